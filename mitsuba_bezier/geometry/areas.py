"""Integrate areas of patches; each is refined only where it needs to be."""

from __future__ import annotations

from functools import cache

import numpy as np

from . import bernstein
from .boxes import reaches_infinity

__all__ = ["patch_areas"]

#: Gauss-Legendre nodes in each of two directions.
_NODES = 12
#: Splits of a part. Where the normal turns over along a curve, as where a patch is folded, the
#: parts at it are so few and small that what they are off does not count.
_LEVELS = 8
#: Numbers of a set of parts that are evaluated at a time.
_CHUNK = 2**18
#: Rounding of ``|dp_du x dp_dv|``, relative to ``|dp_du| |dp_dv|``.
_ROUNDING = 1e-13


@cache
def _rule(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return matrices ``(3, Q, K)`` to points and partials at the nodes, and the weights ``(Q,)``.

    Gauss-Legendre on the triangle collapsed to the square.
    """
    nodes, gauss = np.polynomial.legendre.leggauss(_NODES)
    nodes, gauss = (nodes + 1) / 2, gauss / 2
    s, t = np.meshgrid(nodes, nodes, indexing="ij")
    uv = np.stack([s, (1 - s) * t], axis=-1).reshape(-1, 2)
    du, dv = bernstein.partials_matrices(n)
    lower = bernstein.basis(n - 1, uv)
    matrices = np.stack([bernstein.basis(n, uv), lower @ du, lower @ dv])
    return matrices, np.outer(gauss * (1 - nodes), gauss).reshape(-1)


def _integrals(nets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the integrals of ``|dp_du x dp_dv|`` over nets, and what rounding makes of them."""
    matrices, weights = _rule(bernstein.degree_of(nets.shape[1]))
    value, du, dv = (m @ nets for m in matrices)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inv = 1.0 / value[..., 3:]
        p = value[..., :3] * inv
        du, dv = ((d[..., :3] - p * d[..., 3:]) * inv for d in (du, dv))
        length = np.linalg.norm(np.cross(du, dv), axis=-1)
        scale = np.linalg.norm(du, axis=-1) * np.linalg.norm(dv, axis=-1)
        return length @ weights, _ROUNDING * (scale @ weights)


def patch_areas(nets: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the area of each patch, see `BezierTriangles.area`."""
    out = np.zeros(len(nets))
    infinite = reaches_infinity(nets)
    out[infinite] = np.inf
    finite = np.flatnonzero(~infinite)
    if not len(finite):
        return out
    # points and partials at the nodes, and their products; or what splitting takes
    step = max(_CHUNK // (4 * max(12 * _NODES**2, nets.shape[1] * 4)), 1)
    for first in range(0, len(finite), step):
        patch = finite[first : first + step]
        # relative to a point nearby: far from the origin, differences would lose digits
        local = nets[patch]
        w = local[..., 3:]
        middle = (local[..., :3] * np.sign(w)).sum(axis=1) / np.abs(w).sum(axis=1)
        local[..., :3] -= w * middle[:, None]
        out[patch] = _refined(local, tolerance, step)
    return np.where(np.isnan(out), np.inf, out)  # too large for float64


def _refined(nets: np.ndarray, tolerance: float, step: int) -> np.ndarray:
    """Return the areas of a few patches, evaluating `step` times four parts at a time."""
    coarse, _noise = _integrals(nets)
    total, out = coarse.copy(), np.zeros(len(nets))
    split = bernstein.split_matrices(bernstein.degree_of(nets.shape[1]))
    # the last in, with the smallest parts, are the first out: so few wait at a time
    stack = [(np.arange(len(nets)), nets, coarse, 0)]
    while stack:
        owner, parts, coarse, level = stack.pop()
        if len(owner) > step:
            stack.append((owner[step:], parts[step:], coarse[step:], level))
            owner, parts, coarse = owner[:step], parts[:step], coarse[:step]
        finer = (split @ parts[:, None]).reshape(-1, *parts.shape[1:])
        values, noise = (x.reshape(-1, 4) for x in _integrals(finer))
        value = values.sum(axis=1)
        off = np.abs(value - coarse)
        if level == 0:
            total = value
        done = off <= np.maximum(tolerance * total[owner], noise.sum(axis=1))
        done |= level + 1 >= _LEVELS
        np.add.at(out, owner[done], value[done])
        if not done.all():
            on = np.repeat(~done, 4)
            stack.append((np.repeat(owner[~done], 4), finer[on], values[~done].ravel(), level + 1))
    return out
