"""Results to look at: figures, films, reports, and a person who flies."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import renamed, uavbench_command
from matplotlib.lines import Line2D
from PIL import Image

import uavbench
from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.drawing.raster import raster
from uavbench.envs.env import UAVEnv
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.results import ResultError
from uavbench.evaluation.run import run
from uavbench.pictures.play import play
from uavbench.pictures.plot import draw, legend
from uavbench.pictures.watch import recorded_scenes
from uavbench.world.resources import scenario_paths


@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0"])
def test_scenes_are_those_of_the_recorded_flight(pictured, name):
    result = pictured["greedy", name]
    row = result.episodes().iloc[17]
    scenes = recorded_scenes(result, 17)
    assert scenes[-1].title == f"Movement {row['steps']:.0f}/{row['budget']:.0f}, CR = {row['cr']:.2f}"
    assert scenes[-1].crashes == []
    assert scenes[0].title.startswith(f"Movement 0/{row['budget']:.0f}, CR = 0.00")
    assert len(scenes) == len(result.actions()[17]) + 1
    with pytest.raises(ResultError, match="60 is not one of the episodes 0 to"):
        recorded_scenes(result, 60)


def test_devices_are_full_before_the_first_step(pictured):
    for episode in range(20):
        scenes = recorded_scenes(pictured["greedy", "Manhattan32-DH-Team-v0"], episode)
        assert [device.left for device in scenes[0].devices] == pytest.approx([1.0] * len(scenes[0].devices))
        assert all(0 <= device.left <= 1 for scene in scenes for device in scene.devices)  # a wedge beyond 1 is empty


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0"])
def test_plots_are_drawn_in_all_formats(pictured, name, ending, tmp_path):
    path = tmp_path / "new" / f"flight.{ending}"
    told = uavbench_command("plot", pictured["greedy", name].folder, "--episode", 3, "--out", path)
    assert told.exit_code == 0, told.output
    content = path.read_bytes()
    assert content.startswith({"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[ending])
    if ending == "svg":
        text = content.decode()
        assert "<!-- start and landing zone -->" in text
        assert ("<!-- target to cover -->" in text) == (name == "Block8-CPP-v0")
        assert "<!-- Movement " in text


def test_a_figure_of_a_team_lists_the_uavs_that_fly(pictured):
    result = pictured["greedy", "Manhattan32-DH-Team-v0"]
    flying = result.episodes()["uavs"].tolist()
    assert set(flying) == {1, 2, 3}
    for count in (1, 2, 3):
        entries = [entry.get_label() for entry in legend(recorded_scenes(result, flying.index(count))[-1])]
        assert [entry for entry in entries if entry.startswith("UAV")] == [f"UAV {u}" for u in range(count)]


def test_the_start_is_told_from_the_end(pictured):
    result = pictured["greedy", "Block8-CPP-v0"]
    scenes = (recorded_scenes(result, k)[-1] for k in range(60))
    scene = next(scene for scene in scenes if scene.ends and scene.starts[0][0] != scene.ends[0][0])
    size = 512 // 8
    centres = [raster(scene)[r * size + size // 2, c * size + size // 2] for (r, c), _ in (scene.starts[0], scene.ends[0])]
    assert [centre.tolist() for centre in centres] == [[255, 255, 255], list(scene.ends[0][1])]
    entries = {entry.get_label(): entry for entry in legend(scene) if isinstance(entry, Line2D)}
    assert entries["start"].get_markerfacecolor() != entries["end"].get_markerfacecolor()
    (axes,) = draw(scene).axes
    drawn = [marks.get_facecolors()[:, :3] for marks in axes.collections]
    assert [colours.max() < 0.5 for colours in drawn if len(colours) == 1] == [True, False, True]  # start, its hole, end


def test_wrong_endings_and_episodes_are_refused(pictured, tmp_path):
    folder = pictured["greedy", "Block8-CPP-v0"].folder
    for command, path in (("plot", "a.txt"), ("film", "a.avi")):
        told = uavbench_command(command, folder, "--out", tmp_path / path)
        assert told.exit_code == 2
        assert "ends in" in told.output
        assert uavbench_command(command, folder, "--episode", 60, "--out", tmp_path / "a.png").exit_code == 2
    assert list(tmp_path.iterdir()) == []


def test_films_have_a_frame_for_each_step(pictured, tmp_path):
    result = pictured["greedy", "Block8-DH-v0"]
    steps = len(result.actions()[5])
    told = uavbench_command("film", result.folder, "--episode", 5, "--out", tmp_path / "f.gif", "--fps", 10)
    assert told.exit_code == 0, told.output
    with Image.open(tmp_path / "f.gif") as film:
        assert film.n_frames == steps + 1 or film.n_frames == len({s.title for s in recorded_scenes(result, 5)})
        assert film.size == (512, 512 + 30)
        for k in (0, film.n_frames - 1):  # in the colours of the scenes, whatever the other frames show
            film.seek(k)
            wanted = raster(recorded_scenes(result, 5)[0 if k == 0 else -1])
            assert (np.asarray(film.convert("RGB"))[:512] == wanted).all()
        film.seek(film.n_frames - 1)
        assert film.info["duration"] >= 2000
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="MP4 needs imageio-ffmpeg: pip install 'uavbench[film]'")
    told = uavbench_command("film", result.folder, "--episode", 5, "--out", tmp_path / "f.mp4", "--fps", 10)
    assert told.exit_code == 0, told.output
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "f.mp4"))[0] == steps + 1 + 20
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f.gif", "f.mp4"]


@pytest.mark.parametrize("command", ["plot", "film"])
def test_the_name_of_an_agent_leads_nowhere(pictured, tmp_path, monkeypatch, command):
    """The default name of the file is made of it."""
    folder = renamed(pictured["greedy", "Block8-DH-v0"], tmp_path / "greedy", "x/../../escaped")
    (tmp_path / "a" / "b").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "a" / "b")
    told = uavbench_command(command, folder)
    assert (told.exit_code, "is no name" in told.output) == (2, True), told.output
    assert sorted(path.name for path in tmp_path.rglob("*")) == sorted(
        ["a", "b", "greedy", *(path.name for path in folder.iterdir())]
    )


@pytest.mark.parametrize(("command", "name"), [("plot", "a.png"), ("film", "a.gif"), ("report", "r")])
def test_what_cannot_be_written_is_said(pictured, tmp_path, command, name):
    (tmp_path / "file").write_text("mine")
    told = uavbench_command(command, pictured["greedy", "Block8-CPP-v0"].folder, "--out", tmp_path / "file" / name)
    assert (told.exit_code, "cannot write it" in told.output) == (2, True), told.output
    assert (tmp_path / "file").read_text() == "mine"


def test_a_film_that_ffmpeg_did_not_finish_is_none(pictured, tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="MP4 needs imageio-ffmpeg: pip install 'uavbench[film]'")
    monkeypatch.setattr(ffmpeg, "count_frames_and_secs", lambda path: (3, 0.2))
    told = uavbench_command("film", pictured["greedy", "Block8-CPP-v0"].folder, "--out", tmp_path / "a.mp4")
    assert (told.exit_code, "ffmpeg wrote 3 of" in told.output) == (2, True), told.output
    assert list(tmp_path.iterdir()) == []


def test_a_scenario_that_has_moved_is_asked_for(tmp_path):
    text = scenario_paths()["Block8-CPP-v0"].read_text(encoding="utf-8")
    mine, folder = tmp_path / "mine.toml", scenario_paths()["Block8-CPP-v0"].parent
    text = re.sub(r"maps/\S+txt", lambda found: str(folder / found[0]), text.replace("Block8-CPP-v0", "Mine-CPP-v0"))
    mine.write_text(text, encoding="utf-8")
    result = run(Job(find_agent("greedy"), load_scenario(str(mine)), "train"), 2, tmp_path / "out")
    moved = mine.rename(tmp_path / "moved.toml")
    for command, name in (("plot", "a.png"), ("film", "a.gif")):
        told = uavbench_command(command, result.folder, "--out", tmp_path / name)
        assert (told.exit_code, "--scenario FILE" in told.output) == (2, True), told.output
        told = uavbench_command(command, result.folder, "--out", tmp_path / name, "--scenario", moved)
        assert told.exit_code == 0, told.output


def test_submissions_are_drawn_too(tmp_path):
    folder = Path(__file__).parents[2] / "leaderboard" / "submissions" / "greedy" / "Block8-DH-v0"
    told = uavbench_command("plot", folder, "--out", tmp_path / "a.PNG")
    assert told.exit_code == 0, told.output
    assert (tmp_path / "a.PNG").read_bytes().startswith(b"\x89PNG")


# Windows.


def test_human_shows_every_step_in_a_window():
    pygame = pytest.importorskip("pygame", reason="a window needs pygame-ce: pip install 'uavbench[human]'")
    for env in (UAVEnv("Block8-CPP-v0", render_mode="human"), uavbench.parallel_env("Block8-DH-v0", render_mode="human")):
        env.metadata["render_fps"] = 1000
        env.reset(seed=0)
        assert pygame.display.get_surface().get_size() == (512, 512 + 30)
        before = pygame.surfarray.array3d(pygame.display.get_surface())
        env.step(2 if isinstance(env, UAVEnv) else {"uav_0": 2})
        assert (pygame.surfarray.array3d(pygame.display.get_surface()) != before).any()
        assert env.render() is None
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        env.step(0 if isinstance(env, UAVEnv) else {"uav_0": 0})  # a closed window stays as it was
        shown = pygame.surfarray.array3d(pygame.display.get_surface())
        env.step(0 if isinstance(env, UAVEnv) else {"uav_0": 0})
        assert (pygame.surfarray.array3d(pygame.display.get_surface()) == shown).all()
        env.close()
        assert pygame.display.get_surface() is None


class Keys:
    """A window that presses keys."""

    def __init__(self, keys):
        self.keys, self.titles, self.pictures = list(keys), [], []

    def show(self, picture, title, fps=None):
        assert picture.dtype == np.uint8
        self.pictures.append(picture)
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
    assert (window.pictures[2][512:] != window.pictures[3][512:]).any()  # the score stands below
    assert window.keys == ["never"]
    assert window.titles[-1] == "closed"


def test_the_window_hears_keys_and_closing():
    pygame = pytest.importorskip("pygame", reason="a window needs pygame-ce: pip install 'uavbench[human]'")
    from uavbench.drawing.window import Window

    window = Window()
    window.show(np.zeros((40, 60, 3), dtype=np.uint8), "title")
    assert pygame.display.get_caption()[0] == "title"
    for key in (pygame.K_UP, pygame.K_SPACE):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    assert [window.key(), window.key()] == ["up", "space"]
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert window.key() is None
    window.close()


def test_after_the_last_episode_comes_the_first():
    window = Keys(["n", "q"])
    play(load_scenario("Block8-CPP-v0"), "test", 999, window=window)
    assert window.titles == ["Block8-CPP-v0 test 999", "Block8-CPP-v0 test 0", "closed"]


def test_ctrl_c_ends_the_game():
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # a job in the background ignores it
    code = f"{heard}; from uavbench.cli.app import app; from uavbench.drawing.window import Window; show = Window.show\n"
    code += "Window.show = lambda *a: (show(*a), print('shown', flush=True))\napp(['play', 'Block8-DH-v0'])"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip().endswith("shown")
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert (process.returncode, "Traceback" in errors) == (1, False), errors


@pytest.mark.parametrize("driver", ["", "x11"])
def test_a_missing_display_is_said_instead_of_waiting(driver):
    pytest.importorskip("pygame", reason="a window needs pygame-ce: pip install 'uavbench[human]'")
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")}
    told = subprocess.run(
        [sys.executable, "-c", "from uavbench.cli.app import app; app()", "play", "Block8-CPP-v0"],
        env=kept | ({"SDL_VIDEODRIVER": driver} if driver else {}),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert (told.returncode, "no display" in told.stderr) == (2, True), told.stderr


def test_play_by_command_says_what_is_wrong():
    assert "for a team" in uavbench_command("play", "Manhattan32-DH-Team-v0").output
    assert "out of range" in uavbench_command("play", "Block8-CPP-v0", "--split", "test", "--episode", 1000).output
    assert uavbench_command("play", "Block8-CPP-v0", "--split", "exam").exit_code == 2


@pytest.mark.parametrize(("module", "extra"), [("pygame", "human"), ("imageio_ffmpeg", "film")])
def test_a_missing_extra_is_named(pictured, module, extra, tmp_path):
    folder = pictured["greedy", "Block8-CPP-v0"].folder
    words = {"human": ["play", "Block8-CPP-v0"], "film": ["film", str(folder), "--out", str(tmp_path / "f.mp4")]}[extra]
    code = f"import sys; sys.modules[{module!r}] = None; from uavbench.cli.app import app; app()"
    told = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert told.returncode == 2
    assert f"uavbench[{extra}]" in told.stderr
