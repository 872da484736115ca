"""Make polylines of projective curves: through infinity, within a window, as fine as seen."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..geometry.bernstein import univariate

__all__ = ["Window", "trace"]

#: Samples before refinement. Between two of them a curve that is drawn does not go to infinity and
#: back without a change of sign that is seen.
FIRST = 257

#: Rounds of refinement: each halves the steps that bend too much.
ROUNDS = 14


class Window(NamedTuple):
    """The part of the drawing plane that is shown: ``x0 < x1`` and ``y0 < y1``."""

    x0: float
    x1: float
    y0: float
    y1: float

    @property
    def size(self) -> np.ndarray:
        """Width and height."""
        return np.array([self.x1 - self.x0, self.y1 - self.y0])

    @property
    def middle(self) -> np.ndarray:
        """The centre."""
        return np.array([self.x0 + self.x1, self.y0 + self.y1]) / 2

    def grown(self, fraction: float) -> Window:
        """Return the window with a margin on each side, a fraction of its size."""
        dx, dy = fraction * self.size
        return Window(self.x0 - dx, self.x1 + dx, self.y0 - dy, self.y1 + dy)


def trace(
    net: np.ndarray,
    window: Window,
    tolerance: float,
    sign: np.ndarray | None = None,
    start: float = 0.0,
    end: float = 1.0,
) -> list[np.ndarray]:
    """Return the polylines ``(N, 2)`` of a plane Bézier curve within a window.

    Parameters
    ----------
    net : (n+1, 3) array
        Homogeneous control points in the drawing plane.
    window : Window
        What is shown; a margin of 5 % is drawn too.
    tolerance : float
        Largest distance of the polyline from the curve.
    sign : (m+1,) array, optional
        Bernstein coefficients of a polynomial: the curve is drawn where it is positive. By default
        it is drawn everywhere, broken where the weight changes sign.
    start, end : float
        Range of the parameter.
    """
    n = len(net) - 1

    def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        h = univariate(n, t) @ net
        if sign is None:
            return h, np.sign(h[:, 2])
        return h, np.where(univariate(len(sign) - 1, t) @ sign > 0, np.sign(h[:, 2]), 0.0)

    t = np.linspace(start, end, FIRST)
    _h, side = at(t)
    pieces: list[tuple[float, ...]] = []
    first = 0
    for k in np.append(np.flatnonzero(np.diff(side)), FIRST - 1):
        if side[first]:
            low = t[first] if first == 0 else _last(at, t[first], t[first - 1], side[first])
            high = t[k] if k == FIRST - 1 else _last(at, t[k], t[k + 1], side[k])
            pieces.append((low, *t[first + 1 : k], high) if k > first else (low, high))
        first = int(k) + 1
    grown, wide = window.grown(0.05), window.grown(1.0)
    out = []
    for piece in pieces:
        s = np.array(piece)
        x = _affine(at(s)[0])
        for _ in range(ROUNDS):
            middle = (s[:-1] + s[1:]) / 2
            y = _affine(at(middle)[0])
            bent = _off_chord(x[:-1], x[1:], y) > tolerance
            bent &= _near(x[:-1], x[1:], y, wide)
            if not bent.any():
                break
            place = np.flatnonzero(bent) + 1
            s, x = np.insert(s, place, middle[bent]), np.insert(x, place, y[bent], axis=0)
        out += _clipped(x, grown)
    return out


def _last(at, inside: float, outside: float, side: float) -> float:  # type: ignore[no-untyped-def]
    """Return a parameter close to the last one of a sign between two, by bisection.

    Not the last one: there the weight is what rounding leaves, of either sign.
    """
    step = inside - outside
    for _ in range(60):
        middle = (inside + outside) / 2
        if at(np.array([middle]))[1][0] == side:
            inside = middle
        else:
            outside = middle
    return inside + 1e-7 * step


def _affine(h: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x = h[:, :2] / h[:, 2:]
    return np.clip(np.nan_to_num(x, nan=1e30, posinf=1e30, neginf=-1e30), -1e30, 1e30)


def _off_chord(a: np.ndarray, b: np.ndarray, m: np.ndarray) -> np.ndarray:
    """Return the distance of points from the chords that they should lie on."""
    d = b - a
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        length = np.hypot(d[:, 0], d[:, 1])
        along = np.sum((m - a) * d, axis=1) / np.maximum(length, 1e-300) ** 2
        foot = a + np.clip(along, 0, 1)[:, None] * d
        off = np.hypot(*(m - foot).T)
    return np.nan_to_num(off, nan=np.inf)


def _near(a: np.ndarray, b: np.ndarray, m: np.ndarray, w: Window) -> np.ndarray:
    """Return which triples may have something within the window."""
    low, high = np.minimum(np.minimum(a, b), m), np.maximum(np.maximum(a, b), m)
    return (low[:, 0] < w.x1) & (high[:, 0] > w.x0) & (low[:, 1] < w.y1) & (high[:, 1] > w.y0)


def _clipped(x: np.ndarray, w: Window) -> list[np.ndarray]:
    """Return the parts of a polyline within the window (Liang and Barsky)."""
    out: list[list[np.ndarray]] = []
    last: np.ndarray | None = None
    for a, b in pairwise(x):
        d = b - a
        lo, hi = 0.0, 1.0
        for p, q in (
            (-d[0], a[0] - w.x0), (d[0], w.x1 - a[0]), (-d[1], a[1] - w.y0), (d[1], w.y1 - a[1]),
        ):  # fmt: skip
            if p == 0:
                if q < 0:
                    lo, hi = 1.0, 0.0
            elif p < 0:
                lo = max(lo, q / p)
            else:
                hi = min(hi, q / p)
        if lo > hi:
            last = None
            continue
        start, end = a + lo * d, a + hi * d
        if last is None or lo > 0:
            out.append([start])
        out[-1].append(end)
        last = b if hi == 1 else None
    return [np.array(piece) for piece in out]
