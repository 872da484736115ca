"""Rays against even aspheres in float64: sampled heights, and bisection for all that is between.

The height of a ray over the surface, ``h(t) = z - sag(r^2)``, is sampled together with its first
two derivatives. Between two samples a zero of h'' is found by bisection, then on either side one of
h', and then of h: so no root is missed as long as h'' has one zero at most between two samples.
Nothing here is shared with the leaves and their bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..geometry.aspheres import EvenAsphere

__all__ = ["AsphereHits", "first_hits"]

#: Halvings of an interval: below the roundings of float64.
_HALVINGS = 56
#: Points are looked for up to here, in apertures: those just beyond the rim tell that it is near.
_REACH = 1 + 3e-5
#: Rays and samples at a time: bounds the memory.
_CHUNK = 1 << 21


class AsphereHits(NamedTuple):
    """What rays meet."""

    t: np.ndarray  #: (N,) ray parameters of the first hits, infinite for misses
    #: (N,) the least height, in apertures, at which a ray turns round over the surface: where it is
    #: small, a rounding decides on a hit
    grazing: np.ndarray
    #: (N,) how near a meeting is to a rim, in apertures
    rim: np.ndarray


def first_hits(
    surface: EvenAsphere, o: np.ndarray, d: np.ndarray, samples: int = 65
) -> AsphereHits:
    """Return the first hits, ``t > 0``, of rays with an asphere in its own frame.

    Parameters
    ----------
    surface : EvenAsphere
    o, d : ndarray
        ``(N, 3)`` origins and directions.
    samples : int
        Of each ray within the surface's cylinder.
    """
    o, d = np.asarray(o, float), np.asarray(d, float)
    begin, end = _within(surface, o, d)
    hits = AsphereHits(*(np.full(len(o), np.inf) for _ in range(3)))
    at = np.linspace(0, 1, samples)
    rays = np.flatnonzero(begin < end)
    for first in range(0, len(rays), max(1, _CHUNK // samples)):
        some = rays[first : first + max(1, _CHUNK // samples)]
        t = begin[some, None] + (end - begin)[some, None] * at
        ray = np.repeat(some, samples - 1)
        _search(surface, o, d, hits, ray, t[:, :-1].ravel(), t[:, 1:].ravel())
    return hits


def _within(surface: EvenAsphere, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pieces of rays within the cylinder, and between planes beyond all of the sag."""
    size = surface.aperture
    a = np.sum(d[:, :2] ** 2, axis=1)
    b = np.sum(o[:, :2] * d[:, :2], axis=1)
    c = np.sum(o[:, :2] ** 2, axis=1) - (size * _REACH) ** 2
    height = np.abs(surface.sag(np.linspace(0, 1, 4097) * size**2)).max() * 1.1 + 1e-3 * size
    with np.errstate(all="ignore"):
        q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
        ends = np.sort([q / a, c / q], axis=0)
        ends = np.where(a > 0, ends, np.where(c <= 0, [[-np.inf], [np.inf]], np.nan))
        planes = np.sort([(-height - o[:, 2]) / d[:, 2], (height - o[:, 2]) / d[:, 2]], axis=0)
        level = (d[:, 2] == 0) & (np.abs(o[:, 2]) <= height)
        planes = np.where(level, [[-np.inf], [np.inf]], planes)
        begin = np.maximum(np.maximum(ends[0], planes[0]), 0.0)
        end = np.minimum(ends[1], planes[1])
    return np.where(np.isfinite(begin), begin, np.inf), np.where(np.isfinite(end), end, -np.inf)


def _search(
    surface: EvenAsphere,
    o: np.ndarray,
    d: np.ndarray,
    hits: AsphereHits,
    ray: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> None:
    """Search intervals of rays, and put what is found into `hits`."""
    edge = (surface.aperture * _REACH * (1 + 1e-9)) ** 2

    def height(order: int, t: np.ndarray, ray: np.ndarray) -> np.ndarray:
        across = o[ray, :2] + t[:, None] * d[ray, :2]
        s = np.minimum(np.sum(across**2, axis=1), edge)
        f, f1, f2 = surface.derivatives(s)
        ds = 2 * np.sum(across * d[ray, :2], axis=1)
        if order == 0:
            return o[ray, 2] + t * d[ray, 2] - f
        if order == 1:
            return d[ray, 2] - f1 * ds
        return -f2 * ds**2 - 2 * f1 * np.sum(d[ray, :2] ** 2, axis=1)

    for order in (2, 1):
        k = np.flatnonzero((height(order, low, ray) > 0) != (height(order, high, ray) > 0))
        middle = _bisect(lambda t, r, order=order: height(order, t, r), low[k], high[k], ray[k])
        if order == 1:
            turning = np.abs(height(0, middle, ray[k])) / surface.aperture
            np.minimum.at(hits.grazing, ray[k], turning)
        high_ends = high[k]
        high = high.copy()
        high[k] = middle
        ray = np.concatenate([ray, ray[k]])
        low, high = np.concatenate([low, middle]), np.concatenate([high, high_ends])
    k = np.flatnonzero((height(0, low, ray) > 0) != (height(0, high, ray) > 0))
    ray = ray[k]
    t = _bisect(lambda t, r: height(0, t, r), low[k], high[k], ray)
    r = np.linalg.norm(o[ray, :2] + t[:, None] * d[ray, :2], axis=1)
    gap = np.abs(r[:, None] - [surface.aperture, surface.inner or np.inf]).min(axis=1)
    np.minimum.at(hits.rim, ray, gap / surface.aperture)
    on = (r <= surface.aperture) & (r >= surface.inner)
    np.minimum.at(hits.t, ray[on], t[on])


def _bisect(
    f: Callable[..., np.ndarray], low: np.ndarray, high: np.ndarray, ray: np.ndarray
) -> np.ndarray:
    """Return where functions change their sign."""
    positive = f(low, ray) > 0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        same = (f(middle, ray) > 0) == positive
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return (low + high) / 2
