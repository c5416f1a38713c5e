"""A training shared by processes: the same seed and number of processes give the same weights, whatever happens meanwhile."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from learning import CPP, torch, weights_of
from learning import training as of_ddqn
from typer.testing import CliRunner

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.cli.app import app
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.metrics import METRICS
from uavbench.learning.group import ALONE, GroupError
from uavbench.learning.train import train
from uavbench.learning.training import TrainError, Training

SOURCE = find_agent("ppo")
TINY = replace(SOURCE.module().CONFIGS["fast"], updates=6, num_envs=8, steps=16, minibatch=64, epochs=2, validation=3)


def training(config=TINY, processes=2, source=SOURCE, name="tiny"):
    return Training(source, CPP, name, config, 0, None, processes)


def children():
    """Return the processes that this one has started by multiprocessing's spawn, without its tracker of resources."""
    found = []
    for each in Path("/proc").iterdir():
        if each.name.isdigit():
            try:
                status, command = (each / "status").read_text(), (each / "cmdline").read_text()
            except OSError:
                continue
            if f"\nPPid:\t{os.getpid()}\n" in status and "spawn_main" in command:
                found.append(int(each.name))
    return found


def test_a_shared_training_that_is_interrupted_ends_as_if_it_had_not_been(tmp_path):
    whole = train(training(), tmp_path / "whole")
    assert not children()

    def interrupt(updates):
        if updates == 4:
            for each in (os.getpid(), *children()):  # as Ctrl-C in a terminal does
                os.kill(each, signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(training(), tmp_path / "parts", on_update=interrupt)
    assert not children()
    with pytest.raises(TrainError, match=r"its processes is 2, not 1"):
        train(training(processes=1), tmp_path / "parts", resume=True)
    points = []
    parts = train(training(), tmp_path / "parts", resume=True, on_point=points.append)
    assert [point.updates for point in points] == [3, 6]
    assert points[-1].samples == 6 * 8 * 16
    assert weights_of(whole) == weights_of(parts)
    assert weights_of(whole.with_suffix(".checkpoint")) == weights_of(parts.with_suffix(".checkpoint"))
    alone = train(training(processes=1), tmp_path / "alone")
    assert weights_of(alone) != weights_of(whole)
    # Validation, which is shared too, scores as an evaluation of the weights does.
    best = max(points, key=lambda point: (point.cral, point.updates))
    records = list(evaluate(Job(replace(SOURCE, weights=parts), CPP, "validation"), range(200)))
    for name in METRICS:
        assert getattr(best, name) == pytest.approx(np.mean([getattr(each, name) for each in records]))


@pytest.mark.slow
def test_a_process_that_is_killed_is_told_and_the_training_goes_on_from_its_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr("uavbench.learning.train._CHECKPOINT_SECONDS", 0.0)

    def kill(updates):
        if updates == 4:
            os.kill(children()[0], signal.SIGKILL)

    with pytest.raises(GroupError, match=r"process 2 of the 2 of this training has ended, with exit status -9; .*--resume"):
        train(training(), tmp_path / "parts", on_update=kill)
    updates = []
    parts = train(training(), tmp_path / "parts", resume=True, on_update=updates.append)
    assert updates[0] <= 5
    assert weights_of(parts) == weights_of(train(training(), tmp_path / "whole"))


@pytest.mark.slow
@pytest.mark.parametrize(("agent", "scenario"), [("macro_ppo", "Block8-DH-v0"), ("ppo", "Manhattan32-DH-Team-v0")])
def test_teams_and_macro_actions_are_shared_too(agent, scenario, tmp_path):
    """In macro-actions each process has another number of decisions, and in teams some UAVs do not fly any more."""
    source = find_agent(agent)
    values = {"updates": 2, "num_envs": 8, "steps": 32, "minibatch": 64, "epochs": 2, "validation": 2}
    config = replace(source.module().CONFIGS["fast"], **values)
    found = [
        train(Training(source, load_scenario(scenario), "tiny", config, 0, None, 2), tmp_path / name) for name in ("one", "two")
    ]
    assert weights_of(found[0]) == weights_of(found[1])


@pytest.mark.slow
def test_torchrun_starts_the_same_training(tmp_path, monkeypatch):
    (tmp_path / "tiny.toml").write_text("updates = 4\nnum_envs = 8\nsteps = 16\nminibatch = 64\nepochs = 2\nvalidation = 2\n")
    words = ["train", "ppo", "--scenario", CPP.id, "--config", str(tmp_path / "tiny.toml")]
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "uavbench"]
    found = subprocess.run(
        [*launcher, *words, "--out", str(tmp_path / "there")], capture_output=True, text=True, timeout=300, check=False
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.count("next:") == 1
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "here")
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "4")
    told = CliRunner().invoke(app, [*words, "--processes", "2"])
    assert (told.exit_code, "torchrun has started 4" in told.output) == (2, True)
    monkeypatch.undo()
    told = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "here"), "--processes", "2"])
    assert told.exit_code == 0, told.output
    name = Path(CPP.id) / "ppo-tiny-0.safetensors"
    assert weights_of(tmp_path / "there" / name) == weights_of(tmp_path / "here" / name)


def test_what_cannot_be_shared_is_refused(tmp_path):
    with pytest.raises(TrainError, match="ddqn cannot be trained in several processes: its Learner has no `parallel = True`"):
        train(replace(of_ddqn(), processes=2), tmp_path)
    with pytest.raises(TrainError, match="num_envs: 8 environments cannot be shared evenly by 3 processes"):
        train(training(processes=3), tmp_path)
    assert not children()
    assert not list(tmp_path.iterdir())


def test_gradients_are_the_means_over_the_processes(tmp_path):
    """Each process has a gradient of its own; with plain gradient descent the weights move by their mean."""
    mine = tmp_path / "mine.py"
    mine.write_text(LINEAR)
    kept = train(
        training(source=find_agent(str(mine)), config=find_agent(str(mine)).module().CONFIGS["fast"]), tmp_path / "out"
    )
    weights = np.frombuffer(weights_of(kept)["weight"], dtype=np.float32)
    assert weights.tolist() == [-1.5, -1.5]  # the gradients are (1, 1) and (2, 2)


LINEAR = """
from dataclasses import dataclass
import numpy as np
import torch
from uavbench.learning.group import group

@dataclass(frozen=True)
class Config:
    updates: int = 1
    validation: int = 1

CONFIGS = {"fast": Config()}

class Learner:
    parallel = True
    def __init__(self, scenario, config, seed):
        self.updates = self.samples = 0
        self.network = torch.nn.Linear(2, 1, bias=False)
        with torch.no_grad():
            self.network.weight.zero_()
        self.together = group().together(self.network)
    def advance(self):
        self.together(torch.full((1, 2), 1.0 + group().rank)).sum().backward()
        with torch.no_grad():
            self.network.weight -= self.network.weight.grad
        self.updates += 1
        return {}
    def weights(self):
        return {"weight": self.network.weight.detach().numpy()}
    def snapshot(self):
        return {**self.weights(), "updates": np.array([self.updates])}
    def resume(self, arrays):
        pass

class Agent:
    def __init__(self, scenario, weights=None): pass
    def act(self, observation, info): return int(info["action_mask"].argmax())
"""


def test_a_process_alone_shares_nothing():
    assert ALONE.told(3) == 3
    assert ALONE.gathered(3) == [3]
    assert ALONE.least(3) == 3
    network = torch.nn.Linear(2, 1)
    assert ALONE.together(network) is network
