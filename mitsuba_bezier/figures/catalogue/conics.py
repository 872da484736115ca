"""Kepler's foci, polarity, conics by one weight, the theorems on tangents."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...errors import GeometryError
from ...geometry.conic_elements import conic_by_focus, conic_elements
from ...geometry.conics import conic_matrix
from ...geometry.cross_ratio import cross_ratio
from ...geometry.curves import BezierCurve
from ...geometry.polarity import Polarity, line_intersections, polar
from ...geometry.projective import affine, is_ideal, meet, point
from ...geometry.tangents import three_tangent_ratios
from ._arguments import shown

if TYPE_CHECKING:
    from .. import Drawing

__all__ = ["FIGURES"]


def kepler(style: str = "screen", eccentricity: float | None = None) -> Drawing:
    """Kepler (1604): as the ellipse becomes a parabola its second focus goes blind."""
    from .. import plane

    d = plane((-3.6, 12.4), (-4.2, 4.8), style)
    values = [0.0, 0.6, 0.82, 1.0, 1.35] if eccentricity is None else [eccentricity]
    for e in values:
        a = conic_by_focus([0, 0], [-1, 0], 1.4, e)
        kind = "curve" if e == 1 else "second" if e > 1 else "line"
        d.conic(a, kind, **({"linewidth": 1.6} if kind == "line" else {}))
        found = conic_elements(a)
        far = max(found.foci, key=lambda f: np.inf if is_ideal(f) else abs(f[0] / f[2]))
        if is_ideal(far):
            d.point([1, 0, 0], "blind focus: ideal", (-14, 12))
        elif abs(far[0] / far[2]) > 1e-6 and d.window.x0 < far[0] / far[2] < d.window.x1:
            d.point(far, f"$e={shown(e)}$", (0, -12), kind="second point")
    d.line([0, 1, 0], kind="thin")
    d.point([0, 0], "$F$", (8, 10), markersize=8.0)
    if eccentricity is None:
        text = "Thick: the parabola, $e=1$. Dashed: a hyperbola, $e=1.35$."
    else:
        e = eccentricity
        kind = "circle" if e == 0 else "ellipse" if e < 1 else "parabola"
        text = f"Eccentricity $e = {shown(e)}$: {'hyperbola' if e > 1 else kind}."
    d.title(f"One focus $F$ stays; the other goes to infinity as $e \\to 1$.\n{text}")
    return d


def pole_and_polar(style: str = "screen", x: float = 4.6, y: float = 1.7) -> Drawing:
    """Pole and polar: conjugate points are harmonic to the points of the conic."""
    from .. import plane

    d = plane((-4.2, 6.2), (-2.5, 3.35), style)
    a = np.diag([1 / 9.0, 1 / 4.2, -1.0])
    p = point([x, y])
    if not p @ a @ p > 0:
        raise GeometryError.expected("x, y", "a point outside of the ellipse", f"{x:g}, {y:g}")
    line = polar(a, p)
    d.conic(a)
    d.line(line, kind="tangent")
    ends = line_intersections(a, line)
    for z in ends:
        d.line(p, z, "construction")
        d.point(z, kind="second point")
    for way in ([-1.0, -0.16, 0], [-1.0, -0.52, 0]):
        secant = np.cross(p, way)
        four = line_intersections(a, secant)
        if len(four) != 2:
            continue
        other = meet(secant, line)
        d.line(secant)
        d.points(four, kind="second point", markersize=5.0)
        d.point(other, None, (6, 8))
        value = float(cross_ratio(four[0], p, other, four[1]))
        d.label(other, f"$q$,  $\\mathrm{{cr}}={value:.0f}$", (9, -9), fontsize=11.5)
    d.point(p, "$p$", (8, 8), markersize=8.0)
    d.title("The polar of $p$ holds its conjugate points $q$, harmonic on every secant.")
    return d


def reciprocal(style: str = "screen", weight: float = 1.0) -> Drawing:
    """Poncelet (1822): a curve and its polar reciprocal by a circle."""
    from .. import plane

    d = plane((-3.4, 3.4), (-1.35, 2.475), style)
    polarity = Polarity(np.diag([1.0, 1, -1]))
    curve = BezierCurve.from_points(
        [[-1.5, 0.4], [-0.7, 1.75], [1.1, 1.5], [1.3, 0.3]], [1, weight, 1, 1]
    )
    d.conic(polarity.matrix, "thin", linewidth=1.3)
    image = polarity.reciprocal_curve(curve)
    for t in np.linspace(0, 1, 11):
        d.line(polarity.polar(curve.evaluate(t)), kind="thin")
    d.curve(curve)
    d.curve(image, "second")
    at = 0.32
    d.line(curve.tangent(at), kind="tangent")
    d.point(curve.evaluate(at), "$p$", (0, 10), markersize=8.0)
    d.line(polarity.polar(curve.evaluate(at)), kind="tangent")
    d.point(image.evaluate(at), "$p'$", (9, -9), markersize=8.0, kind="second point")
    d.title("The polars of a curve's points envelop its reciprocal; and the other way round.")
    return d


def conics_by_weight(style: str = "screen", weight: float | None = None) -> Drawing:
    """One weight makes all conics: ellipse, parabola, hyperbola, and the line."""
    from .. import plane

    d = plane((-3.7, 3.7), (-1.62, 2.54), style)
    x = [[-1.25, 0], [0, 1.75], [1.25, 0]]
    values = [2.5, 1.0, 0.5, 0.2, 0.0, -0.3, -1.0] if weight is None else [weight]
    for w in values:
        net = point(x, 1.0)
        net[1] *= w
        arc = BezierCurve(net)
        if w == 0:
            d.curve(arc, "construction")
        else:
            d.curve(arc, "curve" if w > 0 else "third")
            if weight is not None or w in (0.5, 2.5):
                d.curve(BezierCurve(net * [[1], [-1], [1]]), "thin", linewidth=1.0)
        h = arc.evaluate(0.5)
        if abs(h[2]) > 1e-9 and d.window.y0 < h[1] / h[2] < d.window.y1:
            d.label(h, f"$w={shown(w)}$", (0, 5), fontsize=11.5)
    d.polyline(x, "polygon")
    for y, name, way in zip(x, ("$b_0$", "$b_1$", "$b_2$"), ((-10, -6), (12, 2), (10, -6))):
        d.point(y, name, way)
    if weight is not None:
        kind = "ellipse" if abs(weight) < 1 else "hyperbola"
        kind = "parabola" if abs(abs(weight) - 1) < 1e-6 else kind
        if abs(weight) > 1e4:
            kind = "two lines"
        text = f"The middle weight $w = {shown(weight)}$: " + ("line" if weight == 0 else kind)
        if weight < 0:
            text += ", its complementary arc"
        d.title(text + ".\nThin: the rest of the conic.")
        return d
    d.title(
        "The middle weight $w$: $w<1$ ellipse, $w=1$ parabola, $w>1$ hyperbola, $w=0$ line,\n"
        "$w<0$ the complementary arc (thin, for 0.5 and 2.5; for $-1$ through infinity)."
    )
    return d


def three_tangents(style: str = "screen", s: float = 0.36) -> Drawing:
    """Figure 1: three tangents of a parabola cut each other in equal ratios."""
    from .. import plane

    d = plane((-0.9, 5.7), (-0.7, 3.0125), style)
    arc = BezierCurve.from_points([[0, 0], [1.7, 2.5], [4.8, 0.5]])
    a, b, c = arc.evaluate([0.0, s, 1.0])
    ta, tb, tc = arc.tangent([0.0, s, 1.0])
    e, f, top = meet(ta, tb), meet(tb, tc), meet(ta, tc)
    for line in (ta, tb, tc):
        d.line(line, kind="thin")
    d.segment(a, top, "polygon")
    d.segment(top, c, "polygon")
    d.segment(e, f, "tangent")
    d.curve(arc)
    for x, name, way in (
        (a, "$a$", (-9, -9)), (b, "$b$", (4, -13)), (c, "$c$", (9, -7)),
    ):  # fmt: skip
        d.point(x, name, way, markersize=8.0)
    for x, name, way in ((top, "$d$", (0, 10)), (e, "$e$", (-10, 4)), (f, "$f$", (9, 8))):
        d.point(x, name, way, kind="second point")
    r = three_tangent_ratios(arc, 0.0, s, 1.0)
    d.title(
        "$|ae|:|ed| = |eb|:|bf| = |df|:|fc| = "
        f"{r[0]:.4f}$" + ("" if np.ptp(r) < 1e-9 else f", {r[1]:.4f}, {r[2]:.4f}")
    )
    return d


def four_tangents(style: str = "screen", moving: float = 0.55) -> Drawing:
    """Four tangents of a conic cut every other one in the same cross ratio."""
    from .. import plane

    d = plane((-4.0, 6.0), (-1.6, 4.025), style)
    arc = BezierCurve.from_points([[-1.6, 0], [0.4, 3.0], [2.7, 0.2]], [1, 0.75, 1])
    d.conic(conic_matrix(arc), "curve")
    fixed = [-0.35, 0.12, 0.85, 1.6]
    tangents = arc.tangent(np.array(fixed))
    for line in tangents:
        d.line(line, kind="polygon")
    values = []
    for at, look, marks in ((moving, "tangent", "point"), (0.3, "construction", "second point")):
        own = arc.tangent(at)
        d.line(own, kind=look)
        p = np.stack([meet(own, line) for line in tangents])
        for x in p:
            if not is_ideal(x):
                d.point(x, kind=marks)
        values.append(float(cross_ratio(*p)))
    d.title(
        f"Cross ratio on the red tangent: {values[0]:.4f}; on the dashed one: {values[1]:.4f}."
        if style == "screen"
        else f"Cross ratio on the first tangent: {values[0]:.4f}; on the dashed: {values[1]:.4f}."
    )
    return d


def foci(style: str = "screen", eccentricity: float = 0.62) -> Drawing:
    """What a conic has: centre, foci, directrices, axes, vertices."""
    from .. import plane

    d = plane((-5.4, 5.4), (-3.0, 3.07), style)
    a = conic_by_focus([0.0, 0.0], [-1, 0.12], 1.25, eccentricity)
    found = conic_elements(a)
    shift = np.eye(3)
    if not is_ideal(found.center):
        shift[:2, 2] = affine(found.center)  # the drawing is about the centre
    a = shift.T @ a @ shift
    found = conic_elements(a)
    for line in found.axes:
        d.line(line, kind="thin")
    for line in found.directrices:
        d.line(line, kind="ideal")
    if found.asymptotes is not None:
        for line in found.asymptotes:
            d.line(line, kind="construction")
    d.conic(a)
    for x, name in zip(found.foci, ("$F_1$", "$F_2$")):
        d.point(x, name, (6, 9))
    d.points(found.vertices, kind="second point")
    if found.co_vertices is not None:
        d.points(found.co_vertices, kind="second point")
    d.point(found.center, "$C$", (8, 8))
    d.title(
        "Directrices (dash-dotted) are the polars of the foci; the centre is the ideal line's pole."
    )
    return d


FIGURES = {
    "kepler": kepler,
    "foci": foci,
    "pole_and_polar": pole_and_polar,
    "reciprocal": reciprocal,
    "three_tangents": three_tangents,
    "four_tangents": four_tangents,
    "conics_by_weight": conics_by_weight,
}
