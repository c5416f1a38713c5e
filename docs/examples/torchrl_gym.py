"""TorchRL on one UAV: A2C on the native vector environment, with the masks and metrics of its infos.

Train:  python torchrl_gym.py --scenario Block8-CPP-v0 --steps 100000
Score:  uavbench evaluate --agent torchrl_gym.py --scenario Block8-CPP-v0
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch.distributions import Categorical
from torch_a2c import Net
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import A2CLoss, ValueEstimators

import uavbench

WEIGHTS = Path(__file__).with_suffix(".pt")
SEEN = ["local", "global", "budget", "action_mask"]


class Logits(Net):
    """The network's logits alone, for any batch shape."""

    def forward(self, *seen):
        """Return the logits, shape (..., 6)."""
        return _apply(super().forward, seen)[0].logits.unflatten(0, seen[2].shape[:-1])


class Value(Net):
    """The network's value alone, for any batch shape."""

    def forward(self, *seen):
        """Return the value, shape (..., 1)."""
        return _apply(super().forward, seen)[1].unflatten(0, seen[2].shape[:-1])[..., None]


def _apply(forward, seen):
    """Flatten the batch dimensions of the inputs to one, and apply ``forward``."""
    leading = seen[2].dim() - 1
    local, whole, budget, mask = (part.flatten(0, leading - 1) if leading > 1 else part for part in seen)
    return forward({"local": local, "global": whole, "budget": budget}, mask)


def make_env(scenario, num_envs=32):
    """Return the environments. The wrapper registers the infos' keys; it needs mode SameStep for infos of an episode's end."""
    envs = gym.make_vec(f"uavbench/{scenario}", num_envs, vectorization_mode="vector_entry_point", autoreset_mode="SameStep")
    return GymWrapper(envs, categorical_action_encoding=True)


def train(scenario, steps, batch=640):
    """Train for ``steps`` steps, and save the policy beside this file."""
    torch.manual_seed(0)
    loaded = uavbench.load_scenario(scenario)
    env = make_env(scenario)
    policy = ProbabilisticActor(
        TensorDictModule(Logits(loaded), in_keys=SEEN, out_keys=["logits"]),
        spec=env.full_action_spec,
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )
    critic = TensorDictModule(Value(loaded), in_keys=SEEN, out_keys=["state_value"])
    first = env.reset()
    policy(first), critic(first)  # initialises the lazy layers
    loss = A2CLoss(policy, critic, entropy_coeff=0.02)
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.97, lmbda=0.95)
    optimiser = torch.optim.Adam(loss.parameters(), lr=7e-4)
    flown = 0
    for data in Collector(env, policy, frames_per_batch=batch, total_frames=steps):
        data["next", "reward"].clamp_(min=-10.0)  # so that it learns to fly before it learns to land
        with torch.no_grad():
            loss.value_estimator(data)
        parts = loss(data)
        optimiser.zero_grad()
        sum(parts[name] for name in ("loss_objective", "loss_critic", "loss_entropy")).backward()
        torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
        optimiser.step()
        flown += data.numel()
        cral = data["next", "cral"][data["next", "done"].squeeze(-1)]
        print(f"{flown} steps, CRAL {100 * cral.mean():.1f} % of {len(cral)} episodes", flush=True)
        torch.save(policy.module[0].module.state_dict(), WEIGHTS)


class Agent:
    """The agent that ``uavbench evaluate`` scores: it takes the policy's most likely valid action."""

    def __init__(self, scenario: uavbench.Scenario):
        self.net = Logits(scenario)
        self.net.load_state_dict(torch.load(WEIGHTS, weights_only=True))

    @torch.no_grad()
    def act_batch(self, observations, infos):
        """Return an action for each running episode."""
        masks = torch.from_numpy(np.stack([info["action_mask"] for info in infos]))
        return self.net(*(torch.from_numpy(observations[name]) for name in SEEN[:3]), masks).argmax(1).numpy()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Block8-CPP-v0")
    parser.add_argument("--steps", type=int, default=100_000)
    options = parser.parse_args()
    train(options.scenario, options.steps)
