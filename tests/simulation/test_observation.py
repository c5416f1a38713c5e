"""The observation at the sizes that the paper and its ablation use; the oracle covers the rest in test_simulator.py."""

import numpy as np
import pytest
from oracle import Oracle

from uavbench import load_scenario
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator


@pytest.mark.parametrize(
    ("name", "local_size", "scale", "shapes"),
    [
        ("Manhattan32-CPP-v0", 17, 3, ((4, 17, 17), (4, 21, 21))),
        ("Urban50-CPP-v0", 17, 5, ((4, 17, 17), (4, 19, 19))),
        ("Manhattan32-CPP-v0", 0, 1, ((4, 0, 0), (4, 63, 63))),
        ("Manhattan32-CPP-v0", 63, 2, ((4, 63, 63), (4, 31, 31))),
    ],
)
def test_has_the_papers_shapes_and_the_oracles_values(name, local_size, scale, shapes):
    scenario = load_scenario(name).with_observation(local_size, scale)
    simulator = Simulator(scenario, 4)
    simulator.reset(np.arange(4), "test", np.arange(4))
    observer = Observer(scenario)
    assert (observer.local_shape, observer.global_shape) == shapes
    free = np.argwhere(~simulator.city.no_fly)
    simulator.state.position[:, 0] = free[[0, 100, 300, -1]]  # corners and the middle
    batch = observer.empty(4)
    observer.write(simulator.state, np.arange(4), batch)
    for i in range(4):
        state = simulator.state
        oracle = Oracle(scenario, state.position[i, 0].tolist(), state.budget[i, 0], state.target[i])
        expected = oracle.observation(local_size, scale)
        for part, values in batch.items():
            assert np.array_equal(values[i], expected[part].astype(np.float32))


def test_writes_only_the_slots_it_is_asked_for():
    scenario = load_scenario("Block8-DH-v0")
    simulator = Simulator(scenario, 3)
    simulator.reset([0, 1, 2], "test", [0, 1, 2])
    observer = Observer(scenario)
    batch = observer.empty(3)
    for values in batch.values():
        values.fill(-1)
    observer.write(simulator.state, np.array([1]), batch)
    for values in batch.values():
        assert (values[[0, 2]] == -1).all()
        assert (values[1] >= 0).all()
