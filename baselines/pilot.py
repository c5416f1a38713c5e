"""Pilot: remembers what it saw, estimates with a learned network what the averaged global map hides, and plans on the result.

It decides by the observation alone, as the paper's agent does, but uses more than that agent:

- the scenario's map, to find out where it is (the paper's agent sees the map too, but has to learn what it means);
- memory: after each move, the blocks of the global map contain other cells; together, they determine most cells
  (`uavbench.planning.belief`);
- in CPP a network, trained on episodes of the train split, which has learned how target zones look, for the other cells;
- the rules: it searches over whole flights, as `planner` does, and again whenever it has learned something new.

In DH it has no network, because all cells where a device may be are equally likely to hold one.
Needs PyTorch: ``pip install 'uavbench[ddqn]'``.
"""

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from planner import Agent as Planner
from torch import nn

from uavbench.agents.torch_state import pack, unpack, unpack_network
from uavbench.agents.weights import weights_for
from uavbench.planning.belief import DeviceBelief, TargetBelief, places, static
from uavbench.planning.harvesting import expected_rates
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import City, city_of, neighbour
from uavbench.world.episode import train_numbers
from uavbench.world.resources import shipped_weights


@dataclass
class Believed:
    """The parts of a state that `planner` reads, as far as they are known or estimated."""

    uav: int
    city: City
    position: tuple[int, int]
    budget: int
    target: Any
    device_cell: Any = None
    device_data: Any = None


class Flights(Planner):
    """The planner for a belief that changes: it searches less for the first flight, and in CPP improves it at every change."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.searches, self.changes = (2 if self._harvests else 1), 250_000
        if not self._harvests:  # in CPP a flight is improved only when something new is known, but then more
            self.mending_changes, self.mending_heat = 200_000, 1.0

    def revise(self, believed):
        """Take over new devices, or improve the flight for new targets."""
        if self._harvests:
            self._rates = expected_rates(self._scenario, believed.device_cell)
        elif self._flights:
            self._mend([believed])


class Agent:
    """Estimates where targets or data are, plans a flight, and plans again when it learns more.

    Parameters
    ----------
    scenario : Scenario
        A scenario for one UAV, with one map.
    weights : Path, optional
        The weights of the network; by default those that come with uavbench. If a scenario has none, only the sums of blocks
        are used.
    """

    track = "observation"

    def __init__(self, scenario, weights: Path | None = None):
        if scenario.team:
            raise ValueError(f"pilot flies one UAV; {scenario.id} is for teams: choose one without Team in its id")
        if scenario.cities is not None:
            raise ValueError(f"pilot knows its map, and {scenario.id} has many cities: choose a scenario with one map")
        self._scenario, self._planner = scenario, Flights(scenario)
        self._harvests = scenario.mission.kind == "harvesting"
        self._city, self._places = city_of(scenario), places(scenario)
        weights = weights or shipped_weights("pilot").get(scenario.id)
        self._network: Any = None if self._harvests or weights is None else load(weights, scenario)

    def reset(self, info):
        """Forget the last episode."""
        self._planner.reset(info)
        self._belief: Any = (DeviceBelief if self._harvests else TargetBelief)(self._scenario)
        self._target = np.zeros(self._scenario.shape, dtype=np.float32)

    def act(self, observation, info):
        """Return the next action of the best flight found for what is known and estimated."""
        here = self._places[static(observation["global"])]
        believed = Believed(0, self._city, here, int(observation["budget"][0]), self._target)
        (self._believe_devices if self._harvests else self._believe_targets)(believed, observation)
        return self._planner.act_team([observation], [{**info, "state": believed}])[0]

    def _believe_devices(self, believed, observation):
        """Set the believed devices; the planner improves its flight for their data at every step."""
        changed = self._belief.learn(believed.position, observation)
        believed.device_cell, believed.device_data = self._belief.devices()
        if changed:
            self._planner.revise(believed)

    def _believe_targets(self, believed, observation):
        """Set the believed target map; if it has changed in cells that were not known before, improve the flight."""
        belief, before = self._belief, self._target
        unknown = ~belief.known
        if belief.learn(believed.position, observation):
            self._guess = (belief.likely if self._network is None else self._complete(belief)) > 0.5
        believed.target = self._target = np.where(belief.known, belief.now, self._guess).astype(np.float32)
        if (self._target != before)[unknown].any():
            self._planner.revise(believed)

    def _complete(self, belief):
        """Return the network's probability of each cell that it is a target, shape (M, N)."""
        with torch.no_grad():
            return torch.sigmoid(self._network(torch.from_numpy(layers(belief)[None])))[0].numpy()


# The network and its training.


def layers(belief):
    """Return the network's input for a belief, shape (4, M, N).

    The layers are the known cells, the targets at the start among them, the probabilities of targets in the other cells, and
    the cells where the probability is 0.
    """
    likely = np.where(belief.known, 0.0, belief.likely)
    return np.stack([belief.known, belief.known * belief.first, likely, belief.likely == 0.0]).astype(np.float32)


class Network(nn.Module):
    """Returns the logit of each cell's probability to be a target: that of the belief, plus what convolutions add."""

    def __init__(self, channels, depth):
        super().__init__()
        steps = []
        for width, out in itertools.pairwise([4, *[channels] * depth]):
            steps += [nn.Conv2d(width, out, 3, padding=1), nn.ReLU(inplace=True)]
        self.added = nn.Sequential(*steps, nn.Conv2d(channels, 1, 1))

    def forward(self, seen):
        """Return logits, shape (B, M, N), for `layers` of beliefs, shape (B, 4, M, N)."""
        return torch.logit(seen[:, 2], eps=0.02) + self.added(seen)[:, 0]


@dataclass(frozen=True)
class Config:
    """How to train.

    Attributes
    ----------
    updates : int
        Gradient steps in all.
    episodes, views : int
        What an update learns from: the number of episodes, and of cells on a path through each. Each cell gives a belief.
    channels, depth : int
        Width and number of the network's 3×3 convolutions.
    learning_rate : float
        Adam's learning rate at the start; it falls to 0 along a cosine.
    validation, validation_episodes : int
        Updates from one validation to the next, and episodes of each validation.
    """

    updates: int = 600
    episodes: int = 24
    views: int = 8
    channels: int = 32
    depth: int = 5
    learning_rate: float = 2e-3
    validation: int = 600
    validation_episodes: int = 20


CONFIGS = {"fast": Config()}


class Learner:
    """A training on the beliefs along random paths through train episodes, with the true targets as labels."""

    def __init__(self, scenario, config, seed):
        if scenario.mission.kind != "coverage":
            raise ValueError(f"{scenario.id}: pilot learns nothing in DH: it flies without training")
        self.scenario, self.config, self.seed, self.updates = scenario, config, seed, 0
        torch.manual_seed(seed)
        self.network = Network(config.channels, config.depth)
        self._optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate, fused=True)
        self._simulator, self._observer = Simulator(scenario, config.episodes), Observer(scenario)

    @property
    def samples(self):
        """How many beliefs have been learned from."""
        return self.updates * self.config.episodes * self.config.views

    def advance(self):
        """Make one update; return the values to plot."""
        config = self.config
        seen, wanted, asked = (torch.from_numpy(part) for part in self._draw())
        for group in self._optimizer.param_groups:
            group["lr"] = config.learning_rate * (1 + math.cos(math.pi * self.updates / config.updates)) / 2
        logits = self.network(seen)
        loss = torch.nn.functional.binary_cross_entropy_with_logits(logits[asked], wanted[asked])
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        self.updates += 1
        with torch.no_grad():
            wrong = ((logits > 0.0) != (wanted > 0.5))[asked].float().mean().item()
            before = ((seen[:, 2] > 0.5) != (wanted > 0.5))[asked].float().mean().item()
        return {"loss": loss.item(), "wrong": wrong, "wrong before": before}

    def _draw(self):
        """Return the `layers` of beliefs, the true targets, and the cells that count: not known, with a probability above 0."""
        config, simulator, scenario = self.config, self._simulator, self.scenario
        index = np.arange(config.episodes)
        simulator.reset(index, "train", train_numbers(self.seed, self.updates * config.episodes, config.episodes))
        random = np.random.default_rng((self.seed, self.updates))
        city, state = simulator.city, simulator.state
        free = np.argwhere(city.distance_to_landing >= 0)
        goals = free[random.integers(len(free), size=config.episodes)]
        ways = [_way(city, tuple(state.position[i, 0].tolist()), tuple(goals[i].tolist()), config.views, random) for i in index]
        beliefs = [TargetBelief(scenario) for _ in index]
        observation = self._observer.empty(config.episodes)
        seen, asked = [], []
        for view in range(config.views):
            state.position[:, 0] = [way[view] for way in ways]
            self._observer.write(state, index, observation)
            for i in index:
                beliefs[i].learn(ways[i][view], {name: part[i] for name, part in observation.items()})
                seen.append(layers(beliefs[i]))
                asked.append(~beliefs[i].known & (beliefs[i].likely > 0.0))
        wanted = np.tile(state.target, (config.views, 1, 1))
        return np.array(seen), wanted, np.array(asked)

    def weights(self):
        """Return the network's arrays, by name."""
        return {name: tensor.numpy() for name, tensor in self.network.state_dict().items()}

    def snapshot(self):
        """Return everything that changes, as arrays by name."""
        return {**pack({"network": self.network}, self._optimizer), "counters": np.array([self.updates])}

    def resume(self, arrays):
        """Continue from a `snapshot`."""
        unpack(arrays, {"network": self.network}, self._optimizer)
        self.updates = int(arrays["counters"][0])


def load(weights, scenario):
    """Return the network with the weights of a file."""
    arrays = weights_for(weights, scenario)
    depth = sum(array.ndim == 4 for array in arrays.values()) - 1
    first = arrays.get("added.0.weight")
    network = Network(1 if first is None else len(first), depth)
    unpack_network(arrays, network, weights, scenario)
    return network


def _way(city, here, goal, count, random):
    """Return the first ``count`` cells of a random shortest path from ``here`` to ``goal``, which is repeated at the end."""
    left, way = city.distances(goal), [here]
    while len(way) < count:
        near = [neighbour(way[-1], action) for action in range(4)]
        inside = [cell for cell in near if 0 <= cell[0] < left.shape[0] and 0 <= cell[1] < left.shape[1]]
        nearer = [cell for cell in inside if left[cell] >= 0 and left[cell] == left[way[-1]] - 1]
        way.append(nearer[random.integers(len(nearer))] if nearer else way[-1])
    return way
