"""Score an agent on a SLURM cluster: one job for each shard, by submitit, and then the result of all of them.

Usage: python submitit_shards.py --agent my_agent.py --scenario Urban50-DH-v0 --shards 16

Needs submitit: pip install submitit. With --cluster local, the jobs are processes on this machine.
"""

import argparse
from pathlib import Path

import submitit

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.run import run_shard
from uavbench.evaluation.shards import merge, read_shard


def fly(agent, scenario, episodes, shard, out):
    """Fly one shard; return its folder. A job that is started again goes on where it was."""
    job = Job(find_agent(agent), load_scenario(scenario), "test")
    return run_shard(job, read_shard(shard, episodes), Path(out), resume=True)


def main():
    """Submit the jobs, wait for them, and print the score."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--agent", required=True)
    parser.add_argument("--scenario", required=True)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--shards", type=int, default=16)
    parser.add_argument("--out", default="results", help="a folder that all machines see")
    parser.add_argument("--cluster", default="slurm", choices=("slurm", "local"))
    options = parser.parse_args()
    executor = submitit.AutoExecutor(folder=f"{options.out}/jobs", cluster=options.cluster)
    executor.update_parameters(name="uavbench", timeout_min=60, cpus_per_task=1)
    shards = [f"{k}/{options.shards}" for k in range(1, options.shards + 1)]
    with executor.batch():
        jobs = [executor.submit(fly, options.agent, options.scenario, options.episodes, shard, options.out) for shard in shards]
    result = merge([job.result() for job in jobs], Path(options.out))
    print(f"CRAL {100 * result.metrics['cral'].mean:.1f} %; {result.folder}")


if __name__ == "__main__":
    main()
