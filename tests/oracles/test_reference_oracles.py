"""The reference intersector against sympy's resultants and OpenCASCADE, where installed."""

from __future__ import annotations

from fractions import Fraction
from math import comb

import numpy as np
import pytest
from reference_cases import rays, rays_through, wavy

from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.tensor import tensor_to_triangles
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.oracles.reference import candidates, intersect_all


def exact_roots(sympy, net: np.ndarray, o: np.ndarray, d: np.ndarray) -> list[tuple[float, float]]:
    """Return all real (u, v) in the triangle, from exact polynomials and their resultant."""
    u, v = sympy.symbols("u v")
    n = bernstein.degree_of(len(net))
    a, b = np.array([[0, d[2], -d[1]], [d[2], 0, -d[0]]])  # both perpendicular to d: exact
    polynomials = []
    for normal in (a, b):
        normal = [Fraction(x) for x in normal.tolist()]
        offset = sum(x * Fraction(y) for x, y in zip(normal, o.tolist()))
        total = 0
        for (i, j, k), point in zip(bernstein.multi_indices(n).tolist(), net.tolist()):
            x = [Fraction(c) for c in point]
            c = sum(p * q for p, q in zip(normal, x)) - offset * x[3]
            number = comb(n, i) * comb(n - i, j) * c
            rational = sympy.Rational(number.numerator, number.denominator)
            total += rational * u**i * v**j * (1 - u - v) ** k
        polynomials.append(sympy.Poly(sympy.expand(total), u, v))
    f, g = polynomials
    resultant = sympy.Poly(sympy.resultant(f.as_expr(), g.as_expr(), v), u)
    found = []
    for x in resultant.nroots(n=40, maxsteps=200):
        if abs(sympy.im(x)) > 1e-20 or not -0.1 < sympy.re(x) < 1.1:
            continue
        x = sympy.re(x)
        for y in sympy.Poly(f.as_expr().subs(u, x), v).nroots(n=30, maxsteps=200):
            close = abs(complex(sympy.N(g.as_expr().subs({u: x, v: y}), 30))) < 1e-15
            if close and abs(sympy.im(y)) < 1e-15:
                y = sympy.re(y)
                if min(x, y, 1 - x - y) >= 0:
                    found.append((float(x), float(y)))
    return found


@pytest.mark.parametrize("n, signs", [(2, False), (2, True), (3, False), (3, True)])
def test_resultant(n: int, signs: bool) -> None:
    sympy = pytest.importorskip("sympy")
    rng = np.random.default_rng(20 + n)
    nets = wavy(rng, n, patches=3, signs=signs)
    o, d, patch, _uv, _t = rays_through(rng, nets, 4)
    count = 0
    for ray in range(len(o)):
        net = nets.control_points[patch[ray]]
        roots = intersect_all(BezierTriangles(net), o[ray], d[ray])
        exact = exact_roots(sympy, net, o[ray], d[ray])
        count += len(exact)
        assert len(exact) == len(roots.t) > 0
        for point in exact:
            # a root that float64 knows to 1e-15 over its least singular value
            assert np.linalg.norm(roots.uv - point, axis=1).min() < 1e-10
    assert count >= 4


def occ_face(net: np.ndarray):
    """Return a rational tensor-product Bézier patch as a face of OpenCASCADE."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.Geom import Geom_BezierSurface
    from OCP.gp import gp_Pnt

    try:
        from OCP.collections import Array2_double, Array2_gp_Pnt
    except ImportError:  # before OpenCASCADE 8
        from OCP.TColgp import TColgp_Array2OfPnt as Array2_gp_Pnt
        from OCP.TColStd import TColStd_Array2OfReal as Array2_double
    rows, columns = net.shape[:2]
    points, weights = Array2_gp_Pnt(1, rows, 1, columns), Array2_double(1, rows, 1, columns)
    for i in range(rows):
        for j in range(columns):
            w = float(net[i, j, 3])
            points.SetValue(i + 1, j + 1, gp_Pnt(*(net[i, j, :3] / w).tolist()))
            weights.SetValue(i + 1, j + 1, w)
    return BRepBuilderAPI_MakeFace(Geom_BezierSurface(points, weights), 1e-9).Face()


@pytest.mark.parametrize("p, q", [(1, 1), (2, 2), (3, 3), (2, 4)])
def test_opencascade(p: int, q: int) -> None:
    pytest.importorskip("OCP")
    from OCP.gp import gp_Dir, gp_Lin, gp_Pnt
    from OCP.IntCurvesFace import IntCurvesFace_Intersector

    rng = np.random.default_rng(30 + p + q)
    s, t = np.meshgrid(np.arange(p + 1) / p, np.arange(q + 1) / q, indexing="ij")
    net = np.stack([2 * s - 1, 2 * t - 1, 0 * s, np.ones_like(s)], axis=-1)
    net[..., :3] += rng.normal(size=net[..., :3].shape) * 0.3
    net *= np.exp(rng.uniform(np.log(0.3), np.log(3), net.shape[:2]))[..., None]
    intersector = IntCurvesFace_Intersector(occ_face(net), 1e-10)
    o, d = rays(rng, 400)
    d /= np.linalg.norm(d, axis=1)[:, None]
    all_ = candidates(tensor_to_triangles(net), o, d, extend=1e-3)
    # graze and rim: within 1e-7 OpenCASCADE's own tolerance decides
    doubtful = np.unique(all_.ray[(np.abs(all_.edge) < 1e-7) | (all_.graze < 1e-7)])
    roots = all_.select(all_.inside & (all_.kind >= 0))
    total = 0
    for ray in np.setdiff1d(np.arange(400), doubtful):
        intersector.Perform(gp_Lin(gp_Pnt(*o[ray]), gp_Dir(*d[ray])), -100.0, 100.0)
        count = intersector.NbPnt()
        expected = np.sort([intersector.WParameter(k) for k in range(1, count + 1)])
        found = roots.t[roots.ray == ray]
        # OpenCASCADE's tolerance for a root is 1e-10 here; mostly both agree to 1e-14
        np.testing.assert_allclose(found, expected, atol=1e-9)
        total += count
    assert total > 150
