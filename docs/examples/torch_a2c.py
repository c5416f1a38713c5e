"""Plain PyTorch on one UAV: an actor-critic (A2C) on the native vector environment, through Gymnasium's NumpyToTorch.

Train:  python torch_a2c.py --scenario Block8-CPP-v0 --steps 400000
Score:  uavbench evaluate --agent torch_a2c.py --scenario Block8-CPP-v0
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers.vector import NumpyToTorch
from torch import nn
from torch.distributions import Categorical

import uavbench

WEIGHTS = Path(__file__).with_suffix(".pt")


class Net(nn.Module):
    """Two convolutions on each of the two maps, the budget, and two dense layers; a logit for each action, and a value."""

    def __init__(self, scenario, channels=16):
        super().__init__()
        most = torch.tensor([1.0, 1.0, 1.0, scenario.mission.largest_target])
        self.register_buffer("scale", most[:, None, None])
        self.budget = scenario.budget[1]
        self.near, self.far = (
            nn.Sequential(nn.Conv2d(4, channels, 3), nn.ReLU(), nn.Conv2d(channels, channels, 3), nn.ReLU(), nn.Flatten())
            for _ in range(2)
        )
        self.head = nn.Sequential(nn.LazyLinear(128), nn.ReLU(), nn.Linear(128, 7))

    def forward(self, observations, mask):
        """Return the policy over the valid actions, and the values, shape (batch,)."""
        near, far = self.near(observations["local"] / self.scale), self.far(observations["global"] / self.scale)
        out = self.head(torch.cat([near, far, observations["budget"] / self.budget], dim=1))
        return Categorical(logits=out[:, :6].masked_fill(mask == 0, -1e9)), out[:, 6]


def train(scenario, steps, num_envs=64, length=16, gamma=0.97):
    """Train for ``steps`` steps, and save the network beside this file."""
    torch.manual_seed(0)
    envs = NumpyToTorch(gym.make_vec(f"uavbench/{scenario}", num_envs, vectorization_mode="vector_entry_point"))
    net = Net(uavbench.load_scenario(scenario))
    observations, infos = envs.reset(seed=0)
    policy, value = net(observations, infos["action_mask"])
    optimiser = torch.optim.Adam(net.parameters(), lr=7e-4)
    over, cral = torch.zeros(num_envs, dtype=torch.bool), []
    for update in range(steps // (num_envs * length)):
        rollout = []
        for _ in range(length):
            action, resetting = policy.sample(), over  # the step after an episode's end resets, and ignores the action
            observations, reward, terminated, truncated, infos = envs.step(action)
            over = terminated | truncated
            cral += infos["cral"][over].tolist()
            reward = reward.float().clamp(min=-10.0)  # so that it learns to fly before it learns to land
            rollout.append((policy.log_prob(action), policy.entropy(), value, reward, over, ~resetting))
            policy, value = net(observations, infos["action_mask"])
        target, loss = value.detach(), 0.0
        for log_prob, entropy, before, reward, ended, counts in reversed(rollout):
            target = reward + gamma * target * ~ended
            gain = target - before
            loss = loss + (counts * (0.5 * gain**2 - gain.detach() * log_prob - 0.02 * entropy)).mean() / length
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 0.5)
        optimiser.step()
        policy, value = net(observations, infos["action_mask"])
        if update % 20 == 19 and cral:
            print(
                f"{(update + 1) * num_envs * length} steps, CRAL {100 * np.mean(cral):.1f} % of {len(cral)} episodes",
                flush=True,
            )
            cral.clear()
    torch.save(net.state_dict(), WEIGHTS)


class Agent:
    """The agent that ``uavbench evaluate`` scores: it takes the policy's most likely valid action."""

    def __init__(self, scenario: uavbench.Scenario):
        self.net = Net(scenario)
        self.net.load_state_dict(torch.load(WEIGHTS, weights_only=True))

    @torch.no_grad()
    def act_batch(self, observations, infos):
        """Return an action for each running episode."""
        masks = torch.from_numpy(np.stack([info["action_mask"] for info in infos]))
        return (
            self.net({name: torch.from_numpy(maps) for name, maps in observations.items()}, masks)[0].logits.argmax(1).numpy()
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Block8-CPP-v0")
    parser.add_argument("--steps", type=int, default=400_000)
    options = parser.parse_args()
    train(options.scenario, options.steps)
