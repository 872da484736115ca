"""Search for outlines along short pieces of lines: where chains begin to end on something else."""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from .specular_chains import OTHER, SpecularChains

__all__ = ["Crossings", "Pieces", "find_crossings"]

#: Halvings of a piece: what is left is what float32 tells apart.
_HALVINGS = 18
#: Pieces searched at a time, which bounds the memory.
_TOGETHER = 1 << 20
#: Outlines that a piece may cross.
_ROUNDS = 3
#: A jump of place (relative to the way) or normal that is no curvature: after all halvings that of
#: a grazing hit is a few thousandths.
_JUMP = 0.02
#: A piece is searched for such a jump if one of its halves changes by this much of both.
_UNEVEN = 0.8


class Pieces(NamedTuple):
    """Pieces of rows and columns of a rectangle."""

    #: What fixes the chains along a piece; ``row``: whether it is of a row; ``nearest``: the first
    #: vertex whose outlines count
    line: dict[str, Any]
    at: Any  #: Point2f, where it begins
    step: Any  #: Vector2f, to its end
    chance: Any  #: Float, a number from 0 to 1
    size: Any  #: Vector2f, of the rectangle

    @staticmethod
    def within(line: dict[str, Any], at: Any, chance: Any, size: Any, length: float) -> Pieces:
        """Return pieces of a length; their ends are uniform where `at` is in the rectangle."""
        along = dr.select(line["row"], mi.Vector2f(1, 0), mi.Vector2f(0, 1))
        # pieces begin as far before the rectangle as they are long
        at = at * (1 + along * length / size) - along * length
        return Pieces(line, at, along * length, chance, size)


class Crossings(NamedTuple):
    """Outlines that pieces of lines cross."""

    line: dict[str, Any]
    low: Any  #: Point2f, a position on one side, as near as float32 tells
    high: Any  #: Point2f, on the other
    last: Any  #: UInt, the vertex at which the chains differ
    weight: Any  #: Float, one over the probability that a piece that crosses it shows it


def find_crossings(chains: SpecularChains, pieces: Pieces) -> Crossings | None:
    """Return the outlines that pieces of lines cross, None without any.

    A piece is searched if its ends differ, or one of its halves from the other. Two outlines that
    are near to each other, as those of a thin or small thing, are found by chance: if a random
    point of the piece lies between. They count with one over the probability of this.

    Parameters
    ----------
    chains : SpecularChains
    pieces : Pieces
    """
    line, at, step, chance, size = pieces
    dr.eval(line, at, step, chance)
    total = dr.width(at)
    chosen, paired = [], []
    for start in range(0, total, _TOGETHER):
        lanes = start + dr.arange(mi.UInt32, min(_TOGETHER, total - start))
        some, begin, way, part = dr.gather(tuple, (line, at, step, chance), lanes)
        ends = []
        for k in (dr.opaque(mi.Float, x) for x in (0.0, 0.5, 1.0)):
            ends.append(chains.follow(some, begin + way * k))
            dr.eval(ends[-1])
        random = chains.follow(some, begin + way * part)
        whole, one, two = (
            chains.difference(ends[a], ends[b])[0] for a, b in ((0, 2), (0, 1), (1, 2))
        )
        uneven = (dr.maximum(one, two) > _UNEVEN * (one + two)) & (one + two > _JUMP)
        search = (whole >= OTHER) | ((one >= OTHER) & (two >= OTHER)) | uneven
        second = part >= 0.5
        before, after = (
            dr.select(second, chains.difference(random, b)[0], chains.difference(random, a)[0])
            for a, b in ((ends[0], ends[1]), (ends[1], ends[2]))
        )
        same = dr.select(second, two, one) < OTHER
        pair = same & (before >= OTHER) & (after >= OTHER) & ~(uneven & (whole < OTHER))
        chosen.append(dr.gather(mi.UInt32, lanes, dr.compress(search)))
        paired.append(dr.gather(mi.UInt32, lanes, dr.compress(pair)))
    found = []
    which = dr.concat(chosen)
    if dr.width(which):
        some, begin, way = dr.gather(tuple, (line, at, step), which)
        found += _narrowed(chains, some, begin, begin + way, size)
    which = dr.concat(paired)
    if dr.width(which):
        some, begin, way, part = dr.gather(tuple, (line, at, step, chance), which)
        found += _pairs(chains, some, begin, way, part, size)
    return Crossings(*_joined(found)) if found else None


def _bisected(
    chains: SpecularChains, line: Any, low: Any, high: Any, a: Any, b: Any
) -> tuple[Any, ...]:
    """Return both sides of an outline between `low` and `high`, and the chains there."""
    dr.eval(line, low, high, a, b)
    for _step in range(_HALVINGS):
        middle_at = 0.5 * (low + high)
        middle = chains.follow(line, middle_at)
        one, _where = chains.difference(a, middle)
        two, _where = chains.difference(middle, b)
        left = (one >= OTHER) | ((two < OTHER) & (one > two))
        a = dr.select(left, a, middle)
        b = dr.select(left, middle, b)
        low, high = dr.select(left, low, middle_at), dr.select(left, middle_at, high)
        dr.eval(a, b, low, high)
    return low, high, a, b


def _real(line: dict[str, Any], differ: Any, last: Any, low: Any, size: Any) -> Any:
    """Return whether it is an outline, of those asked for, inside of the rectangle."""
    return (differ > _JUMP) & (last >= line["nearest"]) & dr.all((low >= 0) & (low < size))


def _narrowed(
    chains: SpecularChains, line: Any, low: Any, end: Any, size: Any
) -> list[tuple[Any, ...]]:
    """Return outlines between `low` and `end`, as the fields of `Crossings`."""
    found: list[tuple[Any, ...]] = []
    begin = chains.follow(line, low)
    for _ in range(_ROUNDS):
        low, high, a, b = _bisected(chains, line, low, end, begin, chains.follow(line, end))
        differ, last = chains.difference(a, b)
        real = dr.compress(_real(line, differ, last, low, size))
        if dr.width(real):
            weight = dr.full(mi.Float, 1.0, dr.width(low))
            found.append(dr.gather(tuple, (line, low, high, last, weight), real))
        # what is left of the piece, if something is still to be found there
        rest, _where = chains.difference(b, chains.follow(line, end))
        again = dr.compress(rest >= OTHER)
        if dr.width(again) == 0:
            break
        line, low, end, begin = dr.gather(tuple, (line, high, end, b), again)
    return found


def _pairs(
    chains: SpecularChains, line: Any, at: Any, step: Any, part: Any, size: Any
) -> list[tuple[Any, ...]]:
    """Return the two outlines on both sides of a random point in one half of a piece."""
    half = 0.5 * dr.floor(2 * part)
    places = [at + step * x for x in (half, part, half + 0.5)]
    ends = [chains.follow(line, place) for place in places]
    sides = [_bisected(chains, line, *places[k : k + 2], *ends[k : k + 2]) for k in (0, 1)]
    between = dr.norm(sides[1][0] - sides[0][0])
    weight = dr.select(between > 0, dr.norm(step) / between, 0.0)
    found = []
    for low, high, a, b in sides:
        differ, last = chains.difference(a, b)
        real = dr.compress(_real(line, differ, last, low, size) & (weight > 0))
        if dr.width(real):
            found.append(dr.gather(tuple, (line, low, high, last, weight), real))
    return found


def _joined(parts: list[Any]) -> Any:
    """Return the lanes of all of some nests of the same kind, one after the other."""
    first = parts[0]
    if len(parts) == 1:
        return first
    if isinstance(first, dict):
        return {key: _joined([part[key] for part in parts]) for key in first}
    if isinstance(first, (list, tuple)):
        return type(first)(_joined(list(group)) for group in zip(*parts))
    if dr.depth_v(first) > 1:  # a vector
        return type(first)(*(dr.concat([part[k] for part in parts]) for k in range(len(first))))
    return dr.concat(parts)
