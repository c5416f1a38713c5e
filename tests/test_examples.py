"""The examples of docs/integrations.md train with the libraries that they are for, and what they train can be scored."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import uavbench.envs.env

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
EXTRA = "needs the extra: pip install -e '.[integrations]'"
ALONE, TEAM = "Block8-CPP-v0", "Manhattan32-CPP-Team-v0"


@pytest.mark.integrations
@pytest.mark.parametrize(
    ("name", "library", "scenario", "steps", "episodes", "least"),
    [
        ("sb3_ppo", "stable_baselines3", ALONE, 40_000, 200, 0.2),  # random has 0.15
        ("maskable_ppo", "sb3_contrib", ALONE, 40_000, 200, 0.2),
        ("sb3_validation", "stable_baselines3", ALONE, 5_000, 10, 0.0),
        ("torch_a2c", "array_api_compat", ALONE, 20_480, 10, 0.0),
        ("torchrl_gym", "torchrl", ALONE, 12_800, 10, 0.0),
        ("torchrl_ppo", "torchrl", TEAM, 2_000, 10, 0.0),
        ("rllib_ppo", "ray.rllib", TEAM, 2_000, 10, 0.0),
    ],
)
def test_an_example_trains_and_is_scored(name, library, scenario, steps, episodes, least, tmp_path):
    pytest.importorskip(library, reason=EXTRA, exc_type=ImportError)
    for path in EXAMPLES.glob("*.py"):
        shutil.copy(path, tmp_path)
    environment = {**os.environ, "RAY_AUTH_MODE": "disabled"}

    def python(*words):
        subprocess.run([sys.executable, *words], cwd=tmp_path, env=environment, check=True)

    python(f"{name}.py", "--scenario", scenario, "--steps", str(steps))
    chosen = ("--scenario", scenario, "--split", "validation", "--episodes", str(episodes))
    python("-c", "from uavbench.cli.app import app; app()", "evaluate", "--agent", f"{name}.py", *chosen)
    summary = json.loads((tmp_path / "results" / scenario / name / "summary.json").read_text())
    assert summary["episodes"] == episodes
    assert summary["track"] == "observation"
    assert summary["metrics"]["cral"]["mean"] >= least


@pytest.mark.integrations
def test_sb3_evaluates_on_every_validation_episode_once_and_logs_the_metrics():
    pytest.importorskip("stable_baselines3", reason=EXTRA)
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.monitor import Monitor

    flown = []

    class Kept(Monitor):
        def step(self, action):
            observation, reward, terminated, truncated, info = super().step(action)
            if "episode" in info:
                flown.append(info["episode"])
            return observation, reward, terminated, truncated, info

    keys = ("split", "episode_number", "landed", "cr", "cral", "blocked", "is_success")
    validation = gym.make(f"uavbench/{ALONE}", split="validation", order="cycle", max_episode_steps=4)
    train = Monitor(gym.make(f"uavbench/{ALONE}", max_episode_steps=4, success_cr=0.0), info_keywords=keys)
    model = PPO("MultiInputPolicy", train, n_steps=16, batch_size=16, n_epochs=1, seed=0)
    model.learn(64, EvalCallback(Kept(validation, info_keywords=keys), n_eval_episodes=200, eval_freq=32, verbose=0))
    numbers = [int(episode["episode_number"]) for episode in flown]
    assert numbers[:200] == list(range(200))
    assert sorted(numbers[200:]) == list(range(200))
    assert {int(episode["split"]) for episode in flown} == {1}
    assert 0 in {int(episode["landed"]) for episode in flown}  # truncated ones have their metrics too
    assert len(model.ep_success_buffer) > 0
    assert 0 < np.mean(model.ep_success_buffer) < 1


@pytest.mark.integrations
@pytest.mark.parametrize("mode", ["sync", "async", "vector_entry_point"])
def test_gymnasium_makes_tensors_of_all_that_vector_environments_return(mode):
    pytest.importorskip("array_api_compat", reason=EXTRA)
    import torch
    from gymnasium.wrappers.vector import NumpyToTorch

    envs = NumpyToTorch(gym.make_vec(f"uavbench:uavbench/{ALONE}", 2, vectorization_mode=mode))
    try:
        _, info = envs.reset(seed=0, options={"episode": 17, "noise": False})
        assert info["episode_number"].tolist() == [-1, -1]
        for _ in range(40):
            assert all(isinstance(value, torch.Tensor) for value in info.values())
            info = envs.step(torch.tensor([4, 5]))[-1]
    finally:
        envs.close()


@pytest.mark.integrations
@pytest.mark.parametrize("kind", ["several", "one", "native", "sync"])
def test_torchrl_registers_every_key_of_the_infos(kind):
    pytest.importorskip("torchrl", reason=EXTRA)
    import torch
    from torchrl.envs import GymEnv, GymWrapper

    name = f"uavbench:uavbench/{ALONE}"  # processes that are spawned import it too
    if kind == "several":
        env = GymEnv(name, num_envs=3)  # registers the info itself, as GymWrapper does
    elif kind == "one":
        env = GymEnv(name).auto_register_info_dict()
    else:
        how = {"native": {"autoreset_mode": "SameStep"}, "sync": {"vector_kwargs": {"autoreset_mode": "SameStep"}}}[kind]
        mode = {"native": "vector_entry_point", "sync": "sync"}[kind]
        env = GymWrapper(gym.make_vec(name, 3, vectorization_mode=mode, **how), categorical_action_encoding=True)
    try:
        torch.manual_seed(0)
        env.set_seed(0)
        data = env.rollout(200, break_when_any_done=False)
    finally:
        env.close()
    keys = set(uavbench.envs.env.UAVEnv(ALONE).reset()[1])
    assert keys <= set(data.keys()) & set(data["next"].keys())
    assert data["next", "done"].any()
    if kind == "several":  # TorchRL 0.14 makes them in a mode in which its own wrapper does not see what ends an episode
        return
    assert data["next", "landed"][data["next", "done"].squeeze(-1)].any()
    begun = data[..., 1:][data["next", "done"].squeeze(-1)[..., :-1]]  # an episode begins in a landing zone
    assert begun["action_mask"][:, 5].all()
    assert not begun["landed"].any()


def test_every_example_is_shown_and_tested():
    pages = "".join((EXAMPLES.parent / name).read_text(encoding="utf-8") for name in ("integrations.md", "clusters.md"))
    here, shards = Path(__file__), Path(__file__).parent / "evaluation" / "test_shards.py"
    for path in EXAMPLES.glob("*.py"):
        assert f"examples/{path.name}" in pages
        trained = f'("{path.stem}", ' in here.read_text(encoding="utf-8")
        assert trained or f'"{path.name}"' in shards.read_text(encoding="utf-8")
