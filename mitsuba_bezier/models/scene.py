"""Make the scene around models, `mb.scene`: a dictionary for `mi.load_dict`."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import BezierError
from ..geometry.triangles import BezierTriangles
from ..io import Model, Part, Report, read
from . import bounds, lights
from . import section as cuts
from .camera import View, fitted, read_up, read_view, view_frame
from .description import to_dictionary
from .fields import Coloring, FieldLook, coloring, warped_models
from .materials import PALETTE, material, painted
from .selection import Selection, exploded, renamed, selected

__all__ = ["Appearance", "Framing", "Look", "describe", "framing_of", "models_of", "scene"]

#: Called with a part, the number of one of its groups, and the numbers of patches of that group:
#: returns parameters for their shape (``bsdf``, ``vertex_...``, ``face_...``), or None for what the
#: part looks like without.
Appearance = Callable[[Part, int, np.ndarray], "Mapping[str, Any] | None"]

#: Options of `scene` for fields.
FIELD_OPTIONS = tuple(FieldLook.__dataclass_fields__)

#: What closes bodies that are cut.
CAPS = ("hatched", "flat", "none")


@dataclass(frozen=True)
class Look:
    """How a model is shown; see `scene` for the fields."""

    view: Any = "iso"
    up: str = "z"
    fov: float | None = 24.0
    ortho: bool = False
    light: str = "studio"
    ground: bool | None = None
    background: str | None = None
    size: tuple[int, int] = (1024, 768)
    spp: int = 128
    max_depth: int = 8
    selection: Selection = field(default_factory=Selection)
    materials: Mapping[str, str] = field(default_factory=dict)
    explode: float = 0.0
    section: str | None = None
    cap: str = "hatched"

    def __post_init__(self) -> None:
        read_view(self.view)
        read_up(self.up)
        width, height = self.size
        if not (1 <= width <= 65536 and 1 <= height <= 65536):
            raise BezierError.expected("size", "from 1 to 65536 pixels a side", f"{self.size}")
        if self.fov is not None and not 0.1 <= self.fov <= 150:
            raise BezierError.expected("fov", "an angle from 0.1 to 150 degrees", self.fov)
        if not 0 <= self.explode <= 1e3:
            raise BezierError.expected("explode", "a number from 0 to 1000", self.explode)
        if self.cap not in CAPS:
            raise BezierError.expected("cap", f"one of {', '.join(CAPS)}", repr(self.cap))
        if self.section is not None:
            cuts.read_section(self.section)
        if not self.spp >= 1:
            raise BezierError.expected("spp", "at least one sample a pixel", self.spp)
        if self.background is not None and self.background not in (
            "white",
            "transparent",
            "light",
        ):
            from .materials import linear

            linear(self.background)

    @property
    def behind(self) -> str:
        """What is behind the model: ``white``, ``transparent``, ``light`` or ``#rrggbb``."""
        if self.background is not None:
            return self.background
        return "white" if self.light == "studio" else "light"

    @property
    def has_ground(self) -> bool:
        """Whether there is a ground: by default where it is seen from above and not in the way."""
        if self.ground is not None:
            return self.ground
        return read_view(self.view)[1] > -1e-9 and self.behind != "transparent"


@dataclass(frozen=True)
class Framing:
    """What a camera sees, in all pictures of several: points, and the height of the ground."""

    points: np.ndarray
    level: float


def framing_of(models: Sequence[Model], look: Look) -> Framing:
    """Return the framing of models, as `describe` has it.

    Raises
    ------
    BezierError
        If one is of no finite size, has no surface, or no part of it is shown.
    """
    points, level = [], np.inf
    up = read_up(look.up)[2]
    for model in models:
        parts = selected(renamed(model.parts), look.selection)
        bounds.check_finite(parts, model.report.path or "model")
        if look.explode:
            parts = exploded(parts, look.explode)
        points.append(bounds.surface_points(parts))
        level = min(level, bounds.lowest(parts, up))
    return Framing(np.concatenate(points), level)


def models_of(model: Any) -> list[Model]:
    """Return models of what users call one: a model, nets, a file, or several of these.

    Raises
    ------
    BezierError
        If it is nothing of that kind.
    """
    if isinstance(model, Model):
        return [model]
    if isinstance(model, BezierTriangles):
        return [Model([model], [np.arange(len(model))], Report("net", "net"))]
    if isinstance(model, (str, os.PathLike)):
        return [read(model, trims=True)]
    if isinstance(model, (list, tuple)) and model:
        return [one for item in model for one in models_of(item)]
    raise BezierError.expected(
        "model",
        "a Model, BezierTriangles, the name of a file, or a list of these",
        repr(model)[:80],
    )


def scene(model: Any, *, appearance: Appearance | None = None, **look: Any) -> dict[str, Any]:
    """Return a scene around a model: camera, light, ground, materials.

    Parameters
    ----------
    model : Model, BezierTriangles, path, or list of these
        What is shown; a path is read by its suffix, see `load`.
    view : str or (float, float)
        ``iso``, ``front``, ``back``, ``left``, ``right``, ``top``, ``bottom``, or azimuth and
        elevation in degrees, from the front round to the right and upwards.
    up : str
        The axis that is up: ``z``, ``y``, ``x``, or one of them with ``-``.
    fov : float
        Angle of view along the smaller side, in degrees.
    ortho : bool
        A parallel projection instead.
    light : str
        ``studio``, ``sky``, ``lamp``, or a picture of surroundings (``.exr``, ``.hdr``).
    ground : bool
        Whether the model stands on a ground, by default where it is seen from above.
    background : str
        ``white``, ``transparent``, ``#rrggbb``, or ``light`` for what shines.
    size : (int, int)
        Width and height in pixels.
    spp, max_depth : int
        Samples per pixel, and longest light paths.
    selection : Selection
        Which parts are shown.
    materials : mapping of str to str
        Materials by names of parts; see `material`.
    color_by, component, colormap, range, levels, isolines, edges, warp, factor
        How fields are shown, see `FieldLook`.
    explode : float
        How far parts are moved away from the middle, relative to their distance from it.
    section : str
        A plane that cuts the model: ``z=10``, ``x<50%`` (what is kept), ``1,0,1=4``.
    cap : str
        What closes bodies that are cut: ``hatched``, ``flat``, or ``none``.
    appearance : callable, optional
        Called as ``appearance(part, group, patches)`` for each shape; what it returns are
        parameters of the shape, such as ``bsdf`` and ``vertex_...``, in place of the part's.

    Returns
    -------
    dict
        For `mi.load_dict`.

    Raises
    ------
    BezierError
        If an option is none, the model reaches infinity, has no size, or no surface.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> scene = mb.scene(mb.sphere(), view="front", size=(32, 24), spp=1)
    >>> mi.render(mi.load_dict(scene)).shape
    (24, 32, 4)
    """
    import mitsuba as mi

    of_fields = {name: look.pop(name) for name in list(look) if name in FIELD_OPTIONS}
    if unknown := [name for name in look if name not in Look.__dataclass_fields__]:
        names = ", ".join([*Look.__dataclass_fields__, *FIELD_OPTIONS])
        raise BezierError.expected("scene", f"options {names} and appearance", unknown[0])
    models = models_of(model)
    if of_fields:
        shown = FieldLook(**of_fields)
        if shown.warp is not None:
            models = warped_models(models, shown.warp, shown.factor)
        if shown.color_by is not None and appearance is None:
            appearance = coloring(models, shown)
    return to_dictionary(mi, describe(models, Look(**look), appearance))


def describe(
    models: Sequence[Model],
    look: Look,
    appearance: Appearance | None = None,
    notes: list[str] | None = None,
    framing: Framing | None = None,
) -> dict[str, Any]:
    """Return the description of a scene, see `description`; `notes` gets what is to be told.

    With a `framing` camera, light and ground are those of another model, or of several.

    Raises
    ------
    BezierError
        As `scene`.
    """
    every = renamed([part for model in models for part in model.parts])
    name = models[0].report.path or "model"
    parts = selected(every, look.selection)
    if framing is None:
        bounds.check_finite(parts, name)
    if look.explode:
        parts = exploded(parts, look.explode)
    axes = read_up(look.up)
    frame = view_frame(*read_view(look.view), axes)
    own = bounds.surface_points(parts)
    points = own if framing is None else framing.points
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if not size > 0:
        raise BezierError.expected(name, "a model of some size", "a single point")
    width, height = look.size
    view = fitted(points, frame, None if look.ortho else look.fov, width / height)
    out: dict[str, Any] = {"type": "scene"}
    out["integrator"] = {
        "type": "bezierpath",
        "max_depth": look.max_depth,
        "hide_emitters": look.behind != "light",
    }
    out["camera"] = _sensor(view, look)
    if isinstance(appearance, Coloring):
        appearance.see(out["camera"])
    out |= _light(look, axes, frame.back, points)
    if look.has_ground:
        level = bounds.lowest(parts, axes[2]) if framing is None else framing.level
        out["ground"] = _ground(level, points, axes, size)
    if look.section is None:
        return out | _shapes(every, parts, look, appearance)
    plane = cuts.resolved(cuts.read_section(look.section), own, frame.back)
    return out | _cut(every, parts, look, appearance, plane, size, notes)


def _cut(
    every: Sequence[Part],
    parts: Sequence[Part],
    look: Look,
    appearance: Appearance | None,
    plane: np.ndarray,
    size: float,
    notes: list[str] | None,
) -> dict[str, Any]:
    """Return the shapes of parts that are cut by a plane, and their caps."""
    out: dict[str, Any] = {}
    common = {"section": " ".join(repr(float(x)) for x in plane)}
    open_ones = []
    for number, body in enumerate(cuts.bodies(parts), 1):
        points = bounds.surface_points([body])
        heights = points @ plane[:3]
        if heights.min() >= plane[3]:
            continue  # all of it is cut away
        shapes = _shapes(every, [body], look, appearance, out)
        out |= {key: {**node, **common, "body": number} for key, node in shapes.items()}
        if look.cap == "none" or heights.max() <= plane[3]:
            continue
        sign = cuts.closed(body)
        if not sign:
            open_ones.append(body.name)
            continue
        box = np.stack([points.min(axis=0), points.max(axis=0)])
        box += 0.05 * (box[1] - box[0]) * [[-1], [1]]
        colour = np.array(_plain(every, body) if body.colour is None else body.colour)
        # darker than the surface, so that the cut is told from it
        colour = np.clip(0.12 + 0.62 * colour, 0.0, 0.75)
        cap = cuts.cap_node(plane, box, size, colour, look.cap == "hatched")
        key = _unique(f"cap-{body.name}", out)
        out[key] = {**cap, **common, "body": number, "cap": sign}
    if open_ones and notes is not None:
        notes.append(f"no cap, for these are no closed bodies: {', '.join(open_ones[:9])}")
    return out


def _plain(every: Sequence[Part], part: Part) -> Any:
    """Return the colour of a part whose file tells none."""
    if any(one.colour is not None or one.paints for one in every):
        return 0.55, 0.56, 0.58
    names = [one.name for one in every]
    stem = part.name if part.name in names else part.name.rpartition(".")[0]
    return PALETTE[names.index(stem) % len(PALETTE)]


def _sensor(view: View, look: Look) -> dict[str, Any]:
    back = view.origin - view.target
    back /= np.linalg.norm(back)
    right = np.cross(view.up, back)
    matrix = np.eye(4)
    # Mitsuba's cameras look along z, and x points to the left of the picture
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = -right, view.up, -back
    matrix[:3, 3] = view.origin
    if view.fov is None:
        matrix[:3, :2] *= view.scale
    lens: dict[str, Any] = {"type": "orthographic"}
    if view.fov is not None:
        lens = {"type": "perspective", "fov": view.fov, "fov_axis": "smaller"}
    return {
        **lens,
        "near_clip": view.near,
        "far_clip": view.far,
        "to_world": matrix,
        "sampler": {"type": "independent", "sample_count": look.spp},
        "film": {
            "type": "hdrfilm",
            "width": look.size[0],
            "height": look.size[1],
            "pixel_format": "rgba",
            "rfilter": {"type": "gaussian"},
        },
    }


def _light(look: Look, axes: np.ndarray, back: np.ndarray, points: np.ndarray) -> dict[str, Any]:
    up = axes[2]
    towards = back - up * (back @ up)
    if np.linalg.norm(towards) < 1e-6:  # from above: what is below in the picture is in front
        towards = -np.cross(up, np.cross(axes[1], up))
    towards /= np.linalg.norm(towards)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = np.cross(up, towards), up, towards
    if look.light in ("studio", "sky"):
        picture = (lights.studio if look.light == "studio" else lights.sky)(look.has_ground)
        return {"light": {"type": "envmap", "bitmap": picture, "to_world": matrix}}
    if look.light == "lamp":
        return _lamp(matrix, points)
    if not os.path.isfile(look.light):
        expected = f"one of {', '.join(lights.LIGHTS)}, or a picture (.exr, .hdr) that exists"
        raise BezierError.expected("light", expected, repr(look.light))
    return {
        "light": {
            "type": "envmap",
            "filename": os.path.abspath(look.light),
            "to_world": np.vstack(
                [np.column_stack([axes[0], axes[2], -axes[1], [0] * 3]), [0, 0, 0, 1]]
            ),
        }
    }


def _lamp(frame: np.ndarray, points: np.ndarray) -> dict[str, Any]:
    """Return one square lamp above at the left, and a little light from everywhere."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    towards = frame[:3, :3] @ np.array([-0.6, 0.85, 0.55])
    towards /= np.linalg.norm(towards)
    distance, half = 4.0 * radius, 0.9 * radius
    x = np.cross(frame[:3, 1], -towards)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = half * x, half * np.cross(-towards, x)
    matrix[:3, 2], matrix[:3, 3] = -towards, middle + distance * towards
    radiance = 4.2 * distance**2 / (4 * half**2)
    return {
        "light": {"type": "constant", "radiance": _grey(0.16)},
        "lamp": {
            "type": "rectangle",
            "to_world": matrix,
            "emitter": {"type": "area", "radiance": _grey(radiance)},
        },
    }


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value)] * 3}


def _ground(level: float, points: np.ndarray, axes: np.ndarray, size: float) -> dict[str, Any]:
    level -= 1e-5 * size  # a hair, so that a plane face that lies on the ground is not in it
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    matrix = np.eye(4)
    matrix[:3, :3] = (axes * [[1e3 * size], [1e3 * size], [1.0]]).T
    matrix[:3, 3] = middle + (level - middle @ axes[2]) * axes[2]
    return {
        "type": "rectangle",
        "to_world": matrix,
        "bsdf": {
            "type": "twosided",
            "bsdf": {"type": "diffuse", "reflectance": _grey(lights.GROUND)},
        },
    }


def _shapes(
    every: Sequence[Part],
    parts: Sequence[Part],
    look: Look,
    appearance: Appearance | None,
    taken: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    chosen = _materials(every, look.materials)
    out: dict[str, Any] = {}
    for part in parts:
        stem = part.name if part.name in chosen else part.name.rpartition(".")[0]
        for number in range(len(part.groups)):
            paint = part.paint_of(number)
            for colour in np.unique(paint).tolist():
                rows = np.flatnonzero(paint == colour)
                own = part.paints[colour] if colour >= 0 else part.colour
                own = _plain(every, part) if own is None else own
                bsdf = chosen.get(part.name) or chosen.get(stem) or painted(own)
                key = _unique(part.name, {**(taken or {}), **out})
                out[key] = _shape(part, number, rows, bsdf, appearance)
    return out


def _shape(
    part: Part, number: int, rows: np.ndarray, bsdf: Any, appearance: Appearance | None
) -> dict[str, Any]:
    group, trims = part.groups[number], part.trims[number]
    whole = len(rows) == len(group)
    node: dict[str, Any] = {
        "type": "beziertriangle",
        "control_points": group if whole else group[rows],
    }
    if trims is not None:
        trims = trims if whole else trims[rows]
        if (trims.region >= 0).any():
            node["trims"] = trims
    identity = np.eye(4)
    if len(part.placements) > 1:
        node["instances"] = part.placements[:, :3]
    elif (part.placements[0] != identity).any():
        node["to_world"] = part.placements[0]
    node["bsdf"] = bsdf
    if appearance is not None:
        node |= appearance(part, number, rows) or {}
    return node


def _materials(parts: Sequence[Part], wanted: Mapping[str, str]) -> dict[str, Any]:
    from .selection import matching

    out: dict[str, Any] = {}
    for pattern, text in wanted.items():
        bsdf = material(text)
        for part in parts if pattern == "*" else matching(parts, pattern, "material"):
            out[part.name] = bsdf
    return out


def _unique(name: str, taken: Mapping[str, Any]) -> str:
    """Return an id for a shape that Mitsuba and file systems take."""
    base = re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")[:40] or "part"
    base = f"part-{base}"
    out, k = base, 1
    while out in taken:
        k += 1
        out = f"{base}-{k}"
    return out
