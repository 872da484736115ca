"""``mitsuba-bezier render``: render a scene file, or models, to OpenEXR and PNG."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import _runtime
from .._files import is_utf8
from ..errors import BezierError, RuntimeSetupError
from . import _model
from ._flags import duration, flip_level, noise_level, seconds
from ._limits import add_limits
from ._streams import printable

__all__ = ["add_parser", "run", "set_variant", "stops"]

DEFAULT_VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")


# above, the list of passes of a large film would fill the memory
MAX_SPP = 10_000_000
# the header of an EXR file has signed 32-bit integers
MAX_INT = (1 << 31) - 1
# of all processors that there are; each has a stack
MAX_THREADS = 1024
MAX_WORKERS = 1024
# the range of float32, half of it
MAX_STOPS = 64


def integer(lowest: int, highest: int = MAX_INT) -> Callable[[str], int]:
    """Return the type of a flag whose whole number is in a range."""

    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = lowest - 1
        if not lowest <= value <= highest:
            raise argparse.ArgumentTypeError(
                f"expected an integer from {lowest} to {highest}, got {text!r}"
            )
        return value

    return convert


def _define(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals or not is_utf8(text):
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE, got {text!r}")
    return key, value


def add_define(add: Callable[..., Any]) -> None:
    """Add the option that gives a scene its values."""
    add(
        "-D",
        "--define",
        metavar="KEY=VALUE",
        type=_define,
        action="append",
        default=[],
        help="value of a $KEY in the scene; may be given several times",
    )


def _folders(text: str) -> list[str]:
    if not is_utf8(text):  # Mitsuba takes no others
        raise argparse.ArgumentTypeError(f"expected names in UTF-8, got {text!r}")
    return [folder for folder in text.split(";") if folder]


def stops(text: str) -> float:
    """Return a number of stops, for a flag."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_STOPS:
        raise argparse.ArgumentTypeError(
            f"expected a number from {-MAX_STOPS} to {MAX_STOPS}, got {text!r}"
        )
    return value


def _part(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise argparse.ArgumentTypeError(f"expected I/N with 1 <= I <= N, got {text!r}")
    return int(number) - 1, int(count)


def _address(text: str) -> str:
    if not text.strip():  # of a variable of the shell that is not set
        raise argparse.ArgumentTypeError(f"expected the address of a dask scheduler, got {text!r}")
    return text


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "render",
        help="render a scene file or models to OpenEXR and PNG",
        description="Render a Mitsuba scene (.xml), Bézier shapes and all others, or a model "
        "(CAD, finite elements, ...) for which a scene is made, to an OpenEXR "
        "file with a PNG preview beside it. Mitsuba's integrators 'path', 'volpath' and 'aov' are "
        "replaced by 'bezierpath', 'beziervolpath' and 'bezieraov', which have the same "
        "parameters and see Bézier shapes.",
    )
    add = parser.add_argument
    add("scene", metavar="SCENE", help="the scene file, or a model")
    add("more", metavar="MODEL", nargs="*", help="more models, for the same picture")
    add("-o", "--output", metavar="OUT.exr", help="default: beside the scene, as SCENE.exr")
    add("-m", "--mode", metavar="VARIANT", help=f"variant of Mitsuba ({DEFAULT_VARIANTS[0]})")
    add_define(add)
    add("-s", "--sensor", metavar="N", type=integer(0), default=0, help="number of the sensor (0)")
    add(
        "-a",
        "--append",
        metavar="PATHS",
        type=_folders,
        default=[],
        help="search paths for files, ';' between",
    )
    add(
        "-t",
        "--threads",
        metavar="N",
        type=integer(1, MAX_THREADS),
        help="number of CPU threads",
    )
    add("--spp", metavar="N", type=integer(1, MAX_SPP), help="samples per pixel (the scene's)")
    add("--seed", metavar="K", type=integer(0), default=0, help="seed of the render (0)")
    add(
        "--spp-per-pass",
        metavar="N",
        type=integer(1, MAX_SPP),
        help="size of a pass (by film size)",
    )
    add(
        "--part",
        metavar="I/N",
        type=_part,
        help="render only every N-th pass, from the I-th on, with what 'merge' needs to give "
        "the whole render to the bit",
    )
    going_on = parser.add_mutually_exclusive_group()
    going_on.add_argument(
        "--resume",
        action="store_true",
        help="go on from OUT.sums.exr, also from a finished render to more --spp, and keep that "
        "file; without this flag, too, the same command goes on where it was interrupted",
    )
    going_on.add_argument(
        "--fresh", action="store_true", help="begin anew, whatever lies beside OUT.exr"
    )
    add(
        "--save-every",
        metavar="SECONDS",
        type=seconds,
        help="write what is there so often, 0 after every pass (default: 2, and rarer where that "
        "would take more than a hundredth of the time)",
    )
    add(
        "--until-noise",
        metavar="X",
        type=noise_level,
        help="stop when the mean relative standard error of the pixels is X, such as 0.02 or 2%%; "
        "--spp is the upper limit, if given",
    )
    add(
        "--until-flip",
        metavar="X[@P]",
        type=flip_level,
        help="stop when FLIP, the difference that is seen, between picture and perfect picture is "
        "expected to be no more than X in 95%% of the pixels, or P; needs the extra 'compare'",
    )
    add(
        "--time",
        metavar="T",
        type=duration,
        help="stop after a time such as 90s, 10m or 1h30m; --spp is the upper limit, if given",
    )
    add(
        "--denoise",
        action="store_true",
        help="also write OUT.denoised.exr, a guess of the picture without noise, which the preview "
        "then shows; renders with the filter 'box', which that needs",
    )
    many = parser.add_mutually_exclusive_group()
    many.add_argument(
        "--workers",
        metavar="N",
        type=integer(1, MAX_WORKERS),
        help="render by so many processes of this machine, which share its threads",
    )
    many.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        type=_address,
        help="render by the workers of a dask scheduler, such as tcp://host:8786",
    )
    add("--json", metavar="FILE", help="write what was reached; '-' for standard output")
    add("--open", action="store_true", help="show the picture when it is done")
    add("--exposure", metavar="EV", type=stops, default=0.0, help="stops, for the preview (0)")
    add(
        "--allow-plugins",
        action="store_true",
        help="load plugins/NAME.so beside the scene: it may do whatever you may",
    )
    level = parser.add_mutually_exclusive_group()
    level.add_argument("-v", "--verbose", action="count", default=0, help="show Mitsuba's log")
    level.add_argument("-q", "--quiet", action="store_true", help="show errors only")
    _model.add_options(parser)
    add_limits(parser)


def run(args: argparse.Namespace) -> int:
    """Render and write the files; return 0."""
    scene_file = Path(args.scene)
    from . import _images, _inputs, _movie, _passes, _scene

    for name in (args.scene, *args.more):
        _scene.check_name(name)
    model = _model.is_model(args.scene)
    if not model:
        _model.refuse_for_scenes(args)

    def say(line: str) -> None:
        if not args.quiet:
            print(line, file=sys.stderr)

    if model and _model.writes_only(args):
        for note in _model.load(args).notes:
            say(f"mitsuba-bezier: {printable(note)}")
        return 0
    film = model and _movie.wanted(args)
    beside = scene_file.with_suffix(".exr") if args.output is None else args.output
    output = None if film else _images.check_output(beside)

    variant = set_variant(args.mode)
    import drjit as dr
    import mitsuba as mi

    mi.set_log_level(_log_level(mi, args))
    if args.threads:
        try:
            dr.set_thread_count(args.threads)
        except RuntimeError as error:
            expected = "a number of threads that this system starts"
            raise BezierError.expected("--threads", expected, f"{args.threads} ({error})") from None

    if output is None:
        return _movie.render(args, variant, lambda line: say(printable(line)))
    loaded = _inputs.load(args, variant)
    for note in loaded.notes:
        say(f"mitsuba-bezier: {printable(note)}")
    sensor = _inputs.chosen_sensor(loaded.scene, args.sensor)
    _passes.render(_passes.Shot(args, loaded, sensor, variant, output), say)
    if args.open and not show(output.with_suffix(".png")):
        say("mitsuba-bezier: no viewer of pictures was found (--open)")
    return 0


def show(path: Path) -> bool:
    """Open a picture with the system's viewer; return whether one was found."""
    import webbrowser

    try:
        return path.is_file() and webbrowser.open(path.resolve().as_uri())
    except (webbrowser.Error, OSError, ValueError):
        return False


def set_variant(wanted: str | None) -> str:
    """Set the variant asked for, or the first default that starts, and return it."""
    mi = _runtime.import_mitsuba()
    if wanted is None:
        try:
            wanted = DEFAULT_VARIANTS[0]
            _runtime.check(wanted)
        except RuntimeSetupError:
            usable = _runtime.usable_variants()
            wanted = next((name for name in DEFAULT_VARIANTS if name in usable), None)
            if wanted is None:
                raise
    _runtime.check(wanted)
    mi.set_variant(wanted)
    return wanted


def _log_level(mi: Any, args: argparse.Namespace) -> Any:
    if args.quiet:
        return mi.LogLevel.Error
    levels = [mi.LogLevel.Warn, mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace]
    return levels[min(args.verbose, 3)]
