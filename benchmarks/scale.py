"""What evaluations on many machines take: the numbers behind docs/scale.md.

Usage: python benchmarks/scale.py agents|driver|workers. Prints Markdown. Times of `agents` and `driver` are of the processor,
so that other work on the machine changes them little.

- ``agents``: how many episodes of a scenario each built-in agent flies in an hour of a core, and how large its result is.
- ``driver``: what the process that collects the records spends for an episode. Agents are simulated: a worker of a real cluster
  of Dask sleeps as long as an episode takes, and returns records as long as real ones.
- ``workers``: how much faster `greedy` flies 1,000 episodes with two worker processes. The first 200 episodes, in
  which the processes start, are left out.

`driver` needs the extra ``dask``, and learned agents the extra ``ddqn``.
"""

import argparse
import multiprocessing
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from uavbench import load_scenario
from uavbench.agents.agent import AgentLoadError, find_agent
from uavbench.evaluation import crew
from uavbench.evaluation.cluster import Cluster
from uavbench.evaluation.evaluate import AgentError, Job, evaluate
from uavbench.evaluation.run import run
from uavbench.world.resources import baseline_paths

SCENARIOS = ("Manhattan32-CPP-v0", "Manhattan32-DH-v0", "Urban50-CPP-v0", "Urban50-DH-v0")
HOUR = 3600.0


def agents(episodes):
    """Print the episodes per core-hour of each agent, and the kilobytes of 1,000 episodes in its result."""
    print(f"| agent | {' | '.join(SCENARIOS)} |\n| --- |{' ---: |' * len(SCENARIOS)}", flush=True)
    for name in baseline_paths():
        cells = []
        for scenario in map(load_scenario, SCENARIOS):
            try:
                job = Job(find_agent(name), scenario, "validation")
                list(evaluate(job, range(2)))  # compiles what it needs
                started = time.process_time()
                list(evaluate(job, range(episodes)))
                cells.append(f"{HOUR * episodes / (time.process_time() - started):,.0f}")
            except (AgentError, AgentLoadError):  # it does not fly there
                cells.append("")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        sizes = []
        for scenario in map(load_scenario, SCENARIOS):
            found = run(Job(find_agent("greedy"), scenario, "test"), 1000, Path(folder))
            sizes.append(f"{sum(path.stat().st_size for path in found.folder.iterdir()) / 1000:,.0f}")
    print(f"| kB of 1,000 episodes | {' | '.join(sizes)} |")


def cluster(processes, threads, pipe):
    """Run a scheduler, and workers in processes of their own, until the pipe is closed; send the address."""
    import distributed

    with distributed.LocalCluster(n_workers=processes, threads_per_worker=threads, dashboard_address="127.0.0.1:0") as started:
        pipe.send(started.scheduler_address)
        while pipe.poll(None):
            if pipe.recv() is None:
                return
            pipe.send(time.process_time())  # of the scheduler: workers have processes of their own


def simulated(record, seconds):
    """Return a function that stands for flying: it sleeps, and returns records like a real one."""

    def fly(_parcel, numbers):
        time.sleep(seconds * len(numbers))
        return [replace(record, episode=number) for number in numbers]

    return fly


def driver(seconds, cores, episodes):
    """Print what driver and scheduler spend for an episode, for some numbers of simulated cores."""
    scenario = load_scenario("Manhattan32-CPP-v0")
    job = Job(find_agent("greedy"), scenario, "train")
    (record,) = evaluate(Job(find_agent("greedy"), scenario, "test"), [0])
    fly = crew._fly
    crew._fly = simulated(record, seconds)
    print("| simulated cores | offered, episodes/s | reached | driver, ms/episode | scheduler, ms/episode |")
    print("| ---: | ---: | ---: | ---: | ---: |", flush=True)
    for count in cores:
        here, there = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(target=cluster, args=(2, count // 2, there))
        process.start()
        address = here.recv()
        for number in (100, episodes):  # the first is for connections
            here.send(0)
            scheduler, own, started = here.recv(), time.process_time(), time.perf_counter()
            with tempfile.TemporaryDirectory() as folder:
                run(job, number, Path(folder), workers=Cluster("dask", address))
            own, taken = time.process_time() - own, time.perf_counter() - started
            here.send(0)
            scheduler = here.recv() - scheduler
        row = f"{count} | {count / seconds:,.0f} | {episodes / taken:,.0f} | {1000 * own / episodes:.2f}"
        print(f"| {row} | {1000 * scheduler / episodes:.2f} |", flush=True)
        here.send(None)
        process.join()
    crew._fly = fly


def workers(episodes):
    """Print the seconds of the last four fifths of the episodes with one and with two workers, the best of three rounds."""
    job, best = Job(find_agent("greedy"), load_scenario("Manhattan32-CPP-v0"), "test"), {}
    for _ in range(3):
        for count in (1, 2):
            times = []
            with tempfile.TemporaryDirectory() as folder:
                run(
                    job,
                    episodes,
                    Path(folder),
                    workers=count,
                    on_record=lambda _, times=times: times.append(time.perf_counter()),
                )
            best[count] = min(best.get(count, float("inf")), times[-1] - times[episodes // 5])
    print("| workers | seconds |\n| ---: | ---: |")
    for count, taken in best.items():
        print(f"| {count} | {taken:.2f} |")
    print(f"\nratio {best[1] / best[2]:.2f}")


def main():
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("agents", "driver", "workers"))
    parser.add_argument("--episodes", type=int, help="by default 20 for agents, 5,000 for driver, 1,000 for workers")
    parser.add_argument("--seconds", type=float, default=0.014, help="of a simulated episode")
    parser.add_argument("--cores", type=int, nargs="+", default=[2, 8, 32, 128], help="simulated cores, even numbers")
    options = parser.parse_args()
    if options.what == "agents":
        agents(options.episodes or 20)
    elif options.what == "driver":
        driver(options.seconds, options.cores, options.episodes or 5_000)
    else:
        workers(options.episodes or 1_000)


if __name__ == "__main__":
    main()
