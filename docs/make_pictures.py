"""Make the pictures of the README and the docs: greedy's flights, drawn by ``render_mode="rgb_array"``.

Usage: python docs/make_pictures.py
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

import uavbench
from uavbench.agent import find_agent
from uavbench.state_view import StateView

FLIGHTS = (("Manhattan32-CPP-v0", 17), ("Urban50-DH-v0", 17), ("Urban50-CPP-Team-v0", 13))


def fly(name, episode):
    """Fly a test episode with greedy; return the frames before and after, and what happened."""
    env = uavbench.parallel_env(name, render_mode="rgb_array")
    agent = find_agent("greedy").make(env.scenario)
    observations, infos = env.reset(options={"split": "test", "episode": episode})
    before, state = env.render(), env.simulator.state
    while env.agents:
        told = [{**infos[name], "state": StateView(env.simulator, 0, int(name[-1]))} for name in env.agents]
        actions = agent.act_team([observations[name] for name in env.agents], told)
        observations, _, _, _, infos = env.step(dict(zip(env.agents, actions, strict=True)))
    uavs = int(state.uavs[0])
    budget, left = state.initial_budget[0, :uavs].sum(), state.budget[0, :uavs].sum()
    cr = next(iter(infos.values()))["cr"]
    team = f", {uavs} UAVs" if env.scenario.team else ""
    return before, env.render(), f"{name} #{episode}{team}: {budget - left} of {budget} actions, CR {cr:.2f}"


def main():
    """Draw the figure."""
    figure, axes = plt.subplots(len(FLIGHTS), 2, figsize=(8, 4.2 * len(FLIGHTS)), layout="constrained")
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
