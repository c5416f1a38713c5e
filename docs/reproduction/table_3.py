"""The paper's table III: Landed, CR and CRAL of the reference DDQN on the 1,000 test episodes, beside the published numbers.

Usage: python docs/reproduction/table_3.py [--agent ddqn] [--out results] [--workers 2]. Episodes that already have results in
the folder are not flown again.
"""

import argparse
from pathlib import Path

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.run import run

#: The paper's Landed, CR and CRAL, in %.
PUBLISHED = {
    "Manhattan32-CPP-v0": (98.5, 71.0, 70.3),
    "Manhattan32-DH-v0": (98.2, 83.6, 82.5),
    "Urban50-CPP-v0": (98.1, 81.5, 80.1),
    "Urban50-DH-v0": (99.5, 74.5, 74.2),
}


def main():
    """Score the agent and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agent", default="ddqn")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    print("In %; the paper's are means of its own 1,000 episodes, ours have 95 % confidence intervals.\n")
    print("| scenario | metric | the paper | ours | difference |\n| --- | --- | ---: | ---: | ---: |")
    for name, published in PUBLISHED.items():
        job = Job(find_agent(options.agent), load_scenario(name), "test")
        metrics = run(job, 1000, options.out, workers=options.workers, resume=True).metrics
        for (metric, interval), theirs in zip(metrics.items(), published, strict=True):
            mean, low, high = (100 * each for each in (interval.mean, interval.low, interval.high))
            label = {"landed": "Landed"}.get(metric, metric.upper())
            print(f"| {name} | {label} | {theirs} | {mean:.1f} [{low:.1f}, {high:.1f}] | {mean - theirs:+.1f} |", flush=True)


if __name__ == "__main__":
    main()
