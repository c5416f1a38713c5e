"""Symmetries: what is seen and earned in a turned city is what is seen and earned in the city, turned."""

import numpy as np
import pytest
import worlds
from hypothesis import given, settings
from hypothesis import strategies as st

from uavbench.agents.symmetries import IDENTITY, symmetries_of
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import OFFSETS

torch = pytest.importorskip("torch", reason="symmetries turn PyTorch's tensors: pip install 'uavbench[ddqn]'")


def test_there_are_eight_and_four_if_a_map_is_not_square():
    cells = torch.arange(9).reshape(3, 3)
    assert len({tuple(each.maps(cells).flatten().tolist()) for each in symmetries_of((3, 3))}) == 8
    assert symmetries_of((3, 3))[0] == IDENTITY
    assert torch.equal(IDENTITY.maps(cells), cells)
    assert IDENTITY.actions == (0, 1, 2, 3, 4, 5)
    assert {each.maps(torch.zeros(2, 5)).shape for each in symmetries_of((2, 5))} == {(2, 5)}
    assert len(symmetries_of((2, 5))) == 4


@pytest.mark.parametrize("symmetry", symmetries_of((5, 5)))
def test_turned_maps_are_restored(symmetry):
    maps = torch.rand(2, 3, 5, 5)
    assert torch.equal(symmetry.restored(symmetry.maps(maps)), maps)


@pytest.mark.parametrize("symmetry", symmetries_of((5, 5)))
def test_actions_lead_where_the_map_has_their_cells(symmetry):
    for action in range(4):
        marked = torch.zeros(5, 5)
        marked[2 + OFFSETS[action, 0], 2 + OFFSETS[action, 1]] = 1.0
        place = np.argwhere(symmetry.maps(marked).numpy())[0] - 2
        assert tuple(place.tolist()) == tuple(OFFSETS[symmetry.actions[action]].tolist())
        assert symmetry.direction(*OFFSETS[action].tolist()) == tuple(place.tolist())


def turned(symmetry, array):
    return symmetry.maps(torch.from_numpy(np.array(array))).numpy()


@settings(max_examples=30, deadline=None)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
def test_whoever_flies_in_a_turned_city_sees_it_turned_and_in_a_reflected_one_earns_the_same(data, seed):
    side, random = data.draw(st.integers(5, 9)), np.random.default_rng(seed)
    rows = data.draw(worlds.maps(side, side))
    symmetry = data.draw(st.sampled_from(symmetries_of((side, side))))
    scale = data.draw(st.sampled_from([g for g in (1, 3, 5, 7) if (2 * side - 1) % g == 0]))
    letters = np.array([list(row) for row in rows])
    city = worlds.scenario(rows, observation={"local_size": 5, "global_scale": scale})
    other = worlds.scenario(
        ("".join(row) for row in letters.reshape(-1)[turned(symmetry, np.arange(side * side).reshape(side, side))]),
        observation={"local_size": 5, "global_scale": scale},
    )
    targets = random.random((side, side)) < 0.5
    targets &= ~np.isin(letters, ["#", "b"])
    if not targets.any():
        return
    start = tuple(np.argwhere(letters == "L")[0].tolist())
    marked = np.zeros((side, side), dtype=np.int64)
    marked[start] = 1
    there = tuple(np.argwhere(turned(symmetry, marked))[0].tolist())
    one, two = Simulator(city, 1), Simulator(other, 1)
    for simulator, cell, cells in ((one, start, targets), (two, there, turned(symmetry, targets))):
        simulator.reset([0], "train", [0])
        simulator.customise(0, {"start": cell, "budget": 30, "targets": cells})
    for _ in range(30):
        seen = [Observer(each.scenario).empty(1) for each in (one, two)]
        for simulator, observation in zip((one, two), seen, strict=True):
            Observer(simulator.scenario).write(simulator.state, np.arange(1), observation)
        if not symmetry.transpose:
            np.testing.assert_array_equal(one.state.reward, two.state.reward)
            np.testing.assert_array_equal(turned(symmetry, seen[0]["local"]), seen[1]["local"])
            np.testing.assert_array_equal(turned(symmetry, seen[0]["global"]), seen[1]["global"])
        for name in ("local", "global"):
            np.testing.assert_array_equal(turned(symmetry, seen[0][name])[:, :3], seen[1][name][:, :3])
        if one.state.done[0, 0]:
            break
        action = int(random.integers(6))
        one.step([action])
        two.step([symmetry.actions[action]])
