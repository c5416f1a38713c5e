"""The Gymnasium environment: a batch of one."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from uavbench.envs.core import (
    METADATA,
    EnvState,
    action_space,
    check_alone,
    check_options,
    check_render_mode,
    choose_episode,
    load,
    observation_space,
)
from uavbench.envs.pictures import Pictures
from uavbench.episode import check_split
from uavbench.observation import Observation, Observer
from uavbench.scenario import Scenario, SplitName
from uavbench.simulator import Simulator

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
    its g×g means; ``budget`` (1,), actions left. Layers: landing, no_fly, building, target. Without ``local`` if l = 0.

    Rewards
    -------
    r_mov for every action except a successful landing, r_sc for staying in place without hovering or landing, r_crash
    when the budget ends in the air, r_c per covered cell or collected data unit. Their values are the scenario's.

    Starting State
    --------------
    A landing cell, a budget and targets or devices, drawn from the episode's key.

    Episode End
    -----------
    Terminated when landed or when the budget is 0. Never truncated.

    Information
    -----------
    Always ``action_mask``, int8 (6,): the actions that have their effect. After ``reset`` also ``split`` and
    ``episode_number``. At the end also ``landed``, ``cr``, ``cral`` and ``blocked``.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    local_size, global_scale : int, optional
        l (odd, 0 for no local map) and g; the scenario's by default.
    split : {"train", "validation", "test"}
        Where ``reset`` draws episodes from when its options name none.
    render_mode : {"human", "rgb_array", "ansi"}, optional
        What `render` returns; ``"human"`` opens a window (the extra ``human``).

    Version History
    ---------------
    v0: the rules of the paper and of uavSim's branch ``icar``.
    """

    metadata = METADATA

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        local_size: int | None = None,
        global_scale: int | None = None,
        split: str = "train",
        render_mode: str | None = None,
    ) -> None:
        self.scenario = check_alone(load(scenario, local_size, global_scale))
        self.render_mode = check_render_mode(render_mode)
        self._split: SplitName = check_split(split)
        self.simulator = Simulator(self.scenario, 1)
        self._observer = Observer(self.scenario)
        self.observation_space: Any = observation_space(self.scenario, self._observer)
        self.action_space: Any = action_space()
        self._begun = False
        self._pictures = Pictures(self.simulator, self.render_mode)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed : int, optional
            Seeds the sequence of episodes that this and later resets draw.
        options : dict, optional
            ``split`` and ``episode`` pick an episode; ``start`` [row, column], ``budget``, ``targets`` (CPP: a mask) or
            ``devices`` (DH: rows [row, column, data]) set it by hand; ``noise`` False switches shadow fading off.

        Raises
        ------
        ValueError
            When an option is unknown or does not fit the scenario.
        """
        super().reset(seed=seed)
        simulator = self.simulator
        given = check_options(options, simulator.mission)
        split, number = choose_episode(self.scenario, self._split, given, self.np_random)
        simulator.reset(_SLOT, split, [number])
        try:
            simulator.customise(0, given)
        except ValueError:
            simulator.state.done[0] = True  # nothing flies until a reset succeeds
            raise
        self._begun = True
        self._pictures.begin([0])
        split, number = simulator.episode(0)
        return self._observe(), {"action_mask": self._mask(), "split": split, "episode_number": number}

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly one action.

        Raises
        ------
        RuntimeError
            When the episode has ended.
        ValueError
            When ``action`` is not an integer from 0 to 5.
        """
        state = self.simulator.state
        if state.done[0, 0]:
            raise RuntimeError("step() after the end of the episode: call reset() first")
        if np.ndim(action) > 0:
            raise ValueError(f"actions: {action!r} is not one integer from 0 to 5")
        self.simulator.step(np.array([action]))
        self._pictures.extend()
        info: dict[str, Any] = {"action_mask": self._mask()}
        terminated = bool(state.done[0, 0])
        if terminated:
            info.update({name: values[0].item() for name, values in self.simulator.outcomes(_SLOT).items()})
        return self._observe(), float(state.reward[0, 0]), terminated, False, info

    def get_state(self) -> EnvState:
        """Return the state of the episode, to come back to it by `set_state`; a search over many futures does.

        The generator that draws the next episodes is not part of it.
        """
        return EnvState(self.simulator.get_state(), self._pictures.get_state([0]))

    def set_state(self, state: EnvState) -> None:
        """Go back to a state that `get_state` of an environment of this scenario returned, to the last bit.

        Raises
        ------
        ValueError
            When it is of another scenario. Nothing is changed then.
        """
        self.simulator.set_state(state.simulator)
        self._begun = True
        self._pictures.set_state(state.trails, [0])

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the actions that have their effect, bool (6,): the name that sb3-contrib's MaskablePPO asks for."""
        return self._mask().astype(np.bool_)

    def render(self) -> Any:
        """Return a picture of the episode: an array (rows, columns, 3) of uint8, or text, by ``render_mode``."""
        return self._pictures.of(0)

    def close(self) -> None:
        """Close the window, if there is one."""
        self._pictures.close()

    def _mask(self) -> NDArray[np.int8]:
        if not self._begun:
            raise RuntimeError("no episode has begun: call reset() first")
        r, c = self.simulator.state.position[0, 0]
        return self.simulator.city.action_mask[r, c].copy()

    def _observe(self) -> Observation:
        batch = self._observer.empty(1)
        self._observer.write(self.simulator.state, _SLOT, batch)
        return {name: values[0] for name, values in batch.items()}
