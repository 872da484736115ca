"""Render a scene in several passes that add up to one image.

The developed passes are averaged by the film's filter weights, pixel by pixel, which gives the
image of a single long render: plain averages would not, since every pass divides by its own
weights. The sum is exact (`verification.merge`), so the passes may as well be rendered by several
processes and merged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError
from ..verification.merge import Accumulator
from ._images import channels_of

__all__ = ["Rendering", "pass_seed", "plan", "render"]

#: Samples of one pass, by backend: the random number generators of a whole pass are in memory at
#: once, and the progress bar moves between passes; a GPU wants more to be busy. Both are far
#: below the 2^32 that Mitsuba can number.
PASS_SAMPLES = {"llvm": 1 << 22, "cuda": 1 << 25}
MAX_SAMPLES = (1 << 32) - 1


@dataclass(frozen=True)
class Rendering:
    """A finished image: Mitsuba's bitmap, samples per pixel and seed of each pass, exact sums."""

    bitmap: Any
    passes: tuple[int, ...]
    seeds: tuple[int, ...]
    sums: dict[str, np.ndarray]

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
    part: tuple[int, int] = (0, 1),
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
    part : (int, int)
        Which part of how many, from 0: passes ``part[0]``, ``part[0] + part[1]``, ...
    """
    mi = import_mitsuba()
    film, sampler = sensor.film(), sensor.sampler()
    # a light tracer's film holds the finished estimate of a pass, without weights
    weighted = not isinstance(integrator, mi.AdjointIntegrator)
    total = Accumulator()
    taken, seeds = [], []
    for index, spp in list(enumerate(passes))[part[0] :: part[1]]:
        own_seed = pass_seed(seed, index)
        sampler.set_sample_count(spp)
        spp = sampler.sample_count()
        integrator.render(scene, sensor, seed=own_seed, spp=spp)
        # colours, alpha, weight, layers; first of all, as Dr.Jit lets other threads run while it
        # waits for this, so that Ctrl-C is answered, but not while it makes a bitmap
        raw = np.array(film.develop(raw=True))
        bitmap = film.bitmap()
        channels, weight = channels_of(bitmap, half=False), None
        if weighted:
            layers = len(channels) - film.base_channels_count()
            weight = raw[..., raw.shape[-1] - layers - 1]
        total.add(channels, spp, [own_seed], weight)
        taken.append(spp)
        seeds.append(own_seed)
        report(index)
    pixels = np.array(bitmap, copy=False)  # the bitmap's own memory
    mean = total.mean()
    pixels[...] = np.stack(list(mean.values()), axis=-1).reshape(pixels.shape)
    return Rendering(bitmap, tuple(taken), tuple(seeds), total.sums())
