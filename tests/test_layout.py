"""The layout of the package: which room may import which, and the old names of what has moved."""

import ast
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import uavbench
from uavbench.moved import MOVED
from uavbench.world.resources import baselines_folder

PACKAGE = Path(uavbench.__file__).parent
ADR = Path(__file__).parents[1] / "docs" / "adr" / "0001-the-layout.md"


def allowed() -> dict[str, set[str]]:
    """Return the rooms that each room may import, as the table of ADR 1 says."""
    rows = re.findall(r"^\| `(\w+)/` \|[^|]*\|([^|]*)\|$", ADR.read_text(encoding="utf-8"), re.MULTILINE)
    return {room: set(re.findall(r"`(\w+)`", below)) for room, below in rows}


def upward(source: str, room: str, rooms: dict[str, set[str]]) -> list[str]:
    """Return the modules that a source in ``room`` imports and may not; what only type checkers import does not count."""
    found: list[str] = []
    tree = ast.parse(source)
    for node in list(ast.walk(tree)):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts[0] == "uavbench" and len(parts) > 1 and parts[1] in rooms and parts[1] not in rooms[room] | {room}:
                found.append(name)
    return found


def test_every_folder_is_a_room_of_the_table() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(allowed())


def test_the_rooms_stand_above_each_other() -> None:
    rooms = allowed()
    done: set[str] = set()
    while len(done) < len(rooms):
        free = {room for room, below in rooms.items() if room not in done and below <= done}
        assert free, f"{sorted(set(rooms) - done)} import each other"
        done |= free


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("*/**/*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_one_way(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0]
    if room in ("baselines", "scenarios"):  # in a wheel they are inside the package
        return
    assert upward(path.read_text(encoding="utf-8"), room, allowed()) == []


@pytest.mark.parametrize("line", ["from uavbench.cli.app import app", "import uavbench.leaderboard.board"])
def test_an_upward_import_is_found(line: str) -> None:
    assert upward(f"def later():\n    {line}\n", "simulation", allowed())


@pytest.mark.parametrize("old", sorted(MOVED))
def test_what_an_old_name_leads_to_is_there(old: str) -> None:
    assert importlib.util.find_spec(f"uavbench.{MOVED[old]}") is not None


def test_old_names_warn_and_lead_to_the_same_things() -> None:
    code = (
        "import warnings; warnings.simplefilter('error')\n"
        "import uavbench, uavbench.simulation.missions.coverage as new, uavbench.world.city as city\n"
        "with warnings.catch_warnings(record=True) as told:\n"
        "    warnings.simplefilter('always')\n"
        "    import uavbench.city\n"
        "    from uavbench.missions.coverage import camera_views\n"
        "    from uavbench.missions import Mission\n"
        "    from uavbench.memory import episodes_at_once, keep_freed\n"
        "assert uavbench.city.City is city.City and camera_views is new.camera_views\n"
        "print(*(f'{each.filename} {each.category.__name__} {each.message}' for each in told), sep='\\n')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == (
        "<string> DeprecationWarning uavbench.city is now uavbench.world.city; the old name works until version 0.3"
    )
    assert "uavbench.missions.coverage is now uavbench.simulation.missions.coverage" in done.stdout


def functions() -> list[tuple[str, ast.FunctionDef]]:
    """Return the functions of the package and the baselines that are no kernels, with what they are called."""
    return [
        (f"{path.relative_to(path.parents[1])}:{node.name}", node)
        for path in sorted([*PACKAGE.rglob("*.py"), *baselines_folder().glob("*.py")])
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and not any("kernel" in ast.unparse(each) for each in node.decorator_list)
    ]


def lines_of_code(node: ast.FunctionDef) -> int:
    """Return how many lines a function has behind its docstring."""
    body = node.body[1:] if ast.get_docstring(node) else node.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


#: What has more arguments than eight, and why.
LONG_SIGNATURES = {
    "cli/cities.py:import_city": "the options of the command",
    "cli/evaluation.py:evaluate": "the options of the command",
    "cli/leaderboard.py:rerun": "the options of the command",
    "cli/flight.py:fly": "the options of the command",
    "cli/flight.py:mission": "the options of the command",
    "cli/flight.py:plan": "the options of the command",
    "cli/learning.py:train": "the options of the command",
    "leaderboard/submit.py:submit": "what a submission says about itself",
    "learning/train.py:train": "the options of a training, and who is told how it goes",
    "envs/env.py:__init__": "keyword arguments, which Gymnasium takes flat",
    "envs/vector_env.py:__init__": "keyword arguments, which Gymnasium takes flat",
    "envs/parallel_env.py:__init__": "keyword arguments, which PettingZoo takes flat",
    "bounds/harvesting.py:harvesting_bound": "a whole problem",
    "planning/coverage.py:search": "a whole problem",
    "planning/harvesting.py:_search_nearby": "a whole problem, already read",
    "planning/harvesting.py:search": "a whole problem; those of a kind are one argument when the planner is next changed",
}


def test_functions_are_short() -> None:
    assert [name for name, node in functions() if lines_of_code(node) > 50] == []


def test_functions_have_few_arguments() -> None:
    long = {
        name
        for name, node in functions()
        if len([each for each in (*node.args.args, *node.args.kwonlyargs) if each.arg not in ("self", "cls")]) > 8
    }
    assert long == set(LONG_SIGNATURES)
