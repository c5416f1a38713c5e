"""The module that expands compact observations gives the usual ones, bit for bit."""

import doctest
import importlib

import numpy as np
import pytest

import uavbench


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-DH-v0", "Block8-DH-v0"])
def test_it_expands_to_the_same_bits(name):
    torch = pytest.importorskip("torch")
    from uavbench.integrations.torch import Expand

    plain, compact = uavbench.make_vec(name, 4), uavbench.make_vec(name, 4, compact=True)
    expand, random = Expand(compact.scenario), np.random.default_rng(0)
    usual, small = plain.reset(seed=0)[0], compact.reset(seed=0)[0]
    for _ in range(200):
        found = expand({part: torch.from_numpy(values) for part, values in small.items()})
        assert found.keys() == usual.keys()
        assert all(np.array_equal(found[part].numpy(), usual[part]) for part in usual)
        actions = random.integers(0, 6, 4)
        usual, small = plain.step(actions)[0], compact.step(actions)[0]


def test_its_example_holds():
    pytest.importorskip("torch")
    assert doctest.testmod(importlib.import_module("uavbench.integrations.torch")).failed == 0
