"""Score an intersector's answers to a conformance set: missed, extra, and how exact.

A root is *firm* if its margin exceeds `SLACK` times the rounding unit: numbers of that precision
cannot make it vanish. What is not firm may be found or not, and is not counted.
`docs/conformance.md` has the rules in words.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .._files import write_file
from ..errors import GeometryError
from .conformance import VERSION, read_lines, read_set

__all__ = ["ANSWERS", "UNITS", "Score", "answer", "score"]

ANSWERS = "bezier-triangle-answers"

#: Rounding units of the precisions.
UNITS = {"single": 2.0**-24, "double": 2.0**-53}

#: Units of rounding that a computation may lose: about as many as it has steps.
SLACK = 16

#: A hit belongs to a root if it is nearer than this part of the root's reach.
_NEAR = 1e-2

Intersector = Callable[[np.ndarray, np.ndarray, np.ndarray], "list[list[float]] | None"]


@dataclass
class Score:
    """Counts for one family.

    Attributes
    ----------
    rays, refused : int
        Rays, and those whose patch was refused.
    firm, missed, extra : int
        Firm roots looked for, those that were not found, and hits where no root is.
    errors : list of float
        ``|dt|`` of each firm root found, over its condition and the rounding unit: 1 is what
        rounding the input costs.
    """

    rays: int = 0
    refused: int = 0
    firm: int = 0
    missed: int = 0
    extra: int = 0
    errors: list[float] = field(default_factory=list)

    def add(self, other: Score) -> None:
        """Add another's counts and errors."""
        for name in ("rays", "refused", "firm", "missed", "extra", "errors"):
            setattr(self, name, getattr(self, name) + getattr(other, name))


def answer(
    path: str | os.PathLike[str],
    set_path: str | os.PathLike[str],
    intersect: Intersector,
    name: str,
    precision: str,
    first: bool,
) -> None:
    """Write the answers of an intersector to a set.

    Parameters
    ----------
    path, set_path : path-like
        The file to write, and the set.
    intersect : callable
        ``intersect(net (K, 4), origins (N, 3), directions (N, 3))`` returns the `t` of all hits of
        each ray, in any order, or None if it refuses the patch.
    name : str
    precision : str
        ``"single"`` or ``"double"``: what it computes in.
    first : bool
        Whether it returns the first hit with ``t >= 0`` only.
    """
    head = {"format": ANSWERS, "version": VERSION, "name": name}
    lines = [json.dumps(head | {"precision": precision, "first": first})]
    for row in read_set(set_path):
        o, d = (np.array([r[k] for r in row["rays"]]) for k in ("origin", "direction"))
        hits = intersect(np.array(row["net"]), o, d) if row["rays"] else []
        lines.append(json.dumps(hits))
    write_file(path, ("\n".join(lines) + "\n").encode())


def score(
    set_path: str | os.PathLike[str], answers: str | os.PathLike[str]
) -> tuple[dict[str, Any], dict[str, Score]]:
    """Compare answers with a set.

    Returns
    -------
    head : dict
        The head of the answers: name, precision, first.
    scores : dict of Score
        By family and degree: ``"cusp 3"``.

    Raises
    ------
    FileFormatError
        If a file is missing or of another format.
    GeometryError
        If the answers belong to another set.
    """
    head, given = read_lines(answers, ANSWERS)
    entries = list(read_set(set_path))
    unit = UNITS.get(head.get("precision", ""))
    if unit is None or len(entries) != len(given):
        want = f"{len(entries)} lines, precision {' or '.join(UNITS)}"
        raise GeometryError.expected(
            str(answers), want, f"{len(given)} lines, precision {head.get('precision')}"
        )
    scores: dict[str, Score] = {}
    for entry, hits in zip(entries, given):
        s = scores.setdefault(f"{entry['family']} {entry['degree']}", Score())
        s.rays += len(entry["rays"])
        if hits is None:
            s.refused += len(entry["rays"])
            continue
        if not isinstance(hits, list) or len(hits) != len(entry["rays"]):
            raise GeometryError.expected(
                str(answers), f"hits of {len(entry['rays'])} rays", str(hits)[:80]
            )
        for ray, found in zip(entry["rays"], hits):
            _judge(s, ray, [float(t) for t in found], unit, bool(head.get("first")))
    return head, scores


def _entries(
    rows: list[dict[str, Any]], firm: Callable[[dict[str, Any]], bool]
) -> Iterator[tuple[float, float, float | None]]:
    """Yield `t`, the distance that counts as near, and the condition of firm roots."""
    for row in rows:
        if row["t"] is not None and row["reach"] is not None:
            condition = row["condition"] if firm(row) else None
            yield row["t"], _NEAR * row["reach"], condition


def _judge(s: Score, ray: dict[str, Any], found: list[float], unit: float, first: bool) -> None:
    """Count one ray."""

    def firm(row: dict[str, Any]) -> bool:
        return row.get("condition") is not None and row["margin"] > SLACK * unit

    roots = sorted(_entries([*ray["roots"], *ray["near"]], firm))
    loose = [(t, near) for t, near, condition in roots if condition is None]
    want = [row for row in roots if row[2] is not None]
    behind: list[tuple[float, float, float | None]] = []
    if first:
        want, found = [row for row in want if row[0] > 0], sorted(t for t in found if t >= 0)[:1]
        want, behind = want[:1], want[1:]
        for t, near in loose if want and found else []:
            # something loose in front may hide the first firm root
            if t < want[0][0] and abs(t - found[0]) <= near:
                want = want if abs(want[0][0] - found[0]) <= near else []
                break
    s.firm += len(want)
    for t, near, condition in want:
        close = [x for x in found if abs(x - t) <= near]
        if not close:
            s.missed += 1
            continue
        best = min(close, key=lambda x: abs(x - t))
        found.remove(best)
        s.errors.append(abs(best - t) / (condition or np.inf) / unit)
    rest = [x for x in found if not any(abs(x - t) <= near for t, near in loose)]
    if first:  # the second of two roots is a miss of the first, no hit where nothing is
        rest = [x for x in rest if not any(abs(x - t) <= near for t, near, _c in behind)]
    s.extra += len(rest)
