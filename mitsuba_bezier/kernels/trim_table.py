"""The tables of trims on the device: what `trim.keep` reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.trim_cells import HEAD, TrimCells
from .arrays import types_of, upload

__all__ = ["TrimTable", "build_table"]


@dataclass
class TrimTable:
    """The tables of `TrimCells` on the device of one array type."""

    cells: Any  #: Float32, x `CELL`
    lists: Any  #: Float32, x `LIST`
    heads: Any  #: Float32, x 16
    curves: Any  #: Float32, x 3 (degree + 1), padded to packets of eight
    degree: int
    arcs: bool
    bytes: int


def build_table(found: TrimCells, like: Any) -> TrimTable:
    """Pack `found` for the array types of `like` (a Dr.Jit float array or type)."""
    ty = types_of(like)
    cells = found.cells.astype(np.float32)
    cells[:, 10:12] = found.cells[:, 10:12].astype(np.uint32).view(np.float32)
    pieces = found.pieces if len(found.pieces) else np.zeros((1, found.pieces.shape[1]))
    heads = np.zeros((len(pieces), 16), dtype=np.float32)
    heads[:, :HEAD] = pieces[:, :HEAD]
    width = pieces.shape[1] - HEAD
    curves = np.zeros((len(pieces), -(-width // 8) * 8), dtype=np.float32)
    curves[:, :width] = pieces[:, HEAD:]
    return TrimTable(
        cells=upload(ty.Float32, cells),
        lists=upload(ty.Float32, found.lists.astype(np.uint32).view(np.float32)),
        heads=upload(ty.Float32, heads),
        curves=upload(ty.Float32, curves),
        degree=found.degree,
        arcs=found.arcs,
        bytes=cells.nbytes + 4 * found.lists.size + heads.nbytes + curves.nbytes,
    )
