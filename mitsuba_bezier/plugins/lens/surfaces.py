"""The surfaces of a lens on the device: where rays meet them, and how they are refracted.

Numbers stand in the order of the prescription, front first. Rays meet the surfaces from the film
on, in frames whose z runs to the scene; surface `i` of their count is ``count - 1 - i`` there.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...kernels.revolution_records import sag_and_slopes
from ...optics import Lens

__all__ = ["Blades", "Surfaces", "meet", "refracted"]

#: Newton steps on an asphere in float32: the start is on its conic.
_STEPS = 6


class Blades:
    """An iris of blades: a regular polygon whose corners lie on the stop's circle.

    Parameters
    ----------
    count : int
        How many; 0 is a round stop.
    rotation : float
        Degrees by which the polygon is turned about the axis.
    """

    def __init__(self, count: int, rotation: float):
        angle = np.radians(rotation) + (2 * np.arange(count) + 1) * np.pi / max(count, 1)
        self.normals = [(float(np.cos(a)), float(np.sin(a))) for a in angle]
        self.inner = float(np.cos(np.pi / count)) if count else 1.0

    def open(self, x: Any, y: Any, radius: Any) -> Any:
        """Return whether points of the stop's plane are inside: of NumPy, or on the device.

        Rays from the film have x mirrored, as the camera's axes have it.
        """
        inside: Any = True
        for a, b in self.normals:
            inside = inside & (b * y - a * x <= radius * self.inner)
        return inside

    def share(self, height: np.ndarray, radius: float) -> np.ndarray:
        """Return which part of circles about the axis is open, of arrays of NumPy.

        Parameters
        ----------
        height : (N,) array
            Their radii.
        radius : float
            That of the stop.
        """
        count = len(self.normals)
        if not count:
            return np.ones_like(height)
        inner = radius * self.inner
        # each blade covers an arc of a circle that is larger than the polygon's inner one
        half = np.arccos(np.minimum(inner / np.maximum(height, inner), 1.0))
        return np.maximum(1 - count * half / np.pi, 0.0)


class Surfaces:
    """Curvatures, conics, thicknesses and polynomials on the device, and clear radii.

    Parameters
    ----------
    lens : Lens
        As the prescription has it.
    back : Lens
        The same `backwards`, with a clear radius everywhere.
    """

    def __init__(self, lens: Lens, back: Lens):
        rows = lens.surfaces
        self.count = len(rows)
        self.terms = max(len(s.coefficients) for s in rows)
        self.conic_only = [s.is_conic for s in back.surfaces]
        self.curvatures = mi.Float([s.curvature for s in rows])
        self.conics = mi.Float([s.conic for s in rows])
        self.thicknesses = mi.Float([s.thickness for s in rows])
        table = np.zeros((self.count, self.terms))
        for i, s in enumerate(rows):
            table[i, : len(s.coefficients)] = s.coefficients
        self.coefficients = mi.Float(table.ravel()) if self.terms else mi.Float(0.0)
        self.outer2 = mi.Float([s.semi_diameter**2 for s in back.surfaces])
        self.inner2 = mi.Float([s.inner**2 for s in back.surfaces])
        self.stop = next((i for i, s in enumerate(back.surfaces) if s.stop), -1)

    def shape(self, i: Any) -> tuple[Any, Any, list[Any]]:
        """Return curvature, conic and polynomial of surface `i` as rays from the film see it."""
        j = self.count - 1 - mi.UInt32(i)
        known = isinstance(i, int) and self.conic_only[i]
        terms = 0 if known or all(self.conic_only) else self.terms
        polynomial = [
            -dr.gather(mi.Float, self.coefficients, j * self.terms + k) for k in range(terms)
        ]
        return (
            -dr.gather(mi.Float, self.curvatures, j),
            dr.gather(mi.Float, self.conics, j),
            polynomial,
        )

    def distance(self) -> Any:
        """Return the distance from the film to the lens."""
        return dr.gather(mi.Float, self.thicknesses, mi.UInt32(self.count - 1))

    def gap(self, i: Any) -> Any:
        """Return the distance from surface `i` to the next one towards the scene."""
        j = self.count - 2 - mi.Int32(i)
        return dr.gather(mi.Float, self.thicknesses, mi.UInt32(dr.maximum(j, 0)), j >= 0)

    def clear(self, i: Any, s: Any) -> Any:
        """Return whether points at squared distances `s` from the axis are inside the aperture."""
        at = mi.UInt32(i)
        return (s <= dr.gather(mi.Float, self.outer2, at)) & (
            s >= dr.gather(mi.Float, self.inner2, at)
        )


def meet(shape: tuple[Any, Any, list[Any]], o: Any, d: Any, sheet: Any = 1.0) -> tuple[Any, ...]:
    """Return points on a surface, slopes over r there, and whether there is a point.

    Parameters
    ----------
    shape : tuple
        From `Surfaces.shape`.
    o, d : Vector3f
        Rays in the surface's frame.
    sheet : float
        1 for rays towards the scene, -1 for others.
    """
    c, k, polynomial = shape
    a = c * (d.x * d.x + d.y * d.y + (1 + k) * d.z * d.z)
    b = c * (o.x * d.x + o.y * d.y + (1 + k) * o.z * d.z) - d.z
    q = c * (o.x * o.x + o.y * o.y + (1 + k) * o.z * o.z) - 2 * o.z
    disc = b * b - a * q
    met = disc >= 0
    t = q / (-b + sheet * dr.sqrt(dr.select(met, disc, 1.0)))
    # the other branch of the conic is no part of the surface
    met &= (1 + k) * c * (o.z + t * d.z) <= 1
    if polynomial:
        t = dr.select(met, t, -o.z / d.z)
        met = mi.Mask(True)
        with dr.suspend_grad():
            for _ in range(_STEPS - 1):
                t = _nearer(shape, dr.detach(o), dr.detach(d), dr.detach(t))
        t = _nearer(shape, o, d, dr.detach(t))  # derivatives of an implicit function
    p = o + d * t
    _z, slope = _sag(shape, p.x * p.x + p.y * p.y)
    return p, slope, met & dr.isfinite(t)


def _nearer(shape: tuple[Any, Any, list[Any]], o: Any, d: Any, t: Any) -> Any:
    p = o + d * t
    sag, slope = _sag(shape, p.x * p.x + p.y * p.y)
    return t - (p.z - sag) / (d.z - slope * (p.x * d.x + p.y * d.y))


def _sag(shape: tuple[Any, Any, list[Any]], s: Any) -> tuple[Any, Any]:
    """Return sag and slope over r at squared distances `s` from the axis."""
    c, k, polynomial = shape
    sag, by_square, _second = sag_and_slopes(c, (1 + k) * c * c, polynomial, s)
    return sag, 2 * by_square


def refracted(
    p: Any, slope: Any, d: Any, before: Any, behind: Any, sheet: Any = 1.0
) -> tuple[Any, Any, Any, Any]:
    """Return refracted directions, unit normals along the rays, cosines, and what is passed.

    The last is false where light is totally reflected, or a ray meets the surface from behind.
    """
    n = sheet * dr.normalize(mi.Vector3f(-slope * p.x, -slope * p.y, 1.0))
    m = before / behind
    along = dr.dot(n, d)
    left = 1 - m * m * (1 - along * along)
    passed = (left >= 0) & (along > 0)
    out = m * d + (dr.sqrt(dr.select(left > 0, left, 1e-12)) - m * along) * n
    return out, n, along, passed
