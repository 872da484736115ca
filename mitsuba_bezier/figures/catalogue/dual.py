"""Dual curves: control lines and planes, osculating planes, developable surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...geometry.camera import Camera, look_at
from ...geometry.curves import BezierCurve
from ...geometry.developable import DevelopableSurface
from ...geometry.duality import DualBezierCurve
from ...geometry.projective import affine
from ...geometry.unrolling import strip, strip_faces, unrolled
from ._arguments import few, shown

if TYPE_CHECKING:
    from .. import Drawing

__all__ = ["FIGURES"]

#: Control planes of a ribbon between z = 0 and z = 1.
PLANES = ((1, 0, 0.2, -1), (0.8, 0.8, -0.3, -1), (0, 1, 0.1, -1.1), (-0.9, 0.6, 0, -1))
BOTTOM, TOP = (0.0, 0, 1, 0), (0.0, 0, 1, -1)


def dual_curve(style: str = "screen", t: float = 0.42) -> Drawing:
    """A dual curve: control lines define a curve of lines, and its envelope."""
    from .. import plane

    d = plane((-3.6, 3.6), (-1.05, 3.0), style)
    # tangents of about a circle, turned by 45 degrees from one to the next
    angle = np.radians([200, 130, 50, -20])
    u = np.stack([np.cos(angle), np.sin(angle), [-1.15, -1.0, -1.0, -1.15]], axis=1)
    lines = DualBezierCurve(u)
    d.dual_curve(lines, 21)
    scheme = lines.de_casteljau(t)
    for line in scheme[-2]:
        d.line(line, kind="construction")
    d.line(scheme[-1][0], kind="tangent")
    d.point(lines.contact(t), f"$p({shown(t)})$", (8, 10), markersize=8.0)
    d.title(
        "Control lines $U_i$ in place of points: the last two lines (dashed)\n"
        "of de Casteljau's scheme meet where the line at $t$ touches the envelope."
    )
    return d


def _ribbon_camera() -> Camera:
    return Camera(look_at([5.2, 4.2, 2.6], [0.35, 0.95, 0.55], [0, 0, 1]), 34, "x", (1600, 900))


def control_planes(style: str = "screen", t: float = 0.5) -> Drawing:
    """Control planes: a curve of planes, its tangent plane, ruling, and line of contact."""
    from .. import space

    d = space(_ribbon_camera(), style)
    ribbon = DevelopableSurface(PLANES)
    bottom, top = ribbon.trace(BOTTOM), ribbon.trace(TOP)
    for k, (plane, grey) in enumerate(zip(PLANES, (0.93, 0.87, 0.81, 0.75))):
        corners = _piece(np.array(plane, dtype=np.float64))
        d.plane(corners, f"$U_{k}$", grey, 0.5)
    own = ribbon.tangent_plane(t)
    corners = _piece(own, 0.75, affine(bottom.evaluate(t)))
    d.fill(corners, 0.6, alpha=0.45)
    d.polyline(corners, "tangent", closed=True)
    for s in np.linspace(0, 1, 13):
        d.segment(bottom.evaluate(s), top.evaluate(s), "thin")
    d.curve(bottom)
    d.curve(top)
    d.segment(bottom.evaluate(t), top.evaluate(t), "tangent", linewidth=2.6)
    d.title("Planes $U_i$ define a curve of planes: each touches its envelope along a ruling.")
    return d


def _piece(plane: np.ndarray, half: float = 0.8, about: np.ndarray | None = None) -> np.ndarray:
    """Return a piece of a steep plane between z = 0 and z = 1, beside the z axis."""
    along = np.array([-plane[1], plane[0], 0.0])
    along /= np.linalg.norm(along)
    out = []
    for z, s in ((0, -1), (0, 1), (1, 1), (1, -1)):
        if about is None:
            n = plane[:2]
            foot = -(plane[2] * z + plane[3]) * n / (n @ n)
            x = np.array([*foot, z])
        else:
            n = plane[:2]
            x = np.array([*about[:2], z])
            x[:2] -= (plane[:3] @ x + plane[3]) * n / (n @ n)
        out.append(x + s * half * along)
    return np.array(out)


def osculating_planes(style: str = "screen", t: float = 0.45) -> Drawing:
    """Osculating planes of a space curve: its dual curve."""
    from .. import space

    camera = Camera(look_at([2.6, -6.0, 4.2], [0.0, 0.15, 0.65], [0, 0, 1]), 46, "x", (1600, 900))
    d = space(camera, style)
    curve = BezierCurve.from_points(
        [[1.0, -1.0, 0], [1.6, 1.5, 0.2], [-1.6, 1.5, 1.0], [-1.0, -1.0, 1.5]]
    )
    d.polyline(affine(curve.control_points), "polygon")
    for s in (0.12, t, 0.85):
        x, v, a = curve.affine_derivatives(s, 2)
        e1 = v / np.linalg.norm(v)
        e2 = a - (a @ e1) * e1
        e2 /= np.linalg.norm(e2)
        corners = [x + 0.62 * (i * e1 + j * e2) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        d.plane(corners, grey=0.78 if s == t else 0.9, opacity=0.55)
        d.segment(x - 0.62 * e1, x + 0.62 * e1, "tangent")
        d.point(x, markersize=7.0)
    d.curve(curve)
    d.points(curve.control_points, "$b_{}$", kind="second point")
    d.title("Three consecutive points span the osculating plane; the planes are the dual curve.")
    return d


def developable(style: str = "screen", rulings: int = 17) -> Drawing:
    """A developable: rulings are the tangents of the curve of regression."""
    from .. import space

    camera = Camera(look_at([6.6, 4.4, 2.6], [0.1, 0.6, 0.55], [0, 0, 1]), 36, "x", (1600, 900))
    d = space(camera, style)
    ribbon = DevelopableSurface(PLANES)
    bottom, top = ribbon.trace(BOTTOM), ribbon.trace(TOP)
    d.surface(ribbon.patch(BOTTOM, TOP), 40)
    edge = ribbon.regression_curve()
    for s in np.linspace(0, 1, few("rulings", rulings, 2, 200)):
        d.segment(bottom.evaluate(s), top.evaluate(s), "line", linewidth=0.9)
        r = edge.evaluate(s)
        if abs(r[3]) > 1e-9 * np.linalg.norm(r):
            x = affine(r)
            low, high = affine(bottom.evaluate(s)), affine(top.evaluate(s))
            near = low if np.linalg.norm(x - low) < np.linalg.norm(x - high) else high
            if np.linalg.norm(x - near) < 6:
                d.segment(near, x, "thin", linestyle=(0, (2, 2)))
    d.curve(bottom)
    d.curve(top)
    d.curve(edge, "second")
    d.title("The ribbon between two planes, its rulings, and the curve of regression (dashed).")
    return d


def unrolling(style: str = "screen", bend: float = 0.45) -> Drawing:
    """A developable unrolls: lengths and areas stay as it bends into the plane."""
    from .. import space

    camera = Camera(look_at([5.2, 5.4, 3.6], [0.3, 0.86, 0.42], [0, 0, 1]), 23, "x", (1600, 900))
    d = space(camera, style)
    x = strip(DevelopableSurface(PLANES), BOTTOM, TOP, 61)
    y = unrolled(x, bend)
    for points, look in ((unrolled(x, 0.0), "hidden"), (y, "curve")):
        for side in (points[::2], points[1::2]):
            d._stroke([d.place(side)], look)
    for k in range(0, 122, 6):
        d.segment(y[k], y[k + 1], "line", linewidth=0.9)
    d.segment(y[0], y[1], "line")
    d.segment(y[-2], y[-1], "line")
    corners = y[strip_faces(len(y))]
    area = (
        np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()
        / 2
    )
    length = np.linalg.norm(np.diff(y[::2], axis=0), axis=1).sum()
    for face in corners[::2]:
        d.fill(face, 0.85, alpha=0.6)
    d.title(
        f"Angles between rulings bent to {100 * bend:.0f} %: area {area:.4f}, "
        f"lower side {length:.4f}, as ever.\nDotted: unrolled into a plane."
    )
    return d


FIGURES = {
    "dual_curve": dual_curve,
    "control_planes": control_planes,
    "osculating_planes": osculating_planes,
    "developable": developable,
    "unrolling": unrolling,
}
