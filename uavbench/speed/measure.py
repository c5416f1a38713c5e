"""Measuring the suite's steps per second on this machine, beside the time that copying the same observations takes.

Every round measures everything once, one after the other, and the best round of each counts, so that other load on the machine
affects all measurements alike.
"""

import os
import platform
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uavbench.envs.env import UAVEnv
from uavbench.envs.vector_env import UAVVectorEnv
from uavbench.errors import UavbenchError
from uavbench.simulation.simulator import Simulator
from uavbench.speed.peers import installed_peers
from uavbench.world.scenario import Scenario

#: The scenarios that are measured by default: each mission on each of the paper's maps.
SCENARIOS = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0")
#: Numbers of environments in one vector environment.
BATCHES = (1, 16, 256, 1024)

_STEPS = 8192  # steps of all environments together in one round
_MIN_STEPS = 4  # but at least so many steps of the whole batch
_ACTIONS = 5  # all except land, by which most episodes would end at their start


class SpeedError(UavbenchError):
    """A speed cannot be measured; the message says why."""


@dataclass(frozen=True)
class Speed:
    """One line of the table.

    Attributes
    ----------
    task : str
        The scenario, or the environment of a peer (`uavbench.speed.peers`).
    interface : str
        What was stepped: ``"Env"``, ``"VectorEnv"``, ``"Simulator"`` (no observations), or a peer's.
    environments, threads : int
        Number of environments, and of threads that stepped them.
    microseconds : float
        Time of one step of one environment, including resets (except for ``"Env"``).
    bytes : int
        Size of the observation of one environment; 0 without observations.
    copying : float
        Time that copying these bytes took in the same run, in microseconds; 0 where it is not measured.
    """

    task: str
    interface: str
    environments: int
    threads: int
    microseconds: float
    bytes: int = 0
    copying: float = 0.0

    @property
    def steps_per_second(self) -> float:
        """Steps per second, of all environments together."""
        return 1e6 / self.microseconds


def prepare(
    scenarios: Sequence[Scenario], *, peers: bool = True, on_failure: Callable[[str], None] = lambda _: None
) -> "list[Measurement]":
    """Make everything that is to be measured: the environments of scenarios, and the peers that are installed.

    Parameters
    ----------
    scenarios : sequence of Scenario
        Scenarios for one UAV.
    peers : bool
        Whether other suites are measured too, where they are installed.
    on_failure : callable, optional
        Called with one line about each peer that is installed but cannot be measured.

    Raises
    ------
    SpeedError
        When a scenario is for a team.
    """
    for scenario in scenarios:
        if scenario.team:
            raise SpeedError(f"{scenario.id} is for a team: benchmarks/throughput.py measures teams")
    everything = [each for scenario in scenarios for each in _of(scenario)]
    return everything + ([_Peer(peer) for peer in installed_peers(on_failure)] if peers else [])


def measure(
    everything: "Sequence[Measurement]", rounds: int, on_round: Callable[[object], None] = lambda _: None
) -> list[Speed]:
    """Measure everything in ``rounds`` rounds, call ``on_round`` after each round, and return the best measurements."""
    for _ in range(rounds):
        for each in everything:
            each.measure()
        on_round(None)
    return [each.speed() for each in everything]


def report(speeds: Iterable[Speed]) -> dict[str, Any]:
    """Return measurements with the machine and the versions on which they were taken, ready for JSON."""
    import numba

    import uavbench

    versions = {"uavbench": uavbench.__version__, "python": platform.python_version(), "numpy": np.__version__}
    rows = [{**asdict(speed), "steps_per_second": round(speed.steps_per_second)} for speed in speeds]
    return {"machine": machine(), "versions": {**versions, "numba": numba.__version__}, "speeds": rows}


def machine() -> dict[str, str | int]:
    """Return a description of this machine."""
    return {"processor": _processor(), "cores": cores(), "system": f"{platform.system()} {platform.machine()}"}


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    """Return the processor's name."""
    about = Path("/proc/cpuinfo")
    if about.exists():
        for line in about.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _of(scenario: Scenario) -> "Iterator[Measurement]":
    """Return the measurements for a scenario."""
    yield _Env(scenario)
    threads = sorted({1, cores()})
    for environments in BATCHES:
        for each in threads if environments > 1 else [1]:
            yield _Vector(scenario, environments, each)
            yield _Bare(scenario, environments, each)


class Measurement(ABC):
    """Something that can be stepped, and its best round so far in seconds per step of one environment."""

    environments = 1

    def __init__(self) -> None:
        self.stepping = self.copying = float("inf")
        self.steps = max(_MIN_STEPS, _STEPS // self.environments)
        self.actions = np.random.default_rng(0).integers(0, _ACTIONS, (self.steps, self.environments))

    def measure(self) -> None:
        """Measure one round."""
        self.prepare()
        started = time.perf_counter()
        self.run()
        self.stepping = min(self.stepping, (time.perf_counter() - started) / self.steps / self.environments)

    def prepare(self) -> None:  # noqa: B027  # most have nothing to prepare
        """Prepare a round; this is not measured."""

    @abstractmethod
    def run(self) -> None:
        """Take the steps."""

    @abstractmethod
    def speed(self) -> Speed:
        """Return the best round."""


class _Env(Measurement):
    """Measures one environment, without resets."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        self.env = UAVEnv(scenario)
        self.longest = scenario.budget[1]
        self.steps = max(1, min(self.steps, self.longest - 1))  # all within one episode

    def prepare(self) -> None:
        self.env.reset(seed=0, options={"budget": self.longest})

    def run(self) -> None:
        for action in self.actions[: self.steps, 0].tolist():
            self.env.step(action)

    def speed(self) -> Speed:
        size = sum(values.nbytes for values in self.env.reset(seed=0)[0].values())
        return Speed(self.env.scenario.id, "Env", 1, 1, 1e6 * self.stepping, size)


class _Vector(Measurement):
    """Measures a vector environment, and how long copying its observations takes."""

    def __init__(self, scenario: Scenario, environments: int, threads: int) -> None:
        self.environments, self.threads = environments, threads
        super().__init__()
        self.envs = UAVVectorEnv(scenario, environments, threads=threads)
        self.observations, _ = self.envs.reset(seed=0)
        self.copies = {name: np.empty_like(values) for name, values in self.observations.items()}

    def measure(self) -> None:
        super().measure()
        started = time.perf_counter()
        for _ in range(self.steps):
            for name, values in self.observations.items():
                np.copyto(self.copies[name], values)
        self.copying = min(self.copying, (time.perf_counter() - started) / self.steps / self.environments)

    def run(self) -> None:
        for row in self.actions:
            self.envs.step(row)

    def speed(self) -> Speed:
        size = sum(values.nbytes for values in self.observations.values()) // self.environments
        name = self.envs.scenario.id
        return Speed(name, "VectorEnv", self.environments, self.threads, 1e6 * self.stepping, size, 1e6 * self.copying)


class _Bare(Measurement):
    """Measures a simulator without observations; when an episode ends, its slot begins the next one."""

    def __init__(self, scenario: Scenario, environments: int, threads: int) -> None:
        self.environments = environments
        super().__init__()
        self.simulator = Simulator(scenario, environments, threads)
        self.simulator.reset(np.arange(environments), "train", np.arange(environments))
        self.started = environments

    def run(self) -> None:
        done = self.simulator.state.done[:, 0]
        for row in self.actions:
            self.simulator.step(row)
            over = done.nonzero()[0]
            if len(over):
                self.simulator.reset(over, "train", np.arange(self.started, self.started + len(over)))
                self.started += len(over)

    def speed(self) -> Speed:
        return Speed(self.simulator.scenario.id, "Simulator", self.environments, self.simulator.threads, 1e6 * self.stepping)


class _Peer(Measurement):
    """Measures another suite's environments."""

    def __init__(self, peer: Any) -> None:
        self.peer = peer
        self.environments = peer.environments
        super().__init__()

    def run(self) -> None:
        for _ in range(self.steps):
            self.peer.step()

    def speed(self) -> Speed:
        peer = self.peer
        return Speed(peer.task, peer.interface, peer.environments, 1, 1e6 * self.stepping, peer.bytes)
