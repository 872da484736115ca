"""Trace rays through a lens in order, in float64: the reference for everything else.

Refraction and reflection are exact at every surface; aspheres are met by Newton's method from the
conic's closed form. (Welford, *Aberrations of Optical Systems*, 1986, chapter 4.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import PrescriptionError
from .checks import check_wavelength
from .lens import Lens, Surface

#: Newton steps on an asphere; from the conic's hit some five suffice.
_STEPS = 60
#: Rays aimed at a rim meet it but for rounding: they pass if they are off by less, relatively.
_RIM = 1e-9


@dataclass(frozen=True)
class Trace:
    """Rays through a lens.

    Attributes
    ----------
    points : ndarray
        ``(S + 1, N, 3)`` points on each surface and on the image plane, in the frame of the lens.
    directions : ndarray
        ``(S + 1, N, 3)`` unit directions behind each surface; the last is that at the image.
    local : ndarray
        ``(S + 1, N, 3)`` the points in the surfaces' own frames.
    path : ndarray
        ``(N,)`` optical path lengths from the origins to the image.
    valid : ndarray
        ``(N,)`` mask of rays that met every surface, inside every clear aperture or on its rim if
        `vignetting`, without total reflection.
    stopped : ndarray
        ``(N,)`` index of the surface that ended a ray, -1 if none.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, trace
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, conic=-1)])
    >>> found = trace(mirror, [[0, 0, -50], [0, 30, -50]], [[0, 0, 1]] * 2)
    >>> found.path.round(9).tolist()  # equal to the focus of a paraboloid
    [150.0, 150.0]
    """

    points: np.ndarray
    directions: np.ndarray
    local: np.ndarray
    path: np.ndarray
    valid: np.ndarray
    stopped: np.ndarray


def meet(surface: Surface, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return ray parameters ``(N,)`` of hits near the vertex, NaN where there is none.

    Parameters
    ----------
    surface : Surface
        In its own frame.
    o, d : ndarray
        ``(N, 3)`` origins and directions in that frame.
    """
    c, k = surface.curvature, surface.conic
    a = c * (np.sum(d[:, :2] ** 2, axis=1) + (1 + k) * d[:, 2] ** 2)
    b = c * (np.sum(o[:, :2] * d[:, :2], axis=1) + (1 + k) * o[:, 2] * d[:, 2]) - d[:, 2]
    q = c * (np.sum(o[:, :2] ** 2, axis=1) + (1 + k) * o[:, 2] ** 2) - 2 * o[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * q)
        sheet = np.where(d[:, 2] < 0, -1.0, 1.0)
        t = q / (-b + sheet * root)
        # the other branch of the conic is no part of the surface
        z = o[:, 2] + t * d[:, 2]
        t = np.where((1 + k) * c * z <= 1, t, np.nan)
    if surface.is_conic:
        return t
    if not c:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -o[:, 2] / d[:, 2]
    for _ in range(_STEPS):
        p = o + t[:, None] * d
        r = np.hypot(p[:, 0], p[:, 1])
        gap = p[:, 2] - surface.sag(r)
        rate = d[:, 2] - surface.slope(r) * np.sum(p[:, :2] * d[:, :2], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = gap / rate
        t = t - step
        size = 1e-15 * (np.abs(t) + np.linalg.norm(o, axis=1))
        if not (np.abs(step) > size).any():
            break
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(step) <= 1e3 * size, t, np.nan)


def normals(surface: Surface, p: np.ndarray) -> np.ndarray:
    """Return unit normals ``(N, 3)`` at points in the surface's frame, towards positive z."""
    slope = surface.slope(np.hypot(p[:, 0], p[:, 1]))
    n = np.stack([-slope * p[:, 0], -slope * p[:, 1], np.ones(len(p))], axis=1)
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def refract(d: np.ndarray, n: np.ndarray, before: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """Return refracted unit directions; NaN where light is totally reflected.

    `n` is a unit normal on either side. With m = n_before / n_behind and n along d,
    ``d' = m d + (sqrt(1 - m^2 (1 - (n d)^2)) - m (n d)) n``.
    """
    along = np.sum(n * d, axis=1, keepdims=True)
    n = np.where(along < 0, -n, n)
    along = np.abs(along)
    m = np.reshape(before / behind, (-1, 1))
    with np.errstate(invalid="ignore"):
        return m * d + (np.sqrt(1 - m * m * (1 - along**2)) - m * along) * n


def trace(
    lens: Lens,
    origins: np.ndarray,
    directions: np.ndarray,
    wavelength: float | np.ndarray | None = None,
    vignetting: bool = True,
) -> Trace:
    """Trace rays from before the first surface to the image plane.

    Parameters
    ----------
    lens : Lens
        The lens.
    origins, directions : ndarray
        ``(N, 3)`` in the frame of the lens.
    wavelength : float or ndarray
        In micrometres, one or ``(N,)``; the reference wavelength by default.
    vignetting : bool
        Whether rays outside a clear aperture end.

    Returns
    -------
    Trace

    Raises
    ------
    PrescriptionError
        If the arrays are not ``(N, 3)`` and of one length, or a direction is 0.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, trace
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, conic=-1)])
    >>> trace(mirror, [[0, 30, -50]], [[0, 0, 1]]).points[-1].round(12).tolist()
    [[0.0, 0.0, -100.0]]
    """
    o = np.array(origins, float)
    d = np.array(directions, float)
    if o.ndim != 2 or o.shape[1] != 3 or d.shape != o.shape:
        raise PrescriptionError(
            f"origins, directions: expected two arrays (N, 3), got {o.shape} and {d.shape}"
        )
    length = np.linalg.norm(d, axis=1, keepdims=True)
    if (length == 0).any() or np.isinf(length).any():
        raise PrescriptionError.expected("directions", "finite ones that are not 0", d.tolist())
    d = d / length
    w = check_wavelength(lens.wavelengths[lens.reference] if wavelength is None else wavelength)
    if w.shape not in ((), (1,), (len(o),)):
        raise PrescriptionError.expected(
            "wavelength", f"one, or one for each of {len(o)} rays", f"shape {w.shape}"
        )
    w = np.broadcast_to(w, len(o))
    index = np.array([np.broadcast_to(m.index(w), len(o)) for m in lens.media()])

    frames = lens.frames()
    stopped = np.full(len(o), -1)
    path = np.zeros(len(o))
    points, after, local = [], [], []
    for i, frame in enumerate(frames):
        last = i == len(lens.surfaces)
        surface = Surface() if last else lens.surfaces[i]
        turn, move = frame[:3, :3], frame[:3, 3]
        ol, dl = (o - move) @ turn, d @ turn
        t = meet(surface, ol, dl)
        p = ol + t[:, None] * dl
        r = np.hypot(p[:, 0], p[:, 1])
        ended = np.isnan(t)
        if vignetting and not last:
            outer, inner = surface.semi_diameter * (1 + _RIM), surface.inner * (1 - _RIM)
            ended |= ~((r <= outer) & (r >= inner))
        path += index[i] * t
        if not last:
            n = normals(surface, p)
            if surface.mirror:
                dl = dl - 2 * np.sum(dl * n, axis=1, keepdims=True) * n
            else:
                dl = refract(dl, n, index[i], index[i + 1])
            ended |= np.isnan(dl).any(axis=1)
        stopped = np.where((stopped < 0) & ended, i, stopped)
        o, d = p @ turn.T + move, dl @ turn.T
        points.append(o)
        after.append(d)
        local.append(p)
    return Trace(np.array(points), np.array(after), np.array(local), path, stopped < 0, stopped)
