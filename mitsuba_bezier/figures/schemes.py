"""What a lecture draws: polygons, nets, schemes, dual curves, cross ratios, planes, quadrics."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry import bernstein
from ..geometry.cross_ratio import cross_ratio
from ..geometry.curves import BezierCurve
from ..geometry.duality import DualBezierCurve
from ..geometry.farin import cross_ratio_scheme
from ..geometry.isoparametric import isoparametric
from ..geometry.projective import is_ideal, norm, numbers
from ..geometry.quadrics import quadric_matrix
from ..geometry.triangles import BezierTriangles
from .drawing import Canvas

__all__ = ["Schemes"]

#: Parameters of the edges of a triangle, from corner to corner.
_CORNERS = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])


class Schemes(Canvas):
    """The constructions; each a few calls of `Canvas`."""

    # ------------------------------------------------------------------ curves

    def control_polygon(
        self, curve: BezierCurve, labels: str | None = "$b_{}$", **changes: Any
    ) -> None:
        """Draw the control polygon of a curve, its points numbered by `labels`.

        A leg to a control vector is a ray; the vector is marked at the edge.
        """
        net = curve.control_points
        for a, b in pairwise(net):
            if a.any() and b.any() and not (is_ideal(a) and is_ideal(b)):
                self._leg(a, b)
        used = net[net.any(axis=1)]
        self.points(used, labels, **changes)

    def _leg(self, a: np.ndarray, b: np.ndarray) -> None:
        if is_ideal(a) or is_ideal(b):
            self.curve(BezierCurve([a, b]), "polygon")
        else:
            self.segment(a, b, "polygon")

    def de_casteljau(
        self, curve: BezierCurve, t: float, label: str | None = "$b({t:g})$", polygon: bool = True
    ) -> None:
        """Draw de Casteljau's scheme at `t`: all legs, the tangent, and the point."""
        scheme = curve.de_casteljau(numbers(t, "t"))
        if polygon:
            self.control_polygon(curve)
        for r, level in enumerate(scheme[1:-1], 1):
            last = r == curve.degree - 1
            for a, b in pairwise(level):
                self.segment(a, b, "tangent" if last else "construction")
            self.points(level, kind="second point", markersize=5.0)
        self.point(scheme[-1][0], label.format(t=t) if label else None, (8, -10), markersize=8.0)

    def farin(self, curve: BezierCurve, t: float | None = None, labels: str = "$q_{}$") -> None:
        """Draw the Farin points of a curve, and with `t` the scheme by cross ratios."""
        q = curve.farin_points()
        if t is not None:
            for b, f in cross_ratio_scheme(curve.control_points, q, t)[1:-1]:
                self.polyline(b, "construction")
                self.points(b, kind="second point", markersize=5.0)
                for x in f:
                    self._diamond(x, 4.5)
        for k, x in enumerate(q):
            self._diamond(x, 6.5)
            self.label(x, labels.format(k), (9, -9))

    def _diamond(self, x: np.ndarray, size: float) -> None:
        place = self.place(x)
        self.axes.plot(
            *place, marker="D", markersize=size, color="white", markeredgecolor="black", zorder=7
        )

    def dual_curve(
        self, lines: DualBezierCurve, count: int = 25, labels: str | None = "$U_{}$"
    ) -> None:
        """Draw a curve of lines: control lines, `count` lines of it, and the envelope."""
        if self.dimension != 2 or lines.dimension != 2:
            raise GeometryError.expected("lines", "a dual curve of the plane", f"{lines!r}")
        for line in lines.evaluate(np.linspace(0, 1, count)):
            self.line(line, kind="thin")
        for k, line in enumerate(lines.control_elements):
            self.line(line, kind="polygon", linewidth=1.8)
            if labels:
                self.label(self._on_line(line), labels.format(k), (8, 8))
        self.curve(lines.point_form())

    def _on_line(self, line: np.ndarray, where: float = 0.06) -> np.ndarray:
        """Return a place on a line near the edge of the window, ``(3,)``."""
        w = self.window.grown(-where)
        n = line[:2]
        d = np.array([n[1], -n[0]])
        foot = -(line[2] + line[:2] @ w.middle) * n / (n @ n) + w.middle
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.concatenate(
                [(np.array([w.x0, w.y0]) - foot) / d, (np.array([w.x1, w.y1]) - foot) / d]
            )
        order = np.sort(reach[np.isfinite(reach)])
        for s in order[::-1]:
            x = foot + s * d
            if w.x0 - 1e-9 <= x[0] <= w.x1 + 1e-9 and w.y0 - 1e-9 <= x[1] <= w.y1 + 1e-9:
                return np.append(x, 1.0)
        return np.append(foot, 1.0)

    def cross_ratio(
        self,
        points: Any,
        labels: Any = ("$a$", "$b$", "$c$", "$d$"),
        text: str | None = "cr = {:.4g}",
    ) -> float:
        """Mark four points of a line with their cross ratio, and return it."""
        p = self.homogeneous(points)
        if len(p) != 4:
            raise GeometryError.expected("points", "four points", f"{len(p)}")
        value = float(cross_ratio(*p))
        finite = [x for x in p if not is_ideal(x)]
        for x, name in zip(p, labels):
            self.point(x, name)
        if text and len(finite) > 1:
            self.label(finite[-1], text.format(value), (14, -16))
        return value

    # ------------------------------------------------------------------ patches

    def net(
        self, patches: BezierTriangles, patch: int = 0, labels: bool = False, **changes: Any
    ) -> None:
        """Draw the control net of a patch; with `labels`, each point with its three indices."""
        n, b = patches.degree, patches.control_points[patch]
        for corners in bernstein.net_triangles(n).tolist():
            for a, c in zip(corners, corners[1:] + corners[:1]):
                if b[a].any() and b[c].any() and not (is_ideal(b[a]) and is_ideal(b[c])):
                    self._leg(b[a], b[c])
        for x, (i, j, k) in zip(b, bernstein.multi_indices(n)):
            if x.any():
                self.point(x, f"$b_{{{i}{j}{k}}}$" if labels else None, **changes)

    def boundary(
        self, patches: BezierTriangles, kind: str = "curve", on: Any = None, **changes: Any
    ) -> None:
        """Draw the boundary curves of all patches; with a quadric `on`, hidden parts dashed."""
        for patch in range(len(patches)):
            for k in range(3):
                c = isoparametric(patches, patch, _CORNERS[k], _CORNERS[(k + 1) % 3])
                self._on_quadric(c, on, kind, **changes) if c is not None else None

    def isolines(
        self, patches: BezierTriangles, count: int = 4, kind: str = "thin", on: Any = None,
        hidden: bool = False, **changes: Any,
    ) -> None:  # fmt: skip
        """Draw isoparametric lines of all patches in all three directions, `count` each.

        With an oval quadric `on`, what the eye sees of them, and with `hidden` the rest dashed.
        """
        for patch in range(len(patches)):
            for k in range(3):
                a, b, c = (_CORNERS[(k + m) % 3] for m in range(3))
                for s in np.arange(1, count + 1) / (count + 1):
                    line = isoparametric(patches, patch, (1 - s) * a + s * c, (1 - s) * b + s * c)
                    if line is not None:
                        self._on_quadric(line, on, kind, hidden, **changes)

    def _on_quadric(
        self, curve: BezierCurve, A: Any, kind: str, hidden: bool = True, **changes: Any
    ) -> None:
        """Draw a curve on an oval quadric: where the eye does not see it, as hidden line."""
        if A is None:
            self.curve(curve, kind, **changes)
            return
        eye = self.eye()
        plane = quadric_matrix(A) @ eye
        plane = plane * np.sign(plane @ eye)
        # before the eye, and on its side of the polar plane (times the weight, squared in all)
        net = curve.control_points
        side, weight = net @ plane, net[:, -1]
        both = _product(side, weight)
        image, front = self._net(net)
        from .sampling import trace

        for sign, look in ((both, kind), (-both, "hidden"))[: 2 if hidden else 1]:
            pieces = trace(image, self.window, self.tolerance, _positive(sign, front))
            self._stroke(pieces, look, **(changes if look == kind else {}))

    def eye(self) -> np.ndarray:
        """Return the centre of the projection, ``(4,)``; for space alone."""
        if self.dimension != 3:
            raise GeometryError.expected("drawing", "one of space", "one of the plane")
        eye = np.linalg.svd(self.matrix)[2][3]
        return eye / eye[3]

    def surface(
        self, patches: BezierTriangles, resolution: int = 24, light: Any = (0.3, -0.5, 0.8),
        grey: tuple[float, float] = (0.62, 0.97), opacity: float = 1.0, on: Any = None,
        zorder: float = 1.5,
    ) -> None:  # fmt: skip
        """Draw patches as shaded, opaque surface: fine facets, from the far to the near.

        For pictures; what a ray sees exactly is for a render, and `overlay`. With an oval quadric
        `on`, facets that it hides are left out.
        """
        from matplotlib.collections import PolyCollection

        vertices, faces = patches.tessellate(resolution)
        good = np.isfinite(vertices).all(axis=1)
        faces = faces[good[faces].all(axis=1)]
        image = self.image(np.where(good[:, None], vertices, 0.0))
        faces = faces[(image[faces][..., 2] > 0).all(axis=1)]
        if on is not None:
            polar = quadric_matrix(on) @ self.eye()
            polar = polar * np.sign(polar @ self.eye())
            middle = vertices[faces].mean(axis=1)
            faces = faces[middle @ polar[:3] + polar[3] > 0]
        corner = vertices[faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        size = np.maximum(norm(normal), 1e-300)
        l = np.asarray(light, dtype=np.float64)
        lit = np.abs(normal @ (l / norm(l))) / size
        shade = grey[0] + (grey[1] - grey[0]) * lit
        order = np.argsort(-image[faces][..., 2].max(axis=1))
        place = image[..., :2] / np.where(image[..., 2:] > 0, image[..., 2:], 1.0)
        colours = np.repeat(shade[order, None], 4, axis=1)
        colours[:, 3] = opacity
        # not smoothed: smoothed edges of facets let what is behind shine through
        self.axes.add_collection(
            PolyCollection(
                list(place[faces[order]]), facecolors=colours, edgecolors="none", zorder=zorder,
                rasterized=True, antialiased=False,
            ),
            autolim=False,
        )  # fmt: skip

    # ------------------------------------------------------------------ space

    def plane(
        self, corners: Any, label: str | None = None, grey: float = 0.88, opacity: float = 0.75
    ) -> None:
        """Draw a part of a plane: a polygon of points of space, filled and outlined."""
        self.fill(corners, grey, alpha=opacity)
        self.polyline(corners, "thin", closed=True)
        if label:
            self.label(self.homogeneous(corners)[-1], label, (0, -12))

    def box(self, origin: Any, edges: Any, kind: str = "polygon") -> None:
        """Draw the twelve edges of a parallelepiped."""
        o, e = numbers(origin, "origin"), numbers(edges, "edges")
        for k in range(3):
            for i in (0, 1):
                for j in (0, 1):
                    a = o + i * e[(k + 1) % 3] + j * e[(k + 2) % 3]
                    self.segment(a, a + e[k], kind)

    def quadric_outline(self, A: Any, kind: str = "curve", **changes: Any) -> None:
        """Draw the outline of a quadric as the eye sees it: a conic of the image, exactly.

        Raises
        ------
        GeometryError
            If the eye is inside, or the quadric is a cone: it has no such outline.
        """
        a = quadric_matrix(A)
        eye = self.eye()
        polar = a @ eye
        # the cone of tangents from the eye, (E'AE) A - A E E'A, in the image
        cone = (eye @ a @ eye) * a - np.outer(polar, polar)
        back = np.linalg.pinv(self.matrix)
        self.conic(back.T @ cone @ back, kind, **changes)

    def pencil(self, center: Any, through: Any, kind: str = "thin", **changes: Any) -> None:
        """Draw the lines of a pencil: from one point through others, as whole lines."""
        for x in self.homogeneous(through):
            self.line(center, x, kind, **changes)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Bernstein coefficients of the product of two polynomials of one degree."""
    n = len(a) - 1
    t = (1 - np.cos(np.pi * (np.arange(2 * n + 1) + 0.5) / (2 * n + 1))) / 2
    u = bernstein.univariate(n, t)
    return np.linalg.solve(bernstein.univariate(2 * n, t), (u @ a) * (u @ b))


def _positive(a: np.ndarray, front: np.ndarray | None) -> np.ndarray:
    """Return `a` where the curve is before the eye; curves partly behind it lose that part."""
    if front is None or (front > 0).all():
        return a
    return a if (front >= 0).any() else -np.ones(1)
