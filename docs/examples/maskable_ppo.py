"""sb3-contrib on one UAV: MaskablePPO, which chooses only valid actions.

Train:  python maskable_ppo.py --scenario Block8-CPP-v0 --steps 200000
Score:  uavbench evaluate --agent maskable_ppo.py --scenario Block8-CPP-v0
"""

import argparse
from pathlib import Path

import numpy as np
from sb3_contrib import MaskablePPO
from sb3_ppo import SETTINGS, make_envs

import uavbench

WEIGHTS = Path(__file__).with_suffix(".zip")


class Agent:
    """The agent that ``uavbench evaluate`` scores: it takes the policy's most likely valid action."""

    def __init__(self, scenario: uavbench.Scenario):
        self.model = MaskablePPO.load(WEIGHTS, device="cpu")

    def act_batch(self, observations, infos):
        """Return an action for each running episode."""
        masks = np.stack([info["action_mask"] for info in infos])
        return self.model.predict(observations, action_masks=masks, deterministic=True)[0]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Block8-CPP-v0")
    parser.add_argument("--steps", type=int, default=200_000)
    options = parser.parse_args()
    # The environments have the method action_masks(), which MaskablePPO looks for, so they need no wrapper.
    model = MaskablePPO("MultiInputPolicy", make_envs(options.scenario), **SETTINGS)
    model.learn(options.steps)
    model.save(WEIGHTS)
