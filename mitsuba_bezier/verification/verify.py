"""Compare what a renderer hit with what a formula says, pixel by pixel."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from .cases import Case, Truth

__all__ = ["LIMITS", "Hits", "Verdict", "verify"]


class Hits(NamedTuple):
    """What a renderer gave for rays; `t` is ``inf`` for a miss.

    Attributes
    ----------
    t : (N,) array
    p, n : (N, 3) arrays
        Hit point and unit normal.
    surface : (N, 3) array
        The point that the patch number and ``(u, v)`` of the hit mean, in float64.
    stretch : (N,) array
        ``|dp_du| + |dp_dv|`` there: how far a change of the parameters moves it. It is large
        where a patch runs to infinity.
    """

    t: np.ndarray
    p: np.ndarray
    n: np.ndarray
    surface: np.ndarray
    stretch: np.ndarray


#: Limits, and the reason of each.
LIMITS = {
    # the band about silhouettes and rims, relative to the surface: some ten roundings of float32
    "band": 1e-6,
    # error of t relative to the larger of t and the surface: near silhouettes an error across
    # the surface grows by 1 / cos
    "depth": 2e-5,
    "position": 2e-5,
    # the same for the point that (u, v) means; or of the parameters, where those stretch more
    "uv": 2e-5,
    # radians
    "normal": 1e-4,
}


@dataclass
class Verdict:
    """Figures of one case; lengths are relative as in `Case.size`, angles in radians."""

    name: str
    pixels: int
    hits: int
    mask_mismatches: int  #: beyond the band
    in_band: int  #: mismatches within it
    silhouette_px: float  #: how far from a silhouette the worst mismatch is, in pixels
    depth_max: float
    depth_999: float  #: 99.9 %
    depth_mean: float
    position_max: float
    uv_max: float
    normal_max: float
    normal_999: float
    normal_mean: float
    normal_flips: int  #: normals that point to the other side than most
    passed: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for a JSON file."""
        return asdict(self)


def _percentile(values: np.ndarray) -> tuple[float, float, float]:
    if not len(values):
        return 0.0, 0.0, 0.0
    return float(values.max()), float(np.quantile(values, 0.999)), float(values.mean())


def verify(
    case: Case, hits: Hits, truth: Truth, o: np.ndarray, d: np.ndarray, pixel: float
) -> Verdict:
    """Compare hits with the truth.

    Parameters
    ----------
    case : Case
        Where they come from.
    hits, truth : Hits, Truth
        For the same rays.
    o, d : (N, 3) arrays
        The rays, as the renderer had them.
    pixel : float
        Angle of a pixel in radians.
    """
    theirs, ours = np.isfinite(truth.t), np.isfinite(hits.t)
    wrong = ours != theirs
    finite = np.where(theirs, truth.t, 0.0)
    length = np.linalg.norm(d, axis=1)
    scale = np.maximum(case.size, finite * length)
    beyond = wrong & (truth.margin > LIMITS["band"] * scale)
    both = ours & theirs
    # hits within the band may be those of the other side of a silhouette or a rim
    judged = both & (truth.margin > LIMITS["band"] * scale)
    point = o + finite[:, None] * d

    def relative(vectors: np.ndarray) -> np.ndarray:
        return np.linalg.norm(vectors[judged], axis=-1) / scale[judged]

    depth = _percentile(np.abs(hits.t[judged] - truth.t[judged]) * (length / scale)[judged])
    dot = np.einsum("ni,ni->n", hits.n, truth.normals)
    side = 1.0 if dot[judged].sum() >= 0 else -1.0
    cross = np.linalg.norm(np.cross(hits.n, truth.normals), axis=1)
    angle = np.arctan2(cross, np.abs(dot))[judged]
    normal = _percentile(angle)
    position = relative(hits.p - point)
    away = np.linalg.norm((hits.surface - point)[judged], axis=-1)
    uv = away / np.maximum(scale, hits.stretch)[judged]
    silhouette = 0.0
    if wrong.any():
        distance = np.maximum(np.where(theirs, truth.t, np.linalg.norm(o, axis=1)), 1e-9)
        silhouette = float((truth.margin / (distance * pixel))[wrong].max())
    verdict = Verdict(
        name=case.name,
        pixels=len(d),
        hits=int(theirs.sum()),
        mask_mismatches=int(beyond.sum()),
        in_band=int((wrong & ~beyond).sum()),
        silhouette_px=silhouette,
        depth_max=depth[0],
        depth_999=depth[1],
        depth_mean=depth[2],
        position_max=float(position.max(initial=0.0)),
        uv_max=float(uv.max(initial=0.0)),
        normal_max=normal[0],
        normal_999=normal[1],
        normal_mean=normal[2],
        normal_flips=int((side * dot[judged] < 0).sum()),
    )
    verdict.passed = bool(
        verdict.hits > 0
        and verdict.mask_mismatches == 0
        and verdict.normal_flips == 0
        and verdict.depth_max <= LIMITS["depth"]
        and verdict.position_max <= LIMITS["position"]
        and verdict.uv_max <= LIMITS["uv"]
        and verdict.normal_max <= LIMITS["normal"]
    )
    return verdict
