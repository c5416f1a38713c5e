"""DDQN: the paper's agent, which learns Q-values from the global and the local map, and how it is trained.

Theile, Bayerlein, Nai, Gesbert, Caccamo, ICAR 2021: the network (fig. 1, table I), double Q-learning (eqs. 17, 18; van
Hasselt, Guez, Silver, AAAI 2016), softmax exploration, combined experience replay (Zhang, Sutton 2017). The configuration
``paper`` is theirs. ``fast`` trains the same network by the same double Q-learning, but in many environments at once, and on
segments of several steps with λ-returns (Peng, Williams, ICML 1994); a share of its episodes starts in any cell.

Needs PyTorch: ``pip install 'uavbench[ddqn]'``.
"""

import itertools
import math
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from torch import nn
from torch.nn.functional import huber_loss, mse_loss

from uavbench.agents.torch_state import arrays_of, moved, pack, tensor, tensors, unpack, unpack_network
from uavbench.agents.weights import weights_for, weights_path
from uavbench.simulation.city_maps import CityWriter
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.state import index_targets, new_state
from uavbench.world.city import NUM_ACTIONS
from uavbench.world.episode import train_numbers


@dataclass(frozen=True)
class Config:
    """How to train. Where a field has a ``last_`` twin, the value changes evenly from the first to the last in a training.

    Attributes
    ----------
    updates : int
        Gradient steps in all.
    num_envs : int
        Episodes side by side. Each round is a step in all of them and one update, after the first ``learning_starts`` steps.
    batch, segment : int
        How many segments an update learns from, and how many steps each segment has.
    td_lambda : float
        λ of the returns: 0 for one-step targets, 1 for everything that was collected until the end of the segment.
    buffer_size, learning_starts : int
        Steps that the replay buffer holds, and random steps before the first update.
    discount, soft_update, temperature : float
        The paper's γ, τ and softmax temperature; the temperature is in units of the scaled reward.
    reward_scale, crash_scale, budget_scale : float
        Factors of all rewards, of the reward of a crash besides, and of the budget as an input of the network.
    learning_rate, last_learning_rate : float
        Adam's learning rate, and the share of it that is left at the end, to which it falls along a cosine.
    lr_warmup, lr_hold : int, float
        Updates in which the learning rate rises from 0, and the share of the updates after which it begins to fall.
    amsgrad : bool
        Whether Adam is used in its AMSGrad variant.
    huber, clip : float
        The error from which the loss is linear, and the largest norm of a gradient; 0 turns either off.
    random_start_fraction, last_random_start_fraction : float
        Share of episodes that start in any cell, with any budget that suffices to land.
    safe_exploration, last_safe_exploration : float
        Share of the environments that try only safe actions, after which landing is still possible. Without any, the first
        thing learned is to land at once; with all of them, landing is never learned.
    validation : int
        Updates from one validation to the next.
    """

    updates: int
    num_envs: int = 1
    batch: int = 128
    segment: int = 1
    td_lambda: float = 0.0
    buffer_size: int = 50_000
    learning_starts: int = 25_000
    discount: float = 0.95
    soft_update: float = 0.005
    temperature: float = 0.1
    reward_scale: float = 1.0
    crash_scale: float = 1.0
    budget_scale: float = 1.0
    learning_rate: float = 3e-5
    last_learning_rate: float = 1.0
    lr_warmup: int = 0
    lr_hold: float = 1.0
    amsgrad: bool = True
    huber: float = 0.0
    clip: float = 0.0
    random_start_fraction: float = 0.0
    last_random_start_fraction: float = 0.0
    safe_exploration: float = 0.0
    last_safe_exploration: float = 0.0
    validation: int = 1000

    def __post_init__(self):
        for name, value in asdict(self).items():
            low = int(type(value) is int and name not in ("learning_starts", "lr_warmup"))
            high = 1 if name in _SHARES or name.startswith("last_") else math.inf
            if not low <= value <= high or (name == "temperature" and value == 0):
                raise ValueError(f"{name}: {value} is not from {low} to {high}")
        if self.buffer_size < self.num_envs * (self.segment + 2):
            needed = f"num_envs = {self.num_envs} and segment = {self.segment} need {self.num_envs * (self.segment + 2)} steps"
            raise ValueError(f"buffer_size: {self.buffer_size} is too small: {needed}")


_SHARES = ("td_lambda", "discount", "soft_update", "lr_hold", "random_start_fraction", "safe_exploration")
_FAST = Config(
    updates=30_000,
    num_envs=128,
    batch=64,
    segment=8,
    td_lambda=0.7,
    buffer_size=65_536,
    learning_starts=8_192,
    temperature=0.01,
    reward_scale=0.1,
    budget_scale=0.1,
    learning_rate=5e-4,
    last_learning_rate=0.02,
    lr_warmup=200,
    lr_hold=0.3,
    amsgrad=False,
    huber=1.0,
    clip=5.0,
    random_start_fraction=0.5,
    last_random_start_fraction=0.1,
    safe_exploration=0.9,
    last_safe_exploration=0.5,
)
# Continues from weights of `fast`, to land more reliably: crashes cost more, and a squared loss counts rare ones in full.
_FINISH = replace(_FAST, updates=6_000, validation=2_000, learning_rate=1e-4, lr_hold=0.2, crash_scale=20.0, huber=0.0)
_FINISH = replace(_FINISH, random_start_fraction=0.1, safe_exploration=0.0, last_safe_exploration=0.0)
CONFIGS = {"paper": Config(updates=2_000_000, validation=20_000), "fast": _FAST, "finish": _FINISH}


class Network(nn.Module):
    """Q-values of the six actions, from both maps and the budget (the paper's fig. 1).

    Parameters
    ----------
    observer : Observer
        The observer whose observations are the input; it determines their shapes.
    kernels, kernel_size, hidden : int
        The paper's n_k = 16 and s_k = 5, and the width of its three dense layers.
    budget_scale : float
        The factor by which the budget is multiplied.
    """

    def __init__(self, observer, kernels=16, kernel_size=5, hidden=256, budget_scale=1.0):
        super().__init__()
        shapes = {"local": observer.local_shape, "global": observer.global_shape}
        self.maps = [name for name, shape in shapes.items() if shape[1]]
        self.register_buffer("budget_scale", torch.tensor([float(budget_scale)]))
        self.branches = nn.ModuleDict()
        self.inputs = 1  # of the first dense layer, the paper's N (Table IV); this one is the budget
        for name in self.maps:
            layers, height, width = shapes[name]
            size = min(kernel_size, (height + 1) // 2, (width + 1) // 2)  # so that two convolutions fit a tiny map, too
            pair = [(nn.Conv2d(channels, kernels, size), nn.ReLU(inplace=True)) for channels in (layers, kernels)]
            self.branches[f"{name}_map"] = nn.Sequential(*itertools.chain(*pair))
            self.inputs += kernels * (height - 2 * (size - 1)) * (width - 2 * (size - 1))
        self.branches.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        widths = [self.inputs, hidden, hidden, hidden]
        dense = [layer for pair in itertools.pairwise(widths) for layer in (nn.Linear(*pair), nn.ReLU(inplace=True))]
        self.dense = nn.Sequential(*dense, nn.Linear(hidden, NUM_ACTIONS))

    def forward(self, observation):
        """Return Q-values, shape (B, 6), of a batch of observations."""
        maps = [self.branches[f"{name}_map"](observation[name]) for name in self.maps]
        flat = [each.permute(0, 2, 3, 1).flatten(1) for each in maps]  # in memory order, so nothing is copied
        return self.dense(torch.cat([*flat, self.budget_scale * observation["budget"]], dim=1))


class Replay:
    """The last steps of all environments: state before, action, reward, end. Observations are computed again from states."""

    def __init__(self, scenario, num_envs, capacity):
        self._scenario, self._observer = scenario, Observer(scenario)
        self.length = max(2, capacity // num_envs)
        self.written = 0
        shape, exact = (self.length, num_envs), scenario.mission.kind == "coverage"
        self.arrays = {
            "target": np.zeros((*shape, *scenario.shape), dtype=np.bool_ if exact else np.float16),
            "key": np.zeros(shape, dtype=np.uint64),  # which gives the city
            "position": np.zeros((*shape, 2), dtype=np.int16),
            "budget": np.zeros(shape, dtype=np.int16),
            "action": np.zeros(shape, dtype=np.int64),
            "reward": np.zeros(shape, dtype=np.float32),
            "done": np.zeros(shape, dtype=np.bool_),
            "layers": np.zeros((*shape, len(scenario.mission.layers), *scenario.shape), dtype=np.float16),
        }
        self._scratch = {}

    def add_states(self, state):
        """Begin a step: store the states of the environments."""
        at = self.written % self.length
        self.arrays["target"][at] = state.target
        self.arrays["layers"][at] = state.layers
        self.arrays["key"][at] = state.key
        self.arrays["position"][at] = state.position[:, 0]
        self.arrays["budget"][at] = state.budget[:, 0]

    def add_results(self, actions, rewards, done):
        """End the step: store its results."""
        at = self.written % self.length
        for name, values in {"action": actions, "reward": rewards, "done": done}.items():
            self.arrays[name][at] = values
        self.written += 1

    def sample(self, batch, segment, random):
        """Return random segments: observations of their ``segment`` + 1 states, actions, rewards, ends; time first.

        One of them always ends with the newest step whose next state is stored (combined experience replay).
        """
        kept = min(self.written, self.length) - 1  # without the last step, whose next state is not stored yet
        back = random.integers(segment, kept + 1, batch)
        back[0] = segment
        environment = random.integers(self.arrays["done"].shape[1], size=batch)
        time = (self.written - 1 - back + np.arange(segment + 1)[:, None]) % self.length
        picked = {name: values[time, environment] for name, values in self.arrays.items()}
        return self._observe(picked), *(picked[name][:-1] for name in ("action", "reward", "done"))

    def _observe(self, picked):
        """Return the observations of states, time first, as one batch."""
        count = picked["budget"].size
        if count not in self._scratch:
            state = new_state(self._scenario, count, 1)
            self._scratch[count] = state, CityWriter(self._scenario, state.maps)
        state, cities = self._scratch[count]
        cities.enter(np.arange(count), picked["key"].reshape(-1))
        state.target[:] = picked["target"].reshape(state.target.shape)
        index_targets(state)
        state.layers[:] = picked["layers"].reshape(state.layers.shape)
        state.position[:, 0] = picked["position"].reshape(-1, 2)
        state.budget[:, 0] = picked["budget"].reshape(-1)
        observation = self._observer.empty(count)
        self._observer.write(state, np.arange(count), observation)
        return tensors(observation)


class Learner:
    """A training: environments, replay buffer and network. `advance` makes one update.

    All random numbers depend only on the seed and on stored counters, so an interrupted training continues unchanged.

    Parameters
    ----------
    scenario, config, seed : Scenario for one UAV, Config, int
    """

    def __init__(self, scenario, config, seed):
        if scenario.team:
            raise ValueError(f"ddqn learns to fly one UAV; {scenario.id} is for teams")
        self.scenario, self.config, self.seed = scenario, config, seed
        torch.manual_seed(seed)
        self._observer = Observer(scenario)
        with torch.device("cpu"):  # the first weights are the same on every device
            networks = [Network(self._observer, budget_scale=config.budget_scale) for _ in range(2)]
        self.network, self._target = (moved(network) for network in networks)
        self._target.load_state_dict(self.network.state_dict())
        rate, amsgrad = config.learning_rate, config.amsgrad
        self._optimizer = torch.optim.Adam(self.network.parameters(), lr=rate, amsgrad=amsgrad, fused=True)
        self._replay = Replay(scenario, config.num_envs, config.buffer_size)
        self._simulator = Simulator(scenario, config.num_envs)
        self._observation = self._observer.empty(config.num_envs)
        self._all = np.arange(config.num_envs)
        self.updates = self._rounds = self._started = 0
        self._begin(self._all)

    def start_from(self, path):
        """Begin with the network of a weights file."""
        for network in (self.network, self._target):
            unpack_network(weights_for(path, self.scenario), network, path, self.scenario)

    @property
    def samples(self):
        """How many steps have been learned from; a step counts each time that it is sampled."""
        return self.updates * self.config.batch * self.config.segment

    def advance(self):
        """Take a step in every environment and make one update; return the values to plot."""
        config, memory = self.config, self._replay
        while memory.written * config.num_envs < config.learning_starts or memory.written <= config.segment:
            self._act(explore=True)
        self._act()
        return self._learn()

    def _begin(self, index):
        """Start the next episodes of the train split in the slots ``index``; a share of them starts in any cell."""
        self._simulator.reset(index, "train", train_numbers(self.seed, self._started, len(index)))
        share = self._between(self.config.random_start_fraction, self.config.last_random_start_fraction)
        self._simulator.scatter(index[self._random(1).random(len(index)) < share])
        self._started += len(index)

    def _between(self, first, last):
        """Return the value for this update of a share that changes evenly from ``first`` to ``last``."""
        return first + (last - first) * self.updates / self.config.updates

    def _random(self, purpose):
        """Return the random generator of this round for one purpose."""
        return np.random.default_rng((self.seed, self._rounds, purpose))

    def _act(self, explore=False):
        """Take and store a step in every environment, by softmax over the Q-values, or uniformly if ``explore``."""
        config, simulator, random = self.config, self._simulator, self._random(0)
        state = simulator.state
        score = random.gumbel(size=(config.num_envs, NUM_ACTIONS))  # argmax of values + gumbel samples their softmax
        if not explore:
            self._observer.write(state, self._all, self._observation)
            with torch.no_grad():
                score += self.network(tensors(self._observation)).cpu().numpy() / config.temperature
        safe = self._all < self._between(config.safe_exploration, config.last_safe_exploration) * config.num_envs
        score[safe] += np.where(simulator.safe_action_mask()[safe], 0.0, -np.inf)
        actions = score.argmax(axis=1)
        self._replay.add_states(state)
        simulator.step(actions)
        crash = (config.crash_scale - 1.0) * self.scenario.rewards.crash * (state.done & ~state.landed)
        self._replay.add_results(actions, config.reward_scale * (state.reward + crash)[:, 0], state.done[:, 0])
        self._rounds += 1
        over = np.flatnonzero(state.done[:, 0])
        if len(over):
            self._begin(over)

    def _learn(self):
        """Make one update."""
        config = self.config
        observation, actions, rewards, ends = self._replay.sample(config.batch, config.segment, self._random(2))
        size = config.batch * config.segment
        values = self.network({name: part[:size] for name, part in observation.items()})
        with torch.no_grad():
            last = self.network({name: part[size:] for name, part in observation.items()})
            best = torch.cat([values.detach()[config.batch :], last]).argmax(dim=1, keepdim=True)
            onward = self._target({name: part[config.batch :] for name, part in observation.items()})
            bootstraps = onward.gather(1, best).reshape(-1, config.batch).cpu().numpy()
        targets = tensor(self._returns(rewards, ends, bootstraps).reshape(-1))
        chosen = values.gather(1, tensor(actions.reshape(-1, 1)))[:, 0]
        loss = huber_loss(chosen, targets, delta=config.huber) if config.huber else mse_loss(chosen, targets)
        self._optimizer.zero_grad()
        loss.backward()
        if config.clip:
            nn.utils.clip_grad_norm_(self.network.parameters(), config.clip)
        for group in self._optimizer.param_groups:
            group["lr"] = config.learning_rate * self._schedule()
        self._optimizer.step()
        with torch.no_grad():
            for slow, own in zip(self._target.parameters(), self.network.parameters(), strict=True):
                slow.lerp_(own, config.soft_update)
        self.updates += 1
        return {"loss": loss.item(), "value": values.detach().mean().item()}

    def _returns(self, rewards, ends, bootstraps):
        """Return the targets of all steps, shape (T, B): λ-returns from the values of the next states; eq. 18 if λ = 0."""
        config, targets = self.config, np.empty_like(rewards)
        onward = bootstraps[-1]
        for t in range(len(rewards) - 1, -1, -1):
            onward = (1 - config.td_lambda) * bootstraps[t] + config.td_lambda * onward
            onward = targets[t] = rewards[t] + config.discount * np.where(ends[t], 0.0, onward)
        return targets

    def _schedule(self):
        """Return the factor of the learning rate for this update."""
        config = self.config
        warm = min(1.0, (self.updates + 1) / config.lr_warmup) if config.lr_warmup else 1.0
        late = max(0.0, (self.updates / config.updates - config.lr_hold) / max(1 - config.lr_hold, 1e-9))
        last = config.last_learning_rate
        return warm * (last + (1 - last) * (1 + math.cos(math.pi * min(late, 1.0))) / 2)

    def weights(self):
        """Return the arrays that the agent needs, by name."""
        return arrays_of(self.network)

    def snapshot(self):
        """Return everything that changes, as arrays by name."""
        arrays = pack({"network": self.network, "target": self._target}, self._optimizer)
        arrays |= {f"replay.{name}": array for name, array in self._replay.arrays.items()}
        arrays |= {f"simulator.{name}": array for name, array in self._simulator.snapshot().items()}
        return {**arrays, "counters": np.array([self.updates, self._rounds, self._started, self._replay.written])}

    def resume(self, arrays):
        """Continue from a `snapshot` of a learner of the same scenario, configuration and seed."""
        unpack(arrays, {"network": self.network, "target": self._target}, self._optimizer)
        for name, array in self._replay.arrays.items():
            array[:] = arrays[f"replay.{name}"]
        simulator = {name.removeprefix("simulator."): array for name, array in arrays.items() if name.startswith("simulator.")}
        self._simulator.resume(simulator)
        self.updates, self._rounds, self._started, self._replay.written = arrays["counters"].tolist()


class Agent:
    """Takes the action with the highest Q-value.

    Parameters
    ----------
    scenario : Scenario
    weights : Path, optional
        Weights that ``uavbench train`` wrote; by default those that come with uavbench.
    """

    def __init__(self, scenario, weights=None):
        path = weights or weights_path("ddqn", scenario)
        self.network = Network(Observer(scenario))
        unpack_network(weights_for(path, scenario), self.network, path, scenario)

    def act_batch(self, observations, infos):
        """Return the action with the highest Q-value for each running episode."""
        with torch.no_grad():
            return self.network(tensors(observations)).argmax(dim=1).cpu().numpy()
