"""The Gymnasium environment: a simulator with a batch of one episode."""

from pathlib import Path
from typing import Any, Unpack

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from uavbench.envs.core import (
    METADATA,
    SUCCESS_CR,
    Changes,
    EnvState,
    action_space,
    check_action,
    check_alone,
    check_options,
    check_render_mode,
    check_success,
    information_alone,
    load,
    observation_space,
)
from uavbench.envs.episodes import Episodes
from uavbench.envs.forms import Form
from uavbench.envs.pictures import Pictures
from uavbench.simulation.observation import Observation, Observer
from uavbench.simulation.options import check_start
from uavbench.simulation.simulator import Simulator
from uavbench.world.scenario import Scenario

_SLOT = np.zeros(1, dtype=np.int64)


class UAVEnv(gym.Env[dict[str, NDArray[np.float32]], np.int64]):
    """One UAV on a mission over a grid city.

    Description
    -----------
    In coverage (CPP) the UAV's camera must see every target cell, in data harvesting (DH) its radio link must empty every
    device, and it must land in a landing zone before its movement budget ends. After Theile et al., ICAR 2021.

    Action Space
    ------------
    ``Discrete(6)``: 0 north, 1 east, 2 south, 3 west, 4 hover, 5 land. A move off the map or into a no-fly cell is
    blocked; ``land`` outside a landing zone does nothing. Both cost budget and the safety penalty.

    Observation Space
    -----------------
    ``Dict`` of float32: ``local`` (4, l, l), the central crop of the centred map; ``global`` (4, ⌊(2M−1)/g⌋, ⌊(2N−1)/g⌋),
    its g×g means; ``budget`` (1,), actions left. Layers: landing, no_fly, building, target. If l = 0, there is no ``local``.

    Rewards
    -------
    r_mov for every action except a successful landing, r_sc for staying in place without hovering or landing, r_crash
    when the budget is used up without a landing, r_c per covered cell or collected data unit. The scenario sets their values.

    Starting State
    --------------
    A landing cell, a budget and targets or devices, drawn from the episode's key.

    Episode End
    -----------
    Terminated when landed or when the budget is 0. Never truncated.

    Information
    -----------
    The same keys after ``reset`` and every ``step``. ``action_mask``, int8 (6,): 1 for valid actions.
    ``split``: 0 train, 1 validation, 2 test, 3 set by hand; and ``episode_number``, −1 if set by hand. The attribute
    `episode` has both.
    ``landed`` (bool), ``cr``, ``cral`` (float) and ``blocked`` (int): the metrics so far; at the end of the episode, its score.
    ``is_success`` (bool): landed, and CR at least ``success_cr``.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    local_size, global_scale : int, optional
        l (odd, 0 for no local map) and g; the scenario's by default.
    rewards : mapping of str to float, optional
        Terms of the reward that differ from the scenario's: ``movement``, ``safety``, ``crash``, ``collect``.
    budget : (int, int), optional
        Another range of movement budgets; the episodes of all splits are drawn anew with it.
    split : {"train", "validation", "test"}
        The split from which ``reset`` takes episodes if its options name none.
    start : {"landing", "anywhere"}
        Where episodes start if the options of ``reset`` do not say it: in the landing cell that was drawn, or, for training,
        in any cell with any budget that suffices to land, drawn from the episode's key (such episodes have the number −1).
    safe_action_mask : bool
        Whether infos also have ``safe_action_mask``, int8 (6,): 1 for safe actions, after which landing is still possible.
    compact : bool
        Whether observations take a quarter of the memory, for replay buffers: see `uavbench.envs.forms.Form`.
    normalize : bool
        Whether ``budget`` is divided by the scenario's largest, so that it is from 0 to 1.
    order : {"random", "cycle"}
        Whether ``reset`` draws an episode at random, or takes the episodes of the split in order, from number 0 on. The
        cycle starts again after the last episode, and at a reset with a seed.
    success_cr : float
        An episode is a success (``is_success``) if the UAV landed and CR is at least this number, from 0 to 1.
    render_mode : {"human", "rgb_array", "ansi"}, optional
        What `render` returns; ``"human"`` opens a window (needs the extra ``human``).

    Version History
    ---------------
    v0: the rules of the paper and of uavSim's branch ``icar``.
    """

    metadata = METADATA

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        split: str = "train",
        start: str = "landing",
        safe_action_mask: bool = False,
        compact: bool = False,
        normalize: bool = False,
        order: str = "random",
        success_cr: float = SUCCESS_CR,
        render_mode: str | None = None,
        **changes: Unpack[Changes],
    ) -> None:
        self.scenario = check_alone(load(scenario, **changes))
        self.render_mode = check_render_mode(render_mode)
        self._episodes = Episodes(self.scenario, split, order)
        self._start_option, self._shows_safe = check_start(start), safe_action_mask
        self.success_cr = check_success(success_cr)
        self.simulator = Simulator(self.scenario, 1)
        self._observer = Observer(self.scenario)
        self._action = np.zeros((1, 1), dtype=np.int64)
        self._form = Form(self.scenario, compact, normalize)
        self.observation_space: Any = self._form.space(observation_space(self.scenario, self._observer))
        self.action_space: Any = action_space()
        self._begun = False
        self._pictures = Pictures(self.simulator, self.render_mode)

    @property
    def episode(self) -> tuple[str, int]:
        """The split and the number of the current episode; ``("custom", -1)`` if it was set by hand."""
        return self.simulator.episode(0)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed : int, optional
            Seeds the sequence of episodes that this and later resets draw, and starts a cycle again.
        options : dict, optional
            ``split`` and ``episode`` choose an episode. ``start`` ([row, column], ``"anywhere"`` or ``"landing"``),
            ``budget``, ``targets`` (CPP: a mask) or ``devices`` (DH: rows [row, column, data]) set parts of it by hand.
            ``noise`` False switches shadow fading off (DH).

        Raises
        ------
        ValueError
            When an option is unknown or does not fit the scenario. Then `step` fails until a reset succeeds.
        """
        self._begun = False
        self._pictures.end([0])
        super().reset(seed=seed)
        if seed is not None:
            self._episodes.restart()
        simulator = self.simulator
        given = {"start": self._start_option, **check_options(options, simulator.mission)}
        split, number = self._episodes.choose(given, self.np_random)
        simulator.reset(_SLOT, split, [number])
        simulator.customise(0, given)
        self._begun = True
        self._pictures.begin([0])
        return self._observe(), self._info()

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly one action.

        Raises
        ------
        RuntimeError
            Before a successful `reset`, and after the end of the episode.
        ValueError
            When ``action`` is not an integer from 0 to 5.
        """
        state = self.simulator.state
        if not self._begun:
            raise RuntimeError("step() before a successful reset(): call reset() first")
        if state.done.item(0):
            raise RuntimeError("step() after the end of the episode: call reset() first")
        self._action[0, 0] = check_action(action)
        self.simulator.fly(self._action)
        self._pictures.extend()
        return self._observe(), state.reward.item(0), state.done.item(0), False, self._info()

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
        self._begun = True
        self._pictures.set_state(state.trails, [0])

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the valid actions, bool (6,). MaskablePPO of sb3-contrib calls a method of this name."""
        return self._mask().astype(np.bool_)

    def render(self) -> Any:
        """Return a picture of the episode: an array (rows, columns, 3) of uint8, or text, depending on ``render_mode``."""
        return self._pictures.of(0)

    def close(self) -> None:
        """Close the window, if one is open."""
        self._pictures.close()

    def _mask(self) -> NDArray[np.int8]:
        if not self._begun:
            raise RuntimeError("no episode has begun: call reset() first")
        position = self.simulator.state.position
        return self.simulator.city_at(0).action_mask[position.item(0), position.item(1)].copy()

    def _info(self) -> dict[str, Any]:
        safe = {"safe_action_mask": self.simulator.safe_action_mask().reshape(-1)} if self._shows_safe else {}
        return {"action_mask": self._mask(), **safe, **information_alone(self.simulator, self.success_cr)}

    def _observe(self) -> Observation:
        batch = self._observer.empty(1)
        self._observer.write(self.simulator.state, _SLOT, batch)
        formed = batch if self._form.plain else self._form.apply(batch)
        return {name: values[0] for name, values in formed.items()}
