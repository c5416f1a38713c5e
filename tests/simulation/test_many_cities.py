"""A scenario with many cities: each episode is that of its city's map, in any batch, and nothing else decides it."""

import pickle

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, HARVESTING, SIZES, SURVEILLANCE, in_city, maps, scenario

from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.world.cells import rows_of
from uavbench.world.cities import city_count, city_key, city_keys, city_numbers
from uavbench.world.city_source import Cities, SplitMaps
from uavbench.world.episode import episode_keys, fresh_keys
from uavbench.world.scenario import SPLITS

SOURCE = {"generator": "mixed-v0", "shape": (17, 14), "validation": 3, "test": 7}
#: A map for each split, with a building in another column.
MAPS = {split: [("LL..", "....", "....", "." * k + "#" + "." * (3 - k))] for k, split in enumerate(SPLITS)}
MISSIONS = {"CPP": COVERAGE, "DH": HARVESTING}


def many(mission=COVERAGE, source=SOURCE, **changes):
    """Return a scenario with many cities."""
    return scenario((), mission, cities=Cities.model_validate(source), **changes)


def begun(world, keys):
    """Return a simulator in which the episodes of ``keys`` have begun."""
    simulator = Simulator(world, len(keys))
    simulator.sample(np.arange(len(keys)), keys)
    return simulator


def everything(simulator, world, i):
    """Return all that is seen of slot ``i``: its state, the mission's arrays, observations and masks, as bytes."""
    uavs = world.max_uavs
    observer = Observer(world)
    shown = observer.empty(simulator.num_envs * uavs)
    observer.write(simulator.state, np.arange(simulator.num_envs * uavs), shown)
    parts = [array[i] for array in (*simulator.state.arrays().values(), *simulator.mission.arrays().values())]
    parts += [values[i * uavs : (i + 1) * uavs] for values in shown.values()]
    return [part.tobytes() for part in (*parts, simulator.action_mask()[i], simulator.safe_action_mask()[i])]


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(sorted(MISSIONS)),
    st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=5),
    SIZES,
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_each_episode_is_that_of_its_citys_map(mission, keys, sizes, team, seed):
    observation = {"local_size": sizes[0], "global_scale": sizes[1]}
    world = many(MISSIONS[mission], observation=observation, uavs=(1, 3) if team else None)
    keys = np.array(keys, dtype=np.uint64)
    batch = begun(world, keys)
    alone = [in_city(world, batch.city_at(i)) for i in range(len(keys))]
    singles = [begun(each, keys[i : i + 1]) for i, each in enumerate(alone)]
    actions = np.random.default_rng(seed).integers(0, 6, (30, len(keys), *((3,) if team else ())))
    for t in range(30):
        for i, single in enumerate(singles):
            assert everything(batch, world, i) == everything(single, alone[i], 0)
            single.step(actions[t, i : i + 1])
        batch.step(actions[t])


@pytest.mark.parametrize("mission", MISSIONS)
def test_threads_change_nothing(mission):
    world, keys = many(MISSIONS[mission]), np.arange(20, dtype=np.uint64)
    simulators = [begun(world, keys), Simulator(world, 20, threads=2)]
    simulators[1].sample(np.arange(20), keys)
    for t in range(20):
        for simulator in simulators:
            simulator.step(np.full(20, t % 5))
        assert all(everything(simulators[0], world, i) == everything(simulators[1], world, i) for i in range(20))


@pytest.mark.parametrize("mission", MISSIONS)
def test_a_state_brings_its_city_along(mission):
    world = many(MISSIONS[mission])
    first, second = begun(world, np.arange(4, dtype=np.uint64)), begun(world, np.arange(50, 56, dtype=np.uint64))
    first.step([0, 1, 2, 3])
    state = pickle.loads(pickle.dumps(first.get_state([3, 1])))
    second.set_state(state, [0, 5])
    for _ in range(5):
        assert everything(second, world, 0) == everything(first, world, 3)
        assert everything(second, world, 5) == everything(first, world, 1)
        assert np.array_equal(second.city_at(5).cells, first.city_at(1).cells)
        first.step([1, 2, 3, 4])
        second.step([4, 0, 0, 0, 0, 2])


def test_scatter_puts_uavs_where_they_can_land_in_their_own_city():
    simulator = begun(many(), np.arange(60, dtype=np.uint64))
    simulator.scatter(np.arange(60))
    for i in range(60):
        home = simulator.city_at(i).distance_to_landing[tuple(simulator.state.position[i, 0])]
        assert 0 <= home < simulator.state.budget[i, 0]


def test_options_are_checked_in_the_episodes_own_city():
    simulator = begun(many(), np.arange(8, dtype=np.uint64))
    for i in range(8):
        city = simulator.city_at(i)
        building = np.argwhere(city.building)[0]
        targets = np.zeros(city.shape, bool)
        targets[tuple(building)] = True
        with pytest.raises(ValueError, match=r"is a building; buildings cannot be targets"):
            simulator.customise(i, {"targets": targets})
        simulator.customise(i, {"start": city.landing_cells[-1].tolist()})
        assert simulator.state.position[i, 0].tolist() == city.landing_cells[-1].tolist()


def test_the_split_and_the_number_of_an_episode_give_its_city():
    world = many()
    for split, count in (("validation", 3), ("test", 7)):
        assert city_count(world.cities, split) == count
        assert city_numbers(world, split, np.arange(20)).tolist() == [n % count for n in range(20)]
    train = city_numbers(world, "train", np.arange(1000))
    assert len(set(train.tolist())) == 1000
    keys = [city_keys(world, episode_keys(split, np.arange(1000))) for split in SPLITS]
    keys.append(city_keys(world, fresh_keys(1, range(1000))))
    assert len(set(np.concatenate(keys).tolist())) == 1000 + 3 + 7 + 1000
    assert [int(each[0]) >> 62 for each in keys] == [0, 1, 2, 3]


def test_a_limited_number_of_train_cities_is_used_evenly():
    world = many(source={**SOURCE, "train": 10})
    counts = np.bincount(city_numbers(world, "train", np.arange(5000)))
    assert len(counts) == 10
    assert counts.min() > 400


@settings(max_examples=20)
@given(st.data())
def test_cities_may_come_from_files_of_each_split(data):
    shape = {"smallest": 5, "largest": 5}
    drawn = {split: tuple(data.draw(st.lists(maps(**shape), min_size=1, max_size=3))) for split in SPLITS}
    assume(len({each for split in SPLITS for each in drawn[split]}) == sum(map(len, drawn.values())))
    world = many(source={"maps": SplitMaps.model_validate(drawn)})
    for split in SPLITS:
        simulator = Simulator(world, 6)
        simulator.reset(np.arange(6), split, np.arange(6))
        shown = [rows_of(simulator.city_at(i).cells) for i in range(6)]
        assert set(shown) <= set(drawn[split])
        if split != "train":
            assert shown == [drawn[split][n % len(drawn[split])] for n in range(6)]
    fresh = begun(world, fresh_keys(1, range(4)))
    assert {rows_of(fresh.city_at(i).cells) for i in range(4)} <= set(drawn["test"])


def test_a_slot_may_be_named_more_often_than_there_are_slots():
    simulator = Simulator(many(), 2)
    simulator.reset([0, 1], "test", [1, 2])
    one = simulator.get_state([1])
    simulator.set_state(one, [0] * 50)
    assert simulator.city_at(0) is simulator.city_at(1)


def test_the_same_city_is_the_same_object_and_no_city_is_the_scenarios():
    world = many()
    simulator = Simulator(world, 2)
    simulator.reset([0, 1], "test", [1, 8])
    assert simulator.city_at(0) is simulator.city_at(1)
    with pytest.raises(ValueError, match=r"has many cities: city_at\(i\) returns the city of slot i"):
        _ = simulator.city


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ({**SOURCE, "generator": "blocks-v9"}, "'blocks-v9' is not one of blocks-v0"),
        ({name: value for name, value in SOURCE.items() if name != "shape"}, "shape is missing"),
        ({}, "cities come from a generator or from files"),
        ({**SOURCE, "frozen": {"file": "cities.npz"}}, "frozen.sha256\n"),
        ({**SOURCE, "shape": (4, 200)}, "shape"),
        ({**SOURCE, "reach": 1}, "reach: 1 moves are too few"),
        ({"maps": MAPS, "test": 3}, "test belongs to a generator"),
        ({"maps": {**MAPS, "test": MAPS["train"]}}, "map 0 of test is the same as map 0 of train"),
        ({"maps": {**MAPS, "test": MAPS["test"] * 2}}, "map 1 of test is the same as map 0 of test"),
        ({"maps": {split: [("....",) * 4] for split in SPLITS}}, "map 0: there is no landing cell"),
        (
            {"maps": {**{split: [("L...",) + ("....",) * 3] for split in SPLITS}, "test": [("L....",) + (".....",) * 3]}},
            "all maps of a scenario must have the same shape",
        ),
    ],
)
def test_a_wrong_source_is_refused(source, expected):
    with pytest.raises(ValueError, match=expected):
        many(source=source)


def test_what_does_not_fit_every_city_is_refused():
    with pytest.raises(ValueError, match=r"up to 9 start in landing cells of their own, and the map has 4"):
        many(uavs=(1, 9))
    with pytest.raises(ValueError, match=r"cities.places: up to 30 devices need"):
        many({**HARVESTING, "devices": (1, 30)})
    with pytest.raises(ValueError, match="'surveillance' is made for one map"):
        many(SURVEILLANCE)
    with pytest.raises(ValueError, match=r"not both"):
        scenario(("LL..", "....", "....", "...."), cities=Cities.model_validate(SOURCE))
    with pytest.raises(ValueError, match="map: is missing"):
        scenario(())


def test_a_city_out_of_range_is_refused():
    with pytest.raises(ValueError, match="city: 7 is out of range; Test-v0 has test cities 0 to 6"):
        city_key(many(), "test", 7)
    with pytest.raises(ValueError, match="has one map"):
        city_key(scenario(("LL..", "....", "....", "....")), "test", 0)


def test_the_source_is_part_of_the_digest():
    digests = {many(source={**SOURCE, **change}).digest for change in ({}, {"test": 8}, {"reach": 9}, {"train": 5})}
    assert len(digests) == 4
    assert many().digest == many().digest
