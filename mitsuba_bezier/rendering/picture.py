"""What of a render is there so far: exact sums of its passes, in memory and in a file beside it.

A pass is finished or not there. The file beside the picture, ``OUT.sums.exr``, holds the sums to
the last bit, so that a render that is continued ends in the picture of one that never stopped. It
is an EXR file that ``merge`` takes, too; its header tells which render it belongs to.
"""

from __future__ import annotations

import copy
import hashlib
import os
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .._runtime import llvm_version
from ..errors import FileFormatError
from ..verification.images import Image, encode_exr
from ..verification.merge import Accumulator, split_sums
from .passes import Pass, render_pass
from .plan import Plan, pass_seed

__all__ = [
    "Picture",
    "beside",
    "checksum",
    "encode_sums",
    "load_sums",
    "machine",
    "ranges",
    "render_picture",
    "sums_path",
]

#: The longest file name of usual systems, in bytes.
_LONGEST = 255


@dataclass
class Picture:
    """The passes of a render that are finished.

    Attributes
    ----------
    plan : Plan
        All passes.
    whole : Accumulator
        The sums of those that would be the same if more samples were asked for.
    cut : Accumulator or None
        The sums with the plan's last pass too, if that is there and the number of samples has cut
        it short.
    done : set of int
        Numbers of all passes that are there.
    seconds : float
        That they took.
    """

    plan: Plan
    whole: Accumulator = field(default_factory=lambda: Accumulator(squares=True))
    cut: Accumulator | None = None
    done: set[int] = field(default_factory=set)
    seconds: float = 0.0

    @property
    def total(self) -> Accumulator:
        """The sums of all passes that are there."""
        return self.whole if self.cut is None else self.cut

    @property
    def whole_done(self) -> set[int]:
        """Numbers of the passes in `whole`."""
        return {i for i in self.done if i + 1 < len(self.plan) or not self.plan.is_cut(i)}

    @property
    def complete(self) -> bool:
        """Whether all passes of the plan are there."""
        return len(self.done) == len(self.plan)

    def add(self, index: int, rendered: Pass) -> None:
        """Add a pass."""
        values = (rendered.channels, rendered.spp, [rendered.seed], rendered.weight)
        if self.plan.is_cut(index):
            self.cut = self.whole.copy()
        else:
            self.whole.add(*values)
        if self.cut is not None:
            self.cut.add(*values)
        self.done.add(index)

    def add_sums(
        self,
        indices: Iterable[int],
        channels: Mapping[str, np.ndarray],
        spp: int,
        seeds: Sequence[int],
    ) -> None:
        """Add passes that come as sums, see `Accumulator.sums`: whole ones, or the cut one."""
        indices = list(indices)
        sums, weight = split_sums(channels)
        if any(map(self.plan.is_cut, indices)):
            self.cut = self.whole.copy()
        else:
            self.whole.add_sums(sums, weight, spp, seeds, len(indices))
        if self.cut is not None:
            self.cut.add_sums(sums, weight, spp, seeds, len(indices))
        self.done.update(indices)

    def copy(self) -> Picture:
        """Return a copy that what is added later does not change; no pixel is copied."""
        other = copy.copy(self)
        other.whole, other.cut = self.whole.copy(), self.cut and self.cut.copy()
        other.done = set(self.done)
        return other


def render_picture(
    scene: Any, sensor: Any, integrator: Any, plan: Plan, seed: int, picture: Picture | None = None
) -> Picture:
    """Render all passes of a plan that are not there yet, in one go.

    Parameters
    ----------
    scene, sensor, integrator
        Objects of Mitsuba.
    plan : Plan
        The passes.
    seed : int
        Seed of the render.
    picture : Picture, optional
        What is there.
    """
    picture = picture or Picture(plan)
    for index, spp in enumerate(plan):
        if index not in picture.done:
            one = render_pass(scene, sensor, integrator, spp, pass_seed(seed, index))
            picture.add(index, one)
    return picture


def sums_path(output: str | os.PathLike[str]) -> Path:
    """Return the name of the file beside a picture that holds its sums."""
    return beside(output, ".sums.exr")


def beside(output: str | os.PathLike[str], suffix: str) -> Path:
    """Return the name of a file beside a picture: the picture's, with another suffix."""
    path = Path(output)
    name = path.with_suffix("").name + suffix
    if len(os.fsencode(name)) > _LONGEST:
        name = hashlib.sha256(os.fsencode(name)).hexdigest()[:32] + suffix
    return path.with_name(name)


def encode_sums(
    picture: Picture,
    identity: Mapping[str, Any],
    offset: tuple[int, int],
    full_size: tuple[int, int],
) -> bytes:
    """Return the contents of the file of sums.

    Parameters
    ----------
    picture : Picture
        Of one whole pass at least.
    identity : mapping
        Header attributes that tell which render this is.
    offset, full_size : pairs of int
        Of the film, see `verification.images.Image`.
    """
    sums = picture.whole.sums()
    attributes = {
        **identity,
        **machine(),
        "contents": "sums",
        "spp": picture.whole.spp,
        "passes": picture.whole.passes,
        "seeds": " ".join(map(str, picture.whole.seeds)),
        "done": ranges(picture.whole_done),
        "seconds": str(picture.seconds),
        "checksum": str(checksum(sums)),
    }
    # noise hardly gets smaller by ZIP, and this is written again and again
    return encode_exr(sums, attributes, offset, full_size, compress=False)


def load_sums(
    image: Image, identity: Mapping[str, Any], plan: Plan, remedy: str
) -> tuple[Picture, list[str]]:
    """Return the passes that a file of sums holds.

    Parameters
    ----------
    image : Image
        What was read.
    identity : mapping
        That of the render that is to be continued.
    plan : Plan
        Its passes.
    remedy : str
        What errors offer, in brackets.

    Returns
    -------
    Picture, list of str
        What is there; what differs so that the last bits may (versions, the processor).

    Raises
    ------
    FileFormatError
        If the file is damaged, of another render, or holds more samples than are asked for.
    """
    found, name = image.attributes, str(image.path)
    if found.get("contents") != "sums":
        raise FileFormatError.expected(name, f"sums of a render{remedy}", "another file")
    for key, value in identity.items():
        if found.get(key) != value:
            got = found.get(key, "none")
            raise FileFormatError.expected(f"{name}: {key}", f"{value}{remedy}", got)
    try:
        done = _numbers(str(found["done"]))
        picture = Picture(plan, seconds=float(found["seconds"]))
        whole = found["checksum"] == str(checksum(image.channels))
        count = int(found["passes"])
        if not whole or len(done) != count:
            raise ValueError
        seeds = [int(word) for word in str(found["seeds"]).split()]
        if done and (max(done) >= len(plan) or any(plan.is_cut(i) for i in done)):
            raise FileFormatError.expected(
                "--spp", f"at least the {found['spp']} that are in {name}{remedy}", plan.spp
            )
        picture.add_sums(done, image.channels, int(found["spp"]), seeds)
    except FileFormatError:
        raise
    except (KeyError, ValueError):
        raise FileFormatError.expected(
            name, f"the sums of whole passes{remedy}", "a damaged file"
        ) from None
    other = [
        f"{key.replace('_', ' ')} {found.get(key)}, now {value}"
        for key, value in machine().items()
        if found.get(key) != value
    ]
    return picture, other


def machine() -> dict[str, str]:
    """Return what decides the last bits of a pass, but for the variant."""
    return dict(_machine())


@cache  # some milliseconds, and every part tells it
def _machine() -> dict[str, str]:
    from importlib import metadata

    from .._version import __version__

    return {
        "version_mitsuba_bezier": __version__,
        "version_mitsuba": metadata.version("mitsuba"),
        "version_drjit": metadata.version("drjit"),
        "version_llvm": ".".join(map(str, llvm_version() or ())) or "none",
        "processor": processor(),
    }


def processor() -> str:
    """Return the name of the processor, whose instructions LLVM chooses from."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            for line in file:
                key, _, value = line.partition(":")
                if key.strip() in ("model name", "CPU part"):
                    return " ".join(value.split()) or "unknown"
    except OSError:
        pass
    import platform

    return platform.processor() or platform.machine() or "unknown"


def ranges(numbers: Iterable[int]) -> str:
    """Return whole numbers as text: ``0-3 5``."""
    spans: list[list[int]] = []
    for number in sorted(numbers):
        if spans and spans[-1][1] == number - 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return " ".join(f"{a}-{b}" if a < b else f"{a}" for a, b in spans)


def _numbers(text: str) -> list[int]:
    """Return the whole numbers of a text from `ranges`."""
    found: list[int] = []
    for word in text.split():
        first, _, last = word.partition("-")
        found += range(int(first), int(last or first) + 1)
    return found


def checksum(channels: Mapping[str, np.ndarray]) -> int:
    """Return a number of all bytes of channels."""
    total = 0
    for name in sorted(channels):
        total = zlib.crc32(np.ascontiguousarray(channels[name]).data, total)
    return total
