"""A training so small that it takes a second. Tests that import this module are skipped if PyTorch is missing."""

from dataclasses import replace

import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import load_weights
from uavbench.learning.training import Training

torch = pytest.importorskip("torch", reason="learning needs PyTorch: pip install 'uavbench[ddqn]'")
pytest.importorskip("safetensors", reason="learning needs safetensors: pip install 'uavbench[ddqn]'")

SOURCE = find_agent("ddqn")
DDQN = SOURCE.module()
CPP, DH = load_scenario("Block8-CPP-v0"), load_scenario("Block8-DH-v0")
TINY = replace(
    DDQN.CONFIGS["fast"], updates=40, num_envs=8, batch=4, segment=3, buffer_size=256, learning_starts=64, validation=20
)


def training(config=TINY, scenario=CPP, seed=0):
    return Training(SOURCE, scenario, "tiny", config, seed)


def weights_of(path):
    return {name: array.tobytes() for name, array in load_weights(path)[0].items()}


def spoilt(arrays, name, array):
    """Return ``arrays`` with one of them replaced by ``array``, or without it if ``array`` is None."""
    found = {**arrays, name: array}
    return {key: value for key, value in found.items() if value is not None}


def check_resumes(make, updates):
    """Check that a learner that goes on from a snapshot ends as one that was not interrupted, and another seed does not."""
    torch.set_num_threads(1)
    whole, first, second, other = make(), make(), make(), make(seed=1)
    for learner, count in ((whole, updates), (first, updates // 2), (other, updates)):
        for _ in range(count):
            learner.advance()
    second.resume({name: array.copy() for name, array in first.snapshot().items()})
    for _ in range(updates - updates // 2):
        second.advance()
    ends = [{name: array.tobytes() for name, array in each.snapshot().items()} for each in (whole, second, other)]
    assert ends[0] == ends[1]
    assert ends[0] != ends[2]
