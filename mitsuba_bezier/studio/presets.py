"""What the studio offers: the lecture's figures, as nets to drag or as drawings with sliders."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..geometry import bernstein
from ..geometry.covers import sphere
from ..geometry.projective import ideal, point
from ..geometry.quadrics import quadric_patch
from ..geometry.stereographic import StereographicProjection

__all__ = ["CURVES", "NETS", "PRESETS", "Argument", "Preset", "arguments_of", "drawings"]

SPHERE = np.diag([1.0, 1, 1, -1])
ONE_SHEET = np.diag([1.0, 1, -1, -1])
BOWL = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]])
CUBIC = ((0.0, 0.0), (0.8, 2.3), (3.2, 2.6), (4.6, 0.2))


@dataclass(frozen=True)
class Preset:
    """One figure of the lecture as a net to drag.

    Attributes
    ----------
    make : callable
        Returns the homogeneous control points, ``(K, 4)``; the preset itself, called, does so.
    says : str
        What is to be seen, one sentence.
    curve : bool
        A curve; else a triangle.
    flat : bool
        Its points stay in the plane y = 0, which faces the eye.
    shows : tuple of str
        What is drawn besides: ``scheme``, ``farin``, ``conics``, ``plane``, ``tangents``.
    row : int
        The point that is selected first.
    """

    make: Callable[[], np.ndarray]
    says: str
    curve: bool = False
    flat: bool = False
    shows: tuple[str, ...] = ()
    row: int = 0
    view: tuple[float, float, float] = field(default=(0.75, -1.35, 0.75))

    def __call__(self) -> np.ndarray:
        """Return the net; the first weight that is not zero is 1."""
        net = np.asarray(self.make(), dtype=np.float64)
        first = int(np.flatnonzero(net[:, 3])[0])
        return net / net[first, 3]


def _wall(points: Any, weights: Any = 1.0) -> np.ndarray:
    """Return points of the plane, upright in space: y becomes z."""
    return point(np.insert(np.asarray(points, dtype=np.float64), 1, 0.0, axis=1), weights)


def _over_triangle(n: int, heights: Any) -> np.ndarray:
    corners = np.array([[0, 1.15, 0], [-1.15, -0.75, 0], [1.15, -0.75, 0]])
    x = bernstein.multi_indices(n) / n @ corners
    x[:, 2] = heights
    return point(x)


def _hill() -> np.ndarray:
    return _over_triangle(3, [0.25, 0.7, 0.55, 0.65, 1.15, 0.55, 0.1, 0.6, 0.7, 0.25])


def _on(A: np.ndarray, s: Any, x: Any) -> np.ndarray:
    return quadric_patch(A, point(s), point(x))


def _sphere_corners() -> tuple[np.ndarray, np.ndarray]:
    s = np.array([-0.7, -np.sqrt(1 - 0.49 - 0.25), 0.5])
    x = np.array([[0.1, -0.95, -0.3], [0.95, -0.2, -0.1], [0.3, -0.35, 0.89]])
    return s, x / np.linalg.norm(x, axis=1)[:, None]


def _ellipsoid() -> np.ndarray:
    m = np.array([[1.5, 0.25, 0, 0], [0, 0.85, 0.1, 0], [0, 0, 0.8, 0], [0, 0, 0, 1]])
    return np.asarray(_on(SPHERE, *_sphere_corners()) @ m.T)


def _hyperboloid() -> np.ndarray:
    def on(t: float, z: float) -> list[float]:
        a, r = t - np.radians(38.0), np.sqrt(1 + z * z)
        return [r * np.cos(a), r * np.sin(a), z]

    return _on(ONE_SHEET, on(0.77, 0.87), [on(-1.47, 0.74), on(-1.26, -0.85), on(-0.08, 0.79)])


def _bowl() -> np.ndarray:
    plan = np.array([[0.75, -0.35], [-0.45, -0.65], [-0.1, 0.75]])
    x = point(np.column_stack([plan, (plan**2).sum(axis=1)]))
    return quadric_patch(BOWL, ideal([0, 0, 1]), x)


def _stereographic() -> np.ndarray:
    corners = point([[2.1, -1.2, -1], [-0.4, -1.9, -1], [0.9, 0.9, -1]])
    return StereographicProjection(plane=[0, 0, 1, 1]).triangle(corners).control_points[0]


def _tetrahedral_face() -> np.ndarray:
    corner = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    return _on(SPHERE, corner[2], corner[[0, 3, 1]])


#: Surfaces that the page offers: the lecture's figures by their names in `mitsuba_bezier.figures`.
PRESETS: dict[str, Preset] = {
    "rational_triangle": Preset(
        lambda: point([[0, 1.2, 0.5], [-0.75, 0.3, 0.9], [0.75, 0.3, 0.6], [-1.2, -0.8, 0.1],
                       [0, -0.9, 1.5], [1.2, -0.8, 0.1]]),
        "The weight of a control point pulls the surface towards it; negative, it pushes.",
        row=4,
    ),
    "triangle_net": Preset(
        _hill, "A cubic triangle touches its net of ten control points in the corners.", row=4
    ),
    "triangle_decasteljau": Preset(
        _hill, "The last triangle of de Casteljau's scheme lies in the tangent plane.",
        shows=("scheme",), row=4,
    ),
    "polynomial_triangle": Preset(
        lambda: point([[0, 1.2, 0.5], [-0.75, 0.3, 1.1], [0.8, 0.3, 0.5], [-1.3, -0.8, 0.1],
                       [0.1, -0.9, 1.0], [1.3, -0.8, 0.1]]),
        "While all weights are equal, three parabolas bound the patch.", row=4,
    ),
    "projective_triangle": Preset(
        lambda: np.array([[-0.9, 2.0, 0, 0], [1.0, 1.9, 0, 0], [0.2, -2.6, 0, 1.0]]),
        "Two control vectors: a quarter of a plane, up to the horizon.",
        row=2, view=(0.05, -1.3, 0.19),
    ),
    "bernstein_triangle": Preset(
        lambda: _over_triangle(2, [0, 0, 0, 0, 1.15, 0]),
        "One ordinate is 1, all others 0: a Bernstein polynomial over the triangle.", row=4,
    ),
    "paraboloid": Preset(
        _bowl, "Equal weights and a quadric: a paraboloid; S is the ideal point of its axis.",
        shows=("conics",), row=1,
    ),
    "sphere_point": Preset(
        lambda: _on(SPHERE, *_sphere_corners()),
        "On a quadric the extended boundary conics meet in S. Move a point: they miss.",
        shows=("conics",), row=1,
    ),
    "hyperboloid_point": Preset(
        _hyperboloid, "On a hyperboloid of one sheet S decides, as on the sphere.",
        shows=("conics",), row=1,
    ),
    "ellipsoid_point": Preset(
        _ellipsoid, "An affine image of the sphere; S goes with it.", shows=("conics",), row=1
    ),
    "stereographic": Preset(
        _stereographic, "From S a plane triangle becomes a quadratic triangle on the sphere.",
        shows=("conics",), row=1,
    ),
    "figure2": Preset(
        _tetrahedral_face, "A face of Figure 2; S is the opposite corner of the tetrahedron.",
        shows=("conics",), row=1,
    ),
    "octant": Preset(
        lambda: sphere().control_points[0],
        "An octant of the sphere is one quartic triangle with rational weights.", row=4,
    ),
}  # fmt: skip

#: Curves that it offers.
CURVES: dict[str, Preset] = {
    "decasteljau": Preset(
        lambda: _wall(CUBIC), "Every leg is divided alike; the last leg is the tangent.",
        curve=True, flat=True, shows=("scheme",), row=1,
    ),
    "three_tangents": Preset(
        lambda: _wall([[0, 0], [1.2, 2.4], [3.8, 0.9]]),
        "Three tangents of a parabola cut each other in equal ratios.",
        curve=True, flat=True, shows=("scheme",), row=1,
    ),
    "weights": Preset(
        lambda: _wall(CUBIC), "One weight: every point of the curve moves on a line through it.",
        curve=True, flat=True, shows=("farin",), row=1,
    ),
    "farin": Preset(
        lambda: _wall(CUBIC, [1, 2.0, 0.7, 1]),
        "Farin points (green) stand for the weights; the scheme goes by cross ratios.",
        curve=True, flat=True, shows=("farin", "scheme"), row=1,
    ),
    "conics_by_weight": Preset(
        lambda: _wall([[-1.25, 0], [0, 1.75], [1.25, 0]], [1, 0.5, 1]),
        "The middle weight: below 1 an ellipse, 1 a parabola, above a hyperbola, 0 a line.",
        curve=True, flat=True, shows=("conics",), row=1,
    ),
    "control_vectors": Preset(
        lambda: np.array([[1.4, 0, 0, 1], [0, 0, 1.4, 0], [-1.4, 0, 0, 1.0]]),
        "A half circle: its middle control point is a vector, a point at infinity.",
        curve=True, flat=True, row=1,
    ),
    "bernstein": Preset(
        lambda: _wall([[0, 0], [1 / 3, 1], [2 / 3, 0], [1, 0]]),
        "One ordinate is 1, all others 0: a Bernstein polynomial; drag the ordinates.",
        curve=True, flat=True, row=1,
    ),
    "curve_projection": Preset(
        lambda: point([[-1.2, -1.0, 1.3], [-0.9, -0.5, 2.2], [0.9, -1.0, 2.2], [1.1, 0.2, 1.0]]),
        "The image on the wall is the curve of the projected control points.",
        curve=True, shows=("projection",), row=1, view=(1.5, -1.3, 0.35),
    ),
    "osculating_planes": Preset(
        lambda: point([[-1.3, -0.6, 0], [-0.5, 0.9, 0.2], [0.6, -0.9, 0.9], [1.3, 0.6, 1.3]]),
        "The osculating plane at t holds the last two legs of the scheme.",
        curve=True, shows=("scheme", "plane"), row=1,
    ),
}  # fmt: skip


#: All figures whose points can be dragged.
NETS = {**PRESETS, **CURVES}


@dataclass(frozen=True)
class Argument:
    """A number of a figure that can move: its range, its step, and where it begins."""

    name: str
    low: float
    high: float
    step: float
    start: float


#: Ranges of the arguments of drawings; all others go from 0 to twice where they begin.
_RANGES: dict[str, tuple[float, float, float]] = {
    "t": (0.0, 1.0, 0.01), "s": (0.02, 0.98, 0.01), "u": (0.05, 0.6, 0.01),
    "v": (0.05, 0.35, 0.01),
    "pitch": (-40.0, 40.0, 0.5), "turn": (-90.0, 90.0, 1.0), "tilt": (0.0, 80.0, 0.5),
    "n": (1, 8, 1), "rulings": (3, 40, 1), "eccentricity": (0.0, 2.0, 0.01),
    "bend": (0.0, 1.0, 0.01),
    "slope": (-1.0, 1.0, 0.01), "weight": (-2.0, 12.0, 0.02), "knot": (0.01, 0.99, 0.01),
    "c": (0.05, 2.0, 0.01), "moving": (0.02, 0.98, 0.01), "shear": (-1.0, 1.0, 0.01),
    "stretch": (0.1, 1.5, 0.01), "height": (0.6, 4.0, 0.02), "apart": (0.0, 1.5, 0.01),
    "lift": (-2.0, 0.8, 0.01), "x": (-6.0, 6.0, 0.02), "y": (-4.0, 4.0, 0.02),
}  # fmt: skip


def drawings() -> tuple[str, ...]:
    """Return the figures that are shown as drawings: all whose points are none of a net."""
    from ..figures.catalogue import CATALOGUE

    return tuple(name for name in CATALOGUE if name not in NETS)


def arguments_of(name: str) -> list[Argument]:
    """Return what can move in a figure that is shown as a drawing."""
    from ..figures.catalogue import CATALOGUE

    out = []
    for key, p in inspect.signature(CATALOGUE[name]).parameters.items():
        if key == "style":
            continue
        start = {"eccentricity": 0.6, "weight": 1.0}.get(key, 1.0)
        start = start if p.default is None else p.default
        low, high, step = _RANGES.get(key, (0.0, 2 * abs(start), abs(start) / 100))
        out.append(Argument(key, min(low, start), max(high, start), step, start))
    return out
