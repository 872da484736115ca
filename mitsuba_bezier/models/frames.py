"""Make the models and views of a film: a turntable, steps of time, a weight that runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import BezierError
from ..io import Model, Report
from . import section
from .camera import read_up, read_view, view_frame
from .scene import Framing, Look, framing_of

__all__ = ["Frame", "animated", "read_animation", "steps", "turntable"]

#: Directions at which a turned model is looked at for the framing.
_TURNS = 24
#: Points of a framing, at most.
_POINTS = 4000


@dataclass(frozen=True)
class Frame:
    """One picture of a film."""

    models: Sequence[Model]
    look: Look
    framing: Framing


def turntable(models: Sequence[Model], look: Look, count: int) -> list[Frame]:
    """Return the frames of one turn, the last one step before the first.

    The camera goes round, and light with it, as if the model turned; it is as far away in all
    frames. A section keeps the half that it keeps in the first.
    """
    found = framing_of(models, look)
    axes, (azimuth, elevation) = read_up(look.up), read_view(look.view)
    if look.section is not None:
        back = view_frame(azimuth, elevation, axes).back
        plane = section.resolved(section.read_section(look.section), found.points, back)
        words = [repr(float(x)) for x in plane]
        look = replace(look, section=f"{','.join(words[:3])}<{words[3]}")
    local = found.points @ axes.T
    local = local[:: max(1, len(local) // _POINTS)]
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    turned = []
    for angle in np.arange(_TURNS) * 2 * np.pi / _TURNS:
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        turned.append((local - middle) @ rotation + middle)
    around = Framing(np.concatenate(turned) @ axes, found.level)
    views = [(azimuth + 360.0 * k / count, elevation) for k in range(count)]
    return [Frame(models, replace(look, view=_wrapped(view)), around) for view in views]


def _wrapped(view: tuple[float, float]) -> tuple[float, float]:
    return (view[0] + 180.0) % 360.0 - 180.0, view[1]


def steps(models: Sequence[Model], look: Look) -> list[Frame]:
    """Return a frame for each model, all seen from one place."""
    around = framing_of(models, look)
    return [Frame([model], look, around) for model in models]


@dataclass(frozen=True)
class Animation:
    """A weight of a control point that runs from one value to another."""

    patch: int
    point: int
    first: float
    last: float


def read_animation(text: str) -> Animation:
    """Return ``weight:PATCH,POINT,FROM,TO``.

    Raises
    ------
    BezierError
        If it is none.
    """
    kind, _, rest = text.partition(":")
    words = rest.split(",")
    try:
        if kind.strip().lower() != "weight" or len(words) != 4:
            raise ValueError
        out = Animation(int(words[0]), int(words[1]), float(words[2]), float(words[3]))
        if out.patch < 0 or out.point < 0 or not np.isfinite([out.first, out.last]).all():
            raise ValueError
    except ValueError:
        raise BezierError.expected(
            "animate", "weight:PATCH,POINT,FROM,TO, such as weight:0,4,1,-1", repr(text)
        ) from None
    return out


def animated(models: Sequence[Model], look: Look, animation: Animation, count: int) -> list[Frame]:
    """Return frames in which a weight runs evenly; the point stays where it is.

    Patches and points are numbered from 0, as in `BezierTriangles`. The camera sees the surfaces of
    the first frame; others may run to infinity.

    Raises
    ------
    BezierError
        If there is no such point, it is at infinity, or there are several models.
    """
    if len(models) != 1:
        raise BezierError.expected("animate", "one model", f"{len(models)}")
    net, trims = models[0].trimmed()
    shape = net.control_points.shape[:2]
    if animation.patch >= shape[0] or animation.point >= shape[1]:
        raise BezierError.expected(
            "animate",
            f"a patch below {shape[0]} and a point below {shape[1]}",
            f"{animation.patch} and {animation.point}",
        )
    row = net.control_points[animation.patch, animation.point]
    if row[3] == 0:
        raise BezierError.expected("animate", "a point that is not at infinity", row.tolist())
    place = np.append(row[:3] / row[3], 1.0)
    made: list[Model] = []
    for weight in np.linspace(animation.first, animation.last, count):
        points = net.control_points.copy()
        points[animation.patch, animation.point] = weight * place
        source = models[0].report
        report = Report(source.path, source.format, source.faces, source.converted)
        every: Any = None if trims is None else [trims]
        made.append(Model([type(net)(points)], [np.arange(shape[0])], report, every))
    around = framing_of(made[:1], look)
    return [Frame([model], look, around) for model in made]
