"""An id is a contract: its scenario, its frozen episodes and its transitions never change.

When a digest here changes, the change is a new version of the id, not a new digest.
"""

import hashlib
from typing import NamedTuple

import numpy as np
import pytest
from record import digest

from uavbench import list_scenarios, load_scenario
from uavbench.envs.env import UAVEnv
from uavbench.simulation.freeze import FROZEN_SPLITS, draw, draw_frozen_cities
from uavbench.world.cells import CHARACTERS
from uavbench.world.cities import cells_of_cities, city_keys
from uavbench.world.episode import episode_keys, frozen_columns, split_size
from uavbench.world.files import pack_arrays
from uavbench.world.keyed import AGENT, stream


class Counts(NamedTuple):
    """How many episodes a split has, and how many cities if they are generated."""

    episodes: int
    cities: int


SCENARIOS = {
    "Block8-CPP-v0": "43c301d74b011aec2cded9f226f0b5cfa92ba0ef5cc3b59dd37ddb892b0011b0",
    "Block8-DH-v0": "767f5aa4ad9e748439b66b0420142d6097125b7941a5a5e3a73b93cb1add9a00",
    "Cities32-CPP-Team-v0": "ec1faef0220c51eb5c790fa83b48c09b1f424e18aae641e003173b1dbd9bb71d",
    "Cities32-CPP-v0": "eb7e121b62ca59dc02fae88c4d94c583e6ad7f7acd43b3dcca38fb6f1f3c9798",
    "Cities32-DH-Team-v0": "c2f6d47d13b8c650df91dd0ab02319881885c86851258bb898ffae18068b00d1",
    "Cities32-DH-v0": "62edbf7a4bfca8a676f10d57a73ef05f74d5ca91e0d036b88a4dbb73c653a725",
    "Cities50-CPP-v0": "47ebdb042bf6ce95b6e516c6e3deb948265996d7e2033e98da6b5d0b75ae1b70",
    "Cities50-DH-v0": "922eecc5c3e1bf3ff308c7a339c76d1cc2a1fcc56e9f5bd1dd814264b2c4b3a1",
    "City128-CPP-v0": "f7b06f35dfecb85eefcb29a82ebe6e77860dffb37ba611f5094895fed6153f50",
    "City128-DH-v0": "111cd3ab072e50b3cc523279aebc855ebda4d865875d20e58bae77d5b65f6bb9",
    "City256-CPP-v0": "2547ba4e96c1029023018f8469f5825d5fef6ba7733585733739a1079f2898e7",
    "City256-DH-v0": "de1d325aefc8ed89ed0d6c1846e08f706e4b7ff397df8165855799b86c1bc085",
    "City512-CPP-v0": "43d5b603f66c7fbd6ba9f34671d9f7d33c4690741509e183f939b3999e74836c",
    "City512-DH-v0": "13b9befc8ce2c7d8d4b2bf7a5d72019dee1feb999cdd9d797d00fc95c16cd921",
    "City64-CPP-v0": "5fe25986b0cf10f214245bc4ac4534d4d11771c45856129cca718b9432d44696",
    "City64-DH-v0": "5fe0c7a1de20579e342fb6843251e28612d89efe36af3eca632afcadefc92235",
    "Helsinki32-CPP-v0": "9d59c61b57e3e4d6b4f53bff7e7d5416c390d10aa615a264a6b12a09f4da9444",
    "Helsinki32-DH-v0": "0b874b6290bc4b5ce0ec8141bc7bed4a97e5e8b0795aa62c16af325848829b62",
    "Helsinki50-CPP-v0": "fc74e279c7dc956dcbeab724af00ca03cf94d5ee14592215ea43dfa7e074825d",
    "Helsinki50-DH-v0": "9f79484f8a54b4b0be4c8a1d7ba354df9b8926f0bd8acc0079308dab57a3d549",
    "Kotka50-CPP-v0": "f47b2507acfd513f25e400a64310fc3c9a15c632c63cc6af0396895f40647f99",
    "Kotka50-DH-v0": "297c2974144adc14a2976d5e987483c4fe5ef17dc1097e4d85a5cf7ff0f8ddc7",
    "Manhattan32-CPP-Long-v0": "88f9f80731d63673c82423fd52a9ed375602ec1add3f5a7e7050575f55a741d2",
    "Manhattan32-CPP-Team-v0": "1669474bfe99a073746b0dff03980b53afad7865f12f77b7511326b2564cbeaf",
    "Manhattan32-CPP-v0": "73d313b96251bb3b3c44f438d3124d6304cdba363cbe98673d5a26b1efc51867",
    "Manhattan32-DH-Long-v0": "9516876c07189f2a5d0e88d91b534bbf73e6feda9585f08fe75183ec11459860",
    "Manhattan32-DH-Team-v0": "d44a8bd763a69fae1e5c8cb619821edd89c0cb466ba823527594c814a18d5fa1",
    "Manhattan32-DH-v0": "bbf0437e869b3c5ec986cc19245ebd85a6254be0455a2e9a1848f4d022d090bc",
    "Urban50-CPP-Long-v0": "f3ddc486817c3bbd8c95d4b998a39c10463d26aaba1d7300f7a127d162d4ab08",
    "Urban50-CPP-Team-v0": "74025341b50993a0754749bc38664f7de48b14bcd9f9821cc146eeff5e05ac78",
    "Urban50-CPP-v0": "d049bb7171be37cd8b22d8398e7102f44c1c91bde06ce71b636d278cf49dab6d",
    "Urban50-DH-Long-v0": "99049c5ba1fb06afff7f20f713f38e716f94b594940b9265372ca8b6e89c0cbe",
    "Urban50-DH-Team-v0": "2969a277d6fde457821b4d417ffb922713d44b3c24a2e75b340d03cbf9c9e7c3",
    "Urban50-DH-v0": "f4f3c41d9595a6962c11777b9c5f5b3e2bce0eccc49902c4f39fc2a40481b38a",
}

TRANSITIONS = {
    "Block8-CPP-v0": "77815db79e3e671c8c08a2446ca5b3b9988ff9a4afdbdb7bfadb199a83a64512",
    "Block8-DH-v0": "ea0d39b155cdef01a913f74ca4ba8792f59d8b5f02d33bdd058326b8c6f3f392",
    "Cities32-CPP-Team-v0": "69019d4bad9866ccdadcb52b4fe7957bf10a94dc3b3d223fb13ee0ccf7439399",
    "Cities32-CPP-v0": "ec7bd4fe22f1056965e4c7b7f4b0f3b8882afa5dce4a89963ffc0a219a2e4d47",
    "Cities32-DH-Team-v0": "167a71508c328ff52a70d34b914480f57946819b22a2d0f6e65c20b4e28e3d3a",
    "Cities32-DH-v0": "eef0b729d9797761185713aba8ef838a61c789d1c1ea616f73b9da1273b5cbb3",
    "Cities50-CPP-v0": "7adda95aef8fe230171f33356484b14d01c2a667e81c18bacf9e992dd78c6697",
    "Cities50-DH-v0": "bb7617d56f9fe8f59a3c005fb5d658403ba3c1c9fbb00bf8a842bd13aa813c20",
    "City128-CPP-v0": "f2aa94e21889f62c8e963a2115deb3af89dc7b7c064f98454aa2c80d216d5d5c",
    "City128-DH-v0": "5030f3082f25603627ae2e2fc31849c1953bbc3330fe2aa15adebd30cc174a16",
    "City256-CPP-v0": "6db1874b082cccfa59d7d0620614003eb260219a88ab9b6965066f52c59fb67d",
    "City256-DH-v0": "c1f4e1f9e78c6b1c9d11394575c8518f5fbe2472c69c3da120f399e28b1e463b",
    "City512-CPP-v0": "e9c179954439da3e1d379add2df92e91c959efdeca679609337a6690fce0d930",
    "City512-DH-v0": "1ce234363e3bf7be23ed0581d1add15a678d73e71d7b45207a534db314879112",
    "City64-CPP-v0": "a64bba95efc52e96e16af83a279362211ab4a6249a9d7888a6d049054ef71786",
    "City64-DH-v0": "f1a15a5b6d6d447bff3be9a9b6d06a7c7972c6095b833042ff38495cd1492bbe",
    "Helsinki32-CPP-v0": "c46984086a9eed2a9949e65278e8a72216abdbd984116092b0692c901da91659",
    "Helsinki32-DH-v0": "cd069da8c97da918e8b9cd328845d0ad648a4817ddd30fd03a1cd9479db4ce49",
    "Helsinki50-CPP-v0": "fa802c85595ff42b53f4533560b048bf5421d0d35cf6de8aec3d6d1e5a97a287",
    "Helsinki50-DH-v0": "53021d88d80e50eb73ed7fe5e4ed99634301f19c751bf75f9390c02f35753f8f",
    "Kotka50-CPP-v0": "70e57a5deeb8e1a958a0380d477b0921932f0df01cfb950075ca7a3941ba5240",
    "Kotka50-DH-v0": "f5e09709d51cf9c2b98c1bb577aab19074517c4c4291f405e60215d1de7e3bab",
    "Manhattan32-CPP-Long-v0": "4ea1fa3447ec4c5451f82f6caafe9e31384c912b585f3fc1113604f379ec0609",
    "Manhattan32-CPP-Team-v0": "b6c3106fb60352ec6970f8691f277430df8164bc10f67456e5d7affe7e785a24",
    "Manhattan32-CPP-v0": "f14cd1f03c839a74e20d9984d8b134806bd49fc35b209a955842e6f2d3b90504",
    "Manhattan32-DH-Long-v0": "8ce640e5a7c533407ce5228e1869d7a7454c32e1daa497d91215d2561b946714",
    "Manhattan32-DH-Team-v0": "c7393aa74cfe944dea642a239f5fb68a378c8292a9c7a34c2349f0e5221fa040",
    "Manhattan32-DH-v0": "09017267f16375cda19ef25f01e3a82c28e614de809e3f6ee151817ef3406bd9",
    "Urban50-CPP-Long-v0": "f1f921d2151955f73a2e647759b3faff204ef362c9d2a03a3b0a868fc9715db5",
    "Urban50-CPP-Team-v0": "bac53feb3706106333374ad1f2c91fef67a0288e3bb4bf3ff6bca723ededbd3b",
    "Urban50-CPP-v0": "4c16aa5cfeabd959610af7420332e4e21da5250c275a5e4dbaecb9f51fd8decd",
    "Urban50-DH-Long-v0": "9dc13d6b2d99b7452354dd87c3691ac4e3fd0eec649496fa927430d870ad40db",
    "Urban50-DH-Team-v0": "d922974cea5670c02574164a252050a0765c69fc65da70e06043bcf086d80859",
    "Urban50-DH-v0": "0f0f4af6a326f0031448af2adaccc2e2aa1887ca04137d4597fe45c66fc30126",
}


def test_every_id_is_here():
    assert set(SCENARIOS) == set(TRANSITIONS) == set(list_scenarios())


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_scenario_is_the_same(name):
    assert load_scenario(name).digest == SCENARIOS[name]


@pytest.mark.parametrize("name", TRANSITIONS)
def test_the_transitions_and_observations_are_the_same(name):
    assert digest(name) == TRANSITIONS[name]


def test_seeds_mean_the_same_episodes():
    env = UAVEnv("Block8-CPP-v0")
    numbers = [env.reset(seed=0)[1], env.reset()[1], env.reset(seed=1)[1]]
    assert [info["episode_number"] for info in numbers] == [2937467307694268567, 1244171615822312904, 2360360630558964031]


def test_agents_are_given_the_same_seeds():
    seeds = [int(stream(key, AGENT)) >> 1 for key in episode_keys("test", np.arange(3))]
    assert seeds == [9204211687907767439, 3353139973716558898, 5702259096666202763]


@pytest.mark.parametrize("split", FROZEN_SPLITS)
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_frozen_episodes_are_what_their_keys_draw(name, split):
    scenario = load_scenario(name)
    drawn, frozen = draw(scenario, split), frozen_columns(scenario, split)
    assert frozen is not None
    assert drawn.keys() == frozen.keys()
    for column in drawn:
        assert drawn[column].dtype == frozen[column].dtype
        assert np.array_equal(drawn[column], frozen[column]), column
    named = scenario.splits.test if split == "test" else scenario.splits.validation
    assert hashlib.sha256(pack_arrays(drawn)).hexdigest() == named.sha256
    assert len(drawn["key"]) == split_size(scenario, split) == counts(name)[split].episodes


@pytest.mark.parametrize("name", [name for name in SCENARIOS if load_scenario(name).cities])
def test_the_frozen_cities_are_what_their_keys_draw(name):
    scenario = load_scenario(name)
    assert scenario.cities.frozen is not None
    for split, drawn in draw_frozen_cities(scenario).items():
        keys = city_keys(scenario, episode_keys(split, np.arange(len(drawn))))
        assert np.array_equal(cells_of_cities(scenario, keys), drawn)
        assert len({cells.tobytes() for cells in drawn}) == len(drawn) == counts(name)[split].cities
    assert scenario.cities.reach <= scenario.budget[1] // 2


def is_large(name):
    """Whether the id is one of the large maps, which have fewer episodes."""
    return name.startswith(("City64", "City128", "City256", "City512"))


def counts(name):
    """Return the numbers of episodes and generated cities that the splits of an id have."""
    if is_large(name):
        return {"test": Counts(100, 20), "validation": Counts(40, 8)}
    return {"test": Counts(1000, 200), "validation": Counts(200, 40)}


def maps_of(scenario):
    """Return the map of each test episode, shape (episodes, M, N), as characters."""
    keys = city_keys(scenario, episode_keys("test", np.arange(split_size(scenario, "test"))))
    return np.array(list(CHARACTERS))[cells_of_cities(scenario, keys)]


def check_range(values, bounds, exhausted):
    """Check that integers are evenly spread over a range; ``exhausted`` if there are enough that each value occurs."""
    low, high = bounds
    assert low <= values.min() <= values.max() <= high
    if exhausted:
        assert set(np.unique(values)) == set(range(low, high + 1))
    assert abs(values.mean() - (low + high) / 2) < 4 * (high - low) / np.sqrt(12 * len(values))


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_frozen_episodes_keep_the_rules(name):
    scenario = load_scenario(name)
    rows, columns = maps_of(scenario), draw(scenario, "test")
    every = np.arange(len(rows))
    check_range(columns["budget"], scenario.budget, exhausted=not is_large(name))
    start = columns["start"].reshape(len(rows), -1, 2)
    assert start.shape[1] == scenario.max_uavs
    assert (rows[every[:, None], start[..., 0], start[..., 1]] == "L").all()
    assert all(len({tuple(cell) for cell in cells}) == len(cells) for cells in start.tolist())
    if scenario.mission.kind == "coverage":
        targets = np.unpackbits(columns["targets"], axis=1, count=rows[0].size).astype(bool)
        assert not (targets & np.isin(rows, ["#", "b"]).reshape(len(rows), -1)).any()
        assert targets.any(axis=1).all()
        assert targets.mean(axis=1).max() <= scenario.mission.target_fraction[1]
        return
    count, cell, data = columns["device_count"], columns["device_cell"], columns["device_data"]
    check_range(count, scenario.mission.devices, exhausted=not is_large(name))
    for k in range(cell.shape[1]):
        there = count > k
        assert np.isin(rows[every[there], cell[there, k, 0], cell[there, k, 1]], [".", "N"]).all()
        assert ((data[there, k] >= 5) & (data[there, k] < 20)).all()
    for row, n in zip(cell, count, strict=True):
        assert len({tuple(c) for c in row[:n].tolist()}) == n
