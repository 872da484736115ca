"""Nets in buckets of their powers, so that what is of low degree does not pay for what is of high.

A bucket of few powers has code of its own: its nets are padded to these powers, and a net is read
as a whole. The last one may be of any degree: its nets are read row by row (`net.rolled_horner`),
and the code is the same for all. Compiling takes as long as there are buckets, so there are few.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..geometry import bernstein
from ..leaves.nets import Powers, counts_of

__all__ = ["UNROLLED", "Bucket", "Choice", "Rows", "by_bucket", "choose"]

#: Up to this degree, or as many powers, a net may have code of its own. Of 10, it takes the kernels
#: of a gradient 2 s more to compile than row by row, in 6; of 8 rays take half as long as row by
#: row.
UNROLLED = 8
#: A second bucket with code of its own has to save this share of the numbers in all nets, or more
#: if only components differ, as those of leaves of one patch with weights mostly do.
_WORTH, _WORTH_WEIGHTS = 0.05, 0.2
#: ... and beside nets that are read row by row this: with three buckets the kernel of a gradient
#: takes a second more to compile than with two.
_WORTH_BESIDE_ROWS = 0.4


@dataclass
class Bucket:
    """Nets that share their code."""

    powers: Powers | None  #: None: each has its own
    components: int  #: 4, or 3 where all weights are one
    first: Any  #: UInt, number of its first net, opaque; None: 0
    records: Any  #: what there is for each net
    framed: bool = False  #: whether the variables of some nets are not the parameters themselves
    by_rows: Rows | None = None  #: the nets, if `records` do not have them
    is_wide: bool = False  #: in wide numbers, see `Types`

    @property
    def degree(self) -> int | None:
        """The degree of all; None: each has its own."""
        return None if self.powers is None else self.powers.n

    @property
    def bytes(self) -> int:
        """Memory of all."""
        rows = self.by_rows
        arrays = [self.records, *([rows.rows, rows.first, rows.powers] if rows else [])]
        return sum(dr.width(x) * dr.itemsize_v(x) for x in arrays)


@dataclass
class Rows:
    """Nets of any degree, that are read row by row."""

    rows: Any  #: Float, four numbers a row
    first: Any  #: UInt, the first row of each net
    powers: Any  #: UInt, those of each net, eight bits each


@dataclass(frozen=True)
class Choice:
    """Which nets are to share their code."""

    powers: Powers | None  #: None: each keeps its own
    components: int
    numbers: np.ndarray  #: of the nets, rising

    @property
    def degree(self) -> int | None:
        """The degree to which they are raised."""
        return None if self.powers is None else self.powers.n


def choose(powers: np.ndarray, components: np.ndarray, unrolled: int | None = None) -> list[Choice]:
    """Choose buckets for nets that have these powers ``(L, 3)``, and 3 or 4 components.

    With as many as those of the degree `unrolled`, or `UNROLLED`, they may have code of their own.

    Returns
    -------
    list of Choice
        At least one, which is empty if there are no nets.
    """
    highest = UNROLLED if unrolled is None else unrolled
    counts = counts_of(powers)
    few = counts <= bernstein.size(highest)
    low, high = np.flatnonzero(few), np.flatnonzero(~few)
    numbers = counts[low] * components[low]
    order = np.argsort(numbers, kind="stable")
    cuts = np.flatnonzero(np.diff(numbers[order])) + 1
    alone = _cost(powers, components, [low])
    least, parts = alone, [low]
    for cut in cuts.tolist():
        two = [low[np.sort(order[:cut])], low[np.sort(order[cut:])]]
        alike = _highest(powers[two[0]]) == _highest(powers[two[1]])
        worth = max(_WORTH_WEIGHTS if alike else _WORTH, _WORTH_BESIDE_ROWS if len(high) else 0)
        cost = _cost(powers, components, two)
        if cost < min(least, (1 - worth) * alone):
            least, parts = cost, two
    out = [
        Choice(_highest(powers[part]), int(components[part].max()), part)
        for part in parts
        if len(part)
    ]
    if len(high):
        out.append(Choice(None, 4, high))
    return out or [Choice(Powers.whole(1), 3, low)]


def _highest(powers: np.ndarray) -> Powers:
    """Return powers that none of some exceed."""
    return Powers(*powers.max(axis=0).tolist())


def _cost(powers: np.ndarray, components: np.ndarray, parts: list[np.ndarray]) -> int:
    """Return how many numbers there are in nets, if these share their powers and components."""
    return sum(
        len(part) * _highest(powers[part]).size * int(components[part].max())
        for part in parts
        if len(part)
    )


def by_bucket(
    buckets: list[Bucket], number: Any, args: tuple[Any, ...], task: Callable[..., Any]
) -> Any:
    """Call ``task(bucket, number in it, *args)`` for the bucket of each net, by its number."""
    bucket, others = buckets[0], buckets[1:]

    def here(number: Any, *args: Any) -> Any:
        return task(bucket, number if bucket.first is None else number - bucket.first, *args)

    if not others:
        return here(number, *args)
    return dr.if_stmt(
        args=(number, *args),
        cond=number < others[0].first,
        true_fn=here,
        false_fn=lambda number, *args: by_bucket(others, number, args, task),
        label="bezier bucket",
    )
