"""My agent.

Try it with:  uavbench check FILE  and then:  uavbench evaluate --agent FILE

The whole contract is docs/agents.md in the repository of uavbench.
"""

import numpy as np


class Agent:
    """Flies at random among the actions that have their effect: replace ``act`` by something better."""

    # "observation": decide by the observation alone. "state": info["state"] shows everything but the noise to come.
    track = "observation"

    def __init__(self, scenario):
        """Prepare for a scenario: an `uavbench.Scenario` with its map (``rows``), budgets, rewards and mission."""
        self.scenario = scenario

    def reset(self, info):
        """Begin an episode. Take randomness from ``info["seed"]``, so that your score can be reproduced."""
        self.random = np.random.default_rng(info["seed"])

    def act(self, observation, info):
        """Choose an action: 0 north, 1 east, 2 south, 3 west, 4 hover, 5 land.

        observation["local"]   (4, l, l) float32: landing, no_fly, building, target around the UAV, which is in the middle
        observation["global"]  (4, h, w) float32: the same layers of the whole centred map, averaged g×g
        observation["budget"]  (1,) float32: actions left; landed before it is 0, or crashed
        info["action_mask"]    (6,) int8: 1 where the action has its effect (not blocked; land only in a landing zone)

        In a team it is asked for each UAV, info["uav"], in turn; the maps have two layers more: other UAVs, their budgets.
        """
        return self.random.choice(np.flatnonzero(info["action_mask"]))
