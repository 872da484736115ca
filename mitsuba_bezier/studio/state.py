"""What the studio shows: one net of points and weights, with its history."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry import bernstein
from ..geometry.curves import BezierCurve
from ..geometry.projective import number
from ..geometry.triangles import BezierTriangles
from .presets import PRESETS

__all__ = ["INFINITE", "PRESETS", "State", "weight_of"]

#: The weight that stands for infinity: the others then have no digit left of what is seen.
INFINITE = 1e6

#: Most steps that `undo` goes back.
HISTORY = 200


def weight_of(slider: float) -> float:
    """Return the weight at a place of the slider: itself up to 2, then on to infinity at 4."""
    s = number(slider, "weight")
    return s if s <= 2 else min(4 / (4 - s), INFINITE) if s < 4 else INFINITE


def slider_of(weight: float) -> float:
    """Return the place of a weight on the slider, the inverse of `weight_of`."""
    return float(np.clip(weight if weight <= 2 else 4 - 4 / weight, -2.0, 4.0))


class State:
    """One Bézier triangle, or curve, whose points and weights change, with undo.

    Parameters
    ----------
    net : (K, 4) array_like
        Homogeneous control points. Control vectors and points of weight 0 keep their rows.
    curve : bool
        The net is a curve's: K points in a row.

    Raises
    ------
    NetError
        If it is no net.
    """

    def __init__(self, net: Any, curve: bool = False) -> None:
        self._past: list[tuple[np.ndarray, np.ndarray, np.ndarray, bool]] = []
        # row whose weight was the last to change: a run of the slider is one step back
        self._weighed: int | None = None
        #: grows with every change
        self.version = 0
        self.curve = curve
        self._set(self._checked(net, curve), curve)
        self.version = 0

    @staticmethod
    def _checked(net: Any, curve: bool) -> np.ndarray:
        if not curve:
            return BezierTriangles(net).control_points[0].copy()
        a = BezierCurve(net).control_points.copy()
        if a.shape[1] != 4:
            raise GeometryError.expected("net", "four numbers a point", f"shape {a.shape}")
        return a

    def _set(self, net: np.ndarray, curve: bool) -> None:
        self.net, self.curve = net.copy(), curve
        finite = net[:, 3] != 0
        #: where control vectors start: in the middle of the finite points
        self.anchor = np.zeros(3)
        places = net[:, :3].copy()
        if finite.any():
            places[finite] = net[finite, :3] / net[finite, 3:]
            self.anchor = places[finite].mean(axis=0)
        # a point of weight 0 that is no vector either stays where it was, or at the anchor
        places[~finite] += self.anchor
        self._places = places
        self._changed()

    @property
    def degree(self) -> int:
        """The degree."""
        return len(self.net) - 1 if self.curve else bernstein.degree_of(len(self.net))

    @property
    def shape(self) -> BezierTriangles | BezierCurve:
        """The patch, or the curve."""
        return BezierCurve(self.net) if self.curve else BezierTriangles(self.net)

    @property
    def patches(self) -> BezierTriangles:
        """The patch.

        Raises
        ------
        GeometryError
            If it is a curve.
        """
        if self.curve:
            raise GeometryError.expected("net", "that of a surface", "that of a curve")
        return BezierTriangles(self.net)

    @property
    def places(self) -> np.ndarray:
        """Where the points are, ``(K, 3)``; of a control vector, its tip."""
        return self._places

    def is_vector(self, row: int) -> bool:
        """Return whether a row is a control vector: a point at infinity."""
        return bool(self.net[row, 3] == 0 and self.net[row, :3].any())

    def name(self, row: int) -> str:
        """Return the indices of a point."""
        if self.curve:
            return f"{row}"
        return "".join(str(i) for i in bernstein.multi_indices(self.degree)[row].tolist())

    def legs(self) -> list[tuple[int, int]]:
        """Return the pairs of rows that legs of the net, or of the polygon, join."""
        if self.curve:
            return [(k, k + 1) for k in range(self.degree)]
        return [(a, b) for a, b in bernstein.net_edges(self.degree).tolist()]

    def _row(self, row: int) -> int:
        if not (isinstance(row, (int, np.integer)) and 0 <= row < len(self.net)):
            raise GeometryError.expected("row", f"0 to {len(self.net) - 1}", row)
        return int(row)

    def _remember(self) -> None:
        now = self.net.copy(), self._places.copy(), self.anchor.copy(), self.curve
        self._past = [*self._past[-HISTORY + 1 :], now]
        self._weighed = None

    def _changed(self) -> None:
        self.version += 1

    def move(self, row: int, place: Any, remember: bool = True) -> None:
        """Move a control point; its weight stays, and a control vector stays one."""
        k, x = self._row(row), np.asarray(place, dtype=np.float64)
        if x.shape != (3,) or not np.isfinite(x).all():
            raise GeometryError.expected("place", "three finite numbers", f"{place}")
        w = self.net[k, 3]
        moved = x - self.anchor if self.is_vector(k) else w * x
        if w == 0 and self.is_vector(k) and not moved.any():
            raise GeometryError.expected("place", "a vector that is not zero", "the zero vector")
        if remember:
            self._remember()
        self.net[k, :3] = moved
        self._places[k] = x
        self._weighed = None
        self._changed()

    def weigh(self, row: int, weight: float, remember: bool = True) -> None:
        """Give a control point a weight; 0 takes it out, and any other brings it back.

        Changes of one weight, one after the other, are one step back.

        Raises
        ------
        GeometryError
            If all points would be taken out, or it is no number.
        """
        k, w = self._row(row), number(weight, "weight")
        net = self.net.copy()
        net[k] = np.append(w * self._places[k], w)
        if not net.any():
            raise GeometryError.expected("weight", "a net with a point in it", "none left")
        if remember and self._weighed != k:
            self._remember()
        self._weighed = k
        self.net = net
        self._changed()

    def elevate(self) -> None:
        """Raise the degree: the same surface with more control points."""
        net = self.shape.elevate().control_points
        self._remember()
        self._set(net if self.curve else net[0], self.curve)

    def lower(self) -> float:
        """Lower the degree: the same surface if it has a smaller net, else one near to it.

        Returns
        -------
        float
            How far the nearest net is from this one, in homogeneous coordinates, of its size: 0 if
            the surface is the same.

        Raises
        ------
        GeometryError
            If the degree is 1.
        """
        n = self.degree
        if n == 1:
            raise GeometryError.expected("degree", "at least 1", n - 1)
        if self.curve:
            k = np.arange(n + 1)
            up = np.zeros((n + 1, n))
            up[k[1:], k[1:] - 1] = k[1:] / n
            up[k[:-1], k[:-1]] = 1 - k[:-1] / n
        else:
            up = np.asarray(bernstein.elevation_matrix(n - 1))
        net = np.linalg.lstsq(up, self.net, rcond=None)[0]
        left = float(np.abs(up @ net - self.net).max() / np.abs(self.net).max())
        net = self._checked(np.where(np.abs(net) < 1e-12 * np.abs(net).max(), 0.0, net), self.curve)
        self._remember()
        self._set(net, self.curve)
        return left

    def load(self, net: Any, curve: bool = False) -> None:
        """Take another net; the one before is a step back."""
        fresh = self._checked(net, curve)
        self._remember()
        self._set(fresh, curve)

    def undo(self) -> bool:
        """Go one step back; return whether there was one."""
        if not self._past:
            return False
        self.net, self._places, self.anchor, self.curve = self._past.pop()
        self._weighed = None
        self._changed()
        return True
