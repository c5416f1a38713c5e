"""Checking that an agent keeps the contract: it flies the same episodes of Block8 twice, in other orders and batches."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uavbench.agents.agent import AgentLoadError, AgentSource
from uavbench.evaluation.evaluate import AgentError, EpisodeRecord, Job, evaluate
from uavbench.world.scenario import load_scenario

SCENARIOS = ("Block8-CPP-v0", "Block8-DH-v0")
_EPISODES = 24


@dataclass(frozen=True)
class Checked:
    """The outcome of a check: decisions per second, and the mean CRAL on each scenario."""

    decisions_per_second: float
    cral: dict[str, float]


def check_agent(source: AgentSource, scenarios: Sequence[str] = SCENARIOS, decision_timeout: float = 60.0) -> Checked:
    """Fly validation episodes with an agent, and again in another order and with another batch size.

    Parameters
    ----------
    source : AgentSource
    scenarios : sequence of str
    decision_timeout : float
        Seconds that one decision may take.

    Raises
    ------
    AgentLoadError
        When the agent does not keep the contract; the message says in one line what is wrong.
    """
    cral: dict[str, float] = {}
    steps = seconds = 0.0
    source.load()
    for name in scenarios:
        scenario = load_scenario(name)
        try:
            job = Job(source, scenario, "validation", decision_timeout, batch_size=_EPISODES)
            numbers = range(min(_EPISODES, scenario.splits.validation.episodes))
            first = _fly(job, numbers)
            again = _fly(replace(job, batch_size=7), numbers[::-1])
        except AgentError as error:
            raise AgentLoadError(_line(error)) from error
        for number, record in first.items():
            if not np.array_equal(record.actions, again[number].actions):
                raise AgentLoadError(
                    f"{source.name} on {name}, validation episode {number}: it took other actions when flown again after "
                    'other episodes; forget everything in reset(), and take randomness from info["seed"]'
                )
        cral[name] = float(np.mean([record.cral for record in first.values()]))
        steps += sum(record.steps for record in first.values())
        seconds += sum(record.seconds for record in first.values())
    return Checked(steps / max(seconds, 1e-9), cral)


def _line(error: AgentError) -> str:
    """Return an agent's failure in one line, with the place in its file."""
    first, *trace = str(error).splitlines()
    places = [line.strip() for line in trace if line.startswith("  File ")]
    return f"{first} ({places[-1]})" if places else first


def _fly(job: Job, numbers: Sequence[int]) -> dict[int, EpisodeRecord]:
    return {record.episode: record for record in evaluate(job, numbers, workers=1)}
