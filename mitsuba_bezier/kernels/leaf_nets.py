"""Nets of graph leaves on the device, and what marches read beside them."""

from __future__ import annotations

from functools import cache
from typing import Any

import drjit as dr
import numpy as np

from ..leaves.nets import Powers
from ..leaves.records import BENDING_LIMIT, GraphLeaves
from .arrays import Types, upload, upload_wide
from .buckets import Bucket, Choice, Rows
from .net import graph_point, horner, rolled_horner
from .records import Record
from .two_float import TwoFloat, coarse, fma

__all__ = ["LeafNet", "build_buckets", "gather_net", "pack_bending"]


@cache
def net_record(number: type, powers: Powers | None, components: int, framed: bool) -> Record:
    """Return the layout of what marches read: bounds, start values, the coefficients of the net.

    These are elsewhere if there are no powers. The field `bending` is ``bending + BENDING_LIMIT *
    size``.
    """
    net: dict[str, Any] = {"frame": (4,)} if framed else {}
    if powers is not None:
        net["net"] = (powers.size * components,)
    return Record(number, variation=(), bending=(), start=(2, 3), **net)


def build_buckets(
    leaves: GraphLeaves, choices: list[Choice], number: type, ty: Types
) -> list[Bucket]:
    """Upload leaves that are in the order of their buckets.

    Parameters
    ----------
    number : type
        ``np.float32``, or ``np.float64`` for wide numbers: what nets are stored in.
    """
    out, first = [], 0

    def to_device(values: np.ndarray, packet: int) -> Any:
        if number is np.float64:
            return upload_wide(ty, values, packet)
        return upload(ty.Float32, values)

    for choice in choices:
        those = leaves.select(np.arange(first, first + len(choice.numbers)))
        fields: dict[str, Any] = {
            "variation": those.variation,
            "bending": pack_bending(those.bending, those.size),
            "start": those.start,
        }
        nets, powers = those.nets, choice.powers
        framed = bool(nets.is_framed.any())
        record = net_record(number, powers, choice.components, framed)
        if framed:
            fields["frame"] = nets.frame.reshape(-1, 4)
        rows = None
        if powers is None:
            p, q, n = nets.powers.T.astype(np.uint32)
            rows = Rows(
                rows=to_device(nets.rows.astype(number), 4),
                first=upload(ty.UInt, nets.first.astype(np.uint32)),
                powers=upload(ty.UInt, p | q << 8 | n << 16),
            )
        else:
            padded = nets.stored(powers)[:, :, : choice.components]
            fields["net"] = padded.reshape(len(those), *record.fields["net"])
        values = record.pack(len(those), **fields)
        if not len(values):
            values = np.zeros((1, record.size), number)
        out.append(
            Bucket(
                powers=powers,
                framed=framed,
                components=choice.components,
                first=dr.opaque(ty.UInt, first) if first else None,
                records=to_device(values, 8),
                by_rows=rows,
                is_wide=number is np.float64,
            )
        )
        first += len(choice.numbers)
    return out


class LeafNet:
    """What a march knows of a leaf's net."""

    def __init__(self, record: Any) -> None:
        self.variation, self.bending = coarse(record.variation), coarse(record.bending)
        self.start = [[coarse(x) for x in row] for row in record.start]
        #: What takes the parameters to the variables of the net, if it is not the identity
        self.frame = [coarse(x) for x in getattr(record, "frame", ())]

    def point(self, u: Any, v: Any, active: Any) -> tuple[tuple[Any, ...], ...]:
        """Return the point in the chart and its partials; see `net.graph_point`."""
        if not self.frame:
            p, pu, pv = self._jet(u, v, active)
            return graph_point(p, pu, pv, u, v)
        a, b, c, d = (type(coarse(u))(x) for x in self.frame)
        p, ps, pt = self._jet(fma(u, a, v * b), fma(u, c, v * d), active)
        pu = [dr.fma(a, s, c * t) for s, t in zip(ps, pt)]
        pv = [dr.fma(b, s, d * t) for s, t in zip(ps, pt)]
        return graph_point(p, pu, pv, u, v)

    def _jet(self, s: Any, t: Any, active: Any) -> tuple[list[Any], ...]:
        """Return the value of the net and its partials, by its own variables."""
        raise NotImplementedError


class _Whole(LeafNet):
    """A net that was read as a whole."""

    def __init__(self, record: Any, powers: Powers) -> None:
        super().__init__(record)
        self.net, self.powers = record.net, powers

    def _jet(self, s: Any, t: Any, active: Any) -> tuple[list[Any], ...]:
        net = self.net
        if not isinstance(s, TwoFloat):
            net = [type(s)(coarse(x)) for x in net]
        return horner(net, self.powers, s, t)


class _ByRows(LeafNet):
    """A net that is read row by row, each time."""

    def __init__(self, record: Any, nets: Rows, number: Any, active: Any) -> None:
        super().__init__(record)
        self.rows = nets.rows
        self.pairs = isinstance(record.variation, TwoFloat)
        self.first, word = (
            dr.gather(type(x), x, number, active) for x in (nets.first, nets.powers)
        )
        self.powers = word & 0xFF, (word >> 8) & 0xFF, word >> 16

    def _jet(self, s: Any, t: Any, active: Any) -> tuple[list[Any], ...]:
        return rolled_horner(self.rows, self.first, self.powers, s, t, active, self.pairs)


def gather_net(bucket: Bucket, index: Any, active: Any) -> LeafNet:
    """Gather nets by their numbers in a bucket, or where they are."""
    number = np.float64 if bucket.is_wide else np.float32
    layout = net_record(number, bucket.powers, bucket.components, bucket.framed)
    record = layout.gather(bucket.records, index, active)
    if bucket.powers is not None:
        return _Whole(record, bucket.powers)
    assert bucket.by_rows is not None
    return _ByRows(record, bucket.by_rows, index, active)


def pack_bending(bending: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return ``bending + BENDING_LIMIT * size``, rounded up to what float32 can hold.

    Parameters
    ----------
    bending : (L,) array
        At least 0, below `BENDING_LIMIT` where it matters.
    size : (L,) int array
        Index of `SIZES`.
    """
    # 2^-14: four bits for the size and four in front of the point leave it exact in 24
    steps = np.ceil(np.minimum(bending, BENDING_LIMIT - 2.0**-14) * 2.0**14)
    return steps / 2.0**14 + BENDING_LIMIT * size
