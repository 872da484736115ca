"""Render a model without a scene: the options of ``render MODEL``, and what they make."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from .._files import check_target, refuse_inputs, write_files
from .._runtime import import_mitsuba
from ..errors import BezierError, FileFormatError

__all__ = [
    "HOOKS",
    "Extra",
    "Prepared",
    "add_options",
    "digest_of",
    "is_model",
    "load",
    "loaded",
    "prepared",
    "refuse_for_scenes",
    "surroundings",
    "writes_only",
]

#: Modules of this package with more to do with models. Each has ``add_options(add)``, which adds
#: options by ``add("--name", ...)``, and ``prepare(args, models)``, which returns an `Extra`, or
#: None if none of its options is given.
HOOKS: tuple[str, ...] = ("_movie", "_fields")

#: Options of models only, by the names that argparse gives them; see `refuse_for_scenes`.
_own: set[str] = set()


class Extra:
    """What a module of `HOOKS` does for one render.

    Attributes
    ----------
    models : list of Model
        In place of those that were read.
    appearance : callable or None
        See `mitsuba_bezier.models.scene.Appearance`.
    finish : callable or None
        Takes the pixels of the picture ``(H, W, 3 or 4)``, uint8, and returns others.
    notes : list of str
        What the user is told, one line each.
    """

    def __init__(
        self,
        models: list[Any],
        appearance: Callable[..., Any] | None = None,
        finish: Callable[[np.ndarray], np.ndarray] | None = None,
        notes: list[str] | None = None,
    ) -> None:
        self.models, self.appearance, self.finish = models, appearance, finish
        self.notes = notes or []


def _hooks() -> list[ModuleType]:
    return [import_module(f".{name}", __package__) for name in HOOKS]


def _size(text: str) -> tuple[int, int]:
    width, x, height = text.lower().partition("x")
    if not (x and width.strip().isdecimal() and height.strip().isdecimal()):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT in pixels, got {text!r}")
    return int(width), int(height)


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"expected PART=MATERIAL, got {text!r}")
    return name, value


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that only models have."""
    group = parser.add_argument_group(
        "models", "for MODEL in place of SCENE: any file that 'mitsuba-bezier convert' reads"
    )

    def add(*names: str, **settings: Any) -> None:
        if settings.get("action") == "append":
            settings.setdefault("default", [])
        _own.add(group.add_argument(*names, **settings).dest)

    add("--view", metavar="V", help="iso, front, back, left, right, top, bottom or AZ,EL (iso)")
    add("--up", metavar="AXIS", help="the axis that is up: x, y, z, -x, -y, -z (z)")
    add("--fov", metavar="DEG", type=float, help="angle of view along the smaller side (24)")
    add("--ortho", action="store_true", default=None, help="a parallel projection")
    add("--light", metavar="L", help="studio, sky, lamp, or a picture of surroundings (studio)")
    add(
        "--ground",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="a ground that catches shadows (where it is seen from above)",
    )
    add(
        "--background",
        metavar="B",
        help="white, transparent, #rrggbb, or light: what shines is seen (white in the studio)",
    )
    add("--size", metavar="WxH", type=_size, help="pixels (1024x768)")
    add("--only", metavar="PART", action="append", help="show this part, layer, or pattern only")
    add("--hide", metavar="PART", action="append", help="do not show it")
    add(
        "--material",
        metavar="PART=M",
        type=_assignment,
        action="append",
        help="gold, steel, glass, plastic:#rrggbb, matte:#rrggbb, ..., or a <bsdf> of XML; "
        "'*=M' for all parts",
    )
    add("--explode", metavar="F", type=float, help="move parts away from the middle")
    add(
        "--section",
        metavar="PLANE",
        help="cut by a plane: z=10, x<50%% (what is kept), 1,0,1=4",
    )
    add("--cap", metavar="C", help="what closes bodies that are cut: hatched, flat or none")
    add(
        "--scene",
        metavar="OUT.xml",
        dest="scene_out",
        help="write the scene, with its models beside it, and do not render unless -o is given",
    )
    for hook in _hooks():
        hook.add_options(add)


def is_model(path: str) -> bool:
    """Return whether a file is a model by its suffix, and no scene."""
    from ..io import known_suffixes

    return Path(path).suffix.lower() in known_suffixes()[0]


def refuse_for_scenes(args: argparse.Namespace) -> None:
    """Refuse options of models, and more than one file, where there is a scene.

    Raises
    ------
    BezierError
        If there are some.
    """
    if args.more:
        raise FileFormatError.expected(
            "SCENE", "one scene, or several models", f"{args.scene} and {args.more[0]}"
        )
    for name in sorted(_own):
        if getattr(args, name, None) not in (None, []):
            flag = {"scene_out": "--scene"}.get(name, "--" + name.replace("_", "-"))
            from ..io import known_suffixes

            suffixes = ", ".join(known_suffixes()[0])
            raise BezierError.expected(flag, f"a model ({suffixes})", f"the scene {args.scene}")


#: Options that `Look` has under the same name.
_LOOK: tuple[str, ...] = ("view", "up", "fov", "ortho", "light", "ground", "background")
_LOOK += ("size", "spp", "explode", "section", "cap")


def _look(args: argparse.Namespace) -> Any:
    from ..models.scene import Look
    from ..models.selection import Selection

    chosen: dict[str, Any] = {
        name: getattr(args, name) for name in _LOOK if getattr(args, name) is not None
    }
    chosen["selection"] = Selection(tuple(args.only), tuple(args.hide))
    return Look(**chosen, materials=dict(args.material))


def _models(args: argparse.Namespace) -> tuple[list[Any], list[str]]:
    from ..io import read

    models, notes = [], []
    for path in (args.scene, *args.more):
        # fields may be many: they are read where one is asked for
        model = read(path, trims=True, fields=bool(args.color_by or args.warp))
        report = model.report
        notes += [f"note: {line}" for line in report.notes]
        if report.refused:
            notes.append(report.summary())
        models.append(model)
    return models, notes


def surroundings(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the picture that ``--light`` names, if it names one."""
    from ..models import lights

    light = args.light if is_model(args.scene) else None
    if light is None or light in lights.LIGHTS or not os.path.isfile(light):
        return ()
    return (light,)


def writes_only(args: argparse.Namespace) -> bool:
    """Return whether a scene is to be written, and nothing rendered."""
    return args.scene_out is not None and args.output is None


@dataclass
class Prepared:
    """What the options of a model ask for, before a scene is made."""

    look: Any
    models: list[Any]
    appearance: Callable[..., Any] | None
    finishers: list[Callable[[np.ndarray], np.ndarray]]
    notes: list[str]
    files: tuple[Path, ...]


def prepared(args: argparse.Namespace) -> Prepared:
    """Read the models and what is to be made of them."""
    if args.define:
        raise BezierError.expected("--define", "a scene, which has parameters", args.scene)
    look = _look(args)
    models, notes = _models(args)
    appearance, finishers = None, []
    for hook in _hooks():
        extra = hook.prepare(args, models)
        if extra is not None:
            models, appearance = extra.models, extra.appearance or appearance
            notes += extra.notes
            finishers += [extra.finish] if extra.finish else []
    files = tuple(Path(path) for path in (args.scene, *args.more, *surroundings(args)))
    return Prepared(look, models, appearance, finishers, notes, files)


def digest_of(
    args: argparse.Namespace, found: Prepared, more: Mapping[str, str] | None = None
) -> str:
    """Return the fingerprint of a picture of models: of their files and the options."""
    from ..verification.fingerprint import files_fingerprint

    if not _own:  # a worker has read no command line
        add_options(argparse.ArgumentParser())
    hidden = {"scene_out", "fps", "open"}
    if surroundings(args):  # whose contents count, as those of all files do
        hidden.add("light")
    shown = {name: getattr(args, name, None) for name in sorted(_own - hidden)}
    given = {name: repr(value) for name, value in shown.items() if value not in (None, [])}
    return files_fingerprint(found.files, {**given, **(more or {})})


def loaded(args: argparse.Namespace, found: Prepared, node: dict[str, Any], digest: str) -> Any:
    """Return the scene of a description, as `_scene.load` does."""
    from ..models import description
    from . import _scene

    mi = import_mitsuba()
    if args.denoise:  # which needs it
        node["camera"]["film"]["rfilter"] = {"type": "box"}
    scene = mi.load_dict(description.to_dictionary(mi, node))

    def preview(bitmap: Any, exposure: float) -> bytes | None:
        return _preview(bitmap, exposure, found.look.behind, found.finishers)

    notes = tuple(found.notes)
    return _scene.Loaded(
        scene, scene.integrator(), "bezierpath", notes, found.files, digest, preview
    )


def load(args: argparse.Namespace) -> Any:
    """Return the scene around the models of the command line, as `_scene.load` does.

    Where `writes_only`, it is written, and there is none in what is returned.
    """
    from ..models.scene import describe
    from . import _scene

    found = prepared(args)
    node = describe(found.models, found.look, found.appearance, found.notes)
    if args.denoise:  # which needs it
        node["camera"]["film"]["rfilter"] = {"type": "box"}
    if args.scene_out is not None:
        found.notes.append(f"wrote {_write_scene(node, args.scene_out, found.files)}")
    if writes_only(args):
        return _scene.Loaded(None, None, "", tuple(found.notes), found.files)
    return loaded(args, found, node, digest_of(args, found))


def _write_scene(node: dict[str, Any], out: str, inputs: tuple[Path, ...]) -> str:
    """Write a description as an XML file with its models beside it; return what was written.

    Raises
    ------
    FileFormatError
        If a file cannot be written.
    """
    from ..models.description import to_files

    path = Path(out)
    if path.suffix.lower() != ".xml":
        raise FileFormatError.expected("--scene", "a name that ends in .xml", repr(out))
    check_target(path, "--scene")
    files: dict[Any, bytes] = dict(to_files(node, path))
    for file in files:
        check_target(file, "--scene")
        refuse_inputs(file, inputs, "--scene")
    write_files(files)
    return f"{os.fspath(path)} and {len(files) - 1} files beside it"


def _preview(
    bitmap: Any,
    exposure: float,
    behind: str,
    finishers: list[Callable[[np.ndarray], np.ndarray]],
) -> bytes | None:
    """Return the PNG of a picture with alpha, before what is behind the model."""
    from ..models.materials import linear
    from ..verification import png

    mi = import_mitsuba()
    kinds = mi.Bitmap.PixelFormat
    colour = bitmap.convert(kinds.RGBA, mi.Struct.Type.Float32, srgb_gamma=False)
    pixels = np.nan_to_num(np.array(colour))
    rgb, alpha = pixels[..., :3] * np.float32(2.0**exposure), pixels[..., 3:].clip(0.0, 1.0)
    if behind == "transparent":
        rgb = np.where(alpha > 1e-6, rgb / np.maximum(alpha, 1e-6), 0.0)  # as PNG has it
    elif behind != "light":
        ground = np.array((1.0, 1.0, 1.0) if behind == "white" else linear(behind))
        rgb = rgb + (1.0 - alpha) * ground
    shown = mi.Bitmap(np.ascontiguousarray(rgb, dtype=np.float32))
    out = np.array(shown.convert(kinds.RGB, mi.Struct.Type.UInt8, srgb_gamma=True))
    if behind == "transparent":
        out = np.concatenate([out, np.rint(255 * alpha).astype(np.uint8)], axis=-1)
    for finish in finishers:
        out = finish(out)
    return png.encode(out)
