"""Newton's method for the parameters of a point of a plane, on a rational map of triangles.

As `kernels.closed_form.inverted` takes it for inverted leaves, here in float64 at samples, so that
the builder knows whether it will find them (see `inverted`).
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...geometry import bernstein

__all__ = [
    "BACK",
    "LAST_STEP",
    "LEAST_DROP",
    "LEAST_START",
    "ROUNDING",
    "TRIED",
    "centred",
    "newton_converges",
]

#: Newton's method ends after a step whose square, which is the error then, times what one in the
#: plane changes of the parameters is below the square of this.
LAST_STEP = 1e-4
#: It begins at the point with the plane's barycentrics, but none below this.
LEAST_START = 0.02
#: At a pole the map turns over. A step that takes the determinant below this share of what it was
#: went too far, perhaps to its other side: a tenth of it is taken back, then more.
LEAST_DROP, BACK = 0.02, 0.1

#: Steps after which the parameters must be found; the kernel takes some more.
_STEPS = 16
#: Rounding of nets in float32 in the plane: where a patch is singular, parameters are known no
#: better, and the Jacobian may have the wrong sign.
ROUNDING = 2e-7
#: Points of a patch at which all this is tried: a lattice of this degree, and one whose
#: barycentrics are taken to a power, so that there are some close to edges and corners.
TRIED = 16
_CLOSE, _POWER = 10, 5


@cache
def centred(n: int) -> np.ndarray:
    """Return the matrix to coefficients of powers of ``u - 1/3, v - 1/3``."""
    corners = np.array([[4, 1, -2], [1, 4, -2], [1, 1, 1]]) / 3
    return bernstein.monomial_matrix(n) @ bernstein.subdivision_matrix(n, corners)


def _tried() -> np.ndarray:
    """Return the parameters at which Newton's method is tried."""
    close = (bernstein.multi_indices(_CLOSE) / _CLOSE) ** _POWER
    close /= close.sum(axis=1, keepdims=True)
    return np.concatenate([bernstein.multi_indices(TRIED)[:, :2] / TRIED, close[:, :2]])


def newton_converges(maps: np.ndarray, fractions: np.ndarray, n: int) -> np.ndarray:
    """Return a mask, by samples, of nets whose parameters the kernel's iteration finds.

    Others with the same coordinates will do: on a collapsed edge there are many.
    """
    value = bernstein.basis(n, _tried()) @ maps
    goal = value / value.sum(axis=2, keepdims=True)
    a, b = goal[..., 0] - 0.5, goal[..., 1] - 0.5
    start = np.maximum(goal, LEAST_START)
    u, v = (start / start.sum(axis=2, keepdims=True)).transpose(2, 0, 1)[:2] - 1 / 3
    by_u, by_v, by_both = np.zeros((3, *u.shape))
    done = np.zeros(u.shape, dtype=bool)
    before = np.zeros(u.shape)
    back_u, back_v = np.zeros((2, *u.shape))
    left = np.arange(len(maps))
    for step in range(_STEPS):
        at = _evaluated(fractions[left], u[left], v[left], a[left], b[left], n)
        f, g, fu, gu, fv, gv = at
        by_u[left], by_v[left] = np.abs(fu) + np.abs(gu), np.abs(fv) + np.abs(gv)
        by_both[left] = np.abs(fu - fv) + np.abs(gu - gv)
        # one look after the last point has been found, for the partials there
        busy = ~done[left].all(axis=1) | (step == 0)
        if not busy.any():
            break
        left = left[busy]
        f, g, fu, gu, fv, gv = (x[busy] for x in at)
        det = fu * gv - fv * gu
        du, dv = (fv * g - gv * f) / det, (gu * f - fu * g) / det
        size = np.maximum(np.abs(du), np.abs(dv))
        area = np.abs(det)
        at_hand = np.maximum(np.abs(f), np.abs(g)) < ROUNDING
        small = size**2 * (area + np.maximum(by_u[left], by_v[left])) < LAST_STEP**2 * area
        too_far = (det <= LEAST_DROP * before[left]) & ~at_hand
        factor = np.where(at_hand & ~small, 0.0, np.minimum(1.0, 1.0 / size))
        for back, x, change in ((back_u, u, du), (back_v, v, dv)):
            step_x = np.where(too_far, -back[left], np.where(factor > 0, factor * change, 0.0))
            back[left] = np.where(too_far, 2 * back[left], BACK * step_x)
            x[left] = np.where(done[left], x[left], x[left] + step_x)
        before[left] = np.where(too_far, before[left], det)
        done[left] |= (small | at_hand) & ~too_far
    # back into the triangle, by way of the parameter that moves the point least
    u, v = u + 1 / 3, v + 1 / 3
    v = np.where(by_u > by_both, v + np.minimum(u, 0.0), v)
    u = np.maximum(u, 0.0)
    u = np.where(by_v > by_both, u + np.minimum(v, 0.0), u)
    v = np.maximum(v, 0.0)
    over = np.maximum(u + v - 1.0, 0.0)
    u, v = np.where(by_u < by_v, u - over, u), np.where(by_u < by_v, v, v - over)
    u, v = np.clip(u, 0.0, 1.0) - 1 / 3, np.clip(v, 0.0, 1.0) - 1 / 3
    f, g = _evaluated(fractions, u, v, a, b, n)[:2]
    return (np.maximum(np.abs(f), np.abs(g)) < 2 * ROUNDING).all(axis=1)


def _evaluated(
    fractions: np.ndarray, u: np.ndarray, v: np.ndarray, a: np.ndarray, b: np.ndarray, n: int
) -> tuple[np.ndarray, ...]:
    """Return ``(P, S)`` of f and g, and of their partials by u and by v."""
    i, j = bernstein.multi_indices(n)[:, :2].T
    powers = np.ones((2, n + 1, *u.shape))
    for k in range(n):
        powers[:, k + 1] = powers[:, k] * (u, v)
    # by products of powers: numpy's own are twenty times slower
    pu, pv = powers[0].transpose(1, 2, 0), powers[1].transpose(1, 2, 0)
    ui, vj = pu[..., i], pv[..., j]
    ud, vd = i * pu[..., np.maximum(i - 1, 0)], j * pv[..., np.maximum(j - 1, 0)]
    out: list[np.ndarray] = []
    for monomials in (ui * vj, ud * vj, ui * vd):
        x, y, total = (monomials @ fractions[..., :3]).transpose(2, 0, 1)
        out += [x - a * total, y - b * total]
    return tuple(out)
