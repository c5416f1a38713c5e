"""The PettingZoo environment: a team in a simulator with a batch of one episode."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Unpack, cast

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo.utils import parallel_to_aec  # pyright: ignore[reportMissingTypeStubs]
from pettingzoo.utils.env import AECEnv, ParallelEnv  # pyright: ignore[reportMissingTypeStubs]

from uavbench.envs.core import (
    METADATA,
    SUCCESS_CR,
    Changes,
    EnvState,
    action_space,
    check_action,
    check_render_mode,
    check_success,
    information_alone,
    known_options,
    load,
    observation_space,
    read_options,
)
from uavbench.envs.episodes import Episodes
from uavbench.envs.pictures import Pictures
from uavbench.simulation.observation import TEAM_LAYERS, Observer
from uavbench.simulation.options import check_start
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import HOVER, NUM_ACTIONS
from uavbench.world.scenario import Scenario
from uavbench.world.values import shown

_SLOT = np.zeros(1, dtype=np.int64)


class UAVParallelEnv(ParallelEnv[str, Any, Any]):
    """A team of UAVs on a mission over a grid city.

    Description
    -----------
    As `uavbench.envs.env.UAVEnv`, with the rules for several UAVs of Bayerlein et al., IEEE OJCOMS 2021: they share the
    targets or devices, each has its own budget, and each must land. A scenario for one UAV is a team of one.

    Agents
    ------
    ``uav_0`` to ``uav_{U−1}``, in the order in which they move: within a step each UAV moves and covers or collects before
    the next one moves. A UAV that has landed or crashed leaves ``agents`` and no longer occupies its cell.

    Action Space
    ------------
    ``Discrete(6)``: 0 north, 1 east, 2 south, 3 west, 4 hover, 5 land. A move off the map, into a no-fly cell or into a cell
    that an active UAV holds is blocked; ``land`` outside a landing zone does nothing. Both cost budget and the safety penalty.

    Observation Space
    -----------------
    ``Dict`` of float32: ``local`` (6, l, l), ``global`` (6, ⌊(2M−1)/g⌋, ⌊(2N−1)/g⌋) and ``budget`` (1,), each centred on the
    UAV. Layers: landing, no_fly, building, target, the other active UAVs (0/1), their budgets at their cells. Scenarios for
    one UAV have only the first four. If l = 0, there is no ``local``. With ``flat`` the space is one ``Box``.

    Rewards
    -------
    Each UAV earns r_c for what its own action covered or collected, and pays its own r_mov, r_sc and r_crash.

    Starting State
    --------------
    How many UAVs fly, distinct landing cells, a budget each, and targets or devices, drawn from the episode's key.

    Episode End
    -----------
    A UAV is terminated when it has landed or its budget is 0; the episode ends when all UAVs are terminated. Never truncated.

    Information
    -----------
    For each UAV the keys of `uavbench.envs.env.UAVEnv`, after ``reset`` and every ``step``. Its ``action_mask``, int8 (6,),
    is 1 for valid actions; a move to the cell of a UAV that moves later is not valid. All other values are the team's:
    ``landed`` says whether all of its UAVs have landed, and ``blocked`` is their sum.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    num_uavs : int, optional
        Number of UAVs in every episode; by default the number that the episode draws.
    local_size, global_scale : int, optional
        l (odd, 0 for no local map) and g; the scenario's by default.
    rewards : mapping of str to float, optional
        Terms of the reward that differ from the scenario's: ``movement``, ``safety``, ``crash``, ``collect``.
    budget : (int, int), optional
        Another range of movement budgets; the episodes of all splits are drawn anew with it.
    flat : bool
        Whether each observation is one vector, for libraries that do not accept dictionaries.
    keep_finished : bool
        Whether ``agents`` are all of ``possible_agents`` at every step, for libraries that need a fixed set. A UAV that has
        landed or crashed, or that the episode does not have, then stays in ``agents`` until the last UAV is done: it hovers
        whatever action it is given, and its observation is 0 everywhere, its reward 0, ``hover`` its only valid action, and
        ``active`` in its info False. All agents are terminated together.
    split : {"train", "validation", "test"}
        The split from which ``reset`` takes episodes if its options name none.
    start, safe_action_mask
        As for `uavbench.envs.env.UAVEnv`.
    order, success_cr
        As for `uavbench.envs.env.UAVEnv`.
    render_mode : {"human", "rgb_array", "ansi"}, optional
        What `render` returns; ``"human"`` opens a window (needs the extra ``human``).

    Version History
    ---------------
    v0: the first rules.
    """

    metadata: dict[str, Any]

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        num_uavs: int | None = None,
        flat: bool = False,
        keep_finished: bool = False,
        split: str = "train",
        start: str = "landing",
        safe_action_mask: bool = False,
        order: str = "random",
        success_cr: float = SUCCESS_CR,
        render_mode: str | None = None,
        **changes: Unpack[Changes],
    ) -> None:
        loaded = load(scenario, **changes)
        self.scenario = loaded if num_uavs is None else loaded.with_uavs(num_uavs)
        self.render_mode = check_render_mode(render_mode)
        self.metadata = {**METADATA, "name": self.scenario.id, "is_parallelizable": True}
        self._episodes = Episodes(self.scenario, split, order)
        self._start_option, self._shows_safe = check_start(start), safe_action_mask
        self.success_cr = check_success(success_cr)
        self.simulator = Simulator(self.scenario, 1)
        self._observer = Observer(self.scenario)
        self._keep_finished = keep_finished
        self.possible_agents = [f"uav_{u}" for u in range(self.scenario.max_uavs)]
        self.agents: list[str] = []
        self._numbers = {agent: u for u, agent in enumerate(self.possible_agents)}
        # Each agent has its own spaces: seeding the space of one agent must not seed those of the others.
        shown = {agent: observation_space(self.scenario, self._observer) for agent in self._numbers}
        self._flattened = shown[self.possible_agents[0]] if flat else None
        self._observation_spaces: dict[str, spaces.Space[Any]] = {**shown}
        if flat:
            self._observation_spaces = {agent: cast("Any", spaces).flatten_space(space) for agent, space in shown.items()}
        self._action_spaces = {agent: action_space() for agent in self._numbers}
        self.state_space = _state_space(self.scenario)
        self._generator: np.random.Generator | None = None
        self._pictures = Pictures(self.simulator, self.render_mode)

    @property
    def episode(self) -> tuple[str, int]:
        """The split and the number of the current episode; ``("custom", -1)`` if it was set by hand."""
        return self.simulator.episode(0)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of an agent's observations, the same object at every call."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of an agent's actions, the same object at every call."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode.

        Parameters
        ----------
        seed : int, optional
            Seeds the sequence of episodes that this and later resets draw, and starts a cycle again.
        options : dict, optional
            As for `UAVEnv.reset`, and ``num_uavs``. For a team, ``start`` is a list with a cell for each UAV, and ``budget``
            is one number for all UAVs or a list. Unknown options are ignored, as PettingZoo requires.

        Raises
        ------
        ValueError
            When an option does not fit the scenario. Then `step` fails until a reset succeeds.
        """
        self.agents = []  # `step` fails until a reset succeeds
        self._pictures.end([0])
        if seed is not None or self._generator is None:
            self._generator = seeding.np_random(seed)[0]
        if seed is not None:
            self._episodes.restart()
        simulator = self.simulator
        known = (*known_options(simulator.mission), "num_uavs")
        given = {name: value for name, value in read_options(options).items() if name in known}
        given.setdefault("start", self._start_option)
        split, number = self._episodes.choose(given, self._generator)
        simulator.reset(_SLOT, split, [number])
        simulator.customise(0, given)
        self.agents = self._remaining()
        self._pictures.begin([0])
        return self._observe(self.agents), self._infos(self.agents)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Fly one action with every UAV of ``agents``, in their order.

        Raises
        ------
        RuntimeError
            Before a successful `reset`, and after the end of the episode.
        ValueError
            When the action of an active UAV is missing or not an integer from 0 to 5, or when ``actions`` has an unknown agent.
        """
        acting = self.agents
        if not acting:
            raise RuntimeError("step() after the end of the episode: call reset() first")
        simulator, state = self.simulator, self.simulator.state
        simulator.step(self._chosen(actions))
        self._pictures.extend()
        self.agents = self._remaining()
        done = {agent: agent not in self.agents for agent in acting}
        rewards = {agent: float(state.reward[0, self._numbers[agent]]) for agent in acting}
        return self._observe(acting), rewards, done, dict.fromkeys(acting, False), self._infos(acting)

    def get_state(self) -> EnvState:
        """Return the state of the episode, so that `set_state` can restore it: for example, to search over many futures.

        The generator that draws the next episodes is not part of it.
        """
        return EnvState(self.simulator.get_state(), self._pictures.get_state([0]))

    def set_state(self, state: EnvState) -> None:
        """Restore a state that `get_state` of an environment of this scenario returned, to the last bit.

        Raises
        ------
        ValueError
            When the state belongs to another scenario. Nothing is changed then.
        """
        self.simulator.set_state(state.simulator)
        self.agents = self._remaining()
        self._pictures.set_state(state.trails, [0])

    def state(self) -> NDArray[np.float32]:
        """Return the whole state for a centralised critic, float32 (6, M, N): the layers of a team's observation, not centred.

        If the mission has layers of its own, they follow.
        """
        city, state = self.simulator.city_at(0), self.simulator.state
        shared = len(TEAM_LAYERS)
        whole = np.zeros((shared + state.layers.shape[1], *city.shape), dtype=np.float32)
        whole[:4] = city.landing, city.no_fly, city.building, state.target[0]
        for u in np.flatnonzero(~state.done[0]):
            r, c = state.position[0, u]
            whole[4:shared, r, c] = 1.0, state.budget[0, u]
        whole[shared:] = state.layers[0]
        return whole

    def render(self) -> Any:
        """Return a picture of the episode: an array (rows, columns, 3) of uint8, or text, depending on ``render_mode``."""
        return self._pictures.of(0)

    def close(self) -> None:
        """Close the window, if one is open."""
        self._pictures.close()

    def _remaining(self) -> list[str]:
        """Return the agents that take part in the next step."""
        active = [agent for agent in self.possible_agents if self._active(agent)]
        return list(self.possible_agents) if active and self._keep_finished else active

    def _active(self, agent: str) -> bool:
        """Return whether an agent's UAV is active."""
        return not self.simulator.state.done[0, self._numbers[agent]]

    def _chosen(self, actions: Mapping[str, Any]) -> NDArray[Any]:
        """Return the actions in the simulator's form; UAVs that are not active hover."""
        flying = [agent for agent in self.agents if self._active(agent)]
        for agent in flying:
            if agent not in actions:
                raise ValueError(f"actions: none for {agent}; there must be one for each of {', '.join(flying)}")
        for agent in actions:
            if agent not in self._numbers:
                raise ValueError(f"actions: {shown(agent)} is not an agent; they are {', '.join(self.possible_agents)}")
        chosen = np.full((1, len(self.possible_agents)), HOVER)
        for agent in flying:
            chosen[0, self._numbers[agent]] = check_action(actions[agent], f" of {agent}")
        return chosen if self.scenario.team else chosen[:, 0]

    def _observe(self, agents: list[str]) -> dict[str, Any]:
        """Return the agents' observations, in fresh arrays."""
        batch = self._observer.empty(len(self.possible_agents))
        self._observer.write(self.simulator.state, np.array([self._numbers[agent] for agent in agents]), batch)
        if self._keep_finished:
            for values in batch.values():
                values[self.simulator.state.done[0]] = 0.0
        observations = {agent: {name: values[self._numbers[agent]] for name, values in batch.items()} for agent in agents}
        if self._flattened is None:
            return observations
        return {agent: spaces.flatten(self._flattened, observation) for agent, observation in observations.items()}

    def _infos(self, agents: list[str]) -> dict[str, dict[str, Any]]:
        """Return the infos of the agents, in fresh dicts."""
        masks = self.simulator.action_mask().reshape(-1, NUM_ACTIONS)
        each = {"action_mask": masks}
        if self._shows_safe:
            each["safe_action_mask"] = self.simulator.safe_action_mask().reshape(-1, NUM_ACTIONS)
        if self._keep_finished:
            finished = self.simulator.state.done[0]
            for mask in each.values():
                mask[finished] = np.arange(NUM_ACTIONS) == HOVER
            each["active"] = ~finished
        team = information_alone(self.simulator, self.success_cr)
        return {agent: {**{name: rows[self._numbers[agent]] for name, rows in each.items()}, **team} for agent in agents}


def _state_space(scenario: Scenario) -> spaces.Box:
    """Return the space of `UAVParallelEnv.state`."""
    mission = scenario.mission
    most = np.array([1, 1, 1, mission.largest_target, 1, scenario.budget[1], *mission.layers.values()], dtype=np.float32)
    shape = (len(most), *scenario.shape)
    return spaces.Box(np.zeros(shape, np.float32), np.broadcast_to(most[:, None, None], shape), dtype=np.float32)


def aec_env(scenario: str | Path | Scenario, **kwargs: Any) -> AECEnv[str, Any, Any]:
    """Return a team's environment with PettingZoo's other interface (AEC), made by PettingZoo's own converter.

    Parameters
    ----------
    scenario, **kwargs
        As for `UAVParallelEnv`. UAVs still decide on the observations from before the step.
    """
    return cast("Any", parallel_to_aec)(UAVParallelEnv(scenario, **kwargs))
