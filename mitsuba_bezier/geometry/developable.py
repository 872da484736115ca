"""Developable surfaces from control planes, as exact patches between two trace planes.

The planes ``u(t) = sum B_i(t) U_i`` envelop a developable. With the last two planes a(t), b(t)
of de Casteljau's scheme (degree n - 1 in t), the tangent plane is ``(1-t) a + t b``, the ruling
``a ∧ b``, and its meet with a fixed plane e the 4D cross product ``a x b x e``: a curve of degree
``2n - 2``. Two traces are the long boundaries of a patch of bidegree ``(2n - 2, 1)``.
"""

from __future__ import annotations

from math import comb
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import GeometryError, NetError
from .curves import BezierCurve, bernstein_product
from .duality import DualBezierCurve, wedge2, wedge3
from .projective import TOLERANCE, elements, meet, norm, numbers

if TYPE_CHECKING:
    from .triangles import BezierTriangles, Differential

__all__ = ["DevelopableSurface", "developable_residual", "gaussian_curvature"]


class DevelopableSurface:
    """The developable enveloped by a Bézier curve of planes.

    Parameters
    ----------
    control_planes : (n+1, 4) array_like
        Planes ``(a, b, c, e)``, ``ax + by + cz + ew = 0``, degree ``n >= 2``. Degree 2 gives
        a quadratic cone or cylinder.

    Raises
    ------
    NetError
        If the shape is not of this form, or the numbers are unusable.
    GeometryError
        If all planes pass through one line (or are one plane).
    """

    def __init__(self, control_planes: Any) -> None:
        net = numbers(control_planes, "control_planes")
        if net.ndim != 2 or net.shape[0] < 3 or net.shape[1] != 4:
            raise NetError.expected(
                "control_planes", "shape (n+1, 4) with n >= 2", f"shape {net.shape}"
            )
        self._dual = DualBezierCurve(net)
        net = self._dual.control_elements
        self._meets = bernstein_product(net[:-1], net[1:], wedge2)  # in dual coordinates
        length = norm(net)
        unit = net[length > 0] / length[length > 0, None]
        sigma = np.linalg.svd(unit, compute_uv=False)
        if len(sigma) < 3 or not sigma[2] > TOLERANCE * sigma[0]:
            raise GeometryError.expected(
                "control_planes", "planes that do not share a line", "planes of one pencil"
            )

    @property
    def control_planes(self) -> np.ndarray:
        """The control planes, ``(n+1, 4)``, read-only."""
        return self._dual.control_elements

    @property
    def degree(self) -> int:
        """The degree n of the curve of planes."""
        return self._dual.degree

    def __repr__(self) -> str:
        return f"DevelopableSurface(degree {self.degree})"

    def tangent_plane(self, t: Any) -> np.ndarray:
        """Return tangent planes ``(..., 4)``."""
        return self._dual.evaluate(t)

    @property
    def ruling_coefficients(self) -> np.ndarray:
        """Bernstein coefficients ``(2n-1, 6)`` of the rulings as Plücker vectors."""
        return np.concatenate([self._meets[:, 3:], self._meets[:, :3]], axis=1)

    def ruling(self, t: Any) -> np.ndarray:
        """Return rulings as Plücker vectors ``(..., 6)``.

        Raises
        ------
        GeometryError
            Where the last two planes coincide.
        """
        return self._dual.ruling(t)

    def regression_curve(self) -> BezierCurve:
        """Return the curve of regression, degree ``3n - 6``; the rulings are its tangents.

        Raises
        ------
        GeometryError
            If the surface is a cone or cylinder: see `apex`.
        """
        apex = self.apex()
        if apex is not None:
            raise GeometryError.expected(
                "control_planes",
                "planes that do not all pass through one point (n >= 3)",
                f"a cone or cylinder with apex {np.round(apex, 6).tolist()}",
            )
        return self._dual.point_form()

    def apex(self) -> np.ndarray | None:
        """Return the point ``(4,)`` that all planes share, or None if there is none.

        A unit vector; the surface is a cone, or a cylinder if the point is ideal.
        """
        net = self.control_planes
        length = norm(net)
        _u, sigma, vh = np.linalg.svd(net[length > 0] / length[length > 0, None])
        if len(sigma) == 4 and sigma[3] > TOLERANCE * sigma[0]:
            return None
        apex = vh[3]
        return -apex if apex[3] < 0 else apex

    def trace(self, plane: Any) -> BezierCurve:
        """Return the section with a plane ``(4,)``, an exact curve of degree ``2n - 2``.

        Raises
        ------
        GeometryError
            If all rulings meet the plane in one point (it passes through the apex), or a
            ruling with t in [0, 1] lies in the plane.
        """
        e = elements("plane", plane, (4,))
        if e.ndim != 1:
            raise GeometryError.expected("plane", "one plane, shape (4,)", f"shape {e.shape}")
        # minus: the weight is then n.d for the ruling's direction d, as in `meet`
        net = -wedge3(self._meets, e)
        scale = np.abs(self._meets).max() * np.abs(e).max()
        sigma = np.linalg.svd(net, compute_uv=False)
        if not sigma[1] > TOLERANCE * scale:
            raise GeometryError.expected(
                "plane", "one that cuts the surface in a curve", "one through its apex"
            )
        curve = BezierCurve(net)
        for t in _real_roots(net):
            if norm(curve.evaluate(t)) <= 1e-9 * norm(net).max():  # as accurate as double roots are
                raise GeometryError.expected(
                    "plane",
                    "a plane that contains no ruling",
                    f"one with the ruling of t = {round(t, 6):g}",
                )
        return curve

    def net(self, first: Any, second: Any) -> np.ndarray:
        """Return the patch between two trace planes, a tensor net ``(2n-1, 2, 4)``.

        Where the common line of the planes meets a ruling, the patch pinches to a point.

        Parameters
        ----------
        first, second : (4,) array_like
            Different planes. ``net[:, 0]`` is the trace of the first, ``net[:, 1]`` of the
            second, each ruling runs from one to the other. The signs are chosen such that
            the ruling at t = 1/2 does not run through infinity.

        Raises
        ------
        GeometryError
            If the planes coincide, or one of them is unusable for `trace`.
        """
        e, f = elements("first", first, (4,)), elements("second", second, (4,))
        a, b = self.trace(e), self.trace(f)
        meet(e, f)  # refuses equal planes
        one, two = (float(c.evaluate(0.5)[3]) for c in (a, b))
        sign = -1.0 if one < 0 else 1.0
        other = -1.0 if two < 0 else 1.0
        return np.stack([sign * a.control_points, other * b.control_points], axis=1)

    def patch(self, first: Any, second: Any) -> BezierTriangles:
        """Return the patch of `net` as two Bézier triangles of degree ``2n - 1``, exactly."""
        from .tensor import tensor_to_triangles

        return tensor_to_triangles(self.net(first, second))


def _real_roots(net: np.ndarray) -> np.ndarray:
    """Return the real roots in [0, 1] of the largest component of Bernstein coefficients."""
    c = net[:, np.argmax(np.abs(net).max(axis=0))]
    n = len(c) - 1
    # with s = t / (1 - t) the polynomial is sum C(n,i) c_i s^i; t = 1 is a root if c_n = 0
    roots = np.roots([comb(n, i) * c[i] for i in range(n, -1, -1)])
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.append(roots / (1 + roots), [0.0, 1.0])
    # a double root splits by the square root of the rounding, some 1e-8
    good = np.isfinite(t) & (np.abs(t.imag) < 1e-6) & (t.real >= 0) & (t.real <= 1)
    return t[good].real


def developable_residual(net: Any) -> float:
    """Return how far a tensor net ``(m+1, 2, 4)`` is from a developable surface.

    The ruled surface between the curves a(t) = ``net[:, 0]`` and b(t) = ``net[:, 1]`` is
    developable exactly if their tangents at equal t meet, that is, if the polynomial
    ``det(a, a', b, b')`` vanishes. Its largest Bernstein coefficient is returned, divided by
    those of the two tangent lines: rounding (below about 1e-13) if it is developable, of
    order 1 for nets without a pattern.
    """
    x = numbers(net, "net")
    if x.ndim != 3 or x.shape[0] < 2 or x.shape[1:] != (2, 4):
        raise NetError.expected("net", "a net of shape (m+1, 2, 4)", f"shape {x.shape}")
    a, b = (bernstein_product(c[:-1], c[1:], wedge2) for c in (x[:, 0], x[:, 1]))
    scale = norm(a).max() * norm(b).max()
    if scale == 0:
        return 0.0  # one boundary is a point: a cone

    def pairing(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.sum(p * np.concatenate([q[..., 3:], q[..., :3]], axis=-1), axis=-1)

    return float(np.abs(bernstein_product(a, b, pairing)).max() / scale)


def gaussian_curvature(differential: Differential) -> np.ndarray:
    """Return the Gaussian curvature ``(N,)`` from `BezierTriangles.differential`.

    ``K = (L N - M^2) / (E G - F^2)``, in 1 / length^2.

    Raises
    ------
    GeometryError
        Where the surface is singular (``dp_du``, ``dp_dv`` dependent).
    """
    d = differential
    n = np.cross(d.dp_du, d.dp_dv)
    area = norm(n)
    if not (area > TOLERANCE * norm(d.dp_du) * norm(d.dp_dv)).all():
        raise GeometryError.expected("differential", "regular surface points", "a singular one")
    l, m, k = (np.sum(n * x, axis=-1) for x in (d.d2p_duu, d.d2p_duv, d.d2p_dvv))
    return (l * k - m * m) / area**4
