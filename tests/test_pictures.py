"""Results to look at: figures, films, reports, and a person who flies."""

import csv
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import uavbench
from uavbench import load_scenario
from uavbench.agent import find_agent
from uavbench.cli import app
from uavbench.envs.env import UAVEnv
from uavbench.evaluate import Job
from uavbench.play import play
from uavbench.results import ResultError
from uavbench.run import run
from uavbench.watch import recorded_scenes


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    out = tmp_path_factory.mktemp("results")
    names = ("Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0")
    return {
        (agent, name): run(Job(find_agent(agent), load_scenario(name), "test"), 60, out)
        for agent in ("greedy", "random")
        for name in names
    }


def uavbench_command(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0"])
def test_scenes_are_those_of_the_recorded_flight(results, name):
    result = results["greedy", name]
    row = result.episodes().iloc[17]
    scenes = recorded_scenes(result, 17)
    assert scenes[-1].title == f"Movement {row['steps']:.0f}/{row['budget']:.0f}, CR = {row['cr']:.2f}"
    assert scenes[0].title.startswith(f"Movement 0/{row['budget']:.0f}, CR = 0.00")
    assert len(scenes) == len(result.actions()[17]) + 1
    with pytest.raises(ResultError, match="60 is not one of the episodes 0 to 59"):
        recorded_scenes(result, 60)


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0"])
def test_plots_are_drawn_in_all_formats(results, name, ending, tmp_path):
    path = tmp_path / "new" / f"flight.{ending}"
    told = uavbench_command("plot", results["greedy", name].folder, "--episode", 3, "--out", path)
    assert told.exit_code == 0, told.output
    content = path.read_bytes()
    assert content.startswith({"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[ending])
    if ending == "svg":
        text = content.decode()
        assert "<!-- start and landing zone -->" in text
        assert ("<!-- target to cover -->" in text) == (name == "Block8-CPP-v0")
        assert "<!-- Movement " in text


def test_wrong_endings_and_episodes_are_refused(results, tmp_path):
    folder = results["greedy", "Block8-CPP-v0"].folder
    for command, path in (("plot", "a.txt"), ("film", "a.avi")):
        told = uavbench_command(command, folder, "--out", tmp_path / path)
        assert told.exit_code == 2
        assert "ends in" in told.output
        assert uavbench_command(command, folder, "--episode", 60, "--out", tmp_path / "a.png").exit_code == 2
    assert list(tmp_path.iterdir()) == []


def test_films_have_a_frame_for_each_step(results, tmp_path):
    result = results["greedy", "Block8-DH-v0"]
    steps = len(result.actions()[5])
    told = uavbench_command("film", result.folder, "--episode", 5, "--out", tmp_path / "f.gif", "--fps", 10)
    assert told.exit_code == 0, told.output
    with Image.open(tmp_path / "f.gif") as film:
        assert film.n_frames == steps + 1 or film.n_frames == len({s.title for s in recorded_scenes(result, 5)})
        assert film.size == (512, 512)
        film.seek(film.n_frames - 1)
        assert film.info["duration"] >= 2000
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="MP4 needs imageio-ffmpeg: pip install 'uavbench[film]'")
    told = uavbench_command("film", result.folder, "--episode", 5, "--out", tmp_path / "f.mp4", "--fps", 10)
    assert told.exit_code == 0, told.output
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "f.mp4"))[0] == steps + 1 + 20
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f.gif", "f.mp4"]


def test_reports_hold_the_scores_and_the_figures(results, tmp_path):
    pair = [results[agent, "Block8-DH-v0"] for agent in ("greedy", "random")]
    told = uavbench_command("report", *(result.folder for result in pair), "--out", tmp_path / "r")
    assert told.exit_code == 0, told.output
    rows = list(csv.reader((tmp_path / "r" / "comparison.csv").read_text(encoding="utf-8").splitlines()))
    for row, result in zip(rows[1:], pair, strict=True):
        assert row[0] == result.summary["agent"]
        assert row[3].startswith(f"{100 * result.metrics['cral'].mean:.1f} [")
    difference = pair[1].metrics["cral"].mean - pair[0].metrics["cral"].mean
    assert rows[2][4].startswith(f"{100 * difference:+.1f} [")
    assert (tmp_path / "r" / "comparison.md").read_text().count("|") == 4 * 7
    assert r"\begin{tabular}{lrrrrr}" in (tmp_path / "r" / "comparison.tex").read_text()
    figures = ("cral_against_budget", "cr_against_targets", "failures_against_budget", "performance_profiles")
    for name in figures:
        with Image.open(tmp_path / "r" / f"{name}.png") as picture:
            assert len(np.unique(np.asarray(picture.convert("L")))) > 20
        assert (tmp_path / "r" / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_results_of_different_episodes_are_not_reported_together(results, tmp_path):
    told = uavbench_command(
        "report", results["greedy", "Block8-CPP-v0"].folder, results["random", "Block8-DH-v0"].folder, "--out", tmp_path / "r"
    )
    assert told.exit_code == 2
    assert "cannot compare: scenario" in told.output
    assert not (tmp_path / "r").exists()


# Windows.


def test_human_shows_every_step_in_a_window():
    pygame = pytest.importorskip("pygame", reason="a window needs pygame-ce: pip install 'uavbench[human]'")
    for env in (UAVEnv("Block8-CPP-v0", render_mode="human"), uavbench.parallel_env("Block8-DH-v0", render_mode="human")):
        env.metadata["render_fps"] = 1000
        env.reset(seed=0)
        assert pygame.display.get_surface().get_size() == (512, 512)
        before = pygame.surfarray.array3d(pygame.display.get_surface())
        env.step(2 if isinstance(env, UAVEnv) else {"uav_0": 2})
        assert (pygame.surfarray.array3d(pygame.display.get_surface()) != before).any()
        assert env.render() is None
        env.close()
        assert pygame.display.get_surface() is None


class Keys:
    """A window that presses keys."""

    def __init__(self, keys):
        self.keys, self.titles = list(keys), []

    def show(self, picture, title, fps=None):
        assert picture.dtype == np.uint8
        self.titles.append(title)

    def key(self):
        return self.keys.pop(0) if self.keys else None

    def close(self):
        self.titles.append("closed")


def test_a_person_flies_and_is_scored():
    records = []
    keys = ["left", "x", "return", "space", "n", "down", "r", "return", "q", "never"]
    window = Keys(keys)
    play(load_scenario("Block8-CPP-v0"), "test", 3, records.append, window)
    assert [(record.episode, record.landed) for record in records] == [(3, True), (4, True)]
    assert records[0].actions[:, 0].tolist() == [3, 5]
    assert records[1].steps == 1
    assert "landed" in window.titles[4]
    assert window.keys == ["never"]
    assert window.titles[-1] == "closed"


def test_the_window_hears_keys_and_closing():
    pygame = pytest.importorskip("pygame", reason="a window needs pygame-ce: pip install 'uavbench[human]'")
    from uavbench.window import Window

    window = Window()
    window.show(np.zeros((40, 60, 3), dtype=np.uint8), "title")
    assert pygame.display.get_caption()[0] == "title"
    for key in (pygame.K_UP, pygame.K_SPACE):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    assert [window.key(), window.key()] == ["up", "space"]
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert window.key() is None
    window.close()


def test_play_by_command_says_what_is_wrong():
    assert "for a team" in uavbench_command("play", "Manhattan32-DH-Team-v0").output
    assert "out of range" in uavbench_command("play", "Block8-CPP-v0", "--split", "test", "--episode", 1000).output
    assert uavbench_command("play", "Block8-CPP-v0", "--split", "exam").exit_code == 2


@pytest.mark.parametrize(("module", "extra"), [("pygame", "human"), ("imageio_ffmpeg", "film")])
def test_a_missing_extra_is_named(results, module, extra, tmp_path):
    folder = results["greedy", "Block8-CPP-v0"].folder
    words = {"human": ["play", "Block8-CPP-v0"], "film": ["film", str(folder), "--out", str(tmp_path / "f.mp4")]}[extra]
    code = f"import sys; sys.modules[{module!r}] = None; from uavbench.cli import app; app()"
    told = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert told.returncode == 2
    assert f"uavbench[{extra}]" in told.stderr
