"""What the studio shows: one net of points and weights, with its history."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry import bernstein
from ..geometry.covers import sphere
from ..geometry.projective import number, point
from ..geometry.quadrics import quadric_patch
from ..geometry.triangles import BezierTriangles

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


def _hill() -> np.ndarray:
    base = np.array([[0, 1.15, 0], [-1.15, -0.75, 0], [1.15, -0.75, 0]])
    x = bernstein.multi_indices(3) / 3 @ base
    x[:, 2] = [0.25, 0.7, 0.55, 0.65, 1.15, 0.55, 0.1, 0.6, 0.7, 0.25]
    return point(x)


def _on_sphere() -> np.ndarray:
    s = np.array([-0.7, -np.sqrt(1 - 0.49 - 0.25), 0.5])
    x = np.array([[0.1, -0.95, -0.3], [0.95, -0.2, -0.1], [0.3, -0.35, 0.89]])
    x /= np.linalg.norm(x, axis=1)[:, None]
    return quadric_patch(np.diag([1.0, 1, 1, -1]), point(s), point(x))


def _quadratic() -> np.ndarray:
    return point(
        [[0, 1.2, 0.5], [-0.75, 0.3, 0.9], [0.75, 0.3, 0.6], [-1.2, -0.8, 0.1], [0, -0.9, 1.5],
         [1.2, -0.8, 0.1]]
    )  # fmt: skip


#: Nets that the page offers: of the lecture's figures.
PRESETS: dict[str, Callable[[], np.ndarray]] = {
    "rational quadratic": _quadratic,
    "cubic hill": _hill,
    "on the sphere": _on_sphere,
    "octant of the sphere": lambda: sphere().control_points[0],
}


class State:
    """One Bézier triangle whose points and weights change, with undo.

    Parameters
    ----------
    net : (K, 4) array_like
        Homogeneous control points. Control vectors and points of weight 0 keep their rows.

    Raises
    ------
    NetError
        If it is no net.
    """

    def __init__(self, net: Any) -> None:
        self.net = BezierTriangles(net).control_points[0].copy()
        # where a point of weight 0 is, if it had one before
        self._places = np.where(self.net[:, 3:] != 0, self._affine(self.net), self.net[:, :3])
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        self.version = 0

    @staticmethod
    def _affine(net: np.ndarray) -> np.ndarray:
        w = np.where(net[:, 3:] != 0, net[:, 3:], 1.0)
        return net[:, :3] / w

    @property
    def degree(self) -> int:
        """The degree."""
        return bernstein.degree_of(len(self.net))

    @property
    def patches(self) -> BezierTriangles:
        """The patch."""
        return BezierTriangles(self.net)

    @property
    def places(self) -> np.ndarray:
        """Where the points are, ``(K, 3)``; of a control vector, its tip."""
        return self._places

    def _row(self, row: int) -> int:
        if not (isinstance(row, (int, np.integer)) and 0 <= row < len(self.net)):
            raise GeometryError.expected("row", f"0 to {len(self.net) - 1}", row)
        return int(row)

    def _remember(self) -> None:
        self._past = [*self._past[-HISTORY + 1 :], (self.net.copy(), self._places.copy())]

    def _changed(self) -> None:
        self.version += 1

    def move(self, row: int, place: Any, remember: bool = True) -> None:
        """Move a control point; its weight stays, and a control vector stays one."""
        k, x = self._row(row), np.asarray(place, dtype=np.float64)
        if x.shape != (3,) or not np.isfinite(x).all():
            raise GeometryError.expected("place", "three finite numbers", f"{place}")
        if remember:
            self._remember()
        w = self.net[k, 3]
        vector = w == 0 and self.net[k, :3].any()
        self.net[k, :3] = x if vector else w * x
        self._places[k] = x
        self._changed()

    def weigh(self, row: int, weight: float, remember: bool = True) -> None:
        """Give a control point a weight; 0 takes it out, and any other brings it back.

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
        if remember:
            self._remember()
        self.net = net
        self._changed()

    def elevate(self) -> None:
        """Raise the degree: the same surface with more control points."""
        self._remember()
        self._set(self.patches.elevate().control_points[0])

    def load(self, net: Any) -> None:
        """Take another net; the one before is a step back."""
        fresh = BezierTriangles(net).control_points[0].copy()
        self._remember()
        self._set(fresh)

    def _set(self, net: np.ndarray) -> None:
        self.net = net.copy()
        self._places = np.where(net[:, 3:] != 0, self._affine(net), net[:, :3])
        self._changed()

    def undo(self) -> bool:
        """Go one step back; return whether there was one."""
        if not self._past:
            return False
        self.net, self._places = self._past.pop()
        self._changed()
        return True
