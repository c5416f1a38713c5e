"""What reads files and options that others made, with valid examples of each for a fuzzer to change.

A reader takes bytes, and may refuse them only by an error that uavbench raises on purpose.
"""

import ast
import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from places import extract, feature, osm, ring, way

from uavbench import UavbenchError, load_scenario, make, parallel_env
from uavbench.agents.agent import find_agent
from uavbench.agents.onnx_agent import Agent as OnnxAgent
from uavbench.agents.weights import load_weights, save_weights
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.kept import FILE, read_kept
from uavbench.evaluation.run import run_shard
from uavbench.evaluation.shards import Shard
from uavbench.geodata import CityOptions, import_city
from uavbench.leaderboard.best_known import load_best_known
from uavbench.leaderboard.flown import load_flown
from uavbench.leaderboard.submission import check, load_submission
from uavbench.world.cells import cells_of
from uavbench.world.maps import map_picture

ROOT = Path(__file__).parents[2]
SCENARIOS = ROOT / "scenarios"
BLOCK = load_scenario("Block8-CPP-v0")
BEST_KNOWN = ROOT / "leaderboard" / "best_known"
SUBMISSION = ROOT / "leaderboard" / "submissions" / "random" / "Block8-CPP-v0"


@dataclass(frozen=True)
class Reader:
    """A reader, and valid inputs.

    Attributes
    ----------
    read : callable
        Takes bytes and an empty folder.
    examples : callable
        Takes an empty folder, and returns valid inputs as bytes.
    refusals : tuple of exception classes
        How it refuses an input.
    """

    read: Callable[[bytes, Path], object]
    examples: Callable[[Path], list[bytes]]
    refusals: tuple[type[Exception], ...] = (UavbenchError,)

    def __call__(self, content: bytes) -> bool:
        """Read bytes; return whether they were taken, and let every error through that is no refusal."""
        with tempfile.TemporaryDirectory() as folder:
            try:
                self.read(content, Path(folder))
            except self.refusals as error:
                said = str(error)
            else:
                return True
        if not said.strip():
            raise AssertionError("an error without a message")
        return False


def _read_scenario(content: bytes, folder: Path) -> None:
    shutil.copytree(SCENARIOS / "maps", folder / "maps")
    (folder / "own.toml").write_bytes(content)
    load_scenario(folder / "own.toml")


def _scenarios(_folder: Path) -> list[bytes]:
    names = ("Block8-CPP-v0", "Block8-DH-v0", "Cities32-DH-Team-v0", "City64-CPP-v0")
    return [(SCENARIOS / f"{name}.toml").read_bytes() for name in names]


def _map_reader(name: str) -> Callable[[bytes, Path], None]:
    def read(content: bytes, folder: Path) -> None:
        (folder / name).write_bytes(content)
        text = (SCENARIOS / "Block8-CPP-v0.toml").read_text(encoding="utf-8")
        text = text.replace("maps/Block8.txt", name).replace("Block8-CPP-v0", "Own-CPP-v0")
        assert name in text
        (folder / "own.toml").write_text(text, encoding="utf-8")
        load_scenario(folder / "own.toml")

    return read


def _maps(folder: Path) -> list[bytes]:
    return [(SCENARIOS / "maps" / "Block8.txt").read_bytes()]


def _pictures(_folder: Path) -> list[bytes]:
    return [map_picture(cells_of(BLOCK.rows))]


def _city_reader(name: str) -> Callable[[bytes, Path], None]:
    def read(content: bytes, folder: Path) -> None:
        (folder / name).write_bytes(content)
        import_city(folder / name, folder / "own.toml", CityOptions(shape=(16, 16)))

    return read


def _geojson(_folder: Path) -> list[bytes]:
    town = [feature([ring(-40, -20, 40, 20)], building="yes", height="30"), feature([ring(10, 30, 20, 20)], building="yes")]
    return [json.dumps({"type": "FeatureCollection", "features": town}).encode(), json.dumps(town[0]).encode()]


def _osm(folder: Path) -> list[bytes]:
    return [osm(folder / "town.osm", way(1, (1, 2, 3, 4, 1), building="yes", building_levels="4")).read_bytes()]


def _submission_reader(name: str) -> Callable[[bytes, Path], None]:
    def read(content: bytes, folder: Path) -> None:
        place = folder / "random" / "Block8-CPP-v0"
        shutil.copytree(SUBMISSION, place)
        (place / name).write_bytes(content)
        check(load_submission(place))

    return read


def _submitted(name: str) -> Callable[[Path], list[bytes]]:
    return lambda _folder: [(SUBMISSION / name).read_bytes()]


def _best_known_reader(ending: str) -> Callable[[bytes, Path], None]:
    def read(content: bytes, folder: Path) -> None:
        for path in BEST_KNOWN.glob(f"{BLOCK.id}.*"):
            (folder / path.name).write_bytes(content if path.suffix == ending else path.read_bytes())
        load_best_known(folder, BLOCK)

    return read


def _best_known(ending: str) -> Callable[[Path], list[bytes]]:
    return lambda _folder: [(BEST_KNOWN / f"{BLOCK.id}{ending}").read_bytes()]


def _read_flown(content: bytes, folder: Path) -> None:
    (folder / "flown.csv").write_bytes(content)
    load_flown(folder / "flown.csv")


def _read_records(content: bytes, folder: Path) -> None:
    (folder / FILE).write_bytes(content)
    read_kept(folder)


def _records(folder: Path) -> list[bytes]:
    return [(run_shard(Job(find_agent("random"), BLOCK, "test"), Shard(1, 100, 1000), folder) / FILE).read_bytes()]


def _read_weights(content: bytes, folder: Path) -> None:
    (folder / "own.safetensors").write_bytes(content)
    load_weights(folder / "own.safetensors")


def _weights(folder: Path) -> list[bytes]:
    arrays = {"first.weight": np.zeros((3, 2), dtype=np.float32), "scale": np.array([0.1])}
    save_weights(folder / "own.safetensors", arrays, {"agent": "ddqn", "scenario": BLOCK.id})
    return [(folder / "own.safetensors").read_bytes()]


def _read_model(content: bytes, folder: Path) -> None:
    (folder / "own.onnx").write_bytes(content)
    OnnxAgent(BLOCK, folder / "own.onnx")


def _models(_folder: Path) -> list[bytes]:
    """A model that gives six sums of the local map."""
    from onnx import TensorProto, helper

    shape = [int(n) for n in make(BLOCK.id).observation_space["local"].shape]
    local = helper.make_tensor_value_info("local", TensorProto.FLOAT, ["batch", *shape])
    values = helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", 6])
    weights = helper.make_tensor("w", TensorProto.FLOAT, [int(np.prod(shape)), 6], np.zeros(int(np.prod(shape)) * 6))
    nodes = [helper.make_node("Flatten", ["local"], ["flat"]), helper.make_node("MatMul", ["flat", "w"], ["values"])]
    graph = helper.make_graph(nodes, "small", [local], [values], [weights])
    return [helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8).SerializeToString()]


def _read_options(content: bytes, _folder: Path) -> None:
    try:
        options = ast.literal_eval(content.decode())
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return  # no Python value, so no options
    refused = []
    for name in ("Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0"):
        env = _env(name)
        try:
            env.reset(options=options)
        except ValueError as error:
            refused.append(error)
    if len(refused) == 3:
        raise refused[0]


@lru_cache
def _env(name: str) -> Any:
    return parallel_env(name) if "Team" in name else make(name)


def _options(_folder: Path) -> list[bytes]:
    return [
        b"{'split': 'validation', 'episode': 3}",
        b"{'start': [1, 1], 'budget': 12, 'noise': False, 'devices': [[2, 3, 9.5], [4, 4, 10]]}",
        b"{'start': 'anywhere', 'targets': [[0, 1, 1, 0, 0, 0, 0, 0]] * 8}",
        b"{'start': 'landing', 'num_uavs': 2, 'budget': [30, 40]}",
    ]


READERS = {
    "scenario": Reader(_read_scenario, _scenarios),
    "map": Reader(_map_reader("own.txt"), _maps),
    "picture": Reader(_map_reader("own.png"), _pictures),
    "geojson": Reader(_city_reader("own.geojson"), _geojson),
    "osm": Reader(_city_reader("own.osm"), _osm),
    "pbf": Reader(_city_reader("own.osm.pbf"), lambda _folder: [extract("test.osm.pbf").read_bytes()]),
    "manifest": Reader(_submission_reader("manifest.toml"), _submitted("manifest.toml")),
    "actions": Reader(_submission_reader("actions.npz"), _submitted("actions.npz")),
    "episodes": Reader(_submission_reader("episodes.csv"), _submitted("episodes.csv")),
    "best_known": Reader(_best_known_reader(".csv"), _best_known(".csv")),
    "best_known_actions": Reader(_best_known_reader(".npz"), _best_known(".npz")),
    "flown": Reader(_read_flown, lambda _folder: [(BEST_KNOWN.parent / "flown.csv").read_bytes()]),
    "records": Reader(_read_records, _records),
    "weights": Reader(_read_weights, _weights),
    "model": Reader(_read_model, _models, (UavbenchError, ValueError)),
    "options": Reader(_read_options, _options, (ValueError,)),
}
