"""Control nets and arrows in scenes, as dictionaries for `mi.load_dict`."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ...errors import GeometryError
from ...geometry import bernstein
from ...geometry.checks import length, vector
from ...geometry.curves import BezierCurve
from ...geometry.projective import is_ideal
from ...geometry.shapes import cone
from ...geometry.triangles import BezierTriangles
from ..native.dictionaries import shape

__all__ = ["arrow", "net_shapes"]

#: What pieces are made of, if nothing is given: dark legs, light points.
LEG = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.08, 0.08, 0.09]}}
POINT = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.75, 0.2, 0.08]}}


def _cylinder(a: np.ndarray, b: np.ndarray, radius: float, bsdf: Any) -> dict[str, Any]:
    return {
        "type": "cylinder",
        "p0": mi.ScalarPoint3f(*a.tolist()),
        "p1": mi.ScalarPoint3f(*b.tolist()),
        "radius": radius,
        "bsdf": bsdf,
    }


def arrow(
    start: Any, end: Any, radius: float, bsdf: Any = None, name: str = "arrow"
) -> dict[str, Any]:
    """Return an arrow as shapes of a scene: a cylinder and a cone.

    Parameters
    ----------
    start, end : (3,) array_like
        Its tail and its tip.
    radius : float
        Of the shaft; the head is three times as wide and nine times as long, at most half of it.
    bsdf : dict, optional
        Material.
    name : str
        What the keys begin with.

    Raises
    ------
    GeometryError
        If the ends coincide, or a parameter is not of this kind.

    Examples
    --------
    >>> sorted(arrow([0, 0, 0], [0, 0, 1], 0.02))
    ['arrow_head', 'arrow_shaft']
    """
    a, b, r = vector("start", start), vector("end", end), length("radius", radius)
    way = b - a
    size = float(np.linalg.norm(way))
    if not size > 0:
        raise GeometryError.expected("start, end", "two different points", "the same twice")
    z = way / size
    head = min(9 * r, size / 2)
    bsdf = LEG if bsdf is None else bsdf
    x = np.linalg.svd(z[None])[2][1]
    place = np.eye(4)
    place[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    place[:3, 3] = b - head * z
    tip = cone(radii=3 * r, height=head, capped=True)
    return {
        f"{name}_shaft": _cylinder(a, b - head * z, r, bsdf),
        f"{name}_head": shape(tip.transform(place), bsdf=bsdf),
    }


def net_shapes(
    patches: BezierTriangles | BezierCurve,
    radius: float,
    bsdf: Any = None,
    point_bsdf: Any = None,
    vector_length: float | None = None,
    name: str = "net",
) -> dict[str, Any]:
    """Return control nets as shapes of a scene: spheres, and cylinders for the legs between them.

    Parameters
    ----------
    patches : BezierTriangles or BezierCurve
        Whose nets (polygon) are shown. Legs and points that patches share are made once.
    radius : float
        Of the legs; points are 2.6 times as large.
    bsdf, point_bsdf : dict, optional
        Materials of legs and points.
    vector_length : float, optional
        Control vectors are shown as arrows of this length from each of their finite neighbours;
        20 radii if not given.
    name : str
        What the keys begin with.

    Returns
    -------
    dict
        To be merged into that of a scene: ``{"type": "scene", ..., **net_shapes(...)}``.

    Raises
    ------
    GeometryError
        If a parameter is not of this kind, or no control point is finite.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> shapes = mb.net_shapes(mb.disk(), radius=0.01)
    >>> scene = {"type": "scene", "disk": mb.shape(mb.disk()), **shapes}
    >>> sorted({shape["type"] for shape in shapes.values()})
    ['cylinder', 'sphere']
    """
    r = length("radius", radius)
    reach = 20 * r if vector_length is None else length("vector_length", vector_length)
    legs_of = LEG if bsdf is None else bsdf
    points_of = POINT if point_bsdf is None else point_bsdf
    out: dict[str, Any] = {}
    points: dict[tuple[float, ...], np.ndarray] = {}
    legs: dict[tuple[tuple[float, ...], tuple[float, ...]], tuple[np.ndarray, np.ndarray]] = {}
    arrows: dict[tuple[tuple[float, ...], tuple[float, ...]], tuple[np.ndarray, np.ndarray]] = {}
    for net, pairs in _nets(patches):
        used = np.asarray(net.any(axis=1))
        safe = np.where(used[:, None], net, [[0, 0, 0, 1.0]])
        finite = used & ~is_ideal(safe)
        weight = np.where(finite, net[:, 3], 1.0)[:, None]
        x = net[:, :3] / weight
        keys = [tuple(np.round(p, 12)) for p in x]  # the same to rounding is one point
        for k in np.flatnonzero(finite).tolist():
            points[keys[k]] = x[k]
        for i, j in pairs:
            if finite[i] and finite[j] and keys[i] != keys[j]:
                low, high = sorted((i, j), key=lambda row: keys[row])
                legs[keys[low], keys[high]] = x[low], x[high]
            for p, q in ((i, j), (j, i)):
                if finite[p] and used[q] and not finite[q]:
                    way = net[q, :3] / np.linalg.norm(net[q, :3]) * np.sign(net[p, 3])
                    arrows[keys[p], tuple(np.round(way, 12))] = x[p], x[p] + reach * way
    if not points:
        raise GeometryError.expected("patches", "a finite control point", "none")
    for number, center in enumerate(points.values()):
        ball = {"type": "sphere", "center": center.tolist(), "radius": 2.6 * r, "bsdf": points_of}
        out[f"{name}_point_{number}"] = ball
    for number, (a, b) in enumerate(legs.values()):
        out[f"{name}_leg_{number}"] = _cylinder(a, b, r, legs_of)
    for number, (a, b) in enumerate(arrows.values()):
        out |= arrow(a, b, r, legs_of, f"{name}_vector_{number}")
    return out


def _nets(patches: Any) -> list[tuple[np.ndarray, list[tuple[int, int]]]]:
    """Return nets ``(K, 4)`` and the pairs of rows that legs join."""
    if isinstance(patches, BezierCurve):
        net = patches.control_points
        if net.shape[1] == 3:
            net = np.insert(net, 2, 0.0, axis=1)
        return [(net, [(k, k + 1) for k in range(len(net) - 1)])]
    if not isinstance(patches, BezierTriangles):
        raise GeometryError.expected(
            "patches", "BezierTriangles or a BezierCurve", f"{type(patches).__name__}"
        )
    pairs = [(a, b) for a, b in bernstein.net_edges(patches.degree).tolist()]
    return [(net, pairs) for net in patches.control_points]
