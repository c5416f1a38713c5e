"""An agent that is an object in memory instead of a file.

It is evaluated by the same code. The leaderboard does not take its results, as nobody can run it again.
"""

import inspect
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from uavbench.agents.agent import AgentSource
from uavbench.errors import UavbenchError
from uavbench.world.scenario import Scenario


@dataclass(frozen=True)
class ObjectSource(AgentSource):
    """The source of an agent that a program has made.

    Attributes
    ----------
    agent : object
        An agent, or a class that makes one of a scenario.
    """

    agent: Any = None

    @classmethod
    def of(cls, agent: object, name: str | None = None) -> "ObjectSource":
        """Return the source of an agent, called by ``name`` or by its class."""
        kind = agent if inspect.isclass(agent) else type(agent)
        return cls(Path("in memory"), kind.__name__, given_name=name or kind.__name__, agent=agent)

    @property
    def file(self) -> Path | None:
        """None: there is no file."""
        return None

    @property
    def sha256(self) -> str:
        """What stands in the place of a digest: an object in memory has none."""
        return "in memory"

    @property
    def built_in(self) -> bool:
        """False: it does not come with the suite."""
        return False

    def digest(self, scenario: Scenario) -> str:  # noqa: ARG002  # a file's digest depends on it
        """Return what stands in the place of a digest."""
        return self.sha256

    @cached_property
    def _class(self) -> Any:
        """The agent or its class: whatever has the methods."""
        self._check_contract(self.agent)
        if inspect.isclass(self.agent):
            self._check_signature(self.agent)
        return self.agent

    def make(self, scenario: Scenario) -> Any:
        """Return the agent for ``scenario``."""
        return self._class(scenario) if inspect.isclass(self.agent) else self._class

    def meant(self, error: Exception) -> bool:
        """Say whether an error says what the agent needs."""
        return isinstance(error, UavbenchError)
