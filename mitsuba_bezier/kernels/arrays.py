"""Array types derived from the arguments, so that one kernel serves LLVM and CUDA."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import numpy as np

from ..errors import BezierError

__all__ = [
    "Types",
    "dot3",
    "four_zeros",
    "gather_packets",
    "gather_row",
    "inverse_root",
    "reciprocal",
    "types_of",
    "upload",
]


@dataclass(frozen=True)
class Types:
    """The detached array types that belong to one float type."""

    Float: Any
    UInt: Any
    Bool: Any
    Float64: Any
    Float32: Any


@cache
def _vector_of(float_type: Any) -> Any:
    """Return the dynamic vector type over a flat float type, with derivatives if it has them."""
    name = "ArrayXf64" if float_type is dr.float64_array_t(float_type) else "ArrayXf"
    return getattr(sys.modules[float_type.__module__], name)


@cache
def _types(float_type: Any) -> Types:
    float_type = dr.detached_t(float_type)
    return Types(
        Float=float_type,
        UInt=dr.uint32_array_t(float_type),
        Bool=dr.mask_t(float_type),
        Float64=dr.float64_array_t(float_type),
        Float32=dr.float32_array_t(float_type),
    )


def types_of(value: Any) -> Types:
    """Return the types for a Dr.Jit array or array type (its scalar leaf type counts)."""
    leaf = dr.leaf_t(value)
    return _types(leaf)


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


def gather_row(buffer: Any, row: Any, active: Any = True) -> list[Any]:
    """Gather four consecutive values at ``4 * row``, in one packet."""
    vector = _vector_of(dr.leaf_t(buffer))
    values = dr.gather(vector, buffer, row, active, shape=(4, dr.width(row)))
    return [values[i] for i in range(4)]


def four_zeros(number: Any) -> list[Any]:
    """Return four zeros: a row of a net in which nothing is summed up yet."""
    return [dr.zeros(number) for _ in range(4)]


def dot3(a: Any, b: Any) -> Any:
    """Return ``a . b`` of two sequences of three arrays, fused."""
    return dr.fma(a[0], b[0], dr.fma(a[1], b[1], a[2] * b[2]))


def reciprocal(x: Any) -> Any:
    """Return ``1 / x``, for float64 to its last digit.

    There `dr.rcp` is CUDA's ``rcp.approx.ftz.f64``, of 20 bits; and so it is in all that Dr.Jit
    makes of it: `dr.rsqrt`, `dr.normalize`, `dr.tan`, `dr.tanh`.
    """
    return 1.0 / x if _is_float64(x) else dr.rcp(x)


def inverse_root(x: Any) -> Any:
    """Return ``1 / sqrt(x)``; see `reciprocal`."""
    return 1.0 / dr.sqrt(x) if _is_float64(x) else dr.rsqrt(x)


def _is_float64(x: Any) -> bool:
    return bool(dr.type_v(x) == dr.VarType.Float64)
