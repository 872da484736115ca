"""Even aspheres: graphs of a conic of revolution and an even polynomial over a disk or a ring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import GeometryError

__all__ = ["LEG", "START", "STEEPEST", "EvenAsphere"]

#: Parameters of a point, in units of the aperture: ``u = (x + START) / LEG``, and v of y. So the
#: triangle of parameters holds the whole disk, and (u, v) are as smooth as (x, y).
START, LEG = 1 + 1 / 64, 3.5

#: ``(1 + k) c^2 r^2`` of the rim is at most this. At 1 the conic turns back and is no graph any
#: more; here its slope is a hundred times what it would be of the paraboloid.
STEEPEST = 1 - 1e-4

#: No term of the sag is larger than this at the rim, in units of the aperture's radius.
_LARGEST = 1e6

#: Nodes of Gauss's rule in ``r^2``, and of the trapezoidal rule in the angle.
_NODES, _ANGLES = 256, 256


@dataclass(frozen=True)
class EvenAsphere:
    """The surface ``z = c s / (1 + sqrt(1 - (1 + k) c^2 s)) + a_1 s + a_2 s^2 + ...``, ``s = r^2``.

    That is how optical design programs have it (Welford, *Aberrations of Optical Systems*, 1986,
    section 4.8). The vertex is the origin, the axis is z.

    Parameters
    ----------
    curvature : float
        c, the reciprocal of the radius of the conic at the vertex; 0 for a plane.
    aperture : float
        Radius of the rim.
    conic : float
        k: 0 a sphere, -1 a paraboloid, below -1 a hyperboloid, above -1 an ellipsoid.
    coefficients : sequence of float
        ``a_1, a_2, ...`` of ``r^2, r^4, ...``, any number of them.
    inner : float
        Radius of a hole around the axis.

    Raises
    ------
    GeometryError
        If a number is not finite, a radius is negative or none, or the conic ends within the
        aperture.

    Examples
    --------
    >>> from mitsuba_bezier.geometry.aspheres import EvenAsphere
    >>> float(EvenAsphere(0.1, 2.0, coefficients=(0, 1e-3)).sag(4.0).round(6))
    0.218041
    """

    curvature: float
    aperture: float
    conic: float = 0.0
    coefficients: Sequence[float] = ()
    inner: float = 0.0

    def __post_init__(self) -> None:
        for name in ("curvature", "conic"):
            if not np.isfinite(getattr(self, name)):
                raise GeometryError.expected(name, "a finite number", getattr(self, name))
        object.__setattr__(self, "coefficients", tuple(float(a) for a in self.coefficients))
        if not np.isfinite(self.coefficients).all():
            raise GeometryError.expected("coefficients", "finite numbers", list(self.coefficients))
        if not 0 < self.aperture < np.inf:
            raise GeometryError.expected("aperture", "a positive radius", self.aperture)
        if not 0 <= self.inner < self.aperture:
            raise GeometryError.expected(
                "inner_radius", f"a radius from 0 to below {self.aperture:.6g}", self.inner
            )
        bend = self.bend * self.aperture**2
        if not bend <= STEEPEST * (1 + 1e-12):  # false for NaN
            raise GeometryError.expected(
                "aperture",
                f"a radius at which the surface is a graph, (1 + conic) curvature^2 aperture^2 "
                f"at most {STEEPEST}",
                f"{self.aperture:.6g}, where it is {bend:.6g}",
            )
        with np.errstate(over="ignore", invalid="ignore"):
            powers = self.aperture ** (2.0 * np.arange(1, len(self.coefficients) + 1) - 1)
            given = np.array(self.coefficients)
            terms = np.where(given != 0, given * powers, 0.0)  # in units of the aperture
        numbers = [*terms, self.curvature * self.aperture, bend]
        if not (np.abs(numbers) < _LARGEST).all():  # false for NaN
            raise GeometryError.expected(
                "coefficients",
                f"a sag below {_LARGEST:g} times the aperture",
                f"terms of {np.abs(numbers).max():.3g} times the aperture at the rim",
            )

    @property
    def bend(self) -> float:
        """``(1 + k) c^2``: the conic's root is that of ``1 - bend r^2``."""
        return (1 + self.conic) * self.curvature**2

    def sag(self, s: np.ndarray | float) -> np.ndarray:
        """Return z where the square of the distance from the axis is `s`."""
        s = np.asarray(s, float)
        z = np.zeros_like(s)
        for a in reversed(self.coefficients):
            z = (z + a) * s
        return z + self.curvature * s / (1 + np.sqrt(1 - self.bend * s))

    def derivatives(self, s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return z and its first and second derivatives by ``s = r^2``."""
        s = np.asarray(s, float)
        z, first, second = np.zeros_like(s), np.zeros_like(s), np.zeros_like(s)
        with np.errstate(over="ignore", invalid="ignore"):
            for a in (*reversed(self.coefficients), 0.0):
                second = second * s + 2 * first
                first = first * s + z
                z = z * s + a
            root = np.sqrt(1 - self.bend * s)
            z = z + self.curvature * s / (1 + root)
            first = first + self.curvature / (2 * root)
            second = second + self.curvature * self.bend / (4 * root**3)
        return z, first, second

    def normalised(self) -> EvenAsphere:
        """Return the surface in units of its aperture's radius."""
        r = self.aperture
        return EvenAsphere(
            self.curvature * r,
            1.0,
            self.conic,
            [a * r ** (2 * i - 1) for i, a in enumerate(self.coefficients, start=1)],
            self.inner / r,
        )

    def area(self, matrix: np.ndarray | None = None) -> float:
        """Return the area, under a linear map ``(3, 3)`` if one is given.

        By Gauss's rule in ``r^2`` and equal steps of the angle, to some 1e-9 where the rim is not
        steep.
        """
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        low, high = self.inner**2, self.aperture**2
        s = low + (high - low) * (nodes + 1) / 2
        slope = self.derivatives(s)[1]
        angle = np.arange(_ANGLES) / _ANGLES * 2 * np.pi
        r = np.sqrt(s)
        normal = np.stack(
            [
                -2 * (slope * r)[:, None] * np.cos(angle),
                -2 * (slope * r)[:, None] * np.sin(angle),
                np.ones((len(r), _ANGLES)),
            ],
            axis=-1,
        )
        if matrix is not None:  # areas go with the cofactors
            matrix = np.asarray(matrix, float)
            normal = normal @ (np.linalg.det(matrix) * np.linalg.inv(matrix))
        density = np.linalg.norm(normal, axis=-1).mean(axis=1)
        return float(np.pi * (high - low) / 2 * np.dot(weights, density))
