"""`Problem`: the loss of a vector of unknowns, and its gradient."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError
from .optimizers import Smoother
from .parametrization import Parametrization, spread, tensor

__all__ = ["LOSSES", "Problem"]


def _squares(image: Any, target: Any) -> Any:
    import drjit as dr

    return dr.mean(dr.square(image - target), axis=None)


def _absolute(image: Any, target: Any) -> Any:
    import drjit as dr

    return dr.mean(dr.abs(image - target), axis=None)


LOSSES: dict[str, Callable[[Any, Any], Any]] = {"l2": _squares, "l1": _absolute}


class Problem:
    """A scene, what is unknown in it, and what is wanted.

    The parameters of the scene are leaves of the images' derivatives: the structure for rays is
    built once for all images of a step. Their gradients go on to the unknowns afterwards.

    Parameters
    ----------
    scene : mi.Scene or None
    unknowns : dict of str to Parametrization
        By the names of `mi.traverse`.
    images : callable
        ``images(params, seed)`` yields losses one by one; the derivatives of each are taken before
        the next.
    terms : sequence of (float, str, callable)
        Weight, name of a parameter, and a function of its value that gives a number.
    smoothing : float
        Strength of the preconditioner for unknowns that have a Laplacian.
    wanted : array, optional
        Small copies of the targets, by which a checkpoint is known.
    """

    def __init__(
        self,
        scene: Any,
        unknowns: Mapping[str, Parametrization],
        images: Callable[[Any, int], Any],
        terms: Sequence[tuple[float, str, Callable[[Any], Any]]],
        smoothing: float,
        wanted: np.ndarray | None = None,
    ) -> None:
        if not isinstance(unknowns, Mapping) or not unknowns:
            raise BezierError.expected("unknowns", "at least one parameter", "none")
        self.params: Any = _Loose() if scene is None else import_mitsuba().traverse(scene)
        for key, item in unknowns.items():
            if scene is not None and key not in self.params:
                near = ", ".join(_near(str(key), list(dict(self.params.items()))))
                raise BezierError.expected(
                    "unknowns", f"names of mi.traverse(scene){f' ({near})' if near else ''}", key
                )
            if not isinstance(item, Parametrization):
                raise BezierError.expected(
                    f"unknowns[{key!r}]",
                    "a Parametrization (Net, Sphere, Values, ...)",
                    type(item).__name__,
                )
            self._check_differentiable(key)
        for term in terms:
            if not isinstance(term, Sequence) or len(term) != 3 or not callable(term[2]):
                raise BezierError.expected("terms", "(weight, parameter, function) each", term)
            if not np.isfinite(term[0]):
                raise BezierError.expected("terms", "finite weights", term[0])
            if (key := term[1]) not in unknowns:
                raise BezierError.expected("terms", f"one of {', '.join(unknowns)}", key)
        self.images, self.terms, self.smoothing = images, terms, smoothing
        self.wanted = np.zeros(0) if wanted is None else wanted
        self.take(unknowns)

    def _check_differentiable(self, key: str) -> None:
        """Raise an error if Mitsuba says that a parameter has no derivatives."""
        if isinstance(self.params, _Loose):
            return
        mi = import_mitsuba()
        plain = isinstance(self.params[key], (bool, int, float, str))
        if plain or self.params.flags(key) & mi.ParamFlags.NonDifferentiable.value:
            have = [
                k
                for k, v in self.params.items()
                if not isinstance(v, (bool, int, float, str))
                and not self.params.flags(k) & mi.ParamFlags.NonDifferentiable.value
            ]
            raise BezierError.expected(
                "unknowns", f"parameters that have derivatives ({', '.join(have)})", key
            )

    def take(self, unknowns: Mapping[str, Parametrization]) -> None:
        """Take parametrizations, at the beginning and after refinement."""
        self.unknowns = dict(unknowns)
        self.places: list[tuple[str, str, slice, tuple[int, ...], float]] = []
        self.blocks: list[tuple[slice, Smoother | None, tuple[int, ...]]] = []
        begin = 0
        parts = []
        for key, item in self.unknowns.items():
            scales = item.scales()
            for name, array in _start_of(key, item).items():
                end = begin + array.size
                scale = scales.get(name, 1.0)
                place = slice(begin, end)
                self.places.append((key, name, place, array.shape, scale))
                laplacian = item.laplacian(name) if self.smoothing > 0 else None
                smoother = None if laplacian is None else Smoother(laplacian, self.smoothing)
                self.blocks.append((place, smoother, array.shape))
                parts.append(array.ravel() / scale)
                begin = end
        self.start = np.concatenate(parts)

    def arrays(self, x: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
        """Return the unknown arrays of a vector, by parameter and name."""
        out: dict[str, dict[str, np.ndarray]] = {key: {} for key in self.unknowns}
        for key, name, place, shape, scale in self.places:
            out[key][name] = (x[place] * scale).reshape(shape)
        return out

    def vector(self, arrays: Mapping[str, Mapping[str, np.ndarray]]) -> np.ndarray:
        """Return the vector of given unknown arrays; where none are given, that of the start."""
        x = self.start.copy()
        for key, name, place, _shape, scale in self.places:
            if key in arrays:
                x[place] = arrays[key][name].ravel() / scale
        return x

    def set(self, x: np.ndarray, grad: bool = False) -> None:
        """Give the scene the parameters of a vector.

        Raises
        ------
        BezierError
            If they are not valid; the scene keeps those it had.
        """
        import drjit as dr

        for key, arrays in self.arrays(x).items():
            value = self._fitting(
                key, self.unknowns[key].value({k: tensor(v) for k, v in arrays.items()})
            )
            if grad:
                dr.enable_grad(value)
            self.params[key] = value
        try:
            self.params.update()
        except RuntimeError as error:  # of Mitsuba's own objects
            last = str(error).strip().split("\n")[-1]
            names = ", ".join(self.unknowns)
            raise BezierError.expected(names, "values that the scene takes", last) from None

    def _fitting(self, key: str, value: Any) -> Any:
        """Return a value as what the parameter of the scene is."""
        import drjit as dr

        if not dr.is_array_v(value) and not hasattr(value, "inverse_transpose"):
            raise BezierError.expected(
                f"unknowns[{key!r}].value", "an array of Dr.Jit", type(value).__name__
            )
        if isinstance(self.params, _Loose):
            return value
        now = self.params[key]
        if isinstance(value, type(now)):
            return value
        return _as(key, now, value)

    def evaluate(self, x: np.ndarray, seed: int) -> tuple[float, np.ndarray]:
        """Return the loss of a vector, and its gradient.

        Raises
        ------
        BezierError
            If a parameter is not valid, or has no derivative at all.
        """
        import drjit as dr

        self.set(x, grad=True)
        total = 0.0
        for loss in self.images(self.params, seed):
            loss, number = _number(loss, "loss")
            if dr.grad_enabled(loss):
                dr.backward(loss)
            total += number
        leaves = {key: dr.grad(self.params[key]) for key in self.unknowns}
        gradient = np.zeros(len(x))
        for key, arrays in self.arrays(x).items():
            inputs = {name: tensor(values) for name, values in arrays.items()}
            for one in inputs.values():
                dr.enable_grad(one)
            value = self.unknowns[key].value(inputs)
            # the chain rule as one number: what the images say, and the terms
            chained = _dot(self._fitting(key, value), leaves[key])
            for weight, name, function in self.terms:
                if name == key:
                    term, number = _number(weight * function(value), "terms")
                    total += number
                    chained += term.array if dr.is_tensor_v(term) else term
            # a parameter that nothing depends on is told by the search
            dr.backward(chained, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            for place_key, name, place, _shape, scale in self.places:
                if place_key == key:
                    g = np.array(dr.grad(inputs[name]), dtype=np.float64)
                    gradient[place] = scale * g.ravel()
        return total, gradient


def _start_of(key: str, item: Parametrization) -> dict[str, np.ndarray]:
    """Return the unknowns at which a parametrization begins, as arrays of finite numbers."""
    name, start = f"unknowns[{key!r}].start", item.start()
    if not isinstance(start, Mapping) or not start:
        raise BezierError.expected(name, "a dict of names to arrays", repr(start)[:60])
    try:
        out = {k: np.array(v, dtype=np.float64) for k, v in start.items()}
    except (TypeError, ValueError):
        raise BezierError.expected(name, "arrays of numbers", repr(start)[:60]) from None
    if not all(np.isfinite(v).all() for v in out.values()):
        raise BezierError.expected(name, "finite numbers", "NaN or infinity")
    return out


def _near(key: str, names: list[str]) -> list[str]:
    """Return names that may be meant: of the same parameter, else of a similar spelling."""
    same = [name for name in names if name.split(".")[-1] == key.split(".")[-1]]
    return same or get_close_matches(key, names, n=3, cutoff=0.5)


class _Loose(dict[str, Any]):
    """Parameters that belong to no scene."""

    def update(self) -> None:  # type: ignore[override]
        """Do nothing: no scene is to follow."""


def _dot(value: Any, gradient: Any) -> Any:
    """Return the sum of products of the numbers of a parameter and of its gradient."""
    import drjit as dr

    if hasattr(value, "inverse_transpose"):  # a transform holds its inverse as numbers of its own
        names = ("matrix", "inverse_transpose")
        pairs = [(getattr(value, name), getattr(gradient, name)) for name in names]
        return sum(dr.sum(dr.sum(a[i] * b[i])) for a, b in pairs for i in range(4))
    if dr.is_tensor_v(value):
        value, gradient = value.array, gradient.array
    while dr.depth_v(value) > 1:
        value, gradient = dr.ravel(value), dr.ravel(gradient)
    return dr.sum(value * gradient)


def _as(key: str, now: Any, value: Any) -> Any:
    """Return a tensor as what a parameter of the scene is: a colour, a point, an array."""
    import drjit as dr

    kind = type(now)
    size = dr.size_v(kind)
    count = int(np.prod(value.shape))
    if size == dr.Dynamic:
        size = dr.width(now)
        # one number stands for as many as are wanted
        if size > 1 and count != size:
            raise BezierError.expected(f"unknowns[{key!r}]", f"{size} numbers", f"{count}")
        return kind(value.array)
    if count != size:
        raise BezierError.expected(
            f"unknowns[{key!r}]", f"{size} numbers for a {kind.__name__}", f"shape {value.shape}"
        )
    return kind(*(spread(value, entry, 1) for entry in range(size)))


def _number(loss: Any, name: str) -> tuple[Any, float]:
    """Return a loss that is one number, and that number."""
    import drjit as dr

    try:
        numbers = np.ravel(np.array(dr.detach(loss), dtype=np.float64))
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.size != 1:
        got = f"{numbers.size} numbers" if numbers.size else type(loss).__name__
        raise BezierError.expected(name, "one number of Dr.Jit", got)
    return loss, float(numbers[0])
