"""Clusters of Ray and Dask, which the tests start, give the bytes of an evaluation in one process, even if a part is killed."""

import contextlib
import os
import shutil
import signal
import socket
from pathlib import Path

import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.cli.app import app
from uavbench.evaluation.cluster import Cluster, ClusterError
from uavbench.evaluation.crew import evaluate_with
from uavbench.evaluation.evaluate import AgentError, Job
from uavbench.evaluation.run import run

SCENARIO = load_scenario("Block8-DH-v0")
N = 120
SLOW = """import time
class Agent:
    def __init__(self, scenario): pass
    def act(self, observation, info):
        time.sleep(0.002)
        assert info["episode"] != FAILS
        return int(info["action_mask"].argmax())
"""
pytestmark = pytest.mark.slow


@pytest.fixture
def agent(tmp_path):
    """Make an agent that takes its time, and may fail in an episode."""

    def make(fails=-1):
        path = tmp_path / "slow.py"
        path.write_text(SLOW.replace("FAILS", str(fails)))
        return Job(find_agent(str(path)), SCENARIO, "test")

    return make


@pytest.fixture
def ray_cluster(monkeypatch):
    """A cluster of Ray with two nodes, and a function that kills the second."""
    pytest.importorskip("ray", reason="needs the extra: pip install -e '.[ray]'")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    from ray.cluster_utils import Cluster as RayCluster

    cluster = RayCluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    second = cluster.add_node(num_cpus=1)
    yield Cluster("ray", cluster.address), lambda: cluster.remove_node(second, allow_graceful=False)
    cluster.shutdown()


@pytest.fixture
def dask_cluster():
    """A cluster of Dask with two worker processes, and a function that kills the second."""
    distributed = pytest.importorskip("distributed", reason="needs the extra: pip install -e '.[dask]'")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        yield Cluster("dask", cluster.scheduler_address), lambda: os.kill(cluster.workers[1].pid, signal.SIGKILL)


@pytest.mark.parametrize("engine", ["ray", "dask"])
def test_a_cluster_that_loses_a_part_gives_the_same_bytes(engine, agent, tmp_path, request):
    cluster, kill = request.getfixturevalue(f"{engine}_cluster")
    seen = []

    def note(record):
        seen.append(record.episode)
        if len(seen) == 25:
            kill()

    found = run(agent(), N, tmp_path / "cluster", workers=cluster, on_record=note)
    assert sorted(seen) == list(range(N))
    whole = run(agent(), N, tmp_path / "whole")
    for name in ("episodes.csv", "actions.npz"):
        assert (found.folder / name).read_bytes() == (whole.folder / name).read_bytes()
    assert found.summary["workers"] == cluster.size == 2


@pytest.mark.parametrize("engine", ["ray", "dask"])
def test_a_driver_that_stops_goes_on_with_what_was_kept(engine, agent, tmp_path, request):
    cluster, _ = request.getfixturevalue(f"{engine}_cluster")
    seen = []

    def stop(record):
        seen.append(record.episode)
        if len(seen) == 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(agent(), N, tmp_path, workers=cluster, on_record=stop)
    again = []
    run(agent(), N, tmp_path, workers=cluster, resume=True, on_record=lambda record: again.append(record.episode))
    assert sorted(again[:30]) == sorted(seen)
    assert sorted(again) == list(range(N))


def test_bounds_and_reruns_on_a_cluster_are_those_of_one_process(dask_cluster, tmp_path, monkeypatch):
    pytest.importorskip("highspy", reason="needs the extra: pip install -e '.[planning]'")
    from typer.testing import CliRunner

    def call(*words):
        found = CliRunner().invoke(app, [str(word) for word in words])
        assert found.exit_code == 0, found.output

    where = ["--cluster", "dask", "--address", dask_cluster[0].address]
    bound = ["bound", "Block8-CPP-v0", "--episodes", 4, "--seconds", 2]
    call(*bound, "--out", tmp_path / "here")
    call(*bound, "--out", tmp_path / "there", *where)
    assert (tmp_path / "here" / "Block8-CPP-v0.csv").read_bytes() == (tmp_path / "there" / "Block8-CPP-v0.csv").read_bytes()
    official = Path(__file__).parents[2] / "leaderboard" / "submissions"
    # One on the state track, and one on the observation track, which flies in a process of its own.
    for agent, name in (("greedy", "Helsinki32-CPP-v0"), ("random", "Block8-CPP-v0")):
        mine = tmp_path / "board" / "submissions" / agent / name
        shutil.copytree(official / agent / name, mine)
        call("leaderboard", "rerun", mine, "--agent", agent, "--episodes", 12, "--fresh", 0, *where)
    assert (tmp_path / "board" / "reruns.csv").read_text().count("-CPP-v0") == 2


def test_an_agent_that_fails_on_a_cluster_is_told_as_everywhere(agent, dask_cluster):
    with pytest.raises(AgentError, match=r"slow on Block8-DH-v0, test episode 7, step 0: act.. raised AssertionError"):
        list(evaluate_with(dask_cluster[0], agent(fails=7), range(20)))


def test_a_cluster_that_is_not_there_is_refused(agent, monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra: pip install -e '.[dask]'")
    monkeypatch.setattr("uavbench.evaluation.cluster._SECONDS", 1)
    with pytest.raises(ClusterError, match=r"--address tcp://127\.0\.0\.1:9: no scheduler of Dask answers there"):
        list(evaluate_with(Cluster("dask", "tcp://127.0.0.1:9"), agent(), range(3)))


@pytest.fixture
def taken_port():
    """Listen on the port that Dask's dashboard has by default, as another cluster on this machine would."""
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # Another cluster on this machine listens there already.
            other.bind(("", 8787))
            other.listen()
        yield


def test_the_command_starts_a_cluster_of_its_own(tmp_path, monkeypatch, taken_port):
    pytest.importorskip("distributed", reason="needs the extra: pip install -e '.[dask]'")
    from typer.testing import CliRunner

    monkeypatch.chdir(tmp_path)
    words = ["evaluate", "--agent", "greedy", "--scenario", "Block8-DH-v0", "--episodes", "12"]
    found = CliRunner().invoke(app, [*words, "--cluster", "dask"])
    assert found.exit_code == 0, found.output
    assert "CRAL" in found.stdout
    refused = CliRunner().invoke(app, [*words, "--address", "tcp://127.0.0.1:9"])
    assert refused.exit_code == 2
