"""Cut patches into leaves on which a ray meets the surface in a way that can be certified.

A *leaf* is a sub-triangle of a patch together with a chart, a collineation ``M`` of space in
which the leaf is nearly the unit triangle: the rows of ``M`` give homogeneous coordinates
``(x, y, z, W)`` of a point, the corners lie near ``(1,0,0,1), (0,1,0,1), (0,0,0,1)``, and the
surface is the graph ``z = h(x, y)`` of a function close to a quadratic one. There are two kinds:

*exact* leaves
    A whole patch whose inverse is linear: three rows take a point ``(p - shift, 1)`` of the
    patch to a multiple of its barycentrics, and the patch lies on a quadric, whose matrix we
    store. Every intersection has a closed form. All patches of `quadric_patch` and all planar
    triangles of degree one are of this kind.
*graph* leaves
    Everything else, subdivided until the bounds below are small. For them we store the
    quadratic ``a xy + b x(1-x-y) + c y(1-x-y)`` next to ``h`` and

    * ``remainder`` >= |h - quadratic|,
    * ``variation`` >= spectral norm of Hess(h) - Hess(quadratic),
    * ``bending`` >= half the spectral norm of Hess(h),
    * ``margin``: how far the leaf reaches out of the unit triangle in the chart,

    each over the unit triangle enlarged by twice the margin. ``docs/intersection.md`` says how
    the kernel uses them.

Everything is float64; what the kernel stores in float32 (``shift``, ``frame``) is rounded here
*before* the net is expressed in it, so that the rounding moves no surface point.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from . import bernstein
from .triangles import BezierTriangles

__all__ = ["FORM_ENTRIES", "LeafSettings", "Leaves", "build_leaves"]


@dataclass(frozen=True)
class LeafSettings:
    """When a leaf is good enough (all in chart units, in which the leaf has size one).

    Parameters
    ----------
    lateral : float
        Largest ``|J - I|`` of the map from parameters to chart coordinates; below 1/2 it is
        one-to-one and the lateral Newton step contracts.
    remainder : float
        Largest distance of the surface from its quadratic.
    height : float
        Largest height above the chart's base plane, relative to the leaf's size.
    weight : float
        Largest ratio of weights on the leaf, less one.
    max_depth : int
        Subdivision ends here whatever the bounds say.
    closed_form : bool
        Whether patches with a linear inverse become exact leaves.
    """

    lateral: float = 0.25
    remainder: float = 0.02
    height: float = 0.15
    weight: float = 0.3
    max_depth: int = 18
    closed_form: bool = True


@dataclass
class Leaves:
    """Arrays of `L` leaves; see the module's docstring for the meaning."""

    patch: np.ndarray  #: (L,) patch number
    domain: np.ndarray  #: (L, 3, 3) leaf barycentrics to patch barycentrics, homogeneous
    exact: np.ndarray  #: (L,) bool
    shift: np.ndarray  #: (L, 3) origin of the frame, float32 numbers
    frame: np.ndarray  #: (L, 4, 4) rows x, y, z, W (exact: u, v, w, 0) on (p - shift, 1)
    form: np.ndarray  #: (L, 10) quadric (`FORM_ENTRIES`), or a b c and the four bounds
    net: np.ndarray  #: (L, K, 4) monomial (x - u, y - v, z, W - 1); zero for exact leaves
    box: np.ndarray  #: (L, 2, 3) axis-aligned bounds, possibly infinite
    certified: np.ndarray  #: (L,) bool: the bounds of the settings hold

    def __len__(self) -> int:
        return len(self.patch)

    @staticmethod
    def join(parts: list[Leaves]) -> Leaves:
        """Concatenate; nets are padded to the highest degree (monomials pad with zeros)."""
        top = max(p.net.shape[1] for p in parts)
        out = {}
        for field in fields(Leaves):
            arrays = [getattr(p, field.name) for p in parts]
            if field.name == "net":
                arrays = [
                    np.concatenate([a, np.zeros((len(a), top - a.shape[1], 4))], axis=1)
                    for a in arrays
                ]
            out[field.name] = np.concatenate(arrays)
        return Leaves(**out)


def build_leaves(patches: BezierTriangles, settings: LeafSettings | None = None) -> Leaves:
    """Cut `patches` into leaves.

    Parameters
    ----------
    patches : BezierTriangles
        Any degree, any weights.
    settings : LeafSettings, optional
        Thresholds of the subdivision.

    Returns
    -------
    Leaves
        The domains of the leaves of one patch tile its triangle.
    """
    settings = settings or LeafSettings()
    nets = patches.control_points
    numbers = np.arange(len(patches))
    parts: list[Leaves] = []
    if settings.closed_form:
        found, exact = _exact_leaves(patches)
        if len(exact) or not len(nets):
            parts.append(exact)
        numbers, nets = numbers[~found], nets[~found]
    for chunk in _chunks(len(numbers), 4096):
        parts.extend(_subdivide(nets[chunk], numbers[chunk], settings))
    return Leaves.join(parts)


def _chunks(count: int, length: int) -> Iterator[slice]:
    return (slice(i, min(i + length, count)) for i in range(0, count, length))


# ---------------------------------------------------------------------- graph leaves


def _subdivide(nets: np.ndarray, patch: np.ndarray, settings: LeafSettings) -> Iterator[Leaves]:
    """Yield the leaves of one chunk of patches, level by level."""
    n = bernstein.degree_of(nets.shape[1])
    domain = np.broadcast_to(np.eye(3), (len(nets), 3, 3)).copy()
    for depth in range(settings.max_depth + 1):
        leaves, good = _graph_leaves(nets, domain, patch, settings)
        if depth == settings.max_depth:
            good = np.ones(len(nets), dtype=bool)
        yield _select(leaves, good)
        rest = ~good
        if not rest.any():
            return
        nets, domain, patch = nets[rest], domain[rest], patch[rest]
        collapsed = _collapsed_edge(nets)
        turned = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])
        parts = []
        for edge in range(-1, 3):
            mask = collapsed == edge
            if not mask.any():
                continue
            if edge < 0:
                corners = bernstein.SPLIT_CORNERS
            else:  # corner opposite the collapsed edge comes first
                order = turned[edge]
                corners = _COLLAPSED_SPLIT[:, :, np.argsort(order)]
            matrices = (
                bernstein.split_matrices(n)
                if edge < 0
                else np.stack([bernstein.subdivision_matrix(n, c) for c in corners])
            )
            new_nets = np.einsum("ekl,plc->pekc", matrices, nets[mask])
            # rows of `corners` are barycentrics of the new corners: columns of the domain map
            new_domain = np.einsum("pij,ekj->peik", domain[mask], corners)
            count = len(corners)
            parts.append(
                (
                    new_nets.reshape(-1, *nets.shape[1:]),
                    new_domain.reshape(-1, 3, 3),
                    np.repeat(patch[mask], count),
                )
            )
        nets = np.concatenate([p[0] for p in parts])
        domain = np.concatenate([p[1] for p in parts])
        patch = np.concatenate([p[2] for p in parts])


#: Split of a triangle whose edge BC is collapsed: the tip, the part that keeps corner B as an
#: ordinary corner, and a half-sized triangle that is collapsed again. Midpoint splits would
#: double the number of collapsed leaves at every level.
_COLLAPSED_SPLIT = (
    np.array(
        [
            [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
            [[1, 1, 0], [0, 2, 0], [1, 0, 1]],
            [[1, 0, 1], [0, 2, 0], [0, 0, 2]],
        ],
        dtype=np.float64,
    )
    / 2
)


def _affine(net: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return net[..., :3] / net[..., 3:]


def _collapsed_edge(nets: np.ndarray) -> np.ndarray:
    """Return the corner opposite a collapsed edge, or -1."""
    n = bernstein.degree_of(nets.shape[1])
    ijk = bernstein.multi_indices(n)
    edges = [nets[:, ijk[:, c] == 0] for c in range(3)]
    spread = []
    for e in edges:
        unit = e / np.maximum(np.linalg.norm(e, axis=-1, keepdims=True), 1e-300)
        # projective distance to the first control point: zero for equal points of any weight
        dot = np.abs(np.einsum("pkc,pc->pk", unit, unit[:, 0]))
        spread.append(np.sqrt(np.maximum(0.0, 1.0 - dot**2)).max(axis=1))
    s = np.stack(spread, axis=1)
    corner = s.argmin(axis=1)
    lowest = s.min(axis=1)
    # an edge a thousandth as long as the others counts as collapsed
    return np.where(lowest < 1e-3 * np.sort(s, axis=1)[:, 1], corner, -1)


def _normalise_weights(nets: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scale the corner weights to one by a Möbius change of the barycentrics.

    Returns the nets, the factors ``m`` with ``u_patch ~ m u_leaf``, and whether the leaf is
    finite: all weights of one sign.
    """
    w = nets[..., 3]
    sign = np.where((w > 0).all(axis=1), 1.0, np.where((w < 0).all(axis=1), -1.0, 0.0))
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
    with np.errstate(all="ignore"):
        # fourth point of a projective chart: orthogonal to the corners, of their size
        _u, _s, vt = np.linalg.svd(np.where(np.isfinite(basis), basis, 0.0))
    apex = np.where(finite[:, None], apex, vt[:, 3] * scale.mean(axis=1)[:, None])
    basis = np.concatenate([basis, apex[:, None]], axis=1)
    usable = np.isfinite(basis).all(axis=(1, 2))
    basis[~usable] = np.eye(4)
    usable &= np.abs(np.linalg.det(basis)) > 1e-30
    basis[~usable] = np.eye(4)
    inverse = np.linalg.inv(basis.transpose(0, 2, 1))  # coordinates (U0, U1, U2, s)
    rows[:, 0], rows[:, 1], rows[:, 2] = inverse[:, 0], inverse[:, 1], inverse[:, 3]
    rows[:, 3] = inverse[:, :3].sum(axis=1)
    rows[finite & usable, 3] = (0.0, 0.0, 0.0, 1.0)
    with np.errstate(over="ignore"):
        rounded = rows.astype(np.float32).astype(np.float64)
    bad = ~usable | ~np.isfinite(rounded).all(axis=(1, 2))
    rounded[bad] = np.eye(4)
    return shift, rounded


def _graph_leaves(
    nets: np.ndarray, domain: np.ndarray, patch: np.ndarray, settings: LeafSettings
) -> tuple[Leaves, np.ndarray]:
    """Fit a chart to each net and tell which are good leaves."""
    n = bernstein.degree_of(nets.shape[1])
    nets, moebius, finite = _normalise_weights(nets, n)
    shift, frame = _charts(nets, finite, n)
    moved = nets.copy()
    moved[..., :3] -= moved[..., 3:] * shift[:, None]
    chart = np.einsum("lrc,lkc->lkr", frame, moved)  # x, y, z, W
    w = chart[..., 3]
    with np.errstate(all="ignore"):
        flat = chart[..., :3] / w[..., None]
        spread = np.abs(w - 1).max(axis=1)
        out = np.stack([-flat[..., 0], -flat[..., 1], flat[..., 0] + flat[..., 1] - 1], axis=-1)
        margin = np.maximum(out.max(axis=(1, 2)), 0.0) + 1e-6
        lateral, remainder, variation, bending, coefficients, height = _bounds(chart, margin, n)
        good = (
            (w > 0).all(axis=1)
            & (spread <= settings.weight)
            & (margin <= settings.lateral)
            & (lateral <= settings.lateral)
            & (remainder <= settings.remainder)
            & (height <= settings.height)
        )
    form = np.zeros((len(nets), 10))
    form[:, :3] = coefficients
    form[:, 3], form[:, 4], form[:, 5], form[:, 6] = remainder, variation, bending, margin
    form[~np.isfinite(form).all(axis=1)] = 0.0
    deviation = chart.copy()
    ijk = bernstein.multi_indices(n)
    deviation[..., 0] -= ijk[:, 0] / n
    deviation[..., 1] -= ijk[:, 1] / n
    deviation[..., 3] -= 1.0
    leaves = Leaves(
        patch=patch,
        domain=domain * moebius[:, None, :],
        exact=np.zeros(len(nets), dtype=bool),
        shift=shift,
        frame=frame,
        form=form,
        net=bernstein.monomial_matrix(n) @ deviation,
        box=BezierTriangles(nets).bounds(),
        certified=good.copy(),
    )
    return leaves, good


#: Safety factor on bounds taken from samples: the quantities are smooth on a leaf, and 21
#: samples of a function whose third-order part is below ``remainder`` miss a few per cent.
_SAFETY = 1.25


def _bounds(chart: np.ndarray, margin: np.ndarray, n: int) -> tuple[np.ndarray, ...]:
    """Sample the bounds of the module's docstring on the enlarged triangle."""
    lattice = bernstein.multi_indices(5)[:, :2] / 5.0
    grow = 1.0 + 6.0 * np.minimum(margin, 0.3)[:, None, None]
    uv = 1 / 3 + (lattice[None] - 1 / 3) * grow
    du, dv = bernstein.partials_matrices(n)
    b0, b1 = bernstein.basis(n, uv), bernstein.basis(n - 1, uv)
    value = b0 @ chart
    net_u, net_v = du @ chart, dv @ chart
    hu, hv = b1 @ net_u, b1 @ net_v
    if n >= 2:
        du1, dv1 = bernstein.partials_matrices(n - 1)
        b2 = bernstein.basis(n - 2, uv)
        huu, huv, hvv = b2 @ (du1 @ net_u), b2 @ (du1 @ net_v), b2 @ (dv1 @ net_v)
    else:
        huu = huv = hvv = np.zeros_like(value)
    inv = 1.0 / value[..., 3:]
    p = value[..., :3] * inv
    pu = (hu[..., :3] - p * hu[..., 3:]) * inv
    pv = (hv[..., :3] - p * hv[..., 3:]) * inv
    wu, wv = hu[..., 3:], hv[..., 3:]
    puu = (huu[..., :3] - p * huu[..., 3:] - 2 * pu * wu) * inv
    puv = (huv[..., :3] - p * huv[..., 3:] - pu * wv - pv * wu) * inv
    pvv = (hvv[..., :3] - p * hvv[..., 3:] - 2 * pv * wv) * inv
    jac = np.stack([pu[..., :2], pv[..., :2]], axis=-1)  # d(x, y)/d(u, v)
    lateral = np.linalg.norm(jac - np.eye(2), axis=(-2, -1)).max(axis=1)
    det = jac[..., 0, 0] * jac[..., 1, 1] - jac[..., 0, 1] * jac[..., 1, 0]
    jinv = (
        np.stack(
            [
                np.stack([jac[..., 1, 1], -jac[..., 0, 1]], axis=-1),
                np.stack([-jac[..., 1, 0], jac[..., 0, 0]], axis=-1),
            ],
            axis=-2,
        )
        / det[..., None, None]
    )
    slope = np.einsum("...i,...ij->...j", np.stack([pu[..., 2], pv[..., 2]], axis=-1), jinv)
    second = np.stack([np.stack([puu, puv], axis=-1), np.stack([puv, pvv], axis=-1)], axis=-1)
    # second[..., c, i, j]: Hess of coordinate c in (u, v)
    graph = second[..., 2, :, :] - np.einsum("...c,...cij->...ij", slope, second[..., :2, :, :])
    hess = np.einsum("...ia,...ij,...jb->...ab", jinv, graph, jinv)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    rest = 1 - x - y
    design = np.stack([x * y, x * rest, y * rest], axis=-1)
    usable = np.isfinite(design).all(axis=(1, 2)) & np.isfinite(z).all(axis=1)
    design = np.where(usable[:, None, None], design, 0.0)
    gram = np.einsum("lsa,lsb->lab", design, design) + 1e-12 * np.eye(3)
    rhs = np.einsum("lsa,ls->la", design, np.where(usable[:, None], z, 0.0))
    coefficients = np.linalg.solve(gram, rhs[..., None])[..., 0]
    a, b, c = coefficients.T
    remainder = np.abs(z - np.einsum("lsa,la->ls", design, coefficients)).max(axis=1)
    # Hessian of a xy + b x(1-x-y) + c y(1-x-y)
    quad = np.stack(
        [np.stack([-2 * b, a - b - c], axis=-1), np.stack([a - b - c, -2 * c], axis=-1)], axis=-2
    )
    variation = np.linalg.norm(hess - quad[:, None], axis=(-2, -1)).max(axis=1)
    bending = 0.5 * np.linalg.norm(hess, axis=(-2, -1)).max(axis=1)
    height = np.abs(z).max(axis=1)
    return (
        lateral,
        _SAFETY * remainder + 1e-7,  # 1e-7: what float32 makes of a chart coordinate near one
        _SAFETY * variation + 1e-6,
        _SAFETY * bending,
        coefficients,
        height,
    )


def _select(leaves: Leaves, mask: np.ndarray) -> Leaves:
    return Leaves(**{f.name: getattr(leaves, f.name)[mask] for f in fields(Leaves)})


# ---------------------------------------------------------------------- exact leaves


def _exact_leaves(patches: BezierTriangles) -> tuple[np.ndarray, Leaves]:
    """Find patches with a linear inverse and return ``(mask, leaves)``.

    For a quadratic patch ``b(u)`` we look for rows ``m_0, m_1, m_2`` and a linear form ``l``
    with ``m_j . b(u) = l(u) u_j``: a linear system, solved by its null vector. The common
    zero S of the rows is the centre of a stereographic projection. With a fourth row ``s``,
    ``s(u) := m_3 . b(u)`` satisfies ``l(U) s = l(u)^2 s(u) = l(u) s(u) . l(u)``, so the patch
    lies on ``2 l(U) s - 2 s(U) = 0``, a quadratic form in ``x``: the matrix A.

    A planar triangle of degree one has the inverse of its corner matrix; its form is the
    plane times the plane at infinity.
    """
    n, nets = patches.degree, patches.control_points
    k = bernstein.size(n)
    none = np.zeros(len(nets), dtype=bool)
    if n > 2:
        return none, _empty(k)
    shift, size = _centre_and_size(patches)
    local = nets.copy()
    local[..., :3] = (local[..., :3] - local[..., 3:] * shift[:, None]) / size[:, None, None]
    local /= np.abs(local).max(axis=(1, 2), keepdims=True)
    rows, forms, found = (_planar_inverse if n == 1 else _stereographic_inverse)(local)
    keep = np.flatnonzero(found)
    if not len(keep):
        return none, _empty(k)
    # back from units of `size` to those of space
    units = np.ones((len(keep), 4))
    units[:, :3] /= size[keep, None]
    rows, forms = rows[keep] * units[:, None], forms[keep] * units[:, None] * units[:, :, None]
    frame = np.zeros((len(keep), 4, 4))
    frame[:, :3] = rows
    forms *= size[keep, None, None]  # gradient of order one: f is a length
    leaves = Leaves(
        patch=keep,
        domain=np.broadcast_to(np.eye(3), (len(keep), 3, 3)).copy(),
        exact=np.ones(len(keep), dtype=bool),
        shift=shift[keep],
        frame=frame,
        form=np.stack([forms[:, i, j] for i, j in FORM_ENTRIES], axis=-1),
        net=np.zeros((len(keep), k, 4)),
        box=_tight_boxes(patches[keep]),
        certified=np.ones(len(keep), dtype=bool),
    )
    return found, leaves


#: Order of the ten entries of a symmetric form in `Leaves.form`.
FORM_ENTRIES = (
    (0, 0),
    (1, 1),
    (2, 2),
    (0, 1),
    (0, 2),
    (1, 2),
    (0, 3),
    (1, 3),
    (2, 3),
    (3, 3),
)


def _stereographic_inverse(local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve ``m_j . b(u) = l(u) u_j`` for quadratic nets ``(P, 6, 4)``."""
    count = len(local)
    system = np.zeros((count, 18, 15))
    for j in range(3):
        system[:, 6 * j : 6 * j + 6, 4 * j : 4 * j + 4] = local
        for c, ijk in enumerate(bernstein.multi_indices(1)):
            up = ijk.copy()
            up[j] += 1
            # u_j B_ijk of degree 1 = (i_j + 1)/2 times a Bernstein polynomial of degree 2
            system[:, 6 * j + bernstein.row(2, up[0], up[1]), 12 + c] = -up[j] / 2
    _u, s, vt = np.linalg.svd(system)
    # One null vector, and a second far from it. 3e-7: nets come through Mitsuba's float32
    # tensors, whose rounding (6e-8) is what a render can know of a surface anyway; below 1e-3
    # the inverse would lose too many of float32's digits.
    found = (s[:, -1] <= 3e-7 * s[:, 0]) & (s[:, -2] > 1e-3 * s[:, 0])
    rows, ell = vt[:, -1, :12].reshape(count, 3, 4), vt[:, -1, 12:]
    norm = np.linalg.norm(rows, axis=(1, 2))
    norm = np.where(norm > 0, norm, 1.0)
    rows, ell = rows / norm[:, None, None], ell / norm[:, None]
    _u, s3, vt3 = np.linalg.svd(rows)
    found &= s3[:, 2] > 1e-3 * s3[:, 0]
    fourth = vt3[:, 3]
    sigma = np.einsum("pc,pkc->pk", fourth, local)
    quadratic = np.zeros((count, 3, 3))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for r, (a, b) in enumerate(pairs):  # the net order of degree 2
        quadratic[:, a, b] = quadratic[:, b, a] = sigma[:, r]
    matrix = np.concatenate([rows, fourth[:, None]], axis=1)
    inner = np.zeros((count, 4, 4))
    inner[:, :3, :3] = -2 * quadratic
    inner[:, :3, 3] = inner[:, 3, :3] = ell
    forms = np.einsum("pai,pab,pbj->pij", matrix, inner, matrix)
    forms /= np.maximum(np.abs(forms).max(axis=(1, 2), keepdims=True), 1e-300)
    return rows, forms, found


def _planar_inverse(local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Invert planar triangles ``(P, 3, 4)``."""
    _u, s, vt = np.linalg.svd(local)
    found = s[:, 2] > 1e-6 * s[:, 0]
    plane = vt[:, 3]
    found &= np.linalg.norm(plane[:, :3], axis=1) > 1e-12  # not the plane at infinity
    matrix = np.concatenate([local, plane[:, None]], axis=1).transpose(0, 2, 1)
    matrix = np.where(found[:, None, None], matrix, np.eye(4))
    rows = np.linalg.inv(matrix)[:, :3]
    forms = np.zeros((len(local), 4, 4))
    forms[:, :, 3] += plane / 2
    forms[:, 3, :] += plane / 2
    return rows, forms, found


def _tight_boxes(patches: BezierTriangles, levels: int = 3) -> np.ndarray:
    """Return boxes of control points after a few midpoint splits, ``(P, 2, 3)``."""
    fine = patches
    for _ in range(levels):
        fine = fine.split()
    box = fine.bounds().reshape(len(patches), 4**levels, 2, 3)
    return np.stack([box[:, :, 0].min(axis=1), box[:, :, 1].max(axis=1)], axis=1)


def _centre_and_size(patches: BezierTriangles) -> tuple[np.ndarray, np.ndarray]:
    """Return a finite float32 point near each patch and its size; the box tells both."""
    box = patches.bounds()
    lo, hi = box[:, 0], box[:, 1]
    lo_finite, hi_finite = np.isfinite(lo), np.isfinite(hi)
    lo = np.where(lo_finite, lo, np.where(hi_finite, hi, 0.0))
    hi = np.where(hi_finite, hi, lo)
    size = (hi - lo).max(axis=1) / 2
    shift = ((lo + hi) / 2).astype(np.float32).astype(np.float64)
    return shift, np.where(size > 0, size, 1.0)


def _empty(k: int) -> Leaves:
    return Leaves(
        patch=np.zeros(0, dtype=int),
        domain=np.zeros((0, 3, 3)),
        exact=np.zeros(0, dtype=bool),
        shift=np.zeros((0, 3)),
        frame=np.zeros((0, 4, 4)),
        form=np.zeros((0, 10)),
        net=np.zeros((0, k, 4)),
        box=np.zeros((0, 2, 3)),
        certified=np.zeros(0, dtype=bool),
    )
