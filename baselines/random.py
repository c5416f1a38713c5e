"""Random: any action that has its effect, each as likely. The floor of every table."""

import numpy as np


class Agent:
    """Chooses uniformly among the unmasked actions."""

    def __init__(self, scenario):
        self._generators = {}

    def reset(self, info):
        """Seed the episode's own generator: the score must not depend on what was flown before."""
        self._generators[info["episode"]] = np.random.default_rng(info["seed"])

    def act_batch(self, observations, infos):
        """Return an action for each running episode."""
        return np.array([self._choose(info) for info in infos])

    def _choose(self, info):
        allowed = np.flatnonzero(info["action_mask"])
        return allowed[int(self._generators[info["episode"]].random() * len(allowed))]
