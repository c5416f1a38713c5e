"""RLlib on a team: PPO with one policy for all UAVs, through RLlib's PettingZoo wrapper.

Train:  python rllib_ppo.py --scenario Manhattan32-CPP-Team-v0 --steps 100000
Score:  uavbench evaluate --agent rllib_ppo.py --scenario Manhattan32-CPP-Team-v0
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.rl_module import RLModule
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

import uavbench

WEIGHTS = Path(__file__).resolve().with_suffix("")


def make_env(config):
    """Return the environment: flat vectors for RLlib's networks, always three UAVs since its wrapper needs a fixed number."""
    return ParallelPettingZooEnv(uavbench.parallel_env(config["scenario"], num_uavs=3, flat=True))


def train(scenario, steps, batch=4000):
    """Train until UAV 0 has taken ``steps`` steps, and save the policy beside this file."""
    register_env("uavbench", make_env)
    config = (
        PPOConfig()
        .environment("uavbench", env_config={"scenario": scenario})
        .env_runners(num_env_runners=1, sample_timeout_s=600)  # a busy machine may be slow
        .multi_agent(policies={"uav"}, policy_mapping_fn=lambda agent, episode, **more: "uav")
        .training(train_batch_size_per_learner=batch, num_epochs=4, gamma=0.97, entropy_coeff=0.02)
        .rl_module(model_config={"fcnet_hiddens": [256, 256]})
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    flown = 0
    while flown < steps:
        result = algorithm.train()["env_runners"]
        flown = int(result["num_agent_steps_sampled_lifetime"]["uav_0"])
        print(f"{flown} steps, mean return {result['episode_return_mean']:.1f}", flush=True)
    algorithm.get_module("uav").save_to_path(WEIGHTS)
    algorithm.stop()


class Agent:
    """The agent that ``uavbench evaluate`` scores: it takes the policy's most likely valid action."""

    def __init__(self, scenario: uavbench.Scenario):
        self.module = RLModule.from_checkpoint(WEIGHTS)
        self.space = uavbench.parallel_env(scenario).observation_space("uav_0")

    @torch.no_grad()
    def act_batch(self, observations, infos):
        """Return an action for each UAV that still flies."""
        rows = [{name: values[k] for name, values in observations.items()} for k in range(len(infos))]
        flat = torch.from_numpy(np.stack([spaces.flatten(self.space, row) for row in rows]))
        logits = self.module.forward_inference({"obs": flat})["action_dist_inputs"].numpy()
        masks = np.stack([info["action_mask"] for info in infos]).astype(bool)
        return np.where(masks, logits, -np.inf).argmax(axis=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Manhattan32-CPP-Team-v0")
    parser.add_argument("--steps", type=int, default=100_000)
    options = parser.parse_args()
    train(options.scenario, options.steps)
