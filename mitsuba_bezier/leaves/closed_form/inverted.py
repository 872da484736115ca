"""Find patches of any degree on any quadric, or in a plane: point inversion by Newton's method.

Cylinders, cones and spheres as CAD systems write them, once their tensor-product patches are cut
along a diagonal, are the example: the diagonal is no plane section. The ray meets the quadric in
closed form; whether the point is on the patch its parameters tell, which Newton's method finds.

The centre of projection ``S`` is the point in which the normal in the middle of the patch meets
the quadric ``A`` again: projectively ``(n A n) p - 2 (p A n) n``, at infinity for planes and
saddles. Projection from there is one-to-one on the part of the quadric where the tangent plane
``D = S A x`` of ``S`` is positive, as both lines through ``S``, if there are such, lie in that
plane. In coordinates ``x = X / D, y = Y / D`` a patch is a rational map of the plane, of its own
degree; affine ones are chosen for which it is near to the identity, and Newton's method begins at
``(u, v) = (x, y)``. So there are no wrong hits: a point whose coordinates are those of a point
of the patch is that point. At the apex of a cone ``D`` is zero; there the projection is parallel,
along a direction ``n``, and a point with ``n A x >= 0`` is the one of two that is meant. That none
is missed is tried at a lattice of points; patches for which some are, are cut.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ...geometry import bernstein
from ...geometry.triangles import BezierTriangles
from ..records import QUADRIC_ENTRIES, ClosedFormLeaves, LeafKind, weight_signs
from .degree_reduction import reduce_degree
from .fits import fit_forms, in_space, local_nets, plane_forms, relative_distance, with_its_apex
from .groups import quadric_leaves
from .newton import ROUNDING, TRIED, centred, newton_converges

__all__ = ["inverted_leaves", "margin_planes"]

#: Residuals up to this are rounding: nets come through Mitsuba's float32 tensors (6e-8).
_ROUNDING = 3e-7
#: Singular values below this share of the largest leave a quadric or a plane undetermined.
_DETERMINED = 1e-4
#: A quadric is determined if the residual is so much below the next singular value, and that so
#: large: it is small for cones that are narrow or flat.
_GAP, _LEAST_GAP = 1e-2, 1e-6
#: The least of ``D`` over a patch, as a share of its largest: what projection magnifies.
_LEAST = 0.05
#: The equations of the plane times Q, which is one in the middle, tell whether a point is within
#: the tolerance of edges: Q varies by this factor at most, and the terms of a sum are no larger
#: together, so that its rounding in float32 is half of that tolerance.
_WEIGHTS, _TERMS = 16.0, 5.0
#: Ways to project, the first that does is taken.
_PROJECTIONS = ("normal", "mean", "axis")
#: Patches are cut this many times, if Newton's method does not do.
_MAX_CUTS = 2
#: Patches of higher degrees are left to others: the kernels would be too large.
_HIGHEST = 8
#: A patch on a quadric has a system of ten points and ten entries of a form that is worse
#: conditioned than this; most others have not, and need no fit.
_CONDITION = 1e5


@dataclass
class _Parts:
    """Parts of patches with their maps; `L` of them."""

    owner: np.ndarray  #: (L,) of which patch
    domain: np.ndarray  #: (L, 3, 3) as in `Leaves`
    nets: np.ndarray  #: (L, K, 4)
    rows: np.ndarray  #: (L, 4, 4) give X, Y and D - X - Y at a point, and which side it is on
    fractions: np.ndarray  #: (L, K, 4) as in `plane_sections`
    margins: np.ndarray  #: (L, 3) how far below zero the barycentrics of the plane go

    def select(self, mask: np.ndarray) -> _Parts:
        return _Parts(**{f.name: getattr(self, f.name)[mask] for f in fields(_Parts)})

    @staticmethod
    def join(parts: list[_Parts]) -> _Parts:
        return _Parts(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(_Parts)}
        )


def inverted_leaves(patches: BezierTriangles) -> tuple[np.ndarray, ClosedFormLeaves]:
    """Find such patches, with weights of one sign, and return ``(mask, leaves)``.

    Those that are elevations, as in sets of mixed degrees, are inverted at their own degree.
    """
    found = np.zeros(len(patches), dtype=bool)
    parts = []
    left = np.flatnonzero(_on_quadrics(patches)[0])
    for degree in range(2, patches.degree + 1):
        if not len(left) or degree > _HIGHEST:
            break
        reducible, lower, residual = reduce_degree(patches[left], degree)
        if lower is None:
            continue
        which, leaves = _of_this_degree(lower)
        if degree < patches.degree:  # or it is rounding
            leaves.deviation += residual[leaves.patch]
        leaves.patch = left[reducible][leaves.patch]
        found[left[reducible][which]] = True
        parts.append(leaves)
        left = left[~reducible]
    return found, ClosedFormLeaves.join(parts)


def _on_quadrics(patches: BezierTriangles) -> tuple[np.ndarray, ...]:
    """Find the patches that lie on quadrics, or in planes.

    Returns
    -------
    found : (P,) bool array
    local, shift, size, forms : arrays
        Of those found: what `local_nets` says, with positive weights, and the quadrics.
    """
    sign = weight_signs(patches.control_points)
    found = (sign != 0) & (patches.degree > 1)
    local, shift, size = local_nets(patches)
    local *= sign[:, None, None]
    which = np.flatnonzero(found)
    which = which[_may_lie_on_quadrics(local[which], patches.degree)]
    forms = np.zeros((len(which), 4, 4))
    if len(which):
        forms, fits = _fit(local[which], patches.degree)
        which, forms = which[fits], forms[fits]
    found = np.zeros_like(found)
    found[which] = True
    return found, local[which], shift[which], size[which], forms


def _of_this_degree(patches: BezierTriangles) -> tuple[np.ndarray, ClosedFormLeaves]:
    """Do what `inverted_leaves` does, for patches that are no elevations."""
    n = patches.degree
    found, local, shift, size, forms = _on_quadrics(patches)
    which = np.flatnonzero(found)
    found[:] = False
    if not len(which):
        return found, ClosedFormLeaves.zeros()
    parts, whole = _invert(local, forms, n)
    if not whole.any():
        return found, ClosedFormLeaves.zeros()
    parts = parts.select(whole[parts.owner])
    owner = parts.owner
    rows, quadric = in_space(parts.rows, forms[owner], size[owner])
    kind = np.where(parts.rows[:, 3].any(axis=1), LeafKind.INVERTED_APEX, LeafKind.INVERTED)
    # the parts themselves, back in space
    cut = parts.nets.copy()
    cut[..., :3] *= size[owner, None, None]
    cut[..., :3] += cut[..., 3:] * shift[owner, None]
    leaves = quadric_leaves(
        BezierTriangles(cut),
        np.arange(len(owner)),
        shift[owner],
        rows,
        quadric,
        kind,
        domain=parts.domain,
        margins=parts.margins,
        polynomials=parts.fractions,
    )
    leaves.patch = which[owner[leaves.patch]]
    found[which[whole]] = True
    return found, leaves


def margin_planes(leaves: ClosedFormLeaves) -> np.ndarray:
    """Return planes ``(L, 3, 4)``, as rows on ``(p - shift, 1)``, between which such leaves lie."""
    rows = leaves.rows[:, :3]
    return rows + leaves.margins[..., None] * rows.sum(axis=1, keepdims=True)


def _may_lie_on_quadrics(local: np.ndarray, n: int) -> np.ndarray:
    """Return a mask, quickly, of nets that may lie on a quadric: from ten points of each."""
    lattice = bernstein.multi_indices(3)[:, :2] / 3.0
    points = bernstein.basis(n, lattice) @ local
    points = points / np.maximum(np.linalg.norm(points, axis=2, keepdims=True), 1e-300)
    system = np.stack([points[..., i] * points[..., j] for i, j in QUADRIC_ENTRIES], axis=-1)
    s = np.linalg.svd(system, compute_uv=False)
    return s[:, -1] * _CONDITION < s[:, 0]


def _fit(local: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Fit quadrics, or planes times the plane at infinity: ``(P, 4, 4)``; and tell which fit."""
    lattice = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    points = bernstein.basis(n, lattice) @ local
    forms, s = fit_forms(points)
    fits = (s[:, -1] <= _ROUNDING * s[:, 0]) & (s[:, -2] > _LEAST_GAP * s[:, 0])
    fits &= s[:, -1] <= _GAP * s[:, -2]
    for i in np.flatnonzero(fits):
        forms[i] = with_its_apex(forms[i], local[i : i + 1])
    distance = relative_distance(BezierTriangles(local), forms, np.zeros((len(local), 3)))
    fits &= distance < _ROUNDING
    _u, s, vt = np.linalg.svd(local)
    plane = vt[:, 3]
    planar = (s[:, 3] <= _ROUNDING * s[:, 0]) & (s[:, 2] > _DETERMINED * s[:, 0])
    planar &= np.linalg.norm(plane[:, :3], axis=1) > _DETERMINED  # not the plane at infinity
    return np.where(planar[:, None, None], plane_forms(plane), forms), fits | planar


def _invert(local: np.ndarray, forms: np.ndarray, n: int) -> tuple[_Parts, np.ndarray]:
    """Find maps of nets, or of parts of them; tell for which there are such for all of it."""
    owner, nets = np.arange(len(local)), local
    domain = np.broadcast_to(np.eye(3), (len(local), 3, 3))
    done: list[_Parts] = []
    for level in range(_MAX_CUTS + 1):
        parts, good = _maps(owner, domain, nets, forms[owner], n)
        done.append(parts.select(good))
        rest = ~good
        if level == _MAX_CUTS or not rest.any():
            break
        owner = np.repeat(owner[rest], 4)
        domain = np.einsum("pij,ekj->peik", domain[rest], bernstein.SPLIT_CORNERS)
        domain = domain.reshape(-1, 3, 3)
        nets = np.einsum("ekl,plc->pekc", bernstein.split_matrices(n), nets[rest])
        nets = nets.reshape(-1, *local.shape[1:])
    whole = np.ones(len(local), dtype=bool)
    whole[owner[rest]] = False
    return _Parts.join(done), whole


def _maps(
    owner: np.ndarray, domain: np.ndarray, nets: np.ndarray, forms: np.ndarray, n: int
) -> tuple[_Parts, np.ndarray]:
    """Project nets, in one of three ways, and tell where the result can be inverted.

    Parameters are changed first where the corners' weights differ, so that these are one.
    """
    corners = nets[:, bernstein.corner_rows(n), 3]
    differ = corners.max(axis=1) > 2 * corners.min(axis=1)
    scale = np.where(differ[:, None], corners ** (-1 / n), 1.0)
    domain = domain * scale[:, None]
    nets = nets * np.prod(scale[:, None] ** bernstein.multi_indices(n), axis=2)[..., None]
    out, good = _project(owner, domain, nets, forms, n, _PROJECTIONS[0])
    for way in _PROJECTIONS[1:]:
        rest = np.flatnonzero(~good)
        if not len(rest):
            break
        other, good[rest] = _project(owner[rest], domain[rest], nets[rest], forms[rest], n, way)
        for f in fields(_Parts):
            getattr(out, f.name)[rest] = getattr(other, f.name)
    return out, good


def _project(
    owner: np.ndarray,
    domain: np.ndarray,
    nets: np.ndarray,
    forms: np.ndarray,
    n: int,
    way: str,
) -> tuple[_Parts, np.ndarray]:
    """Project nets in one way; see `_rows`."""
    lattice = bernstein.multi_indices(TRIED)
    uv = lattice[:, :2] / TRIED
    with np.errstate(all="ignore"):
        rows, good = _rows(nets, forms, n, uv, way)
        maps = np.einsum("prc,pkc->pkr", rows[:, :3], nets)  # X, Y, D - X - Y
        good &= _is_regular(maps, n, lattice)
        x, y, rest = maps.transpose(2, 0, 1)
        total = x + y + rest
        fractions = np.stack([x - total / 2, y - total / 2, total, 0 * total], axis=-1)
        fractions = centred(n) @ fractions
        fractions /= fractions[:, bernstein.row(n, 0, 0), 2][:, None, None]
        good &= np.isfinite(fractions).all(axis=(1, 2)) & _is_even(fractions, n, uv)
        tried = np.flatnonzero(good)
        good[tried] = newton_converges(maps[tried], fractions[tried], n)
        fine = maps
        for _ in range(2):
            fine = np.einsum("ekl,plc->pekc", bernstein.split_matrices(n), fine)
            fine = fine.reshape(-1, *maps.shape[1:])
        below = -fine / fine.sum(axis=2, keepdims=True)
        below = below.reshape(len(maps), -1, 3) if len(maps) else np.zeros((0, 1, 3))
        margins = np.maximum(below.max(axis=1), 0.0)
    return _Parts(owner, domain.copy(), nets, rows, fractions, margins), good


def _rows(
    nets: np.ndarray, forms: np.ndarray, n: int, uv: np.ndarray, way: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows ``(P, 4, 4)``, see `_Parts`, and where the projection magnifies no rounding.

    The centre is where the quadric is met again by the normal in the middle, or by the line from
    there to the mean of all points: no affine map changes that. Along the axis of a cone a line
    meets it twice, on different sides of the plane ``n A x = 0``, to which the fourth row belongs;
    else that is zero.
    """

    def product(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.einsum("pi,pij,pj->p", x, forms, y)[:, None]

    points = bernstein.basis(n, uv) @ nets
    points /= points[..., 3:]
    p = (bernstein.basis(n, np.full((1, 2), 1 / 3)) @ nets)[:, 0]
    p /= p[:, 3:]
    rows = np.zeros((len(nets), 4, 4))
    if way == "axis":
        centre, good = _axes_of_cones(forms)
        d = np.broadcast_to([0.0, 0, 0, 1], p.shape)
        rows[:, 3] = np.einsum("pij,pj->pi", forms, centre)
        side = np.einsum("pc,psc->ps", rows[:, 3], points)
        most = np.take_along_axis(side, np.abs(side).argmax(axis=1)[:, None], axis=1)
        rows[:, 3] /= most  # positive on the patch
        good &= (side / most > -_ROUNDING).all(axis=1)
    else:
        normal = np.einsum("pij,pj->pi", forms, p) * [1.0, 1, 1, 0]
        if way == "mean":
            normal = points.mean(axis=1) - p
        normal = _unit(normal)
        for _ in range(2):  # onto the quadric, more exactly
            p = p - product(p, p) / (2 * product(p, normal)) * normal
        centre = product(normal, normal) * p - 2 * product(p, normal) * normal
        centre /= np.linalg.norm(centre, axis=1, keepdims=True)
        d = np.einsum("pij,pj->pi", forms, centre)
        d /= np.einsum("pc,pc->p", d, p)[:, None]  # one in the middle
        height = np.einsum("pc,psc->ps", d, points)
        good = height.min(axis=1) > _LEAST * height.max(axis=1)
    pair = np.stack([centre, p], axis=1)
    good &= np.isfinite(pair).all(axis=(1, 2))
    _u, s, vt = np.linalg.svd(np.where(good[:, None, None], pair, 0.0))
    good &= s[:, 1] > _DETERMINED * s[:, 0]
    rows[:, :2] = vt[:, 2:]  # they vanish at the centre and in the middle
    value = np.einsum("prc,psc->psr", rows[:, :2], points)
    value = value / np.einsum("pc,psc->ps", d, points)[..., None]
    plane = np.concatenate([value, np.ones_like(value[..., :1])], axis=2)
    usable = np.isfinite(plane).all(axis=(1, 2))
    u, s, vt = np.linalg.svd(np.where(usable[:, None, None], plane, 0.0), full_matrices=False)
    usable &= s[:, 2] > _ROUNDING * s[:, 0]
    inverse = np.where(usable[:, None], 1.0 / np.where(usable[:, None], s, 1.0), 0.0)
    affine = np.einsum("psi,sd,pi,pij->pdj", u, uv, inverse, vt, optimize=True)
    rows[:, :2] = affine[..., :2] @ rows[:, :2] + affine[..., 2:] * d[:, None]
    rows[:, 2] = d - rows[:, 0] - rows[:, 1]
    good &= usable & np.isfinite(rows).all(axis=(1, 2))
    rows[~good] = 0.0
    return rows, good


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _axes_of_cones(forms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return directions ``(P, 4)`` inside of cones, and which forms are those of cones."""
    values, vectors = np.linalg.eigh(forms)
    order = np.abs(values).argsort(axis=1)
    values = np.take_along_axis(np.abs(values), order, axis=1)
    apex = np.take_along_axis(vectors, order[:, None, :1], axis=2)[..., 0]
    good = (values[:, 0] < 1e-3 * values[:, 1]) & (np.abs(apex[:, 3]) > _DETERMINED)
    # one eigenvalue has a sign of its own
    values, vectors = np.linalg.eigh(forms[:, :3, :3])
    axis = np.where((values[:, 1] > 0)[:, None], vectors[..., 0], vectors[..., 2])
    return np.concatenate([axis, np.zeros((len(forms), 1))], axis=1), good


def _is_even(fractions: np.ndarray, n: int, uv: np.ndarray) -> np.ndarray:
    """Return a mask of nets where Q, and the rounding of the equations, differ little."""
    i, j = bernstein.multi_indices(n)[:, :2].T
    powers = (uv[:, :1] - 1 / 3) ** i * (uv[:, 1:] - 1 / 3) ** j
    q = powers @ fractions[..., 2:3]
    terms = np.abs(powers) @ np.abs(fractions)
    terms = terms[..., :2] + np.abs(uv - 0.5) * terms[..., 2:3]
    even = (q > 0).all(axis=(1, 2)) & (q.max(axis=(1, 2)) < _WEIGHTS * q.min(axis=(1, 2)))
    return even & (terms.max(axis=(1, 2)) < _TERMS)


def _is_regular(maps: np.ndarray, n: int, lattice: np.ndarray) -> np.ndarray:
    """Return a mask, by samples, of maps to the plane without folds; edges may be singular."""
    uv, inner = lattice[:, :2] / TRIED, lattice.min(axis=1) > 0
    value = bernstein.basis(n, uv) @ maps
    du, dv = (bernstein.basis(n - 1, uv) @ (m @ maps) for m in bernstein.partials_matrices(n))
    # det (U, U_u, U_v): the Jacobian of the plane's barycentrics times the cube of their sum
    det = np.linalg.det(np.stack([value, du, dv], axis=-1)) / value.sum(axis=2) ** 3
    most = det.max(axis=1, keepdims=True)
    return (det[:, inner] > 0).all(axis=1) & (det > -10 * ROUNDING * most).all(axis=1)
