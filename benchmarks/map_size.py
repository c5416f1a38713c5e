"""How does the time of everything grow with the map? Generated cities of 64×64 to 512×512 cells, one simulator of each size.

Usage: python benchmarks/map_size.py [--rounds 5] [--envs 32] [--picture FILE.png]. Prints Markdown: the best of all rounds, and
the exponent e in time ∝ cells^e of a straight line through the logarithms. The global map has about 21×21 blocks at every size.
The memory is that of a process of its own, with Python and all libraries, which take about 185 MB.
Also measures how fast 256 environments of Cities32-CPP-v0, with a new city in every episode, are beside Manhattan32-CPP-v0.
"""

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import uavbench
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.world.cities import draw_city_cells
from uavbench.world.city_source import Cities

SIZES = (64, 128, 256, 512)
SMALL = (16, 32)  # first, so that everything is compiled when it is measured
BATCH = 256
STEPS = 100


def scenario(side, mission):
    """Return a scenario with generated cities of side×side cells."""
    like = uavbench.load_scenario("Manhattan32-CPP-v0" if mission == "coverage" else "Manhattan32-DH-v0")
    source = {"generator": "mixed-v0", "shape": (side, side), "validation": 4, "test": 20, "reach": 4 * side}
    parts = {name: getattr(like, name) for name in type(like).model_fields}
    sizes = {"local_size": 17, "global_scale": max(1, (2 * side - 1) // 21)}
    parts |= {"id": f"Size{side}-v0", "map": "", "rows": (), "splits": {}, "cities": Cities.model_validate(source)}
    return type(like).model_validate({**parts, "observation": sizes, "budget": (500, 1000)})


def seconds(function, repeats=1):
    """Return the wall time of one call in seconds, over so many calls."""
    started = time.perf_counter()
    for _ in range(repeats):
        function()
    return (time.perf_counter() - started) / repeats


def measured(side, mission, envs):
    """Return the times of one size in µs, in ms for loading."""
    world = scenario(side, mission)
    index = np.arange(envs)
    started = time.perf_counter()
    simulator, observer = Simulator(world, envs), Observer(world)
    simulator.reset(index[:1], "train", index[:1])
    load = time.perf_counter() - started
    found = {"load, first reset included, ms": 1e3 * load}
    keys = np.arange(4, dtype=np.uint64)
    found["city, µs"] = 1e6 * seconds(lambda: draw_city_cells(world.cities, keys)) / len(keys)
    found["reset in a new city, µs"] = 1e6 * seconds(lambda: simulator.reset(index, "train", index)) / envs
    actions = np.random.default_rng(0).integers(0, 5, (20, envs))
    rows = iter(np.concatenate([actions] * 100))
    seconds(lambda: simulator.step(next(rows)), STEPS)  # at first, a new map is not in the processor's caches
    found["step, µs"] = 1e6 * seconds(lambda: simulator.step(next(rows)), STEPS) / envs
    shown = observer.empty(envs)

    def step():
        simulator.step(next(rows))
        observer.write(simulator.state, index, shown)

    found["step with observation, µs"] = 1e6 * seconds(step, STEPS) / envs
    return found


def largest_memory():
    """Return the largest memory that this process has had, in MB."""
    status = Path("/proc/self/status")
    if status.exists():  # Linux counts the memory of the process that started this one in ru_maxrss, too
        return int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def memory(side, mission, envs):
    """Return the memory in MB of a process that loads one size, resets and steps it; of one environment, and of ``envs``."""
    words = [sys.executable, __file__, "--memory", str(side), mission]
    return [float(subprocess.run([*words, str(n)], capture_output=True, check=True, text=True).stdout) for n in (1, envs)]


def exponent(sizes, times):
    """Return e of the line log time = e · log cells + constant."""
    return float(np.polyfit(2 * np.log(sizes), np.log(times), 1)[0])


def batch(name):
    """Return a vector environment, and a function that steps it 60 times with random actions."""
    envs = uavbench.make_vec(name, BATCH)
    envs.reset(seed=0)
    random = np.random.default_rng(0)
    return lambda: [envs.step(random.integers(0, 5, BATCH)) for _ in range(60)]


def against_one_map(rounds):
    """Print how fast cities are beside one map."""
    names = ("Manhattan32-CPP-v0", "Cities32-CPP-v0")
    batches, best = [batch(name) for name in names], [np.inf, np.inf]
    for _ in range(20 * rounds):
        best = [min(old, seconds(step)) for old, step in zip(best, batches, strict=True)]
    print("\n| 256 environments, resets included | µs/step | ratio |\n| --- | ---: | ---: |")
    for name, time_of in zip(names, best, strict=True):
        print(f"| {name} | {1e6 * time_of / 60 / BATCH:.2f} | {best[0] / time_of:.2f} |")
    world = uavbench.load_scenario("Cities32-CPP-v0")
    simulator, index = Simulator(world, BATCH), np.arange(BATCH)
    numbers = iter(np.arange(10 * BATCH).reshape(10, BATCH))
    one = min(seconds(lambda: simulator.reset(index, "train", next(numbers))) for _ in range(10)) / BATCH
    print(f"\nA reset of Cities32-CPP-v0 in a new city, with all that follows from it: {1e6 * one:.0f} µs.")


def draw(path, results):
    """Draw the times against the number of cells."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for ax, (mission, table) in zip(axes, results.items(), strict=True):
        for name, times in table.items():
            scale = 1e3 if name.endswith("ms") else 1
            ax.loglog([side**2 for side in SIZES], [scale * each for each in times], "o-", label=name.replace("ms", "µs"))
        ax.set(title=mission, xlabel="cells", ylabel="µs")
        ax.grid(alpha=0.3)
    axes[1].legend(fontsize=7)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main():
    """Measure, and print a table for each mission."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=5, help="rounds, of which the best counts (default: 5)")
    parser.add_argument("--envs", type=int, default=32, help="environments of each simulator (default: 32)")
    parser.add_argument("--picture", help="a PNG file to draw")
    parser.add_argument("--memory", nargs=3, metavar=("SIDE", "MISSION", "ENVS"), help="only print the memory of one case")
    wanted = parser.parse_args()
    if wanted.memory:
        measured(int(wanted.memory[0]), wanted.memory[1], int(wanted.memory[2]))
        print(largest_memory())
        return
    results = {}
    for mission in ("coverage", "harvesting"):
        for side in SMALL:
            measured(side, mission, 2)
        tables = [[measured(side, mission, wanted.envs) for side in SIZES] for _ in range(wanted.rounds)]
        results[mission] = {name: [min(table[k][name] for table in tables) for k in range(len(SIZES))] for name in tables[0][0]}
        print(f"\n| {mission}, {wanted.envs} environments | {' | '.join(map(str, SIZES))} | exponent |")
        print(f"| --- |{' ---: |' * (len(SIZES) + 1)}")
        for name, times in results[mission].items():
            print(f"| {name} | {' | '.join(f'{each:.3g}' for each in times)} | {exponent(SIZES, times):.2f} |")
        for number, row in zip(
            (1, wanted.envs), zip(*(memory(side, mission, wanted.envs) for side in SIZES), strict=True), strict=True
        ):
            print(f"| memory with {number} environments, MB | {' | '.join(f'{each:.0f}' for each in row)} | |")
    if wanted.picture:
        draw(wanted.picture, results)
    against_one_map(wanted.rounds)


if __name__ == "__main__":
    main()
