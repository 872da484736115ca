"""Records in device memory: packed by name in NumPy, read by name in kernels."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drjit as dr
import numpy as np

from ..leaves.records import LeafKind
from .arrays import gather_packets, gather_wide

__all__ = ["Record", "bits", "is_kind"]


def is_kind(values: Any, kind: LeafKind) -> Any:
    """Return a mask of leaves of a kind, by the field that says so."""
    return values == int(kind)  # Dr.Jit takes plain numbers only


class bits(tuple[int, ...]):
    """Shape of a field of unsigned integers, which a buffer of floats holds as their bits."""


class Record:
    """The layout of a record: its fields, one after the other, padded to packets of eight numbers.

    Parameters
    ----------
    number : type
        ``np.float32`` or ``np.float64``.
    fields : tuple of int
        The shape of each: ``()`` for one number, ``(3,)``, ``(3, 4)``; `bits` of a shape for
        integers.

    Examples
    --------
    >>> member = Record(np.float32, sides=(3, 4), leaf=bits(), least_sum=())
    >>> member.size
    16
    >>> member.pack(2, leaf=[5, 7])[:, 12].view(np.uint32).tolist()
    [5, 7]
    """

    def __init__(self, number: type, **fields: tuple[int, ...]) -> None:
        self.number = number
        self.fields = fields
        counts = [int(np.prod(shape, dtype=int)) for shape in fields.values()]
        ends = np.cumsum(counts).tolist()
        #: Where each field begins.
        self.first = dict(zip(fields, [0, *ends]))
        self._end = dict(zip(fields, ends))
        #: Numbers in a record.
        self.size: int = -(-ends[-1] // 8) * 8

    def pack(self, count: int, /, **values: Any) -> np.ndarray:
        """Return `count` records ``(count, size)`` of these values; what is not named is zero."""
        kinds = [
            (name, np.uint32 if isinstance(shape, bits) else self.number, tuple(shape))
            for name, shape in self.fields.items()
        ]
        rest = self.size - self._end[kinds[-1][0]]
        out = np.zeros(count, dtype=[*kinds, ("", self.number, (rest,))])
        for name, value in values.items():
            out[name] = value
        return out.view(self.number).reshape(count, self.size)

    def read(self, values: list[Any]) -> SimpleNamespace:
        """Return the fields of a record's numbers, or of the first of them, as attributes.

        Fields of some numbers are lists, those of a matrix lists of rows.
        """
        found = {}
        for name, shape in self.fields.items():
            if self._end[name] > len(values):
                break
            part = values[self.first[name] : self._end[name]]
            if isinstance(shape, bits):
                part = [dr.reinterpret_array(dr.uint32_array_t(x), x) for x in part]
            if len(shape) == 2:
                width = shape[1]
                found[name] = [part[r : r + width] for r in range(0, len(part), width)]
            else:
                found[name] = part if len(shape) else part[0]
        return SimpleNamespace(**found)

    def gather(
        self, buffer: Any, index: Any, active: Any = True, through: str | None = None
    ) -> SimpleNamespace:
        """Gather records by their number; see `read`.

        `through` is the last field that is wanted, if not all are.
        """
        count = self._end[through or next(reversed(self.fields))]
        gather_numbers = gather_wide if self.number is np.float64 else gather_packets
        wanted, packets = -(-count // 8), self.size // 8
        if wanted == packets:
            return self.read(gather_numbers(buffer, index, count, active))
        values = []
        for p in range(wanted):
            values += gather_numbers(buffer, index * packets + p, 8, active)
        return self.read(values[:count])
