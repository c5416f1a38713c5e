"""The paper's figure 3: scores of agents for several sizes l of the local map and scales g of the global map.

Usage: python docs/reproduction/figure_3.py [--updates 3000] [--out runs/figure_3] [--workers 2]

For each pair of sizes, a network is trained on each ``-Long-v0`` scenario of Manhattan32, by the configuration ``fast`` with
fewer updates (``--updates``), and scored on 200 test episodes. Trainings write checkpoints: after an interruption, the same
command continues. Writes ``figure_3.csv`` and ``figure_3.png`` into the folder ``--out``.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import joblib
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.metrics import METRICS
from uavbench.learning.train import Training, train

SCENARIOS = ("Manhattan32-CPP-Long-v0", "Manhattan32-DH-Long-v0")
LOCALS, SCALES = (9, 17, 25), (3, 5, 7)
EPISODES = 200


def point(name, local_size, global_scale, updates, out):
    """Train one network and return its scores."""
    scenario = load_scenario(name).with_observation(local_size, global_scale)
    source = find_agent("ddqn")
    config = replace(source.module().CONFIGS["fast"], updates=updates, validation=max(1, updates // 6))
    folder = out / f"l{local_size}-g{global_scale}"
    training = Training(source, scenario, "fast", config, seed=0)
    weights = train(training, folder, resume=True)
    records = list(evaluate(Job(replace(source, weights=weights), scenario, "test"), range(EPISODES)))
    scores = {metric: float(np.mean([getattr(record, metric) for record in records])) for metric in METRICS}
    return {"scenario": name, "l": local_size, "g": global_scale, "updates": updates, **scores}


def draw(table, path):
    """Draw CRAL against l, with a line for each g."""
    figure, axes = plt.subplots(1, len(SCENARIOS), figsize=(8, 3.2), sharey=True, layout="constrained")
    for axis, name in zip(axes, SCENARIOS, strict=True):
        for scale, rows in table[table["scenario"] == name].groupby("g"):
            axis.plot(rows["l"], 100 * rows["cral"], marker="o", label=f"g = {scale}")
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("local map size l")
        axis.set_xticks(LOCALS)
    axes[0].set_ylabel("CRAL, %")
    axes[0].legend()
    figure.savefig(path, dpi=120)


def main():
    """Train, score and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--updates", type=int, default=3000)
    parser.add_argument("--out", type=Path, default=Path("runs/figure_3"))
    parser.add_argument("--workers", type=int, default=1, help="trainings at the same time, each in its own process")
    options = parser.parse_args()
    sizes = [(name, size, scale) for name in SCENARIOS for size in LOCALS for scale in SCALES]
    one = joblib.delayed(point)
    points = joblib.Parallel(n_jobs=options.workers, return_as="generator")(
        one(*size, options.updates, options.out) for size in sizes
    )
    rows = []
    for row in points:
        rows.append(row)
        print(
            " ".join(f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()),
            flush=True,
        )
    options.out.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(rows)
    table.to_csv(options.out / "figure_3.csv", index=False)
    draw(table, options.out / "figure_3.png")


if __name__ == "__main__":
    main()
