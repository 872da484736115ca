"""When a render is good enough: after so many samples, at so little noise, or after so long."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from .picture import Picture

__all__ = ["Goal", "shown_time"]

#: Passes that an estimate of noise needs, at the least.
ENOUGH = 4


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
    seconds : float or None
        Of this run; no pass begins that would not end in time, but for the first.
    started : float
        When the run began, by `time.perf_counter`.
    """

    noise: float | None = None
    seconds: float | None = None
    started: float = field(default_factory=lambda: time.perf_counter())
    stopped_by: str = ""
    _slowest: float = 0.0

    def measured(self, samples: int, seconds: float) -> None:
        """Note how long a pass of so many samples per pixel took; the first compiles, too."""
        rate = seconds / samples
        # an old value fades, so that what another program takes away is not held against us long
        self._slowest = rate if not self._slowest else max(rate, 0.5 * (rate + self._slowest))

    def reached(self, picture: Picture, samples: int) -> bool:
        """Tell whether to stop before a pass of so many samples; `stopped_by` tells why."""
        if self.noise is not None and picture.total.passes >= ENOUGH:
            noise = picture.total.noise()
            if noise is not None and noise <= self.noise:
                self.stopped_by = "noise"
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
        if self.seconds is not None and self._slowest:
            left = self.seconds - (time.perf_counter() - self.started)
            spp = min(spp, have + max(left, 0.0) / self._slowest)
        return spp
