"""What each part of `ppo` is worth: trainings of `ppo` from nothing on Manhattan32-CPP, each without one part, and `macro_ppo`.

Usage: python docs/reproduction/ablation.py [--updates 100] [--seeds 3] [--out runs/ablation] [--workers 2]

All trainings take as many updates, and so as many steps of episodes. After an interruption, the same command continues. Writes
``ablation.csv``, with the score of each validation, and ``ablation.png`` into the folder ``--out``.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import joblib
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import pandas as pd

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import training_record
from uavbench.learning.train import train
from uavbench.learning.training import Training

SCENARIO = "Manhattan32-CPP-v0"
#: The agent, its configuration, and what is changed in it.
VARIANTS = {
    "ppo": ("ppo", "fast", {}),
    "without the mask of safe actions": ("ppo", "fast", {"safe_mask": False}),
    "without symmetries": ("ppo", "fast", {"symmetries": False}),
    "with a constant discount of 0.95": ("ppo", "fast", {"last_discount": 0.95}),
    "without random starts": ("ppo", "fast", {"random_start_fraction": 0.0}),
    "without residual blocks": ("ppo", "fast", {"blocks": 0}),
    "in float32": ("ppo", "fast", {"half": False}),
    "macro_ppo, cells": ("macro_ppo", "fast", {}),
    "macro_ppo, directions": ("macro_ppo", "directions", {}),
}
VALIDATIONS = 10


def curve(variant, seed, updates, out):
    """Train once and return a row for each validation."""
    name, base, changed = VARIANTS[variant]
    source, number = find_agent(name), list(VARIANTS).index(variant)
    config = source.module().CONFIGS[base]
    # Each update has as many steps of episodes for all agents.
    steps = find_agent("ppo").module().CONFIGS["fast"]
    config = replace(config, updates=updates, validation=max(1, updates // VALIDATIONS), **changed)
    config = replace(config, steps=steps.num_envs * steps.steps // config.num_envs)
    training = Training(source, load_scenario(SCENARIO), f"variant{number}", config, seed)
    weights = train(training, out, resume=True)
    points = training_record(weights.with_suffix(".checkpoint"))["curve"]
    return [{"variant": variant, "seed": seed, **point} for point in points]


def draw(table, path):
    """Draw CRAL against the steps of episodes: the mean over the seeds, and the range."""
    figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for variant in VARIANTS:
        rows = table[table["variant"] == variant]
        if len(rows):
            by = rows.groupby("samples")["cral"]
            axis.plot(by.mean().index / 1e6, 100 * by.mean(), label=variant)
            axis.fill_between(by.mean().index / 1e6, 100 * by.min(), 100 * by.max(), alpha=0.15, linewidth=0)
    axis.set_xlabel("steps of episodes, millions")
    axis.set_ylabel("CRAL on 200 validation episodes, %")
    axis.legend(fontsize=8)
    figure.savefig(path, dpi=120)


def main():
    """Train, print a table, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--updates", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("runs/ablation"))
    parser.add_argument("--workers", type=int, default=1, help="trainings at the same time, each in its own process")
    options = parser.parse_args()
    wanted = [(variant, seed) for seed in range(options.seeds) for variant in VARIANTS]
    one, rows = joblib.delayed(curve), []
    options.out.mkdir(parents=True, exist_ok=True)
    for points in joblib.Parallel(n_jobs=options.workers, return_as="generator")(
        one(*each, options.updates, options.out) for each in wanted
    ):
        rows += points
        last = points[-1]
        print(
            f"{last['variant']}, seed {last['seed']}: CRAL {100 * last['cral']:.1f} in {last['seconds'] / 60:.1f} min",
            flush=True,
        )
        pd.DataFrame(rows).to_csv(options.out / "ablation.csv", index=False)
    table = pd.DataFrame(rows)
    last = table[table["updates"] == table["updates"].max()].groupby("variant", sort=False)
    print(
        last[["landed", "cr", "cral"]]
        .mean()
        .mul(100)
        .round(1)
        .join(last["cral"].agg(["min", "max"]).mul(100).round(1))
        .to_string()
    )
    draw(table, options.out / "ablation.png")


if __name__ == "__main__":
    main()
