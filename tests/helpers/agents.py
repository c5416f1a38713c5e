"""Agents for tests, good and bad, one class each: ``tests/helpers/agents.py:Class``."""

import contextlib
import os
import signal
import sys
import time

import numba
import numpy as np


class One:
    """Takes random valid actions, which depend on the episode's seed and on the observation; decides for one UAV at a time."""

    def __init__(self, scenario):
        self.most = scenario.budget[1]

    def reset(self, info):
        self.generator = np.random.default_rng(info["seed"])

    def act(self, observation, info):
        assert observation["local"].ndim == observation["global"].ndim == 3
        assert "safe_action_mask" not in info
        allowed = np.flatnonzero(info["action_mask"])
        if len(allowed) > 3 and observation["budget"][0] > self.most / 4:
            allowed = allowed[allowed != 5]
        return allowed[int(self.generator.random() * len(allowed))]


class Many(One):
    """The same as `One`, for many episodes at once."""

    def reset(self, info):
        super().reset(info)
        self.generators = {**getattr(self, "generators", {}), info["episode"]: self.generator}

    def act_batch(self, observations, infos):
        actions = []
        for i, info in enumerate(infos):
            self.generator = self.generators[info["episode"]]
            actions.append(self.act({name: values[i] for name, values in observations.items()}, info))
        return np.array(actions)


class Careful(One):
    """Takes random actions that are valid and safe, so that it always lands."""

    safe_mask = True

    def act(self, observation, info):
        allowed = np.flatnonzero(info["action_mask"] & info["safe_action_mask"])
        return allowed[int(self.generator.random() * len(allowed))]


class Careless(One):
    """Says by a text what is said by True or False."""

    safe_mask = "yes"


class Seer:
    """Checks the state that an agent on the state track sees."""

    track = "state"

    def __init__(self, scenario):
        pass

    def act(self, observation, info):
        state = info["state"]
        for array in (state.target, state.city.landing, state.city.distance_to_landing):
            try:
                array[0, 0] = 1
            except ValueError:
                continue
            raise AssertionError("an array of the state can be written")
        assert state.budget == observation["budget"][0]
        middle = observation["local"].shape[1] // 2
        assert observation["local"][3, middle, middle] == state.target[state.position]
        assert state.remaining <= state.total
        assert state.scenario.budget[1] >= state.budget
        assert state.uav == info["uav"]
        assert tuple(state.positions[state.uav]) == state.position
        assert state.budgets[state.uav] == state.budget
        assert state.active[state.uav]
        others = [u for u in np.flatnonzero(state.active) if u != state.uav]
        for u in others:
            r, c = state.positions[u] - state.position + middle
            if 0 <= r <= 2 * middle and 0 <= c <= 2 * middle:
                assert observation["local"][4, r, c] == 1
                assert observation["local"][5, r, c] == state.budgets[u]
        if state.scenario.mission.kind == "harvesting":
            assert len(state.device_cell) == len(state.device_data)
            assert np.isclose(state.device_data.sum(), state.remaining)
        return 5 if state.city.landing[state.position] and state.budget < 8 else 4


class Together(One):
    """The same as `One`, for a whole team at once."""

    track = "state"

    def act_team(self, observations, infos):
        assert [info["uav"] for info in infos] == np.flatnonzero(infos[0]["state"].active).tolist()
        assert len({info["episode"] for info in infos}) == 1
        return [self.act(observation, info) for observation, info in zip(observations, infos, strict=True)]


class OnlyTogether:
    """Has ``act_team`` only, which therefore also decides where there is one UAV."""

    track = "state"

    def __init__(self, scenario):
        pass

    def act_team(self, observations, infos):
        return [5 if info["action_mask"][5] and info["state"].budget < 20 else 4 for info in infos]


class TooMany(OnlyTogether):
    def act_team(self, observations, infos):
        return [4] * (len(infos) + 1)


class WrongTogether(OnlyTogether):
    def act_team(self, observations, infos):
        return [4 if info["uav"] != 1 else 8 for info in infos]


class TogetherButBlind(OnlyTogether):
    track = "observation"


class WrongAlone:
    """Returns a wrong action for one UAV of the team."""

    def __init__(self, scenario):
        pass

    def act(self, observation, info):
        return 4 if info["uav"] != 1 else 8


class Blind:
    """Returns a wrong action if the observation track shows the state."""

    def __init__(self, scenario):
        pass

    def act(self, observation, info):
        return 4 if "state" not in info else 9


class _Bad(Blind):
    step = 3

    def reset(self, info):
        self.episode, self.steps = info["episode"], 0

    def act(self, observation, info):
        self.steps += 1
        return self.answer() if self.episode == 3 and self.steps == self.step + 1 else 4

    def answer(self):
        raise NotImplementedError


class Raises(_Bad):
    def answer(self):
        raise RuntimeError("lost my way")


class WrongShape(_Bad):
    def answer(self):
        return [1, 2]


class NotANumber(_Bad):
    def answer(self):
        return float("nan")


class OutOfRange(_Bad):
    def answer(self):
        return 6


class Nothing(_Bad):
    def answer(self):
        return None


class Slow(_Bad):
    def answer(self):
        try:
            time.sleep(30)
        except Exception:
            return 4
        return 4


class Ragged(_Bad):
    def answer(self):
        return [[1, 2], [3]]


class Exits(_Bad):
    def answer(self):
        raise SystemExit(0)


class Dies(_Bad):
    """Ends its process with the exit status 1."""

    def answer(self):
        os._exit(1)


class DiesQuietly(_Bad):
    """Ends its process with the exit status 0, as if all were well."""

    def answer(self):
        os._exit(0)


class ExitsInArray(_Bad):
    def answer(self):
        return _Array(lambda: sys.exit(0))


class _Array:
    """Runs a function when NumPy converts it to an array."""

    def __init__(self, do):
        self._do = do

    def __array__(self, dtype=None, copy=None):
        return self._do()


@numba.njit
def _endless(x):
    while x < 10:
        x = x % 3
    return x


class Compiled(_Bad):
    """Never returns from compiled code, in which Python handles no signals."""

    def answer(self):
        return _endless(4)


class Stubborn(_Bad):
    """Catches every exception that could stop it."""

    def answer(self):
        while True:
            with contextlib.suppress(BaseException):
                time.sleep(1)


class Deaf(_Bad):
    """Ignores the alarm signal, and takes too long."""

    def answer(self):
        signal.signal(signal.SIGALRM, signal.SIG_IGN)
        time.sleep(60)


class EndlessArray(_Bad):
    def answer(self):
        return _Array(lambda: time.sleep(60))


class Unreadable(_Bad):
    """Raises an exception whose message cannot be read."""

    def answer(self):
        class HiddenError(Exception):
            def __str__(self):
                raise RuntimeError("no")

        raise HiddenError


class Slowly(Blind):
    """Takes some time for each decision, but for none too long."""

    def act(self, observation, info):
        time.sleep(0.002)
        return 4


class Compiles(Blind):
    """Compiles for seconds in its first decision, and makes all others at once."""

    def act(self, observation, info):
        if not hasattr(self, "decide"):

            @numba.njit
            def decide(x):
                return np.sort(x)[0] + np.linalg.norm(x) + np.median(x) + np.percentile(x, 50) + np.unique(x)[0]

            self.decide = decide
            self.decide(np.ones(3))
        return 4


class WrongBatch(Blind):
    def act_batch(self, observations, infos):
        return np.zeros((len(infos), 1), dtype=int)


class BadBatch(Blind):
    def act_batch(self, observations, infos):
        return np.where([info["episode"] == 3 for info in infos], 7, 4)


class RaggedBatch(Blind):
    def act_batch(self, observations, infos):
        return [[1], [2, 3]]


class RaisingBatch(Blind):
    def act_batch(self, observations, infos):
        raise RuntimeError("lost")


class HangingReset(Blind):
    def reset(self, info):
        time.sleep(30)


class BadInit:
    def __init__(self, scenario):
        raise OSError("no weights")

    def act(self, observation, info):
        return 4


class Remembers(Blind):
    """Takes actions that depend on the episodes flown before, which the contract forbids."""

    count = 0

    def act(self, observation, info):
        self.count += 1
        return 4 if self.count % 7 else int(self.count % 3)


class Mute:
    def __init__(self, scenario):
        pass


class Cheater(Blind):
    track = "everything"


not_a_class = 3
