"""My agent.

Try it with:  uavbench check FILE  and then:  uavbench evaluate --agent FILE

docs/agents.md in uavbench's repository describes the whole contract.
"""

import numpy as np


class Agent:
    """Takes random valid actions: replace ``act`` by something better."""

    # "observation": decide from the observation alone. "state": info["state"] shows everything except the noise to come.
    track = "observation"

    def __init__(self, scenario):
        """Prepare for a scenario, an `uavbench.Scenario`: ``rows`` (its map, if it has only one), budgets, rewards, mission."""
        self.scenario = scenario

    def reset(self, info):
        """Begin an episode. Take randomness from ``info["seed"]``, so that your score can be reproduced."""
        self.random = np.random.default_rng(info["seed"])

    def act(self, observation, info):
        """Choose an action: 0 north, 1 east, 2 south, 3 west, 4 hover, 5 land.

        observation["local"]   (4, l, l) float32: landing, no_fly, building, target around the UAV, whose cell is in the middle
        observation["global"]  (4, h, w) float32: the same layers of the whole centred map, as g×g means
        observation["budget"]  (1,) float32: actions left; a UAV that has not landed when it reaches 0 crashes
        info["action_mask"]    (6,) int8: 1 where the action is valid (not blocked; land only in a landing zone)

        In a team it is called for each UAV in turn, info["uav"]; the maps have two more layers: other UAVs, and their budgets.
        """
        return self.random.choice(np.flatnonzero(info["action_mask"]))
