"""A flight as a film: MP4 by imageio-ffmpeg (``pip install "uavbench[film]"``), GIF by Pillow, which comes with Matplotlib."""

import importlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from uavbench.render import raster
from uavbench.results import ResultError
from uavbench.scene import Scene

_LAST_SECONDS = 2.0  # how long the end is shown

Frames = Sequence[NDArray[np.uint8]]


def save_film(scenes: Sequence[Scene], path: Path, fps: float, on_frame: Callable[[object], None] = lambda scene: None) -> None:
    """Write scenes as a film; the file's ending says which format. It is there as a whole or not at all.

    Raises
    ------
    ResultError
        When the ending is neither ``.mp4`` nor ``.gif``, imageio-ffmpeg is missing for ``.mp4``, or the file cannot be written.
    """
    writers = {".mp4": _write_mp4, ".gif": _write_gif}
    if path.suffix not in writers:
        raise ResultError(f"{path}: write to a file that ends in {' or '.join(writers)}")
    frames: list[NDArray[np.uint8]] = []
    for scene in scenes:
        frames.append(raster(scene))
        on_frame(scene)
    unfinished = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writers[path.suffix](frames, unfinished, fps)
        unfinished.replace(path)
    except OSError as error:
        raise ResultError(f"{path}: cannot write it: {error}") from None
    finally:
        unfinished.unlink(missing_ok=True)


def _write_mp4(frames: Frames, path: Path, fps: float) -> None:
    try:
        ffmpeg: Any = importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise ResultError('.mp4 needs imageio-ffmpeg: pip install "uavbench[film]"; .gif does not') from None
    height, width, _ = frames[0].shape
    writer = ffmpeg.write_frames(str(path), (width, height), fps=fps, macro_block_size=2, output_params=["-crf", "20"])
    writer.send(None)
    for picture in (*frames, *[frames[-1]] * round(_LAST_SECONDS * fps)):
        writer.send(np.ascontiguousarray(picture))
    writer.close()


def _write_gif(frames: Frames, path: Path, fps: float) -> None:
    colours = Image.fromarray(frames[-1]).quantize(255)  # one palette: what does not change is not written again
    pictures = [Image.fromarray(picture).quantize(palette=colours, dither=Image.Dither.NONE) for picture in frames]
    durations = [round(1000 / fps)] * (len(pictures) - 1) + [round(1000 * _LAST_SECONDS)]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=False)
