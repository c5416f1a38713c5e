"""An agent that is an object in memory instead of a file.

The same code evaluates it. The leaderboard refuses its results, because nobody could run it again.
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
    """The source of an agent that exists as a Python object.

    Attributes
    ----------
    agent : object
        An agent, or a class that makes one from a scenario.
    """

    agent: Any = None

    @classmethod
    def of(cls, agent: object, name: str | None = None) -> "ObjectSource":
        """Return the source of an agent; without ``name`` it has the name of its class."""
        kind = agent if inspect.isclass(agent) else type(agent)
        return cls(Path("in memory"), kind.__name__, given_name=name or kind.__name__, agent=agent)

    @property
    def file(self) -> Path | None:
        """None: there is no file."""
        return None

    @property
    def sha256(self) -> str:
        """The text "in memory" instead of a digest, which an object in memory does not have."""
        return "in memory"

    @property
    def built_in(self) -> bool:
        """False: the agent does not come with the suite."""
        return False

    def digest(self, scenario: Scenario) -> str:  # noqa: ARG002  # a file's digest depends on it
        """Return the text "in memory" instead of a digest."""
        return self.sha256

    @cached_property
    def _class(self) -> Any:
        """The agent or its class, after a check of its methods."""
        self._check_contract(self.agent)
        if inspect.isclass(self.agent):
            self._check_signature(self.agent)
        return self.agent

    def make(self, scenario: Scenario) -> Any:
        """Return the agent for ``scenario``."""
        return self._class(scenario) if inspect.isclass(self.agent) else self._class

    def meant(self, error: Exception) -> bool:
        """Return whether an error is the agent's message that it needs something: here only an error of uavbench is."""
        return isinstance(error, UavbenchError)
