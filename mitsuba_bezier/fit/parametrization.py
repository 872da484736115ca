"""`Parametrization`: what is unknown of a parameter of a scene. `Values`: plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError
from ..geometry.checks import length
from ..geometry.triangles import BezierTriangles

__all__ = ["Parametrization", "Values", "as_patches", "assembled", "column", "spread", "tensor"]


class Parametrization:
    """Base of all parametrizations: unknown arrays, and the parameter that comes of them.

    A derived class gives `start`, `scales` and `value`. Unknowns are NumPy arrays of float64 in
    `minimize` and tensors of Dr.Jit in `value`, which is differentiable.

    Examples
    --------
    >>> import mitsuba as mi, numpy as np
    >>> mi.set_variant("llvm_ad_rgb")
    >>> from mitsuba_bezier import fit
    >>> class Cube(fit.Parametrization):  # a volume, of which the edge is searched
    ...     def start(self):
    ...         return {"edge": np.ones(1)}
    ...     def value(self, unknowns):
    ...         return unknowns["edge"] ** 3
    >>> def away(params, seed):
    ...     return (params["volume"].array - 8) ** 2
    >>> found = fit.minimize(None, {"volume": Cube()}, objective=away, method="l-bfgs")
    >>> found.unknowns["volume"]["edge"].round(4).tolist()
    [2.0]
    """

    #: Whether there are finer ones of the same surface.
    can_refine = False

    def start(self) -> dict[str, np.ndarray]:
        """Return the unknowns, by name, at which a search begins."""
        raise NotImplementedError(f"{type(self).__name__} has no method start")

    def scales(self) -> dict[str, float]:
        """Return by name how large a change of an unknown is a large one; 1 where not given.

        Searches count in these: a rate of 0.01 moves points by a hundredth of the surface's size.
        """
        return {}

    def value(self, unknowns: Mapping[str, Any]) -> Any:
        """Return the parameter of the scene for unknowns given as tensors of Dr.Jit."""
        raise NotImplementedError(f"{type(self).__name__} has no method value")

    def laplacian(self, name: str) -> Any:
        """Return the sparse graph Laplacian that couples the rows of an unknown, or None."""
        return None

    def refined(self, unknowns: Mapping[str, np.ndarray], how: str) -> Parametrization:
        """Return one with more unknowns that begins at the same surface.

        Parameters
        ----------
        unknowns : dict of str to array
            Where the search is.
        how : {"elevate", "split"}
            Raise the degree by one, or split each patch into four.

        Raises
        ------
        BezierError
            If this parametrization has no finer one.
        """
        raise BezierError.expected(
            "refine", "a parametrization that can be refined (Net)", type(self).__name__
        )

    def state(self) -> dict[str, np.ndarray]:
        """Return the arrays of which `restored` makes the same parametrization again."""
        return {}

    def restored(self, state: Mapping[str, np.ndarray]) -> Parametrization:
        """Return the parametrization of a checkpoint: as this one, after its refinements."""
        return self


class Values(Parametrization):
    """Plain numbers: a colour, an index of refraction, a curvature.

    Parameters
    ----------
    start : array_like
        Where the search begins; its shape is that of the parameter.
    positive : bool
        The logarithms are the unknowns.
    low, high : float, optional
        Bounds, which are kept by a logistic function. Both or none.
    scale : float, optional
        A large change; by default the largest number that is unknown, or 1. It does not count
        where the numbers are positive or bounded.
    only : sequence of int, optional
        Which entries are unknown, counted in C order; the others stay. By default all.

    Raises
    ------
    BezierError
        If numbers are not finite, not positive or not within the bounds, or `only` does not name
        entries, each once.

    Examples
    --------
    >>> from mitsuba_bezier import fit
    >>> fit.Values([0.2, 0.4, 0.5], low=0, high=1).start()["values"].round(2).tolist()
    [-1.39, -0.41, 0.0]
    >>> fit.Values([8.75, 0.5, 61.0], only=[-1]).start()["values"].tolist()
    [61.0]
    """

    def __init__(
        self,
        start: Any,
        positive: bool = False,
        low: float | None = None,
        high: float | None = None,
        scale: float | None = None,
        only: Any = None,
    ) -> None:
        self.whole = _numbers(start)
        self.only = None if only is None else _entries(only, self.whole.size)
        self.first = self.whole if self.only is None else self.whole.ravel()[self.only]
        if (low is None) != (high is None) or (positive and low is not None):
            raise BezierError.expected(
                "low, high", "both bounds or none, and none for positive numbers", (low, high)
            )
        if low is not None and high is not None and not -np.inf < low < high < np.inf:
            raise BezierError.expected("low, high", "finite bounds, low below high", (low, high))
        if positive and not (self.first > 0).all():
            raise BezierError.expected("start", "positive numbers", self.first.tolist())
        inside = low is None or high is None or ((self.first > low) & (self.first < high)).all()
        if not inside:
            raise BezierError.expected(
                "start", f"numbers between {low} and {high}", self.first.tolist()
            )
        if scale is not None:
            length("scale", scale)
        self.positive, self.low, self.high = positive, low, high
        plain = float(np.abs(self.first).max(initial=0.0)) or 1.0
        self.scale = (scale or plain) if not positive and low is None else 1.0

    def start(self) -> dict[str, np.ndarray]:
        if self.positive:
            return {"values": np.log(self.first)}
        if self.low is not None and self.high is not None:
            part = (self.first - self.low) / (self.high - self.low)
            return {"values": np.log(part / (1 - part))}
        return {"values": self.first.copy()}

    def scales(self) -> dict[str, float]:
        return {"values": self.scale}

    def value(self, unknowns: Mapping[str, Any]) -> Any:
        import drjit as dr

        x = unknowns["values"]
        if self.positive:
            x = dr.exp(x)
        elif self.low is not None and self.high is not None:
            x = self.low + (self.high - self.low) / (1 + dr.exp(-x))
        if self.only is None:
            return x + 0
        mi = import_mitsuba()
        out = tensor(self.whole)
        entries = mi.Float(out.array)
        dr.scatter(entries, x.array, mi.UInt32(self.only))
        return mi.TensorXf(entries, shape=self.whole.shape)


def _numbers(start: Any) -> np.ndarray:
    """Return an array of finite numbers, of which there are some."""
    try:
        numbers = np.array(start, dtype=np.float64)
    except (TypeError, ValueError):
        raise BezierError.expected("start", "finite numbers", repr(start)) from None
    if not numbers.size or not np.isfinite(numbers).all():
        raise BezierError.expected("start", "finite numbers", numbers.tolist())
    return numbers


def _entries(only: Any, count: int) -> np.ndarray:
    """Return the places of entries, counted from zero."""
    places = np.atleast_1d(np.asarray(only))
    if not (
        places.ndim == 1
        and places.size
        and np.issubdtype(places.dtype, np.integer)
        and ((-count <= places) & (places < count)).all()
        and len(np.unique(places % count)) == len(places)
    ):
        raise BezierError.expected("only", f"entries from 0 to {count - 1}, each once", only)
    return places % count


def as_patches(patches: Any) -> BezierTriangles:
    """Return patches that may be given as control points."""
    return patches if isinstance(patches, BezierTriangles) else BezierTriangles(patches)


def tensor(values: Any) -> Any:
    """Return an array as a tensor of Mitsuba's variant."""
    mi = import_mitsuba()
    values = np.asarray(values)
    return mi.TensorXf(np.ravel(values).astype(np.float64), shape=values.shape)


def column(values: Any, index: Any, width: int = 1, offset: int = 0) -> Any:
    """Return entries ``width * index + offset`` of a tensor as an array of Dr.Jit."""
    import drjit as dr

    mi = import_mitsuba()
    return dr.gather(mi.Float, values.array, mi.UInt32(width * np.asarray(index) + offset))


def spread(values: Any, entry: int, count: int) -> Any:
    """Return one entry of a tensor as an array of `count` equal numbers.

    Its derivative is then added up by one scatter. A number of width one would be reduced anew, by
    a kernel of its own, wherever it meets an array.
    """
    return column(values, np.full(count, entry))


def assembled(columns: Any, shape: tuple[int, ...]) -> Any:
    """Return the tensor of `shape` whose last axis has the given arrays as columns."""
    import drjit as dr

    mi = import_mitsuba()
    rows, width = int(np.prod(shape[:-1])), shape[-1]
    out = dr.zeros(mi.Float, rows * width)
    index = dr.arange(mi.UInt32, rows) * width
    for c, values in enumerate(columns):
        dr.scatter(out, mi.Float(values), index + c)
    return mi.TensorXf(out, shape=shape)
