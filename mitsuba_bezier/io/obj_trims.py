"""Surfaces of ``.obj`` files with trimming curves that are no parameter lines."""

from __future__ import annotations

from functools import partial
from math import comb
from typing import Any

import numpy as np

from ..geometry.trims import Trims
from .cad.plane_regions import standard
from .cad.trimmed_patches import closed_boundary, cut, fit_parabolas, trimmed_grid, trimmed_patches
from .nurbs import check_knots, surface_to_bezier
from .nurbs_surface import PatchGrid, bezier_points

__all__ = ["bezier_form", "grid_of_range", "trimmed_surface"]


def bezier_form(kind: str, net: np.ndarray, degree: int, spans: int) -> np.ndarray | None:
    """Return the points ``(spans * degree + 1, d)`` of a cardinal or Taylor curve in Bézier form.

    None if the number of points does not fit, or parts do not join.
    """
    if kind == "cardinal":
        if degree != 3 or len(net) != spans + 3:
            return None
        before, start, stop, after = (net[k : k + spans] for k in range(4))
        parts = np.stack([start, start + (stop - before) / 6, stop - (after - start) / 6, stop], 1)
    else:
        if len(net) != spans * (degree + 1):
            return None
        coefficients = net.reshape(spans, degree + 1, -1)  # of powers of the local parameter
        n = degree
        change = np.array(
            [
                [comb(j, i) / comb(n, i) if i <= j else 0.0 for i in range(n + 1)]
                for j in range(n + 1)
            ]
        )
        parts = np.einsum("ji,sid->sjd", change, coefficients)
        # 1e-6 of the size: files have six digits
        if np.abs(parts[1:, 0] - parts[:-1, -1]).max(initial=0.0) > 1e-6 * np.ptp(parts):
            return None
    return np.concatenate([parts[:, :-1].reshape(-1, parts.shape[2]), parts[-1, -1:]])


def grid_of_range(
    net: np.ndarray, knots: tuple[Any, Any], degrees: tuple[int, int], box: np.ndarray
) -> PatchGrid | str:
    """Return the patches of a NURBS surface within ``[[s0, s1], [t0, t1]]``.

    Raises
    ------
    GeometryError
        If the knots do not fit.
    """
    knots_u = check_knots(knots[0], degrees[0], net.shape[0], "knots_u")
    knots_v = check_knots(knots[1], degrees[1], net.shape[1], "knots_v")
    patches, domains = surface_to_bezier(net, knots_u, knots_v, degrees, (box[0], box[1]))
    middle = domains.mean(axis=2)
    left = ((middle > box[:, 0]) & (middle < box[:, 1])).all(axis=1)
    if not left.any():
        return "nothing is left inside of its range"
    patches, domains = patches[left], domains[left]
    u, v = (np.unique(domains[:, axis]) for axis in range(2))
    return PatchGrid(patches.reshape(len(u) - 1, len(v) - 1, *patches.shape[1:]), u, v)


def trimmed_surface(
    grid: PatchGrid, loops: list[list[np.ndarray]], trims: bool
) -> list[tuple[np.ndarray, Trims | None]] | str:
    """Return what trimming curves leave of a surface.

    Parameters
    ----------
    grid : PatchGrid
        The surface over its range.
    loops : list of list of (n+1, 3) arrays
        Homogeneous Bézier curves of positive weights; inside by the even-odd rule.
    trims : bool
        Whether the patches may keep the curves as trims; else they are restricted to them, and
        curves that are no conics become parabolas within 1e-5 of the size of the surface.

    Returns
    -------
    list of pairs of nets and trims, or str
        The reason if there are none.
    """
    curves = [standard(c) for loop in loops for c in loop]
    flat = np.concatenate([bezier_points(c, np.linspace(0, 1, 17)) for c in curves])
    box = np.stack([flat.min(axis=0), flat.max(axis=0)], axis=1)
    if (np.ptp(box, axis=1) == 0).any():
        return "nothing is left inside of its range and trims"
    if not trims:
        points = grid.patches[..., :3] / grid.patches[..., 3:]
        lengths = [
            np.linalg.norm(np.diff(points, axis=2 + k), axis=-1).sum(axis=(k, 2 + k)).max()
            for k in (0, 1)
        ]
        scale = np.array(lengths) / (grid.domain[:, 1] - grid.domain[:, 0])
        fitted: list[np.ndarray] = []
        for c in curves:
            if len(c) <= 3:
                fitted.append(c)
                continue
            found = fit_parabolas(partial(bezier_points, c), scale, 1e-5 * grid.size)
            if found is None:
                return "trimmed by a curve that parabolas cannot follow"
            fitted += found
        curves = fitted
    closed = closed_boundary(curves, box)
    if isinstance(closed, str):
        return closed
    if trims:
        part = trimmed_grid(grid, closed)
        return part if isinstance(part, str) else [part]
    extent = grid.domain[:, 1] - grid.domain[:, 0]
    for axis in range(2):  # the trims may reach beyond the range
        for side in (0, 1):
            value = float(grid.domain[axis, side])
            beyond = box[axis, 0] < value if side == 0 else box[axis, 1] > value
            if beyond and closed:
                parts = cut(closed, axis, value, 1e-9 * float(extent[axis]))
                if parts is None:
                    return "its boundary is not closed"
                closed = parts[1 - side]
    if not closed:
        return "nothing is left inside of its range and trims"
    nets = trimmed_patches(grid, closed)
    return nets if isinstance(nets, str) else [(net, None) for net in nets]
