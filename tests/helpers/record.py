"""Recording episodes for golden digests, which fix what the id of a scenario stands for."""

import hashlib
import sys

import numpy as np

from uavbench import load_scenario
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.world.episode import split_size
from uavbench.world.keyed import mix

EPISODES = 200
EPISODES_OF_LARGE_MAPS = 20  # each in a city of its own


def actions(step, count):
    """Return actions that wander: ``land`` is chosen eight times less often than each other action."""
    bits = [int(mix(np.uint64(1_000_003 * step + k))) for k in range(count)]
    return np.array([5 if b % 41 == 0 else (b >> 8) % 5 for b in bits])


def digest(name):
    """Return the SHA-256 of the first test episodes: every observation, mask, reward, end and outcome.

    CPP is hashed exactly. DH is rounded to 1e-6, since logarithms differ between platforms in their last digits.
    """
    scenario = load_scenario(name)
    exact = scenario.mission.kind == "coverage"
    sha = hashlib.sha256()

    def add(values):
        values = np.asarray(values)
        if values.dtype.kind == "f" and not exact:
            values = np.round(values.astype(np.float64) * 1e6).astype(np.int64)
        sha.update(np.ascontiguousarray(values).tobytes())

    episodes = EPISODES if split_size(scenario, "test") >= EPISODES else EPISODES_OF_LARGE_MAPS
    simulator = Simulator(scenario, episodes)
    observer = Observer(scenario)
    index, uavs = np.arange(episodes), np.arange(episodes * scenario.max_uavs)
    shape = (episodes, scenario.max_uavs) if scenario.team else episodes
    simulator.reset(index, "test", index)
    step = 0
    while True:
        observation = observer.empty(len(uavs))
        observer.write(simulator.state, uavs, observation)
        for part in ("local", "global", "budget"):
            add(observation[part])
        add(simulator.action_mask())
        if simulator.state.done.all():
            break
        simulator.step(actions(step, len(uavs)).reshape(shape))
        step += 1
        for part in (simulator.state.reward, simulator.state.done, *simulator.outcomes(index).values()):
            add(part)
    return sha.hexdigest()


if __name__ == "__main__":
    for scenario_id in sys.argv[1:]:
        print(f'    "{scenario_id}": "{digest(scenario_id)}",')
