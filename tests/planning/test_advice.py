"""A teacher's advice: compared with brute force over all flights of a few moves, and followed to the end."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.planning import coverage, harvesting
from uavbench.planning.advice import NEVER, Teacher
from uavbench.simulation.missions.coverage import camera_views
from uavbench.simulation.simulator import Simulator

CHANGES = {"first": 20_000, "mending": 2_000}
OFFSETS = [(-1, 0), (0, 1), (1, 0), (0, -1), (0, 0)]


def flights(city, here, moves):
    """All sequences of cells of at most ``moves`` actions that end in a landing cell."""
    if city.landing[here]:
        yield [here]
    if moves == 0 or city.distance_to_landing[here] > moves:
        return
    for down, right in OFFSETS:
        r, c = here[0] + down, here[1] + right
        if 0 <= r < city.shape[0] and 0 <= c < city.shape[1] and not city.no_fly[r, c]:
            for rest in flights(city, (r, c), moves - 1):
                yield [here, *rest]


def value(scenario, city, state, flight):
    """What a flight covers, or is expected to collect."""
    if scenario.mission.kind == "harvesting":
        devices = np.argwhere(state.target[0] > 0).astype(np.int32)
        data = state.target[0][state.target[0] > 0].astype(np.float64)
        plan = harvesting.search(
            scenario, value.rates, devices, data, [flight[0]], [len(flight)], seed=0, moves=0, first=[flight], city=city
        )
        return plan.value - harvesting.LENGTH_PRICE * (len(flight) - 1)
    seen = np.zeros(city.shape, dtype=bool)
    size = scenario.mission.camera_size
    for r, c in flight[1:]:
        view = int(camera_views(scenario, city)[r, c])
        for k in range(size * size):
            if view >> k & 1:
                seen[r + k // size - size // 2, c + k % size - size // 2] = True
    return (seen & (state.target[0] > 0)).sum() - coverage.LENGTH_PRICE * (len(flight) - 1)


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0"])
@pytest.mark.parametrize("episode", range(3))
def test_worths_are_those_of_the_best_flights_of_a_few_moves(scenario, episode):
    scenario = load_scenario(scenario)
    simulator = Simulator(scenario, 1)
    simulator.reset([0], "test", [episode])
    simulator.customise(0, {"budget": 7})
    city, state = simulator.city, simulator.state
    if scenario.mission.kind == "harvesting":
        value.rates = harvesting.rates_for(scenario, np.argwhere(state.target[0] > 0).astype(np.int32), city)
    teacher = Teacher(scenario, 1, **CHANGES)
    teacher.begin(simulator, [0])
    found = teacher.worths(simulator, [0])[0, 0]
    start = tuple(state.position[0, 0].tolist())
    best = np.full(6, NEVER)
    for flight in flights(city, start, 6):
        action = 5 if len(flight) == 1 else OFFSETS.index(tuple(np.subtract(flight[1], flight[0]).tolist()))
        best[action] = max(best[action], value(scenario, city, state, flight))
    assert found.max() == pytest.approx(best.max(), abs=1e-6)
    assert (found <= best + 1e-6).all()
    assert ((found == NEVER) == (best == NEVER)).all()


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-CPP-Team-v0", "Manhattan32-DH-Team-v0"])
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_exactly_valid_and_safe_actions_have_a_worth(scenario, seed):
    scenario, random = load_scenario(scenario), np.random.default_rng(seed)
    simulator, teacher = Simulator(scenario, 2), Teacher(scenario, 2, first=500, mending=50)
    simulator.reset([0, 1], "train", random.integers(2**40, size=2))
    teacher.begin(simulator, [0, 1])
    shape = (2, scenario.max_uavs, 6)
    for _ in range(40):
        running = np.flatnonzero(~simulator.state.done.all(axis=1))
        if not len(running):
            break
        worths = teacher.worths(simulator, running.tolist())
        r, c = simulator.state.position[running].transpose(2, 0, 1)  # other UAVs are not considered
        can_land = simulator.city.distance_to_landing[r, c] + 1 <= simulator.state.budget[running]
        expected = simulator.city.action_mask[r, c] & simulator.safe_action_mask().reshape(shape)[running]
        expected &= (can_land & ~simulator.state.done[running])[..., None]
        np.testing.assert_array_equal(worths > NEVER, expected > 0)
        actions = random.integers(5, size=shape[:2])
        simulator.step(actions if scenario.team else actions[:, 0])


@pytest.mark.parametrize("scenario", ["Manhattan32-CPP-v0", "Manhattan32-DH-v0", "Cities32-CPP-v0", "Manhattan32-CPP-Team-v0"])
def test_who_follows_the_advice_lands_and_flies_better_than_greedy(scenario):
    scenario = load_scenario(scenario)
    numbers = np.arange(8)
    simulator, teacher = Simulator(scenario, 8), Teacher(scenario, 8, **CHANGES)
    simulator.reset(numbers, "test", numbers)
    teacher.begin(simulator, numbers.tolist())
    actions = np.zeros((8, scenario.max_uavs), dtype=np.int64)
    while len(running := np.flatnonzero(~simulator.state.done.all(axis=1))):
        actions[running] = teacher.worths(simulator, running.tolist()).argmax(axis=2)
        simulator.step(actions if scenario.team else actions[:, 0])
    outcome = simulator.outcomes()
    assert outcome["landed"].all()
    assert outcome["cral"].mean() > np.mean(
        [each.cral for each in evaluate(Job(find_agent("greedy"), scenario, "test"), numbers, workers=0)]
    )


def test_is_the_same_in_any_slot():
    scenario, worths = load_scenario("Manhattan32-DH-v0"), []
    for slots in ([0], [2, 0]):
        simulator, teacher = Simulator(scenario, 3), Teacher(scenario, 3, first=2_000, mending=500)
        simulator.reset(slots, "test", [5, 6][: len(slots)])
        teacher.begin(simulator, slots)
        worths.append([teacher.worths(simulator, slots)[0] for _ in range(3)])
    np.testing.assert_array_equal(*worths)


def test_declines_large_maps():
    with pytest.raises(ValueError, match="City128-CPP-v0: its maps are too large"):
        Teacher(load_scenario("City128-CPP-v0"), 1, **CHANGES)
