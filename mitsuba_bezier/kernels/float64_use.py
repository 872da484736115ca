"""Whether kernels use float64 where float32 is too coarse, or pairs of float32 in its place."""

from __future__ import annotations

import os
from typing import Any

import drjit as dr

from ..errors import BezierError

__all__ = ["VARIABLE", "float64", "set_float64", "uses_pairs"]

#: What is used until `set_float64` is called.
VARIABLE = "MITSUBA_BEZIER_FLOAT64"
CHOICES = ("auto", "always", "never")
#: Compute capabilities of NVIDIA's chips with half as many units for float64 as for float32; all
#: others have a 32nd or a 64th part of them.
_FAST = (60, 70, 80, 90, 100)

_chosen: str | None = None


def set_float64(use: str) -> None:
    """Choose whether kernels use float64 where float32 is too coarse.

    Holds for structures that are built from now on; those of scenes are built again at the next
    ray. The variable ``MITSUBA_BEZIER_FLOAT64`` is what holds before.

    Parameters
    ----------
    use : str
        ``"always"``; ``"never"``: pairs of float32 in its place, of 48 bits; or ``"auto"``, as it
        is from the start: never on Metal, which has none, and on consumers' GPUs of NVIDIA, on
        which it is 32 or 64 times as slow as float32. Variants with float64 throughout, as
        ``llvm_ad_rgb_double``, always use it.

    Raises
    ------
    BezierError
        If it is another word.

    Examples
    --------
    >>> mb.set_float64("never")
    >>> mb.float64()
    'never'
    >>> mb.set_float64("auto")
    """
    global _chosen
    _chosen = _checked("use", use)


def float64() -> str:
    """Return what `set_float64` was told, or the environment.

    Raises
    ------
    BezierError
        If the environment has another word than those.

    Examples
    --------
    >>> mb.float64()
    'auto'
    """
    if _chosen is not None:
        return _chosen
    return _checked(VARIABLE, os.environ.get(VARIABLE) or "auto")


def _checked(name: str, use: Any) -> str:
    if use not in CHOICES:
        raise BezierError.expected(name, " or ".join(map(repr, CHOICES)), repr(use))
    return str(use)


def uses_pairs(like: Any) -> bool:
    """Return whether kernels for an array, or array type, use pairs of float32."""
    number = dr.leaf_t(like)
    if dr.type_v(number) == dr.VarType.Float64:
        return False
    backend, use = dr.backend_v(number), float64()
    if backend == dr.JitBackend.Metal:
        if use == "always":
            raise BezierError.expected(VARIABLE, "'auto' or 'never' on Metal", "'always'")
        return True
    if use == "auto":
        return backend == dr.JitBackend.CUDA and (dr.detail.cuda_compute_capability() not in _FAST)
    return use == "never"
