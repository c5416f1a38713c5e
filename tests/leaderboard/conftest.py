"""Submissions of cheap agents, made once."""

import shutil

import pytest

from uavbench import load_scenario
from uavbench.agent import find_agent
from uavbench.evaluate import Job
from uavbench.leaderboard.submit import submit
from uavbench.results import load_result
from uavbench.run import run

NAMES = ("Block8-CPP-v0", "Block8-DH-v0")


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    """All test episodes of Block8, by agent."""
    out = tmp_path_factory.mktemp("results")
    return {
        agent: [run(Job(find_agent(agent), load_scenario(name), "test"), 1000, out) for name in NAMES]
        for agent in ("greedy", "random")
    }


@pytest.fixture(scope="session")
def made(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("board") / "submissions"
    for agent, flown in results.items():
        submit(flown, folder, name=agent, authors=["A. Author", "B. Author"], hardware="a machine")
    return folder


@pytest.fixture
def submissions(made, tmp_path):
    """A copy of the submissions, to spoil."""
    return shutil.copytree(made, tmp_path / "board" / "submissions")


@pytest.fixture(scope="session")
def result(results):
    return load_result(results["greedy"][0].folder)
