"""Passes that another process has rendered: exact sums that travel, and are checked on arrival."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import BezierError
from .passes import Pass
from .picture import Picture, checksum, machine
from .plan import Plan, pass_seed

__all__ = ["Rendered", "check", "part_size", "render_part"]

#: Seconds that a part is to take, and parts that each worker is to get of what is left.
SECONDS, SHARES = 10.0, 4
#: Of the time of a part, the most that making its sums may take, where there are passes enough.
COST = 0.1


@dataclass(frozen=True)
class Rendered:
    """The sums of some passes.

    Attributes
    ----------
    identity : dict
        Which render they are of.
    made_by : dict
        Versions and processor.
    indices : tuple of int
        Numbers of the passes.
    sums : dict of str to (H, W) array
        See `Accumulator.sums`.
    spp : int
        Samples per pixel.
    seeds : tuple of int
        Of the passes.
    checksum : int
        Of the sums.
    seconds : float
        That the passes took.
    cost : float
        Seconds that making the sums took, whatever the number of passes.
    """

    identity: dict[str, Any]
    made_by: dict[str, str]
    indices: tuple[int, ...]
    sums: dict[str, np.ndarray]
    spp: int
    seeds: tuple[int, ...]
    checksum: int
    seconds: float
    cost: float = 0.0


def render_part(
    plan: Plan,
    indices: Sequence[int],
    seed: int,
    identity: Mapping[str, Any],
    render: Any,
) -> Rendered:
    """Render some passes; ``render(spp, seed)`` gives a `Pass`."""
    import time

    started = time.perf_counter()
    picture = Picture(plan)
    for index in indices:
        one: Pass = render(plan[index], pass_seed(seed, index))
        picture.add(index, one)
    rendered = time.perf_counter()
    sums = picture.total.sums()
    total = checksum(sums)
    return Rendered(
        dict(identity),
        machine(),
        tuple(indices),
        sums,
        picture.total.spp,
        tuple(picture.total.seeds),
        total,
        rendered - started,
        time.perf_counter() - rendered,
    )


def check(
    rendered: Any, indices: Sequence[int], seed: int, identity: Mapping[str, Any], size: Any
) -> None:
    """Make sure that what came is what was asked for.

    Raises
    ------
    BezierError
        If it is not; the message says what does not fit.
    """
    if not isinstance(rendered, Rendered):
        raise BezierError.expected("part", "sums of passes", type(rendered).__name__)
    if tuple(rendered.indices) != tuple(indices):
        raise BezierError.expected("part", f"passes {tuple(indices)}", rendered.indices)
    for key, value in identity.items():
        if rendered.identity.get(key) != value:
            raise BezierError.expected(f"part: {key}", value, rendered.identity.get(key))
    if rendered.seeds != tuple(pass_seed(seed, index) for index in indices):
        raise BezierError.expected("part", "the seeds of its passes", "others")
    shapes = {np.shape(values) for values in rendered.sums.values()}
    if shapes != {tuple(size)} or "sum1.weight" not in rendered.sums:
        raise BezierError.expected("part", f"sums of size {tuple(size)}", sorted(shapes))
    if checksum(rendered.sums) != rendered.checksum:
        raise BezierError.expected("part", "its checksum", "another: it was damaged on its way")
    if not rendered.spp >= len(indices):
        raise BezierError.expected("part", "samples", rendered.spp)


def part_size(
    seconds_a_pass: float | None, left: int, workers: int, cost: float | None = None
) -> int:
    """Return how many passes the next part has.

    Parameters
    ----------
    seconds_a_pass : float or None
        Measured, or None before anything is.
    left : int
        Passes that no part has yet.
    workers : int
        How many there are.
    cost : float, optional
        Seconds that a part takes besides its passes.
    """
    if not seconds_a_pass:
        return 1
    workers = max(1, workers)
    # few enough that no worker is the last for long
    count = min(int(SECONDS / seconds_a_pass), left // (SHARES * workers))
    # and so many that they are worth a message, if there is one for everybody
    worth = math.ceil((cost or 0.0) / (COST * seconds_a_pass))
    return max(1, count, min(worth, left // workers))
