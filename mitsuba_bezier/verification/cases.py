"""Cases of `mitsuba-bezier verify`: patches, a camera, and the same surface as a formula.

The formula side uses `oracles.analytic` alone, float64 and no net.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..geometry import shapes
from ..geometry.covers import sphere
from ..geometry.triangles import BezierTriangles
from ..oracles import analytic

__all__ = ["CASES", "Case", "Surface", "Truth"]

Points = np.ndarray

#: Hits so far over a rim still belong to the patch: `kernels.edges.EDGE`, 1e-6 in barycentrics
#: (and a tenth of it over the cosine), times ten, which is how far a unit of the parameters
#: reaches on these patches. It keeps common edges closed; silhouettes have nothing of it.
RIM = 1e-5


class Truth(NamedTuple):
    """What a formula says of rays.

    Attributes
    ----------
    t : (N,) array
        First hit with ``t > 0``; ``inf`` for a miss.
    normals : (N, 3) array
        Unit normals along the gradient, zero for a miss.
    margin : (N,) array
        How far, as a length, the ray is from another answer: from a silhouette, or from the
        rim of a surface that has one.
    """

    t: np.ndarray
    normals: np.ndarray
    margin: np.ndarray


@dataclass(frozen=True)
class Surface:
    """A surface ``x'Ax = 0`` or another with known roots, inside of some region.

    Parameters
    ----------
    roots : callable
        ``(origins, directions) -> analytic.AnalyticHits``.
    inside : callable, optional
        ``points (..., 3) -> (...)``: how far points are inside of the rim, negative outside.
    """

    roots: Callable[[Points, Points], analytic.AnalyticHits]
    inside: Callable[[Points], np.ndarray] | None = None

    def truth(self, o: Points, d: Points) -> Truth:
        """Return the first hits of rays ``(N, 3)``."""
        hits = self.roots(o, d)
        t = np.where(hits.t > 0, hits.t, np.inf)
        p = o[:, None] + np.where(np.isfinite(t), t, 0.0)[..., None] * d[:, None]
        margin = np.abs(hits.clearance)
        if self.inside is not None:
            depth = self.inside(p)
            cosine = np.abs(np.einsum("nmi,ni->nm", hits.normals, d))
            cosine /= np.linalg.norm(d, axis=1)[:, None]
            # moving the ray by x moves the hit by x / cos
            rim = (np.abs(depth) - RIM * (1 + 0.1 / np.maximum(cosine, 1e-9))) * cosine
            rim = np.where(np.isfinite(t), np.maximum(rim, 0.0), np.inf)
            t = np.where(depth >= 0, t, np.inf)
            first = t.min(axis=1)
            behind = hits.t > first[:, None]
            margin = np.minimum(margin, np.where(behind, np.inf, rim).min(axis=1))
        best = t.argmin(axis=1)
        rows = np.arange(len(t))
        normals = np.where(np.isfinite(t[rows, best])[:, None], hits.normals[rows, best], 0.0)
        return Truth(t[rows, best], normals, margin)


@dataclass(frozen=True)
class Case:
    """One surface seen by one camera.

    Parameters
    ----------
    name : str
        What the command line calls it.
    patches : callable
        Builds the patches.
    surfaces : tuple of Surface
        The same as formulas; the nearest counts.
    origin, target : (3,) tuples
        Place and aim of the camera; z is up.
    fov : float
        Field of view in degrees.
    size : float
        Length that errors are relative to; errors of `t` are relative to the larger of this
        and `t`.
    """

    name: str
    patches: Callable[[], BezierTriangles]
    surfaces: tuple[Surface, ...]
    origin: tuple[float, float, float] = (2.6, -3.2, 1.9)
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fov: float = 40.0
    size: float = field(default=1.0)

    def truth(self, o: Points, d: Points) -> Truth:
        """Return the first hits of rays ``(N, 3)`` with any of the surfaces."""
        all_ = [s.truth(o, d) for s in self.surfaces]
        t = np.stack([a.t for a in all_])
        best = t.argmin(axis=0)
        rows = np.arange(t.shape[1])
        return Truth(
            t[best, rows],
            np.stack([a.normals for a in all_])[best, rows],
            np.stack([a.margin for a in all_]).min(axis=0),
        )


def _quadric(
    diagonal: tuple[float, float, float],
    linear: float,
    constant: float,
    inside: Callable[[Points], np.ndarray] | None = None,
) -> Surface:
    """Return ``a x^2 + b y^2 + c z^2 + linear z + constant = 0``."""
    a = np.diag(np.array([*diagonal, constant], dtype=np.float64))
    a[2, 3] = a[3, 2] = linear / 2
    return Surface(lambda o, d: analytic.quadric(a, o, d), inside)


def _between(low: float, high: float) -> Callable[[Points], np.ndarray]:
    return lambda p: np.minimum(p[..., 2] - low, high - p[..., 2])


def _strip(p: Points) -> np.ndarray:
    return np.minimum(0.8 - np.abs(p[..., 0]), p[..., 1])


def _road() -> BezierTriangles:
    """Return the strip ``|x| <= 0.8, y >= 0`` of the ground, to its vanishing point."""
    left, right, far = [-0.8, 0, 0, 1], [0.8, 0, 0, 1], [0.0, 1, 0, 0]
    return BezierTriangles([[left, right, far]])


def _ground(o: Points, d: Points) -> analytic.AnalyticHits:
    return analytic.plane((0, 0, 0), (0, 0, 1), o, d)


def _lens() -> BezierTriangles:
    """Return a lens of two paraboloids with a common rim."""
    bowl = shapes.elliptic_paraboloid((0, 0, -0.3), 1, 0.3)
    return BezierTriangles.join([bowl, bowl.transform(np.diag([1.0, -1.0, -1.0, 1.0]))])


_UNIT = Surface(lambda o, d: analytic.sphere((0, 0, 0), 1, o, d))

#: All cases, in the order of the table.
CASES: tuple[Case, ...] = (
    Case("sphere-octants", lambda: sphere(cover="octants"), (_UNIT,)),
    Case("sphere-tetrahedral", lambda: sphere(cover="tetrahedral"), (_UNIT,)),
    Case(
        "ellipsoid",
        lambda: shapes.ellipsoid(radii=(1.3, 0.8, 0.6)),
        (_quadric((1 / 1.3**2, 1 / 0.8**2, 1 / 0.6**2), 0, -1),),
    ),
    Case(
        "elliptic-paraboloid",
        lambda: shapes.elliptic_paraboloid((0, 0, 0), (1, 0.8), 1.2),
        (_quadric((1, 1 / 0.8**2, 0), -1 / 1.2, 0, _between(-1, 1.2)),),
        target=(0, 0, 0.5),
    ),
    Case(
        "hyperbolic-paraboloid",
        lambda: shapes.hyperbolic_paraboloid((0, 0, 0), (1, 1.1), 0.6),
        (
            _quadric(
                (1, -1 / 1.1**2, 0),
                -1 / 0.6,
                0,
                lambda p: np.minimum(1 - np.abs(p[..., 0]), 1.1 - np.abs(p[..., 1])),
            ),
        ),
    ),
    Case(
        "hyperboloid-one-sheet",
        lambda: shapes.hyperboloid_one_sheet((0, 0, 0), (0.6, 0.5, 0.7), 1.8),
        (_quadric((1 / 0.36, 1 / 0.25, -1 / 0.49), 0, -1, _between(-0.9, 0.9)),),
    ),
    Case(
        "hyperboloid-two-sheets",
        lambda: shapes.hyperboloid_two_sheets((0, 0, 0), (0.5, 0.5, 0.3), 0.7),
        (
            _quadric((4, 4, -1 / 0.09), 0, 1, _between(0.2, 1.0)),
            _quadric((4, 4, -1 / 0.09), 0, 1, _between(-1.0, -0.2)),
        ),
    ),
    Case(
        "cone",
        lambda: shapes.cone((0, 0, -0.6), 0.9, 1.5),
        (
            Surface(
                lambda o, d: analytic.cone((0, 0, 0.9), (0, 0, 1), 0.6, o, d),
                lambda p: np.minimum(p[..., 2] + 0.6, 0.9 - p[..., 2]),
            ),
        ),
    ),
    Case(
        "cylinder",
        lambda: shapes.cylinder((0, 0, -0.7), (0.8, 0.6), 1.4),
        (_quadric((1 / 0.64, 1 / 0.36, 0), 0, -1, _between(-0.7, 0.7)),),
    ),
    Case(
        "torus",
        lambda: shapes.torus((0, 0, 0), 0.9, 0.35),
        (Surface(lambda o, d: analytic.torus((0, 0, 0), (0, 0, 1), 0.9, 0.35, o, d)),),
    ),
    Case(
        "horizon",
        shapes.plane,
        (Surface(_ground),),
        origin=(0.3, -4.0, 1.2),
        target=(0.1, 0.0, 1.0),
        fov=60.0,
    ),
    Case(
        "vanishing-point",
        _road,
        (Surface(_ground, _strip),),
        origin=(0.3, -4.0, 1.2),
        target=(0.1, 0.0, 1.0),
        fov=60.0,
    ),
    Case(
        "lens",
        _lens,
        (
            _quadric((1, 1, 0), -1 / 0.3, -1, _between(-1, 0)),
            _quadric((1, 1, 0), 1 / 0.3, -1, _between(0, 1)),
        ),
    ),
)
