"""Load a Mitsuba scene file for rendering, with an integrator that sees Bézier shapes.

The parsed scene is edited before anything is built: only there the name of a plugin can be
exchanged while all its parameters, from whatever included file or default they come, stay.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import _loading
from .._files import is_utf8
from .._runtime import import_mitsuba
from .._threads import thread_for_files
from ..errors import FileFormatError
from ..verification.fingerprint import files_fingerprint, scene_files
from . import _plugins
from ._scene_xml import check_xml

__all__ = ["REPLACED", "SEES_BEZIER", "Loaded", "check_name", "load"]

SHAPES = ("beziertriangle", "asphere")

#: Mitsuba's integrators that have an equal among ours, with the same parameters and defaults.
REPLACED = {"path": "bezierpath", "volpath": "beziervolpath", "aov": "bezieraov"}

#: Integrators that render the exact surfaces: ours, and those of Mitsuba's that find ours, or the
#: scene's exact queries, when they render.
SEES_BEZIER = (
    "bezierpath",
    "beziervolpath",
    "bezieraov",
    "bezierdepth",
    "bezierdirect",
    "beziermoment",
    "bezierptracer",
    "bezierstokes",
    "bezier_direct_projective",
    "bezier_prb_projective",
    "depth",
    "direct",
    "direct_projective",
    "moment",
    "prb",
    "prb_basic",
    "prb_projective",
    "prbvolpath",
    "ptracer",
    "stokes",
    "volpathmis",
)

#: Integrators whose nested integrators see what these see.
HAS_NESTED = ("bezieraov",)


@dataclass(frozen=True)
class Loaded:
    """A scene, its integrator, and what the user should be told about the choice.

    Also the files that it was read from, its fingerprint, and what makes its preview, if that is
    not `_images.encode_preview`.
    """

    scene: Any
    integrator: Any
    integrator_name: str
    notes: tuple[str, ...]
    files: tuple[Path, ...] = ()
    digest: str = ""
    preview: Callable[[Any, float], bytes | None] | None = None


def load(
    path: str | Path,
    variant: str,
    defines: Mapping[str, str] | None = None,
    search_paths: Sequence[str | Path] = (),
    allow_plugins: bool = False,
    box_filter: bool = False,
) -> Loaded:
    """Load a scene file under the variant that is set.

    Parameters
    ----------
    path : path
        The XML file.
    variant : str
        The name of the variant that is set.
    defines : mapping, optional
        Values of the ``$parameters`` of the scene.
    search_paths : sequence of paths, optional
        More folders in which files named by the scene are looked for.
    allow_plugins : bool
        Whether libraries beside the scene may be loaded as plugins.
    box_filter : bool
        Whether films get the filter `box` in place of their own.

    Raises
    ------
    FileFormatError
        If the file is missing, Mitsuba cannot load it, it is no scene, its integrator cannot
        see the Bézier shapes that it has, or a plugin lies beside it.
    """
    mi = import_mitsuba()
    path = Path(path)
    check_name(path)
    check_xml(path, [path.resolve().parent, *map(Path, search_paths), Path()])
    config = _loading.parser_config(mi, variant)
    with _loading.relative_to(mi, path, search_paths):
        _plugins.load_own(mi)
        state = _guarded(path, mi.parser.parse_file, config, str(path), **(defines or {}))
        files = scene_files(mi, state)
        if not allow_plugins:
            _plugins.check(mi, (node.props.plugin_name() for node in state.nodes), path)
        _guarded(path, mi.parser.transform_all, config, state)
        name, notes = _choose_integrator(mi, state)
        if box_filter:
            _choose_box_filter(mi, state, notes)
        with thread_for_files():
            built = _guarded(path, mi.parser.instantiate, config, state)
        scene = built[0] if isinstance(built, list) and len(built) == 1 else built
        if not isinstance(scene, mi.Scene):
            raise FileFormatError.expected("SCENE", "a file whose root is <scene>", f"{path}")
        integrator = scene.integrator() or mi.load_dict({"type": name})
    return Loaded(scene, integrator, name, tuple(notes), files, files_fingerprint(files, defines))


def check_name(path: str | Path) -> None:
    """Make sure that a scene file is there.

    Raises
    ------
    FileFormatError
        If it is not, or its name is one that Mitsuba cannot take.
    """
    if not str(path) or not Path(path).is_file():
        got = str(path) if str(path) not in ("", ".") else repr(str(path))
        raise FileFormatError.expected("SCENE", "an existing scene file (.xml)", got)
    for name in (str(path), os.path.dirname(os.path.realpath(path))):
        if not is_utf8(name):
            raise FileFormatError.expected("SCENE", "a name in UTF-8", repr(name))


def _guarded(path: Path, step: Any, *args: Any, **kwargs: Any) -> Any:
    """Run a step of Mitsuba's loader; what it throws becomes one line of ours."""
    try:
        return step(*args, **kwargs)
    except Exception as error:
        raise FileFormatError.expected(
            "SCENE", "a scene that Mitsuba can load", f"{path}: {_one_line(str(error))}"
        ) from error


def _one_line(message: str) -> str:
    """Reduce a message of the loader to one line without source positions and tracebacks."""
    message = re.sub(r"\x1b\[[0-9;]*m", "", message)
    message = re.sub(r"^\[\w+\.\w+:\d+\] ", "", message)
    # an error raised by a Python plugin comes as a traceback; its last line is the message
    message = re.sub(
        r"Traceback \(most recent call last\):\n(?:[ \t].*\n)*(?:[\w.]+: )?", "", message
    )
    # what our plugins say needs no such introduction
    message = re.sub(
        r'failed to instantiate \w+ plugin of type "(bezier\w*)": (\1: )?', r"\1: ", message
    )
    return " ".join(message.split())


def _children(state: Any, node: Any) -> Iterator[Any]:
    """Yield the nodes that are a node's own children (`merge` wraps some of a scene's)."""
    for key in node.props.keys():  # noqa: SIM118 (Properties is no dict)
        value = node.props[key]
        if hasattr(value, "index") and not isinstance(value, str):  # a reference to a node
            child = state.nodes[value.index()]
            yield child
            if child.props.plugin_name() == "merge":
                yield from _children(state, child)


def _choose_integrator(mi: Any, state: Any) -> tuple[str, list[str]]:
    """Exchange the scene's integrator where we have an equal; return its name and notes."""
    integrators = [
        node for node in _children(state, state.root) if node.type == mi.ObjectType.Integrator
    ]
    if not integrators:
        return SEES_BEZIER[0], [f"the scene names no integrator: rendering with {SEES_BEZIER[0]}"]
    notes: list[str] = []
    has_bezier = any(node.props.plugin_name() in SHAPES for node in state.nodes)
    return _exchange(mi, state, integrators[0], has_bezier, notes), notes


def _choose_box_filter(mi: Any, state: Any, notes: list[str]) -> None:
    """Give all films the filter `box`."""
    for film in state.nodes:
        if film.type != mi.ObjectType.Film:
            continue
        filters = [
            n for n in _children(state, film) if n.type == mi.ObjectType.ReconstructionFilter
        ]
        for node in filters:
            if node.props.plugin_name() != "box":
                notes.append(f"--denoise: the filter box in place of {node.props.plugin_name()}")
                identifier = node.props.id()
                node.props = mi.Properties("box")
                node.props.set_id(identifier)
        if not filters:
            notes.append("--denoise: the filter box in place of the film's own")
            film.props["box_filter_of_denoise"] = mi.load_dict({"type": "box"})


def _exchange(mi: Any, state: Any, node: Any, has_bezier: bool, notes: list[str]) -> str:
    """Exchange an integrator and those nested in it; return its name."""
    name = node.props.plugin_name()
    if name in REPLACED:
        own = REPLACED[name]
        node.props.set_plugin_name(own)
        notes.append(f"the integrator '{name}' cannot see Bézier shapes: rendering with {own}")
        name = own
    elif has_bezier and name not in SEES_BEZIER:
        names = [*SEES_BEZIER, *(f"{old} (rendered with {new})" for old, new in REPLACED.items())]
        raise FileFormatError.expected(
            "integrator",
            f"{' or '.join(names)}, which see the scene's Bézier shapes",
            f"{name} at {mi.parser.file_location(state, node)}",
        )
    if name in HAS_NESTED:
        for child in _children(state, node):
            if child.type == mi.ObjectType.Integrator:
                _exchange(mi, state, child, has_bezier, notes)
    return name
