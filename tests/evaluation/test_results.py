"""Results on disk: whole or not at all, resumable, reproducible by anyone."""

import json
from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest
from commands import uavbench_command
from running import AGENTS, N, files, job

from uavbench import list_scenarios, load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import NO_ACTION
from uavbench.evaluation.metrics import summarise
from uavbench.evaluation.replay import compare_results, fly_all_recorded, fly_recorded, fly_together, replay
from uavbench.evaluation.results import COLUMNS, ResultError, load_result
from uavbench.evaluation.run import jobs, run
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import HOVER


@pytest.fixture
def result(tmp_path):
    return run(job(), N, tmp_path)


def test_a_result_is_three_files_in_their_place(result, tmp_path):
    folder = tmp_path / "Block8-DH-v0" / "agents.One"
    assert result.folder == folder
    assert sorted(path.name for path in folder.iterdir()) == ["actions.npz", "episodes.csv", "summary.json"]
    assert [path.name for path in folder.parent.iterdir()] == ["agents.One"]
    assert load_result(folder).summary == result.summary


def test_the_summary_tells_all_that_the_score_depends_on(result):
    summary = result.summary
    for name in ("landed", "cr", "cral"):
        assert set(summary["metrics"][name]) == {"mean", "low", "high"}
        assert 0 <= summary["metrics"][name]["low"] <= summary["metrics"][name]["mean"] <= summary["metrics"][name]["high"] <= 1
    assert summary["track"] == "observation"
    assert summary["agent_sha256"] == find_agent(str(AGENTS)).sha256
    assert summary["scenario_digest"] == load_scenario("Block8-DH-v0").digest
    assert set(summary["versions"]) == {"python", "numpy", "numba", "platform"}
    assert summary["uavbench"]
    assert summary["wall_time"] > 0
    assert summary["decisions_per_second"] > 0


def test_episodes_csv_holds_every_episode(result):
    table = result.episodes()
    assert list(table.columns) == list(COLUMNS)
    assert table["episode"].tolist() == list(range(N))
    assert np.allclose(table["cral"], table["cr"] * table["landed"])
    assert table["cr"].mean() == pytest.approx(result.metrics["cr"].mean)
    assert {number: len(actions) for number, actions in result.actions().items()} == dict(
        zip(table["episode"], table["steps"], strict=True)
    )


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0"])
def test_replay_reproduces_every_number(scenario, tmp_path):
    assert replay(run(job(scenario=scenario), N, tmp_path)) == []


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-CPP-Team-v0"])
def test_replay_flies_all_episodes_side_by_side_in_one_simulator(scenario, tmp_path, monkeypatch):
    """In parts where the maps of all would take too much memory; each episode comes out as if it flew alone."""
    result, made, fits = run(job(scenario=scenario), N, tmp_path), [], []

    class Counted(Simulator):
        def __init__(self, *given):
            super().__init__(*given)
            made.append(self.num_envs)

        def _check_fit(self, *given):
            fits.append(given)
            super()._check_fit(*given)

    monkeypatch.setattr("uavbench.evaluation.replay.Simulator", Counted)
    flown, wrong = fly_all_recorded(result)
    assert (made, len(fits), wrong) == ([N], 1, [])
    rows, cols = result.scenario.shape
    monkeypatch.setattr("uavbench.evaluation.replay._MAX_CELLS", 7 * rows * cols + 1)
    in_parts, wrong = fly_all_recorded(result)
    assert (made[1:], len(fits), wrong) == ([7], 2, [])
    alone = [fly_recorded(result.scenario, "test", k, actions) for k, actions in result.actions().items()]
    for records in zip(flown, in_parts, alone, strict=True):
        assert len({repr({**asdict(record), "actions": record.actions.tobytes()}) for record in records}) == 1


@pytest.mark.parametrize("scenario", ["Block8-DH-v0", "Manhattan32-DH-Team-v0"])
def test_a_flight_that_is_not_whole_disturbs_no_other(scenario, tmp_path):
    result = run(job(scenario=scenario), N, tmp_path)
    flights = list(result.actions().values())
    whole = fly_together(result.scenario, "test", range(N), flights)
    uavs = flights[0].shape[1]
    flights[3] = flights[3][:-1]  # too short
    flights[5] = np.concatenate([flights[5], np.full((1, uavs), NO_ACTION, dtype=np.uint8)])  # a step in which nobody flies
    flights[7] = np.full((10**6, uavs), HOVER, dtype=np.uint8)  # longer than any budget
    flights[9] = flights[9][:, :0]  # of no UAV
    flights[11] = flights[11][:0]
    flights[13] = np.where(np.arange(len(flights[13]))[:, None] == 1, 255, flights[13]).astype(np.uint8)
    flights[15] = flights[15][:, 0]
    found = fly_together(result.scenario, "test", range(N), flights)
    assert [k for k, record in enumerate(found) if record is None] == [3, 5, 7, 9, 11, 13, 15]
    for record, other in zip(found, whole, strict=True):
        assert record is None or (record.cr, record.total_reward) == (other.cr, other.total_reward)
    assert [fly_recorded(result.scenario, "test", k, flight) is None for k, flight in enumerate(flights)] == [
        record is None for record in found
    ]


def test_replay_finds_actions_of_uavs_that_do_not_fly(tmp_path):
    """What a UAV that is not there, or flies no more, is said to have done must be nothing."""
    result = run(job("One", "Manhattan32-DH-Team-v0"), 6, tmp_path)
    path = result.folder / "actions.npz"
    with np.load(path) as table:
        columns = dict(table)
    absent, there = columns["actions"] == NO_ACTION, columns["actions"] != NO_ACTION
    assert absent.any(axis=0).tolist() == [True, True, True]
    for where, action in ((absent, 4), (absent, 7), (there, NO_ACTION)):
        changed = columns["actions"].copy()
        changed[tuple(np.argwhere(where)[0])] = action
        np.savez(path, **{**columns, "actions": changed})
        assert any("does not hold the actions of a whole episode" in line for line in replay(load_result(result.folder)))
    np.savez(path, **{**columns, "actions": columns["actions"][:, :2]})
    assert len(replay(load_result(result.folder))) == 6


@pytest.mark.slow
def test_teams_are_compared_and_resumed(tmp_path):
    team = "Manhattan32-DH-Team-v0"
    first = run(job("greedy", team), N, tmp_path)
    assert compare_results(first, run(job("random", team), N, tmp_path))[0]["cral"].difference.mean > 0.3
    stopped = run(job("Together", team), N, tmp_path / "whole")

    class Interrupted(Exception):  # noqa: N818
        pass

    def interrupt(record):
        if record.episode == 9:
            raise Interrupted

    with pytest.raises(Interrupted):
        run(job("Together", team), N, tmp_path / "parts", on_record=interrupt)
    assert files(run(job("Together", team), N, tmp_path / "parts", resume=True).folder) == files(stopped.folder)


def tamper_table(folder, column, change):
    table = pd.read_csv(folder / "episodes.csv")
    table.loc[4, column] = change(table.loc[4, column])
    table.to_csv(folder / "episodes.csv", index=False)


@pytest.mark.parametrize("column", [name for name in COLUMNS if name != "episode"])
def test_replay_finds_a_changed_number(result, column):
    tamper_table(result.folder, column, lambda value: value + 1)
    assert any(f"episode 4: {column}" in line for line in replay(load_result(result.folder)))


def test_replay_finds_a_number_that_is_none(result):
    path = result.folder / "episodes.csv"
    lines = path.read_text().splitlines()
    cells = lines[5].split(",")
    lines[5] = ",".join([*cells[:5], "nan", *cells[6:]])
    path.write_text("\n".join(lines) + "\n")
    assert any("episode 4: cr" in line for line in replay(load_result(result.folder)))


def test_replay_finds_a_changed_summary(result):
    path = result.folder / "summary.json"
    summary = json.loads(path.read_text())
    summary["metrics"]["cral"]["mean"] += 0.01
    path.write_text(json.dumps(summary))
    assert replay(load_result(result.folder)) != []


def test_replay_finds_changed_dropped_or_added_actions(result):
    with np.load(result.folder / "actions.npz") as table:
        columns = dict(table)
    first = columns["offsets"][1]
    for change in (
        {"actions": np.r_[(columns["actions"][:1] + 1) % 4, columns["actions"][1:]].astype(np.uint8)},
        {"actions": columns["actions"][1:], "offsets": np.r_[0, columns["offsets"][1:] - 1]},
        {
            "actions": np.r_[columns["actions"][:first], [[4]], columns["actions"][first:]].astype(np.uint8),
            "offsets": np.r_[0, columns["offsets"][1:] + 1],
        },
        {"episodes": np.r_[columns["episodes"][:-1], 999]},
    ):
        np.savez(result.folder / "actions.npz", **{**columns, **change})
        assert replay(load_result(result.folder)) != []


def forge(folder, table, **changes):
    """Write a table and a summary that agrees with it."""
    table.to_csv(folder / "episodes.csv", index=False, na_rep="nan")
    path = folder / "summary.json"
    summary = json.loads(path.read_text())
    for name, interval in summarise(*(table[name].to_numpy(float) for name in ("landed", "cr", "cral"))).items():
        summary["metrics"][name] = vars(interval)
    path.write_text(json.dumps({**summary, **changes}))
    return load_result(folder)


def test_replay_finds_forgeries_that_agree_with_themselves(result):
    table = result.episodes()
    best = table.loc[[table["cral"].idxmax()] * N]
    unknown = table.assign(cr=float("nan"), cral=float("nan"), **{"return": float("nan")})
    chosen = table[table["cral"] > 0]
    for forged, changes in (
        (best, {}),
        (unknown, {}),
        (chosen, {"episodes": len(chosen)}),
        (chosen, {}),
        (table, {"decisions": 1}),
        (table[::-1], {}),
        (table, {"episodes": 0}),
    ):
        try:
            wrong = replay(forge(result.folder, forged, **changes))
        except ResultError as error:
            wrong = [str(error)]
        assert "episode" in "".join(wrong) or "decisions" in "".join(wrong)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"split": "tset"}, "split: 'tset'"),
        ({"split": None}, "not a summary"),
        ({"episodes": "20"}, "not a summary"),
        ({"metrics": {}}, "not a summary"),
    ],
)
def test_a_summary_that_makes_no_sense_is_refused(result, change, message):
    path = result.folder / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(ResultError, match=message):
        replay(load_result(result.folder))


def test_actions_damaged_anywhere_are_found_or_refused(result):
    path = result.folder / "actions.npz"
    content = path.read_bytes()
    whole = result.actions()
    for place in range(0, len(content), 7):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :])
        try:
            found = result.actions()
        except ResultError:
            continue
        same = found.keys() == whole.keys() and all(np.array_equal(found[k], whole[k]) for k in whole)
        assert same or replay(result) != []


def test_replay_refuses_another_scenario(result):
    path = result.folder / "summary.json"
    path.write_text(path.read_text().replace(result.summary["scenario_digest"], "0" * 64))
    with pytest.raises(ResultError, match="scenario_digest"):
        replay(load_result(result.folder))


@pytest.mark.parametrize("name", ["summary.json", "episodes.csv", "actions.npz"])
def test_a_missing_or_damaged_file_is_refused(result, name):
    content = (result.folder / name).read_bytes()
    (result.folder / name).write_bytes(content[: len(content) // 2])
    try:
        wrong = replay(load_result(result.folder))
    except ResultError as error:
        assert str(result.folder) in str(error)  # noqa: PT017
    else:
        assert wrong != []
    (result.folder / name).unlink()
    with pytest.raises(ResultError, match=name):
        load_result(result.folder)


def test_a_new_run_replaces_the_old_result(result, tmp_path):
    again = run(job(), N + 1, tmp_path)
    assert again.summary["episodes"] == len(again.episodes()) == N + 1


def test_resuming_a_finished_run_leaves_it_as_it_is(result, tmp_path):
    before = (result.folder / "summary.json").read_bytes()
    flown = []
    assert run(job(), N, tmp_path, resume=True, on_record=flown.append).summary == result.summary
    assert (result.folder / "summary.json").read_bytes() == before
    assert flown == []


def test_what_was_flown_is_kept_when_it_cannot_be_published(tmp_path, monkeypatch):
    def full_disk(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("uavbench.evaluation.run.publish", full_disk)
    with pytest.raises(ResultError, match=r"--out: cannot write .*agents.One: No space"):
        run(job(), N, tmp_path)
    monkeypatch.undo()
    flown = []
    monkeypatch.setattr("uavbench.evaluation.run.evaluate_with", lambda *_arguments: flown.append(1) or iter(()))
    assert run(job(), N, tmp_path, resume=True).summary["episodes"] == N
    assert flown == []


def test_a_result_that_a_killed_run_has_half_moved_is_found(result, tmp_path):
    before, folder = files(result.folder), result.folder
    promise = folder.with_name(".uavbench-ready-x")
    promise.mkdir()
    folder.replace(promise / folder.name)
    assert files(load_result(folder).folder) == before
    assert [path.name for path in folder.parent.iterdir()] == ["agents.One"]


def test_compares_paired_episodes(tmp_path):
    greedy, chance = (run(job(name, "Block8-CPP-v0"), N, tmp_path) for name in ("greedy", "random"))
    found, episodes = compare_results(greedy, chance)
    assert episodes == N
    expected = greedy.episodes()["cral"].mean() - chance.episodes()["cral"].mean()
    assert found["cral"].difference.mean == pytest.approx(expected)
    assert found["cral"].difference.low > 0
    assert found["cral"].improvement.mean > 0.8


def test_refuses_to_compare_what_is_not_paired(result, tmp_path):
    other = run(job("random", "Block8-CPP-v0"), N, tmp_path)
    with pytest.raises(ResultError, match="scenario is Block8-DH-v0 in"):
        compare_results(result, other)


def test_a_users_own_scenario_is_replayed_from_its_file(tmp_path):
    shipped = load_scenario("Block8-CPP-v0").path
    text = shipped.read_text().split("[splits")[0].replace("Block8-CPP-v0", "Mine-v0")
    text = text.replace("maps/Block8.txt", str(shipped.parent / "maps" / "Block8.txt"))
    (tmp_path / "mine.toml").write_text(text)
    source = find_agent("random")
    (mine, episodes, _), *_ = jobs(source, [str(tmp_path / "mine.toml")], "test", 5, None)
    assert replay(load_result(run(mine, episodes, tmp_path).folder)) == []


def test_plans_all_scenarios_and_refuses_what_is_not_there():
    source = find_agent("greedy")
    assert len(jobs(source, ["all", "Block8-CPP-v0"], "test", None, None)) == len(list_scenarios())
    assert jobs(source, ["Block8-CPP-v0"], "validation", None, None)[0][1] == 200
    assert jobs(source, ["Block8-CPP-v0"], "train", None, None)[0][1] == 1000
    with pytest.raises(ResultError, match="--split"):
        jobs(source, ["Block8-CPP-v0"], "tset", None, None)
    with pytest.raises(ResultError, match="has 1000 test episodes"):
        jobs(source, ["Block8-CPP-v0"], "test", 1001, None)


def test_compares_the_episodes_that_both_flew_and_says_so(result, tmp_path):
    fewer = run(job("random"), N - 1, tmp_path / "fewer")
    found, episodes = compare_results(result, fewer)
    assert episodes == N - 1
    difference = result.episodes()["cral"][: N - 1].mean() - fewer.episodes()["cral"].mean()
    assert found["cral"].difference.mean == pytest.approx(difference)
    told = uavbench_command("compare", result.folder, fewer.folder)
    assert f"{N - 1} paired episodes (of {N}, those that both flew)" in " ".join(told.output.split())
