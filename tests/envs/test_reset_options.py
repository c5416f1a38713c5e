"""Whatever `reset(options=...)` is given, it is taken or refused by one clear ValueError, and nothing flies after a refusal."""

import importlib.util
import itertools

import numpy as np
import pytest

from uavbench.envs.env import UAVEnv
from uavbench.envs.parallel_env import UAVParallelEnv
from uavbench.envs.vector_env import UAVVectorEnv

CPP, DH, TEAM = "Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-CPP-Team-v0"
HOVER = 4


class Unspeakable:
    """An object whose representation raises."""

    def __repr__(self):
        raise ZeroDivisionError


class Hostile(Unspeakable):
    """An object of which nothing can be asked."""

    def __getattr__(self, name):
        raise ZeroDivisionError

    __index__ = __array__ = __len__ = __iter__ = __getitem__ = __eq__ = __bool__ = __float__ = Unspeakable.__repr__
    __hash__ = object.__hash__


def tensors():
    """Tensors of every kind, where PyTorch is there."""
    if importlib.util.find_spec("torch") is None:
        return []
    import torch

    return [torch.tensor(value) for value in (3, 12.7, True, [3], [7, 6], [[7, 6, 5.0]], float("nan"))] + [
        torch.ones(2, requires_grad=True),
        torch.zeros((8, 8), dtype=torch.uint8),
    ]


SCALARS = [
    0,
    1,
    -1,
    12,
    2**31,
    2**63,
    10**400,
    10**5000,
    3.0,
    12.7,
    float("nan"),
    float("inf"),
    1j,
    True,
    None,
    "",
    "test",
    b"3",
]
OBJECTS = [
    Unspeakable(),
    Hostile(),
    object(),
    int,
    len,
    {1, 2},
    {},
    {"a": 1},
    iter([1]),
    range(2),
    slice(2),
    ...,
    memoryview(b"ab"),
]
ARRAYS = [
    np.array(3),
    np.array([3]),
    np.array(True),
    np.array("test"),
    np.array(["test"]),
    np.array([3, 4], dtype=object),
    np.array(Unspeakable(), dtype=object),
    np.array([1.5, np.nan]),
    np.array([1j]),
    np.array(["2020-01-01"], dtype="datetime64[D]"),
    np.longdouble("1e400"),
    np.zeros((0, 3)),
    np.zeros((8, 8)),
    np.ones((2, 2), dtype=bool),
    np.array([(1, 2.0)], dtype=[("a", "i4"), ("b", "f8")]),
    np.str_("test"),
    np.uint64(2**64 - 1),
]
GOOD = [{"episode": 7}, {"split": "test"}, {"budget": 12}, {"noise": False}, {"start": [7, 6]}, {"start": [[7, 6], [7, 7]]}]

LEAVES = [*SCALARS, *OBJECTS, *ARRAYS, *tensors()]
NAMES = ["split", "episode", "start", "budget", "targets", "devices", "noise", "num_uavs"]


def value(generator, depth=3):
    """A random value, lists in lists included. (Hypothesis cannot do this: it asks for representations.)"""
    if depth and generator.random() < 0.4:
        return [value(generator, depth - 1) for _ in range(generator.integers(0, 4))]
    return LEAVES[generator.integers(len(LEAVES))]


def mutant(generator):
    """Good options, of which some are replaced by random values or have others beside them."""
    options = dict(GOOD[generator.integers(len(GOOD))])
    for _ in range(generator.integers(1, 3)):
        options[NAMES[generator.integers(len(NAMES))]] = value(generator)
    return options


def take(env, options, fly):
    """Reset with the options, and fly a step: only a ValueError may say no, on one line, and nothing flies then."""
    try:
        env.reset(options=options)
    except ValueError as error:
        text = str(error)
        assert 0 < len(text) < 300
        assert "\n" not in text
        assert ":" in text  # the field it is about
        with pytest.raises(RuntimeError, match="call reset"):
            fly(env)
        return
    fly(env)


FLY = {
    UAVEnv: lambda env: env.step(HOVER),
    UAVVectorEnv: lambda env: env.step(np.array([HOVER, HOVER])),
    UAVParallelEnv: lambda env: env.step(dict.fromkeys(env.agents, HOVER)),
}
ENVS = [UAVEnv(CPP), UAVEnv(DH), UAVVectorEnv(CPP, 2), UAVVectorEnv(DH, 2), UAVParallelEnv(TEAM), UAVParallelEnv(DH)]


@pytest.mark.parametrize("env", ENVS, ids=lambda env: f"{type(env).__name__}-{env.scenario.id}")
def test_mutated_options_are_taken_or_refused(env):
    generator = np.random.default_rng(0)
    for _ in range(150):
        env.reset(seed=0)
        take(env, mutant(generator), FLY[type(env)])


@pytest.mark.parametrize("env", ENVS, ids=lambda env: f"{type(env).__name__}-{env.scenario.id}")
def test_every_option_of_every_kind_is_taken_or_refused(env):
    for name, leaf in itertools.product(NAMES, LEAVES):
        for given in (leaf, [leaf], [leaf] * 2, [[leaf] * 2] * 2, [[leaf] * 3]):
            take(env, {name: given}, FLY[type(env)])


@pytest.mark.parametrize("mask", [[True, False], np.ones(2), np.ones(3, bool), np.zeros(2, bool), Hostile(), 1, "x"], ids=type)
def test_a_mask_is_refused_as_gymnasium_does(mask):
    envs = UAVVectorEnv(CPP, 2)
    with pytest.raises((TypeError, ValueError), match=r"^reset_mask: "):
        envs.reset(options={"reset_mask": mask})


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("episode", np.array([3]), r"episode: array\(\[3\]\) is not an integer"),
        ("episode", 10**400, r"episode: 1000.*000 is out of range; Block8-CPP-v0 has test episodes 0 to 999"),
        ("episode", Unspeakable(), "episode: .*Unspeakable.* is not an integer"),
        ("budget", 12.7, "budget: 12.7 is not an integer from 1 to 30"),
        ("start", [10**5000, 0], "start: .* is off the 8×8 map"),
        ("split", np.array(["test"]), r"split: array\(\['test'\].* is not one of train, validation, test"),
        ("noise", np.array([True]), "noise: .* is not True or False"),
        ("targets", [[1], [1, 0]], "targets: .* is not a mask"),
    ],
)
def test_the_message_names_the_option_and_what_was_expected(name, given, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        UAVEnv(CPP).reset(options={"split": "test", name: given})


def test_options_are_a_dictionary():
    for options in ([("episode", 3)], "episode", 3, np.ones(2), np.ones(0), Hostile()):
        for env in (UAVEnv(CPP), UAVVectorEnv(CPP, 2), UAVParallelEnv(CPP)):
            with pytest.raises(ValueError, match=r"^reset\(options=...\): .* is not a dictionary"):
                env.reset(options=options)


def integers():
    """The same integer in the types that libraries use."""
    kinds = {"int": int, "NumPy": np.int64, "array": lambda number: np.array(number, np.int32)}
    if importlib.util.find_spec("torch") is not None:
        import torch

        kinds["tensor"] = torch.tensor
    return kinds


@pytest.mark.parametrize("kind", integers().values(), ids=integers())
def test_an_integer_may_come_from_any_library(kind):
    env = UAVEnv(CPP)
    env.reset(options={"split": "test", "episode": kind(17)})
    assert env.episode == ("test", 17)
    env.reset(options={"start": [kind(7), kind(6)], "budget": kind(11), "noise": np.array(True)})
    assert (env.simulator.state.position[0, 0].tolist(), env.simulator.state.budget[0, 0]) == ([7, 6], 11)
    env.step(kind(0))
    assert env.simulator.state.position[0, 0].tolist() == [6, 6]
    envs = UAVVectorEnv(CPP, 2)
    envs.reset(options={"split": "test", "episode": [kind(17), kind(3)]})
    assert envs.episode == (("test", 17), ("test", 3))
    envs.reset(options={"split": "test", "episode": kind(17)})
    assert envs.episode == (("test", 17), ("test", 17))
    team = UAVParallelEnv(TEAM)
    team.reset(options={"num_uavs": kind(2), "budget": [kind(9), kind(10)], "episode": kind(17)})
    assert team.simulator.state.budget[0, :2].tolist() == [9, 10]
    assert team.step({"uav_0": kind(4), "uav_1": kind(4)})[1].keys() == {"uav_0", "uav_1"}


@pytest.mark.parametrize("action", [6, -1, 1.0, True, 10**400, np.array([1]), Hostile(), None, "1", *tensors()[1:]], ids=type)
def test_what_is_no_action_is_refused_in_one_line(action):
    for env, chosen in ((UAVEnv(CPP), action), (UAVParallelEnv(CPP), {"uav_0": action})):
        env.reset(seed=0)
        with pytest.raises(ValueError, match=r"^actions: .* is not one integer from 0 to 5$"):
            env.step(chosen)


@pytest.mark.parametrize("options", [{"budget": 0}, {"no such option": 1}, {"episode": 1.5}, [1]])
def test_nothing_flies_after_a_reset_that_failed(options):
    env = UAVEnv(CPP, render_mode="ansi")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"."):
        env.reset(options=options)
    for ask in (lambda: env.step(HOVER), env.action_masks, env.render):
        with pytest.raises(RuntimeError, match="call reset"):
            ask()
    env.reset()
    env.step(HOVER)
