"""Find patches of any degree on an ellipsoid whose edges are plane sections.

Octants of the sphere are the example. The ray meets the quadric in closed form, and the planes
of the edges tell whether the point is on the patch; only its parameters, of the one hit that
counts, are found by Newton's method in the plane.

An affine map makes the ellipsoid the unit sphere, and a stereographic projection takes the sphere
to the complex numbers. There a patch is ``z = P(u, v) / Q(u, v)`` with polynomials of at most half
its degree (Dietz, Hoschek, Juettler, "An algebraic approach to curves and surfaces on the sphere
and on other quadrics", 1993). So the parameters of a point solve ``P - z Q = 0``, two real
equations: of degree two for octants, where the plane sections have degree four.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from ...geometry import bernstein
from ...geometry.linear import inverses
from ...geometry.triangles import BezierTriangles
from ..records import ClosedFormLeaves, LeafKind, weight_signs
from .fits import fit_forms, in_space, local_nets, matrices
from .groups import quadric_leaves

__all__ = ["edge_planes", "section_leaves", "shared_map"]

#: Residuals up to this are rounding: nets come through Mitsuba's float32 tensors (6e-8).
_ROUNDING = 3e-7
#: Singular values below this share of the largest leave a quadric or a plane undetermined.
_DETERMINED = 1e-4
#: `z` is counted from here, the middle of the square in which the coordinates are.
_MIDDLE = 0.5 + 0.5j
#: Newton steps after which the parameters must be found, and how well: nets in float32.
_STEPS = 8
_MAX_ERROR = 1e-5
#: Leaves looked at together: bounds the memory.
_CHUNK = 512
#: Parameters by a map that leaves share may be off by this, ten roundings of float32: what nets in
#: float32 that differ by a rotation are.
_SAME = 1e-6


def section_leaves(patches: BezierTriangles) -> tuple[np.ndarray, ClosedFormLeaves]:
    """Find such patches and return ``(mask, leaves)``.

    The three planes and the quadric bound the patch alone: if the planes meet inside of the
    ellipsoid, they cut it into eight regions, each on its own combination of sides.
    """
    n, nets = patches.degree, patches.control_points
    found = np.zeros(len(nets), dtype=bool)
    nothing = found, ClosedFormLeaves.zeros()
    if n < 3:
        return nothing
    sign = weight_signs(nets)
    which = np.flatnonzero(sign)
    if not len(which):
        return nothing
    local, shift, size = local_nets(patches[which])
    local *= sign[which, None, None]
    keep = _plane_edges(local, n)
    which, shift, size, local = which[keep], shift[keep], size[keep], local[keep]
    if not len(which):
        return nothing
    planes, on_planes = _edge_planes(local, n)
    forms, on_quadric = _fit(local, n)
    keep = on_planes & on_quadric & _meet_inside(planes, forms) & _regular(local, planes, n)
    which, shift, size, local = which[keep], shift[keep], size[keep], local[keep]
    planes, forms = planes[keep], forms[keep]
    if not len(which):
        return nothing
    rows = _projections(local, forms, n)
    fractions, keep = _fractions(local, rows, n)
    keep &= _newton_converges(local, rows, fractions, n)
    if not keep.any():
        return nothing
    which, shift, size = which[keep], shift[keep], size[keep]
    found_rows, quadric = in_space(rows[keep], forms[keep], size)
    found[which] = True
    kind, polynomials = LeafKind.PLANE_SECTIONS, fractions[keep]
    return found, quadric_leaves(
        patches, which, shift, found_rows, quadric, kind, polynomials=polynomials
    )


def edge_planes(leaves: ClosedFormLeaves) -> np.ndarray:
    """Return planes ``(L, 3, 4)``, as rows on ``(p - shift, 1)``, of the edges of such leaves.

    They are 0 on an edge and 1 in the opposite corner. Each goes through three points.
    """
    corners_and_middles = np.array([(2, 0), (0, 2), (0, 0), (0, 1), (1, 0), (1, 1)]) / 2
    points = _points(leaves, corners_and_middles - 1 / 3)
    planes = np.empty((len(leaves), 3, 4))
    for corner, edge in enumerate(((1, 2, 3), (0, 2, 4), (0, 1, 5))):
        _u, _s, vt = np.linalg.svd(points[:, edge])
        value = np.einsum("lc,lc->l", vt[:, 3], points[:, corner])
        planes[:, corner] = vt[:, 3] / value[:, None]
    return planes


def shared_map(
    leaves: ClosedFormLeaves, planes: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return what finds the parameters of points on all such leaves alike, if they are congruent.

    Octants of one sphere are, and of its affine images: what `_projections` makes of a patch does
    not depend on its place, up to rounding.

    Parameters
    ----------
    leaves : ClosedFormLeaves
    planes : (L, 3, 4) array
        Their `edge_planes`.

    Returns
    -------
    matrix : (3, 4) array
        Takes the three values of `edge_planes` of a point, and one, to those of the leaf's rows.
    net : (K, 4) array
        P and Q.
    """
    sides = np.zeros((len(leaves), 4, 4))
    sides[:, :3], sides[:, 3, 3] = planes, 1.0
    inverse, regular = inverses(sides)
    if not regular.all():
        return None
    matrix = leaves.rows[:, :3] @ inverse
    matrix /= np.abs(matrix).max(axis=(1, 2), keepdims=True)
    matrix, net = matrix.mean(axis=0), leaves.polynomials.mean(axis=0)
    for first in range(0, len(leaves), _CHUNK):
        chunk = np.arange(first, min(first + _CHUNK, len(leaves)))
        if not _gives_parameters(matrix, net, leaves.select(chunk), sides[chunk]):
            return None
    return matrix, net


def _gives_parameters(
    matrix: np.ndarray, net: np.ndarray, leaves: ClosedFormLeaves, sides: np.ndarray
) -> bool:
    """Return whether what `shared_map` returns is right for leaves with these sides, by samples."""
    uv = bernstein.multi_indices(6)[:, :2] / 6 - 1 / 3
    value = np.einsum("lsi,lij,kj->lsk", _points(leaves, uv), sides.transpose(0, 2, 1), matrix)
    z = (value[..., 0] + 1j * value[..., 1]) / value.sum(axis=2) - _MIDDLE
    du, dv = _newton(_equation(z, net[None]), *uv.T)
    return bool(np.maximum(np.abs(du), np.abs(dv)).max() <= _SAME)


def _points(leaves: ClosedFormLeaves, uv: np.ndarray) -> np.ndarray:
    """Return points ``(L, S, 4)``, with last coordinate one, from the leaves' shifts on.

    Of parameters ``(S, 2)`` from the middle on. The inverse of the projection finds them: those
    with the coordinates of a point are on a line through the centre of projection, and that is on
    the quadric.
    """
    a, b = bernstein.multi_indices(bernstein.degree_of(leaves.polynomials.shape[1]))[:, :2].T
    value = (uv[:, :1] ** a * uv[:, 1:] ** b) @ leaves.polynomials
    z = (value[..., 0] + 1j * value[..., 1]) / (value[..., 2] + 1j * value[..., 3])
    z += _MIDDLE
    goal = np.stack([z.real, z.imag, 1.0 - z.real - z.imag], axis=-1)
    rows, forms = leaves.rows[:, :3], matrices(leaves.quadric)
    _u, _s, vt = np.linalg.svd(rows)
    centre = vt[:, 3]
    near = np.einsum("lcr,lsr->lsc", np.linalg.pinv(rows), goal)
    square = np.einsum("lsa,lab,lsb->ls", near, forms, near)
    slope = 2 * np.einsum("lsa,lab,lb->ls", near, forms, centre)
    points = near - (square / slope)[..., None] * centre[:, None]
    return points / points[..., 3:]


def _edge(n: int, corner: int) -> np.ndarray:
    """Return the rows of the control points of the edge opposite a corner."""
    return np.flatnonzero(bernstein.multi_indices(n)[:, corner] == 0)


def _plane_edges(local: np.ndarray, n: int) -> np.ndarray:
    """Return a mask, quickly, of nets that may have three plane edges: by four points of each."""
    out = np.ones(len(local), dtype=bool)
    for corner in range(3):
        edge = _edge(n, corner)
        four = local[:, edge[[0, n // 3, n - n // 3, n]]]
        four = four / np.linalg.norm(four, axis=2, keepdims=True)
        out &= np.abs(np.linalg.det(four)) < 1e-5
    return out


def _edge_planes(local: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return planes ``(P, 3, 4)`` that are 0 on an edge and 1 in the opposite corner."""
    planes = np.zeros((len(local), 3, 4))
    found = np.ones(len(local), dtype=bool)
    for corner, row in enumerate(bernstein.corner_rows(n)):
        _u, s, vt = np.linalg.svd(local[:, _edge(n, corner)])
        found &= (s[:, 3] <= _ROUNDING * s[:, 0]) & (s[:, 2] > _DETERMINED * s[:, 0])
        plane = vt[:, 3]
        tip = local[:, row]
        value = np.einsum("pc,pc->p", plane, tip) / tip[:, 3]
        found &= np.abs(value) > _DETERMINED
        planes[:, corner] = plane / np.where(value == 0, 1.0, value)[:, None]
    return planes, found


def _fit(local: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Fit an ellipsoid; return matrices ``(P, 4, 4)``, negative inside, and where it fits."""
    lattice = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    forms, s = fit_forms(bernstein.basis(n, lattice) @ local)
    found = (s[:, -1] <= _ROUNDING * s[:, 0]) & (s[:, -2] > _DETERMINED * s[:, 0])
    forms *= np.sign(np.trace(forms[:, :3, :3], axis1=1, axis2=2))[:, None, None]
    axes = np.linalg.eigvalsh(forms[:, :3, :3])
    found &= axes[:, 0] > _DETERMINED * axes[:, 2]
    return forms, found


def _meet_inside(planes: np.ndarray, forms: np.ndarray) -> np.ndarray:
    _u, s, vt = np.linalg.svd(planes)
    point = vt[:, 3]
    inside = np.einsum("pi,pij,pj->p", point, forms, point) < 0
    return inside & (np.abs(point[:, 3]) > 0) & (s[:, 2] > _DETERMINED * s[:, 0])


def _regular(local: np.ndarray, planes: np.ndarray, n: int) -> np.ndarray:
    """Return a mask of nets in whose parameters the planes' values are one-to-one, by samples.

    They are positive inside, so the patch does not leave its region, and the map from the
    parameters to their ratios does not fold, so it is covered once.
    """
    lattice = bernstein.multi_indices(3 * n)
    inner = (lattice > 0).all(axis=1)
    uv = lattice[:, :2] / (3 * n)
    net = np.einsum("prc,pkc->pkr", planes, local)
    value = bernstein.basis(n, uv) @ net
    du, dv = (bernstein.basis(n - 1, uv) @ (m @ net) for m in bernstein.partials_matrices(n))
    # det (A, A_u, A_v): the Jacobian of the ratios times the cube of their sum
    det = np.linalg.det(np.stack([value, du, dv], axis=-1))
    return (value[:, inner] > 0).all(axis=(1, 2)) & (det > 0).all(axis=1)


def _projections(local: np.ndarray, forms: np.ndarray, n: int) -> np.ndarray:
    """Return rows ``(P, 3, 4)`` whose ratios are the stereographic coordinates of a point.

    The centre of projection is opposite the patch. With the sum of a point's three values, the
    first two over it are coordinates that lie between 0 and 1 on the patch.
    """
    centre = -np.linalg.solve(forms[:, :3, :3], forms[:, :3, 3:])[..., 0]
    level = -np.einsum("pi,pi->p", forms[:, 3, :3], centre) - forms[:, 3, 3]
    axes, vectors = np.linalg.eigh(forms[:, :3, :3] / level[:, None, None])
    to_sphere = np.zeros((len(local), 3, 4))
    to_sphere[..., :3] = (vectors * np.sqrt(axes)[:, None]) @ vectors.transpose(0, 2, 1)
    to_sphere[..., 3] = -np.einsum("pij,pj->pi", to_sphere[..., :3], centre)
    lattice = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    points = bernstein.basis(n, lattice) @ local
    sphere = np.einsum("pij,psj->psi", to_sphere, points) / points[..., 3:]
    pole = sphere.mean(axis=1)
    # the two directions across the pole
    _u, _s, frame = np.linalg.svd(pole[:, None])
    x, y, pole = frame[:, 1], frame[:, 2], pole / np.linalg.norm(pole, axis=1, keepdims=True)
    x, y = _turned(x, y, sphere[:, bernstein.corner_rows(2 * n)])
    rows = np.stack([np.einsum("pi,pij->pj", v, to_sphere) for v in (x, y, pole)], axis=1)
    rows[:, 2, 3] += 1.0
    value = np.einsum("prj,psj->prs", rows, points)
    reach = np.hypot(*(value[:, k] / value[:, 2] for k in range(2))).max(axis=1)
    rows[:, :2] = rows[:, 2:] / 2 + rows[:, :2] * (0.45 / reach)[:, None, None]
    rows[:, 2] -= rows[:, 0] + rows[:, 1]
    return rows


def _turned(x: np.ndarray, y: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn directions, so that a patch's corners are where those of a congruent one are.

    The first is ahead of the others along `x`, the second comes before the third about the pole.
    """
    c = np.einsum("pkj,pj->pk", corners, x) + 1j * np.einsum("pkj,pj->pk", corners, y)
    c -= c.mean(axis=1, keepdims=True)
    turns_left = ((c[:, 1] - c[:, 0]).conj() * (c[:, 2] - c[:, 0])).imag > 0
    first = np.where(turns_left, c[:, 0], c[:, 0].conj())
    y = np.where(turns_left[:, None], y, -y)
    cos, sin = (part[:, None] / np.abs(first)[:, None] for part in (first.real, first.imag))
    return cos * x + sin * y, cos * y - sin * x


def _complex(rows: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator ``(P, S)`` of `z` at points ``(P, S, 4)``."""
    value = np.einsum("prj,psj->rps", rows, points)
    total = value.sum(axis=0)
    return value[0] + 1j * value[1] - _MIDDLE * total, total


def _fractions(local: np.ndarray, rows: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return P and Q as ``(P, K, 4)`` (real and imaginary parts), and where they exist.

    They are of the lowest degree that there is, and by powers of ``u - 1/3, v - 1/3``, so that the
    terms are small on the patch. ``z`` is known at more points than there are unknowns.
    """
    out = np.zeros((len(local), bernstein.size(n), 4))
    found = np.zeros(len(local), dtype=bool)
    for degree in range(1, n // 2 + 1):
        left = np.flatnonzero(~found)
        lattice = bernstein.multi_indices(n + degree)[:, :2] / (n + degree)
        z, d = _complex(rows[left], bernstein.basis(n, lattice) @ local[left])
        a, b = bernstein.multi_indices(degree)[:, :2].T
        basis = (lattice[:, :1] - 1 / 3) ** a * (lattice[:, 1:] - 1 / 3) ** b
        system = np.concatenate([d[..., None] * basis, -z[..., None] * basis], axis=2)
        _u, s, vh = np.linalg.svd(system)
        good = s[:, -1] <= _ROUNDING * s[:, 0]
        k = bernstein.size(degree)
        pair = vh[good, -1].conj().reshape(-1, 2, k)
        pair = pair / pair[:, 1:, -1:]  # Q is one in the middle
        places = np.array([bernstein.row(n, i, j) for i, j in zip(a.tolist(), b.tolist())])
        parts = np.stack([pair.real, pair.imag], axis=2).reshape(-1, 4, k)
        out[np.ix_(left[good], places)] = parts.transpose(0, 2, 1)
        found[left[good]] = True
    return out, found


def _newton_converges(
    local: np.ndarray, rows: np.ndarray, fractions: np.ndarray, n: int
) -> np.ndarray:
    """Return a mask, by samples, of nets whose parameters the kernel's iteration finds."""
    lattice = bernstein.multi_indices(12)[:, :2] / 12.0
    goal = lattice - 1 / 3
    z, d = _complex(rows, bernstein.basis(n, lattice) @ local)
    equation = _equation(z / d, fractions)
    u, v = np.zeros((2, *z.shape))
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            du, dv = _newton(equation, u, v)
            u, v = u + du, v + dv
            if not (np.abs([du, dv]) > _MAX_ERROR**2).any():
                break
        off = np.maximum(np.abs(u - goal[:, 0]), np.abs(v - goal[:, 1])).max(axis=1)
    return off < _MAX_ERROR


def _equation(z: np.ndarray, net: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """Return ``P - z Q`` by the powers of ``u, v``, for `z` ``(L, S)`` and nets ``(L, K, 4)``."""
    p, q = (net[..., None, k] + 1j * net[..., None, k + 1] for k in (0, 2))
    powers = bernstein.multi_indices(bernstein.degree_of(net.shape[1]))[:, :2].tolist()
    used = np.flatnonzero(net.any(axis=(0, 2))).tolist()
    return {tuple(powers[k]): p[:, k] - z * q[:, k] for k in used}


def _newton(
    equation: dict[tuple[int, int], np.ndarray], u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the step of Newton's method at ``u, v``."""
    highest = max(max(powers) for powers in equation)
    powers_u, powers_v = (
        list(accumulate([x] * highest, np.multiply, initial=np.ones_like(x))) for x in (u, v)
    )
    f, fu, fv = np.zeros((3, *next(iter(equation.values())).shape), dtype=complex)
    for (a, b), coefficient in equation.items():
        f += coefficient * (powers_u[a] * powers_v[b])
        if a:
            fu += coefficient * (a * powers_u[a - 1] * powers_v[b])
        if b:
            fv += coefficient * (b * powers_u[a] * powers_v[b - 1])
    det = (fu.conj() * fv).imag
    return -(f.conj() * fv).imag / det, -(fu.conj() * f).imag / det
