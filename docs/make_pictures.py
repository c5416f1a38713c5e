"""Make the pictures of the README and the docs: greedy's flights, drawn by ``render_mode="rgb_array"``.

Usage: python docs/make_pictures.py
"""

from pathlib import Path

import gymnasium as gym
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

import uavbench  # noqa: F401  (registers the ids)
from uavbench.agent import find_agent
from uavbench.state_view import StateView

FLIGHTS = (("Manhattan32-CPP-v0", 17), ("Urban50-DH-v0", 17))


def fly(name, episode):
    """Fly a test episode with greedy; return the frames before and after, and what happened."""
    env = gym.make(f"uavbench/{name}", render_mode="rgb_array").unwrapped
    agent = find_agent("greedy").make(env.scenario)
    observation, info = env.reset(options={"split": "test", "episode": episode})
    before, terminated = env.render(), False
    state = StateView(env.simulator, 0)
    while not terminated:
        observation, _, terminated, _, info = env.step(agent.act(observation, {**info, "state": state}))
    steps = env.simulator.state.initial_budget[0, 0] - env.simulator.state.budget[0, 0]
    budget = env.simulator.state.initial_budget[0]
    return before, env.render(), f"{name}, test episode {episode}: {steps} of {budget} actions, CR {info['cr']:.2f}"


def main():
    """Draw the figure."""
    figure, axes = plt.subplots(2, 2, figsize=(8, 8.4), layout="constrained")
    for row, flight in zip(axes, FLIGHTS, strict=True):
        *frames, title = fly(*flight)
        for axis, frame, name in zip(row, frames, ("start", title), strict=True):
            axis.imshow(frame)
            axis.set_title(name, fontsize=8)
            axis.axis("off")
    path = Path(__file__).parent / "images" / "greedy.png"
    figure.savefig(path, dpi=100)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
