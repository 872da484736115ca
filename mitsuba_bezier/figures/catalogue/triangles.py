"""Bézier triangles: net, de Casteljau, polynomial, rational, and to infinity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...geometry import bernstein
from ...geometry.camera import Camera, look_at
from ...geometry.projective import point
from ...geometry.triangles import BezierTriangles
from ._arguments import few, shown

if TYPE_CHECKING:
    from .. import Drawing

__all__ = ["FIGURES"]


def _camera(eye: Any = (1.4, -4.6, 2.9), at: Any = (0.0, 0.0, 0.52), fov: float = 40) -> Camera:
    return Camera(look_at(eye, at, [0, 0, 1]), fov, "x", (1600, 900))


def _cubic(weights: Any = 1.0) -> BezierTriangles:
    """Return a cubic patch over an equilateral triangle, its net raised as a hill."""
    corners = np.array([[0, 1.15, 0], [-1.15, -0.75, 0], [1.15, -0.75, 0]])
    rows = bernstein.multi_indices(3)
    x = rows / 3 @ corners
    x[:, 2] = [0.25, 0.7, 0.55, 0.65, 1.15, 0.55, 0.1, 0.6, 0.7, 0.25]
    return BezierTriangles(point(x, np.broadcast_to(weights, len(x))))


def triangle_net(style: str = "screen") -> Drawing:
    """A cubic Bézier triangle and its control net, ten points by three indices."""
    from .. import space

    d = space(_camera(), style)
    patch = _cubic()
    d.surface(patch, 40)
    d.isolines(patch, 3)
    d.boundary(patch)
    d.net(patch, labels=True, markersize=5.0)
    d.title("Control points $b_{ijk}$, $i+j+k=3$: the patch touches the net in its three corners.")
    return d


def triangle_decasteljau(style: str = "screen", u: float = 0.3, v: float = 0.3) -> Drawing:
    """De Casteljau over the triangle: every small triangle of the net, divided alike."""
    from .. import space

    d = space(_camera(), style)
    patch = _cubic()
    d.surface(patch, 40, opacity=0.9)
    d.boundary(patch, linewidth=1.6)
    scheme = patch.de_casteljau(0, (u, v))
    looks = ("polygon", "construction", "tangent")
    for level, look in zip(scheme[:-1], looks):
        n = bernstein.degree_of(len(level))
        for rows in bernstein.net_triangles(n).tolist():
            if look == "tangent":
                d.fill(level[rows], 0.55, alpha=0.55)
            d.polyline(level[rows], look, closed=True)
        d.points(level, markersize=4.5, kind="point" if look == "polygon" else "second point")
    d.point(scheme[-1][0], "$b(U)$", (10, 8), markersize=9.0)
    d.title(
        "Three steps with the same $U = (u, v, w)$; the last triangle lies in the tangent plane."
    )
    return d


def polynomial_triangle(style: str = "screen") -> Drawing:
    """A polynomial quadratic triangle: its boundary curves are parabolas."""
    from .. import space

    x = np.array(
        [[0, 1.2, 0.5], [-0.75, 0.3, 1.1], [0.8, 0.3, 0.5], [-1.3, -0.8, 0.1], [0.1, -0.9, 1.0],
         [1.3, -0.8, 0.1]]
    )  # fmt: skip
    patch = BezierTriangles(point(x))
    d = space(_camera(), style)
    d.surface(patch, 40)
    d.isolines(patch, 4)
    d.boundary(patch)
    d.net(patch, labels=True)
    d.title("All weights are equal: the boundary curves are three parabolas.")
    return d


def rational_triangle(style: str = "screen", weight: float | None = None) -> Drawing:
    """A rational triangle: one net, one weight, three surfaces."""
    from .. import space

    x = np.array(
        [[0, 1.2, 0.5], [-0.75, 0.3, 0.9], [0.75, 0.3, 0.6], [-1.2, -0.8, 0.1], [0, -0.9, 1.5],
         [1.2, -0.8, 0.1]]
    )  # fmt: skip
    values = [0.15, 1.0, 6.0] if weight is None else [weight]
    d = space(_camera((0, -9.0, 6.0), (0, 0.0, 0.55), 56 if weight is None else 22), style)
    for k, w in enumerate(values):
        shift = np.array([3.05 * (k - (len(values) - 1) / 2), 0, 0])
        weights = np.array([1, 1, 1, 1, w, 1.0])
        patch = BezierTriangles(point(x + shift, weights))
        d.surface(patch, 32)
        d.isolines(patch, 3)
        d.boundary(patch)
        d.net(patch)
        d.point(x[4] + shift, f"$w = {shown(w)}$", (0, 9))
    d.title("The weight of one control point of a quadratic triangle pulls the surface towards it.")
    return d


def projective_triangle(style: str = "screen", height: float = 1.7) -> Drawing:
    """Control points at infinity: a patch with two control vectors ends at the horizon."""
    from .. import space

    camera = Camera(look_at([0.3, -6.5, height], [0.3, 4, 0.6], [0, 0, 1]), 75, "x", (1600, 900))
    d = space(camera, style)
    corner = np.array([0.2, -2.6, 0, 1.0])
    left, right = np.array([-0.9, 2.0, 0, 0]), np.array([1.0, 1.9, 0, 0])
    patch = BezierTriangles([left, right, corner])
    for s in np.linspace(0, 1, 9):
        d.segment(corner, (1 - s) * left + s * right, "curve" if s in (0, 1) else "thin")
    for s in (0.25, 0.45, 0.6, 0.7, 0.78, 0.84, 0.89, 0.93, 0.96):
        ends = patch.evaluate(0, [[s, 0.0], [0.0, s]])
        d.segment(ends[0], ends[1], "thin")
    horizon = [camera.vanishing_point(v[:3]) for v in (left, right)]
    x = [h[:2] / h[2] for h in horizon]
    d._stroke([np.array(x)], "ideal", linewidth=2.6)
    for p, name, way in zip(x, ("$b_{100}$ ideal", "$b_{010}$ ideal"), ((-4, 9), (4, 9))):
        d.axes.plot(*p, "o", color="white", markeredgecolor="black", markersize=7, zorder=7)
        d._write(p, name, way)
    d.point(corner, "$b_{001}$", (10, -8), markersize=8.0)
    d.title(
        "A linear patch with two control vectors is a quarter of a plane; its third side is ideal."
    )
    return d


def bernstein_triangle(style: str = "screen", n: int = 2) -> Drawing:
    """Bernstein polynomials of three variables over the triangle."""
    from .. import space

    n = few("n", n, 1, 4)
    rows = bernstein.multi_indices(n)
    base = np.array([[0, 1.0, 0], [-1.0, -0.7, 0], [1.0, -0.7, 0]])
    d = space(_camera((0, -11.5, 8.4), (0, 0.1, 0.25), 42), style)
    x = rows / n @ base
    for k, (i, j, l) in enumerate(rows):
        column = k - (bernstein.row(n, i, n - i) + bernstein.row(n, i, 0)) / 2
        shift = np.array([2.45 * column, 2.15 * (i - (n - 1) / 2) + 0.1, 0])
        net = x.copy()
        net[:, 2] = np.eye(len(rows))[k] * 1.15
        patch = BezierTriangles(point(net + shift))
        d.polyline(base + shift, "thin", closed=True)
        d.surface(patch, 24)
        d.isolines(patch, 4)
        d.boundary(patch, linewidth=1.4)
        d.label(shift - np.array([0, 0.72, 0]), f"$B_{{{i}{j}{l}}}$", (0, -10))
    d.title(
        f"$B_{{ijk}} = {n}!/(i!\\,j!\\,k!)\\; u^i v^j w^k$: "
        "positive over the triangle, with the sum 1."
    )
    return d


FIGURES = {
    "bernstein_triangle": bernstein_triangle,
    "triangle_net": triangle_net,
    "triangle_decasteljau": triangle_decasteljau,
    "polynomial_triangle": polynomial_triangle,
    "rational_triangle": rational_triangle,
    "projective_triangle": projective_triangle,
}
