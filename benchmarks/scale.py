"""What evaluations on many machines take: the numbers behind docs/scale.md.

Usage: python benchmarks/scale.py agents|driver|shards|merge|workers. Prints Markdown. Except for those of `workers`, times are
of the processor, so that other work on the machine changes them little.

- ``agents``: how many episodes of a scenario each built-in agent flies in an hour of a core, and how large its result is.
- ``driver``: what the process that collects the records spends for an episode. Agents are simulated: a worker of a real cluster
  of Dask sleeps as long as an episode takes, and returns records as long as real ones.
- ``shards``: the same for shards, each of which has a driver of its own: all at once, as threads of two processes, into one
  folder.
- ``merge``: what `uavbench merge` takes for an episode of four real shards of `greedy`.
- ``workers``: how much faster `greedy` flies 1,000 episodes with two worker processes. The first 200 episodes, in
  which the processes start, are left out.

`driver` needs the extra ``dask``, and learned agents the extra ``ddqn``.
"""

import argparse
import multiprocessing
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from uavbench import load_scenario
from uavbench.agents.agent import AgentLoadError, find_agent
from uavbench.evaluation import crew
from uavbench.evaluation import run as runs
from uavbench.evaluation.cluster import Cluster
from uavbench.evaluation.evaluate import AgentError, Job, evaluate
from uavbench.evaluation.run import run, run_shard
from uavbench.evaluation.shards import Shard, merge
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
    """Return a function that stands for flying: it sleeps, and yields records like a real one."""

    def fly(_parcel, numbers):
        for number in numbers:
            time.sleep(seconds)
            yield replace(record, episode=number)

    return fly


def now():
    """Return the clock, and the seconds that this process has had of its processor."""
    return time.perf_counter(), time.process_time()


def driver(seconds, cores, episodes):
    """Print what driver and scheduler spend for an episode, for some numbers of simulated cores."""
    scenario = load_scenario("Manhattan32-CPP-v0")
    job = Job(find_agent("greedy"), scenario, "train")
    (record,) = evaluate(Job(find_agent("greedy"), scenario, "test"), [0])
    fly = crew._fly
    crew._fly = simulated(record, seconds)
    columns = "simulated cores|offered, episodes/s|reached in the first half|in all|driver, ms|scheduler, ms|result, ms"
    print(f"| {columns.replace('|', ' | ')} |\n|{' ---: |' * 7}", flush=True)
    for count in cores:
        here, there = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(target=cluster, args=(2, count // 2, there))
        process.start()
        address = here.recv()
        for number in (100, episodes):  # the first is for connections
            here.send(0)
            scheduler, clocks = here.recv(), [now()]
            with tempfile.TemporaryDirectory() as folder:
                run(
                    job,
                    number,
                    Path(folder),
                    workers=Cluster("dask", address),
                    on_record=lambda _, clocks=clocks: clocks.append(now()),
                )
            clocks.append(now())
            here.send(0)
            scheduler = here.recv() - scheduler
        (before, own), (half, _), (after, spent), (_, end) = (clocks[k] for k in (0, episodes // 2, -2, -1))
        row = f"{count} | {count / seconds:,.0f} | {episodes // 2 / (half - before):,.0f} | {episodes / (after - before):,.0f}"
        row += "".join(f" | {1000 * taken / episodes:.2f}" for taken in (spent - own, scheduler, end - spent))
        print(f"| {row} |", flush=True)
        here.send(None)
        process.join()
    crew._fly = fly


def fly_shards(parts, seconds, out, pipe):
    """Fly simulated shards, each in a thread of its own; send how many seconds of the processor that took."""
    job = Job(find_agent("greedy"), load_scenario("Manhattan32-CPP-v0"), "train")
    (record,) = evaluate(job, [0])
    runs.evaluate_with = lambda _, job, numbers: simulated(record, seconds)(job, numbers)
    pipe.send("ready")
    pipe.recv()
    started = time.process_time()
    with ThreadPoolExecutor(len(parts)) as pool:
        list(pool.map(lambda part: run_shard(job, part, out), parts))
    pipe.send(time.process_time() - started)


def shards(seconds, cores, episodes):
    """Print what the drivers of shards spend for an episode, for some numbers of shards at the same time."""
    print("| shards at once | offered, episodes/s | reached | drivers, ms/episode |\n| ---: | ---: | ---: | ---: |", flush=True)
    for count in cores:
        parts, started = [Shard(k + 1, count, count * episodes) for k in range(count)], []
        with tempfile.TemporaryDirectory() as folder:
            for own in (parts[::2], parts[1::2]):
                here, there = multiprocessing.Pipe()
                told = (own, seconds, Path(folder), there)
                process = multiprocessing.get_context("spawn").Process(target=fly_shards, args=told)
                process.start()
                started.append((here, process))
            for here, _ in started:
                here.recv()
            before = time.perf_counter()
            for here, _ in started:
                here.send("go")
            spent = sum(here.recv() for here, _ in started)
            taken = time.perf_counter() - before
            for _, process in started:
                process.join()
        row = f"{count} | {count / seconds:,.0f} | {count * episodes / taken:,.0f} | {1000 * spent / (count * episodes):.3f}"
        print(f"| {row} |", flush=True)


def merging(episodes):
    """Print what merging takes for an episode."""
    for scenario in map(load_scenario, SCENARIOS):
        job = Job(find_agent("greedy"), scenario, "train")
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder)
            folders = [run_shard(job, Shard(k, 4, episodes), out, workers=2) for k in range(1, 5)]
            started = time.process_time()
            merge(folders, out)
            print(f"| {scenario.id} | {1000 * (time.process_time() - started) / episodes:.2f} ms/episode |", flush=True)


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
    parser.add_argument("what", choices=("agents", "driver", "shards", "merge", "workers"))
    parser.add_argument(
        "--episodes",
        type=int,
        help="by default 20 for agents, 5,000 for driver and merge, 1,000 for workers, and 2,000 of each shard",
    )
    parser.add_argument("--seconds", type=float, default=0.014, help="of a simulated episode")
    parser.add_argument("--cores", type=int, nargs="+", default=[2, 8, 32, 128], help="simulated cores, even numbers")
    options = parser.parse_args()
    if options.what == "agents":
        agents(options.episodes or 20)
    elif options.what == "driver":
        driver(options.seconds, options.cores, options.episodes or 5_000)
    elif options.what == "shards":
        shards(options.seconds, options.cores, options.episodes or 2_000)
    elif options.what == "merge":
        merging(options.episodes or 5_000)
    else:
        workers(options.episodes or 1_000)


if __name__ == "__main__":
    main()
