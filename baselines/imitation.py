"""Imitation: a policy that learns from a planner's advice, in the states to which the policy itself leads.

The learner flies (Ross, Gordon, Bagnell, AISTATS 2011, "DAgger"), and in every state a teacher says what each action is worth
(`uavbench.planning.advice`). The network learns to choose good actions: the better one is, the more probable it should be, and
equally good ones are equally probable. It also learns the state's value. Each sample is shown in a random symmetry.

The network and the agent are those of `ppo`, whose training can begin with these weights.
Needs PyTorch: ``pip install 'uavbench[ddqn]'``.
"""

import math
from dataclasses import dataclass

import numpy as np
import ppo
import torch
from torch import nn

from uavbench.agents.torch_state import arrays_of, moved, pack, tensor, tensors, unpack, unpack_network
from uavbench.agents.weights import weights_for
from uavbench.planning.advice import NEVER, Teacher
from uavbench.simulation.city_maps import CityWriter
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.state import index_targets, new_state
from uavbench.world.episode import train_numbers


@dataclass(frozen=True)
class Config:
    """How to train.

    Attributes
    ----------
    updates : int
        Gradient steps in all.
    num_envs, batch : int
        Episodes side by side, each of which takes a step before an update, and the samples that an update learns from.
    buffer_size, learning_starts : int
        States that are kept, and states before the first update.
    first, mending : int
        Changes that the teacher's search tries for the first plan of an episode, and at every later step.
    softness : float
        How much less an action may be worth to be e times less probable, as a share of what an average target is worth: a cell
        in CPP, a tenth of a device's data in DH.
    taught : float
        Until this share of the updates, some environments fly as the teacher advises: at first all, then fewer and fewer.
    curious : float
        The share of the environments that draw their actions by their probabilities.
    learning_rate, lr_warmup, lr_hold, weight_decay, clip, average : float
        AdamW's learning rate rises from 0 in ``lr_warmup`` updates, and falls to 0 along a cosine after the share ``lr_hold``
        of the updates. ``clip`` is the largest norm of a gradient. The weights that are kept are a moving average.
    value_share : float
        The share of the value in the loss.
    channels, blocks : int
        Width of the network's convolutions, and number of its residual blocks for each map.
    symmetries, half : bool
        Whether samples are shown in random symmetries, and whether to compute in bfloat16 where the processor can.
    validation : int
        Updates from one validation to the next.
    """

    updates: int = 8_000
    num_envs: int = 64
    batch: int = 256
    buffer_size: int = 500_000
    learning_starts: int = 5_000
    first: int = 30_000
    mending: int = 800
    softness: float = 1.0
    taught: float = 1.0
    curious: float = 0.1
    learning_rate: float = 1e-3
    lr_warmup: int = 100
    lr_hold: float = 0.3
    weight_decay: float = 1e-4
    clip: float = 2.0
    average: float = 0.998
    value_share: float = 0.5
    channels: int = 32
    blocks: int = 2
    symmetries: bool = True
    half: bool = True
    validation: int = 2_000


CONFIGS = {"fast": Config()}


class Buffer:
    """States of episodes, and what the actions of each UAV were worth in them. Observations are computed from states again."""

    def __init__(self, scenario, capacity):
        self._scenario, self._observer, self.capacity, self.written = scenario, Observer(scenario), capacity, 0
        uavs, cells = scenario.max_uavs, scenario.shape[0] * scenario.shape[1]
        self._sparse = scenario.mission.kind == "harvesting"
        spots = scenario.mission.max_targets if self._sparse else 0
        self.arrays = {
            "key": np.zeros(capacity, dtype=np.uint64),
            "cells": np.zeros((capacity, 0 if self._sparse else (cells + 7) // 8), dtype=np.uint8),
            "spots": np.zeros((capacity, spots, 2), dtype=np.int16),
            "data": np.zeros((capacity, spots), dtype=np.float32),
            "position": np.zeros((capacity, uavs, 2), dtype=np.int16),
            "budget": np.zeros((capacity, uavs), dtype=np.int16),
            "done": np.zeros((capacity, uavs), dtype=np.bool_),
            "worths": np.zeros((capacity, uavs, 6), dtype=np.float32),
        }
        self._scratch = {}

    def add(self, state, worths):
        """Store the states of all slots, and the worths of their UAVs' actions, shape (B, U, 6)."""
        at = (self.written + np.arange(len(worths))) % self.capacity
        if self._sparse:
            self.arrays["spots"][at] = state.spots
            rows = np.arange(len(worths))[:, None]
            self.arrays["data"][at] = state.target[rows, state.spots[..., 0], state.spots[..., 1]]
        else:
            self.arrays["cells"][at] = np.packbits(state.target.reshape(len(worths), -1) > 0, axis=1)
        values = {"key": state.key, "position": state.position, "budget": state.budget, "done": state.done, "worths": worths}
        for name, value in values.items():
            self.arrays[name][at] = value
        self.written += len(worths)

    def sample(self, count, random):
        """Return observations of random UAVs in random states, and what their actions were worth, shape (B, 6)."""
        at = random.integers(min(self.written, self.capacity), size=count)
        picked = {name: array[at] for name, array in self.arrays.items()}
        able = picked["worths"].max(axis=2) > NEVER
        uav = np.where(able, random.random(able.shape), -1.0).argmax(axis=1)
        state = self._restore(picked)
        index = np.arange(count) * self._scenario.max_uavs + uav
        observation = self._observer.empty(count * self._scenario.max_uavs)
        self._observer.write(state, index, observation)
        chosen = {name: values[index] for name, values in observation.items()}
        return tensors(chosen), tensor(picked["worths"][np.arange(count), uav])

    def _restore(self, picked):
        """Return a state with the stored ones in its slots."""
        count = len(picked["key"])
        if count not in self._scratch:
            state = new_state(self._scenario, count, self._scenario.max_uavs)
            self._scratch[count] = state, CityWriter(self._scenario, state.maps)
        state, cities = self._scratch[count]
        cities.enter(np.arange(count), picked["key"])
        if self._sparse:
            state.target[:] = 0.0
            state.target[np.arange(count)[:, None], picked["spots"][..., 0], picked["spots"][..., 1]] += picked["data"]
        else:
            flat = np.unpackbits(picked["cells"], axis=1, count=state.target[0].size)
            state.target[:] = flat.reshape(state.target.shape)
        index_targets(state)
        for name in ("position", "budget", "done"):
            getattr(state, name)[:] = picked[name]
        return state


class Learner:
    """A training: environments with a teacher, a buffer, and a network. `advance` makes one update.

    Parameters
    ----------
    scenario, config, seed : Scenario, Config, int
    """

    def __init__(self, scenario, config, seed):
        self.scenario, self.config, self.seed = scenario, config, seed
        torch.manual_seed(seed)
        with torch.device("cpu"):  # the first weights are the same on every device
            networks = [ppo.Network(scenario, channels=config.channels, blocks=config.blocks) for _ in range(2)]
        self.network, self._average = (moved(network) for network in networks)
        self._average.load_state_dict(self.network.state_dict())
        self._optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self._half = config.half and ppo.can_halve()
        self._buffer, self._observer = Buffer(scenario, config.buffer_size), Observer(scenario)
        self._simulator = Simulator(scenario, config.num_envs)
        self._teacher = Teacher(scenario, config.num_envs, first=config.first, mending=config.mending)
        self._observation = self._observer.empty(config.num_envs * scenario.max_uavs)
        self.updates = self._rounds = self._started = 0
        self._begin(np.arange(config.num_envs))

    def start_from(self, path):
        """Begin with the network of a weights file."""
        for network in (self.network, self._average):
            unpack_network(weights_for(path, self.scenario), network, path, self.scenario)

    @property
    def samples(self):
        """How many states have been learned from; a state counts each time that it is sampled."""
        return self.updates * self.config.batch

    def advance(self):
        """Take a step in every environment and make one update; return the values to plot."""
        while self._buffer.written < self.config.learning_starts:
            self._act()
        self._act()
        return self._learn()

    def _begin(self, slots):
        """Start the next episodes of the train split in ``slots``."""
        self._simulator.reset(slots, "train", train_numbers(self.seed, self._started, len(slots)))
        self._started += len(slots)
        self._teacher.begin(self._simulator, slots.tolist())

    def _random(self, purpose):
        """Return the random generator of this round for one purpose."""
        return np.random.default_rng((self.seed, self._rounds, purpose))

    def _act(self):
        """Store the states and the advice, and take a step in every environment."""
        config, simulator, random = self.config, self._simulator, self._random(0)
        state, team = simulator.state, self.scenario.max_uavs
        worths = self._teacher.worths(simulator, range(config.num_envs))
        self._buffer.add(state, worths)
        self._observer.write(state, np.arange(config.num_envs * team), self._observation)
        with torch.no_grad(), ppo.precision(self._half):
            logits = self.network(tensors(self._observation)).float().cpu().numpy().reshape(worths.shape)
        masks = (simulator.action_mask() & simulator.safe_action_mask()).reshape(worths.shape)
        scores = np.where(masks > 0, logits, -math.inf)
        curious = random.random(config.num_envs) < config.curious
        scores[curious] += random.gumbel(size=scores.shape)[curious]
        taught = random.random(config.num_envs) >= self.updates / (config.taught * config.updates + 1e-9)
        scores[taught] = np.where(masks[taught] > 0, worths[taught], -math.inf)
        actions = scores.argmax(axis=2)
        simulator.step(actions if self.scenario.team else actions[:, 0])
        self._rounds += 1
        over = np.flatnonzero(state.done.all(axis=1))
        if len(over):
            self._begin(over)

    def _learn(self):
        """Make one update."""
        config, random = self.config, self._random(1)
        observation, worths = self._buffer.sample(config.batch, random)
        best = worths.max(dim=1, keepdim=True).values
        wanted = torch.softmax((worths - best) / config.softness, dim=1)
        symmetries = self.network.symmetries
        symmetry = symmetries[random.integers(len(symmetries)) if config.symmetries else 0]
        with ppo.precision(self._half):
            logits, values = self.network.evaluate(observation, symmetry)
        logs = torch.log_softmax(logits.float(), dim=1)
        loss = -(wanted * logs).sum(dim=1).mean()
        error = (values.float() - best[:, 0] / 100.0).square().mean()
        self._optimizer.zero_grad()
        (loss + config.value_share * error).backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), config.clip)
        for group in self._optimizer.param_groups:
            group["lr"] = config.learning_rate * self._schedule()
        self._optimizer.step()
        self.updates += 1
        with torch.no_grad():
            keep = min(config.average, 1.0 - 1.0 / (self.updates + 1))
            for slow, own in zip(self._average.parameters(), self.network.parameters(), strict=True):
                slow.lerp_(own, 1.0 - keep)
            right = wanted.gather(1, logs.argmax(dim=1, keepdim=True)) > 0.99 * wanted.max(dim=1, keepdim=True).values
            excess = loss + (wanted * torch.log(wanted + 1e-9)).sum(dim=1).mean()
        return {"divergence": excess.item(), "value error": error.item(), "agreement": right.float().mean().item()}

    def _schedule(self):
        """Return the factor of the learning rate for this update."""
        config = self.config
        warm = min(1.0, (self.updates + 1) / config.lr_warmup) if config.lr_warmup else 1.0
        late = max(0.0, (self.updates / config.updates - config.lr_hold) / max(1 - config.lr_hold, 1e-9))
        return warm * (0.01 + 0.99 * (1 + math.cos(math.pi * min(late, 1.0))) / 2)

    def weights(self):
        """Return the arrays that the agent needs, by name."""
        return arrays_of(self._average)

    def snapshot(self):
        """Return everything that changes, as arrays by name."""
        arrays = pack({"network": self.network, "average": self._average}, self._optimizer)
        arrays |= {f"buffer.{name}": array for name, array in self._buffer.arrays.items()}
        arrays |= {f"simulator.{name}": array for name, array in self._simulator.snapshot().items()}
        arrays |= {f"teacher.{name}": array for name, array in self._teacher.snapshot().items()}
        return {**arrays, "counters": np.array([self.updates, self._rounds, self._started, self._buffer.written])}

    def resume(self, arrays):
        """Continue from a `snapshot` of a learner of the same scenario, configuration and seed."""
        unpack(arrays, {"network": self.network, "average": self._average}, self._optimizer)
        groups = {"buffer": {}, "simulator": {}, "teacher": {}}
        for name, array in arrays.items():
            group, _, part = name.partition(".")
            if group in groups:
                groups[group][part] = array
        for name, array in self._buffer.arrays.items():
            array[:] = groups["buffer"][name]
        self._simulator.resume(groups["simulator"])
        self._teacher.resume(groups["teacher"], self._simulator)
        self.updates, self._rounds, self._started, self._buffer.written = arrays["counters"].tolist()


class Agent(ppo.Agent):
    """The agent of `ppo` with weights of this training."""

    def __init__(self, scenario, weights=None):
        super().__init__(scenario, weights, name="imitation")
