"""All common roots of two polynomials on a triangle, by subdivision with certificates.

Both polynomials are given by Bernstein coefficients of one degree. The domain is split into
four again and again; every piece `T` ends in one of these ways (`E` is `T` enlarged twice
about its centroid, so that neighbours overlap):

*Sign test.* A linear combination of the two polynomials has coefficients of one sign on `T`:
no root. Tried are the two themselves, then the combination that the coefficients, as points in
the plane, suggest: it succeeds whenever their convex hull leaves out the origin.

*Simple root.* With ``Y`` the inverse Jacobian at the centroid, ``|Y DF - I| < 1`` in the
maximum norm for all Bernstein coefficients of ``DF`` on `E`. Then ``YF`` is injective on
`E` (mean value theorem), so Newton's method either finds the only root in `E`, or, where the
bound is 1/4 or less, proves by leaving `E` that `T` has none: there the first step takes any
point to within 1/4 of its distance from a root in `T`, and no later step goes further away.

*Fold.* In the singular frame of the centroid, `f` has ``f_1 > 0`` and slope
``|f_2| <= f_1 / 8`` on `E`, so that ``f = 0`` is one curve; and the second derivative of `g`
along it keeps its sign. Then `g` has at most one extremum on the curve: no root, a double
root, or two roots, one on each side of the fold point, from which they are found.

*Near miss.* With a `band`, pieces that come that close to a root are kept until they hold no
fold, until the fold point is found, or until their image is small compared with its distance.

*Unresolved.* At the depth limit, or when one problem holds more pieces than isolated roots
can explain (a curve of roots; a collapsed edge on the line), damped least squares from the
piece's centroid either finds a root, which nothing certifies to be the only one, or leaves
the piece undecided.

What is proved holds up to the rounding of the coefficients, bounded here by `NOISE`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..errors import GeometryError
from ..geometry import bernstein
from .bivariate_local import (
    NOISE,
    adjugate,
    evaluate,
    fold_points,
    hull_distance,
    is_fold,
    least_squares,
    local,
    matrices,
    newton,
)

__all__ = [
    "DOUBLE",
    "NEAR_MISS",
    "NOISE",
    "SIMPLE",
    "UNDECIDED",
    "UNRESOLVED",
    "Roots",
    "common_roots",
]

#: Kinds of candidates: a certified simple root; a double root (two that rounding does not
#: separate); a root that no certificate isolates; a fold point near which there is no root; a
#: piece left undecided, in which no root was found and none could be excluded.
SIMPLE, DOUBLE, UNRESOLVED, NEAR_MISS, UNDECIDED = 1, 2, 0, -1, -2

#: Size 2**-26 of a piece: the square root of eps, where folds end in a double root anyway.
_DEPTH = 26

#: From this level on, pieces are counted: 1024 on the triangle leave room for 4 n^2 roots.
_COUNTING = 5


class Roots(NamedTuple):
    """Roots and near misses, sorted by problem; `R` rows.

    Attributes
    ----------
    problem : (R,) int array
    uv : (R, 2) array
        Barycentric coordinates ``(u, v)``.
    kind : (R,) int array
        `SIMPLE`, `DOUBLE`, `UNRESOLVED`, `NEAR_MISS` or `UNDECIDED`.
    """

    problem: np.ndarray
    uv: np.ndarray
    kind: np.ndarray


class _Search:
    """The work list of one block of problems.

    With a `frame` only the rim of that width around the triangle is searched. The triangle is
    searched on its own: where an edge collapses to a point, the images of pieces that reach
    across it are bow ties, which the sign test can hardly tell from a root.
    """

    def __init__(self, f: np.ndarray, band: np.ndarray, frame: float) -> None:
        self.f = f
        self.band = band.copy()
        self.frame = frame
        self.n = bernstein.degree_of(f.shape[-1], "f")
        self.found: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, problem: np.ndarray, x: np.ndarray, kind: int, radius: np.ndarray) -> None:
        """Note candidates; no second one of the same problem lies within `radius`."""
        self.found.append((problem, x, np.full(len(x), kind), radius))

    def run(self) -> None:
        m = matrices(self.n)
        count, _, k = self.f.shape
        # the piece (c, h) has the corners c + h (1, 0), c + h (0, 1), c; h < 0 is a half turn
        q = np.arange(count)
        c = np.full((count, 2), -self.frame)
        h = np.full(count, 1.0 + 3.0 * self.frame)
        f = self.f
        if self.frame:
            corners = (1.0 + 3.0 * self.frame) * np.eye(3) - self.frame
            f = f @ bernstein.subdivision_matrix(self.n, corners).T
        rounding = 16 * self.n * np.finfo(float).eps
        regular = np.zeros(count, dtype=bool)
        plain = np.zeros(count, dtype=bool)  # no near miss to be looked for
        for level in range(_DEPTH + 1):
            tolerance = np.where(plain, NOISE, self.band[q])
            # the axes first: they settle most pieces at little cost
            far = (f.min(axis=2) > tolerance[:, None]) | (f.max(axis=2) < -tolerance[:, None])
            keep = np.flatnonzero(~far.any(axis=1))
            distance = hull_distance(f[keep])
            near = distance <= tolerance[keep]
            if self.frame:
                low = (c[keep] + np.minimum(h[keep], 0.0)[:, None]).min(axis=1)
                low = np.minimum(low, 1.0 - c[keep].sum(axis=1) - np.maximum(h[keep], 0.0))
                near &= low < 0.0
            keep, distance = keep[near], distance[near]
            q, c, h, f, regular, plain = (a[keep] for a in (q, c, h, f, regular, plain))
            if level >= _COUNTING:
                # seen from the origin the image is small: a near miss known to a factor of 1.5,
                # which ends the search at singular points that lie in the band
                size = np.sqrt((f**2).sum(axis=1).max(axis=1))
                small = ~plain & (distance > NOISE) & (size <= 1.5 * distance)
                at = c[small] + h[small, None] / 3
                self.add(q[small], at, NEAR_MISS, 0.5 * np.abs(h[small]))
                keep = np.flatnonzero(~small)
                q, c, h, f, regular, plain = (a[keep] for a in (q, c, h, f, regular, plain))
                distance = distance[keep]

            j = f @ m.center.T  # (M, 2, 2), rows the polynomials
            det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
            # 16 n eps: the rounding of a derivative
            usable = np.abs(det) > rounding * np.sqrt((j**2).sum(axis=(1, 2)))
            d1 = (f @ m.first.T).reshape(len(q), 2, 2, bernstein.size(self.n - 1))
            moved = adjugate(j) / np.where(usable, det, 1.0)[:, None, None]
            moved = (moved @ d1.reshape(len(q), 2, 2 * bernstein.size(self.n - 1))).reshape(
                d1.shape
            )
            moved -= np.eye(2)[:, :, None]
            change = np.abs(moved).sum(axis=2).max(axis=(1, 2))
            change[~usable] = np.inf
            regular |= change < 0.95  # below 1 by far more than rounding
            plain |= regular
            done = regular & (distance > NOISE)
            todo = np.flatnonzero(regular & ~done)
            done[todo] = self._simple(q[todo], c[todo], h[todo], change[todo])
            if self.n >= 2:
                todo = np.flatnonzero(~regular)
                todo = todo[is_fold(f[todo], j[todo], d1[todo])]
                done[todo] = self._fold(q[todo], c[todo], h[todo])
                plain[todo] = True  # the fold point is noted, or lies elsewhere

            keep = np.flatnonzero(~done)
            if level >= _COUNTING:
                keep = keep[~self._crowded(q[keep], c[keep], h[keep])]
            if level == _DEPTH:
                self._unresolved(q[keep], c[keep], h[keep], roots=True)
                keep = keep[:0]
            if not len(keep):
                break
            q, c, h, f, regular, plain = (a[keep] for a in (q, c, h, f, regular, plain))
            f = (f.reshape(-1, k) @ m.split.T).reshape(len(q), 2, 4, k)
            f = f.transpose(0, 2, 1, 3).reshape(-1, 2, k)
            q, regular, plain = np.repeat(q, 4), np.repeat(regular, 4), np.repeat(plain, 4)
            h2 = h[:, None] / 2  # corner C of the parts: at A, at B, at C, the middle one
            zero = np.zeros_like(h2)
            first = np.concatenate([h2, zero, zero, h2], axis=1)
            second = np.concatenate([zero, h2, zero, h2], axis=1)
            c = (c[:, None] + np.stack([first, second], axis=2)).reshape(-1, 2)
            h = (h2 * [1.0, 1.0, 1.0, -1.0]).reshape(-1)

    def _simple(
        self, q: np.ndarray, c: np.ndarray, h: np.ndarray, change: np.ndarray
    ) -> np.ndarray:
        """Look for the one root of certified pieces; returns which pieces are settled."""
        size = np.abs(h)
        x, converged = newton(self.f[q], c + h[:, None] / 3, size)
        where = local(x, c, h)
        inside = converged & (where >= -1 / 3)
        # 0.01 of overlap: neighbours may both find a root, rounding lets none fall between
        own = inside & (where >= -0.01)
        # a tenth of the size around a point of T lies in E, where the root is the only one
        self.add(q[own], x[own], SIMPLE, 0.1 * size[own])
        return inside | (change <= 0.25)

    def _fold(self, q: np.ndarray, c: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Find fold point and roots of certified pieces; returns which pieces are settled."""
        f, size = self.f[q], np.abs(h)
        x, near, offset, bend, null = fold_points(f, c, h)
        own = near & (local(x, c, h) >= -0.01)
        # twice the rounding: below it the sign of the discriminant means nothing
        double = near & (np.abs(offset) <= 2 * NOISE)
        none = near & ~double & (offset * bend > 0)
        # neighbours turn `f` a little differently: whoever sees a near miss notes it
        self.add(q[none], x[none], NEAR_MISS, 0.1 * size[none])
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.sqrt(np.maximum(-2 * offset / bend, 0.0))
            spread = 4 * np.sqrt(4 * NOISE / np.abs(bend))
        self.add(q[own & double], x[own & double], DOUBLE, spread[own & double])
        two = np.flatnonzero(near & ~double & ~none)
        reach, q, f, c, h = reach[two], q[two], f[two], c[two], h[two]
        ends, good = [], np.ones(len(two), dtype=bool)
        for side in (1.0, -1.0):
            start = x[two] + side * reach[:, None] * null[two]
            end, converged = newton(f, start, np.minimum(reach, np.abs(h)))
            across = side * ((end - x[two]) * null[two]).sum(axis=1)
            good &= converged & (across > 0) & (local(end, c, h) >= -1 / 3)
            ends.append(end)
        apart = 0.25 * np.linalg.norm(ends[0] - ends[1], axis=1)
        for end in ends:
            own = good & (local(end, c, h) >= -0.01)
            self.add(q[own], end[own], SIMPLE, apart[own])
        settled = double | none
        settled[two] = good
        return settled

    def _crowded(self, q: np.ndarray, c: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Deal with problems that hold too many pieces; returns the pieces to drop."""
        full = np.bincount(q, minlength=len(self.f)) > 32 + 4 * self.n**2
        wide = full & (self.band > NOISE)
        at = wide[q]
        if at.any():  # look closer: without the band, after noting the near misses it holds
            self._unresolved(q[at], c[at], h[at], roots=False)
            self.band[wide] = NOISE
        at = (full & ~wide)[q]
        if at.any():
            self._unresolved(q[at], c[at], h[at], roots=True)
        return at

    def _unresolved(self, q: np.ndarray, c: np.ndarray, h: np.ndarray, roots: bool) -> None:
        if not len(q):
            return
        x, value = least_squares(self.f[q], c, h)
        radius = 0.5 * np.abs(h)
        # a double root is found to some sqrt(eps): |F| of order eps, times ten for its bend
        root = value <= 10 * NOISE
        if roots:
            self.add(q[root], x[root], UNRESOLVED, radius[root])
        self.add(q[~root], x[~root], UNDECIDED if roots else NEAR_MISS, radius[~root])

    def result(self) -> Roots:
        problem, x, kind, radius = (np.concatenate(part) for part in zip(*self.found))
        if self.frame:
            out = np.minimum(x.min(axis=1), 1.0 - x.sum(axis=1)) < 0.0
            problem, x, kind, radius = problem[out], x[out], kind[out], radius[out]
        near = kind < 0
        value = np.zeros(len(x))
        e = evaluate(self.f[problem[near]], x[near], 1)
        value[near] = np.linalg.norm(e[..., 0], axis=1)
        rank = np.select([kind == SIMPLE, kind == DOUBLE, kind == UNRESOLVED], [0, 1, 2], 5 + kind)
        order = np.lexsort((value, rank, problem))
        problem, x, kind, radius, near = (a[order] for a in (problem, x, kind, radius, near))
        drop = np.zeros(len(x), dtype=bool)
        for lag in range(1, int(np.bincount(problem).max(initial=0))):
            same = problem[lag:] == problem[:-lag]
            same &= near[lag:] == near[:-lag]
            gap = np.linalg.norm(x[lag:] - x[:-lag], axis=1)
            drop[lag:] |= same & (gap <= np.maximum(radius[lag:], radius[:-lag]))
        return Roots(problem[~drop], x[~drop], kind[~drop])


def common_roots(f: Any, scale: Any, *, margin: float = 0.0, band: Any = 0.0) -> Roots:
    """Find all common roots of two polynomials on a triangle, for many problems.

    Parameters
    ----------
    f : (Q, 2, K) array_like
        Bernstein coefficients of the two polynomials of each problem, of one degree n.
    scale : (Q,) array_like
        Magnitude that the rounding of the coefficients is relative to (for coefficients that
        are sums with cancellation, the sum of the absolute terms). Positive.
    margin : float
        Roots are sought where all barycentric coordinates are at least ``-margin``; some
        up to a hundredth of the triangle further out may be returned. With a margin, roots
        just outside the triangle may be returned twice.
    band : float or (Q,) array_like
        Near misses, the fold points where the image of the triangle comes closest to zero,
        are reported when they are at most about `band` away (in units of `f`).

    Returns
    -------
    Roots

    Raises
    ------
    GeometryError
        If `f` or `scale` has the wrong shape or numbers that are not finite.
    """
    f = np.asarray(f, dtype=np.float64)
    if f.ndim != 3 or f.shape[1] != 2 or not np.isfinite(f).all():
        raise GeometryError.expected("f", "finite numbers of shape (Q, 2, K)", f"shape {f.shape}")
    bernstein.degree_of(f.shape[2], "f")
    scale = np.asarray(scale, dtype=np.float64)
    if scale.shape != f.shape[:1] or not (np.isfinite(scale) & (scale > 0)).all():
        raise GeometryError.expected("scale", "positive numbers of shape (Q,)", f"{scale}")
    if not 0 <= margin <= 1:
        raise GeometryError.expected("margin", "a number from 0 to 1", margin)
    width = np.maximum(np.broadcast_to(band, scale.shape) / scale, NOISE)
    parts = []
    # some megabytes at a time stay in the cache
    block = max(256, 2**19 // f.shape[2])
    for start in range(0, len(f), block):
        at = slice(start, start + block)
        scaled = f[at] / scale[at, None, None]
        for frame in [0.0, margin] if margin else [0.0]:
            search = _Search(scaled, width[at], frame)
            search.run()
            if search.found:
                r = search.result()
                parts.append(Roots(r.problem + start, r.uv, r.kind))
    if not parts:
        empty = np.zeros(0, dtype=np.int64)
        return Roots(empty, np.zeros((0, 2)), empty)
    out = Roots(*(np.concatenate(column) for column in zip(*parts)))
    order = np.argsort(out.problem, kind="stable")
    return Roots(*(column[order] for column in out))
