"""Several threads share the slots of a step: the results are the same to the last bit."""

import gymnasium as gym
import numpy as np
import pytest
from worlds import SURVEILLANCE, scenario

from uavbench import load_scenario
from uavbench.envs.vector_env import UAVVectorEnv
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator

ROWS = ("LL......", "........", "..##....", "..##....", "......N.", "........")
WORLDS = {
    **{
        name: load_scenario(name) for name in ("Manhattan32-CPP-v0", "Urban50-DH-v0", "Manhattan32-DH-Team-v0", "Block8-CPP-v0")
    },
    "surveillance": scenario(ROWS, SURVEILLANCE, uavs=(1, 2)),
}
SLOTS = 7


def flight(world, threads):
    """Return everything that there is to see in some steps with resets, as bytes."""
    simulator, observer = Simulator(world, SLOTS, threads), Observer(world)
    rng, started, seen = np.random.default_rng(0), SLOTS, []
    simulator.reset(np.arange(SLOTS), "train", np.arange(SLOTS))
    everyone = np.arange(SLOTS * world.max_uavs)
    for _ in range(120):
        simulator.step(rng.integers(0, 6, (SLOTS, world.max_uavs) if world.team else SLOTS))
        over = simulator.state.done.all(axis=1).nonzero()[0]
        if len(over):
            simulator.reset(over, "train", np.arange(started, started + len(over)))
            started += len(over)
        shown = observer.empty(len(everyone))
        observer.write(simulator.state, everyone, shown, threads)
        seen.append(
            b"".join(
                part.tobytes()
                for part in (*simulator.state.arrays().values(), *simulator.mission.arrays().values(), *shown.values())
            )
        )
    assert started > SLOTS
    return seen


@pytest.mark.parametrize("name", WORLDS)
def test_any_number_of_threads_gives_the_same_bits(name):
    alone = flight(WORLDS[name], 1)
    for threads in (2, 3, 2 * SLOTS):  # also more than slots, and than cores
        assert flight(WORLDS[name], threads) == alone


def test_vector_environments_take_threads():
    made = [
        gym.make_vec("uavbench/Block8-DH-v0", 5, vectorization_mode="vector_entry_point", threads=threads, split="test")
        for threads in (1, 2)
    ]
    first, second = ([env.reset(seed=0), *(env.step([n % 6] * 5) for n in range(40))] for env in made)
    for one, two in zip(first, second, strict=True):
        for name, values in one[0].items():
            assert values.tobytes() == two[0][name].tobytes()
        assert [part.tolist() for part in one[1:-1]] == [part.tolist() for part in two[1:-1]]
        assert {name: values.tolist() for name, values in one[-1].items()} == {
            name: values.tolist() for name, values in two[-1].items()
        }


def test_a_wrong_action_changes_nothing_in_any_thread():
    simulator = Simulator(WORLDS["Block8-CPP-v0"], 4, 2)
    simulator.reset(np.arange(4), "test", np.arange(4))
    before = [part.tobytes() for part in simulator.state.arrays().values()]
    with pytest.raises(ValueError, match="actions: 6 is not an action from 0 to 5"):
        simulator.step([0, 0, 6, 0])
    assert [part.tobytes() for part in simulator.state.arrays().values()] == before


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2", None])
def test_other_values_are_refused(threads):
    with pytest.raises(ValueError, match=r"threads: .* is not an integer from 1 on"):
        UAVVectorEnv("Block8-CPP-v0", 2, threads=threads)
