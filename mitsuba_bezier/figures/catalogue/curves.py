"""Bézier's first idea, de Casteljau, Bernstein polynomials, weights, projections of curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...geometry.basic_curve import BasicCurve
from ...geometry.bernstein import univariate
from ...geometry.camera import Camera, look_at
from ...geometry.collineations import central_projection
from ...geometry.conics import circle
from ...geometry.cross_ratio import cross_ratio
from ...geometry.curves import BezierCurve
from ...geometry.projective import affine, point
from ...geometry.splines import BSplineCurve
from ._arguments import few, shown

if TYPE_CHECKING:
    from .. import Drawing

__all__ = ["FIGURES"]

CUBIC = ((0, 0), (0.8, 2.3), (3.2, 2.6), (4.6, 0.2))


def basic_curve(style: str = "screen", shear: float = 0.55) -> Drawing:
    """Bézier's first idea: two elliptic cylinders in a box; the sheared box shears the curve."""
    from .. import space

    camera = Camera(look_at([4.6, -7.2, 3.6], [0.98, 0.35, 0.62], [0, 0, 1]), 31, "x", (1600, 900))
    d = space(camera, style)
    lean = np.array([[1, 0, 0], [shear, 1, 0], [0.3 * shear, 0.45 * shear, 1]])
    boxes = (
        BasicCurve((-0.95, 0, 0)),
        BasicCurve((1.0, 0, 0), lean),
    )
    for curve in boxes:
        o, e = curve.origin, curve.edges
        d.box(o, e, "thin")
        angle = np.linspace(0, np.pi / 2, 33)
        quarter = np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
        for s in np.linspace(0, 1, 7):
            for axis, (i, j) in ((2, (0, 1)), (0, (1, 2))):
                x = np.zeros((33, 3))
                x[:, [i, j]], x[:, axis] = quarter, s
                _path(d, o + x @ e, "thin" if 0 < s < 1 else "polygon", axis == 0)
        for k in range(0, 33, 4):
            for axis, (i, j) in ((2, (0, 1)), (0, (1, 2))):
                ends = np.zeros((2, 3))
                ends[:, [i, j]], ends[1, axis] = quarter[k], 1
                a, b = o + ends @ e
                d.segment(
                    a, b, "thin", linestyle="-" if axis == 2 else (0, (3, 2))
                )  # fmt: skip
        _path(d, curve.points(np.linspace(0, 1, 120)), "curve", False, 3.4)
        d.point(o, kind="second point")
        d.point(o + e.sum(axis=0), kind="second point")
    d.title(
        "A curve on two elliptic cylinders in a box (full and dashed rulings),\n"
        "and in a sheared box."
    )
    return d


def _path(d: Drawing, x: np.ndarray, kind: str, dashed: bool, width: float | None = None) -> None:
    look = {} if width is None else {"linewidth": width}
    d._stroke([d.place(x)], kind, **look, **({"linestyle": (0, (3, 2))} if dashed else {}))


def decasteljau(style: str = "screen", t: float = 0.4) -> Drawing:
    """De Casteljau's algorithm: linear interpolation alone."""
    from .. import plane

    d = plane((-0.8, 5.6), (-0.4, 3.2), style)
    curve = BezierCurve.from_points(CUBIC)
    d.de_casteljau(curve, t, f"$b({shown(t)})$")
    d.curve(curve)
    text = f"Every leg is divided $t : (1-t)$, here $t = {shown(t)}$"
    d.title(f"{text}; the last leg is the tangent.")
    return d


def bernstein(style: str = "screen", n: int = 3, t: float = 0.4) -> Drawing:
    """Bernstein polynomials: positive, with the sum 1."""
    from .. import plane

    n = few("n", n, 1, 8)

    d = plane((-0.16, 1.2), (-0.09, 0.675), style)
    s = np.linspace(0, 1, 200)
    values = univariate(n, s)
    for k in range(n + 1):
        coefficients = np.zeros((n + 1, 3))
        coefficients[:, 0], coefficients[:, 1] = (
            np.linspace(0, 1, n + 1),
            0.5 * np.eye(n + 1)[k],
        )
        coefficients[:, 2] = 1
        look = ("curve", "second", "third", "construction")[k % 4]
        d.curve(BezierCurve(coefficients), look, linewidth=2.2)
        top = int(np.argmax(values[:, k]))
        way = (16, -2) if top == 0 else (0, 6)
        d.label([s[top], 0.5 * values[top, k]], f"$B_{{{k}}}^{{{n}}}$", way, fontsize=12.5)
    for line in ([0, 0], [1.04, 0]), ([0, 0], [0, 0.56]):
        d.segment(*line, "line")
    d.segment([t, 0], [t, 0.55], "thin")
    for v in univariate(n, t):
        d.point([t, 0.5 * v], kind="second point", markersize=5.0)
    d.label(
        [t, 0.55], " + ".join(f"{v:.3f}" for v in univariate(n, t)) + " = 1", (0, 4), fontsize=11
    )
    d.label([t, 0], f"$t={shown(t)}$", (0, -8))
    d.label([0, 0.5], "1", (-8, 0))
    d.label([1, 0], "1", (0, -8))
    d.title(
        f"$B_i^{{{n}}}(t) = \\binom{{{n}}}{{i}}(1-t)^{{{n}-i}}\\, t^i$; "
        "their sum is 1 for every $t$."
    )
    return d


def control_vectors(style: str = "screen") -> Drawing:
    """Control vectors: control points at infinity; a half circle is one quadratic arc."""
    from .. import plane

    d = plane((-2.7, 6.5), (-0.9, 4.275), style)
    half = BezierCurve([[1.4, 0, 1], [0, 1.4, 0], [-1.4, 0, 1]])
    d.curve(half)
    for x in (-1.4, 1.4):
        d.segment([x, 0, 1], [0, 1, 0], "polygon")
        d.arrow([x, 0], [x, 1.4], "tangent")
    d.point([1.4, 0], "$b_0$", (0, -10))
    d.point([-1.4, 0], "$b_2$", (0, -10))
    d.label([1.4, 1.15], "$b_1 = (0, r, 0)$", (10, 0))
    branch = BezierCurve([[1, 0.25, 0.0], [3.1, 0.2, 1.0], [0.25, 1.0, 0.0]])
    d.curve(branch, "second")
    d.line([3.1, 0.2, 1], [1, 0.25, 0], "polygon")
    d.line([3.1, 0.2, 1], [0.25, 1, 0], "polygon")
    d.arrow([3.1, 0.2], [4.1, 0.45], "tangent")
    d.arrow([3.1, 0.2], [3.35, 1.2], "tangent")
    d.point([3.1, 0.2], "$b_1$", (2, -10))
    d.label([4.1, 0.45], "$b_0$ ideal", (4, -9))
    d.label([3.35, 1.2], "$b_2$ ideal", (-9, 4))
    d.title(
        "A half circle with an ideal middle control point, and a branch of a hyperbola\n"
        "from asymptote to asymptote, with two ideal ends."
    )
    return d


def weights(style: str = "screen", weight: float | None = None) -> Drawing:
    """The weight of one control point pulls the curve towards it; negative, it pushes."""
    from .. import plane

    d = plane((-0.7, 5.5), (-0.35, 3.1375), style)
    values = [0.0, 0.35, 1.0, 3.0, 12.0, -0.18] if weight is None else [weight]
    for w in values:
        net = point(CUBIC)
        net[1] *= w
        curve = BezierCurve(net)
        d.curve(curve, "third" if w < 0 else "curve", linewidth=1.6 if w != 1 else 2.6)
        d.label(curve.evaluate(0.36), f"$w_1={shown(w)}$", (4, 6), fontsize=10.5)
        if weight is not None:
            d.farin(curve)
    d.polyline(CUBIC, "polygon")
    d.points(CUBIC, "$b_{}$")
    d.title("One net, one weight: points move on lines through $b_1$.")
    return d


def farin(style: str = "screen", t: float = 0.4, weight: float = 2.0) -> Drawing:
    """Farin points and cross ratios: evaluation that every collineation keeps."""
    from .. import plane

    d = plane((-0.6, 5.4), (-0.3, 3.075), style)
    curve = BezierCurve.from_points(CUBIC, [1, weight, 0.7, 1])
    d.control_polygon(curve)
    d.farin(curve, t)
    d.curve(curve)
    x = curve.evaluate(t)
    d.point(x, f"$b({shown(t)})$", (8, -10), markersize=8.0)
    b, q = curve.control_points, curve.farin_points()
    level = curve.de_casteljau(t)[1]
    value = float(cross_ratio(b[0], q[0], level[0], b[1]))
    d.title(
        "$\\mathrm{cr}(b_i, q_i, b_i^1, b_{i+1}) = (1-t)/t = "
        f"{value:.3f}$ on every leg (diamonds: Farin points)"
    )
    return d


def curve_projection(style: str = "screen", height: float = 2.7) -> Drawing:
    """The projection of a curve is the curve of the projected control points."""
    from .. import space

    camera = Camera(look_at([7.6, -7.6, 3.6], [-0.1, -0.2, 1.5], [0, 0, 1]), 40, "x", (1600, 900))
    d = space(camera, style)
    eye = np.array([0, -2.8, height, 1.0])
    wall = np.array([0, 1.0, 0, -1.6])
    curve = BezierCurve.from_points(
        [[-1.2, -1.0, 1.3], [-0.9, -0.5, 2.2], [0.9, -1.0, 2.2], [1.1, 0.2, 1.0]]
    )
    image = curve.project(central_projection(eye, wall))
    x = affine(image.control_points)
    d.plane([[-4.6, 1.6, -1.6], [3.4, 1.6, -1.6], [3.4, 1.6, 2.6], [-4.6, 1.6, 2.6]], grey=0.9)
    for p, q in zip(affine(curve.control_points), x):
        d.segment(eye, q, "thin")
        d.point(p, kind="point")
        d.point(q, kind="second point")
    d.polyline(affine(curve.control_points), "polygon")
    d.polyline(x, "polygon")
    for t in np.linspace(0.1, 0.9, 9):
        d.segment(curve.points(t), image.points(t), "thin", linestyle=(0, (2, 2)))
    d.curve(curve)
    d.curve(image, "second")
    d.point(eye, "$S$", (-12, 8), markersize=8.0)
    w = image.weights / image.weights[0]
    d.title(
        "Control points and curve, projected from $S$ onto a wall (dashed);\n"
        "the weights of the images: " + ", ".join(f"{v:.2f}" for v in w) + "."
    )
    return d


def spline(style: str = "screen", knot: float = 0.37) -> Drawing:
    """A B-spline, one knot more, and its Bézier points: the same curve thrice."""
    from .. import plane

    d = plane((-0.7, 7.1), (-0.6, 3.7875), style)
    curve = BSplineCurve.from_points(
        [[0, 0], [0.6, 2.4], [2.4, 3.0], [3.8, 0.2], [5.4, 0.4], [6.2, 2.6]]
    )
    more = curve.insert_knot(knot)
    d.polyline(affine(more.control_points), "construction")
    d.polyline(affine(curve.control_points), "polygon")
    d.curve(curve)
    for piece in curve.to_bezier():
        d.points(piece.control_points, kind="second point", markersize=4.0)
    d.points(affine(more.control_points), kind="second point", markersize=7.5)
    d.points(curve.control_points, "$d_{}$", offset=(-8, 8))
    text = f"Control points $d_i$; dashed: with the knot {shown(knot)} inserted"
    d.title(f"{text}; small: Bézier points.")
    return d


def circle_to_hyperbola(style: str = "screen", tilt: float = 24.0) -> Drawing:
    """A cone cut by a plane: circle, ellipse, parabola, hyperbola, as the plane tilts."""
    from .. import space

    camera = Camera(look_at([4.4, -8.6, 6.0], [0.2, 0, 0.3], [0, 0, 1]), 44, "x", (1600, 900))
    d = space(camera, style)
    for z in (-1.9, 1.9):
        for arc in circle((0, 0), abs(z), 4):
            net = np.insert(arc.control_points, 2, z * arc.weights, axis=1)
            d.curve(BezierCurve(net), "thin")
    for a in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        top = np.array([np.cos(a), np.sin(a), 1.0]) * 1.9
        d.segment(-top, top, "thin", linewidth=0.5)
    angle = np.radians(tilt)
    c, s = np.cos(angle), np.sin(angle)
    u, v, n = np.array([c, 0, s]), np.array([0, 1.0, 0]), np.array([-s, 0, c])
    o = np.array([0, 0, 0.85]) - 0.0 * n
    frame = np.column_stack([np.append(u, 0), np.append(v, 0), np.append(o, 1)])
    cone = np.diag([1.0, 1, -1, 0])
    section = frame.T @ cone @ frame
    corners = [o + 2.5 * (i * u + j * v) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    d.plane(corners, grey=0.86, opacity=0.55)
    from ...geometry.conics import classify_conic, conic_arcs

    kind = classify_conic(section)
    if kind in ("ellipse", "parabola", "hyperbola"):
        for arc in conic_arcs(section, 4):
            d.curve(BezierCurve(arc.control_points @ frame.T), "curve", linewidth=3.0)
    name = "circle" if abs(tilt) < 1e-9 else kind
    d.title(f"The section of a cone by a plane tilted by {tilt:.0f}°: {name}.")
    return d


FIGURES = {
    "basic_curve": basic_curve,
    "decasteljau": decasteljau,
    "bernstein": bernstein,
    "control_vectors": control_vectors,
    "weights": weights,
    "farin": farin,
    "curve_projection": curve_projection,
    "conic_sections": circle_to_hyperbola,
    "spline": spline,
}
