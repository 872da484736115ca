"""Render films of models: frames in a folder of their own, where a later call goes on.

Workers, where there are any, are those of all frames: each makes the frame that it is asked for by
itself, from the models, and renders parts of it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .._files import check_target, is_utf8, temporary_folder, write_file
from ..errors import BezierError, FileFormatError
from . import _many, _passes
from ._movie_frames import FRAMES, Film

__all__ = ["add_options", "prepare", "render", "wanted"]

#: Suffixes of films.
SUFFIXES = (".gif", ".mp4", ".webp")
#: Frames of a film, at most.
MAX_FRAMES = 100_000


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text[:9]) <= MAX_FRAMES or len(text) > 9:
        raise argparse.ArgumentTypeError(f"expected a number from 1 to {MAX_FRAMES}, got {text!r}")
    return int(text)


def _rate(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.1 <= value <= 240:
        raise argparse.ArgumentTypeError(f"expected frames a second, 0.1 to 240, got {text!r}")
    return value


def add_options(add: Callable[..., Any]) -> None:
    """Add the options."""
    add("--turntable", metavar="N", type=_count, help="a film of N frames of one turn")
    add(
        "--sequence",
        action="store_true",
        default=None,
        help="a film with a frame for each MODEL, such as steps of time",
    )
    add(
        "--animate",
        metavar="weight:P,K,A,B",
        help="a film in which the weight of control point K of patch P runs from A to B",
    )
    add("--frames", metavar="N", type=_count, help=f"frames of --animate ({FRAMES})")
    add("--fps", metavar="F", type=_rate, help="frames a second (24)")


def prepare(args: argparse.Namespace, models: list[Any]) -> None:
    """Do nothing to the models: a film is of what others make of them."""


def wanted(args: argparse.Namespace) -> bool:
    """Return whether a film is to be made.

    Raises
    ------
    BezierError
        If options contradict each other.
    """
    kinds = [k for k in ("turntable", "sequence", "animate") if getattr(args, k) is not None]
    if len(kinds) > 1:
        flags = " and ".join(f"--{kind}" for kind in kinds)
        raise BezierError.expected("film", "one of --turntable, --sequence, --animate", flags)
    for name, needs in (("frames", "animate"), ("fps", "turntable")):
        if getattr(args, name) is not None and (
            not kinds or (name == "frames" and needs not in kinds)
        ):
            raise BezierError.expected(f"--{name}", f"a film, such as --{needs}", "none")
    return bool(kinds)


def library(suffix: str) -> Any:
    """Return imageio, or raise `FileFormatError` with how to install it."""
    try:
        import imageio.v3 as imageio

        if suffix == ".mp4":
            import imageio_ffmpeg  # noqa: F401 (imageio takes it)
    except ImportError as error:
        raise FileFormatError.expected(
            "--output",
            "a film that can be written",
            f"{suffix}, which needs imageio ({error}): pip install 'mitsuba-bezier[movie]'",
        ) from None
    return imageio


def render(args: argparse.Namespace, variant: str, say: Callable[[str], None]) -> int:
    """Render the frames that are not there yet, and write the film; return 0."""
    out = Path(args.output or Path(args.scene).with_suffix(".gif"))
    if out.suffix.lower() not in SUFFIXES or not is_utf8(str(out)):
        raise FileFormatError.expected(
            "--output", f"a name that ends in {', '.join(SUFFIXES)}", out
        )
    check_target(out, "--output")
    imageio = library(out.suffix.lower())
    film = Film(args)
    for note in film.notes:
        say(f"mitsuba-bezier: {note}")
    folder = out.with_name(f"{out.stem}.frames")
    folder.mkdir(exist_ok=True)
    targets = [folder / f"{number:05d}.exr" for number in range(len(film))]
    pictures = [target.with_suffix(".png") for target in targets]
    wanting = [
        number
        for number, target in enumerate(targets)
        if args.fresh or not _is_there(target, film.digest(number), args)
    ]
    many = wanting and (args.workers or args.scheduler)
    with _many.connected(args) if many else nullcontext() as client:
        for number in wanting:
            loaded = film.load(number)
            sensor = loaded.scene.sensors()[0]
            shot = _passes.Shot(args, loaded, sensor, variant, targets[number], number)
            _passes.render(shot, lambda line: say(line) if ": note: " in line else None, client)
            with suppress(OSError):
                shot.sums.unlink()
            say(f"mitsuba-bezier: frame {number + 1} of {len(film)}")
    kept = len(film) - len(wanting)
    write_file(out, encode(imageio, out.suffix.lower(), pictures, args.fps or 24.0), "--output")
    reused = f", {kept} of them from before" if kept else ""
    say(f"mitsuba-bezier: wrote {out}: {len(film)} frames, kept in {folder}{reused}")
    return 0


def _is_there(path: Path, digest: str, args: argparse.Namespace) -> bool:
    """Return whether a frame is finished, and of this film."""
    from ..verification.images import read_image

    if not path.is_file() or not path.with_suffix(".png").is_file():
        return False
    try:
        told = read_image(path).attributes
    except (BezierError, OSError):
        return False
    same = told.get("scene") == digest and told.get("seed") == args.seed
    enough = args.spp is None or int(told.get("spp_asked", told.get("spp", 0))) == args.spp
    return same and enough and told.get("stopped_by") != "not yet"


def encode(imageio: Any, suffix: str, pictures: Sequence[Path], rate: float) -> bytes:
    """Return a film of PNG files."""
    from ..verification import png

    frames = [png.decode(path.read_bytes(), str(path)) for path in pictures]
    height, width = (min(frame.shape[k] for frame in frames) for k in (0, 1))
    frames = [frame[:height, :width] for frame in frames]
    with temporary_folder() as folder:  # writers go by the suffix
        target = Path(folder) / f"film{suffix}"
        if suffix == ".mp4":  # of even size, without alpha
            even = np.stack([f[: height - height % 2, : width - width % 2, :3] for f in frames])
            options: dict[str, Any] = {"fps": rate, "codec": "libx264", "quality": 8}
            imageio.imwrite(target, even, plugin="FFMPEG", macro_block_size=2, **options)
        else:
            from PIL import Image  # imageio's own plugin writes one frame of a WebP

            first, *rest = (Image.fromarray(frame) for frame in frames)
            first.save(
                target,
                save_all=True,
                append_images=rest,
                duration=round(1000.0 / rate),
                loop=0,
                quality=85,
            )
        return target.read_bytes()
