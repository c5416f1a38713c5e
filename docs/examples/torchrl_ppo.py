"""TorchRL on a team: PPO with one policy for all UAVs, through TorchRL's PettingZoo wrapper.

Train:  python torchrl_ppo.py --scenario Manhattan32-CPP-Team-v0 --steps 100000
Score:  uavbench evaluate --agent torchrl_ppo.py --scenario Manhattan32-CPP-Team-v0
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import MarlGroupMapType
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.modules import MaskedCategorical, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, ValueEstimators

import uavbench

WEIGHTS = Path(__file__).with_suffix(".pt")
SEEN = [("agents", "observation", name) for name in ("local", "global", "budget")]


class TwoMaps(nn.Module):
    """Two convolutions on each of the two maps, the budget, and three dense layers; for any batch shape."""

    def __init__(self, scenario: uavbench.Scenario, outputs: int, channels: int = 16):
        super().__init__()
        budget = float(scenario.budget[1])
        layers = [1.0, 1.0, 1.0, scenario.mission.largest_target, 1.0, budget]
        self.register_buffer("scale", torch.tensor(layers)[:, None, None])
        self.register_buffer("budget", torch.tensor(budget))
        self.local, self.whole = (
            nn.Sequential(nn.Conv2d(6, channels, 3), nn.ReLU(), nn.Conv2d(channels, channels, 3), nn.ReLU(), nn.Flatten())
            for _ in range(2)
        )
        self.head = nn.Sequential(nn.LazyLinear(128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, outputs))

    def forward(self, local, whole, budget):
        """Return the outputs, shape (..., outputs)."""
        shape = budget.shape[:-1]
        features = [
            self.local(local.reshape(-1, *local.shape[-3:]) / self.scale),
            self.whole(whole.reshape(-1, *whole.shape[-3:]) / self.scale),
            budget.reshape(-1, 1) / self.budget,
        ]
        return self.head(torch.cat(features, dim=1)).reshape(*shape, -1)


def make_env(scenario: str) -> PettingZooWrapper:
    """Return the environment, always with three UAVs, because the wrapper needs every agent at every reset."""
    env = uavbench.parallel_env(scenario, num_uavs=3)
    return PettingZooWrapper(
        env, use_mask=True, done_on_any=False, categorical_actions=True, group_map=MarlGroupMapType.ALL_IN_ONE_GROUP
    )


def train(scenario: str, steps: int, batch: int = 2000, epochs: int = 4, minibatch: int = 512) -> None:
    """Train for ``steps`` steps of the team, and save the policy beside this file."""
    torch.manual_seed(0)
    env, loaded = make_env(scenario), uavbench.load_scenario(scenario)
    policy = ProbabilisticActor(
        TensorDictModule(TwoMaps(loaded, 6), in_keys=SEEN, out_keys=[("agents", "logits")]),
        spec=env.full_action_spec,
        in_keys={"logits": ("agents", "logits"), "mask": ("agents", "action_mask")},
        out_keys=[("agents", "action")],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
    )
    critic = TensorDictModule(TwoMaps(loaded, 1), in_keys=SEEN, out_keys=[("agents", "state_value")])
    first = env.reset()
    policy(first), critic(first)  # initialises the lazy layers
    loss = ClipPPOLoss(policy, critic, entropy_coeff=0.02, normalize_advantage=True)
    loss.set_keys(
        reward=("agents", "reward"),
        action=("agents", "action"),
        value=("agents", "state_value"),
        done=("agents", "done"),
        terminated=("agents", "terminated"),
        sample_log_prob=("agents", "action_log_prob"),
        advantage=("agents", "advantage"),
        value_target=("agents", "value_target"),
    )
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.97, lmbda=0.95)
    optimiser = torch.optim.Adam(loss.parameters(), lr=3e-4)
    started, flown = time.perf_counter(), 0
    for data in Collector(env, policy, frames_per_batch=batch, total_frames=steps):
        reward = data["next", "agents", "reward"]
        reward.clamp_(min=-10.0)  # so that it learns to fly before it learns to land
        with torch.no_grad():
            loss.value_estimator(data)
        acting = TensorDict({"agents": data["agents"][data["agents", "mask"]]})  # without UAVs that have finished
        acting.batch_size = acting["agents"].batch_size
        for _ in range(epochs):
            for rows in torch.randperm(len(acting)).split(minibatch):
                parts = loss(acting[rows])
                optimiser.zero_grad()
                sum(parts[name] for name in ("loss_objective", "loss_critic", "loss_entropy")).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()
        flown += data.numel()
        ended = data["next", "done"].squeeze(-1)
        cral = data["next", "agents", "info", "cral"][ended, 0]
        speed = flown / (time.perf_counter() - started)
        print(f"{flown} steps, {speed:.0f} steps/s, CRAL {100 * cral.mean():.1f} % of {len(cral)} episodes", flush=True)
        torch.save(policy.module[0].module.state_dict(), WEIGHTS)


class Agent:
    """The agent that ``uavbench evaluate`` scores: it takes the policy's most likely valid action."""

    def __init__(self, scenario: uavbench.Scenario):
        self.net = TwoMaps(scenario, 6)
        self.net.load_state_dict(torch.load(WEIGHTS, weights_only=True))

    @torch.no_grad()
    def act_batch(self, observations, infos):
        """Return an action for each UAV that still flies."""
        logits = self.net(*(torch.from_numpy(observations[name]) for name in ("local", "global", "budget"))).numpy()
        masks = np.stack([info["action_mask"] for info in infos]).astype(bool)
        return np.where(masks, logits, -np.inf).argmax(axis=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Manhattan32-CPP-Team-v0")
    parser.add_argument("--steps", type=int, default=100_000)
    options = parser.parse_args()
    train(options.scenario, options.steps)
