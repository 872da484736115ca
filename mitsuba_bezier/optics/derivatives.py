"""How a spot changes with the prescription: differentiated ray equations.

Derivatives of points and directions by every parameter go through the surfaces with the rays
(Feder, "Differentiation of ray-tracing equations with respect to construction parameters of
rotationally symmetric optics", J. Opt. Soc. Am. 58, 1968). Rays keep the point of the stop that
they are aimed at, so that the pupil's own shift takes part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import PrescriptionError
from .beams import beam, pupil_grid
from .glass import index_derivatives
from .lens import Lens, Surface
from .trace import meet, trace

#: What a surface has; `coefficients` come one for each power.
_KINDS = ("curvature", "thickness", "conic", "nd", "vd")


@dataclass(frozen=True)
class SpotDerivatives:
    """A spot's radius and its derivatives by the prescription.

    Attributes
    ----------
    rms : float
        Root mean square distance from the centroid, of all wavelengths by their weights.
    curvature, thickness, conic, nd, vd : ndarray
        ``(S,)`` derivatives by those of each surface, and of the medium behind it. The last
        thickness is the focus. Air has derivatives by its index, too.
    coefficients : tuple of ndarray
        For each surface those by its even polynomial.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, spot_derivatives
    >>> mirror = Lens([Surface(-1 / 200, -101, mirror=True, conic=-1, semi_diameter=25)])
    >>> found = spot_derivatives(mirror)  # a paraboloid, 1 mm out of focus: the spot grows as that
    >>> round(float(found.thickness[-1] / found.rms), 6)
    -1.0
    """

    rms: float
    curvature: np.ndarray
    thickness: np.ndarray
    conic: np.ndarray
    nd: np.ndarray
    vd: np.ndarray
    coefficients: tuple[np.ndarray, ...]


def spot_derivatives(
    lens: Lens, field: tuple[float, float] = (0.0, 0.0), pupil: np.ndarray | None = None
) -> SpotDerivatives:
    """Return a spot's radius and its derivatives by every parameter of the prescription.

    The object's point stays, and each ray stays at its point of the stop, of the stop's size as it
    is now.

    Parameters
    ----------
    lens : Lens
        The lens.
    field : (float, float)
        As for `beam`.
    pupil : ndarray, optional
        ``(N, 2)`` points of the unit disk; `pupil_grid` by default.

    Returns
    -------
    SpotDerivatives

    Raises
    ------
    PrescriptionError
        If no ray arrives, or the spot is a point.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, spot_derivatives
    >>> front = Surface(1 / 50, 4, Constant(1.5), semi_diameter=10, stop=True)
    >>> lens = Lens([front, Surface(-1 / 50, 47, semi_diameter=10)])
    >>> bool(spot_derivatives(lens).thickness[-1] > 0)  # it is in focus before that
    True
    """
    p = pupil_grid() if pupil is None else np.atleast_2d(np.asarray(pupil, float))
    columns = _columns(lens)
    weights = lens.weights or [1.0] * len(lens.wavelengths)
    points, moved, shares = [], [], []
    for w, weight in zip(lens.wavelengths, weights):
        at, derivative = _image(lens, field, p, float(w), columns)
        points.append(at)
        moved.append(derivative)
        shares.append(np.full(len(at), float(weight)))
    at, by, share = np.concatenate(points), np.concatenate(moved, axis=1), np.concatenate(shares)
    if not share.sum() > 0:
        raise PrescriptionError(f"field: expected one from which rays arrive, got {tuple(field)}")
    share = share / share.sum()
    off = at - share @ at
    rms = float(np.sqrt(share @ (off**2).sum(axis=1)))
    if rms == 0:
        raise PrescriptionError("spot: expected one with a size, whose derivative exists, got 0")
    # the centroid's own change drops out: distances from it have mean 0
    gradient = np.einsum("n,nk,pnk->p", share, off, by) / rms
    return _sorted(lens, columns, gradient, rms)


def _columns(lens: Lens) -> dict[tuple[str, int, int], int]:
    """Return the number of each parameter: kind, surface, power of the polynomial."""
    names = [(kind, i, 0) for kind in _KINDS for i in range(len(lens.surfaces))]
    for i, s in enumerate(lens.surfaces):
        names += [("coefficient", i, power) for power in range(1, len(s.coefficients) + 1)]
    return {name: number for number, name in enumerate(names)}


def _sorted(
    lens: Lens, columns: dict[tuple[str, int, int], int], gradient: np.ndarray, rms: float
) -> SpotDerivatives:
    rows = {
        kind: np.array([gradient[columns[kind, i, 0]] for i in range(len(lens.surfaces))])
        for kind in _KINDS
    }
    polynomials = tuple(
        np.array([gradient[columns["coefficient", i, k + 1]] for k in range(len(s.coefficients))])
        for i, s in enumerate(lens.surfaces)
    )
    return SpotDerivatives(rms, **rows, coefficients=polynomials)


def _image(
    lens: Lens,
    field: tuple[float, float],
    pupil: np.ndarray,
    w: float,
    columns: dict[tuple[str, int, int], int],
) -> tuple[np.ndarray, np.ndarray]:
    """Return points ``(N, 2)`` of the rays that arrive, and derivatives ``(P, N, 2)``."""
    o, d = beam(lens, field, pupil, w)
    valid = trace(lens, o, d, w).valid
    o, d = o[valid], d[valid]
    count = len(columns)
    # two more rows: how a ray may be moved before the lens, to keep its point of the stop
    do, dd = np.zeros((2, count + 2, len(o), 3))
    if np.isfinite(lens.object_distance):  # turned about the object's point
        reach = (o[:, 2:] + lens.object_distance) / d[:, 2:]
        for k in range(2):
            side = np.eye(3)[k] - d[:, k : k + 1] * d
            dd[count + k], do[count + k] = side, side * reach
    else:
        do[count, :, 0] = do[count + 1, :, 1] = 1.0
    index = lens.indices(w)
    rates = _rates(lens, w, columns, count + 2)
    step = np.eye(4)
    for i, s in enumerate([*lens.surfaces, Surface()]):
        step = step @ s.before
        turn = step[:3, :3]
        o, d, do, dd = (o - step[:3, 3]) @ turn, d @ turn, do @ turn, dd @ turn
        if i:  # the vertex moves along the axis of the frame behind the surface before
            do[columns["thickness", i - 1, 0]] -= s.before[2, :3]
        o, do, n, dn = _met(s, i, (o, d), (do, dd), columns)
        if i == len(lens.surfaces):
            break
        if i == lens.stop:
            do, dd, dn = _kept(do, dd, dn, count)
        if s.mirror:
            along = np.sum(n * d, axis=1, keepdims=True)
            change = np.sum(dn * d + n * dd, axis=2, keepdims=True)
            dd = dd - 2 * (change * n + along * dn)
            d = d - 2 * along * n
        else:
            d, dd = _refracted((d, dd), (n, dn), index[i : i + 2], rates[i : i + 2])
        step = s.after.copy()
        step[:3, 3] += s.thickness * step[:3, 2]
    return o[:, :2], do[:count, :, :2]


def _rates(
    lens: Lens, w: float, columns: dict[tuple[str, int, int], int], count: int
) -> np.ndarray:
    """Return the derivatives ``(S + 1, count)`` of the index before and behind each surface."""
    rates = np.zeros((len(lens.surfaces) + 1, count))
    for i, s in enumerate(lens.surfaces):
        if s.mirror:  # the medium before it goes on
            rates[i + 1] = rates[i]
            continue
        by_nd, by_vd = index_derivatives(s.medium, w)
        rates[i + 1, columns["nd", i, 0]] = by_nd
        rates[i + 1, columns["vd", i, 0]] = by_vd
    return rates


def _met(
    s: Surface,
    number: int,
    ray: tuple[np.ndarray, np.ndarray],
    moved: tuple[np.ndarray, np.ndarray],
    columns: dict[tuple[str, int, int], int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return points and unit normals on a surface, each with derivatives."""
    (o, d), (do, dd) = ray, moved
    t = meet(s, o, d)[:, None]
    p = o + t * d
    r2 = np.sum(p[:, :2] ** 2, axis=1)
    c, k = s.curvature, s.conic
    root = np.sqrt(1 - (1 + k) * c * c * r2)
    z = c * r2 / (1 + root)
    slope = s.slope(np.sqrt(r2))
    bend = (1 + k) * c**3 / (2 * root**3)  # of the slope over r, by r^2
    # by the surface's own parameters: of the sag, and of the slope over r
    own = {
        ("curvature", number, 0): ((r2 + (1 + k) * z * z) / (2 * root), root**-3),
        ("conic", number, 0): (c * z * z / (2 * root), c**3 * r2 / (2 * root**3)),
    }
    for j, a in enumerate(s.coefficients, start=1):
        own["coefficient", number, j] = (r2**j, 2 * j * r2 ** (j - 1))
        if j > 1:
            bend = bend + 2 * j * (j - 1) * a * r2 ** (j - 2)
    sag_by = np.zeros(do.shape[:2])
    slope_by = np.zeros(do.shape[:2])
    for name, (of_sag, of_slope) in own.items():
        if name in columns:  # the image plane has none
            sag_by[columns[name]], slope_by[columns[name]] = of_sag, of_slope
    n = np.stack([-slope * p[:, 0], -slope * p[:, 1], np.ones(len(p))], axis=1)
    free = do + t * dd
    dt = (sag_by - np.sum(n * free, axis=2)) / np.sum(n * d, axis=1)
    dp = free + dt[:, :, None] * d
    slope_by = slope_by + bend * 2 * np.sum(p[:, :2] * dp[:, :, :2], axis=2)
    dn = np.zeros_like(dp)
    dn[:, :, :2] = -slope_by[:, :, None] * p[:, :2] - slope[:, None] * dp[:, :, :2]
    size = np.linalg.norm(n, axis=1, keepdims=True)
    n = n / size
    dn = (dn - np.sum(n * dn, axis=2, keepdims=True) * n) / size
    return p, dp, n, dn


def _kept(
    dp: np.ndarray, dd: np.ndarray, dn: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move rays before the lens such that their points of the stop stay."""
    a, b = dp[count, :, :2], dp[count + 1, :, :2]
    det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    x = -(dp[..., 0] * b[:, 1] - dp[..., 1] * b[:, 0]) / det
    y = -(a[:, 0] * dp[..., 1] - a[:, 1] * dp[..., 0]) / det
    x[count:], y[count:] = 0.0, 0.0
    first, second = x[..., None], y[..., None]
    dp, dd, dn = (v + first * v[count] + second * v[count + 1] for v in (dp, dd, dn))
    return dp, dd, dn


def _refracted(
    ray: tuple[np.ndarray, np.ndarray],
    normal: tuple[np.ndarray, np.ndarray],
    index: np.ndarray,
    rates: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return refracted directions and their derivatives, see `trace.refract`."""
    (d, dd), (n, dn) = ray, normal
    flip = np.where(np.sum(n * d, axis=1, keepdims=True) < 0, -1.0, 1.0)
    n, dn = flip * n, flip * dn
    m = index[0] / index[1]
    dm = ((rates[0] - m * rates[1]) / index[1])[:, None, None]
    along = np.sum(n * d, axis=1, keepdims=True)
    change = np.sum(dn * d + n * dd, axis=2, keepdims=True)
    behind = np.sqrt(1 - m * m * (1 - along**2))
    change_behind = (m * m * along * change - m * dm * (1 - along**2)) / behind
    g = behind - m * along
    dg = change_behind - dm * along - m * change
    return m * d + g * n, dm * d + m * dd + dg * n + g * dn
