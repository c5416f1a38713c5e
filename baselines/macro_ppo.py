"""Macro-PPO: a policy that decides by macro-actions, each of which is flown in several moves, and how it is trained.

A macro-action is a cell of the local map, to which the UAV flies by a shortest path, or a direction, in which it flies until
something changes (`uavbench.simulation.macro_actions`). The decision process is semi-Markov (Sutton, Precup, Singh, Artificial
Intelligence 1999): a decision's reward is what its moves earn, discounted move by move, and the value of the state after it
counts γ to the power of the number of its moves. For the rest it is learned as in `ppo`.

For cells, the network's logits are a map over the local map, computed by convolutions, so that what it learns about a cell
holds wherever the cell is.

Needs PyTorch: ``pip install 'uavbench[ddqn]'``.
"""

import math
from dataclasses import dataclass

import numpy as np
import ppo
import torch
from torch import nn

from uavbench.agents.macro_actions import MacroAgent
from uavbench.agents.symmetries import IDENTITY
from uavbench.agents.torch_state import tensor, tensors, unpack_network
from uavbench.agents.weights import training_record, weights_for, weights_path
from uavbench.simulation.macro_actions import MacroKind
from uavbench.simulation.observation import Observer


@dataclass(frozen=True)
class Config(ppo.Config):
    """How to train; the fields of `ppo`, and one more. ``steps`` are moves, not decisions.

    Attributes
    ----------
    kind : str
        The macro-actions: "cells" or "directions".
    """

    kind: str = "cells"
    num_envs: int = 128
    entropy: float = 0.003
    last_entropy: float = 0.0003


CONFIGS = {"fast": Config(), "directions": Config(kind="directions")}


class MapNetwork(ppo.Network):
    """Logits of the cells of the local map and of ``land``, and the value of the state.

    Parameters
    ----------
    scenario : Scenario
        The scenario whose observations are the input.
    channels, blocks, hidden : int
        Width of the convolutions, number of their residual blocks, and width of the dense layers.
    """

    def __init__(self, scenario, channels=32, blocks=2, hidden=256):
        super().__init__(scenario, channels=channels, blocks=blocks, hidden=hidden)
        body = [ppo.Residual(channels) for _ in range(blocks)]
        self.cells = nn.Sequential(nn.Conv2d(Observer(scenario).local_shape[0], channels, 3, padding=1), nn.ReLU(), *body)
        self.context = nn.Linear(hidden, channels)
        last = nn.Conv2d(channels, 1, 1)
        self.choice = nn.Sequential(ppo.Residual(channels), last)
        for part in (self.cells, self.choice):
            part.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.policy = nn.Linear(hidden, 1)  # of landing
        with torch.no_grad():
            self.policy.weight.mul_(0.1)
            last.weight.mul_(0.1)

    def _logits(self, observation, features, symmetries):
        """Return the logits, shape (S · B, l² + 1), from the features; cells are in the order of the observation."""
        maps = observation["local"] * self.units
        seen = torch.cat([symmetry.maps(maps) for symmetry in symmetries]).contiguous(memory_format=torch.channels_last)
        chosen = self.choice(torch.relu(self.cells(seen) + self.context(features)[:, :, None, None]))
        parts = zip(chosen.chunk(len(symmetries)), symmetries, strict=True)
        cells = torch.cat([symmetry.restored(part) for part, symmetry in parts]).flatten(1)
        return torch.cat([cells, self.policy(features)], dim=1)

    def evaluate(self, observation, symmetry=IDENTITY, team=None):  # macro-actions are for one UAV
        """Return logits (B, l² + 1) and values (B,) of observations, which the network sees as a symmetry changes them."""
        features = self._features(observation, [symmetry])
        values = self.value(torch.cat([features, features], dim=1))[:, 0]
        return self._logits(observation, features, [symmetry]), values

    def agreed(self, observation):
        """Return the mean of the logarithmic probabilities over all symmetries, shape (B, l² + 1)."""
        features = self._features(observation, self.symmetries)
        logs = torch.log_softmax(self._logits(observation, features, self.symmetries), dim=1)
        return torch.stack(logs.chunk(len(self.symmetries))).mean(dim=0)


def network_of(scenario, kind, channels, blocks):
    """Return a network for a kind of macro-actions: directions are the six actions that the network of `ppo` knows."""
    return (MapNetwork if kind == "cells" else ppo.Network)(scenario, channels=channels, blocks=blocks)


class Learner(ppo.Learner):
    """A training: as in `ppo`, but decisions are noted only where a macro-action begins.

    At the end of each update's steps, macro-actions that are still flown end, and the next update begins with new ones.

    Parameters
    ----------
    scenario, config, seed : Scenario, Config, int
    """

    def __init__(self, scenario, config, seed):
        if scenario.team:
            raise ValueError(f"macro-actions are for one UAV; {scenario.id} is for teams")
        self._kind = MacroKind(config.kind, scenario.observation.local_size)
        super().__init__(scenario, config, seed)
        self._steps = ppo.Steps(config.steps, self._envs, 1, self._observation, self._kind.number)
        self._steps["discount"] = np.zeros((config.steps, self._envs), dtype=np.float32)

    def _network(self):
        """Return a new network."""
        return network_of(self.scenario, self.config.kind, self.config.channels, self.config.blocks)

    def _collect(self, symmetry, random):
        """Fly all environments, and note every decision; return the values of the states after the last step."""
        simulator, steps, state = self._simulator, self._steps, self._simulator.state
        every = np.arange(self._envs)
        flights = [None] * len(every)
        began = np.zeros_like(every)  # the step in which the slot's macro-action began
        factors = np.ones(len(every), dtype=np.float32)  # what the reward of its next move counts
        steps["flies"][:], steps["reward"][:] = False, 0.0
        for t in range(self.config.steps):
            self._observer.write(state, every, self._observation)
            allowed = simulator.action_mask()
            if self.config.safe_mask:
                allowed &= simulator.safe_action_mask()
            moves, deciding = self._go_on(flights, allowed)
            began[deciding], factors[deciding] = t, 1.0
            self._decide(t, deciding, allowed, flights, moves, symmetry, random)
            simulator.step(moves)
            steps["reward"][began, every] += self.config.reward_scale * factors * state.reward[:, 0]
            factors *= self._between("discount")
            steps["discount"][began, every], steps["over"][began, every] = factors, state.done[:, 0]
            over = np.flatnonzero(state.done[:, 0])
            for i in over:
                flights[i] = None
            if len(over):
                self._begin(over)
        self._observer.write(state, every, self._observation)
        nothing_forbidden = torch.ones((len(every), self._kind.number), dtype=torch.bool)
        with torch.no_grad():
            return self._evaluate(tensors(self._observation), nothing_forbidden, symmetry, None)[1].cpu().numpy()

    def _go_on(self, flights, allowed):
        """Return the next moves of all slots, and the slots that have to decide because their macro-action is over."""
        moves, deciding = np.zeros(len(flights), dtype=np.int64), []
        for i, flight in enumerate(flights):
            move = None if flight is None else flight.next(self._observation["local"][i], allowed[i])
            if move is None:
                deciding.append(i)
            else:
                moves[i] = move
        return moves, np.array(deciding, dtype=np.int64)

    def _decide(self, t, deciding, allowed, flights, moves, symmetry, random):
        """Choose macro-actions for some slots; note them, begin their flights, and write their first moves."""
        if not len(deciding):
            return
        steps, seen = self._steps, {name: part[deciding] for name, part in self._observation.items()}
        pairs = list(zip(seen["local"], allowed[deciding], strict=True))
        mask = np.stack([self._kind.mask(local, actions) for local, actions in pairs]) > 0
        with torch.no_grad():
            logs, values = self._evaluate(tensors(seen), tensor(mask), symmetry, None)
        logs = logs.cpu().numpy()
        chosen = (logs + random.gumbel(size=logs.shape)).argmax(axis=1)
        for name, part in seen.items():
            steps[name][t, deciding] = part
        noted = {"mask": mask, "value": values.cpu().numpy(), "flies": True, "action": chosen}
        noted["log"] = logs[np.arange(len(chosen)), chosen]
        for name, part in noted.items():
            steps[name][t, deciding] = part
        for i, action, (local, actions) in zip(deciding, chosen.tolist(), pairs, strict=True):
            flights[i] = self._kind.begin(action, local)
            moves[i] = flights[i].next(local, actions)

    def _returns(self, onward):
        """Return the targets of the values, shape (T, B): generalised advantage estimates, plus the values."""
        steps = self._steps
        returns, gain = np.zeros_like(steps["value"]), np.zeros_like(onward)
        for t in range(len(returns) - 1, -1, -1):
            decided, factor = steps["flies"][t], np.where(steps["over"][t], 0.0, steps["discount"][t])
            found = steps["reward"][t] + factor * (onward + self.config.trace * gain) - steps["value"][t]
            gain = np.where(decided, found, gain)
            onward = np.where(decided, steps["value"][t], onward)
            returns[t] = gain + steps["value"][t]
        return returns


class Agent(MacroAgent):
    """Takes the most probable macro-action among those that can begin, in the mean over all symmetries.

    Parameters
    ----------
    scenario : Scenario
    weights : Path, optional
        Weights that ``uavbench train`` wrote; by default those that come with uavbench.
    """

    def __init__(self, scenario, weights=None):
        path = weights or weights_path("macro_ppo", scenario)
        trained = training_record(path).get("config", {})
        self.kind = trained.get("kind", "cells")
        super().__init__(scenario)
        self.network = network_of(scenario, self.kind, trained.get("channels", 32), trained.get("blocks", 2))
        unpack_network(weights_for(path, scenario), self.network, path, scenario)
        self._symmetries = trained.get("symmetries", True)

    def choose(self, observation, mask, info):
        """Return the most probable macro-action."""
        seen = tensors({name: part[None] for name, part in observation.items()})
        with torch.no_grad():
            scores = (self.network.agreed(seen) if self._symmetries else self.network(seen)).cpu().numpy()[0]
        return int(np.where(mask > 0, scores, -math.inf).argmax())
