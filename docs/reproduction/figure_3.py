"""The paper's figure 3: scores of agents for several sizes l of the local map and scales g of the global map.

Usage: python docs/reproduction/figure_3.py [--updates 3000] [--out runs/figure_3] [--workers 2] [--again]

For each of the paper's 16 pairs of sizes, and without the scheme (l = 0, g = 1), a network is trained on each ``-Long-v0``
scenario of Manhattan32, by the configuration ``fast`` with fewer updates (``--updates``), and scored on 200 test episodes.
Trainings write checkpoints: after an interruption, the same command continues. Scores that are in ``figure_3.csv`` beside this
file with as many updates are taken from there, unless ``--again`` is given. Writes ``figure_3.csv`` and ``figure_3.png`` into
the folder ``--out``.
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
from uavbench.learning.train import train
from uavbench.learning.training import Training
from uavbench.simulation.observation import Observer

SCENARIOS = ("Manhattan32-CPP-Long-v0", "Manhattan32-DH-Long-v0")
LOCALS, SCALES = (9, 17, 25, 33), (2, 3, 5, 7)
WITHOUT = (0, 1)  # the sizes that turn the scheme off
EPISODES = 200
KNOWN = Path(__file__).with_suffix(".csv")


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


def flatten_size(name, local_size, global_scale):
    """Return the number of inputs of the first dense layer, the paper's N (Table IV)."""
    return find_agent("ddqn").module().Network(Observer(load_scenario(name).with_observation(local_size, global_scale))).inputs


def draw(table, path):
    """Draw CRAL against the size of the flatten layer, as the paper does: a line for each l, and a star without the scheme."""
    figure, axes = plt.subplots(1, len(SCENARIOS), figsize=(9, 3.6), sharey=True, layout="constrained")
    for axis, name in zip(axes, SCENARIOS, strict=True):
        there = table[table["scenario"] == name]
        sizes = [flatten_size(name, *pair) for pair in zip(there["l"], there["g"], strict=True)]
        for size, rows in there.assign(size=sizes).sort_values("size").groupby("l"):
            label = f"l = {size}" if size else "without the scheme"
            axis.plot(rows["size"], 100 * rows["cral"], "*k" if size == 0 else "o-", ms=10 if size == 0 else 5, label=label)
            for _, row in rows.iterrows():
                if size:
                    at = (row["size"], 100 * row["cral"])
                    axis.annotate(f"{row['g']}", at, xytext=(4, 4), textcoords="offset points", fontsize=7)
        axis.set_xscale("log")
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("inputs of the first dense layer (small numbers: g)")
    axes[0].set_ylabel("CRAL, %")
    axes[0].legend(fontsize=8)
    figure.savefig(path, dpi=120)


def known_rows(updates):
    """Return the scores that were measured before with as many updates."""
    table = pd.read_csv(KNOWN) if KNOWN.exists() else pd.DataFrame(columns=["updates"])
    return table[table["updates"] == updates].to_dict("records")


def main():
    """Train, score and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--updates", type=int, default=3000)
    parser.add_argument("--out", type=Path, default=Path("runs/figure_3"))
    parser.add_argument("--workers", type=int, default=1, help="trainings at the same time, each in its own process")
    parser.add_argument("--again", action="store_true", help="train again what has been measured before")
    options = parser.parse_args()
    pairs = [*((size, scale) for size in LOCALS for scale in SCALES), WITHOUT]
    wanted = [(name, *pair) for name in SCENARIOS for pair in pairs]
    rows = [] if options.again else known_rows(options.updates)
    missing = [each for each in wanted if each not in {(row["scenario"], row["l"], row["g"]) for row in rows}]
    missing.sort(key=lambda each: flatten_size(*each))  # the fast ones first
    one = joblib.delayed(point)
    options.out.mkdir(parents=True, exist_ok=True)
    for row in joblib.Parallel(n_jobs=options.workers, return_as="generator")(
        one(*each, options.updates, options.out) for each in missing
    ):
        rows.append(row)
        print(
            " ".join(f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()),
            flush=True,
        )
        pd.DataFrame(rows).to_csv(options.out / "figure_3.csv", index=False)  # what is there is kept if this is interrupted
    table = pd.DataFrame(sorted(rows, key=lambda row: wanted.index((row["scenario"], row["l"], row["g"]))))
    table.to_csv(options.out / "figure_3.csv", index=False)
    draw(table, options.out / "figure_3.png")


if __name__ == "__main__":
    main()
