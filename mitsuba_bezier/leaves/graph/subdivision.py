"""Subdivide patches into graph leaves, with charts and bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from ...geometry import bernstein
from ...geometry.linear import inverses
from ...geometry.triangles import BezierTriangles
from ..nets import Nets, Powers, counts_of
from ..records import BENDING_LIMIT, GraphLeaves, LeafSettings, round_reach, weight_signs
from .bounds import leaf_bounds
from .collapsed_edges import collapsed_edge, fan, strips
from .cover import edge_reach
from .lower_degrees import HIGH, allowed, lowered
from .majorants import norm2
from .tensor_nets import in_patch_variables, patch_powers, rounding_of_build

__all__ = ["subdivide"]


def subdivide(
    nets: np.ndarray,
    patch: np.ndarray,
    settings: LeafSettings,
    wanted: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Iterator[GraphLeaves]:
    """Yield the leaves of one chunk of patches, level by level.

    Parameters
    ----------
    nets : (P, K, 4) array
        Control nets.
    patch : (P,) array
        Their numbers.
    settings : LeafSettings
        When a leaf is good enough.
    wanted : callable, optional
        Given patches ``(L,)`` and the parameters of the corners ``(L, 3, 2)`` of parts of them,
        tells which parts are needed. Others have no leaves.
    """
    n = bernstein.degree_of(nets.shape[1])
    domain = np.broadcast_to(np.eye(3), (len(nets), 3, 3)).copy()
    halvings = np.zeros(len(nets), dtype=int)  # of the area, in the parameters
    places = patch, _middles(nets)
    folded = _singular(nets)
    powers = patch_powers(nets)
    while True:
        of = np.searchsorted(places[0], patch)
        leaves, good, way = _graph_leaves(nets, domain, patch, powers[of], settings)
        yield leaves.select(good)
        singular = _singular_corner(nets)
        pending = _pending(patch, good)
        middle = places[1][of]
        last = _below_float32(leaves.box, middle, singular >= 0) | (pending > _MAX_PENDING_LEAVES)
        last[pending > _MANY_PENDING_LEAVES] |= _flat(
            nets[pending > _MANY_PENDING_LEAVES], middle[pending > _MANY_PENDING_LEAVES]
        )
        last |= halvings >= 2 * settings.max_depth
        last &= ~good
        if last.any():
            for tip in range(-1, 3):
                part = last & (singular == tip)
                if part.any():
                    yield _fallback_triangles(
                        nets[part], domain[part], patch[part], powers[of[part]], settings, tip
                    )
        rest = ~good & ~last
        if not rest.any():
            return
        nets, domain, patch = nets[rest], domain[rest], patch[rest]
        halvings, way = halvings[rest], way[rest]
        of = np.searchsorted(places[0], patch)
        small = np.flatnonzero((halvings >= _SMALL) & ~folded[of])
        folded[of[small[_folded(nets[small])]]] = True
        way[folded[of]] = _IN_FOUR
        corner = collapsed_edge(nets)
        parts, numbers, halved = [], [], []
        for number, (matrices, corners) in enumerate(_ways(n)):
            those = np.flatnonzero((corner < 0) & (way == number))
            if not len(those):
                continue
            # one product of matrices a net: many times as fast as an einsum for high degrees
            split = matrices @ nets[those]
            # rows of `corners` are barycentrics of new corners: columns of the domain map
            inner = np.einsum("pij,ekj->peik", domain[those], corners)
            parts.append((split.reshape(-1, *nets.shape[1:]), inner.reshape(-1, 3, 3)))
            numbers.append(np.repeat(patch[those], len(corners)))
            halved.append(np.repeat(halvings[those] + len(corners) // 2, len(corners)))
        cut_alike: dict[bytes, tuple[np.ndarray, list[int]]] = {}
        for i in np.flatnonzero(corner >= 0).tolist():
            triangles, end = strips(nets[i], int(corner[i]))
            cut_alike.setdefault(triangles.tobytes(), (triangles, []))[1].append(i)
            if end > 0:
                caps, inner = fan(nets[i], int(corner[i]), end)
                if len(caps):
                    owner = np.full(len(caps), patch[i])
                    theirs = powers[np.searchsorted(places[0], owner)]
                    closing = _graph_leaves(caps, domain[i] @ inner, owner, theirs, settings)[0]
                    closing.certified[:] = False  # planar: not quite the surface
                    yield closing
        for triangles, alike in cut_alike.values():
            split = bernstein.subdivide(nets[alike], triangles)
            inner = domain[alike][:, None] @ triangles.transpose(0, 2, 1)
            parts.append((split.reshape(-1, *nets.shape[1:]), inner.reshape(-1, 3, 3)))
            numbers.append(np.repeat(patch[alike], len(triangles)))
            halved.append(np.repeat(halvings[alike] + 2, len(triangles)))
        nets = np.concatenate([p[0] for p in parts])
        domain = np.concatenate([p[1] for p in parts])
        patch, halvings = np.concatenate(numbers), np.concatenate(halved)
        if wanted is not None:
            barycentrics = domain / domain.sum(axis=1, keepdims=True)
            needed = wanted(patch, barycentrics[:, :2].transpose(0, 2, 1))
            nets, domain, patch = nets[needed], domain[needed], patch[needed]
            halvings = halvings[needed]
            if not len(nets):
                return


#: How a leaf is cut: by the middle of one of its edges, opposite of the corner of that number, or
#: by the middles of all three.
_IN_FOUR = 3


@cache
def _ways(n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each way to cut: the matrices of all parts above each other, and their corners."""
    halves = []
    for e in range(3):
        parts = np.eye(3)[None].repeat(2, axis=0)
        a, b = (e + 1) % 3, (e + 2) % 3
        parts[0, b] = parts[1, a] = (np.eye(3)[a] + np.eye(3)[b]) / 2
        halves.append(parts)
    matrices = [np.concatenate([bernstein.subdivision_matrix(n, c) for c in h]) for h in halves]
    four = bernstein.split_matrices(n).reshape(-1, bernstein.size(n))
    return [*zip(matrices, halves), (four, bernstein.SPLIT_CORNERS)]


#: Most leaves of one patch that may be pending, to be cut further. A patch whose parametrisation is
#: singular along a curve has more at every level; it ends as planar triangles.
_MAX_PENDING_LEAVES = 20000
#: With this many leaves pending, those that are planar to this, relative to their coordinates, are
#: cut no further: four planar triangles in place of one are off by a fourth of it, a rounding.
_MANY_PENDING_LEAVES, _FLAT = 500, 2.5e-7
#: Least cosine between the corners, as homogeneous vectors, of a triangle that meets infinity.
_MIN_COSINE = 0.9
#: Fallback triangles are drawn out by this, so that chords cover the arcs they replace.
_GROWTH = 1.03


def _singular_corner(nets: np.ndarray) -> np.ndarray:
    """Return the corner 0, 1, 2 at which the partials of a net vanish or are parallel, or -1."""
    n = bernstein.degree_of(nets.shape[1])
    with np.errstate(all="ignore"):
        p = _affine(nets)
        areas = []
        for c in range(3):
            ijk = np.zeros((3, 3), dtype=int)
            ijk[:, c] = n - 1
            ijk[range(3), range(3)] += 1
            q = p[:, [bernstein.row(n, i, j) for i, j, _k in ijk.tolist()]]
            arms = q - q[:, [c]]
            area = np.cross(arms[:, (c + 1) % 3], arms[:, (c + 2) % 3])
            areas.append(np.linalg.norm(area, axis=1))
        area = np.stack(areas, axis=1)
        # 1e-3: the least of a leaf beside the singular corner is some hundredth of the largest
        found = (area < 1e-3 * area.max(axis=1, keepdims=True)).sum(axis=1) == 1
    return np.where(found, np.argmin(area, axis=1), -1)


def _middles(nets: np.ndarray) -> np.ndarray:
    """Return a point near the middle of each net, the origin for nets at infinity."""
    w = nets[..., 3]
    with np.errstate(all="ignore"):
        middle = (nets[..., :3] * np.sign(w)[..., None]).sum(axis=1)
        middle = middle / np.abs(w).sum(axis=1)[:, None]
    return np.where(np.isfinite(middle).all(axis=1)[:, None], middle, 0.0)


def _below_float32(box: np.ndarray, middle: np.ndarray, singular: np.ndarray) -> np.ndarray:
    """Return a mask of leaves too small to have a chart in float32, whose origin is rounded.

    They lie at singular corners such as the apex of a cone. Further cuts could not make them
    better: they would all be cut down to the last level. What counts is their size in that of the
    patch, whose `middle` is given: far from the origin of space, as long as its float32 numbers
    can place a chart, leaves are what they are near it.
    """
    with np.errstate(invalid="ignore"):
        size = (box[:, 1] - box[:, 0]).max(axis=1)
        # 3e-6: some fifty roundings of the origin. At the singular corner itself 3e-5, so that
        # the leaves around it, a tenth as large, are not too small
        small = size < np.where(singular, 3e-5, 3e-6) * np.abs(box - middle[:, None]).max(
            axis=(1, 2)
        )
        # 1e-6: the chart's origin is within a tenth of the leaf
        return small | (size < np.where(singular, 1e-5, 1e-6) * np.abs(box).max(axis=(1, 2)))


def _flat(nets: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return a mask of nets with weights of one sign that are planar up to `_FLAT`."""
    w = nets[..., 3]
    finite = np.logical_or((w > 0).all(axis=1), (w < 0).all(axis=1))
    p = _affine(np.where(finite[:, None, None], nets, 1.0)) - middle[:, None]
    size = np.abs(p).max(axis=2).min(axis=1)  # the nearest: a leaf may reach far out
    p = p - p.mean(axis=1, keepdims=True)
    finite &= np.isfinite(p).all(axis=(1, 2))
    # not by eigenvalues of squares: rounding alone makes some 1e-8 of the extent of their roots
    spread = np.linalg.svd(np.where(finite[:, None, None], p, 0.0), compute_uv=False)[:, -1]
    return finite & (spread < _FLAT * size)


def _normals(matrices: tuple[np.ndarray, ...], nets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals ``(L, N, 3)`` at some points, times the square of the weights, and these.

    `matrices` take nets to values and partials.
    """
    value, du, dv = (m @ nets for m in matrices)
    p = _affine(value)
    normal = np.cross(du[..., :3] - p * du[..., 3:], dv[..., :3] - p * dv[..., 3:])
    return normal, value[..., 3]


def _folded(nets: np.ndarray) -> np.ndarray:
    """Return a mask of nets whose normals, at seven points, turn over or nearly vanish at some."""
    with np.errstate(all="ignore"):
        # times the squares of weights, which are nearly equal, or the answer no matter
        normal = _normals(_seven(bernstein.degree_of(nets.shape[1])), nets)[0]
        length = np.linalg.norm(normal, axis=2)
        most = normal[np.arange(len(nets)), length.argmax(axis=1)]
        inner = np.einsum("lpc,lc->lp", normal, most)
        return np.asarray(~(inner.min(axis=1) >= _FOLDED * inner.max(axis=1)))


#: A patch is looked at on a lattice of so many steps for points where it is singular, and counts as
#: singular where normals are this much shorter than the longest.
_STEPS, _VANISHING = 12, 1e-3


@cache
def _lattice(n: int) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Return matrices to values and partials on the lattice, and the pairs of neighbours."""
    at = bernstein.multi_indices(_STEPS)
    du, dv = bernstein.partials_matrices(n)
    lower = bernstein.basis(n - 1, at[:, :2] / _STEPS)
    pairs = [
        (r, bernstein.row(_STEPS, i - a, j - b))
        for r, (i, j, k) in enumerate(at.tolist())
        for a, b in ((1, 0), (0, 1), (1, -1))
        if i >= a and j >= b and k + a + b >= 0 and i - a + j - b <= _STEPS
    ]
    return (bernstein.basis(n, at[:, :2] / _STEPS), lower @ du, lower @ dv), np.array(pairs)


def _singular(nets: np.ndarray) -> np.ndarray:
    """Return a mask of patches on which normals vanish, or turn over between two points."""
    matrices, pairs = _lattice(bernstein.degree_of(nets.shape[1]))
    parts = [
        _singular_on(matrices, pairs, nets[i : i + _CHUNK]) for i in range(0, len(nets), _CHUNK)
    ]
    return np.concatenate([np.zeros(0, dtype=bool), *parts])


def _singular_on(
    matrices: tuple[np.ndarray, ...], pairs: np.ndarray, nets: np.ndarray
) -> np.ndarray:
    with np.errstate(all="ignore"):
        normal, w = _normals(matrices, nets)
        normal = normal / (w * w)[..., None]
        length = np.linalg.norm(normal, axis=2)
        regular = length.min(axis=1) >= _VANISHING * length.max(axis=1)
        a, b = normal[:, pairs[:, 0]], normal[:, pairs[:, 1]]
        regular &= ((a * b).sum(axis=2) > 0).all(axis=1)
    return np.asarray(~regular)


#: Normals of a leaf this much shorter than the longest, or turned over, tell that its patch is
#: singular there: leaves along such curves would get thinner and thinner if cut in two.
_FOLDED = 0.02
#: Leaves are asked for that after so many halvings: larger ones may be curved so much.
_SMALL = 4


def _pending(patch: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Return for each leaf how many of its patch are not good."""
    return np.bincount(patch[~good], minlength=int(patch.max(initial=0)) + 1)[patch]


def _fallback_triangles(
    nets: np.ndarray,
    domain: np.ndarray,
    patch: np.ndarray,
    powers: np.ndarray,
    settings: LeafSettings,
    corner: int,
) -> GraphLeaves:
    """Return planar leaves in place of those that cannot be made good.

    Each is cut into four planar triangles through its own points; where a patch went over its
    budget they are what `docs/intersection.md` calls the unguaranteed case. A leaf with a
    singular `corner` is cut into 32 triangles around that corner, which is what a cone is: at
    3e-5 of the scene they are off by 1e-8 of it.
    """
    n = bernstein.degree_of(nets.shape[1])
    corners = bernstein.SPLIT_CORNERS  # rows: barycentrics of the corners of each triangle
    if corner >= 0:
        corners = _around(corner)
    points = np.einsum("trk,pkc->ptrc", bernstein.basis(n, corners[..., :2]), nets)
    points = points.reshape(-1, 3, 4)
    w = points[..., 3:]
    finite = ((w > 0).all(axis=1) | (w < 0).all(axis=1))[:, :, None]
    points = np.where(finite, points / np.where(w == 0, 1.0, w), points)
    # beside a base point, where all four coordinates vanish, points of a leaf lie anywhere on a
    # line; a triangle through them and through infinity would be met by half of all rays
    size = np.linalg.norm(points, axis=2, keepdims=True)
    ray = points / np.where(size > 0, size, 1.0)
    close = np.einsum("tic,tjc->tij", ray, ray).min(axis=(1, 2)) > _MIN_COSINE
    middle = points.mean(axis=1, keepdims=True)
    points = middle + _GROWTH * (points - middle)
    points = bernstein.elevated(points, 1, n)
    inner = np.einsum("pij,trj->ptir", domain, corners).reshape(-1, 3, 3)
    patch, powers = (np.repeat(x, len(corners), axis=0) for x in (patch, powers))
    leaves, good, _way = _graph_leaves(points, inner, patch, powers, settings)
    leaves.certified[:] = False
    # what is not good has no area, and no ray meets it
    return leaves.select(good & (close | finite[:, 0, 0]))


def _around(corner: int, count: int = 32) -> np.ndarray:
    """Return barycentrics ``(count, 3, 3)`` of the corners of triangles around one corner."""
    s = np.arange(count + 1) / count
    edge = np.zeros((count + 1, 3))
    edge[:, (corner + 1) % 3], edge[:, (corner + 2) % 3] = 1 - s, s
    out = np.zeros((count, 3, 3))
    out[:, 0, corner] = 1.0
    out[:, 1], out[:, 2] = edge[:-1], edge[1:]
    return out


def _affine(net: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return net[..., :3] / net[..., 3:]


def _normalise_weights(nets: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scale the corner weights to one by a Möbius change of the barycentrics.

    Returns the nets, the factors ``m`` with ``u_patch ~ m u_leaf``, and whether the leaf is
    finite: all weights of one sign.
    """
    sign = weight_signs(nets)
    finite = sign != 0
    nets = nets * np.where(finite, sign, 1.0)[:, None, None]
    corners = nets[:, bernstein.corner_rows(n)]
    size = np.where(finite[:, None], corners[..., 3], np.linalg.norm(corners, axis=-1))
    # a corner that is the zero vector cannot be scaled
    m = np.where(size > 0, size, 1.0) ** (-1.0 / n)
    ijk = bernstein.multi_indices(n)
    nets = nets * np.prod(m[:, None, :] ** ijk[None], axis=-1)[..., None]
    return nets, m, finite


def _charts(nets: np.ndarray, finite: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return shift ``(L, 3)`` and frame ``(L, 4, 4)``, both rounded to float32."""
    corners = nets[:, bernstein.corner_rows(n)]
    rows = np.zeros((len(nets), 4, 4))
    with np.errstate(all="ignore"):
        p = _affine(corners)
        normal = np.cross(p[:, 0] - p[:, 2], p[:, 1] - p[:, 2])
        area2 = np.linalg.norm(normal, axis=1)
        unit = normal / area2[:, None] * np.sqrt(area2)[:, None]
    shift = np.where(finite[:, None], p[:, 2], 0.0)
    shift = np.where(np.isfinite(shift), shift, 0.0).astype(np.float32).astype(np.float64)
    basis = corners.copy()  # rows P0, P1, P2
    basis[..., :3] -= basis[..., 3:] * shift[:, None]
    apex = np.zeros((len(nets), 4))
    apex[:, :3] = unit
    scale = np.linalg.norm(basis, axis=-1)
    if not finite.all():
        # fourth point of a projective chart: orthogonal to the corners, of their size
        far = basis[~finite]
        _u, _s, vt = np.linalg.svd(np.where(np.isfinite(far), far, 0.0))
        apex[~finite, :] = vt[:, 3] * scale[~finite].mean(axis=1)[:, None]
    basis = np.concatenate([basis, apex[:, None]], axis=1)
    local = basis.copy()
    with np.errstate(all="ignore"):  # in the size of the leaf
        local[..., :3] /= np.abs(basis[..., :3]).max(axis=(1, 2), keepdims=True)
    # coordinates (U0, U1, U2, s)
    inverse, usable = inverses(basis.transpose(0, 2, 1), local.transpose(0, 2, 1))
    rows[:, 0], rows[:, 1], rows[:, 2] = inverse[:, 0], inverse[:, 1], inverse[:, 3]
    rows[:, 3] = inverse[:, :3].sum(axis=1)
    # the affine chart's origin is the shift itself, so only a 3x3 matrix is left
    rows[finite & usable, :3, 3] = 0.0
    rows[finite & usable, 3] = (0.0, 0.0, 0.0, 1.0)
    with np.errstate(over="ignore"):
        rounded = rows.astype(np.float32).astype(np.float64)
    bad = ~usable | ~np.isfinite(rounded).all(axis=(1, 2))
    rounded[bad] = np.eye(4)
    return shift, rounded


#: Rays look for a leaf this far beyond its edges: rounding moves grazing hits along the surface.
_PAD = 1e-4

#: What culling in float32 may be off at a coordinate, over the chart's largest entry `m` times
#: the leaf's extent `r`. With a unit `u` of rounding, the point near the leaf, which is at most `r`
#: away, makes 4 u m r of it, and the direction 3 u m over at most `2 r`; and root 3 for 1-norms.
_CULLING = 18 * 2.0**-24

#: Leaves examined at a time: bounds the memory, not the result.
_CHUNK = 4096


def _graph_leaves(
    nets: np.ndarray,
    domain: np.ndarray,
    patch: np.ndarray,
    powers: np.ndarray,
    settings: LeafSettings,
) -> tuple[GraphLeaves, np.ndarray, np.ndarray]:
    """Fit a chart to each net; return the leaves, a mask of good ones, and `_ways`.

    `powers` are those of their patches.
    """
    parts = [
        _fit_charts(nets[c], domain[c], patch[c], powers[c], settings)
        for c in (slice(i, i + _CHUNK) for i in range(0, max(len(nets), 1), _CHUNK))
    ]
    if len(parts) == 1:
        return parts[0]
    leaves, good, way = zip(*parts)
    return GraphLeaves.join(list(leaves)), np.concatenate(good), np.concatenate(way)


def _fit_charts(
    nets: np.ndarray,
    domain: np.ndarray,
    patch: np.ndarray,
    powers: np.ndarray,
    settings: LeafSettings,
) -> tuple[GraphLeaves, np.ndarray, np.ndarray]:
    n = bernstein.degree_of(nets.shape[1])
    nets, moebius, finite = _normalise_weights(nets, n)
    shift, frame = _charts(nets, finite, n)
    moved = nets.copy()
    moved[..., :3] -= moved[..., 3:] * shift[:, None]
    chart = np.einsum("lrc,lkc->lkr", frame, moved)  # x, y, z, W
    w = chart[..., 3]
    spread = np.abs(w - 1).max(axis=1)
    rows = np.flatnonzero((w > 0).all(axis=1) & (spread <= settings.weight))
    way = np.full(len(nets), _IN_FOUR)
    hopeless, way[rows] = _seen(chart[rows], settings)
    rows = rows[~hopeless]
    reach, inward = edge_reach(chart[rows])
    rounding = np.where(finite[rows], _rounding(nets[rows], shift[rows], frame[rows]), 0.0)
    reach = round_reach(reach + (_PAD + rounding)[:, None])
    inward = round_reach(inward + rounding[:, None])
    margin = reach.max(axis=1)
    # the kernel has but one number for projective charts
    reach[~finite[rows]] = margin[~finite[rows], None]
    good = np.zeros(len(nets), dtype=bool)
    bounds = leaf_bounds(chart[rows], reach, inward, settings.lateral)
    good[rows] = (
        bounds.proved
        & (bounds.lateral <= settings.lateral)
        & (bounds.remainder <= settings.remainder)
        & (bounds.height <= settings.height)
    )
    quadratic, start = bounds.quadratics[:, :3], bounds.quadratics[:, 3:].reshape(-1, 2, 3)
    # the slope of the quadratic takes what is off along the chart to a height: its gradient is at
    # most 2 sqrt(2) times the sum of its coefficients over the unit triangle, some more beyond it
    with np.errstate(invalid="ignore"):  # an infinite margin, where nothing is proved
        bends = 1 + 3 * (1 + 3 * margin) * np.abs(quadratic).sum(axis=1)
    proved = {
        "quadratic": quadratic,
        "start": start,
        "remainder": bounds.remainder + bends * rounding,
        "variation": bounds.variation,
        "bending": np.minimum(bounds.bending, BENDING_LIMIT),
        "size": bounds.size,
        "outward": reach,
        "inward": inward,
    }
    usable = np.ones(len(rows), dtype=bool)
    for values in proved.values():
        usable &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    for name, values in proved.items():
        proved[name] = np.zeros((len(nets), *values.shape[1:]), values.dtype)
        proved[name][rows[usable]] = values[usable]
    deviation = chart.copy()
    ijk = bernstein.multi_indices(n)
    deviation[..., 0] -= ijk[:, 0] / n
    deviation[..., 1] -= ijk[:, 1] / n
    deviation[..., 3] -= 1.0
    leaves = GraphLeaves(
        patch=patch,
        domain=domain * moebius[:, None, :],
        shift=shift,
        chart=frame,
        nets=_stored(
            deviation,
            good,
            (frame[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1),
            proved["size"],
            domain,
            powers,
            rounding_of_build(nets, frame),
        ),
        box=BezierTriangles(nets).hulls(),
        certified=good.copy(),
        **proved,
    )
    return leaves, good, way


def _stored(
    net: np.ndarray,
    wanted: np.ndarray,
    affine: np.ndarray,
    size: np.ndarray,
    domain: np.ndarray,
    powers: np.ndarray,
    unsure: np.ndarray,
) -> Nets:
    """Return the nets of leaves as rays read them: monomial, in the variables that need the fewest.

    Those of high degree are lowered. Not in projective charts, where float64 counts. Leaves that
    are not `wanted` have nets of zeros.
    """
    n = bernstein.degree_of(net.shape[1])
    monomials = bernstein.monomial_matrix(n)
    near, far = np.flatnonzero(wanted & affine), np.flatnonzero(wanted & ~affine)
    rest = np.flatnonzero(~wanted)
    parts = [Nets.of(monomials @ net[far]), Nets.zeros(len(rest))]
    places = [far, rest]
    lower = lowered(net[near], size[near]) if n > HIGH else Nets.of(monomials @ net[near])
    counts, least = counts_of(powers[near]), powers[near, :2].min(axis=1)
    # nets that may have code of their own have the same powers, rather than a few less each
    fewer = (counts < lower.count) | ((counts <= bernstein.size(HIGH)) & (lower.degree > least))
    fewer &= least < n
    for own in np.unique(powers[near[fewer]], axis=0):
        those = np.flatnonzero(fewer & (powers[near] == own).all(axis=1))
        tensor, found = in_patch_variables(
            monomials @ net[near[those]],
            domain[near[those]],
            Powers(*own.tolist()),
            size[near[those]],
            # of high degree a change of variables would add as much again
            np.maximum(unsure[near[those]] if n <= HIGH else 0.0, np.full(len(those), allowed(n))),
        )
        parts.append(tensor[found])
        places.append(near[those[found]])
        fewer[those[~found]] = False
    parts.append(lower[~fewer])
    places.append(near[~fewer])
    return Nets.join(parts)[np.argsort(np.concatenate(places))]


def _rounding(nets: np.ndarray, shift: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return what culling may be off at the chart coordinates of finite leaves; see `_CULLING`."""
    with np.errstate(all="ignore"):
        extent = np.abs(_affine(nets) - shift[:, None]).max(axis=1).sum(axis=1)
        return np.nan_to_num(_CULLING * np.abs(frame[:, :3, :3]).max(axis=(1, 2)) * extent)


@cache
def _seven(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return matrices to the values and partials at corners, middles of edges and the middle."""
    uv = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0, 0.5], [0.5, 0.5], [1 / 3, 1 / 3]])
    du, dv = bernstein.partials_matrices(n)
    lower = bernstein.basis(n - 1, uv)
    return bernstein.basis(n, uv), lower @ du, lower @ dv


#: A leaf is cut in two if one of its edges is bent this much more than another. With 2 tori have
#: 2 % more leaves, and those that are bent alike in all directions are better cut in four.
_ONE_WAY = 3.0


def _seen(chart: np.ndarray, settings: LeafSettings) -> tuple[np.ndarray, np.ndarray]:
    """Look at seven points of leaves.

    Returns
    -------
    hopeless : (L,) bool array
        Leaves too crooked: most are, and bounds are dear.
    way : (L,) int array
        Of `_ways`: how to cut them. Along one direction if they are bent in that one, as strips
        between two circles are, which would else become much too many across.
    """
    value, du, dv = (m @ chart for m in _seven(bernstein.degree_of(chart.shape[1])))
    inv = 1.0 / value[..., 3:]
    p = value[..., :3] * inv
    pu, pv = (du[..., :3] - p * du[..., 3:]) * inv, (dv[..., :3] - p * dv[..., 3:]) * inv
    lateral = norm2(pu[..., 0] - 1, pv[..., 0], pu[..., 1], pv[..., 1] - 1).max(axis=1)
    hopeless = (lateral > settings.lateral) | (np.abs(p[..., 2]).max(axis=1) > settings.height)
    # how much the partial along an edge changes on it: BC, CA and AB, by the corners opposite, in
    # the order of `_ways`; the first three points are C, A and B
    turns = pv[:, 2] - pv[:, 0], pu[:, 1] - pu[:, 0], (pu - pv)[:, 1] - (pu - pv)[:, 2]
    bent = np.stack([np.linalg.norm(turn, axis=-1) for turn in turns])
    bent = np.maximum(bent, _bent_nets(chart))
    one_way = bent.max(axis=0) > _ONE_WAY * bent.min(axis=0)
    return hopeless, np.where(one_way, bent.argmax(axis=0), _IN_FOUR)


def _bent_nets(chart: np.ndarray) -> np.ndarray:
    """Return ``(3, L)`` how much the sides of the control polygons of the edges turn, added up.

    An edge with an inflection may end with the partial it began with. Never cut, while the other
    two are, it would leave thinner and thinner needles.
    """
    n = bernstein.degree_of(chart.shape[1])
    edges = bernstein.edge_rows(n)[[1, 2, 0]]
    points = chart[:, edges, :3] / chart[:, edges, 3:]
    return n * np.linalg.norm(np.diff(points, 2, axis=2), axis=-1).sum(axis=-1).T
