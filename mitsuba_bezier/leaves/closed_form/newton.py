"""Newton's method for the parameters of a point of a plane, on a rational map of triangles.

As `kernels.closed_form.newton` takes it for inverted leaves, here in float64 at samples, so that
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
    """Tell, by samples, where the kernel's iteration finds the parameters.

    Others with the same coordinates will do: on a collapsed edge there are many.
    """
    value = bernstein.basis(n, _tried()) @ maps
    goal = value / value.sum(axis=2, keepdims=True)
    a, b = goal[..., 0] - 0.5, goal[..., 1] - 0.5
    start = np.maximum(goal, LEAST_START)
    u, v = (start / start.sum(axis=2, keepdims=True)).transpose(2, 0, 1)[:2] - 1 / 3
    i, j = bernstein.multi_indices(n)[:, :2].T

    def evaluate(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        """Return f and g, and their partials."""
        ui, vj = u[..., None] ** i, v[..., None] ** j
        ud, vd = i * u[..., None] ** np.maximum(i - 1, 0), j * v[..., None] ** np.maximum(j - 1, 0)
        p = np.einsum("tpsk,pkc->ctps", np.stack([ui * vj, ud * vj, ui * vd]), fractions[..., :3])
        f, g = p[0] - a * p[2], p[1] - b * p[2]
        return [f[0], g[0], f[1], g[1], f[2], g[2]]

    done = np.zeros(u.shape, dtype=bool)
    before = np.zeros(u.shape)
    back_u, back_v = np.zeros((2, *u.shape))
    for _ in range(_STEPS):
        f, g, fu, gu, fv, gv = evaluate(u, v)
        det = fu * gv - fv * gu
        du, dv = (fv * g - gv * f) / det, (gu * f - fu * g) / det
        size = np.maximum(np.abs(du), np.abs(dv))
        by_u, by_v = np.abs(fu) + np.abs(gu), np.abs(fv) + np.abs(gv)
        area = np.abs(det)
        at_hand = np.maximum(np.abs(f), np.abs(g)) < ROUNDING
        small = size**2 * (area + np.maximum(by_u, by_v)) < LAST_STEP**2 * area
        too_far = (det <= LEAST_DROP * before) & ~at_hand
        factor = np.where(at_hand & ~small, 0.0, np.minimum(1.0, 1.0 / size))
        step_u = np.where(too_far, -back_u, np.where(factor > 0, factor * du, 0.0))
        step_v = np.where(too_far, -back_v, np.where(factor > 0, factor * dv, 0.0))
        back_u, back_v = (
            np.where(too_far, 2 * back, BACK * step)
            for back, step in ((back_u, step_u), (back_v, step_v))
        )
        u, v = np.where(done, u, u + step_u), np.where(done, v, v + step_v)
        before = np.where(too_far, before, det)
        done |= (small | at_hand) & ~too_far
    # back into the triangle, by way of the parameter that moves the point least
    by_both = np.abs(fu - fv) + np.abs(gu - gv)
    u, v = u + 1 / 3, v + 1 / 3
    v = np.where(by_u > by_both, v + np.minimum(u, 0.0), v)
    u = np.maximum(u, 0.0)
    u = np.where(by_v > by_both, u + np.minimum(v, 0.0), u)
    v = np.maximum(v, 0.0)
    over = np.maximum(u + v - 1.0, 0.0)
    u, v = np.where(by_u < by_v, u - over, u), np.where(by_u < by_v, v, v - over)
    f, g = evaluate(np.clip(u, 0.0, 1.0) - 1 / 3, np.clip(v, 0.0, 1.0) - 1 / 3)[:2]
    return (np.maximum(np.abs(f), np.abs(g)) < 2 * ROUNDING).all(axis=1)
