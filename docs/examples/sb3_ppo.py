"""Stable-Baselines3 on one UAV: PPO, with a feature extractor for the two maps.

Train:  python sb3_ppo.py --scenario Block8-CPP-v0 --steps 200000
Score:  uavbench evaluate --agent sb3_ppo.py --scenario Block8-CPP-v0
"""

import argparse
from pathlib import Path

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

import uavbench

WEIGHTS = Path(__file__).with_suffix(".zip")


class TwoMaps(BaseFeaturesExtractor):
    """Two convolutions on each of the two maps, as in the paper, and the budget."""

    def __init__(self, space, channels=16):
        shapes = {name: space[name].shape for name in ("local", "global")}
        cells = sum((rows - 4) * (cols - 4) for _, rows, cols in shapes.values())  # two 3×3 kernels, no padding
        super().__init__(space, features_dim=channels * cells + 1)
        self.max_data, self.max_budget = float(space["global"].high[3].max()), float(space["budget"].high[0])
        self.maps = nn.ModuleDict({name: self._convolutions(shape[0], channels) for name, shape in shapes.items()})

    def forward(self, observations):
        """Return the features, shape (batch, features_dim)."""
        scaled = {name: observations[name].clone() for name in self.maps}
        for layers in scaled.values():
            layers[:, 3] /= self.max_data  # the target layer, scaled to [0, 1] like the others
        features = [convolve(scaled[name]) for name, convolve in self.maps.items()]
        return torch.cat([*features, observations["budget"] / self.max_budget], dim=1)

    @staticmethod
    def _convolutions(layers, channels):
        return nn.Sequential(
            nn.Conv2d(layers, channels, 3), nn.ReLU(), nn.Conv2d(channels, channels, 3), nn.ReLU(), nn.Flatten()
        )


def make_envs(scenario, seed=0):
    """Return 16 environments with rewards clipped at −10, so that the agent learns to fly before it learns to land."""
    return make_vec_env(
        lambda: gym.wrappers.TransformReward(gym.make(f"uavbench/{scenario}"), lambda reward: max(reward, -10.0)),
        n_envs=16,
        seed=seed,
    )


#: Keyword arguments of PPO and MaskablePPO.
SETTINGS = {
    "n_steps": 128,
    "batch_size": 512,
    "n_epochs": 4,
    "gamma": 0.97,
    "ent_coef": 0.02,
    "policy_kwargs": {"features_extractor_class": TwoMaps, "net_arch": [128, 128]},
    "seed": 0,
    "verbose": 1,
}


class Agent:
    """The agent that ``uavbench evaluate`` scores: it takes the policy's most likely action."""

    def __init__(self, scenario: uavbench.Scenario):
        self.model = PPO.load(WEIGHTS, device="cpu")

    def act_batch(self, observations, infos):
        """Return an action for each running episode."""
        return self.model.predict(observations, deterministic=True)[0]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Block8-CPP-v0")
    parser.add_argument("--steps", type=int, default=200_000)
    options = parser.parse_args()
    model = PPO("MultiInputPolicy", make_envs(options.scenario), **SETTINGS)
    model.learn(options.steps)
    model.save(WEIGHTS)
