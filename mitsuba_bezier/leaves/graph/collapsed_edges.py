"""Triangles with a collapsed edge: all of edge BC is one point, as at the pole of a lune.

At such an edge the parametrisation is singular and no subdivision makes it regular. It is cut
into strips between ``u = 2^-k`` and ``u = 2^-k-1``, each of which is a regular quadrangle
however small, until float32 cannot tell the rest from a point; that rest becomes a fan of
planar triangles.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...geometry import bernstein

__all__ = ["collapsed_edge", "fan", "strips"]

#: An edge this much shorter than the shorter of the others is treated here.
SHORT = 0.02
#: Strips end where the edge is no longer short against the strip ...
COMPARABLE = 0.25
#: ... or after this many halvings. What is left is 1e-4 of the patch, planar to 1e-8 of it;
#: smaller leaves would have no digits left in float32.
STRIPS = 12
#: Largest angle (radians) of a sector of a strip, seen from the collapsed edge.
SECTOR = 0.3


def _spread(points: np.ndarray) -> np.ndarray:
    """Return how far homogeneous points ``(P, K, 4)`` are from the first, projectively."""
    length = np.linalg.norm(points, axis=-1, keepdims=True)
    unit = points / np.where(length > 0, length, 1.0)
    dot = np.einsum("pkc,pc->pk", unit, unit[:, 0])
    across = unit - dot[..., None] * unit[:, :1]  # zero vectors are no points: they count zero
    return np.linalg.norm(across, axis=-1).max(axis=1)


def collapsed_edge(nets: np.ndarray) -> np.ndarray:
    """Return for each net ``(P, K, 4)`` the corner opposite a very short edge, or -1.

    Two short edges mean a net that is short as a whole, not a collapsed one.
    """
    ijk = bernstein.multi_indices(bernstein.degree_of(nets.shape[1]))
    centred = nets.copy()
    # projective distances depend on the origin; from near the net they are like affine ones
    w = nets[..., 3:]
    weight = np.abs(w).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = (nets[..., :3] * np.sign(w)).sum(axis=1) / weight
        middle = np.where(np.isfinite(middle), middle, 0.0)
    centred[..., :3] -= w * middle[:, None]
    size = np.linalg.norm(centred[..., :3], axis=-1).max(axis=1)[:, None, None]
    size = size / np.maximum(np.abs(centred[..., 3]).max(axis=1), 1e-300)[:, None, None]
    centred[..., :3] /= np.where(size > 0, size, 1.0)
    s = np.stack([_spread(centred[:, ijk[:, c] == 0]) for c in range(3)], axis=1)
    ordered = np.sort(s, axis=1)
    return np.where(ordered[:, 0] < SHORT * ordered[:, 1], s.argmin(axis=1), -1)


def _cut(corner: int, u: float, towards_b: float) -> np.ndarray:
    """Return the barycentrics of the point at `u` from the edge, between B (1) and C (0)."""
    out = np.zeros(3)
    out[corner] = u
    out[(corner + 1) % 3] = (1 - u) * towards_b
    out[(corner + 2) % 3] = (1 - u) * (1 - towards_b)
    return out


def _at(net: np.ndarray, barycentrics: np.ndarray) -> np.ndarray:
    return bernstein.basis(bernstein.degree_of(len(net)), barycentrics[..., :2]) @ net


def _sectors(net: np.ndarray, corner: int) -> int:
    """Return into how many sectors the strips are cut: none turns by more than `SECTOR`."""
    tip = _at(net, _cut(corner, 0.0, 0.5))
    ring = _at(net, np.array([_cut(corner, 0.25, t) for t in np.linspace(0, 1, 33)]))
    if tip[3] == 0 or (ring[:, 3] == 0).any():
        return 4
    ray = ring[:, :3] / ring[:, 3:] - tip[:3] / tip[3]
    length = np.linalg.norm(ray, axis=1, keepdims=True)
    if (length == 0).any():
        return 4
    ray /= length
    turn = np.arccos(np.clip((ray[1:] * ray[:-1]).sum(axis=1), -1, 1)).sum()
    return int(np.clip(np.ceil(turn / SECTOR), 1, 64))


def strips(net: np.ndarray, corner: int) -> tuple[np.ndarray, float]:
    """Return domain triangles ``(T, 3, 3)`` of the strips, and where they end.

    The second value is 0 if the triangles cover the whole domain, else the ``u`` below which a
    `fan` is to close it.
    """
    ijk = bernstein.multi_indices(bernstein.degree_of(len(net)))
    edge = net[ijk[:, corner] == 0]
    count = _sectors(net, corner)
    steps = np.linspace(1.0, 0.0, count + 1)  # from B to C
    half = [_cut(corner, 0.5, t) for t in (1.0, 0.0)]
    triangles = [[_cut(corner, 1.0, 1.0), *half]]
    u = 0.5
    for _ in range(STRIPS):
        inner = u / 2
        # the edge is comparable with the strip: an ordinary, if thin, quadrangle ends it
        radial = _spread(np.stack([edge[0], _at(net, _cut(corner, u, 1.0))])[None])[0]
        if _spread(edge[None])[0] > COMPARABLE * radial:
            inner = 0.0
        for s, t in pairwise(steps):
            b0, c0 = _cut(corner, u, s), _cut(corner, u, t)
            b1, c1 = _cut(corner, inner, s), _cut(corner, inner, t)
            triangles += [[b0, b1, c1], [b0, c1, c0]]
        u = inner
        if u == 0.0:
            break
    return np.array(triangles), u


def fan(net: np.ndarray, corner: int, u: float) -> tuple[np.ndarray, np.ndarray]:
    """Return planar nets ``(F, K, 4)`` that close the strips at `u`, and their domains.

    They reach a little over the end of the strips, so that chords lie outside of arcs.
    """
    n = bernstein.degree_of(len(net))
    count = max(_sectors(net, corner), 4)
    u = u / np.cos(SECTOR / 2) * 1.01
    nets, domains = [], []
    for k in range(count):
        outer = [_cut(corner, u, 1.0 - t / count) for t in (k, k + 1)]
        tip = _cut(corner, 0.0, 1.0 - (k + 0.5) / count)
        rows = np.array([outer[0], tip, outer[1]])
        points = _at(net, rows)
        if (points[:, 3] == 0).any():
            continue  # the point of the edge is at infinity: nothing there to hit
        nets.append(bernstein.elevated(points / points[:, 3:], 1, n))
        domains.append(rows.T)
    if not nets:
        return np.zeros((0, *net.shape)), np.zeros((0, 3, 3))
    return np.stack(nets), np.stack(domains)
