"""Validations during a training: one that is cut off goes on where it was, and scores as if it had not been."""

import json
import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from learning import CPP, DDQN, SOURCE, TINY, training, weights_of

from uavbench.agents.weights import load_weights
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.metrics import METRICS
from uavbench.learning import validation
from uavbench.learning.train import train
from uavbench.learning.validation import Validation

COUNT = 30


@pytest.fixture(autouse=True)
def parts_of_ten(monkeypatch):
    monkeypatch.setattr(validation, "_PART", 10)


class Killed(BaseException):
    """Stands for a kill, which no code can catch."""


def flights(monkeypatch, before):
    """Note which episodes are flown; ``before`` is called before each part with the number of parts so far."""
    flown = []

    def fly(job, numbers):
        before(len(flown))
        flown.append(list(numbers))
        return evaluate(job, numbers)

    monkeypatch.setattr(validation, "evaluate", fly)
    return flown


def parts(first=0):
    return [list(range(k, k + 10)) for k in range(first, COUNT, 10)]


def kill(at):
    def before(count):
        if count == at:
            raise Killed

    return before


def made(tmp_path):
    return Validation(SOURCE, CPP, tmp_path, "tiny", COUNT), DDQN.Learner(CPP, TINY, 0).weights()


def test_scores_are_the_means_over_the_validation_episodes(tmp_path):
    kept = train(training(replace(TINY, updates=20)), tmp_path)
    arrays, record = load_weights(kept)
    scores = Validation(SOURCE, CPP, tmp_path, "tiny", COUNT).scores(arrays, record)
    records = list(evaluate(Job(replace(SOURCE, weights=kept), CPP, "validation"), range(COUNT)))
    assert scores == {name: pytest.approx(np.mean([getattr(each, name) for each in records])) for name in METRICS}
    assert not list(tmp_path.glob(".tiny*"))


def test_a_validation_that_was_killed_flies_only_what_is_left(tmp_path, monkeypatch):
    checked, arrays = made(tmp_path)
    whole = checked.scores(arrays, {})
    flown = flights(monkeypatch, kill(1))
    with pytest.raises(Killed):
        checked.scores(arrays, {})
    monkeypatch.undo()
    monkeypatch.setattr(validation, "_PART", 10)
    flown = flights(monkeypatch, lambda count: None)
    assert checked.scores(arrays, {}) == whole
    assert flown == parts(10)
    assert checked.scores(arrays, {}) == whole
    assert flown == parts(10) + parts()


@pytest.mark.parametrize("content", ["other weights", "", "[1]", '{"weights": 3}', None])
def test_scores_of_other_weights_and_damaged_ones_do_not_count(content, tmp_path, monkeypatch):
    checked, arrays = made(tmp_path)
    flown = flights(monkeypatch, kill(2))
    with pytest.raises(Killed):
        checked.scores(arrays, {})
    (kept,) = tmp_path.glob(".*.json")
    assert len(json.loads(kept.read_text())["scores"]) == 20
    if content == "other weights":
        arrays = {name: array + 1 for name, array in arrays.items()}
    elif content is None:
        kept.unlink()
    else:
        kept.write_text(content)
    monkeypatch.undo()
    monkeypatch.setattr(validation, "_PART", 10)
    flown = flights(monkeypatch, lambda count: None)
    checked.scores(arrays, {})
    assert flown == parts()


def test_long_episodes_are_flown_in_smaller_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(validation, "_PART_ACTIONS", 4 * CPP.budget[1])
    checked, arrays = made(tmp_path)
    flown = flights(monkeypatch, lambda count: None)
    checked.scores(arrays, {})
    assert {len(part) for part in flown} == {4, 2}


def test_a_training_that_is_killed_in_a_validation_loses_no_update(tmp_path, monkeypatch):
    monkeypatch.setattr("uavbench.learning.train._BEFORE_VALIDATION_SECONDS", 0.0)
    whole = train(training(), tmp_path / "whole")
    flown = flights(monkeypatch, kill(2))
    with pytest.raises(Killed):
        train(training(), tmp_path / "parts")
    assert len(flown) == 2
    monkeypatch.undo()
    monkeypatch.setattr(validation, "_PART", 10)
    updates, points = [], []
    flown = flights(monkeypatch, lambda count: None)
    kept = train(training(), tmp_path / "parts", resume=True, on_update=updates.append, on_point=points.append)
    assert flown[0][0] == 20
    assert updates == list(range(21, 41))
    assert [point.updates for point in points] == [20, 40]
    assert weights_of(kept) == weights_of(whole)


def test_an_interrupt_waits_for_a_part_of_a_validation_only(tmp_path, monkeypatch):
    whole = train(training(), tmp_path / "whole")
    flown = flights(monkeypatch, lambda count: os.kill(os.getpid(), signal.SIGINT) if count == 1 else None)
    with pytest.raises(KeyboardInterrupt):
        train(training(), tmp_path / "parts")
    assert flown == parts()[:2]
    updates = []
    kept = train(training(), tmp_path / "parts", resume=True, on_update=updates.append)
    assert updates == list(range(21, 41))
    assert weights_of(kept) == weights_of(whole)
