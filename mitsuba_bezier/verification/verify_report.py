"""Verdicts of `verify` as entries of the HTML report."""

from __future__ import annotations

import numpy as np

from . import png, preview
from .cases import Truth
from .comparison import Check
from .report import Entry, HeatMap, Panel, Wording, heat_map
from .verify import LIMITS, Hits, Verdict

__all__ = ["WORDING", "verify_entry"]

#: What the page calls things.
WORDING = Wording("case", "formula", "patches", "Traced")

_BAND = f"within {LIMITS['band']:.0e} of the size, where float32 may decide either way"


def _blocks(values: np.ndarray, side: int, largest: int, worst: bool) -> np.ndarray:
    """Reduce a square image ``(side, side, ...)`` to at most `largest` pixels a side.

    Of the pixels of a block the mean is taken, or the largest value.
    """
    step = -(-side // largest)
    side -= side % step
    cut = values[:side, :side].reshape(side // step, step, side // step, step, *values.shape[2:])
    return cut.max(axis=(1, 3)) if worst else cut.mean(axis=(1, 3))


def _picture(shade: np.ndarray, side: int, largest: int) -> np.ndarray:
    """Return colours ``(side^2, 3)`` from 0 to 1 as a picture of 8 bits."""
    small = _blocks(shade.reshape(side, side, 3), side, largest, False)
    return np.clip(np.rint(small * 255), 0, 255).astype(np.uint8)


def _normals(n: np.ndarray, hit: np.ndarray, side: int, largest: int) -> np.ndarray:
    return _picture(np.where(hit[:, None], n * 0.5 + 0.5, 0.12), side, largest)


def _depths(t: np.ndarray, near: float, far: float, side: int, largest: int) -> np.ndarray:
    # inverse depth: what lies at the horizon is dark, not without bound
    with np.errstate(divide="ignore"):
        shade = (1 / t - 1 / far) / (1 / near - 1 / far)
    shade = np.where(np.isfinite(t), 0.25 + 0.75 * np.clip(shade, 0, 1), 0.0)
    return _picture(np.repeat(shade[:, None], 3, axis=1), side, largest)


def _map(title: str, values: np.ndarray, side: int, largest: int, note: str) -> HeatMap:
    """Return a map of errors; a few outliers do not make all else black."""
    grid = _blocks(values.reshape(side, side), side, largest, True)
    errors = grid[grid > 0]
    high = float(np.quantile(errors, 0.998)) if errors.size else 1.0
    return heat_map(title, grid, 0.0, high, "magma", note)


def _worst(values: np.ndarray, side: int, largest: int) -> tuple[int, int] | None:
    """Return column and row of the pixel of `_map` with the largest error."""
    grid = _blocks(values.reshape(side, side), side, largest, True)
    row, column = np.unravel_index(int(grid.argmax()), grid.shape)
    return (int(column), int(row)) if grid[row, column] > 0 else None


def verify_entry(
    verdict: Verdict, hits: Hits, truth: Truth, command: str, largest: int = 384
) -> Entry:
    """Return the entry of one case.

    Parameters
    ----------
    verdict : Verdict
        Its figures.
    hits, truth : Hits, Truth
        Of a square image.
    command : str
        What repeats the case.
    largest : int
        Pixels a side of the pictures at most; of the errors in a block the largest is shown.
    """
    side = round(np.sqrt(verdict.pixels))
    ours, theirs = np.isfinite(hits.t), np.isfinite(truth.t)
    both = ours & theirs
    with np.errstate(invalid="ignore"):
        error = np.where(both, (hits.t - truth.t) / np.maximum(truth.t, 1.0), 0.0)
    signed = error.reshape(side, side, 1)
    error = np.abs(error)
    facing = np.where((np.einsum("ni,ni->n", hits.n, truth.normals) < 0)[:, None], -1.0, 1.0)
    turned = facing * truth.normals  # the gradient may point to the other side
    cross = np.linalg.norm(np.cross(hits.n, turned), axis=1)
    bent = np.where(both[:, None], hits.n - turned, 0.0).reshape(side, side, 3)
    along = np.abs(np.einsum("ni,ni->n", hits.n, turned))
    angle = np.where(both, np.arctan2(cross, along), 0.0)
    seen = truth.t[theirs] if theirs.any() else np.array([1.0, 2.0])
    near, far = float(seen.min()), float(max(np.quantile(seen, 0.99), seen.min() * 1.001))

    depth_checks = [
        _check("mask mismatches", verdict.mask_mismatches, 0),
        Check("mismatches in the band", verdict.in_band, note=_BAND),
        Check("silhouette off by, pixels", verdict.silhouette_px),
        _check("depth, max", verdict.depth_max, LIMITS["depth"]),
        Check("depth, 99.9 %", verdict.depth_999),
        Check("depth, mean", verdict.depth_mean),
        _check("position, max", verdict.position_max, LIMITS["position"]),
        _check("uv, max", verdict.uv_max, LIMITS["uv"]),
    ]
    normal_checks = [
        _check("angle, max", verdict.normal_max, LIMITS["normal"]),
        Check("angle, 99.9 %", verdict.normal_999),
        Check("angle, mean", verdict.normal_mean),
        _check("normals turned round", verdict.normal_flips, 0),
    ]
    a, b = _depths(truth.t, near, far, side, largest), _depths(hits.t, near, far, side, largest)
    an, bn = _normals(turned, theirs, side, largest), _normals(hits.n, ours, side, largest)
    size = (a.shape[1], a.shape[0])
    wrong = (ours != theirs).astype(np.float64)
    panels = [
        Panel(
            "normal",
            size,
            png.encode(an),
            png.encode(bn),
            "normals, x y z as red green blue",
            [
                _map(
                    "angle",
                    angle,
                    side,
                    largest,
                    "angle between the normals, radians; worst of a block",
                )
            ],
            normal_checks,
            preview.difference_histogram(bent, ["x", "y", "z"]),
            _worst(angle, side, largest),
        ),
        Panel(
            "depth",
            size,
            png.encode(a),
            png.encode(b),
            f"inverse depth, {near:.3g} white to {far:.3g} dark; a miss is black",
            [
                _map(
                    "depth", error, side, largest, "relative error of the depth; worst of a block"
                ),
                _map("mask", wrong, side, largest, "one of the two hits, the other misses"),
            ],
            depth_checks,
            preview.difference_histogram(signed, ["depth"]),
            _worst(error, side, largest),
        ),
    ]
    if any(c.passed is False for c in depth_checks):
        panels.reverse()
    facts = [
        ("pixels that hit", str(int(theirs.sum())), str(int(ours.sum()))),
        ("pixels in all", f"{side} × {side}", f"{side} × {side}"),
        ("computed in", "float64, NumPy", "float32, Dr.Jit"),
    ]
    return Entry(
        verdict.name,
        "pass" if verdict.passed else "fail",
        panels,
        "",
        command,
        facts,
        png.encode(preview.thumbnail(bn)),
        f"{verdict.hits} hits, {verdict.mask_mismatches} mask mismatches; "
        f"depth within {verdict.depth_max:.1e}, normals within {verdict.normal_max:.1e} rad",
    )


def _check(name: str, value: float, limit: float) -> Check:
    return Check(name, float(value), float(limit), value <= limit)
