"""Array types derived from the arguments, so that one kernel serves LLVM and CUDA."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import numpy as np

from ..errors import BezierError
from .two_float import TwoFloat, fma, split

__all__ = [
    "Types",
    "dot3",
    "four_zeros",
    "gather_packets",
    "gather_row",
    "gather_row_wide",
    "gather_wide",
    "inverse_root",
    "reciprocal",
    "types_of",
    "upload",
    "upload_wide",
]


#: Where rays without an end end, for pairs of float32.
_FAR = 1e25


@dataclass(frozen=True)
class Types:
    """The detached array types that belong to one float type.

    What float32 is too coarse for is *wide*: float64, or a `TwoFloat` if `pairs` is set.
    """

    Float: Any
    UInt: Any
    Bool: Any
    Float64: Any
    Float32: Any
    pairs: bool = False

    def widen(self, x: Any) -> Any:
        """Return a number as a wide one."""
        return TwoFloat.of(x) if self.pairs else self.Float64(x)

    def narrow(self, x: Any) -> Any:
        """Return the nearest `Float` to a number, wide or not."""
        return x.hi if isinstance(x, TwoFloat) else self.Float(x)

    def widen_end(self, t: Any) -> Any:
        """Return the end of a ray as a wide number; none of two floats is infinite."""
        return TwoFloat(dr.minimum(t, _FAR)) if self.pairs else self.Float64(t)

    def wide_zero(self) -> Any:
        """Return zero as a wide number, for the state of a loop."""
        return TwoFloat.zeros(self.Float) if self.pairs else dr.zeros(self.Float64)

    def wide_opaque(self, x: float) -> Any:
        """Return a number that is data of kernels, not code, as a wide one."""
        if not self.pairs:
            return dr.opaque(self.Float64, x)
        return TwoFloat(*(dr.opaque(self.Float32, float(part)) for part in split(np.array(x))))

    def whole(self, x: Any) -> Any:
        """Return the integer that a wide number is, as `UInt`; negative ones, too."""
        integer = dr.int32_array_t(self.UInt)
        if not isinstance(x, TwoFloat):
            return self.UInt(integer(x))
        # beyond 2^24 the second of two floats has a part of it, with either sign
        return self.UInt(integer(x.hi) + (0 if x.lo is None else integer(x.lo)))


@cache
def _vector_of(float_type: Any) -> Any:
    """Return the dynamic vector type over a flat float type, with derivatives if it has them."""
    name = "ArrayXf64" if _is_float64(float_type) else "ArrayXf"
    return getattr(sys.modules[float_type.__module__], name)


@cache
def _types(float_type: Any, pairs: bool) -> Types:
    float_type = dr.detached_t(float_type)
    return Types(
        Float=float_type,
        UInt=dr.uint32_array_t(float_type),
        Bool=dr.mask_t(float_type),
        Float64=None if _lacks_float64(float_type) else dr.float64_array_t(float_type),
        Float32=dr.float32_array_t(float_type),
        pairs=pairs,
    )


def types_of(value: Any, pairs: bool = False) -> Types:
    """Return the types for a Dr.Jit array or array type (its scalar leaf type counts)."""
    leaf = dr.leaf_t(value)
    return _types(leaf, pairs)


def upload(array_type: Any, values: np.ndarray) -> Any:
    """Copy a NumPy array to a flat Dr.Jit array in memory that Dr.Jit allocated.

    Packet gathers need 64-byte alignment and silently fall back without it; an array made
    straight from NumPy may alias memory that has less. What is copied is aligned, too: Dr.Jit
    would compile the copy anew for each alignment that NumPy happens to have.

    Raises
    ------
    BezierError
        While a function is frozen: Dr.Jit would end the process.
    """
    if dr.flag(dr.JitFlag.FreezingScope):
        raise BezierError(
            "dr.freeze: expected a function that ran once before it was frozen, and after each "
            "change of a shape, so that all tables are on the device; got a new one"
        )
    values = np.asarray(values)
    memory = np.empty(values.nbytes + 64, dtype=np.uint8)
    first = -memory.ctypes.data % 64
    flat = memory[first : first + values.nbytes].view(values.dtype)
    flat[:] = values.reshape(-1)
    result = dr.zeros(array_type, flat.size)
    dr.scatter(result, array_type(flat), dr.arange(dr.uint32_array_t(array_type), flat.size))
    dr.eval(result)
    return result


def upload_wide(ty: Types, values: np.ndarray, packet: int = 8) -> Any:
    """Copy float64 numbers to the device, for `gather_wide`.

    They come in packets; as two floats each is followed by one of all second numbers.
    """
    if not ty.pairs:
        return upload(ty.Float64, values)
    hi, lo = split(values.reshape(-1, packet))
    return upload(ty.Float32, np.stack([hi, lo], axis=1))


def gather_wide(
    buffer: Any, index: Any, count: int, active: Any = True, stride: int | None = None
) -> list[Any]:
    """Do what `gather_packets` does where `upload_wide` copied numbers to."""
    if _is_float64(buffer):
        return gather_packets(buffer, index, count, active, stride)
    packets = -(-count // 8)
    stride = packets if stride is None else stride
    numbers = gather_packets(buffer, index, 16 * packets, active, 2 * stride)
    pairs = [TwoFloat(numbers[k + k - k % 8], numbers[k + k - k % 8 + 8]) for k in range(count)]
    return pairs


def gather_packets(
    buffer: Any, index: Any, count: int, active: Any = True, stride: int | None = None
) -> list[Any]:
    """Gather `count` consecutive values of a record, in packets of at most eight.

    Parameters
    ----------
    buffer : flat array, a whole number of packets long
    index : UInt
        Index of the record.
    count : int
        Number of values wanted.
    stride : int, optional
        Packets from one record to the next; as many as hold `count` values if not given.

    Returns
    -------
    list of `count` arrays
    """
    vector = _vector_of(dr.leaf_t(buffer))
    packets = -(-count // 8)
    stride = packets if stride is None else stride
    out: list[Any] = []
    for p in range(packets):
        shape = (8, dr.width(index))
        values = dr.gather(vector, buffer, index * stride + p, active, shape=shape)
        out.extend(values[i] for i in range(8))
    return out[:count]


def gather_row_wide(buffer: Any, row: Any, active: Any = True) -> list[Any]:
    """Do what `gather_row` does where `upload_wide` copied packets of four to."""
    if _is_float64(buffer):
        return gather_row(buffer, row, active)
    numbers = gather_packets(buffer, row, 8, active)
    return [TwoFloat(*pair) for pair in zip(numbers[:4], numbers[4:])]


def gather_row(buffer: Any, row: Any, active: Any = True) -> list[Any]:
    """Gather four consecutive values at ``4 * row``, in one packet."""
    vector = _vector_of(dr.leaf_t(buffer))
    values = dr.gather(vector, buffer, row, active, shape=(4, dr.width(row)))
    return [values[i] for i in range(4)]


def four_zeros(like: Any) -> list[Any]:
    """Return four zeros of a number's type: a row of a net in which nothing is summed up yet."""
    if isinstance(like, TwoFloat):
        return [TwoFloat.zeros(type(like.hi)) for _ in range(4)]
    return [dr.zeros(type(like)) for _ in range(4)]


def dot3(a: Any, b: Any) -> Any:
    """Return ``a . b`` of two sequences of three arrays, fused."""
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))


def reciprocal(x: Any) -> Any:
    """Return ``1 / x``, for float64 to its last digit.

    There `dr.rcp` is CUDA's ``rcp.approx.ftz.f64``, of 20 bits; and so it is in all that Dr.Jit
    makes of it: `dr.rsqrt`, `dr.normalize`, `dr.tan`, `dr.tanh`.
    """
    return 1.0 / x if isinstance(x, TwoFloat) or _is_float64(x) else dr.rcp(x)


def inverse_root(x: Any) -> Any:
    """Return ``1 / sqrt(x)``; see `reciprocal`."""
    return 1.0 / dr.sqrt(x) if _is_float64(x) else dr.rsqrt(x)


def _lacks_float64(x: Any) -> bool:
    return bool(dr.backend_v(x) == dr.JitBackend.Metal)


def _is_float64(x: Any) -> bool:
    return bool(dr.type_v(x) == dr.VarType.Float64)
