"""Numbers of 48 bits as unevaluated sums of two float32, where there is no fast float64, or none.

Dekker, "A floating-point technique for extending the available precision" (1971); Knuth's sum;
bounds by Joldes, Muller and Popescu, "Tight and rigorous error bounds for basic building blocks of
double-word arithmetic" (2017). With ``u = 2^-24``, a rounding of float32, products are off by
4 u^2, quotients and roots by some 15 u^2, sums by 3 u^2, and a fused sum `fma` by some 6 u^2 of the
larger of its terms. The exponents are those of float32: what overflows is NaN, and of products
below 1e-30 the second number is lost to the flush to zero.

`fma`, `select` and the other functions here take plain numbers of Dr.Jit as well, and do with them
what Dr.Jit does: one code serves both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

__all__ = [
    "TwoFloat",
    "absolute",
    "clip",
    "coarse",
    "copysign",
    "fma",
    "full",
    "maximum",
    "minimum",
    "select",
    "split",
    "sqrt",
    "two_prod",
    "two_sum",
]

#: Added to products on CUDA and Metal, where it counts as zero: neither Dr.Jit nor the assembler
#: knows that, so none of them fuses the product with a sum that follows it.
_NOTHING = 1e-45


def two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """Return ``a + b``, rounded, and what the rounding took away."""
    s = a + b
    of_b = s - a
    return s, (a - (s - of_b)) + (b - of_b)


def _fast_two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """Return what `two_sum` does, for ``|a| >= |b|``."""
    s = a + b
    return s, b - (s - a)


def two_prod(a: Any, b: Any) -> tuple[Any, Any]:
    """Return ``a b``, rounded, and what the rounding took away."""
    p = a * b
    if dr.is_jit_v(p) and dr.backend_v(p) != dr.JitBackend.LLVM:
        p = dr.fma(a, b, _NOTHING)
    return p, dr.fma(a, b, -p)


def split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return float64 numbers as the nearest float32 and the nearest to what is left."""
    hi = np.asarray(values, dtype=np.float64).astype(np.float32)
    with np.errstate(invalid="ignore"):
        lo = np.where(np.isfinite(hi), values - hi.astype(np.float64), 0.0)
    return hi, lo.astype(np.float32)


@dataclass(eq=False)
class TwoFloat:
    """A number ``hi + lo``, `hi` being the float32 that is nearest to it.

    Operators take plain numbers, too; a Python number is split. Comparisons are exact.
    """

    hi: Any
    lo: Any = None  #: None: zero for certain. Not so in the state of a loop, see `full`

    @staticmethod
    def of(x: Any) -> TwoFloat:
        """Return a number, of Python, Dr.Jit or of two floats already, without rounding it."""
        if isinstance(x, TwoFloat):
            return x
        if isinstance(x, (int, float)):
            hi = float(np.float32(x))
            return TwoFloat(hi, (x - hi) or None)
        return TwoFloat(x)

    @staticmethod
    def zeros(number: Any) -> TwoFloat:
        """Return zero, in the type `number`."""
        return TwoFloat(dr.zeros(number), dr.zeros(number))

    def full(self) -> TwoFloat:
        """Return the same with both numbers, as the state of a loop needs it."""
        return self if self.lo is not None else TwoFloat(self.hi, dr.zeros(type(self.hi)))

    def __neg__(self) -> TwoFloat:
        return TwoFloat(-self.hi, None if self.lo is None else -self.lo)

    def __add__(self, other: Any) -> TwoFloat:
        y = TwoFloat.of(other)
        s, rest = two_sum(self.hi, y.hi)
        if self.lo is None and y.lo is None:
            return TwoFloat(s, rest)
        if self.lo is None or y.lo is None:
            return TwoFloat(*_fast_two_sum(s, rest + (y.lo if self.lo is None else self.lo)))
        low, least = two_sum(self.lo, y.lo)
        s, rest = _fast_two_sum(s, rest + low)
        return TwoFloat(*_fast_two_sum(s, rest + least))

    def __sub__(self, other: Any) -> TwoFloat:
        return self + -TwoFloat.of(other)

    def __rsub__(self, other: Any) -> TwoFloat:
        return TwoFloat.of(other) + -self

    def __mul__(self, other: Any) -> TwoFloat:
        y = TwoFloat.of(other)
        p, rest = _product(self, y)
        if self.lo is None and y.lo is None:
            return TwoFloat(p, rest)
        return TwoFloat(*_fast_two_sum(p, rest))

    def __truediv__(self, other: Any) -> TwoFloat:
        y = TwoFloat.of(other)
        q = self.hi / y.hi
        rest = fma(-q, y, self).hi
        return TwoFloat(*_fast_two_sum(q, rest / y.hi))

    def __rtruediv__(self, other: Any) -> TwoFloat:
        return TwoFloat.of(other) / self

    __radd__, __rmul__ = __add__, __mul__

    def __lt__(self, other: Any) -> Any:
        y = TwoFloat.of(other)
        a, b = _low(self), _low(y)
        return (self.hi < y.hi) | ((self.hi == y.hi) & (a < b))

    def __le__(self, other: Any) -> Any:
        y = TwoFloat.of(other)
        a, b = _low(self), _low(y)
        return (self.hi < y.hi) | ((self.hi == y.hi) & (a <= b))

    def __gt__(self, other: Any) -> Any:
        return -self < -TwoFloat.of(other)

    def __ge__(self, other: Any) -> Any:
        return -self <= -TwoFloat.of(other)


def _low(x: TwoFloat) -> Any:
    return dr.zeros(type(x.hi)) if x.lo is None else x.lo


def _product(x: TwoFloat, y: TwoFloat) -> tuple[Any, Any]:
    """Return the product of the first numbers, rounded, and all the rest of the product."""
    p, rest = two_prod(x.hi, y.hi)
    if x.lo is not None:
        rest = dr.fma(x.lo, y.hi, rest)
    if y.lo is not None:
        rest = dr.fma(x.hi, y.lo, rest)
    return p, rest


def _any(*numbers: Any) -> bool:
    return any(isinstance(x, TwoFloat) for x in numbers)


def fma(a: Any, b: Any, c: Any) -> Any:
    """Return ``a b + c``."""
    if not _any(a, b, c):
        return dr.fma(a, b, c)
    c = TwoFloat.of(c)
    p, rest = _product(TwoFloat.of(a), TwoFloat.of(b))
    s, least = two_sum(p, c.hi)
    rest = least + (rest if c.lo is None else rest + c.lo)
    return TwoFloat(*_fast_two_sum(s, rest))


def coarse(x: Any) -> Any:
    """Return the first of two floats: what slopes need that correct a number by little."""
    return x.hi if isinstance(x, TwoFloat) else x


def full(x: Any) -> Any:
    """Return a number as the state of a loop needs it, see `TwoFloat.full`."""
    return x.full() if isinstance(x, TwoFloat) else x


def select(mask: Any, a: Any, b: Any) -> Any:
    """Return `a` where the mask is set and `b` elsewhere."""
    if not _any(a, b):
        return dr.select(mask, a, b)
    a, b = TwoFloat.of(a), TwoFloat.of(b)
    hi = dr.select(mask, a.hi, b.hi)
    if a.lo is None and b.lo is None:
        return TwoFloat(hi)
    zero = dr.zeros(type(hi))
    x, y = (zero if z.lo is None else z.lo for z in (a, b))
    return TwoFloat(hi, dr.select(mask, x, y))


def absolute(x: Any) -> Any:
    """Return the magnitude."""
    return select(x.hi < 0.0, -x, x) if _any(x) else dr.abs(x)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger one."""
    return select(TwoFloat.of(a) < b, b, a) if _any(a, b) else dr.maximum(a, b)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller one."""
    return select(TwoFloat.of(b) < a, b, a) if _any(a, b) else dr.minimum(a, b)


def clip(x: Any, low: Any, high: Any) -> Any:
    """Return the nearest number between `low` and `high`."""
    return maximum(minimum(x, high), low) if _any(x, low, high) else dr.clip(x, low, high)


def copysign(a: Any, sign: Any) -> Any:
    """Return the magnitude of `a` with the sign of another number; neither is zero."""
    if not _any(a):
        return dr.copysign(a, coarse(sign))
    return select((a.hi < 0.0) ^ (coarse(sign) < 0.0), -a, a)


def sqrt(x: Any) -> Any:
    """Return the root; NaN of negative numbers."""
    if not _any(x):
        return dr.sqrt(x)
    root = dr.sqrt(x.hi)
    rest = dr.fma(-root, root, x.hi)
    rest = rest if x.lo is None else rest + x.lo
    more = dr.select(root == 0.0, 0.0, rest / (2.0 * root))
    return TwoFloat(*_fast_two_sum(root, more))
