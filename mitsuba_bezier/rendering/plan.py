"""The passes of a render: how many samples each takes, and its seed.

A plan depends on the film, the variant and the flags only, never on time or load, so that a render
can be repeated, divided and continued. It begins with small passes, so that there is a picture
soon, and more samples in all only add passes at its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

import numpy as np

from ..errors import BezierError

__all__ = [
    "MAX_SAMPLES",
    "PASS_SAMPLES",
    "STYLES",
    "Plan",
    "make_plan",
    "pass_seed",
    "sampled_pixels",
]

#: Samples of one pass, by backend: the random number generators of a whole pass are in memory at
#: once, and pictures are kept between passes; a GPU wants more to be busy. Both are far below the
#: 2^32 that Mitsuba can number.
PASS_SAMPLES = {"llvm": 1 << 22, "cuda": 1 << 25}
#: The first pass takes an eighth: a fraction of a second.
FIRST = 8
#: Passes in which the samples double in a fine plan: a standard error falls by a tenth in each.
FINE = 4
STYLES = ("soon", "large", "fine")
MAX_SAMPLES = (1 << 32) - 1


@dataclass(frozen=True)
class Plan(Sequence[int]):
    """Samples per pixel of each pass.

    Attributes
    ----------
    spp : int
        Samples per pixel in all.
    size : int
        Of a pass, once they have grown.
    first : int
        Of the first pass. The next ones take the largest power of two that is no more than a
        `steps`-th of all before, up to `size`. The very last takes what is left.
    steps : int
        Passes in which the samples in all double, while passes grow.
    """

    spp: int
    size: int
    first: int
    steps: int = 1

    @cached_property
    def _growing(self) -> tuple[int, ...]:
        """The passes that are smaller than `size`, were there no end."""
        passes: list[int] = []
        done = 0
        while True:
            share = done // self.steps
            grown = 1 << (share.bit_length() - 1) if share else 0
            own = max(self.first, grown)
            if own >= self.size:
                return tuple(passes)
            passes.append(own)
            done += own

    def start(self, index: int) -> int:
        """Return the samples per pixel of all passes before one."""
        grown = len(self._growing)
        return sum(self._growing[:index]) + max(0, index - grown) * self.size

    def whole(self, index: int) -> int:
        """Return the samples per pixel of a pass, were there no end."""
        return self._growing[index] if index < len(self._growing) else self.size

    def __len__(self) -> int:
        grown = 0
        for index, own in enumerate(self._growing):
            grown += own
            if grown >= self.spp:
                return index + 1
        return len(self._growing) + -(-(self.spp - grown) // self.size)

    @overload
    def __getitem__(self, index: int) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> list[int]: ...

    def __getitem__(self, index: int | slice) -> int | list[int]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not 0 <= index < len(self):
            raise IndexError(index)
        return min(self.whole(index), self.spp - self.start(index))

    def is_cut(self, index: int) -> bool:
        """Tell whether a pass is smaller than it would be if more samples were asked for."""
        return self[index] < self.whole(index)

    @property
    def kind(self) -> str:
        """All but the number of samples: what two renders share that can go on from each other."""
        grow = f" after {self.first}, {self.steps} a doubling" if self.first < self.size else ""
        return f"passes of {self.size}{grow}"


def make_plan(
    pixels: int,
    spp: int,
    variant: str,
    spp_per_pass: int | None = None,
    style: str = "soon",
) -> Plan:
    """Divide `spp` samples per pixel into passes.

    Parameters
    ----------
    pixels : int
        Pixels of the film, with the border where the film samples it.
    spp : int
        Samples per pixel in all.
    variant : str
        The variant: passes of CUDA are larger.
    spp_per_pass : int, optional
        All passes take so many.
    style : str
        ``"soon"``: passes begin small, so that there is a picture soon. ``"large"``: they do not.
        ``"fine"``: they begin with one sample and grow so slowly that a render may stop near any
        noise.

    Raises
    ------
    BezierError
        If one pass would have 2^32 samples or more.
    """
    if spp_per_pass is not None:
        size = first = spp_per_pass
    else:
        # powers of two, where pixel numbers are found by a shift and one kernel serves all
        samples = PASS_SAMPLES[variant[:4]]
        size = 1 << max(0, (samples // pixels).bit_length() - 1)
        first = {
            "large": size,
            "soon": 1 << max(0, (samples // (FIRST * pixels)).bit_length() - 1),
            "fine": 1,
        }[style]
    largest = min(size, spp)
    if pixels * largest > MAX_SAMPLES:
        raise BezierError.expected(
            "--spp-per-pass", f"width * height * spp < 2^32 = {1 << 32}", f"{pixels} * {largest}"
        )
    return Plan(spp, size, first, FINE if style == "fine" else 1)


def pass_seed(seed: int, index: int) -> int:
    """Return the seed of a pass, another one for each pass of a render.

    The first has the seed of the render, so that one pass is what ``mi.render(seed=seed)`` gives.
    The others are shuffled: counting up would give renders of neighbouring seeds the same samples,
    and drawing at random would give two of some 10^5 passes the same seed.
    """
    if index == 0:
        return seed
    first, second = map(int, np.random.SeedSequence(seed).generate_state(2))

    def shuffled(number: int) -> int:
        return _mix(_mix((number + first) % (1 << 32)) ^ second)

    own = shuffled(index)
    return shuffled(0) if own == seed else own  # which no other pass has


def _mix(x: int) -> int:
    """Return a number of 32 bits for another, one to one: the last step of MurmurHash3."""
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35), (16, 1)):
        x = (x ^ (x >> shift)) * factor % (1 << 32)
    return x


def sampled_pixels(film: Any) -> int:
    """Return the pixels of a film of Mitsuba, with the border where it samples it."""
    border = 2 * film.rfilter().border_size() if film.sample_border() else 0
    width, height = film.crop_size()
    return (int(width) + border) * (int(height) + border)


def usual_style(sampler: Any) -> str:
    """Return the style of a plan for a sampler of Mitsuba, see `make_plan`."""
    # samples of other samplers belong together: a small pass would be a worse one
    return "soon" if sampler.class_name() == "IndependentSampler" else "large"
