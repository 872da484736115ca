"""Convert polygons of a file together, grouped by their number of corners."""

from __future__ import annotations

import numpy as np

from .report import Collector
from .tensor_nets import fans

__all__ = ["PolygonFaces"]

_CHUNK = 1 << 16  # corners at a time: the tests take some 300 bytes a corner


class PolygonFaces:
    """Gathers polygons while a file is read."""

    def __init__(self) -> None:
        self._found: dict[int, list[tuple[int, np.ndarray]]] = {}

    def add(self, number: int, corners: np.ndarray) -> None:
        """Add face `number` of the file, of homogeneous corners ``(m, 4)``."""
        self._found.setdefault(len(corners), []).append((number, corners))

    def convert(self, collector: Collector) -> None:
        """Enter all of them in a model, or the reasons why not."""
        refused: list[tuple[int, str]] = []
        for m, found in self._found.items():
            if m < 3:
                refused += [(k, "polygon of fewer than three corners") for k, _corners in found]
                continue
            collector.expect(3 * (m - 2) * len(found))
            step = max(1, _CHUNK // m)
            for at in range(0, len(found), step):
                numbers = np.array([number for number, _corners in found[at : at + step]])
                nets, convex = fans(np.array([corners for _n, corners in found[at : at + step]]))
                if convex.any():
                    kept = nets[convex].reshape(-1, 3, 4)
                    collector.add(kept, np.repeat(numbers[convex], m - 2))
                    collector.report.accept(int(convex.sum()))
                reason = "polygon that is not convex, or without area"
                refused += [(int(k), reason) for k in numbers[~convex]]
        for number, reason in sorted(refused):
            collector.report.refuse(f"face {number}", reason)
