"""Show the fields of models: colours, isolines, sides of elements, and displaced surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import BezierError, FileFormatError
from ..geometry.camera import Camera
from ..geometry.fields import MAGNITUDE, BezierField, nearest_names, warped
from ..io import Model, Part
from ..plugins.colormaps import color_table
from ..plugins.field_parameters import MAX_LEVELS, read_limits

__all__ = ["Coloring", "FieldLook", "coloring", "pixel_map", "warped_models"]

#: Intervals between isolines where nothing is said of levels.
_ISOLINES = 12
#: Width of lines in pixels.
_WIDTH = 1.5


@dataclass(frozen=True)
class FieldLook:
    """How fields are shown.

    Attributes
    ----------
    color_by : str or None
        Name of the field that gives colours.
    component : int, str or None
        Its component: a number, ``x``, ``y``, ``z`` or ``magnitude``; None: the only one, or the
        magnitude.
    colormap : str
    range : (float or None, float or None)
        Values of the first and last colour; None: those of the field.
    levels : int
        Bands of one colour each; 0: colours run.
    isolines, edges : bool
        Lines at the ends of levels, and at the sides of elements.
    warp : str or None
        Name of the field of vectors by which points are moved.
    factor : float
        What these are multiplied by.
    """

    color_by: str | None = None
    component: int | str | None = None
    colormap: str = "viridis"
    range: tuple[float | None, float | None] = (None, None)
    levels: int = 0
    isolines: bool = False
    edges: bool = False
    warp: str | None = None
    factor: float = 1.0

    def __post_init__(self) -> None:
        color_table(self.colormap)
        low, high = self.range
        if low is not None and high is not None and not low < high:
            got = f"{low:.9g},{high:.9g}"
            raise BezierError.expected("range", "two numbers a,b with a < b", got)
        if not 0 <= self.levels <= MAX_LEVELS:
            raise BezierError.expected("levels", f"from 1 to {MAX_LEVELS}", self.levels)
        if not np.isfinite(self.factor):
            raise BezierError.expected("factor", "a finite number", self.factor)
        if self.color_by is None:
            for name in ("component", "levels", "isolines"):
                if getattr(self, name) not in (None, 0, False):
                    raise BezierError.expected(name, "with color-by NAME", "without")
            if self.range != (None, None):
                raise BezierError.expected("range", "with color-by NAME", "without")


class Coloring:
    """The colours of a field on models: what `scene` takes as `appearance`, and the bar.

    Attributes
    ----------
    look : FieldLook
    limits : (float, float)
        Values of the first and the last colour.
    label : str
        Name, component and unit.
    """

    def __init__(self, models: Sequence[Model], look: FieldLook) -> None:
        self.look = look
        self._pixels = ""
        self._groups: dict[int, tuple[BezierField, np.ndarray | None, np.ndarray]] = {}
        name = str(look.color_by)
        having = [model for model in models if name in model.fields]
        if not having:
            known = dict.fromkeys(k for model in models for k in model.fields)
            near = ", ".join(repr(k) for k in nearest_names(name, list(known)))
            more = f" ({len(known)} in all)" if len(known) > 5 else ""
            expected = near + more or f"a model with fields; {_names(models)} has none"
            raise FileFormatError.expected("color-by", expected, repr(name))
        ends: list[tuple[float, float]] = []
        for model in having:
            field = model.fields[name]
            self.component = field.component(look.component)
            _check_finite(field)
            ends.append(read_limits(*look.range, field, self.component))
            for k, rows in _rows_of_groups(model).items():
                self._groups[k] = (field, model.edges, rows)
        self.limits = min(low for low, _high in ends), max(high for _low, high in ends)
        self.label = _label(field, self.component)

    def see(self, camera: Mapping[str, Any]) -> None:
        """Take over the camera, by which lines are some pixels wide."""
        self._pixels = " ".join(repr(float(x)) for x in pixel_map(camera).ravel())

    def __call__(self, part: Part, number: int, rows: np.ndarray) -> dict[str, Any] | None:
        """Return the material of some patches of a part; None if the field is not on them."""
        found = self._groups.get(id(part.groups[number]))
        if found is None:
            return None
        field, edges, places = found
        chosen = places[rows]
        look = self.look
        texture: dict[str, Any] = {
            "type": "bezierfield",
            "ordinates": field[chosen],
            "component": str(self.component),
            "colormap": look.colormap,
            "minimum": self.limits[0],
            "maximum": self.limits[1],
        }
        if look.levels:
            texture["levels"] = look.levels
        if look.isolines:
            texture |= {"isolines": look.levels or _ISOLINES, "isoline_width": _WIDTH}
        if look.edges:
            texture["edge_width"] = _WIDTH
            if edges is not None:
                texture["edges"] = edges[chosen]
        if (look.isolines or look.edges) and self._pixels:
            texture["world_to_pixel"] = self._pixels
        diffuse = {"type": "diffuse", "reflectance": texture}
        return {"bsdf": {"type": "twosided", "bsdf": diffuse}}


def coloring(models: Sequence[Model], look: FieldLook) -> Coloring:
    """Return the colours of the field `look.color_by` on models.

    Raises
    ------
    BezierError
        If no model has such a field, or its values are not finite, or nothing is in the range.
    """
    return Coloring(models, look)


def _names(models: Sequence[Model]) -> str:
    return ", ".join(model.report.path for model in models)


def _check_finite(field: BezierField) -> None:
    if (missing := field.missing()).any():
        raise FileFormatError.expected(
            f"field {field.name!r}",
            f"finite values on all {len(field)} patches",
            f"none on {int(missing.sum())} of them (NaN, or not in the file)",
        )


def _label(field: BezierField, component: int | str) -> str:
    text = field.name
    if component == MAGNITUDE and field.components > 1:
        text += " magnitude"
    elif field.components in (2, 3) and isinstance(component, int):
        text += f" {'xyz'[component]}"
    elif field.components > 1:
        text += f" {component}"
    return f"{text} [{field.unit}]" if field.unit else text


def _rows_of_groups(model: Model) -> dict[int, np.ndarray]:
    """Return for each group, by its identity, where its patches are in `Model.triangles`."""
    order = np.argsort(np.concatenate(model.sources), kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    ends = np.cumsum([len(group) for group in model.groups])[:-1]
    return {id(g): rows for g, rows in zip(model.groups, np.split(place, ends))}


def pixel_map(camera: Mapping[str, Any]) -> np.ndarray:
    """Return the map ``(4, 4)`` from the world to pixels ``(w x, w y, ., w)`` of a sensor.

    Parameters
    ----------
    camera : mapping
        The description of a ``perspective`` or ``orthographic`` sensor with its film.
    """
    film = camera["film"]
    size = float(film["width"]), float(film["height"])
    to_world = np.asarray(camera["to_world"], dtype=np.float64)
    if camera["type"] == "perspective":
        axis = camera.get("fov_axis", "x")
        near, far = camera.get("near_clip", 1e-2), camera.get("far_clip", 1e4)
        return Camera(to_world, camera["fov"], axis, size, near_clip=near, far_clip=far).matrix
    half = size[0] / 2
    sample = np.array([[-half, 0, 0, half], [0, -half, 0, size[1] / 2], [0, 0, 1, 0], [0, 0, 0, 1]])
    return sample @ np.linalg.inv(to_world)


def warped_models(models: Sequence[Model], name: str, factor: float) -> list[Model]:
    """Return models whose points are moved by a field, those without it as they are.

    Raises
    ------
    BezierError
        If no model has such a field, or its values are no vectors.
    """
    if not any(name in model.fields for model in models):
        every = [item for model in models for item in model.fields.items()]
        known = dict.fromkeys(k for k, field in every if field.components in (2, 3))
        near = ", ".join(repr(k) for k in nearest_names(name, list(known)))
        expected = near or f"a model with fields of vectors; {_names(models)} has none"
        raise FileFormatError.expected("warp", expected, repr(name))
    out = []
    for model in models:
        if name not in model.fields:
            out.append(model)
            continue
        field = model.fields[name]
        _check_finite(field)
        nets, trims = model.trimmed()
        moved = warped(nets, field, factor)
        out.append(
            Model(
                [moved],
                [np.arange(len(moved))],
                replace(model.report),
                [trims] if trims is not None else None,
                unit=model.unit,
                fields=model.fields,
                edges=model.edges,
            )
        )
    return out
