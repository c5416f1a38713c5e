"""What is believed of the map is true where it was seen, and agrees with all that was shown elsewhere."""

import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.planning.belief import DeviceBelief, TargetBelief, places, static
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator

MAPS = ("Manhattan32", "Urban50")


def flight(name, episode, steps):
    """Fly at random without landing; yield the state's arrays, the cell and the observation of every step."""
    scenario = load_scenario(name)
    simulator, observer, random = Simulator(scenario, 1), Observer(scenario), np.random.default_rng(episode)
    simulator.reset([0], "train", [episode])
    observation = observer.empty(1)
    for _ in range(steps):
        observer.write(simulator.state, np.arange(1), observation)
        yield simulator.state, tuple(simulator.state.position[0, 0].tolist()), {k: v[0].copy() for k, v in observation.items()}
        simulator.step([int(random.choice(np.flatnonzero(simulator.action_mask()[0, :5])))])


@pytest.mark.parametrize("city", MAPS)
def test_no_two_cells_look_alike(city):
    scenario = load_scenario(f"{city}-CPP-v0")
    found = places(scenario)
    free = ~Simulator(scenario, 1).city.no_fly
    assert sorted(found.values()) == [tuple(cell) for cell in np.argwhere(free).tolist()]
    for _, here, observation in flight(f"{city}-CPP-v0", 3, 20):
        assert found[static(observation["global"])] == here


@pytest.mark.parametrize("city", MAPS)
def test_targets_that_were_seen_are_right_and_the_rest_adds_up(city):
    scenario = load_scenario(f"{city}-CPP-v0")
    for episode in range(4):
        belief, first = TargetBelief(scenario), None
        for state, here, observation in flight(f"{city}-CPP-v0", episode, 40):
            first = state.target[0].copy() if first is None else first
            belief.learn(here, observation)
            known, now = belief.known, state.target[0]
            assert (belief.now[known] == now[known]).all()
            assert (belief.first[known] == first[known]).all()
            assert (belief.likely[~known & (first > 0)] > 0).all()  # no target is ruled out
            whole = np.where(known, belief.first, belief.likely)
            assert whole.sum() == pytest.approx(first.sum(), rel=0.05)
        unknown = ~known
        wrong = ((belief.likely > 0.5) != (first > 0))[unknown].mean() if unknown.any() else 0.0
        assert wrong < min(0.12, (first > 0)[unknown].mean() + 0.02)


@pytest.mark.parametrize("city", MAPS)
def test_devices_near_are_right_and_no_data_are_forgotten(city):
    scenario = load_scenario(f"{city}-DH-v0")
    half = scenario.observation.local_size // 2
    for episode in range(4):
        belief = DeviceBelief(scenario)
        for state, here, observation in flight(f"{city}-DH-v0", episode, 40):
            belief.learn(here, observation)
            truth = state.target[0]
            near = tuple(slice(max(0, at - half), at + half + 1) for at in here)
            assert belief.data[near] == pytest.approx(truth[near], rel=1e-6)
            assert belief.data.sum() == pytest.approx(truth.sum(), rel=1e-3, abs=0.1)
            cells, data = belief.devices()
            assert len(cells) == len(data) <= (truth > 0).sum()


def test_a_change_far_away_is_told():
    scenario = load_scenario("Manhattan32-DH-v0")
    belief, told = DeviceBelief(scenario), []
    for _, here, observation in flight("Manhattan32-DH-v0", 1, 30):
        before = belief.data > 0
        told.append(belief.learn(here, observation) == ((belief.data > 0) != before).any())
    assert all(told)
