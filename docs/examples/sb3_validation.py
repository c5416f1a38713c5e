"""Stable-Baselines3 with its EvalCallback: PPO, keeping the weights that scored best on the whole validation split.

Train:  python sb3_validation.py --scenario Block8-CPP-v0 --steps 200000
Score:  uavbench evaluate --agent sb3_validation.py --scenario Block8-CPP-v0
"""

import argparse
from pathlib import Path

import gymnasium as gym
from sb3_ppo import SETTINGS, make_envs
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor

import uavbench

FOLDER = Path(__file__).with_suffix("")


def make_validation(scenario):
    """Return one environment that goes through all validation episodes in order; Monitor writes the metrics of each."""
    env = gym.make(f"uavbench/{scenario}", split="validation", order="cycle")
    return Monitor(env, str(FOLDER / "validation"), info_keywords=("episode_number", "landed", "cr", "cral", "is_success"))


def train(scenario, steps, evaluations=4):
    """Train for ``steps`` steps, and evaluate the policy ``evaluations`` times in between."""
    envs = make_envs(scenario)
    callback = EvalCallback(
        make_validation(scenario),
        n_eval_episodes=uavbench.load_scenario(scenario).splits.validation.episodes,
        eval_freq=steps // evaluations // envs.num_envs,  # one call of it is a step of all environments
        best_model_save_path=str(FOLDER),
        deterministic=True,
    )
    PPO("MultiInputPolicy", envs, **SETTINGS).learn(steps, callback)


class Agent:
    """The agent that ``uavbench evaluate`` scores: it takes the most likely action of the best policy."""

    def __init__(self, scenario: uavbench.Scenario):
        self.model = PPO.load(FOLDER / "best_model.zip", device="cpu")

    def act_batch(self, observations, infos):
        """Return an action for each running episode."""
        return self.model.predict(observations, deterministic=True)[0]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Block8-CPP-v0")
    parser.add_argument("--steps", type=int, default=200_000)
    options = parser.parse_args()
    train(options.scenario, options.steps)
