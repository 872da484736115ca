"""Cut a model by a plane: which plane, which half is kept, and a cap for each body that it cuts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import BezierError
from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles
from ..io.parts import Part

__all__ = ["Plane", "bodies", "cap_node", "closed", "read_section", "resolved"]

_AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
_PATTERN = re.compile(
    r"\s*(?:(?P<sign>[+-]?)(?P<axis>[xyz])|(?P<normal>[^=<>]+,[^=<>]+,[^=<>]+))\s*"
    r"(?P<how><=|>=|=|<|>)\s*(?P<at>[^%=<>]+)(?P<percent>%?)\s*",
    re.IGNORECASE,
)
#: A closed body has a sum of areas as vectors that is this small, relative to its area. Bodies with
#: trims, which are found at the points of a lattice only, have up to 0.0022.
_OPEN = 0.02
#: The same for these areas times their places, relative to area and size; those have 0.0006.
_UNEVEN = 0.004
#: Points a patch along each side, for these sums.
_LATTICE = 16
#: Stripes of a hatched cap, over the size of the model.
_STRIPES = 24


@dataclass(frozen=True)
class Plane:
    """A plane as it is asked for.

    Attributes
    ----------
    normal : (3,) tuple
        Of unit length.
    at : float
        ``normal . x = at`` on the plane; of percents the number itself.
    percent : bool
        Whether `at` is a percentage of the model's extent along the normal.
    keep : int
        Which side is kept: -1 below, 1 above, 0 what does not hide the cut from the camera.
    """

    normal: tuple[float, float, float]
    at: float
    percent: bool
    keep: int


def read_section(text: str) -> Plane:
    """Return the plane of ``z=10``, ``x<50%``, ``-y>3``, or ``1,0,1=4``.

    Raises
    ------
    BezierError
        If it is none.
    """
    found = _PATTERN.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        if found["axis"]:
            vector = np.array(_AXES[found["axis"].lower()], dtype=np.float64)
            vector = -vector if found["sign"] == "-" else vector
        else:
            vector = np.array([float(word) for word in found["normal"].split(",")])
        length = float(np.linalg.norm(vector))
        at = float(found["at"])
        if vector.shape != (3,) or not (0 < length < np.inf and np.isfinite(at)):
            raise ValueError
    except ValueError:
        raise BezierError.expected(
            "section", "a plane such as z=10, x<50%, or 1,0,1=4", repr(text)
        ) from None
    percent = bool(found["percent"])
    keep = {"=": 0, "<": -1, ">": 1}[found["how"][0]]
    return Plane(tuple((vector / length).tolist()), at if percent else at / length, percent, keep)


def resolved(plane: Plane, points: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return ``(a, b, c, d)`` with ``a x + b y + c z <= d`` for what is kept.

    Parameters
    ----------
    plane : Plane
    points : (N, 3) array
        Of the surface.
    back : (3,) array
        Towards the camera.

    Raises
    ------
    BezierError
        If the plane misses the model.
    """
    normal = np.array(plane.normal)
    heights = points @ normal
    low, high = float(heights.min()), float(heights.max())
    at = low + plane.at / 100 * (high - low) if plane.percent else plane.at
    if not low < at < high:
        raise BezierError.expected(
            "section",
            f"a plane that meets the model, which reaches from {low:.6g} to {high:.6g} there",
            f"{at:.6g}",
        )
    keep = plane.keep or (1 if normal @ back < -1e-9 else -1)
    return np.array([*(-keep * normal), -keep * at])


def bodies(parts: Sequence[Part]) -> list[Part]:
    """Return the parts with one part for each place: bodies are cut one by one."""
    out = []
    for part in parts:
        for k, (matrix, place) in enumerate(zip(part.placements, part.places)):
            name = part.name if len(part.placements) == 1 else f"{part.name}.{k + 1}"
            out.append(replace(part, name=name, placements=matrix[None], places=[place]))
    return out


def closed(part: Part) -> int:
    """Return 1 for a closed body whose normals point outwards, -1 inwards, 0 for what is none.

    Of a closed body the areas as vectors sum to zero, and with the places where they are to its
    volume times the identity (Gauss). An open tube passes the first, not the second.
    """
    vector, moments, area = np.zeros(3), np.zeros((3, 3)), 0.0
    # midpoints of the triangles of a lattice, those with the point up and those with it down
    up = bernstein.multi_indices(_LATTICE - 1)[:, :2] + 1 / 3
    down = bernstein.multi_indices(_LATTICE - 2)[:, :2] + 2 / 3
    uv = np.concatenate([up, down]) / _LATTICE
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for group, trims in zip(part.groups, part.trims):
        patch = np.repeat(np.arange(len(group)), len(uv))
        at = np.tile(uv, (len(group), 1))
        x, xu, xv = group.partials(patch, at, order=1)
        with np.errstate(all="ignore"):
            p = x[:, :3] / x[:, 3:]
            du = (xu[:, :3] - p * xu[:, 3:]) / x[:, 3:]
            dv = (xv[:, :3] - p * xv[:, 3:]) / x[:, 3:]
        n = np.cross(du, dv) / (2 * len(uv))
        good = np.isfinite(n).all(axis=1)
        if trims is not None:
            good &= trims.inside(patch, at)
        p, n = p[good], n[good]
        if not len(p):
            continue
        low, high = np.minimum(low, p.min(axis=0)), np.maximum(high, p.max(axis=0))
        vector += n.sum(axis=0)
        moments += p.T @ n
        area += float(np.linalg.norm(n, axis=1).sum())
    if not area:
        return 0
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    moments -= np.outer(middle, vector)
    volume = float(np.trace(moments)) / 3
    off = np.linalg.norm(moments - volume * np.eye(3))
    if np.linalg.norm(vector) > _OPEN * area or off > _UNEVEN * area * size:
        return 0
    # `to_world` keeps the outside out, also where it mirrors
    return 1 if volume > 0 else -1


def hatch(colour: np.ndarray) -> np.ndarray:
    """Return a picture ``(64, 64, 3)`` of one slanted stripe that repeats."""
    x = (np.arange(64) + 0.5) / 64
    across = (2 * x[:, None] + x[None, :]) % 1.0  # along no diagonal of a box
    line = np.clip((np.abs(across - 0.5) - 0.36) / 0.04, 0.0, 1.0)
    dark = colour @ [0.2126, 0.7152, 0.0722] < 0.25  # luminance
    other = 0.35 * colour + 0.5 if dark else 0.16 * colour
    return (colour + line[..., None] * (other - colour)).astype(np.float32)


def cap_node(
    plane: np.ndarray, box: np.ndarray, size: float, colour: np.ndarray, hatched: bool
) -> dict[str, Any]:
    """Return the description of the triangle that closes a body where it is cut.

    Parameters
    ----------
    plane : (4,) array
        From `resolved`.
    box : (2, 3) array
        Bounds of the body.
    size : float
        Of the model.
    colour : (3,) array
        Of the body.
    hatched : bool
        Stripes, or all of one colour.
    """
    normal = plane[:3]
    axis = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = np.cross(axis, normal)
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
    flat = corners @ np.stack([x, y]).T
    low, high = flat.min(axis=0), flat.max(axis=0)
    low, high = low - 0.01 * (high - low), high + 0.01 * (high - low)
    places = np.array([low, [2 * high[0] - low[0], low[1]], [low[0], 2 * high[1] - low[1]]])
    points = places @ np.stack([x, y]) + plane[3] * normal
    net = BezierTriangles(np.column_stack([points, np.ones(3)])[None])
    if not hatched:
        texture: Any = {"type": "rgb", "value": colour.tolist()}
    else:
        texture = {"type": "bitmap", "bitmap": hatch(colour), "raw": True}
    node: dict[str, Any] = {"type": "beziertriangle", "control_points": net}
    if hatched:
        node["texcoords"] = (places * (_STRIPES / size))[None]
    node["bsdf"] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture}}
    return node
