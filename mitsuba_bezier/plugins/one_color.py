"""Paths of one channel in rgb variants, whose channel travels in the ray's time.

Rgb variants have no wavelengths in which a path could carry what it is made of. Nothing here
moves, so that a ray's time is free: below zero it names the channel.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["channel_of", "chosen", "time_of"]

#: Time of the first channel; shutters open at no such time.
_FIRST = -1.0e6


def time_of(channel: Any) -> Any:
    """Return the time that says a ray is of this channel, 0 to 2."""
    return _FIRST * (mi.Float(channel) + 1.0)


def channel_of(time: Any) -> tuple[Any, Any]:
    """Return the channel of rays by their time, and whether they have one."""
    place = time / _FIRST - 1.0
    known = place > -0.5
    return mi.UInt32(dr.clip(place + 0.5, 0.0, 2.0)), known


def chosen(channel: Any) -> Any:
    """Return the weight of a path of one channel: it stands for three."""
    return mi.Spectrum(*(dr.select(channel == i, 3.0, 0.0) for i in range(3)))
