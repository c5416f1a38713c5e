"""Submissions: what is handed in is what was flown, and whatever else a folder holds is refused in one line."""

import json
import os
import shutil
import tomllib
import zipfile

import numpy as np
import pytest
import tomli_w
from pydantic import TypeAdapter, ValidationError

import uavbench.leaderboard.submission as submission_module
from uavbench.evaluation.results import Result, load_result
from uavbench.leaderboard.submission import MANIFEST, SubmissionError, check, load_submission
from uavbench.leaderboard.submit import submit
from uavbench.world.files import pack_arrays, unpack_arrays

FOLDER = "greedy/Block8-CPP-v0"


def edit_manifest(folder, change):
    path = folder / MANIFEST
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    change(table)
    path.write_text(tomli_w.dumps(table), encoding="utf-8")


def edit_actions(folder, change):
    path = folder / "actions.npz"
    table = unpack_arrays(path.read_bytes())
    change(table)
    path.write_bytes(pack_arrays(table, compress=True))


def refusal(folder):
    """Return why it is refused: one line that names it."""
    with pytest.raises(SubmissionError) as caught:
        check(load_submission(folder))
    line = str(caught.value)
    assert line.startswith(f"{folder.parent.name}/{folder.name}: ")
    assert len(line) < 500
    return line


def test_a_submission_says_who_and_how_and_is_reproduced(submissions, result):
    submission = load_submission(submissions / FOLDER)
    check(submission)
    manifest = submission.manifest
    assert manifest.authors == ("A. Author", "B. Author")
    assert manifest.hardware == "a machine"
    assert manifest.result.model_dump(exclude_none=True) == result.summary
    for name in ("episodes.csv", "actions.npz"):
        assert (submission.folder / name).read_bytes() == (result.folder / name).read_bytes()


def test_that_weights_flew_on_another_map_is_kept_and_nothing_else_than_true(result, tmp_path):
    for said in (True, False, "yes"):
        again = Result(result.folder, {**result.summary, "transfer": said})
        if said is True:
            (folder,) = submit([again], tmp_path / "s", name="mine", authors=["A"])
            assert load_submission(folder).result.summary["transfer"] is True
        else:
            with pytest.raises(SubmissionError, match=r"result\.transfer"):
                submit([again], tmp_path / "s", name="mine", authors=["A"])


def test_it_is_filed_under_its_name_and_replaces_an_older_one(result, tmp_path):
    for link in ("", "https://example.org/paper?x=1"):
        folders = submit([result], tmp_path / "s", name="My Agent 2.0", authors=["A"], link=link)
        assert folders == [tmp_path / "s" / "my-agent-2.0" / "Block8-CPP-v0"]
        assert load_submission(folders[0]).manifest.link == link
    assert [path.name for path in (tmp_path / "s").iterdir()] == ["my-agent-2.0"]
    assert "×" in load_submission(folders[0]).manifest.hardware


@pytest.mark.parametrize(
    ("told", "field"),
    [
        ({"name": ""}, "name"),
        ({"name": "../up"}, "name"),
        ({"name": "a/b"}, "name"),
        ({"name": "a\n"}, "name"),
        ({"name": "a "}, "name"),
        ({"name": "a  b"}, "name"),
        ({"name": "x" * 41}, "name"),
        ({"authors": []}, "authors"),
        ({"authors": ["a\nb"]}, "authors"),
        ({"authors": ["a\u202eb"]}, "authors"),
        ({"authors": ["a\u009bb"]}, "authors"),
        ({"training": "a\u2028b"}, "training"),
        ({"method": "magic"}, "method: write one of policy, policy \\+ mask, rules, .*, or nothing"),
        ({"link": "javascript:alert(1)"}, "link"),
        ({"link": 'https://x" onclick="y'}, "link"),
        ({"training": "x" * 201}, "training"),
    ],
)
def test_what_is_said_must_be_fit_to_print(result, tmp_path, told, field):
    with pytest.raises(SubmissionError, match=field):
        submit([result], tmp_path / "s", **{"name": "a", "authors": ["b"], **told})
    assert list((tmp_path / "s").iterdir()) == []


def test_a_name_that_is_filed_alike_is_not_taken_from_another(result, tmp_path):
    submit([result], tmp_path / "s", name="My Agent", authors=["A"])
    for told in ({"name": "my-agent", "authors": ["A"]}, {"name": "My Agent", "authors": ["B"]}):
        with pytest.raises(SubmissionError, match="is My Agent by A: choose another name"):
            submit([result], tmp_path / "s", **told)
    assert load_submission(tmp_path / "s" / "my-agent" / "Block8-CPP-v0").manifest.authors == ("A",)


def test_a_name_of_an_older_version_is_not_taken_either(result, tmp_path):
    (folder,) = submit([result], tmp_path / "s", name="My Agent", authors=["A"])
    edit_manifest(folder, lambda table: table["result"].update(scenario_digest="0" * 64))
    with pytest.raises(SubmissionError, match="is My Agent by A: choose another name"):
        submit([result], tmp_path / "s", name="My Agent", authors=["B"])
    assert submit([result], tmp_path / "s", name="My Agent", authors=["A"]) == [folder]
    assert load_submission(folder).manifest.authors == ("A",)


def test_what_build_would_refuse_is_not_submitted(results, tmp_path):
    told = {"name": "a", "authors": ["b"]}
    coverage, harvesting = results["greedy"]
    submit([coverage], tmp_path / "s", **told)
    with pytest.raises(SubmissionError, match=r"link: .*Block8-CPP-v0 has none and track state: use the same"):
        submit([harvesting], tmp_path / "s", **told, link="https://example.org")
    with pytest.raises(SubmissionError, match="has none and track state: use the same"):
        submit([results["random"][1]], tmp_path / "s", **told)
    with pytest.raises(SubmissionError, match="track: greedy has state, random observation"):
        submit([coverage, results["random"][1]], tmp_path / "s", **told)
    assert [path.name for path in (tmp_path / "s" / "a").iterdir()] == ["Block8-CPP-v0"]
    both = submit([coverage, harvesting], tmp_path / "s", **told, link="https://example.org")
    assert {load_submission(each).manifest.link for each in both} == {"https://example.org"}


def test_a_users_own_files_are_not_deleted(result, tmp_path):
    (folder,) = submit([result], tmp_path / "s", name="a", authors=["b"])
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(SubmissionError, match=r"holds 'notes\.txt'"):
        submit([result], tmp_path / "s", name="a", authors=["b"])
    assert (folder / "notes.txt").read_text() == "mine"


def test_a_folder_that_cannot_be_written_is_named(result, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SubmissionError, match=f"{tmp_path / 'file'}: .*/file is a file, not a folder"):
        submit([result], tmp_path / "file", name="a", authors=["b"])


def test_two_results_on_one_scenario_are_no_submission(result, tmp_path):
    with pytest.raises(SubmissionError, match="two results"):
        submit([result, result], tmp_path / "s", name="a", authors=["b"])


def test_results_on_few_episodes_or_of_unknown_scenarios_are_no_submission(result, tmp_path):
    for change in ({"episodes": 999}, {"split": "validation"}, {"scenario": "Mine-v0"}, {"scenario_file": "mine.toml"}):
        copied = shutil.copytree(result.folder, tmp_path / next(iter(change)))
        (copied / "summary.json").write_text(json.dumps({**result.summary, **change}), encoding="utf-8")
        with pytest.raises(SubmissionError, match=rf"{next(iter(change))}|does not come with"):
            submit([load_result(copied)], tmp_path / "s", name="a", authors=["b"])
        assert list((tmp_path / "s").iterdir()) == []


def test_a_result_that_is_not_reproduced_is_no_submission(result, tmp_path):
    wrong = {**result.summary, "metrics": {**result.summary["metrics"], "cral": {"mean": 1.0, "low": 1.0, "high": 1.0}}}
    with pytest.raises(SubmissionError, match=r"not reproduced: summary\.json: metrics\.cral\.mean"):
        submit([Result(result.folder, wrong)], tmp_path / "s", name="a", authors=["b"])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda t: t.pop("name"), "name"),
        (lambda t: t.update(surprise=1), "surprise"),
        (lambda t: t.update(name="other"), "folders"),
        (lambda t: t["result"].pop("agent"), "agent"),
        (lambda t: t["result"].update(episodes="1000"), "episodes"),
        (lambda t: t["result"].update(episodes=10**12), "episodes"),
        (lambda t: t["result"].update(scenario="../../etc/passwd"), "scenario: .* is no name"),
        (lambda t: t["result"].update(scenario="Mine-v0"), "does not come with"),
        (lambda t: t["result"].update(agent="x/../../../escaped"), "agent: .* is no name"),
        (lambda t: t.update(authors=[" "]), "authors"),
        (lambda t: t["result"].update(scenario="Block8-DH-v0"), "folders"),
        (lambda t: t["result"].update(scenario_digest="0" * 64), "scenario_digest"),
        (lambda t: t["result"].update(split="train"), "split"),
        (lambda t: t["result"].update(track="telepathy"), "track"),
        (lambda t: t["result"].update(decisions=1), "decisions"),
        (lambda t: t["result"].update(decisions_per_second=float("nan")), "decisions_per_second"),
        (lambda t: t["result"].update(decisions_per_second=float("inf")), "decisions_per_second"),
        (lambda t: t["result"].update(decisions_per_second=-1.0), "decisions_per_second"),
        (lambda t: t["result"].update(decisions_per_second=1e300), "decisions_per_second"),
        (lambda t: t["result"].update(confidence=0.5), "confidence"),
        (lambda t: t["result"].update(wall_time=-1.0), "wall_time"),
        (lambda t: t["result"].update(agent_sha256="not a digest"), "agent_sha256"),
        (lambda t: t["result"].update(x={"x": {"x": 1}}), "x"),
        (lambda t: t["result"].pop("versions"), "versions"),
        (lambda t: t["result"]["versions"].pop("numpy"), "versions"),
        (lambda t: t["result"].update(agent="\u001b[2K"), "agent"),
        (lambda t: t["result"]["metrics"]["cral"].update(mean=0.999), r"metrics\.cral\.mean"),
        (lambda t: t["result"]["metrics"]["landed"].update(high=float("nan")), r"metrics\.landed\.high"),
        (lambda t: t["result"]["metrics"].pop("cr"), "cr"),
        (lambda t: t["result"]["metrics"]["cr"].update(mean="1.0"), "metrics"),
    ],
)
def test_a_wrong_manifest_is_refused(submissions, change, reason):
    edit_manifest(submissions / FOLDER, change)
    with pytest.raises(SubmissionError, match=reason):
        check(load_submission(submissions / FOLDER))
    refusal(submissions / FOLDER)


def test_a_manifest_that_is_no_toml_is_refused(submissions):
    (submissions / FOLDER / MANIFEST).write_bytes(b"\xff\xfe")
    assert MANIFEST in refusal(submissions / FOLDER)
    for text in ("a = ", "a = " + "[" * 20_000, "a = 0x" + "f" * 9000):
        (submissions / FOLDER / MANIFEST).write_text(text, encoding="utf-8")
        assert MANIFEST in refusal(submissions / FOLDER)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("1,", "2,", "hold the episodes"),
        (",1,", ",0,", "uavs is 1"),
        ("\n17,", "\n18,", "hold the episodes"),
        ("cral", "CRAL", "damaged"),
        ("return\n", "return,x\n", "its columns are not"),
        ("\n17,1,", "\n17.2,1,", "damaged"),
        ("\n17,1,", "\n17,1.9,", "damaged"),
        ("\n17,1,", "\n17,1,1,", "damaged"),
        ("\n17,1,", f"\n17,{10**30},", "damaged"),
        ("\n17,1,", "\n1_7, 1,", "is no number"),
        ("\n17,1,", "\n\N{ARABIC-INDIC DIGIT SEVEN},1,", "is no number"),
    ],
)
def test_an_edited_table_is_refused(submissions, old, new, reason):
    path = submissions / FOLDER / "episodes.csv"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    assert reason in refusal(submissions / FOLDER)


def test_a_missing_episode_is_refused(submissions):
    path = submissions / FOLDER / "episodes.csv"
    path.write_text("".join(path.read_text(encoding="utf-8").splitlines(keepends=True)[:-1]), encoding="utf-8")
    assert "hold the episodes" in refusal(submissions / FOLDER)


def shorter(table):
    table["offsets"], table["episodes"] = table["offsets"][:-1], table["episodes"][:-1]
    table["actions"] = table["actions"][: table["offsets"][-1]]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (shorter, "hold 1000 episodes"),
        (lambda t: t.update(actions=t["actions"].astype(np.int64)), "damaged"),
        (lambda t: t.update(actions=t["actions"][:, 0]), "whole episode"),
        (lambda t: t.update(actions=t["actions"] + 6), "whole episode"),
        (lambda t: t["actions"].__setitem__(slice(0, 40), 4), "episode 0"),
        (lambda t: t.update(offsets=-t["offsets"]), "damaged"),
        (lambda t: t["offsets"].__setitem__(1, 10**15), "damaged"),
        (lambda t: t.update(offsets=t["offsets"].astype(np.float64) + 0.5), "damaged"),
        (lambda t: t.update(offsets=np.zeros(0, dtype=np.int64)), "damaged"),
        (lambda t: t.update(episodes=t["episodes"][::-1]), "hold the episodes"),
        (lambda t: t.pop("episodes"), "damaged"),
        (lambda t: t.update(more=np.zeros(3)), "its arrays are not"),
        (lambda t: t.update(episodes=t["episodes"].astype(np.complex128)), "no signed integers"),
        (lambda t: t.update(offsets=t["offsets"].astype(np.uint64)), "no signed integers"),
        (lambda t: t.update(offsets=np.zeros(10**7, dtype=np.uint8)), "hold 1000 episodes"),
        (lambda t: t.update(offsets=np.zeros((1001, 1), dtype=np.int64)), "hold 1000 episodes"),
    ],
)
def test_wrong_actions_are_refused(submissions, change, reason):
    edit_actions(submissions / FOLDER, change)
    assert reason in refusal(submissions / FOLDER)


def test_files_that_are_not_what_they_should_be_are_refused(submissions):
    folder = submissions / FOLDER
    content = (folder / "actions.npz").read_bytes()
    (folder / "actions.npz").write_bytes(content[:-50])
    assert "damaged" in refusal(folder)
    with zipfile.ZipFile(folder / "actions.npz", "w", zipfile.ZIP_DEFLATED) as table:
        table.writestr("actions.npy", bytes(2**29))
    assert "64 MB" in refusal(folder)
    (folder / "actions.npz").write_bytes(bytes(2**22 + 1))
    assert "larger than" in refusal(folder)
    (folder / "actions.npz").unlink()
    assert "missing" in refusal(folder)
    (folder / "actions.npz").symlink_to("/dev/zero")
    assert "not a plain file" in refusal(folder)
    (folder / "actions.npz").unlink()
    os.mkfifo(folder / "actions.npz")
    assert "not a plain file" in refusal(folder)


def test_other_files_are_refused(submissions):
    (submissions / FOLDER / "setup.py").write_text("")
    assert "setup.py" in refusal(submissions / FOLDER)


def reads_author(name):
    return TypeAdapter(submission_module._Name).validate_python(name)


@pytest.mark.parametrize("name", [*"\u3164\uffa0\u2800\u034f\ufe0f\u115f\U000e0100 —", "A\u2800B", "a\u200db"])
def test_names_of_what_cannot_be_seen_are_no_authors(name):
    with pytest.raises(ValidationError, match=r"cannot be seen|needs a letter"):
        reads_author(name)


@pytest.mark.parametrize("name", ["A. Author", "山田 太郎", "محمد علي", "हिन्दी नाम", "Łukasz O’Neill", "이영희", "Nguyễn"])
def test_names_in_any_script_are_authors(name):
    assert reads_author(name) == name


@pytest.mark.parametrize("name", ["CON", "aux", "nul", "lpt1", "agent.", "Com1.x"])
def test_names_that_windows_cannot_file_are_refused(name):
    with pytest.raises(ValidationError, match="Windows"):
        TypeAdapter(submission_module.Manifest.model_fields["name"].rebuild_annotation()).validate_python(name)
