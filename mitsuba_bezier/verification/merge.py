"""Adding up passes of a render, in one process or from files, with the same result to the bit.

A render of several passes is their mean, weighted pixel by pixel: with the developed images F_i
and weights w_i (the film's reconstruction weights, or just the samples per pixel),

    F = sum_i w_i F_i / sum_i w_i.

Each F_i and w_i is a float32 number, so w_i F_i is exact in float64. The sums are kept in pairs
of float64 (compensated by Knuth's TwoSum), which is exact as long as the terms of one pixel stay
within a factor of some 2^80, and only the final quotient is rounded, to float32. Hence the order
and the grouping of the passes do not matter.

A file of one float32 pass with constant weights (box filter) says all of that in its pixels and
its header (``spp``). A file of several passes, of half precision or with varying weights has been
rounded; to be merged exactly it must also hold the sums, as float32 channels that add up to them:
``sum1.R``, ``sum2.R``, ``sum3.R``, and so on, and ``sum1.weight``, ...
"""

from __future__ import annotations

import copy
import math
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from .._files import refuse_inputs
from ..errors import BezierError, FileFormatError
from .images import Image, read_image, refuse_denoised, write_exr

__all__ = ["DIFFERENCES", "Accumulator", "add_file", "luminance", "merge_files", "split_sums"]

#: What parts may differ in if that is wanted, with the attribute of the header that tells it.
DIFFERENCES = {
    "scene": "scene",
    "sensor": "sensor",
    "integrator": "integrator",
    "filter": "rfilter",
    "colours": "variant",
}
#: What is darker, as a part of a picture's mean luminance, counts as so bright (`noise`).
DARK = 0.01
#: Allows that parts of a plan are not there, and that some were interrupted.
MISSING, UNFINISHED = "missing", "unfinished"

_SUM = re.compile(r"sum\d+\.(.+)")
_WEIGHT = "weight"
_SQUARE = "square"  # sum of weight times the squared luminance of a pass: tells how noisy it is
_LARGEST = 1e30  # of a square: sums are kept in float32, too
_TERMS = 6  # six float32 hold any pair of float64 within the range of float32


class _ExactSum:
    """Sum of arrays, kept as an unevaluated pair of float64 arrays, which are never changed."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.high = np.zeros(shape)
        self.low = np.zeros(shape)

    def add(self, term: np.ndarray | float) -> None:
        total = self.high + term
        part = total - self.high
        self.low = self.low + ((self.high - (total - part)) + (term - part))
        self.high = total

    def value(self) -> np.ndarray:
        return self.high + self.low

    def copy(self) -> _ExactSum:
        return copy.copy(self)

    def terms(self) -> list[np.ndarray]:
        """Return float32 arrays that add up to the sum, largest first; at least one."""
        rest = _ExactSum(self.high.shape)
        rest.add(self.high)
        rest.add(self.low)
        terms: list[np.ndarray] = []
        while len(terms) < _TERMS:
            term = rest.value().astype(np.float32)
            if terms and not term.any():
                break
            terms.append(term)
            rest.add(-term.astype(np.float64))
        return terms


class Accumulator:
    """Weighted mean of passes, the same for every order and grouping.

    Parameters
    ----------
    variance : bool
        Also estimate the variance of one sample from the differences between the passes.
    squares : bool
        Also sum up the squares of luminance, exactly, for `noise`.

    Attributes
    ----------
    spp : int
        Samples per pixel so far.
    passes : int
        Passes so far.
    seeds : list of int
        Seeds of the passes so far.
    """

    def __init__(self, variance: bool = False, squares: bool = False) -> None:
        self.spp = 0
        self.passes = 0
        self._known: set[int] = set()
        self._square: _ExactSum | None = None
        self._squares = squares
        self._noise: tuple[int, float | None] = 0, None  # of so many passes
        self.seeds: list[int] = []
        self._sums: dict[str, _ExactSum] = {}
        self._weight: _ExactSum | None = None
        # West's running update (1979): spp, mean, sum of spp * squared deviation
        self._spread: dict[str, tuple[np.ndarray, np.ndarray]] | None = {} if variance else None

    def copy(self) -> Accumulator:
        """Return a copy that what is added later does not change; no pixel is copied."""
        other = copy.copy(self)
        other.seeds, other._known = list(self.seeds), set(self._known)
        other._sums = {name: total.copy() for name, total in self._sums.items()}
        other._weight, other._square = copy.copy(self._weight), copy.copy(self._square)
        other._spread = None if self._spread is None else dict(self._spread)
        return other

    def add(
        self,
        channels: Mapping[str, np.ndarray],
        spp: int,
        seeds: Sequence[int] = (),
        weight: np.ndarray | None = None,
    ) -> None:
        """Add one pass.

        Parameters
        ----------
        channels : mapping of str to (H, W) array
            Developed channels; what is finer than float32 is rounded to it.
        spp : int
            Samples per pixel.
        seeds : sequence of int
            Seeds used; none may have been used before.
        weight : (H, W) array, optional
            Sum of the film's reconstruction weights; by default `spp` everywhere.
        """
        self._admit(channels, spp, seeds)
        self._add_weight(float(spp) if weight is None else _as_float(weight))
        for name, pixels in channels.items():
            values = _as_float(pixels)
            self._sums[name].add(values * (float(spp) if weight is None else _as_float(weight)))
            if self._spread is not None:
                mean, squares = self._spread.get(name, (np.zeros(()), np.zeros(())))
                step = values - mean
                mean = mean + step * (spp / (self.spp + spp))
                self._spread[name] = mean, squares + spp * step * (values - mean)
        if self._square is not None:
            light = _luminance({name: _as_float(pixels) for name, pixels in channels.items()})
            factor = float(spp) if weight is None else _as_float(weight)
            self._square.add(factor * np.minimum(light * light, _LARGEST))
        self.passes += 1
        self.spp += spp
        self.seeds += seeds
        self._known.update(seeds)

    def add_sums(
        self,
        sums: Mapping[str, Sequence[np.ndarray]],
        weight: Sequence[np.ndarray],
        spp: int,
        seeds: Sequence[int] = (),
        passes: int = 1,
    ) -> None:
        """Add sums of several passes, as `sums` gives them: by channel, arrays to be added."""
        squares = sums.get(_SQUARE, ())
        sums = {name: terms for name, terms in sums.items() if name != _SQUARE}
        self._admit({name: terms[0] for name, terms in sums.items()}, spp, seeds)
        for term in weight:
            self._add_weight(_as_float(term))
        for name, terms in sums.items():
            for term in terms:
                self._sums[name].add(_as_float(term))
        self._spread = None  # not known within these passes
        if not squares:
            self._square = None
        elif self._square is not None:
            for term in squares:
                self._square.add(_as_float(term))
        self.passes += passes
        self.spp += spp
        self.seeds += seeds
        self._known.update(seeds)

    def _admit(self, channels: Mapping[str, np.ndarray], spp: int, seeds: Sequence[int]) -> None:
        shapes = {np.shape(pixels) for pixels in channels.values()}
        if not self._sums:
            if len(shapes) != 1:
                raise BezierError.expected("channels", "at least one, all of one size", shapes)
            (shape,) = shapes
            self._sums = {name: _ExactSum(shape) for name in channels}
            self._weight = _ExactSum(shape)
            if self._squares and luminance(channels) is not None:
                self._square = _ExactSum(shape)
        if channels.keys() != self._sums.keys():
            raise BezierError.expected(
                "channels", ", ".join(sorted(self._sums)), ", ".join(sorted(channels))
            )
        expected = next(iter(self._sums.values())).high.shape
        if shapes != {expected}:
            raise BezierError.expected("size", "{1} x {0}".format(*expected), f"{sorted(shapes)}")
        if not 0 < spp < 2**28:  # beyond, spp times a float32 would not be exact
            raise BezierError.expected("spp", "a number of samples from 1 to 2^28", spp)
        again = sorted(self._known.intersection(seeds))
        if again:
            raise BezierError.expected(
                "seed", "seeds not merged before", ", ".join(map(str, again))
            )

    def _add_weight(self, weight: np.ndarray | float) -> None:
        assert self._weight is not None
        self._weight.add(weight)

    def mean(self) -> dict[str, np.ndarray]:
        """Return the mean as float32 channels; 0 where nothing was sampled."""
        if self._weight is None:
            raise BezierError.expected("passes", "at least one", "none")
        weight = self._weight.value()
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return {
                name: np.where(weight == 0, 0.0, total.value() / weight).astype(np.float32)
                for name, total in self._sums.items()
            }

    def sums(self) -> dict[str, np.ndarray]:
        """Return the channels ``sum1.R``, ... that let a file be merged exactly."""
        if self._weight is None:
            raise BezierError.expected("passes", "at least one", "none")
        return {
            f"sum{index}.{name}": term
            for name, total in {**self._sums, _WEIGHT: self._weight, _SQUARE: self._square}.items()
            if total is not None
            for index, term in enumerate(total.terms(), 1)
        }

    def variance(self) -> dict[str, np.ndarray]:
        """Return ``variance.R``, ...: the variance of one sample, float32.

        With the pass means m_i of n_i samples: ``sum n_i (m_i - m)^2 / (passes - 1)``. It holds
        for any reconstruction filter, whose neighbouring pixels share samples.

        Raises
        ------
        BezierError
            If it was not asked for, or there were fewer than two passes.
        """
        if not self._spread or self.passes < 2:
            raise BezierError.expected(
                "passes", "two or more passes and variance=True", self.passes
            )
        return {
            f"variance.{name}": (squares / (self.passes - 1)).astype(np.float32)
            for name, (_, squares) in self._spread.items()
        }

    def noise(self) -> float | None:
        """Return the mean relative standard error of the pixels' luminance, if it is known.

        The error of a pixel with the luminances L_i of its passes, of weights w_i, is estimated by

            sum w_i (L_i - L)^2 / ((passes - 1) sum w_i),

        the square of its standard error, and divided by L^2. In a pixel that is darker than a
        hundredth of the picture's mean it is divided by that; a picture may be black in places.
        These squares are averaged over a pixel and its eight neighbours before the root is taken:
        of few passes, in which rare bright paths may be missing, each alone would be too small. It
        takes two passes at least, `squares`, and colours.
        """
        if self._square is None or self._weight is None or self.passes < 2:
            return None
        if self._noise[0] != self.passes:  # it is asked for again and again
            self._noise = self.passes, self._noise_now()
        return self._noise[1]

    def _noise_now(self) -> float | None:
        errors = self.relative_errors()
        assert errors is not None
        known = np.isfinite(errors)
        return float(errors[known].mean()) if known.any() else None

    def relative_errors(self) -> np.ndarray | None:
        """Return the estimates of pixels whose mean `noise` is, NaN where there is none."""
        if self._square is None or self._weight is None or self.passes < 2:
            return None
        weight = self._weight.value()
        there = weight != 0
        weight = np.where(there, weight, 1.0)
        light = _luminance({name: total.value() for name, total in self._sums.items()})
        with np.errstate(invalid="ignore", over="ignore"):
            mean = light / weight
            square = np.maximum(self._square.value() / weight - mean**2, 0.0) / (self.passes - 1)
            mean = np.abs(mean)
            usable = there & np.isfinite(square) & np.isfinite(mean)
        errors = np.full(weight.shape, np.nan)
        if not usable.any():
            return errors
        floor = DARK * float(mean[usable].mean())
        if floor == 0:
            errors[usable] = 0.0
            return errors
        relative = np.where(
            usable, square / np.maximum(np.where(usable, mean, 1.0), floor) ** 2, 0.0
        )
        known = _around(usable.astype(np.float64))
        # what is left of a root's bias, were all normally distributed and alike around a pixel
        n = float(9 * (self.passes - 1)) + 1
        small = math.sqrt(2 / (n - 1)) * math.exp(math.lgamma(n / 2) - math.lgamma((n - 1) / 2))
        errors[usable] = np.sqrt(_around(relative)[usable] / known[usable]) / small
        return errors


def _around(values: np.ndarray) -> np.ndarray:
    """Return the sums over 3 x 3 pixels; beyond the rim there is nothing."""
    for axis in (0, 1):
        padded = np.pad(values, [(1, 1) if a == axis else (0, 0) for a in (0, 1)])
        low, middle, high = (
            np.take(padded, range(k, k + values.shape[axis]), axis=axis) for k in range(3)
        )
        values = low + middle + high
    return values


def _luminance(channels: Mapping[str, np.ndarray]) -> np.ndarray:
    found = luminance(channels)
    assert found is not None
    return found


def luminance(channels: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Return the luminance of channels of colour, by Rec. 709, or None if there are none."""
    for names, factors in (
        ("RGB", (0.212671, 0.715160, 0.072169)),
        ("Y", (1.0,)),  # of one channel, or of X, Y, Z
    ):
        if all(name in channels for name in names):
            return sum((f * channels[name] for f, name in zip(factors, names)), np.zeros(()))
    return None


def _as_float(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(pixels, dtype=np.float32).astype(np.float64)


def _integers(image: Image, key: str) -> list[int]:
    """Return the integers of a header attribute, a number or text with spaces between."""
    value = image.attributes.get(key)
    try:
        return [] if value is None else [int(word) for word in str(value).split()]
    except ValueError:
        raise FileFormatError.expected(
            f"{image.path}: {key}", "whole numbers", f"{value!r}"
        ) from None


def add_file(total: Accumulator, image: Image, allow_nan: bool = False) -> bool:
    """Add a part to `total`; return whether that was exact.

    Raises
    ------
    FileFormatError
        If the header lacks ``spp`` or ``seed``, a seed comes twice, size or channels do not fit
        those before, channels are integers, or a pixel is not finite.
    """
    name = str(image.path)
    refuse_denoised(image)
    spp, seeds = _integers(image, "spp"), _integers(image, "seeds") or _integers(image, "seed")
    if len(spp) != 1:
        raise FileFormatError.expected(f"{name}: spp", "the header attribute spp", "none")
    if not seeds:
        raise FileFormatError.expected(f"{name}: seed", "the header attribute seed", "none")
    kinds = {pixels.dtype for pixels in image.channels.values()}
    if np.dtype(np.uint32) in kinds:
        raise FileFormatError.expected(name, "channels of floats", "integers, which have no mean")
    bad = ~np.logical_and.reduce([np.isfinite(p) for p in image.channels.values()])
    if bad.any() and not allow_nan:
        raise FileFormatError.expected(
            name, "finite pixels (or --allow-nan)", f"{np.count_nonzero(bad)} with NaN or infinity"
        )
    sums, weight = split_sums(image.channels)
    try:
        with np.errstate(invalid="ignore"):
            if weight:
                total.add_sums(sums, weight, spp[0], seeds, max([1, *_integers(image, "passes")]))
                return True
            total.add(image.channels, spp[0], seeds)
    except BezierError as error:
        raise FileFormatError(f"{name}: {error}") from None
    passes = max([*_integers(image, "passes"), len(seeds)])
    constant = image.attributes.get("rfilter", "box") == "box"
    return passes == 1 and constant and kinds == {np.dtype(np.float32)}


def split_sums(
    channels: Mapping[str, np.ndarray],
) -> tuple[dict[str, list[np.ndarray]], list[np.ndarray]]:
    """Return the sums among channels, by what they are of, and those of the weight; or nothing."""
    sums: dict[str, list[np.ndarray]] = {}
    for channel in sorted(channels):
        if match := _SUM.fullmatch(channel):
            sums.setdefault(match.group(1), []).append(channels[channel])
    return sums, sums.pop(_WEIGHT, [])


def _colours(variant: Any) -> Any:
    """Return the kind of colours of a variant, whatever computes it: ``rgb``, ``spectral``, ..."""
    if not isinstance(variant, str):
        return variant
    backends = ("llvm", "cuda", "metal", "scalar", "ad", "double")
    return "_".join(word for word in variant.split("_") if word not in backends)


def _check_alike(first: Image, image: Image, allow: Collection[str]) -> None:
    """Raise an error if two parts are not of one picture."""
    for name, key in DIFFERENCES.items():
        a, b = first.attributes.get(key), image.attributes.get(key)
        if key == "variant":
            a, b = _colours(a), _colours(b)
        if a != b and name not in allow:
            raise FileFormatError.expected(
                f"{image.path}: {name}",
                f"{'none' if a is None else a}, as in {first.path} (or --allow {name})",
                "none" if b is None else b,
            )


def _note_part(
    plans: dict[tuple[str, ...], set[int]], image: Image, allow: Collection[str]
) -> None:
    """Note which parts of which plan a file holds."""
    words = str(image.attributes.get("part", "")).split()
    ended = image.attributes.get("stopped_by", "spp") == "spp"
    if words and UNFINISHED not in allow and not (ended and "contents" not in image.attributes):
        asked = image.attributes.get("spp_asked", "")
        raise FileFormatError.expected(
            f"{image.path}: part {words[0]}",
            f"all of its {asked} spp (or --allow {UNFINISHED})".replace("  ", " "),
            image.attributes.get("spp"),
        )
    for word in words:
        number, _, count = word.partition("/")
        if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
            raise FileFormatError.expected(f"{image.path}: part", "I/N", f"{word!r}")
        # all that makes up a plan: what one of its processes is told
        plan, seed = (str(image.attributes.get(key, "")) for key in ("plan", "seed"))
        own = plans.setdefault((count, plan, seed), set())
        if int(number) - 1 in own:
            raise FileFormatError.expected(
                f"{image.path}: part", "one that is not merged before", word
            )
        own.add(int(number) - 1)


def _missing(plans: Mapping[tuple[str, ...], set[int]]) -> list[str]:
    """Return the parts that are not there, in words."""
    return [
        f"part {index + 1}/{count} of seed {seed}, {plan}"
        for (count, plan, seed), own in plans.items()
        for index in sorted(set(range(min(int(count), len(own) + 1))) - own)
    ]


def _frame(image: Image) -> str:
    height, width = image.size
    full = image.full_size or (width, height)
    crop = " at {}, {} of {} x {}".format(*image.offset, *full)
    return f"{width} x {height}{'' if full == (width, height) else crop}"


def merge_files(
    parts: Iterable[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    command: str = "",
    keep_sums: bool = False,
    allow_nan: bool = False,
    allow: Collection[str] = (),
) -> tuple[Accumulator, list[str]]:
    """Merge EXR files and write the result.

    The header keeps the attributes that all parts share; ``spp``, ``seed``, ``seeds``,
    ``passes`` and ``command`` are those of the whole.

    Parts belong together if their headers tell the same scene, sensor, integrator, filter and
    kind of colours, as far as they tell any, and if of each plan whose parts (``I/N``) are among
    them all are.

    Parameters
    ----------
    parts : paths
        Files of float channels of one size, with ``spp`` and ``seed`` in the header.
    output : path
        Half precision if all parts are, else float32.
    command : str
        Written to the header.
    keep_sums : bool
        Also write the sums, so that the result can itself be merged exactly.
    allow_nan : bool
        Let pixels pass that are not finite; they stay so.
    allow : collection of str
        What parts may differ in, of `DIFFERENCES`; ``missing`` allows that some are not there,
        ``unfinished`` that some were interrupted.

    Returns
    -------
    Accumulator, list of str
        What was merged, and the files that had been rounded before.

    Raises
    ------
    FileFormatError
        If a part cannot be used, see `add_file`, parts do not belong together, or the output is
        one of them.
    """
    parts = list(parts)
    refuse_inputs(output, parts, "--output")
    there: set[tuple[int, int]] = set()
    for path in parts:
        try:
            found = os.stat(path)
        except OSError:
            continue  # which is told when it is read
        if (found.st_dev, found.st_ino) in there:
            raise FileFormatError.expected("PART", "each file once", f"{path} twice")
        there.add((found.st_dev, found.st_ino))
    total = Accumulator(squares=True)
    plans: dict[tuple[str, ...], set[int]] = {}
    rounded: list[str] = []
    first: Image | None = None
    shared: dict[str, Any] = {}
    half = True
    passes = 0
    for path in parts:
        image = read_image(path)
        if image.encoding != "linear":
            raise FileFormatError.expected(str(path), "an EXR file", "a PNG file")
        if first is None:
            first, shared = image, dict(image.attributes)
        if _frame(image) != _frame(first):
            raise FileFormatError.expected(f"{path}: size", _frame(first), _frame(image))
        _check_alike(first, image, allow)
        _note_part(plans, image, allow)
        if not add_file(total, image, allow_nan):
            rounded.append(str(path))
        shared = {k: v for k, v in shared.items() if image.attributes.get(k) == v}
        plain = [p.dtype for n, p in image.channels.items() if not _SUM.fullmatch(n)]
        half = half and set(plain) == {np.dtype(np.float16)}
        passes += max([1, *_integers(image, "passes")])
    if first is None:
        raise FileFormatError.expected("parts", "at least one file", "none")
    missing = _missing(plans)
    if missing and MISSING not in allow:
        raise FileFormatError.expected(
            "PART", f"all parts of a render (or --allow {MISSING})", f"none that is {missing[0]}"
        )
    channels = total.mean()
    if half:
        top = np.finfo(np.float16).max  # a larger pixel would become infinite
        channels = {n: np.clip(p, -top, top).astype(np.float16) for n, p in channels.items()}
    if keep_sums:
        channels |= total.sums()
    shared.pop("noise", None)
    shared |= {
        "spp": total.spp,
        "seed": shared.get("seed", min(total.seeds)),
        "seeds": " ".join(map(str, sorted(total.seeds))),
        "passes": passes,
        "command": command,
    }
    noise = total.noise()
    if noise is not None:
        shared["noise"] = noise
    for key in ("contents", "checksum", "done", "seconds", "part", *(() if missing else ("plan",))):
        shared.pop(key, None)
    if missing:  # so that the rest can still be merged with this
        shared["part"] = " ".join(f"{i + 1}/{key[0]}" for key, own in plans.items() for i in own)
    write_exr(output, channels, shared, first.offset, first.full_size)
    return total, rounded
