"""When a render is good enough: after so many samples, at so little noise, or after so long."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

from .perceived import expected_flip
from .picture import Picture

__all__ = ["Goal", "shown_time"]

#: Passes that an estimate of noise needs, at the least.
ENOUGH = 4
#: FLIP takes its time: it is looked at when there are so many times the samples, or more.
GROWN = 1.1


def shown_time(seconds: float) -> str:
    """Return a time in words."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {whole % 60} s" if minutes else f"{seconds:.1f} s"


@dataclass
class Goal:
    """What ends a render before all its samples are taken.

    Attributes
    ----------
    noise : float or None
        The mean relative standard error that is small enough, see `Accumulator.noise`.
    flip : (float, float) or None
        The FLIP error that a share of the pixels, the second number, is expected not to exceed, see
        `expected_flip`.
    seconds : float or None
        Of this run; no pass begins that would not end in time, but for the first.
    started : float
        When the run began, by `time.perf_counter`.
    """

    noise: float | None = None
    flip: tuple[float, float] | None = None
    seconds: float | None = None
    started: float = field(default_factory=lambda: time.perf_counter())
    stopped_by: str = ""
    flip_found: float | None = None  #: when it was last looked at
    _slowest: float = 0.0

    def measured(self, samples: int, seconds: float) -> None:
        """Note how long a pass of so many samples per pixel took; the first compiles, too."""
        rate = seconds / samples
        # an old value fades, so that what another program takes away is not held against us long
        self._slowest = rate if not self._slowest else max(rate, 0.5 * (rate + self._slowest))

    def reached(self, picture: Picture, samples: int, by_many: bool = False) -> bool:
        """Tell whether to stop before a pass of so many samples; `stopped_by` tells why.

        Passes that come in their order, not `by_many`, end at the same one in every run.
        """
        if self.noise is not None and picture.total.passes >= ENOUGH:
            noise = picture.total.noise()
            if noise is not None and noise <= self.noise:
                self.stopped_by = "noise"
        if self.flip is not None and picture.total.passes >= ENOUGH:
            spp, last = picture.total.spp, picture.plan[max(picture.done)]
            if by_many or _level(spp) != _level(spp - last):
                self.flip_found = expected_flip(picture.total, self.flip[1])
            if self.flip_found is not None and self.flip_found <= self.flip[0]:
                self.stopped_by = "flip"
        if self.seconds is not None and self._slowest:
            elapsed = time.perf_counter() - self.started
            if elapsed + self._slowest * samples > self.seconds:
                self.stopped_by = "time"
        return bool(self.stopped_by)

    def expected_spp(self, picture: Picture, noise: float | None) -> float:
        """Return how many samples per pixel the render will have at its end, as far as is known."""
        spp = float(picture.plan.spp)
        have = picture.total.spp
        if self.noise is not None and noise:
            # the error falls with the root of the number of samples
            spp = min(spp, max(have, have * (noise / self.noise) ** 2))
        if self.flip is not None and self.flip_found:
            spp = min(spp, max(have, have * (self.flip_found / self.flip[0]) ** 2))
        if self.seconds is not None and self._slowest:
            left = self.seconds - (time.perf_counter() - self.started)
            spp = min(spp, have + max(left, 0.0) / self._slowest)
        return spp


def _level(samples: int) -> int:
    return math.floor(math.log(samples, GROWN)) if samples > 0 else -1
