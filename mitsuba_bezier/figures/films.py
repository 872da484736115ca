"""Films of the lecture: a figure whose parameter runs, frame by frame, kept and resumed.

A frame is a PNG in a folder beside the film. Its name holds what is in it (figure, arguments, size,
style), so that a film that was broken off goes on, and one that was changed is drawn anew.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._files import write_file
from ..errors import GeometryError, RuntimeSetupError
from ..geometry.projective import count

__all__ = ["FILMS", "Film", "film_frames", "save_film"]

#: What `save_film` writes.
SUFFIXES = (".gif", ".mp4")


class Film(NamedTuple):
    """A film: its figure, the argument that runs, and its values for times from 0 to 1."""

    figure: str
    argument: str
    values: Callable[[np.ndarray], np.ndarray]
    text: str


def _to_and_fro(low: float, high: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda s: low + (high - low) * (1 - np.cos(2 * np.pi * s)) / 2


def _once(low: float, high: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda s: low + (high - low) * s


def _weight(s: np.ndarray) -> np.ndarray:
    """Return weights that run from 1 through 0, -1 and infinity back to 1: once around."""
    return np.tan(np.pi / 4 - np.pi * np.clip(s, 1e-9, 1 - 1e-9))


FILMS: dict[str, Film] = {
    "decasteljau": Film(
        "decasteljau", "t", _to_and_fro(0.0, 1.0), "de Casteljau's scheme as t runs"
    ),
    "weight": Film(
        "conics_by_weight", "weight", _weight, "a weight from 1 through 0, -1 and infinity, to 1"
    ),
    "conic": Film(
        "conic_sections", "tilt", _to_and_fro(0.0, 78.0), "a circle becomes parabola and hyperbola"
    ),
    "horizon": Film(
        "vanishing_point", "pitch", _to_and_fro(-28.0, 24.0), "the camera pitches past the horizon"
    ),
    "quadrics": Film(
        "quadric_family", "turn", _once(0.0, 180.0), "a paraboloid through all oval quadrics"
    ),
    "unrolling": Film(
        "unrolling", "bend", _to_and_fro(1.0, 0.0), "a developable unrolls, and rolls up"
    ),
    "kepler": Film(
        "kepler", "eccentricity", _to_and_fro(0.0, 1.6), "the second focus goes to infinity"
    ),
}


def _checked(name: str) -> Film:
    if name not in FILMS:
        raise GeometryError.expected("name", "one of " + ", ".join(FILMS), repr(name))
    return FILMS[name]


def film_frames(
    name: str,
    folder: str | os.PathLike[str],
    frames: int = 96,
    width: int = 800,
    style: str = "screen",
) -> Iterator[tuple[Path, bool]]:
    """Draw the frames of a film that are not there yet; yield each one's path, and if it was new.

    Parameters
    ----------
    name : str
        One of `FILMS`.
    folder : path
        Where frames are kept.
    frames, width : int
        How many, and pixels across; the width is made even, as films need it.
    style : {"screen", "print"}

    Raises
    ------
    GeometryError
        If there is no such film, or a number is not of this kind.
    """
    from . import draw

    film, n = _checked(name), count(frames, "frames", 2)
    w = count(width, "width", 16) // 2 * 2
    for value in film.values(np.arange(n) / n):
        path = Path(folder) / f"{film.figure}_{w}_{style}_{film.argument}={value:.9g}.png"
        new = not _is_png(path)
        if new:
            data = draw(film.figure, style=style, **{film.argument: float(value)}).encoded(
                ".png", w
            )
            write_file(path, data, "folder", make_folders=True)
        yield path, new


def _is_png(path: Path) -> bool:
    """Return whether a frame is there as a whole; they are written in one step."""
    try:
        with open(path, "rb") as file:
            return file.read(8) == b"\x89PNG\r\n\x1a\n"
    except OSError:
        return False


def save_film(
    name: str,
    path: str | os.PathLike[str],
    frames: int = 96,
    width: int = 800,
    fps: int = 24,
    style: str = "screen",
    folder: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a film as GIF or MP4.

    Parameters
    ----------
    name : str
        One of `FILMS`.
    path : path
        The suffix tells the format: .gif or .mp4.
    frames, width, fps : int
        How many frames, pixels across, frames a second.
    style : {"screen", "print"}
    folder : path, optional
        Where frames are kept; ``NAME_frames`` beside the film if not given.
    progress : callable, optional
        Called with how many frames are there, of how many.

    Raises
    ------
    GeometryError
        If there is no such film or suffix.
    RuntimeSetupError
        Without imageio, or for MP4 without its ffmpeg.
    """
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise GeometryError.expected("path", "a suffix " + ", ".join(SUFFIXES), repr(target.suffix))
    rate = count(fps, "fps", 1)
    _checked(name)
    imageio = _imageio(target.suffix.lower())
    keep = target.with_name(f"{target.stem}_frames") if folder is None else Path(folder)
    paths = []
    for frame, _new in film_frames(name, keep, frames, width, style):
        paths.append(frame)
        if progress:
            progress(len(paths), int(frames))
    write_file(target, _encoded(imageio, paths, target.suffix.lower(), rate), "path")


def _encoded(imageio: Any, paths: list[Path], suffix: str, fps: int) -> bytes:
    from PIL import Image

    pictures = []
    for path in paths:
        with Image.open(path) as image:
            picture = image.convert("RGB")
            box = (0, 0, picture.width // 2 * 2, picture.height // 2 * 2)
            pictures.append(picture.crop(box))
    if suffix == ".gif":
        # one palette for all: few greys and dark colours, and frames that differ where lines move
        palette = pictures[len(pictures) // 2].quantize(48)
        flat = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
        buffer = io.BytesIO()
        flat[0].save(
            buffer, "GIF", save_all=True, append_images=flat[1:], duration=round(1000 / fps),
            loop=0, optimize=True,
        )  # fmt: skip
        return buffer.getvalue()
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "film.mp4"
        with imageio.get_writer(
            out, fps=fps, codec="libx264", quality=7, macro_block_size=2, pixelformat="yuv420p"
        ) as writer:
            for p in pictures:
                writer.append_data(np.array(p))
        return out.read_bytes()


def _imageio(suffix: str) -> Any:
    hint = "pip install 'mitsuba-bezier[figures]'"
    try:
        if suffix == ".mp4":
            import imageio.v2 as module
            import imageio_ffmpeg

            del imageio_ffmpeg
            return module
        import PIL
    except ImportError as error:
        raise RuntimeSetupError.expected(
            "film", "imageio and its ffmpeg, which write it", f"none ({error}): {hint}"
        ) from None
    return PIL
