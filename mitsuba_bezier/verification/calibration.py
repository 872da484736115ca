"""How many pixels of an unchanged scene fail the Z-test: found from a reference's own passes.

The test takes noise as normal. Light that glass and metal gather comes in rare bright samples, and
then more pixels of equal scenes fail than the 0.25 % that Mitsuba's tests allow. Each pass of a
reference is a render of the unchanged scene: it is held against the mean of all others.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np

from .images import Image
from .ztest import PASSING_SHARE, ZTest, comparable_layers, z_test

__all__ = ["ATTRIBUTE", "own_shares", "passing_share"]

#: Header attribute: JSON, the share of pixels that must pass by layer, where it is lower.
ATTRIBUTE = "z_shares"

#: Standard deviations between the mean of the passes and what is let pass. Failing pixels come in
#: rows and patches, so that their number has a longer tail than a normal one.
_DEVIATIONS = 5.0

#: Part of the usual allowance that one of the passes must use before it is widened.
_NEAR = 0.75


def own_shares(passes: Sequence[Mapping[str, np.ndarray]], spp: int) -> dict[str, float]:
    """Return, by layer, the share of pixels that must pass, where the usual one is too much.

    Parameters
    ----------
    passes : sequence of mappings
        Channels of renders of `spp` samples of one scene with different seeds; three or more.
    spp : int
        Samples per pixel of each.
    """
    count = len(passes)
    if count < 3:
        return {}
    names = list(passes[0])
    mean = {n: np.mean([p[n] for p in passes], axis=0, dtype=np.float64) for n in names}
    squares = {n: np.sum([(p[n] - mean[n]) ** 2 for p in passes], axis=0) for n in names}
    found: dict[str, list[float]] = {}
    pixels = next(iter(mean.values())).size
    for one in passes:
        channels = {}
        for n in names:  # the others' mean and variance
            step = one[n] - mean[n]
            channels[n] = mean[n] - step / (count - 1)
            rest = squares[n] - step**2 * (count / (count - 1))
            channels[f"variance.{n}"] = np.maximum(rest, 0) * (spp / (count - 2))
        others = Image(channels, {"spp": spp * (count - 1)})
        test = Image(dict(one), {"spp": spp})
        for layer, members in comparable_layers(test).items():
            result = z_test(others, test, members)
            if isinstance(result, ZTest):
                found.setdefault(layer, []).append(result.share)
    out = {}
    for layer, shares in found.items():
        failing = (1 - np.array(shares)) * pixels
        if failing.max() < _NEAR * (1 - PASSING_SHARE) * pixels:
            continue  # none comes near what Mitsuba's tests allow
        spread = max(float(failing.std(ddof=1)), float(np.sqrt(failing.mean())))
        share = 1 - (float(failing.mean()) + _DEVIATIONS * spread) / pixels
        if share < PASSING_SHARE:
            out[layer] = round(max(share, 0.0), 6)
    return out


def passing_share(reference: Image, layer: str) -> float:
    """Return the share of pixels that must pass, as the header of a reference has it."""
    try:
        share = json.loads(str(reference.attributes.get(ATTRIBUTE, "{}"))).get(layer)
    except (ValueError, AttributeError):
        return PASSING_SHARE
    # a header cannot make the test stricter, nor turn it off
    good = isinstance(share, float) and 0.5 <= share < PASSING_SHARE
    return share if good else PASSING_SHARE
