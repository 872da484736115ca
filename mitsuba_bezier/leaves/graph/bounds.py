"""Proved bounds of graph leaves: where they are graphs, and how far from their quadratics.

The setting. A leaf is ``F = (X, Y) / W``, ``z = Z / W`` with polynomials of degree `n` in the
leaf's parameters ``p = (u, v)``. Let ``T`` be the parameter triangle with barycentrics at least
``-s`` (``s`` is one of `SIZES`), and ``P`` the chart triangle in which the kernel looks for the
leaf, with barycentrics at least ``-m`` (three numbers ``m``: how far the leaf reaches outward, and
what the kernel's rounding adds). Shown is, for the leaves marked as proved:

1. ``W > 0`` on ``T``, and ``sym F' >= mu > 0`` there. As ``T`` is convex, ``F`` is one-to-one:
   ``(F(p) - F(p')) . (p - p') >= mu |p - p'|^2``. So the leaf is the graph of ``h = z o F^-1``.
2. ``F`` takes no point of an edge of ``T`` into ``P``. So the boundary of ``F(T)`` does not meet
   ``P``, which is connected and meets ``F(T)`` in the leaf's corners: ``P`` lies in ``F(T)``.
3. On ``F(T)``: ``|h - q| <= remainder`` and ``|Hess h - Hess q| <= variation`` (spectral norm),
   where ``q`` is a quadratic fitted to ``h``.
4. For ``p``, ``p'`` in ``T`` and ``d = F(p') - F(p)``:
   ``|g(F(p')) - g(F(p)) - grad g(F(p)) . d| <= bending |d|^2`` for ``g = h - q``, and the gradients
   differ by at most ``2 bending |d|``. For with ``|Hess g| <= H`` the left sides are at most
   ``H l^2 / 2`` and ``H l``, if ``l`` is the length of the path ``F`` makes of the segment from
   ``p`` to ``p'``, and ``l <= sup|F'| |p' - p| <= (sup|F'| / mu) |d|``. So
   ``bending = (sup|F'| / mu)^2 variation / 2``.

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
* Quotients ``f = N / D`` (`quotient`): Leibniz' rule for ``D f = N`` gives
  ``D f_3 <= N_3 + 3 D_1 f_2 + 3 D_2 f_1 + D_3 f_0`` for the suprema ``f_k`` of ``|D^k f|``, and
  alike for ``f_4``; with ``f_k <= samples + c f_(k+2)`` for ``k < 3`` these are two linear
  inequalities for ``f_3`` and ``f_4``. Used for ``F`` and for the rest ``R = z - q(F)``, which is
  ``(Z W - q(X, Y, W)) / W^2``, a quotient of polynomials of degree ``2 n``.
* ``K = Hess h - Hess q`` at ``F(p)`` (`second_of_variation`): let ``B = F'^-1``, with
  ``|B| <= j = 1 / mu``, and ``g`` the gradient of ``h - q``, so that ``Dg = K F'``. Differentiating
  ``R'' = K[F', F'] + g F''`` once and twice, and applying ``B`` to the two arguments that are not
  the direction of the derivative:

      k_1 <= j^2 R_3 + (2 j F_2 + j^2 F_1 F_2) k_0 + j^2 F_3 g_0
      k_2 <= j^2 R_4 + (4 j F_2 + j^2 F_1 F_2) k_1
             + (2 j F_3 + 3 j^2 F_2^2 + 2 j^2 F_1 F_3) k_0 + j^2 F_4 g_0

  With ``k_0 <= samples + c k_2`` and ``g_0 <= samples + c (F_1 k_1 + F_2 k_0)`` these again are
  two linear inequalities, for ``k_1`` and ``k_2``.

Two inequalities ``x <= b + A x``, ``A >= 0``, bound `x` if the spectral radius of ``A`` is below
one (`majorants`); else the leaf is not proved. All suprema are finite where ``W > 0`` and
``mu > 0``, which are shown first. Rounding: see `_ROUNDING`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import numpy as np

from ...geometry import bernstein
from ..records import BENDING_LIMIT, SIZES
from .cover import by_size, covering_sizes, needed_margin, to_triangle
from .majorants import form_norm, norm2, norm2_symmetric, quotient, second_of_variation, square

__all__ = ["LeafBounds", "leaf_bounds"]

#: Lattices of samples: the first for all, the others for leaves that need it.
_LATTICES = (8, 16)

#: A leaf's bounds are taken again on the next lattice if they exceed the samples by this factor.
_INFLATED = 1.5

#: ``F`` is taken from the middle of the unit triangle, where ``f_0`` of `quotient` is smaller.
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
    chart: np.ndarray, outward: np.ndarray, inward: np.ndarray, lateral: float
) -> LeafBounds:
    """Bound leaves; see the module's docstring.

    Parameters
    ----------
    chart : (L, K, 4) array
        Bernstein coefficients ``X, Y, Z, W`` in the leaves' charts, corners near the unit triangle.
    outward, inward : (L, 3) arrays
        What `edge_reach` says, or more; the kernel looks for the leaf so far `outward`.
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
        size, rows = covering_sizes(chart, needed_margin(outward), inward)
        out.size[:] = size
        for lattice in _LATTICES:
            again = [rows[:0]]
            for part, s in by_size(rows, size):
                found, worth = _bound(chart[part], lateral, n, s, lattice)
                out.put(part, found)
                again.append(part[worth])
            rows = np.concatenate(again)
    return out


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


@cache
def _operators(n: int, size: int, lattice: int) -> _Operators:
    leg = 1 + 3 * SIZES[size]
    to_t = to_triangle(n, size)
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
    numerator = tuple(m / leg**k for m, k in zip(_from_values(n), (3, 4))) if n < _HIGH else ()
    return _Operators(
        samples=samples,
        differences=differences,
        values=bernstein.basis(n, double) @ to_t,
        numerator=numerator,
        loss=tuple(_ROUNDING * np.abs(m).sum(axis=1).max() for m in numerator),
        uv=1 / 3 + (at[:, :2] / lattice - 1 / 3) * leg,
        gap=(leg / lattice) ** 2 / 4,
    )


@cache
def _from_values(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return matrices from values on the lattice of degree 2 n to partials of order 3 and 4."""
    double = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    inverse = np.linalg.inv(bernstein.basis(2 * n, double))
    third, fourth = (np.concatenate(_partials(2 * n, k)) @ inverse for k in (3, 4))
    return third, fourth


def _basis(n: int, uv: np.ndarray) -> np.ndarray:
    return bernstein.basis(n, uv) if n >= 0 else np.zeros((len(uv), 1))


@cache
def _partials(n: int, order: int) -> list[np.ndarray]:
    """Return the matrices from a net to the nets of d^k/du^k, d^k/du^(k-1)dv, ..., d^k/dv^k."""
    if order > n:
        return [np.zeros((1, bernstein.size(n)))] * (order + 1)
    out = [np.eye(bernstein.size(n))]
    for m in range(n, n - order, -1):
        du, dv = bernstein.partials_matrices(m)
        out = [du @ a for a in out] + [dv @ out[-1]]
    return out


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
    weights = net.reshape(-1, 4, count)[:, 3]  # of the first two orders, these alone are needed
    parts = [(m @ weights)[:, None] for m in op.differences[:2]]
    parts += [(m @ net).reshape(-1, 4, count) for m in op.differences[2:]]
    dw = [form_norm(d[:, -1:], k) for k, d in enumerate(parts, 1)]
    least = w.min(axis=0) - c * dw[1]
    positive = least > 0
    least = np.where(positive, least, np.nan)
    weight = (least, *dw)
    third, fourth = (d[:, :3] - d[:, 3:] * _MIDDLE for d in parts[2:])
    f = quotient(
        form_norm(third[:, :2], 3),
        form_norm(fourth[:, :2], 4),
        weight,
        np.hypot(x - 1 / 3, y - 1 / 3).max(axis=0),
        norm2(xu, xv, yu, yv).max(axis=0),
        np.sqrt((puu[:2] ** 2 + 2 * puv[:2] ** 2 + pvv[:2] ** 2).sum(axis=0).max(axis=0)),
        c,
    )
    lateral = norm2(xu - 1, xv, yu, yv - 1).max(axis=0)
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

    def second(p2: Any, x1: Any, y1: Any, x2: Any, y2: Any) -> Any:
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
    variation = norm2_symmetric(kxx, kxy, kyy).max(axis=0)
    remainder = np.abs(r).max(axis=0)
    slope = np.hypot(gx, gy).max(axis=0)

    # third and fourth derivatives of R
    first, bend = np.hypot(ru, rv).max(axis=0), norm2_symmetric(ruu, ruv, rvv).max(axis=0)
    if op.numerator:
        r3, r4 = _numerator(op, net, q)
        most = w.max(axis=0) + c * dw[1]
        r3, r4 = quotient(r3, r4, square(weight, most), remainder, first, bend, c)[3:]
    else:
        z3, z4 = quotient(
            form_norm(third[:, 2:], 3),
            form_norm(fourth[:, 2:], 4),
            weight,
            np.abs(z).max(axis=0),
            np.hypot(zu, zv).max(axis=0),
            norm2_symmetric(puu[2], puv[2], pvv[2]).max(axis=0),
            c,
        )[3:]
        hq = norm2_symmetric(qxx, qxy, qyy)
        q1 = np.hypot(qx, qy).max(axis=0) + c * hq * f[2]
        r3 = z3 + 3 * hq * f[1] * f[2] + q1 * f[3]
        r4 = z4 + hq * (4 * f[1] * f[3] + 3 * f[2] ** 2) + q1 * f[4]
    k2 = second_of_variation(1 / mu, f, r3, r4, variation, slope, c)

    proved_variation, proved_remainder = variation + c * k2, remainder + c * (bend + c * r4)
    proved = positive & np.isfinite(k2) & np.isfinite(proved_remainder)
    worth = ~proved | (proved_variation > _INFLATED * variation + 1e-5)
    worth &= positive & (lateral <= limit)
    some_variation = np.where(proved, proved_variation, 2 * variation) + 1e-6
    bending = np.where(proved, (f[1] / mu) ** 2, 2.0) * some_variation / 2
    bounds = LeafBounds(
        proved=proved & (bending < 0.99 * BENDING_LIMIT),
        size=np.full(count, size),
        lateral=np.where(proved, lateral + c * f[3], 2 * lateral),
        # 1e-7: what float32 makes of a chart coordinate near one
        remainder=np.where(proved, proved_remainder, 2 * remainder) + 1e-7,
        variation=some_variation,
        bending=bending,
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
    # the kernel has them in float32, the first three with 16 digits; bounds are of what it has
    quadratics = fitted.transpose(0, 2, 1).reshape(-1, 9).astype(np.float32)
    bits = quadratics[:, :3].view(np.uint32)
    quadratics[:, :3] = ((bits + 0x80) & 0xFFFFFF00).view(np.float32)
    quadratics = quadratics.astype(np.float64)
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
        form_norm((m @ n)[:, None], k) + loss * scale
        for k, m, loss in zip((3, 4), op.numerator, op.loss)
    )
    return third, fourth
