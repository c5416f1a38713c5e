"""A flight as a film: MP4 by imageio-ffmpeg (``pip install "uavbench[film]"``), GIF by Pillow."""

import importlib
import io
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from uavbench.drawing.raster import captioned, raster
from uavbench.drawing.scene import Scene
from uavbench.evaluation.results import ResultError, deliver

_LAST_SECONDS = 2.0  # how long the last frame is shown
_FASTEST_GIF = 50.0  # delays are whole hundredths of a second, and browsers show 1/100 s as 10/100 s
_PALETTE_FRAMES = 16  # from which the palette of a GIF is made

Told = Callable[[object], None]


def check_film(path: Path, fps: float) -> None:
    """Refuse a film that cannot be written, before the episode is flown.

    Raises
    ------
    ResultError
        When the ending is neither ``.mp4`` nor ``.gif``, ``fps`` is too high for a GIF, or imageio-ffmpeg is missing for
        ``.mp4``.
    """
    ending = path.suffix.lower()
    if ending not in _WRITERS:
        raise ResultError(f"{path}: write to a file that ends in {' or '.join(_WRITERS)}")
    if ending == ".gif" and fps > _FASTEST_GIF:
        raise ResultError(f"--fps {fps:g}: a GIF has {_FASTEST_GIF:g} frames a second at most; write an .mp4")
    if ending == ".mp4":
        _ffmpeg()


def save_film(scenes: Sequence[Scene], path: Path, fps: float, on_frame: Told = lambda scene: None) -> None:
    """Write scenes as a film in the format of the file's ending. On failure, an existing file does not change.

    Raises
    ------
    ResultError
        As `check_film`, or when the file cannot be written.
    """
    check_film(path, fps)
    deliver({path: _WRITERS[path.suffix.lower()](scenes, fps, on_frame)})


def _frame(scene: Scene) -> NDArray[np.uint8]:
    return captioned(raster(scene), scene.title)


def _ffmpeg() -> Any:
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise ResultError('.mp4 needs imageio-ffmpeg: pip install "uavbench[film]"; .gif does not') from None


def _mp4(scenes: Sequence[Scene], fps: float, on_frame: Told) -> bytes:
    """Return the film. Its frames are counted, because ffmpeg may fail without an error."""
    ffmpeg, last = _ffmpeg(), _frame(scenes[-1])
    height, width, _ = last.shape
    wanted = len(scenes) + round(_LAST_SECONDS * fps)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        try:
            writer = ffmpeg.write_frames(str(path), (width, height), fps=fps, macro_block_size=2, output_params=["-crf", "20"])
            writer.send(None)
            for k in range(wanted):
                writer.send(np.ascontiguousarray(_frame(scenes[k]) if k < len(scenes) else last))
                if k < len(scenes):
                    on_frame(scenes[k])
            writer.close()
            written = ffmpeg.count_frames_and_secs(str(path))[0]
        except (OSError, RuntimeError) as error:
            raise ResultError(f"ffmpeg could not make the film: {str(error).strip().splitlines()[0]}") from None
        if written != wanted:
            raise ResultError(f"ffmpeg wrote {written} of {wanted} frames: is there room in {folder}?")
        return path.read_bytes()


def _gif(scenes: Sequence[Scene], fps: float, on_frame: Told) -> bytes:
    """Return the film. All frames share one palette, so that unchanged parts are not written again."""
    picked: list[int] = np.linspace(0, len(scenes) - 1, min(len(scenes), _PALETTE_FRAMES)).astype(int).tolist()
    some = [_frame(scenes[k]) for k in picked]
    colours = np.unique(np.concatenate([np.unique(_codes(picture)) for picture in some]))
    palette = Image.new("P", (1, 1))
    if len(colours) <= 256:
        palette.putpalette((colours[:, None] >> np.array([16, 8, 0], dtype=np.uint32)).astype(np.uint8).tobytes())
    else:
        palette = Image.fromarray(np.concatenate(some)).quantize(256, dither=Image.Dither.NONE)
    pictures: list[Image.Image] = []
    for scene in scenes:
        pictures.append(_indexed(_frame(scene), colours, palette))
        on_frame(scene)
    ends = np.round(np.arange(1, len(pictures)) * 100 / fps).astype(int)  # in hundredths of a second
    durations = [*(10 * np.diff(ends, prepend=0)).tolist(), round(1000 * _LAST_SECONDS)]
    buffer = io.BytesIO()
    pictures[0].save(
        buffer, "GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=False, disposal=1
    )
    return buffer.getvalue()


def _codes(picture: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return the colour of each pixel as one number."""
    red, green, blue = np.moveaxis(picture.astype(np.uint32), -1, 0)
    return red << 16 | green << 8 | blue


def _indexed(picture: NDArray[np.uint8], colours: NDArray[np.uint32], palette: Image.Image) -> Image.Image:
    """Return a picture in a palette: by lookup if the palette has all its colours (ten times as fast), else by the nearest."""
    asked = _codes(picture)
    place = np.searchsorted(colours, asked).clip(max=len(colours) - 1)
    if len(colours) > 256 or (colours[place] != asked).any():
        return Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
    found = Image.fromarray(place.astype(np.uint8), "P")
    found.putpalette(palette.getpalette() or [])
    return found


_WRITERS = {".mp4": _mp4, ".gif": _gif}
