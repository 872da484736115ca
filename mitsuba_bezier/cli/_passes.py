"""Render a scene in several passes that add up to one image.

The film's raw sums (colour times filter weight, and the weights) are added over the passes and
divided once at the end, which gives the image of a single long render: averages of finished
passes would not, since every pass divides by its own weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError

__all__ = ["Rendering", "pass_seed", "plan", "render"]

#: Samples of one pass, by backend: the random number generators of a whole pass are in memory at
#: once, and the progress bar moves between passes; a GPU wants more to be busy. Both are far
#: below the 2^32 that Mitsuba can number.
PASS_SAMPLES = {"llvm": 1 << 22, "cuda": 1 << 25}
MAX_SAMPLES = (1 << 32) - 1


@dataclass(frozen=True)
class Rendering:
    """A finished image: Mitsuba's bitmap, and the samples per pixel of each pass."""

    bitmap: Any
    passes: tuple[int, ...]

    @property
    def spp(self) -> int:
        """Samples per pixel in all."""
        return sum(self.passes)


def plan(pixels: int, spp: int, variant: str, spp_per_pass: int | None = None) -> list[int]:
    """Divide `spp` samples per pixel into passes.

    The plan depends on the arguments only, never on time or load, so that a render can be
    repeated.

    Parameters
    ----------
    pixels : int
        Pixels of the film, with the border where the film samples it.
    spp : int
        Samples per pixel in all.
    variant : str
        The variant: passes of CUDA are larger.
    spp_per_pass : int, optional
        Overrides the choice.

    Raises
    ------
    BezierError
        If one pass would have 2^32 samples or more.
    """
    if spp_per_pass is None:
        # a power of two, where pixel numbers are found by a shift and one kernel serves all
        spp_per_pass = 1 << max(0, (PASS_SAMPLES[variant[:4]] // pixels).bit_length() - 1)
    size = min(spp, spp_per_pass)
    if pixels * size > MAX_SAMPLES:
        raise BezierError.expected(
            "--spp-per-pass", f"width * height * spp < 2^32 = {1 << 32}", f"{pixels} * {size}"
        )
    full, rest = divmod(spp, size)
    return [size] * full + [rest] * (rest > 0)


def pass_seed(seed: int, index: int) -> int:
    """Return the seed of a pass.

    The first has the seed of the render, so that one pass is what ``mi.render(seed=seed)`` gives.
    The others are hashed: counting up would give renders of neighbouring seeds the same samples.
    """
    if index == 0:
        return seed
    return int(np.random.SeedSequence((seed, index)).generate_state(1)[0])


def render(
    scene: Any,
    sensor: Any,
    integrator: Any,
    passes: Sequence[int],
    seed: int,
    report: Callable[[int], None],
) -> Rendering:
    """Render all passes.

    Parameters
    ----------
    scene, sensor, integrator
        Objects of Mitsuba.
    passes : sequence of int
        Samples per pixel of each pass, from `plan`. Samplers that need a special number
        (powers of two, squares) may take more.
    seed : int
        Seed of the render.
    report : callable
        Called after each pass with its number from 0.
    """
    mi = import_mitsuba()
    film, sampler = sensor.film(), sensor.sampler()
    # a light tracer's film holds the finished estimate of a pass, without weights
    weighted = not isinstance(integrator, mi.AdjointIntegrator)
    total: Any = 0.0
    taken = []
    for index, spp in enumerate(passes):
        sampler.set_sample_count(spp)
        spp = sampler.sample_count()
        integrator.render(scene, sensor, seed=pass_seed(seed, index), spp=spp)
        raw = np.array(film.develop(raw=True), dtype=np.float64)
        total = total + (raw if weighted else raw * spp)
        taken.append(spp)
        report(index)
    if not weighted:
        total /= sum(taken)
    film.clear()
    film.put_block(
        mi.ImageBlock(
            mi.TensorXf(total.astype(np.float32)), offset=film.crop_offset(), border=False
        )
    )
    return Rendering(film.bitmap(), tuple(taken))
