"""One pass of a render, and the channels of what Mitsuba has rendered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._runtime import import_mitsuba

__all__ = ["Pass", "channels_of", "empty_bitmap", "fill_bitmap", "halved", "render_pass"]


@dataclass(frozen=True)
class Pass:
    """What a pass has rendered.

    Attributes
    ----------
    channels : dict of str to (H, W) array
        Developed, float32.
    weight : (H, W) array or None
        Sum of the film's reconstruction weights; None if every sample counts as one.
    spp : int
        Samples per pixel that it took: samplers that need a special number (powers of two,
        squares) may take more than they were asked for.
    seed : int
        Its seed.
    """

    channels: dict[str, np.ndarray]
    weight: np.ndarray | None
    spp: int
    seed: int


def render_pass(scene: Any, sensor: Any, integrator: Any, spp: int, seed: int) -> Pass:
    """Render one pass.

    Every pass divides by its own weights, so that plain averages of several would not be the image
    of one long render: they are to be averaged by `weight`, pixel by pixel.

    Parameters
    ----------
    scene, sensor, integrator
        Objects of Mitsuba.
    spp, seed : int
        Samples per pixel, and the seed.
    """
    mi = import_mitsuba()
    film, sampler = sensor.film(), sensor.sampler()
    sampler.set_sample_count(spp)
    spp = sampler.sample_count()
    integrator.render(scene, sensor, seed=seed, spp=spp)
    # colours, alpha, weight, layers; first of all, as Dr.Jit lets other threads run while it
    # waits for this, so that Ctrl-C is answered, but not while it makes a bitmap
    raw = np.array(film.develop(raw=True))
    channels, weight = channels_of(film.bitmap()), None
    # a light tracer's film holds the finished estimate of a pass, without weights
    if not isinstance(integrator, mi.AdjointIntegrator):
        layers = len(channels) - film.base_channels_count()
        weight = raw[..., raw.shape[-1] - layers - 1]
    return Pass(channels, weight, spp, seed)


def channels_of(bitmap: Any) -> dict[str, np.ndarray]:
    """Return the channels ``(H, W)`` of a Mitsuba bitmap by name."""
    pixels = np.array(bitmap)
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    return {field.name: pixels[..., i] for i, field in enumerate(bitmap.struct_())}


def halved(channels: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return channels with colours as 16-bit floats, which Mitsuba's films write by default.

    Other channels keep 32 bits: depths, positions and numbers need them.
    """
    limit = np.finfo(np.float16).max  # a larger pixel would become infinite
    return {
        name: np.clip(values, -limit, limit).astype(np.float16) if _is_colour(name) else values
        for name, values in channels.items()
    }


def _is_colour(name: str) -> bool:
    """Tell whether a channel is one of colour: of the film itself, or R, G, B, A of a layer."""
    layer, _, channel = name.rpartition(".")
    return channel in ({"R", "G", "B", "A"} if layer else {"R", "G", "B", "A", "X", "Y", "Z"})


def empty_bitmap(sensor: Any, integrator: Any) -> Any:
    """Return a bitmap of the film's kind, with the channels of an integrator."""
    film = sensor.film()
    film.prepare(integrator.aov_names())
    return film.bitmap()


def fill_bitmap(bitmap: Any, channels: Mapping[str, np.ndarray]) -> Any:
    """Write channels to the pixels of a bitmap of Mitsuba, and return it."""
    pixels = np.array(bitmap, copy=False)  # the bitmap's own memory
    planes = [channels[field.name] for field in bitmap.struct_()]
    pixels[...] = np.stack(planes, axis=-1).reshape(pixels.shape)
    return bitmap
