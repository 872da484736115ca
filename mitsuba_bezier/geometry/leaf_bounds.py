"""Proved bounds of graph leaves: where they are graphs, and how far from their quadratics.

The setting. A leaf is ``F = (X, Y) / W``, ``z = Z / W`` with polynomials of degree `n` in the
leaf's parameters ``p = (u, v)``. Let ``T`` be the parameter triangle with barycentrics at least
``-s`` (``s`` is one of `SIZES`), and ``P`` the chart triangle with barycentrics at least ``-m``, in
which the kernel looks for the leaf (``m`` is the leaf's margin with what the kernel's rounding
adds). Shown is, for the leaves marked as proved:

1. ``W > 0`` on ``T``, and ``sym F' >= mu > 0`` there. As ``T`` is convex, ``F`` is one-to-one:
   ``(F(p) - F(p')) . (p - p') >= mu |p - p'|^2``. So the leaf is the graph of ``h = z o F^-1``.
2. ``F`` takes no point of an edge of ``T`` into ``P``. So the boundary of ``F(T)`` does not meet
   ``P``, which is connected and meets ``F(T)`` in the leaf's corners: ``P`` lies in ``F(T)``.
3. On ``F(T)``: ``|h - q| <= remainder`` and ``|Hess h - Hess q| <= variation`` (spectral norm),
   where ``q`` is a quadratic fitted to ``h``.
4. For ``p``, ``p'`` in ``T`` and ``d = F(p') - F(p)``:
   ``|h(F(p')) - h(F(p)) - grad h(F(p)) . d| <= bending |d|^2``, and the gradients differ by at
   most ``2 bending |d|``. For with ``|Hess h| <= H`` the left sides are at most ``H l^2 / 2`` and
   ``H l``, if ``l`` is the length of the path ``F`` makes of the segment from ``p`` to ``p'``, and
   ``l <= sup|F'| |p' - p| <= (sup|F'| / mu) |d|``. So ``bending = (sup|F'| / mu)^2 H / 2``.

How. Each quantity is sampled on a lattice that cuts ``T`` into right triangles of leg ``l``, and
what may happen between the samples is bounded: linear interpolation of ``f`` on such a
triangle is off by at most ``c sup|D^2 f|``, ``c = l^2 / 4`` (with weights ``b_i`` at the corners
``v_i`` it is at most ``sup|D^2 f| / 2`` times ``sum b_i |p - v_i|^2 = R^2 - |p - centre|^2``, and
the circumradius is ``R = l / sqrt 2``). Hence, for any norm,
``sup <= max over samples + c sup|D^2 f|``; and alike for the least eigenvalue of ``sym F'``, which
is concave. With second derivatives of second derivatives, four orders of derivatives are enough,
and for the last two crude bounds do:

* Derivatives of polynomials on ``T`` are combinations of their Bernstein coefficients there,
  which are differences of those of the polynomial. ``|D^k|`` is the norm of a symmetric form, at
  most ``(sum_a binom(k, a) |f_a|^2)^(1/2)`` for the partials ``f_a = d^k f / du^(k-a) dv^a``.
* Quotients ``f = N / D`` (`_quotient`): Leibniz' rule for ``D f = N`` gives
  ``D f_3 <= N_3 + 3 D_1 f_2 + 3 D_2 f_1 + D_3 f_0`` for the suprema ``f_k`` of ``|D^k f|``, and
  alike for ``f_4``; with ``f_k <= samples + c f_(k+2)`` for ``k < 3`` these are two linear
  inequalities for ``f_3`` and ``f_4``. Used for ``F`` and for the rest ``R = z - q(F)``, which is
  ``(Z W - q(X, Y, W)) / W^2``, a quotient of polynomials of degree ``2 n``.
* ``K = Hess h - Hess q`` at ``F(p)`` (`_variation`): let ``B = F'^-1``, ``|B| <= j = 1 / mu``, and
  ``g`` the gradient of ``h - q``, so that ``Dg = K F'``. Differentiating
  ``R'' = K[F', F'] + g F''`` once and twice, and applying ``B`` to the two arguments that are not
  the direction of the derivative:

      k_1 <= j^2 R_3 + (2 j F_2 + j^2 F_1 F_2) k_0 + j^2 F_3 g_0
      k_2 <= j^2 R_4 + (4 j F_2 + j^2 F_1 F_2) k_1
             + (2 j F_3 + 3 j^2 F_2^2 + 2 j^2 F_1 F_3) k_0 + j^2 F_4 g_0

  With ``k_0 <= samples + c k_2`` and ``g_0 <= samples + c (F_1 k_1 + F_2 k_0)`` these again are
  two linear inequalities, for ``k_1`` and ``k_2``.

Two inequalities ``x <= b + A x``, ``A >= 0``, bound `x` if the spectral radius of ``A`` is below
one (`_majorant`); else the leaf is not proved. All suprema are finite where ``W > 0`` and
``mu > 0``, which are shown first. Rounding: see `_ROUNDING`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from math import comb

import numpy as np

from . import bernstein
from .leaves import BENDING_LIMIT, SIZES

__all__ = ["LeafBounds", "edge_reach", "leaf_bounds", "needed_margin"]

#: Lattices of samples: the first for all, the others for leaves that need it.
_LATTICES = (8, 16)

#: A leaf's bounds are taken again on the next lattice if they exceed the samples by this factor.
_INFLATED = 1.5

#: A parameter triangle that reaches out by this times what the chart triangle does will do.
_STEEP = 1.15
#: ... and if not, larger ones are tried: so many in all.
_TRIES = 4
#: The edges of the parameter triangle are sampled at the ends of so many pieces.
_PIECES = 8

#: Leaves examined at a time: what fits in the cache.
_CHUNK = 512

#: ``F`` is taken from the middle of the unit triangle, where ``f_0`` of `_quotient` is smaller.
_MIDDLE = np.array([1 / 3, 1 / 3, 0.0])[:, None]

#: Rounding of sums of a hundred products in float64, relative to the sum of their moduli. Added
#: explicitly where differences of high order amplify it; elsewhere it is some 1e-13, and hidden
#: by the 1e-7 and 1e-6 that are added to the remainder and the variation for float32.
_ROUNDING = 1e-14

#: From this degree on fourth differences at twice the degree lose too many digits.
_HIGH = 9


@dataclass
class LeafBounds:
    """Bounds of `L` leaves. Where they are not proved they are guesses, or infinite."""

    proved: np.ndarray  #: (L,) bool
    size: np.ndarray  #: (L,) index of `SIZES`: of the triangle on which they hold
    lateral: np.ndarray  #: (L,) spectral norm of ``F' - 1``
    remainder: np.ndarray  #: (L,)
    variation: np.ndarray  #: (L,)
    bending: np.ndarray  #: (L,)
    height: np.ndarray  #: (L,) largest ``|h|`` of the samples, not a bound
    quadratics: np.ndarray  #: (L, 9) of ``h``, ``u - x`` and ``v - y``, three numbers each

    def put(self, rows: np.ndarray, other: LeafBounds) -> None:
        """Replace the leaves `rows` by others."""
        for f in fields(LeafBounds):
            getattr(self, f.name)[rows] = getattr(other, f.name)


def leaf_bounds(
    chart: np.ndarray, margin: np.ndarray, inward: np.ndarray, lateral: float
) -> LeafBounds:
    """Bound leaves; see the module's docstring.

    Parameters
    ----------
    chart : (L, K, 4) array
        Bernstein coefficients ``X, Y, Z, W`` in the leaves' charts, corners near the unit triangle.
    margin, inward : (L,) arrays
        What `edge_reach` says; the bounds are for this margin, which may be more.
    lateral : float
        Leaves with more of it are cut anyway, so that finer lattices are not for them.

    Returns
    -------
    LeafBounds
    """
    n = bernstein.degree_of(chart.shape[1])
    count = len(chart)
    out = LeafBounds(
        proved=np.zeros(count, dtype=bool),
        size=np.zeros(count, dtype=int),
        quadratics=np.zeros((count, 9)),
        **{
            name: np.full(count, np.inf)
            for name in ("lateral", "remainder", "variation", "bending", "height")
        },
    )
    with np.errstate(all="ignore"):
        size, rows = _sizes(chart, needed_margin(margin), inward)
        out.size[:] = size
        for lattice in _LATTICES:
            again = [rows[:0]]
            for part, s in _by_size(rows, size):
                found, worth = _bound(chart[part], lateral, n, s, lattice)
                out.put(part, found)
                again.append(part[worth])
            rows = np.concatenate(again)
    return out


def needed_margin(margin: np.ndarray) -> np.ndarray:
    """Return how far out of the unit triangle the kernel may look for a leaf.

    It stores the margin as a multiple of ``2^-30``, a square, rounded up; and it clips rays in
    float32.
    """
    return margin + 2.0**-14 * np.sqrt(margin) + 2.0**-30 + 3e-6


def _by_size(rows: np.ndarray, size: np.ndarray) -> list[tuple[np.ndarray, int]]:
    """Return `rows` in chunks of leaves of the same size, and these sizes."""
    rows = rows[np.argsort(size[rows], kind="stable")]
    out = []
    for part in np.split(rows, np.flatnonzero(np.diff(size[rows])) + 1):
        for i in range(0, len(part), _CHUNK):
            out.append((part[i : i + _CHUNK], int(size[part[0]])))
    return out


@cache
def _pieces(n: int) -> tuple[np.ndarray, ...]:
    """Return for each edge of the leaf the matrix to the coefficients of its eight pieces."""
    ijk = bernstein.multi_indices(n)
    halves = np.zeros((2, n + 1, n + 1))
    for i in range(n + 1):
        for a in range(i + 1):
            halves[0, i, a] = halves[1, n - i, n - a] = comb(i, a) / 2**i
    cuts = np.eye(n + 1)[None]
    for _ in range(3):
        cuts = np.concatenate([h @ c for c in cuts for h in halves]).reshape(-1, n + 1, n + 1)
    out = []
    for e in range(3):
        pick = np.eye(bernstein.size(n))[ijk[:, e] == 0]
        out.append((cuts @ pick).reshape(-1, bernstein.size(n)))
    return tuple(out)


def edge_reach(chart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bound how far the edges of leaves leave the edges of the unit triangle in the chart.

    By the coefficients of eight pieces of each edge. Where the map is one-to-one, the leaf reaches
    no further out than its edges do.

    Parameters
    ----------
    chart : (L, K, 4) array
        With positive weights.

    Returns
    -------
    out, inward : (L,) arrays
        In barycentrics, at least 0.
    """
    n = bernstein.degree_of(chart.shape[1])
    out = np.zeros(len(chart))
    inward = np.zeros(len(chart))
    if not len(chart):
        return out, inward
    net = np.ascontiguousarray(chart[..., [0, 1, 3]].transpose(1, 2, 0))
    net = net.reshape(chart.shape[1], -1)
    for e, matrix in enumerate(_pieces(n)):
        x, y, w = (matrix @ net).reshape(-1, 3, len(chart)).transpose(1, 0, 2)
        inv = 1.0 / w
        x, y = x * inv, y * inv
        barycentrics = (x, y, 1 - x - y)
        for b in barycentrics:
            out = np.maximum(out, -b.min(axis=0))
        inward = np.maximum(inward, barycentrics[e].max(axis=0))
    return out, inward


def _sizes(
    chart: np.ndarray, needed: np.ndarray, inward: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of the triangle ``T`` for each leaf, and for which leaves it will do."""
    n = bernstein.degree_of(chart.shape[1])
    reach = np.nan_to_num(_STEEP * (needed + inward), nan=np.inf)
    size = np.minimum(np.searchsorted(SIZES, reach), len(SIZES) - 1)
    rows = np.arange(len(chart))
    covered = [rows[:0]]
    for _ in range(_TRIES):
        missing = [rows[:0]]
        for part, s in _by_size(rows, size):
            found = _covers(chart[part], needed[part], n, s)
            covered.append(part[found])
            missing.append(part[~found & (s < len(SIZES) - 1)])
        rows = np.concatenate(missing)
        size[rows] += 1
    return size, np.sort(np.concatenate(covered))


@cache
def _edge_matrices(n: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return samples, and coefficients of the second derivatives, of a net on the edges of T."""
    to_t = _to_triangle(n, size)
    at = bernstein.multi_indices(_PIECES)
    ijk = bernstein.multi_indices(n)
    values = bernstein.basis(n, at[:, :2] / _PIECES) @ to_t
    bent = [np.diff(to_t[ijk[:, e] == 0], 2, axis=0) * (n * (n - 1)) for e in range(3)]
    if n == 1:
        bent = [np.zeros((1, 3))] * 3
    return np.stack([values[at[:, e] == 0] for e in range(3)]), np.stack(bent)


def _covers(chart: np.ndarray, needed: np.ndarray, n: int, size: int) -> np.ndarray:
    """Tell for which leaves the edges of ``T`` do not meet ``P``.

    Each piece between two samples has to be beyond one of the edges of ``P``: ``U + m W < 0`` for a
    barycentric ``U``, a polynomial, which is off its linear interpolation by at most an eighth of
    its second derivative.
    """
    x, y, w = chart[..., 0].T, chart[..., 1].T, chart[..., 3].T
    net = np.concatenate([x + needed * w, y + needed * w, w - x - y + needed * w], axis=1)
    values, bent = (m @ net for m in _edge_matrices(n, size))  # edge, sample, barycentric and leaf
    most = np.maximum(values[:, 1:], values[:, :-1])
    most += np.abs(bent).max(axis=1, keepdims=True) / (8 * _PIECES**2)
    beyond = (most < 0).reshape(*most.shape[:2], 3, -1)
    return beyond.any(axis=2).all(axis=(0, 1))


@dataclass(frozen=True)
class _Operators:
    """Matrices on the net of a leaf, for one degree, size and lattice."""

    samples: np.ndarray  #: value, u, v, uu, uv, vv on the lattice, one after the other
    differences: tuple[np.ndarray, ...]  #: coefficients of the partials of order 1 to 4 on T
    values: np.ndarray  #: values on the lattice of degree 2 n
    numerator: tuple[np.ndarray, ...]  #: from those values to partials of order 3 and 4
    loss: tuple[float, ...]  #: rounding of these, relative to the values
    uv: np.ndarray  #: the lattice
    gap: float  #: ``c`` of the module's docstring


def _to_triangle(n: int, size: int) -> np.ndarray:
    """Return the matrix to the coefficients on ``T``."""
    s = SIZES[size]
    return bernstein.subdivision_matrix(n, np.full((3, 3), -s) + (1 + 3 * s) * np.eye(3))


@cache
def _operators(n: int, size: int, lattice: int) -> _Operators:
    leg = 1 + 3 * SIZES[size]
    to_t = _to_triangle(n, size)
    at = bernstein.multi_indices(lattice)
    samples = np.concatenate(
        [
            _basis(n - k, at[:, :2] / lattice) @ m @ to_t / leg**k
            for k in range(3)
            for m in _partials(n, k)
        ]
    )
    differences = tuple(np.concatenate(_partials(n, k)) @ to_t / leg**k for k in range(1, 5))
    double = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    numerator: tuple[np.ndarray, ...] = ()
    if n < _HIGH:
        inverse = np.linalg.inv(bernstein.basis(2 * n, double))
        numerator = tuple(np.concatenate(_partials(2 * n, k)) @ inverse / leg**k for k in (3, 4))
    return _Operators(
        samples=samples,
        differences=differences,
        values=bernstein.basis(n, double) @ to_t,
        numerator=numerator,
        loss=tuple(_ROUNDING * np.abs(m).sum(axis=1).max() for m in numerator),
        uv=1 / 3 + (at[:, :2] / lattice - 1 / 3) * leg,
        gap=(leg / lattice) ** 2 / 4,
    )


def _basis(n: int, uv: np.ndarray) -> np.ndarray:
    return bernstein.basis(n, uv) if n >= 0 else np.zeros((len(uv), 1))


def _partials(n: int, order: int) -> list[np.ndarray]:
    """Return the matrices from a net to the nets of d^k/du^k, d^k/du^(k-1)dv, ..., d^k/dv^k."""
    if order > n:
        return [np.zeros((1, bernstein.size(n)))] * (order + 1)
    out = [np.eye(bernstein.size(n))]
    for m in range(n, n - order, -1):
        du, dv = bernstein.partials_matrices(m)
        out = [du @ a for a in out] + [dv @ out[-1]]
    return out


def _form_norm(partials: np.ndarray, order: int) -> np.ndarray:
    """Return the largest norm of forms ``((order + 1) * rows, components, L)``: ``(L,)``."""
    weights = np.array([comb(order, a) for a in range(order + 1)], dtype=np.float64)
    square = np.square(partials).sum(axis=1).reshape(order + 1, -1, partials.shape[-1])
    return np.sqrt(np.tensordot(weights, square, axes=1).max(axis=0))


def _majorant(b1, b2, a11, a12, a21, a22):
    """Return the largest `x` with ``x <= b + A x``, or NaN where there is none."""
    d1, d2 = 1 - a11, 1 - a22
    det = d1 * d2 - a12 * a21
    det = np.where((d1 > 0) & (d2 > 0) & (det > 0), det, np.nan)
    return (d2 * b1 + a12 * b2) / det, (a21 * b1 + d1 * b2) / det


def _quotient(n3, n4, d, s0, s1, s2, c):
    """Bound the derivatives 0 to 4 of a quotient.

    Parameters
    ----------
    n3, n4 : (L,) arrays
        Of the numerator's derivatives.
    d : five (L,) arrays
        Lower bound of the denominator, bounds of its derivatives 1 to 4.
    s0, s1, s2 : (L,) arrays
        Largest samples of the quotient and its first two derivatives.
    c : float
        See the module's docstring.
    """
    d0, d1, d2, d3, d4 = d
    near = s0 + c * s2  # f_0 <= near + c^2 f_4
    f3, f4 = _majorant(
        (n3 + 3 * d1 * s2 + 3 * d2 * s1 + d3 * near) / d0,
        (n4 + 6 * d2 * s2 + 4 * d3 * s1 + d4 * near) / d0,
        3 * c * d2 / d0,
        (3 * c * d1 + c * c * d3) / d0,
        (4 * d1 + 4 * c * d3) / d0,
        (6 * c * d2 + c * c * d4) / d0,
    )
    f2 = s2 + c * f4
    return s0 + c * f2, s1 + c * f3, f2, f3, f4


def _variation(j, f, r3, r4, k, g, c):
    """Bound the second derivative of ``K`` along the parameters; see the module's docstring."""
    _f0, f1, f2, f3, f4 = f
    j2 = j * j
    g = g + c * f2 * k  # g_0 <= this + c f_1 k_1 + c^2 f_2 k_2
    e1, e2 = 2 * j * f2 + j2 * f1 * f2, 2 * j * f3 + 3 * j2 * f2**2 + 2 * j2 * f1 * f3
    mixed = 4 * j * f2 + j2 * f1 * f2
    h1, h2 = j2 * f3, j2 * f4
    _k1, k2 = _majorant(
        j2 * r3 + e1 * k + h1 * g,
        j2 * r4 + e2 * k + h2 * g,
        c * h1 * f1,
        c * e1 + c * c * h1 * f2,
        mixed + c * h2 * f1,
        c * e2 + c * c * h2 * f2,
    )
    return k2


def _norm2(a, b, c, d):
    """Return the spectral norm of ``[[a, b], [c, d]]``."""
    f, det = a * a + b * b + c * c + d * d, a * d - b * c
    return np.sqrt((f + np.sqrt(np.maximum(f * f - 4 * det * det, 0.0))) / 2)


def _norm2_symmetric(a, b, c):
    """Return the spectral norm of ``[[a, b], [b, c]]``."""
    return np.abs(a + c) / 2 + np.hypot((a - c) / 2, b)


def _bound(
    chart: np.ndarray, limit: float, n: int, size: int, lattice: int
) -> tuple[LeafBounds, np.ndarray]:
    """Bound leaves on a triangle; tell for which a finer lattice is worth while."""
    op = _operators(n, size, lattice)
    c = op.gap
    count = len(chart)
    net = np.ascontiguousarray(chart.transpose(1, 2, 0)).reshape(chart.shape[1], -1)
    jets = (op.samples @ net).reshape(6, -1, 4, count).transpose(0, 2, 1, 3)

    # samples of the affine point and its partials; (component, sample, leaf)
    w = jets[0, 3]
    inv = 1.0 / w
    value, du, dv, duu, duv, dvv = (a[:3] * inv for a in jets)
    wu, wv, wuu, wuv, wvv = (a[3] * inv for a in jets[1:])
    pu, pv = du - value * wu, dv - value * wv
    puu = duu - value * wuu - 2 * pu * wu
    puv = duv - value * wuv - pu * wv - pv * wu
    pvv = dvv - value * wvv - 2 * pv * wv
    x, y, z = value
    (xu, yu, zu), (xv, yv, zv) = pu, pv

    # the weight, and the map F
    parts = [(m @ net).reshape(-1, 4, count) for m in op.differences]
    dw = [_form_norm(d[:, 3:], k) for k, d in enumerate(parts, 1)]
    least = w.min(axis=0) - c * dw[1]
    positive = least > 0
    least = np.where(positive, least, np.nan)
    weight = (least, *dw)
    third, fourth = (d[:, :3] - d[:, 3:] * _MIDDLE for d in parts[2:])
    f = _quotient(
        _form_norm(third[:, :2], 3),
        _form_norm(fourth[:, :2], 4),
        weight,
        np.hypot(x - 1 / 3, y - 1 / 3).max(axis=0),
        _norm2(xu, xv, yu, yv).max(axis=0),
        np.sqrt((puu[:2] ** 2 + 2 * puv[:2] ** 2 + pvv[:2] ** 2).sum(axis=0).max(axis=0)),
        c,
    )
    lateral = _norm2(xu - 1, xv, yu, yv - 1).max(axis=0)
    stretch = (xu + yv) / 2 - np.hypot((xu - yv) / 2, (xv + yu) / 2)
    mu = stretch.min(axis=0) - c * f[3]
    mu = np.where(mu > 0, mu, np.nan)

    quadratics, q = _fit(x, y, z, op.uv)
    a, b, d = q
    qxx, qxy, qyy = -2 * b, a - b - d, -2 * d
    rest = 1 - x - y
    r = z - (a * x * y + b * x * rest + d * y * rest)
    qx = a * y + b * (rest - x) - d * y
    qy = a * x - b * x + d * (rest - y)
    ru, rv = zu - qx * xu - qy * yu, zv - qx * xv - qy * yv

    def second(p2, x1, y1, x2, y2):
        """Return a second partial of ``R = z - q(F)``."""
        bent = qxx * x1 * x2 + qxy * (x1 * y2 + y1 * x2) + qyy * y1 * y2
        return p2[2] - qx * p2[0] - qy * p2[1] - bent

    ruu = second(puu, xu, yu, xu, yu)
    ruv = second(puv, xu, yu, xv, yv)
    rvv = second(pvv, xv, yv, xv, yv)
    # gradient and Hessian in (x, y): with B = F'^-1, g = B^T R', K = B^T (R'' - g F'') B
    inv = 1.0 / (xu * yv - xv * yu)
    gx, gy = (yv * ru - yu * rv) * inv, (xu * rv - xv * ru) * inv
    auu, auv, avv = (s - gx * p2[0] - gy * p2[1] for s, p2 in ((ruu, puu), (ruv, puv), (rvv, pvv)))
    xu, yu, xv, yv = xu * inv, yu * inv, xv * inv, yv * inv
    kxx = yv * (yv * auu - 2 * yu * auv) + yu * yu * avv
    kxy = (yv * xu + yu * xv) * auv - yv * xv * auu - yu * xu * avv
    kyy = xv * (xv * auu - 2 * xu * auv) + xu * xu * avv
    variation = _norm2_symmetric(kxx, kxy, kyy).max(axis=0)
    hessian = _norm2_symmetric(kxx + qxx, kxy + qxy, kyy + qyy).max(axis=0)
    remainder = np.abs(r).max(axis=0)
    slope = np.hypot(gx, gy).max(axis=0)

    # third and fourth derivatives of R
    first, bend = np.hypot(ru, rv).max(axis=0), _norm2_symmetric(ruu, ruv, rvv).max(axis=0)
    if op.numerator:
        r3, r4 = _numerator(op, net, q)
        most = w.max(axis=0) + c * dw[1]
        r3, r4 = _quotient(r3, r4, _square(weight, most), remainder, first, bend, c)[3:]
    else:
        z3, z4 = _quotient(
            _form_norm(third[:, 2:], 3),
            _form_norm(fourth[:, 2:], 4),
            weight,
            np.abs(z).max(axis=0),
            np.hypot(zu, zv).max(axis=0),
            _norm2_symmetric(puu[2], puv[2], pvv[2]).max(axis=0),
            c,
        )[3:]
        hq = _norm2_symmetric(qxx, qxy, qyy)
        q1 = np.hypot(qx, qy).max(axis=0) + c * hq * f[2]
        r3 = z3 + 3 * hq * f[1] * f[2] + q1 * f[3]
        r4 = z4 + hq * (4 * f[1] * f[3] + 3 * f[2] ** 2) + q1 * f[4]
    k2 = _variation(1 / mu, f, r3, r4, variation, slope, c)

    proved_variation, proved_remainder = variation + c * k2, remainder + c * (bend + c * r4)
    path = (f[1] / mu) ** 2
    proved = positive & np.isfinite(k2) & np.isfinite(proved_remainder)
    worth = ~proved | (proved_variation > _INFLATED * variation + 1e-5)
    worth &= positive & (lateral <= limit)
    bounds = LeafBounds(
        proved=proved & (path * (hessian + c * k2) / 2 < 0.99 * BENDING_LIMIT),
        size=np.full(count, size),
        lateral=np.where(proved, lateral + c * f[3], 2 * lateral),
        # 1e-7: what float32 makes of a chart coordinate near one
        remainder=np.where(proved, proved_remainder, 2 * remainder) + 1e-7,
        variation=np.where(proved, proved_variation, 2 * variation) + 1e-6,
        bending=np.where(proved, path * (hessian + c * k2), 2 * hessian) / 2,
        height=np.abs(z).max(axis=0),
        quadratics=quadratics,
    )
    return bounds, worth


def _fit(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fit quadratics that vanish at the corners to ``z``, ``u - x``, ``v - y``.

    Returns
    -------
    quadratics : (L, 9) array
        All three.
    q : (3, L) array
        The first, finite.
    """
    rest = 1 - x - y
    design = np.stack([x * y, x * rest, y * rest]).transpose(2, 0, 1)  # leaf, function, sample
    targets = np.stack([z, uv[:, :1] - x, uv[:, 1:] - y]).transpose(2, 0, 1)
    usable = np.isfinite(design).all(axis=(1, 2)) & np.isfinite(targets).all(axis=(1, 2))
    if not usable.all():
        design = np.where(usable[:, None, None], design, 0.0)
        targets = np.where(usable[:, None, None], targets, 0.0)
    gram = design @ design.transpose(0, 2, 1)
    # the ridge keeps the fit of hopeless leaves, which are cut anyway, from being singular
    gram += (1e-12 * (1.0 + np.trace(gram, axis1=1, axis2=2)))[:, None, None] * np.eye(3)
    fitted = np.linalg.solve(gram, design @ targets.transpose(0, 2, 1))
    # the kernel has them in float32; bounds are of what it has
    quadratics = fitted.transpose(0, 2, 1).reshape(-1, 9).astype(np.float32).astype(np.float64)
    return quadratics, np.ascontiguousarray(quadratics[:, :3].T)


def _numerator(op: _Operators, net: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bound the third and fourth derivatives of ``Z W - q(X, Y, W)``."""
    v = (op.values @ net).reshape(len(op.values), 4, -1)
    x, y, z, w = v[:, 0], v[:, 1], v[:, 2], v[:, 3]
    rest = w - x - y
    n = z * w - q[0] * x * y - (q[1] * x + q[2] * y) * rest
    size = np.abs(v).max(axis=(0, 1))
    scale = (1 + 3 * np.abs(q).sum(axis=0)) * size**2
    third, fourth = (
        _form_norm((m @ n)[:, None], k) + loss * scale
        for k, m, loss in zip((3, 4), op.numerator, op.loss)
    )
    return third, fourth


def _square(weight, most):
    """Return what `_quotient` wants of ``W^2``, from the same of ``W`` and its upper bound."""
    least, w1, w2, w3, w4 = weight
    return (
        least**2,
        2 * most * w1,
        2 * (w1**2 + most * w2),
        2 * (3 * w1 * w2 + most * w3),
        2 * (3 * w2**2 + 4 * w1 * w3 + most * w4),
    )
