"""Central projection, ideal elements, the theorems of Desargues, Menelaus and Ceva."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...geometry.camera import Camera, look_at
from ...geometry.collineations import collineation
from ...geometry.cross_ratio import cross_ratio
from ...geometry.ideal_elements import Perspectivity
from ...geometry.projective import affine, join, line_points, meet, point
from ...geometry.theorems import (
    ceva,
    ceva_points,
    desargues,
    harmonic_conjugate,
    menelaus,
    menelaus_points,
)

if TYPE_CHECKING:
    from .. import Drawing

__all__ = ["FIGURES"]


def vanishing_point(style: str = "screen", pitch: float = -3.0, turn: float = 6.0) -> Drawing:
    """Parallel rails meet in their vanishing point V, on the horizon of the ground."""
    from .. import space

    a, b = np.radians([turn, pitch])
    eye = np.array([0.6, -4.5, 2.0])
    way = [np.sin(-a) * np.cos(b), np.cos(a) * np.cos(b), np.sin(b)]
    camera = Camera(look_at(eye, eye + way, [0, 0, 1]), fov=60, film_size=(1600, 900))
    d = space(camera, style)
    rail = np.array([0, 1.0, 0, 0])
    for y in np.concatenate([np.arange(-3, 12, 0.9), np.arange(12, 60, 3.0)]):
        d.segment([-1.3, y, 0], [1.3, y, 0], "thin")
    for x in (-0.72, 0.72):
        d.segment([x, -8, 0, 1], rail, "curve")
    for x, z in ((-3.2, 0), (3.4, 0), (-3.2, 3.6), (3.4, 3.6)):
        d.segment([x, -8, z, 1], rail, "line")
    for x in (-3.2, 3.4):
        for y in np.append(np.arange(-2, 30, 4.0), [40, 60, 90]):
            d.segment([x, y, 0], [x, y, 3.6], "line")
    ground = np.array([0, 0, 1.0, 0])
    horizon = camera.horizon(ground)
    _film_line(d, horizon, "horizon", "ideal")
    v = camera.vanishing_point(rail[:3])
    if abs(v[2]) > 1e-9:
        _film_point(d, v[:2] / v[2], "$V$", (12, 12))
    d.title("Parallels have one ideal point; its image is their vanishing point $V$.")
    return d


def _film_line(d: Drawing, line: np.ndarray, text: str, kind: str) -> None:
    """Draw a line of the film, given by its coordinates, in a drawing of space."""
    w = d.window.grown(0.05)
    n = line / np.hypot(*line[:2])
    foot = w.middle - (n[:2] @ w.middle + n[2]) * n[:2]
    way = np.array([n[1], -n[0]]) * np.sign(n[1] if n[1] else 1.0)
    ends = np.stack([foot - 2 * w.size.max() * way, foot + 2 * w.size.max() * way])
    from ..sampling import _clipped

    for piece in _clipped(ends, w):
        d._stroke([piece], kind)
        d._write(0.86 * piece[0] + 0.14 * piece[-1], text, (0, 8))


def _film_point(d: Drawing, x: Any, text: str, offset: tuple[float, float]) -> None:
    from ..styles import role

    d.axes.plot(*x, marker="o", linestyle="none", **role("point", d.style, markersize=9.0))
    d._write(np.asarray(x), text, offset, fontsize=18.0)


def completed_planes(style: str = "screen", height: float = 2.2) -> Drawing:
    """Two completed planes, one to one: the vanishing line goes to the ideal line."""
    from .. import space

    eye = np.array([0, -2.4, height, 1])
    view = Perspectivity(eye, [0, 0, 1, 0], [0, 1, 0, 0])
    camera = Camera(look_at([9.5, -8.6, 5.2], [-0.35, -0.75, 1.1], [0, 0, 1]), 40, "x", (1600, 900))
    d = space(camera, style)
    d.plane([[-2, -3.6, 0], [2, -3.6, 0], [2, 3.2, 0], [-2, 3.2, 0]], grey=0.9)
    d.plane([[-2, 0, 0], [2, 0, 0], [2, 0, 2.8], [-2, 0, 2.8]], grey=0.8, opacity=0.45)
    # three parallels of the ground and their images
    for x in (-1.2, 0.0, 1.2):
        d.segment([x, -3.6, 0], [x, 3.2, 0], "line")
        start, far = view.image([x, 0, 0, 1]), view.image([0, 1, 0, 0])
        d.segment(start, far, "second", linewidth=1.8)
    for x in (-1.2, 1.2):
        near = affine(view.image([x, 2.4, 0, 1]))
        d.segment([x, 2.4, 0], near, "thin")
        d.segment(near, eye, "thin")
        d.point([x, 2.4, 0], kind="second point")
        d.point(near, kind="second point")
    d.segment([-2, 0, 0], [2, 0, 0], "curve")
    d.label([2, 0, 0], "axis: fixed points", (10, -4))
    horizon = affine(view.image([0, 1, 0, 0]))
    d.segment([-2, 0, horizon[2]], [2, 0, horizon[2]], "ideal")
    d.label([2, 0, horizon[2]], "horizon: image\nof the ideal line", (10, 2))
    y = float(affine(line_points(view.vanishing_line)[0])[1])
    d.segment([-2, y, 0], [2, y, 0], "ideal")
    d.label([-2, y, 0], "vanishing line:\nits image is ideal", (-8, 8))
    d.segment(eye, affine(view.image([0, 1, 0, 0])), "construction")
    d.segment(eye, [0, y, 0], "construction")
    d.point(eye, "$S$", (-14, 8), markersize=8.0)
    d.point(horizon, "$V$", (8, 8))
    d.title("Projection from $S$ maps a completed plane onto another, without any exception.")
    return d


def four_points(style: str = "screen", tilt: float = 24.0) -> Drawing:
    """Four points and their images have the same cross ratio."""
    from .. import plane

    d = plane((-5.6, 5.6), (-1.2, 5.1), style)
    a = np.radians(tilt)
    first = point([[-4.2, 0.2], [-2.2, 0.2], [0.9, 0.2], [4.4, 0.2]])
    eye = point([0.4, 4.4])
    second = join(point([0, 2.1]), [np.cos(a), np.sin(a), 0])
    image = np.stack([meet(join(eye, x), second) for x in first])
    d.line(join(first[0], first[3]))
    d.line(second)
    for x in first:
        d.segment(eye, x, "construction")
    d.point(eye, "$S$", (10, 6), markersize=8.0)
    d.points(first, ["$a$", "$b$", "$c$", "$d$"], offset=(2, -10))
    d.points(image, ["$a'$", "$b'$", "$c'$", "$d'$"], offset=(10, -6), kind="second point")
    one, two = float(cross_ratio(*first)), float(cross_ratio(*image))
    d.title(f"$\\mathrm{{cr}}(a,b,c,d) = {one:.4f}$\n$\\mathrm{{cr}}(a',b',c',d') = {two:.4f}$")
    return d


def desargues_theorem(style: str = "screen", stretch: float = 0.55) -> Drawing:
    """Triangles in perspective from a point S are so from a line: Desargues (1639)."""
    from .. import plane

    d = plane((-5.2, 5.9), (-3.0, 3.24), style)
    s = np.array([-4.3, 1.5])
    a = np.array([[-2.59, -0.18], [-0.45, 0.35], [-0.42, -0.7]])
    b = s + (a - s) * (np.array([1.982, 1.272, 1.531]) + (stretch - 0.55))[:, None]
    found = desargues(point(a), point(b))
    for y in b:
        d.segment(s, s + 1.12 * (y - s), "construction")
    assert found.meets is not None and found.axis is not None
    for k, z in enumerate(found.meets):
        i, j = (k + 1) % 3, (k + 2) % 3
        for t in (a, b):
            d.line(point(t[i]), point(t[j]), "thin")
        d.point(z, f"${'PQR'[k]}$", (9, 7), kind="second point")
    d.line(found.axis, kind="ideal")
    for t, look, grey in ((a, "curve", 0.8), (b, "second", 0.9)):
        d.fill(t, grey)
        d.polyline(t, look, closed=True)
    for t, names in ((a, ("$A$", "$B$", "$C$")), (b, ("$A'$", "$B'$", "$C'$"))):
        for x, name, way in zip(t, names, ((-9, -7), (8, 8), (8, -9))):
            d.point(x, name, way)
    d.point(s, "$S$", (-4, 10), markersize=8.0)
    d.title("Lines $AA'$, $BB'$, $CC'$ meet in $S$: corresponding sides meet on one line.")
    return d


def _title_of_ratios(d: Drawing, ratios: list[str], product: float) -> None:
    """Say in the title what the ratios on the sides of a triangle are, and their product."""
    d.title(
        r"$\frac{|ap|}{|pb|}\cdot\frac{|bq|}{|qc|}\cdot\frac{|cr|}{|ra|} = "
        + r" \cdot ".join(ratios)
        + f" = {product:.3f}$"
    )


def menelaus_theorem(style: str = "screen", slope: float = 0.32) -> Drawing:
    """Menelaus: three points of the sides are on a line if the ratios' product is -1."""
    from .. import plane

    d = plane((-2.9, 6.9), (-1.5, 4.01), style)
    t = point([[0, 0], [5.0, -0.4], [2.6, 2.9]])
    line = join(point([-2.1, 0.15]), [1.0, slope, 0.0])
    p = menelaus_points(t, line)
    found = menelaus(t, p)
    for k in range(3):
        d.line(t[k], t[(k + 1) % 3], "thin")
    d.fill(affine(t), 0.92)
    d.polyline(t, "curve", closed=True)
    d.line(line, kind="tangent")
    for x, name, way in zip(t, ("$a$", "$b$", "$c$"), ((0, -9), (0, -9), (12, 2))):
        d.point(x, name, way)
    for x, name, way in zip(p, ("$p$", "$q$", "$r$"), ((0, -10), (6, 10), (-6, 10))):
        d.point(x, name, way, kind="second point")
    _title_of_ratios(d, [f"({x:.3f})" for x in found.ratios], found.product)
    return d


def ceva_theorem(style: str = "screen", u: float = 0.3, v: float = 0.32) -> Drawing:
    """Ceva: lines to the opposite corners meet in a point if the ratios' product is 1."""
    from .. import plane

    d = plane((-1.3, 7.1), (-1.0, 3.72), style)
    t = point([[0.2, 0], [5.6, -0.3], [2.6, 3.0]])
    inner = np.array([u, v, 1 - u - v]) @ t
    q = ceva_points(t, inner)
    found = ceva(t, q)
    d.fill(affine(t), 0.92)
    d.polyline(t, "curve", closed=True)
    for k in range(3):
        d.segment(t[(k + 2) % 3], q[k], "tangent")
    for x, name, way in zip(t, ("$a$", "$b$", "$c$"), ((-9, -7), (9, -7), (12, 4))):
        d.point(x, name, way)
    for x, name, way in zip(q, ("$p$", "$q$", "$r$"), ((0, -10), (9, 7), (-9, 7))):
        d.point(x, name, way, kind="second point")
    d.point(inner, "$s$", (10, 4))
    _title_of_ratios(d, [f"{x:.3f}" for x in found.ratios], found.product)
    return d


def harmonic_points(style: str = "screen", c: float = 0.68, height: float = 2.6) -> Drawing:
    """Four harmonic points by the complete quadrangle: with a straightedge alone."""
    from .. import plane

    d = plane((-0.8, 10.4), (-1.1, 5.2), style)
    a, b, at = point([0, 0]), point([5, 0]), point([5 * c, 0])
    apex = point([1.1, height + 1.4])
    p = at + 0.75 * apex
    on_a, on_b = meet(join(a, p), join(apex, b)), meet(join(b, p), join(apex, a))
    fourth = harmonic_conjugate(a, b, at)
    d.line(a, b, "line")
    for x, y in ((apex, a), (apex, b), (apex, at), (a, on_a), (b, on_b)):
        d.segment(x, y, "construction")
    d.line(on_a, on_b, "tangent")
    d.point(apex, "$s$", (10, 4))
    for x in (p, on_a, on_b):
        d.point(x, kind="second point")
    for x, name in ((a, "$a$"), (at, "$c$"), (b, "$b$"), (fourth, "$d$")):
        d.point(x, name, (0, -10), markersize=8.0)
    d.title("$\\mathrm{cr}(a, c, d, b) = -1$, whatever the point $s$ and the line through $c$.")
    return d


def photograph(style: str = "screen", x: float = 0.5, y: float = 0.5) -> Drawing:
    """Four pairs of points determine a collineation: a chessboard seen aslant."""
    from .. import plane

    d = plane((-1.5, 12.5), (-1.1, 6.775), style)
    square = point([[0, 0], [4, 0], [4, 4], [0, 4]])
    target = point([[6.2, 0.4], [11.6, 0.9], [10.4, 4.6], [7.6, 3.7]])
    m = collineation(square, target)
    for k in range(5):
        for line in ([[k, 0], [k, 4]], [[0, k], [4, k]]):
            p = point(line)
            look = "curve" if k in (0, 4) else "line"
            for ends in (p, p @ m.T):
                d.segment(ends[0], ends[1], look)
    for a, b in ((0, 2), (1, 3)):
        for p in (square, square @ m.T):
            d.segment(p[a], p[b], "construction")
    d.points(square, ["1", "2", "3", "4"], offset=(-8, -8))
    d.points(square @ m.T, ["1'", "2'", "3'", "4'"], offset=(9, -7), kind="second point")
    own = point([4 * x, 4 * y])
    d.point(own, "$p$", (10, -8), markersize=8.0)
    d.point(m @ own, "$p'$", (10, -8), markersize=8.0)
    d.title("Four pairs of points determine the image of every other point.")
    return d


FIGURES = {
    "vanishing_point": vanishing_point,
    "completed_planes": completed_planes,
    "four_points": four_points,
    "photograph": photograph,
    "desargues": desargues_theorem,
    "harmonic": harmonic_points,
    "menelaus": menelaus_theorem,
    "ceva": ceva_theorem,
}
