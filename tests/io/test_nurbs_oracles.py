"""NURBS against geomdl, an independent library, where it is installed."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io.nurbs import curve_to_bezier, surface_to_bezier
from mitsuba_bezier.io.nurbs_surface import PatchGrid, bezier_points
from mitsuba_bezier.io.tensor_nets import tensor_nets


def knot_vector(rng, degree: int, count: int) -> list[float]:
    """A clamped knot vector on [0, 1] with a double knot inside."""
    inner = np.sort(rng.uniform(0.1, 0.9, count - degree - 1))
    if len(inner) > 1 and degree > 1:
        inner[1] = inner[0]
    return [0.0] * (degree + 1) + inner.tolist() + [1.0] * (degree + 1)


@pytest.mark.parametrize("degrees", [(1, 2), (2, 2), (3, 2), (3, 5)])
def test_surface_equals_geomdl(degrees):
    NURBS = pytest.importorskip("geomdl.NURBS")
    rng = np.random.default_rng(sum(degrees))
    counts = degrees[0] + 4, degrees[1] + 3
    net = np.empty((*counts, 4))
    net[..., 3] = rng.uniform(0.5, 2, counts)
    net[..., :3] = rng.uniform(-1, 1, (*counts, 3)) * net[..., 3:]
    knots = [knot_vector(rng, p, m) for p, m in zip(degrees, counts)]
    theirs = NURBS.Surface()
    theirs.degree_u, theirs.degree_v = degrees
    theirs.set_ctrlpts(net.reshape(-1, 4).tolist(), *counts)
    theirs.knotvector_u, theirs.knotvector_v = knots
    patches, domains = surface_to_bezier(net, *knots, degrees)
    triangles = BezierTriangles(tensor_nets(patches))
    st = rng.dirichlet([1, 1, 1], 5)[:, :2]
    for k in range(len(triangles)):
        inside = st if k % 2 == 0 else 1 - st
        low, high = domains[k // 2].T
        wanted = theirs.evaluate_list((low + inside * (high - low)).tolist())
        # 1e-12 as required; coordinates are below one
        np.testing.assert_allclose(triangles.points(k, st), wanted, rtol=0, atol=1e-12)
    uv = rng.random((20, 2))
    grid = PatchGrid.from_nurbs(net, *knots, degrees)
    wanted = np.array([theirs.derivatives(*at, order=1) for at in uv.tolist()])
    for ours, (i, j) in zip(grid.jet(uv), ((0, 0), (1, 0), (0, 1))):
        # derivatives are larger by the degree over the shortest span, about 100
        np.testing.assert_allclose(ours, wanted[:, i, j], rtol=1e-11, atol=1e-11)


def test_curve_equals_geomdl():
    NURBS = pytest.importorskip("geomdl.NURBS")
    rng = np.random.default_rng(1)
    net = np.column_stack([rng.uniform(-1, 1, (9, 3)), np.ones(9)])
    net *= rng.uniform(0.5, 2, (9, 1))
    knots = knot_vector(rng, 3, 9)
    theirs = NURBS.Curve()
    theirs.degree = 3
    theirs.ctrlptsw = net.tolist()
    theirs.knotvector = knots
    breaks = np.unique(knots)
    t = rng.random(6)
    for piece, low, high in zip(curve_to_bezier(net, knots, 3), breaks, breaks[1:]):
        wanted = theirs.evaluate_list((low + t * (high - low)).tolist())
        np.testing.assert_allclose(bezier_points(piece, t), wanted, rtol=0, atol=1e-12)
