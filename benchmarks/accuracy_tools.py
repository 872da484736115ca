"""Rays, truths and verdicts of the accuracy suite."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from drjit.llvm import Float

from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafSettings, Leaves
from mitsuba_bezier.oracles.reference import first_hit

__all__ = [
    "GENERAL",
    "Answer",
    "Line",
    "Tracer",
    "against_reference",
    "against_truth",
    "at_random",
    "describe",
    "toward",
    "unit",
]

#: The general path: no closed forms, every patch is cut into graph leaves.
GENERAL = LeafSettings(closed_form=False)

#: Rays a launch.
_CHUNK = 2**19


@dataclass
class Line:
    """One line of the table: a measurement against what is required."""

    what: str  #: what was traced
    rays: int  #: rays that were judged
    required: str
    measured: str
    passed: bool
    values: dict[str, float]  #: the numbers behind `measured`
    failures: list[str]  #: the first rays that failed, to reproduce them


@dataclass
class Answer:
    """What the kernel says, as NumPy arrays."""

    valid: np.ndarray
    t: np.ndarray
    patch: np.ndarray
    uv: np.ndarray


class Tracer:
    """The kernel over one set of patches, in float32 as in a render."""

    def __init__(self, patches: BezierTriangles, settings: LeafSettings | None = None) -> None:
        self.patches = patches
        self._take(build_leaves(patches, settings))

    @classmethod
    def of(cls, leaves: Leaves) -> Tracer:
        """Return the kernel over leaves that are no patches."""
        tracer = cls.__new__(cls)
        tracer._take(leaves)
        return tracer

    def _take(self, leaves: Leaves) -> None:
        self.uncertified = int((~leaves.certified).sum())
        self.structure = build_structure(leaves, Float)

    def __call__(
        self, o: np.ndarray, d: np.ndarray, t_max: Any = np.inf, any_hit: bool = False
    ) -> Answer:
        """Trace float32 rays ``(N, 3)``."""
        limit = np.broadcast_to(np.float32(t_max), len(o))
        parts = []
        for first in range(0, len(o), _CHUNK):
            c = slice(first, first + _CHUNK)
            columns = [[Float(np.ascontiguousarray(a[c, k])) for k in range(3)] for a in (o, d)]
            far = Float(np.ascontiguousarray(limit[c]))
            hit = intersect(self.structure, *columns, far, True, any_hit)
            dr.eval(*hit)
            count = len(o[c])
            uv = np.stack([_numpy(hit.u, count), _numpy(hit.v, count)], axis=1)
            parts.append(
                (_numpy(hit.valid, count), _numpy(hit.t, count), _numpy(hit.patch, count), uv)
            )
        valid, t, patch, uv = (np.concatenate(column) for column in zip(*parts))
        return Answer(valid, t.astype(np.float64), patch.astype(int), uv.astype(np.float64))


def _numpy(value: Any, count: int) -> np.ndarray:
    out = np.array(value)
    return np.broadcast_to(out, count) if out.size == 1 else out


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors of length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def toward(o: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return float32 rays from `o` to `target`; the float32 numbers are the rays' definition."""
    o = np.broadcast_to(o, target.shape).astype(np.float32)
    return o, unit(target - o.astype(np.float64)).astype(np.float32)


def at_random(
    rng: np.random.Generator, count: int, start: float = 2.5, ball: float = 1.2
) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from a sphere of radius `start` to points of a ball."""
    target = unit(rng.normal(size=(count, 3))) * ball * np.cbrt(rng.random((count, 1)))
    return toward(start * unit(rng.normal(size=(count, 3))), target)


def describe(o: np.ndarray, d: np.ndarray, wrong: np.ndarray, *columns: Any) -> list[str]:
    """Return the first three of the rays in the mask, with more columns of numbers."""
    return [
        f"o={o[k].tolist()} d={d[k].tolist()} " + " ".join(f"{c[k]}" for c in columns)
        for k in np.flatnonzero(wrong)[:3]
    ]


#: Relative change of the input that float32 may make of it: some ten roundings of 6e-8.
PRECISION = 1e-6
#: The same for what is computed in float64 from the start: the ends at infinity.
FLOAT64 = 1e-9
#: Band along edges, in parameters.
EDGE = 1e-4


def against_reference(
    what: str,
    tracer: Tracer,
    o: np.ndarray,
    d: np.ndarray,
    relative: float | None = None,
    boundary: bool = True,
) -> Line:
    """Judge first hits by the float64 reference.

    A ray counts if moving patch and ray by `PRECISION` cannot change its answer. A hit is wrong
    if it is missed or invented, or off along the surface's normal by more than
    ``1e-5 scale``, where roots nearer to each other than that do not count. With `relative`
    the error of `t` is held to it too, up to ``t = 1e6``, for all hits whose `t` changes by less
    than a quarter of that when the hit point is rounded to float32.
    """
    truth = first_hit(tracer.patches, o.astype(float), d.astype(float))
    got = tracer(o, d)
    decided = truth.margin.decidable(PRECISION, EDGE if boundary else 0.0, boundary)
    hit = np.isfinite(truth.t)
    both = decided & hit & got.valid
    length = np.linalg.norm(d.astype(float), axis=1)
    with np.errstate(invalid="ignore"):
        error = np.abs(got.t - truth.t)
        limit = 1e-5 * truth.margin.scale / np.maximum(truth.margin.cosine, 1e-6)
    wrong = decided & (got.valid != hit)
    wrong_root = both & (error * length > limit)
    bad = wrong | wrong_root
    largest = float(error[both & ~wrong_root].max(initial=0.0))
    values = {
        "wrong": int(wrong.sum()),
        "wrong root": int(wrong_root.sum()),
        "decidable": float(decided.mean()),
        "hits": int((decided & hit).sum()),
        "max |dt|": largest,
    }
    required = "0 wrong"
    measured = f"{int(bad.sum())} wrong, {decided.mean():.1%} decidable, max |dt| {largest:.1e}"
    passed = not bad.any()
    if relative is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            size = _size(o, truth.t * length)
            condition = 2 * 6e-8 * size / (truth.margin.cosine * truth.t * length)
            off = error / truth.t
            sure = truth.margin.decidable(FLOAT64, EDGE if boundary else 0.0, boundary)
            firm = sure & hit & got.valid & (condition < relative / 4) & (truth.t * length <= 1e6)
        worst = float(off[firm].max(initial=0.0))
        reach = float((truth.t * length)[firm].max(initial=0.0))
        bad = bad | (firm & (off > relative))
        values |= {"relative error": worst, "reach": reach}
        required = f"0 wrong, relative error {relative:.0e}"
        measured = f"{int((wrong | wrong_root).sum())} wrong, relative {worst:.1e} to t {reach:.0e}"
        passed = not bad.any()
    failures = describe(o, d, bad, got.valid, got.t, truth.t, truth.patch, truth.uv)
    return Line(what, int(decided.sum()), required, measured, passed, values, failures)


def _size(o: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the size of the coordinates of hits; at least 1, the size of the surfaces here."""
    return np.maximum(np.linalg.norm(o.astype(float), axis=1) + along, 1.0)


def against_truth(
    what: str,
    tracer: Tracer,
    o: np.ndarray,
    d: np.ndarray,
    t: np.ndarray,
    cosine: np.ndarray,
    judged: np.ndarray,
    relative: float | None = None,
) -> Line:
    """Judge first hits by an analytic answer.

    Parameters
    ----------
    t : (N,) array
        The answer, ``inf`` for a miss.
    cosine : (N,) array
        Of ray and normal at the hit.
    judged : (N,) bool array
        Rays outside of the bands along edges and silhouettes.
    relative : float, optional
        Required relative error of `t`, where rounding the surface's coordinates to float32
        changes `t` by less than a quarter of that.
    """
    got = tracer(o, d)
    hit = np.isfinite(t)
    both = judged & hit & got.valid
    length = np.linalg.norm(d.astype(float), axis=1)
    size = _size(o, np.where(hit, t, 0.0) * length)
    cosine = np.maximum(np.abs(np.where(hit, cosine, 1.0)), 1e-9)
    with np.errstate(invalid="ignore"):
        error = np.where(both, np.abs(got.t - t) * length, 0.0)
    wrong = judged & (got.valid != hit)
    wrong_root = both & (error > 1e-5 * size / cosine)
    bad = wrong | wrong_root
    largest = float(error[~bad].max(initial=0.0))
    values = {
        "wrong": int(wrong.sum()),
        "wrong root": int(wrong_root.sum()),
        "judged": float(judged.mean()),
        "hits": int((judged & hit).sum()),
        "max |dt|": largest,
    }
    required = "0 wrong"
    measured = f"{int(bad.sum())} wrong, {judged.mean():.1%} judged, max |dt| {largest:.1e}"
    if relative is not None:
        along = np.where(hit, t, 1.0) * length
        firm = both & (6e-8 * size / (cosine * along) < relative / 4)
        off = error / along
        worst = float(off[firm].max(initial=0.0))
        reach = float(along[firm].max(initial=0.0))
        values |= {"relative error": worst, "reach": reach, "firm": float(firm.mean())}
        required = f"0 wrong, relative error {relative:.0e}"
        measured = f"{int(bad.sum())} wrong, relative {worst:.1e} to t {reach:.0e}"
        bad = bad | (firm & (off > relative))
    failures = describe(o, d, bad, got.valid, got.t, t, cosine)
    return Line(what, int(judged.sum()), required, measured, not bad.any(), values, failures)
