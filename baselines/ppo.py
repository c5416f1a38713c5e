"""PPO: a policy that decides in one pass from the observation, and how it is trained by proximal policy optimisation.

Schulman, Wolski, Dhariwal, Radford, Klimov, "Proximal policy optimization algorithms", 2017, with what has been learned since
the paper of this suite; each part can be switched off in the configuration:

- actions that are not safe, after which landing is not possible any more, are never taken (`safe_mask`);
- the network learns in all rotations and reflections of the map, and decides by the mean over them (`symmetries`);
- the discount factor rises from 0.95 to nearly 1 in the course of the training;
- residual convolutions (He, Zhang, Ren, Sun, CVPR 2016) on both maps, and the budget in several scales.

In a team all UAVs have the same network, and each decides by its own observation. Only the value, which is needed in training,
is computed from what all UAVs of the team see (Yu et al., "The surprising effectiveness of PPO in cooperative multi-agent
games", NeurIPS 2022).

Needs PyTorch: ``pip install 'uavbench[ddqn]'``.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn.functional import relu

from uavbench.agents.symmetries import IDENTITY, symmetries_of
from uavbench.agents.torch_state import arrays_of, moved, pack, tensor, tensors, unpack, unpack_network
from uavbench.agents.weights import training_record, weights_for, weights_path
from uavbench.learning.group import group
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import NUM_ACTIONS
from uavbench.world.episode import train_numbers

#: Each process of a training has so many train episodes of its own.
_EPISODES = 2**30


@dataclass(frozen=True)
class Config:
    """How to train. Where a field has a ``last_`` twin, the value changes evenly from the first to the last in a training.

    Attributes
    ----------
    updates : int
        How often steps are collected and learned from.
    num_envs, steps : int
        Episodes side by side, and the steps that are collected in each of them for an update.
    epochs, minibatch : int
        How often each step is learned from in an update, and how many steps a gradient is computed from.
    critic_first : int
        Updates at the beginning in which only the value is learned, for a training that starts from weights.
    clip, divergence : float
        How much more or less probable an action may become in an update (PPO's ε), and the divergence (Kullback-Leibler) of the
        policy from that before the update at which the update ends.
    discount, last_discount, trace : float
        γ, and λ of the generalised advantage estimate (Schulman, Moritz, Levine, Jordan, Abbeel, ICLR 2016).
    entropy, last_entropy, value_share : float
        Shares of the entropy and of the error of the value in the loss.
    reward_scale : float
        The factor of all rewards.
    learning_rate, last_learning_rate, max_norm : float
        Adam's learning rate, and the largest norm of a gradient.
    random_start_fraction, last_random_start_fraction : float
        Share of episodes that start in any cell, with any budget that suffices to land; not for teams.
    channels, blocks : int
        Width of the network's convolutions, and number of its residual blocks for each map.
    safe_mask, symmetries, half : bool
        Whether to take safe actions only, whether to learn and decide in all symmetries, and whether to compute in bfloat16
        where the processor can.
    validation : int
        Updates from one validation to the next.
    """

    updates: int = 1_000
    num_envs: int = 64
    steps: int = 64
    epochs: int = 3
    minibatch: int = 512
    critic_first: int = 0
    clip: float = 0.2
    divergence: float = 0.03
    discount: float = 0.95
    last_discount: float = 0.995
    trace: float = 0.9
    entropy: float = 0.01
    last_entropy: float = 0.001
    value_share: float = 0.5
    reward_scale: float = 0.05
    learning_rate: float = 5e-4
    last_learning_rate: float = 1e-5
    max_norm: float = 1.0
    random_start_fraction: float = 0.3
    last_random_start_fraction: float = 0.0
    channels: int = 32
    blocks: int = 2
    safe_mask: bool = True
    symmetries: bool = True
    half: bool = True
    validation: int = 50


#: `fast` begins from nothing, `finish` from weights of `imitation` (``--from``).
CONFIGS = {
    "fast": Config(),
    "finish": Config(
        updates=600,
        critic_first=20,
        clip=0.1,
        discount=0.995,
        last_discount=0.998,
        entropy=0.002,
        learning_rate=1e-4,
        random_start_fraction=0.0,
    ),
}


class Residual(nn.Module):
    """Two 3×3 convolutions, to whose result the input is added (He, Zhang, Ren, Sun, CVPR 2016)."""

    def __init__(self, channels):
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, maps):
        """Return maps of the same shape."""
        return relu(maps + self.second(relu(self.first(maps))))


class Network(nn.Module):
    """Logits of the six actions and the value of the state, from both maps and the budget.

    Parameters
    ----------
    scenario : Scenario
        The scenario whose observations are the input.
    channels, blocks, flat, hidden : int
        Width of the convolutions, number of residual blocks for each map, width of the maps when they enter the dense layers,
        and width of these.
    """

    def __init__(self, scenario, channels=32, blocks=2, flat=8, hidden=256):
        super().__init__()
        observer, scale = Observer(scenario), scenario.observation.global_scale
        shapes = {"local": observer.local_shape, "global": observer.global_shape}
        self.maps = [name for name, shape in shapes.items() if shape[1]]
        self.symmetries = symmetries_of(scenario.shape)
        units = {"target": 1.0 if scenario.mission.kind == "coverage" else 0.1, "budgets": 0.01}
        self.register_buffer("units", torch.tensor([units.get(layer, 1.0) for layer in observer.layers])[:, None, None])
        # How far the UAV is from the middle of the global map, in blocks: its last rows and columns may be cut off.
        middle = [(side - 1 - ((2 * side - 1) // scale * scale - 1) / 2) / scale for side in scenario.shape]
        self.register_buffer("middle", torch.tensor(middle))
        self.branches = nn.ModuleDict()
        inputs = 6
        for name in self.maps:
            layers, height, width = shapes[name]
            body = [Residual(channels) for _ in range(blocks)]
            stem = nn.Conv2d(layers, channels, 4, stride=2, padding=2)
            self.branches[f"{name}_map"] = nn.Sequential(stem, nn.ReLU(), *body, nn.Conv2d(channels, flat, 1), nn.ReLU())
            inputs += flat * (height // 2 + 1) * (width // 2 + 1)
        self.branches.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.dense = nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.policy, self.value = nn.Linear(hidden, NUM_ACTIONS), nn.Linear(2 * hidden, 1)
        with torch.no_grad():
            self.policy.weight.mul_(0.1)

    def _features(self, observation, symmetries):
        """Return features of observations as each of some symmetries changes them, shape (S · B, hidden)."""
        flat = []
        for name in self.maps:
            maps = observation[name] * self.units
            seen = torch.cat([symmetry.maps(maps) for symmetry in symmetries])
            flat.append(self.branches[f"{name}_map"](seen.contiguous(memory_format=torch.channels_last)).flatten(1))
        budget = observation["budget"] / 100.0
        numbers = torch.cat([budget, budget * budget, budget.sqrt(), torch.exp(-10.0 * budget)], dim=1)
        down, right = self.get_buffer("middle")
        middles = [torch.stack(symmetry.direction(down, right)).expand(len(budget), 2) for symmetry in symmetries]
        return self.dense(torch.cat([*flat, numbers.repeat(len(symmetries), 1), torch.cat(middles)], dim=1))

    def evaluate(self, observation, symmetry=IDENTITY, team=None):
        """Return logits (B, 6) and values (B,) of observations, which the network sees as a symmetry changes them.

        ``team`` (B,) says which team each observation belongs to; without it, each is a team of its own.
        """
        features = self._features(observation, [symmetry])
        together = features
        if team is not None:
            size = torch.bincount(team).clamp(min=1)[:, None]
            together = (torch.zeros(len(size), features.shape[1], dtype=features.dtype).index_add(0, team, features) / size)[
                team
            ]
        return self.policy(features)[:, list(symmetry.actions)], self.value(torch.cat([features, together], dim=1))[:, 0]

    def forward(self, observation):
        """Return logits, shape (B, 6), of a batch of observations."""
        return self.evaluate(observation)[0]

    def agreed(self, observation):
        """Return the mean of the logarithmic probabilities over all symmetries, shape (B, 6)."""
        logs = torch.log_softmax(self.policy(self._features(observation, self.symmetries)), dim=1)
        parts = logs.reshape(len(self.symmetries), -1, NUM_ACTIONS)
        turned = [part[:, list(each.actions)] for part, each in zip(parts, self.symmetries, strict=True)]
        return torch.stack(turned).mean(dim=0)


def can_halve():
    """Return whether PyTorch's default device computes in bfloat16."""
    device = torch.get_default_device().type
    if device == "cpu":
        found = torch.cpu.get_capabilities()
        return bool(found.get("avx512_bf16") or found.get("amx_bf16"))
    return device == "cuda" and torch.cuda.is_bf16_supported()


def precision(half):
    """Return the context in which a network computes on PyTorch's default device: in bfloat16 if ``half``, else in float32."""
    return torch.autocast(torch.get_default_device().type, dtype=torch.bfloat16, enabled=half)


class Evaluation(nn.Module):
    """`Network.evaluate` as a module of its own, as PyTorch wants it for averaging gradients over processes."""

    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, observation, symmetry, team):
        """Return logits and values."""
        return self.network.evaluate(observation, symmetry, team)


class Steps(dict):
    """What was seen and done in an update: arrays by name, (T, B, U, …), of which only those count where a UAV flies."""

    def __init__(self, steps, envs, uavs, observation, actions=NUM_ACTIONS):
        super().__init__(
            {name: np.zeros((steps, envs * uavs, *part.shape[1:]), np.float32) for name, part in observation.items()}
        )
        shape = (steps, envs * uavs)
        self["mask"] = np.zeros((*shape, actions), dtype=np.bool_)
        self["action"] = np.zeros(shape, dtype=np.int64)
        self["flies"], self["over"] = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        self["log"], self["value"], self["reward"] = (np.zeros(shape, dtype=np.float32) for _ in range(3))


class Learner:
    """A training: environments and a network. `advance` collects steps in all environments, and learns from them.

    All random numbers depend only on the seed, on stored counters, and on the number of the process, so an interrupted training
    continues unchanged. Several processes share the environments and each minibatch.

    Parameters
    ----------
    scenario, config, seed : Scenario, Config, int
    """

    parallel = True

    def __init__(self, scenario, config, seed):
        self.scenario, self.config, self.seed, self._group = scenario, config, seed, group()
        if config.num_envs % self._group.size:
            raise ValueError(
                f"num_envs: {config.num_envs} environments cannot be shared evenly by {self._group.size} processes"
            )
        self._envs = config.num_envs // self._group.size
        torch.manual_seed(seed)
        with torch.device("cpu"):  # the first weights are the same on every device
            network = self._network()
        self.network, self._uavs = moved(network), scenario.max_uavs
        self._together = self._group.together(Evaluation(self.network))
        self._optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate, eps=1e-5, fused=True)
        self._simulator, self._observer = Simulator(scenario, self._envs), Observer(scenario)
        self._observation = self._observer.empty(self._envs * self._uavs)
        self._steps = Steps(config.steps, self._envs, self._uavs, self._observation)
        self._team = torch.arange(self._envs).repeat_interleave(self._uavs)
        self._half = config.half and can_halve()
        self.updates, self._started = 0, self._group.rank * _EPISODES
        self._begin(np.arange(self._envs))

    def _network(self):
        """Return a new network."""
        return Network(self.scenario, channels=self.config.channels, blocks=self.config.blocks)

    def start_from(self, path):
        """Begin with the network of a weights file."""
        unpack_network(weights_for(path, self.scenario), self.network, path, self.scenario)

    @property
    def samples(self):
        """How many steps of episodes have been collected, each of a whole team."""
        return self.updates * self.config.num_envs * self.config.steps

    def advance(self):
        """Collect steps and learn from them; return the values to plot."""
        config, own = self.config, (2, self._group.rank) if self._group.rank else ()
        random = np.random.default_rng((self.seed, self.updates, *own))
        symmetries = self.network.symmetries
        symmetry = symmetries[random.integers(len(symmetries)) if config.symmetries else 0]
        onward = self._collect(symmetry, random)
        returns = self._returns(onward)
        for each in self._optimizer.param_groups:
            each["lr"] = self._between("learning_rate")
        found = self._learn(symmetry, returns, random)
        self.updates += 1
        return found

    def _begin(self, slots):
        """Start the next episodes of the train split in ``slots``; a share of them starts in any cell."""
        self._simulator.reset(slots, "train", train_numbers(self.seed, self._started, len(slots)))
        if not self.scenario.team:
            draws = np.random.default_rng((self.seed, self._started, 1)).random(len(slots))
            self._simulator.scatter(slots[draws < self._between("random_start_fraction")])
        self._started += len(slots)

    def _between(self, name):
        """Return the value of a field and its ``last_`` twin for this update."""
        first, last = getattr(self.config, name), getattr(self.config, f"last_{name}")
        return first + (last - first) * self.updates / self.config.updates

    def _evaluate(self, observation, mask, symmetry, team):
        """Return logarithmic probabilities of the actions, −∞ where the mask forbids them, and values."""
        network = self._together if torch.is_grad_enabled() else self.network.evaluate
        with precision(self._half):
            logits, values = network(observation, symmetry, team)
        return torch.log_softmax(logits.float().masked_fill(~mask, -math.inf), dim=1), values.float()

    def _collect(self, symmetry, random):
        """Fly all environments, and note everything; return the values of the states after the last step."""
        simulator, steps, state = self._simulator, self._steps, self._simulator.state
        index, rows = np.arange(state.done.size), np.arange(state.done.size)
        for t in range(self.config.steps + 1):
            self._observer.write(state, index, self._observation)
            mask = simulator.action_mask()
            if self.config.safe_mask:
                mask &= simulator.safe_action_mask()
            allowed = tensor(mask.reshape(-1, NUM_ACTIONS) > 0)
            with torch.no_grad():
                logs, values = self._evaluate(tensors(self._observation), allowed, symmetry, self._team)
            if t == self.config.steps:
                return values.cpu().numpy()
            logs, values = logs.cpu().numpy(), values.cpu().numpy()
            for name, part in self._observation.items():
                steps[name][t] = part
            steps["mask"][t], steps["value"][t] = mask.reshape(-1, NUM_ACTIONS), values
            steps["flies"][t] = ~state.done.reshape(-1)
            actions = (logs + random.gumbel(size=logs.shape)).argmax(axis=1)
            steps["action"][t], steps["log"][t] = actions, logs[rows, actions]
            simulator.step(actions.reshape(state.done.shape) if self.scenario.team else actions)
            steps["reward"][t] = self.config.reward_scale * state.reward.reshape(-1)
            steps["over"][t] = state.done.reshape(-1)
            over = np.flatnonzero(state.done.all(axis=1))
            if len(over):
                self._begin(over)
        raise AssertionError("the loop returns")

    def _returns(self, onward):
        """Return the targets of the values, shape (T, B · U): generalised advantage estimates, plus the values."""
        steps, discount = self._steps, self._between("discount")
        returns, gain = np.zeros_like(steps["value"]), np.zeros_like(onward)
        for t in range(len(returns) - 1, -1, -1):
            goes_on = ~steps["over"][t]
            error = steps["reward"][t] + discount * np.where(goes_on, onward, 0.0) - steps["value"][t]
            gain = error + discount * self.config.trace * np.where(goes_on, gain, 0.0)
            returns[t], onward = gain + steps["value"][t], steps["value"][t]
        return returns

    def _learn(self, symmetry, returns, random):
        """Go through the steps several times, until the policy has changed enough; return the values to plot."""
        steps, config = self._steps, self.config
        flies = steps["flies"].reshape(-1)
        groups = np.flatnonzero(flies.reshape(-1, self._uavs).any(axis=1))  # steps of whole teams
        advantages = (returns - steps["value"]).reshape(-1)
        advantages = (advantages - advantages[flies].mean()) / (advantages[flies].std() + 1e-8)
        flat = {name: values.reshape(-1, *values.shape[2:]) for name, values in steps.items()}
        flat |= {"advantage": advantages.astype(np.float32), "return": returns.reshape(-1)}
        size, sums, means, count = max(1, config.minibatch // self._uavs // self._group.size), np.zeros(4), np.zeros(4), 0
        number = self._group.least(len(groups))  # all processes make the same number of gradient steps
        for _ in range(config.epochs):
            order = random.permutation(groups)[:number]
            for k in range(0, len(order), size):
                chosen = (order[k : k + size, None] * self._uavs + np.arange(self._uavs)).reshape(-1)
                chosen = chosen[flies[chosen]]
                sums += self._step({name: values[chosen] for name, values in flat.items()}, chosen // self._uavs, symmetry)
                count += 1
            means = self._group.mean(sums / count)
            if means[3] > config.divergence:
                break
        return dict(zip(("policy loss", "value error", "entropy", "divergence"), means.tolist(), strict=True))

    def _step(self, part, team, symmetry):
        """Make one gradient step; return the loss of the policy, the error of the value, entropy and divergence."""
        config = self.config
        observation = tensors({name: part[name] for name in self._observation})
        numbers = tensor(np.unique(team, return_inverse=True)[1])
        mask, given = tensor(part["mask"]), {name: tensor(part[name]) for name in ("log", "advantage", "return")}
        logs, values = self._evaluate(observation, mask, symmetry, numbers)
        chosen = logs.gather(1, tensor(part["action"])[:, None])[:, 0]
        ratio = (chosen - given["log"]).exp()
        gain = torch.minimum(
            ratio * given["advantage"], ratio.clamp(1.0 - config.clip, 1.0 + config.clip) * given["advantage"]
        ).mean()
        error = (values - given["return"]).square().mean()
        entropy = -(logs.exp() * logs.masked_fill(~mask, 0.0)).sum(dim=1).mean()
        policy = -gain - self._between("entropy") * entropy if self.updates >= config.critic_first else 0.0 * gain
        self._optimizer.zero_grad()
        (policy + config.value_share * error).backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), config.max_norm)
        self._optimizer.step()
        divergence = (ratio - 1.0 - (chosen - given["log"])).mean()
        return np.array([-gain.item(), error.item(), entropy.item(), divergence.item()])

    def weights(self):
        """Return the arrays that the agent needs, by name."""
        return arrays_of(self.network)

    def snapshot(self):
        """Return everything that changes, as arrays by name."""
        own = {f"simulator.{name}": array for name, array in self._simulator.snapshot().items()}
        own["counters"] = np.array([self.updates, self._started])
        arrays = pack({"network": self.network}, self._optimizer)
        for rank, part in enumerate(self._group.gathered(own)):
            arrays |= {f"{_prefix(rank)}{name}": array for name, array in part.items()}
        return arrays

    def resume(self, arrays):
        """Continue from a `snapshot` of a learner of the same scenario, configuration and seed, and as many processes."""
        unpack(arrays, {"network": self.network}, self._optimizer)
        prefix = _prefix(self._group.rank)
        own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
        simulator = {name.removeprefix("simulator."): array for name, array in own.items() if name.startswith("simulator.")}
        self._simulator.resume(simulator)
        self.updates, self._started = own["counters"].tolist()


def _prefix(rank):
    """Return what the names of a process's own arrays begin with."""
    return f"{rank}." if rank else ""


class Agent:
    """Takes the most probable action among those that are valid and safe, in the mean over all symmetries.

    Parameters
    ----------
    scenario : Scenario
    weights : Path, optional
        Weights that ``uavbench train`` wrote; by default those that come with uavbench.
    """

    safe_mask = True

    def __init__(self, scenario, weights=None, name="ppo"):
        path = weights or weights_path(name, scenario)
        trained = training_record(path).get("config", {})
        self.network = Network(scenario, channels=trained.get("channels", 32), blocks=trained.get("blocks", 2))
        unpack_network(weights_for(path, scenario), self.network, path, scenario)
        self._safe, self._symmetries = trained.get("safe_mask", True), trained.get("symmetries", True)

    def act_batch(self, observations, infos):
        """Return the most probable action for each running episode."""
        seen = tensors(observations)
        with torch.no_grad():
            scores = (self.network.agreed(seen) if self._symmetries else self.network(seen)).cpu().numpy()
        masks = np.array([info["action_mask"] * (info["safe_action_mask"] if self._safe else 1) for info in infos])
        return np.where(masks > 0, scores, -math.inf).argmax(axis=1)
