"""Patches projected onto quadrics, and the quadric found back from a net."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import rotation
from surface_checks import implicit, parameters

from mitsuba_bezier.errors import BezierError, GeometryError, NetError
from mitsuba_bezier.geometry import bernstein, quadrics
from mitsuba_bezier.geometry.covers import octants, sphere, tetrahedral
from mitsuba_bezier.geometry.quadrics import fit_quadric, fit_quadrics, quadric_patch
from mitsuba_bezier.geometry.shapes import torus
from mitsuba_bezier.geometry.triangles import BezierTriangles

SIGNATURES = [(1, 1, 1, -1), (1, 1, -1, -1), (1, 1, -1, 0), (1, -1, 0, 0)]
SPHERE = np.diag([1.0, 1, 1, -1])


def collineation(rng: np.random.Generator, low: float = 0.5) -> np.ndarray:
    """A regular matrix of condition ``1 / low**2``."""
    q = rotation(rng, 4)
    r = rotation(rng, 4)
    return q @ np.diag(rng.uniform(low, 1 / low, 4)) @ r


def random_quadric(rng, signature) -> tuple[np.ndarray, np.ndarray]:
    """Return a quadric of this signature and a collineation that takes the diagonal one to it."""
    m = collineation(rng)
    inverse = np.linalg.inv(m)
    a = inverse.T @ np.diag(np.array(signature, dtype=float)) @ inverse
    return (a + a.T) / 2, m


def random_points(rng, signature, m: np.ndarray, count: int) -> np.ndarray:
    """Return points of the quadric of `random_quadric`."""
    d = np.array(signature)
    x = rng.normal(size=(count, 4))
    for part in (d > 0, d < 0):
        x[:, part] /= np.linalg.norm(x[:, part], axis=1, keepdims=True)
    return x @ m.T


def independent_points(rng, s: np.ndarray) -> np.ndarray:
    """Return three points which, with the unit vector of `s`, are far from dependent."""
    while True:
        p = rng.normal(size=(3, 4))
        p /= np.linalg.norm(p, axis=1, keepdims=True)
        if np.linalg.svd(np.vstack([p, s / np.linalg.norm(s)]), compute_uv=False)[-1] > 0.3:
            return p


#: Half a rounding for each stage of a number: S'A, S'AP, its product with P, three sums, a product
#: with a Bernstein polynomial, five sums; and some four for the quadric that the points are on.
BOUND = 10 * np.finfo(float).eps


def net_terms(a: np.ndarray, s: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the sums of the sizes of all terms of the net of `quadric_patch`."""
    a, s, p = np.abs(a), np.abs(s), np.abs(np.array(p))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    return np.array(
        [(s @ a @ p[i]) * p[j] + (s @ a @ p[j]) * p[i] + (p[i] @ a @ p[j]) * s for i, j in pairs]
    )


def same_up_to_factor(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return float(min(np.abs(a - b).max(), np.abs(a + b).max()))


@pytest.mark.parametrize(
    ("signature", "on_quadric"),
    [*((s, False) for s in SIGNATURES), *((s, True) for s in SIGNATURES[:3])],
)
def test_patch_lies_on_its_quadric(signature, on_quadric):
    rng = np.random.default_rng(1)
    for _ in range(20):
        a, m = random_quadric(rng, signature)
        s, *p = random_points(rng, signature, m, 4)
        if not on_quadric:
            p = rng.normal(size=(3, 4))
        net = quadric_patch(a, s, p)
        _, uv = parameters(rng, 1, 200)
        uv = 3 * uv - 1
        x = BezierTriangles(net).evaluate(0, uv)
        value = np.abs(np.einsum("ni,ij,nj->n", x, a, x))
        terms = net_terms(a, s, p)
        size = np.abs(bernstein.basis(2, uv)) @ terms
        assert (value <= BOUND * np.einsum("ni,ij,nj->n", size, np.abs(a), size)).all()
        if on_quadric:
            for row, corner in zip((0, 3, 5), p):
                bound = BOUND * terms[row].max() / np.linalg.norm(net[row])
                assert same_up_to_factor(net[row], corner) <= bound


def test_boundary_conics_pass_through_the_center():
    rng = np.random.default_rng(2)
    a, m = random_quadric(rng, (1, 1, 1, -1))
    s, *p = random_points(rng, (1, 1, 1, -1), m, 4)
    h = BezierTriangles(quadric_patch(a, s, p))
    polar = np.array(p) @ a @ s
    for i, j in ((0, 1), (1, 2), (2, 0)):
        u = np.zeros(3)
        u[i], u[j] = polar[j], -polar[i]  # on the line that is contracted to S
        x = h.evaluate(0, [(u / u.sum())[:2]])[0]
        assert same_up_to_factor(x, s) < 1e-12  # u.sum() may cancel a digit


def test_ideal_points_in_the_tangent_plane_make_a_lune():
    s, e, f, j = [0, 0, -1, 1], [1, 0, 0, 0], [0, 1, 0, 0], [0.6, 0.0, 0.8, 1]
    net = quadric_patch(SPHERE, s, [j, e, f])
    for row in (3, 4, 5):  # the edge between the ideal points is collapsed into the centre
        assert np.allclose(np.cross(net[row, :3], [0, 0, 1]), 0) and net[row, 2] == -net[row, 3]
    assert same_up_to_factor(net[0], np.array(j)) < 1e-15


def test_weights_are_positive_on_a_face_of_the_sphere():
    # A and -A are the same quadric, so the sign must not come from A
    p = [[1, 0, 0, 1], [0, 1, 0, 1], [-0.6, -0.8, 0, 1]]
    for a in (SPHERE, -SPHERE):
        assert (quadric_patch(a, [0, 0, -1, 1], p)[:, 3] > 0).all()


def test_patch_commutes_with_collineations():
    rng = np.random.default_rng(3)
    for _ in range(20):
        a, m = random_quadric(rng, (1, 1, -1, -1))
        s, *p = random_points(rng, (1, 1, -1, -1), m, 4)
        c = collineation(rng)
        i = np.linalg.inv(c)
        b = quadric_patch(i.T @ a @ i, c @ s, np.array(p) @ c.T)
        # 1e-12: conditions 4 and 4, squared in A
        assert same_up_to_factor(b, quadric_patch(a, s, p) @ c.T) < 1e-12


@pytest.mark.parametrize(
    ("message", "a", "center", "points"),
    [
        ("A: expected a symmetric", np.triu(np.ones((4, 4))), [0, 0, 1, 1], np.eye(4)[:3]),
        ("A: expected a quadric, got the zero", np.zeros((4, 4)), [0, 0, 1, 1], np.eye(4)[:3]),
        ("A: .*shape", np.eye(3), [0, 0, 1, 1], np.eye(4)[:3]),
        ("A: .*NaN", np.full((4, 4), np.nan), [0, 0, 1, 1], np.eye(4)[:3]),
        ("A: .*finite numbers", "sphere", [0, 0, 1, 1], np.eye(4)[:3]),
        ("A: .*empty", np.eye(4), [0, 0, 1, 1], np.eye(4)[:3]),
        ("center: .*on the quadric", SPHERE, [0, 0, 1.001, 1], np.eye(4)[:3]),
        ("center: .*zero vector", SPHERE, [0, 0, 0, 0], np.eye(4)[:3]),
        ("center: .*NaN", SPHERE, [0, 0, np.inf, 1], np.eye(4)[:3]),
        ("center: .*shape", SPHERE, [0, 0, 1], np.eye(4)[:3]),
        ("center: .*vertex", np.diag([1.0, 1, -1, 0]), [0, 0, 0, 1], np.eye(4)[:3]),
        ("points: .*shape", SPHERE, [0, 0, 1, 1], np.eye(4)),
        ("points: .*zero vector", SPHERE, [0, 0, 1, 1], np.diag([1.0, 1, 0, 0])[:3]),
        ("points: .*dependent", SPHERE, [0, 0, 1, 1], [[1, 0, 0, 1], [2, 0, 0, 2], [0, 1, 0, 1]]),
        # the centre lies in the plane of the points
        ("points: .*dependent", SPHERE, [0, 0, 1, 1], [[1, 0, 0, 1], [-1, 0, 0, 1], [0, 0, -1, 1]]),
    ],
)
def test_patch_errors(message, a, center, points):
    with pytest.raises(GeometryError, match=message):
        quadric_patch(a, center, points)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_equations_are_the_coefficients_of_the_form(n):
    rng = np.random.default_rng(4)
    net = rng.normal(size=(1, bernstein.size(n), 4))
    q = rng.normal(size=(4, 4))
    q = q + q.T
    rows, columns = np.triu_indices(4)
    unknown = q[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))
    coefficients = quadrics._equations(net, n)[0] @ unknown
    _, uv = parameters(rng, 1, 50)
    x = BezierTriangles(net).evaluate(0, uv)
    direct = np.einsum("ni,ij,nj->n", x, q, x)
    # the system holds 2 b'Qb; the sums have size up to 100
    assert np.allclose(bernstein.basis(2 * n, uv) @ coefficients, 2 * direct, atol=1e-12)


@pytest.mark.parametrize("signature", SIGNATURES[:3])
@pytest.mark.parametrize("times", [0, 1, 2])
def test_fit_finds_the_quadric_of_a_patch(signature, times):
    rng = np.random.default_rng(5)
    for _ in range(20):
        a, m = random_quadric(rng, signature)
        s = random_points(rng, signature, m, 1)[0]
        h = BezierTriangles(quadric_patch(a, s, independent_points(rng, s))).elevate(times)
        found = fit_quadric(h.control_points[0])
        assert found is not None
        # rounding times the conditions of M (16 in A) and of the patch; the worst of 3000
        # cases was 3e-13
        assert same_up_to_factor(found, a) < 1e-12


@pytest.mark.parametrize("cover", [octants, tetrahedral])
@pytest.mark.parametrize(
    "place",
    # at 2e6 the coordinates still have ten digits of the radius
    [(0, 0, 0, 1), (3, -2, 5, 0.5), (1e4, 0, 0, 1), (2e6, 0, 0, 1), (0, 0, 0, 1e-6)],
)
def test_fit_of_sphere_covers(cover, place):
    patches = sphere(place[:3], place[3], cover.__name__)
    for h in (patches, patches.elevate(), patches.split()):
        if place[0] > 1e6 and len(h) > len(patches):
            continue  # a quarter of an octant has one digit too few there
        a, ok = fit_quadrics(h.control_points)
        assert ok.all()
        x = h.evaluate(np.arange(len(h)), np.full((len(h), 2), 0.2))
        assert implicit(a[-1], x[-1]) < 1e-14
        if place[0] < 1e3:
            c, r = np.array(place[:3]), place[3]
            want = np.block([[np.eye(3), -c[:, None]], [-c, np.array([[c @ c - r * r]])]])
            # 1e-12: rounding times the conditions of a patch and of its place (37 here)
            assert max(same_up_to_factor(q, want) for q in a) < 1e-12


def test_fit_is_normalized():
    a, _ = fit_quadrics(sphere((1, 2, 3), 2).control_points)
    assert np.abs(np.abs(a).max(axis=(1, 2)) - 1).max() == 0
    assert (np.einsum("i,pij,j->p", [1, 2, 3, 1], a, [1, 2, 3, 1]) < 0).all()  # inside
    assert np.array_equal(a, np.swapaxes(a, 1, 2))


def test_fit_commutes_with_collineations():
    rng = np.random.default_rng(6)
    for _ in range(10):
        m = collineation(rng, 0.2)
        i = np.linalg.inv(m)
        for a in fit_quadrics(octants().transform(m).control_points)[0]:
            assert same_up_to_factor(a, i.T @ SPHERE @ i) < 1e-11  # condition 25, squared


def test_small_and_flat_patches_keep_their_quadric():
    # 5 splits: 1/32 of an octant, bulge over length 0.02; ratios reach 1e-12, see `fit_quadrics`
    h = octants()[0]
    for _ in range(5):
        h = h[0].split() if len(h) == 1 else h[:4].split()
    assert fit_quadrics(h.control_points)[1].all()


def test_nets_off_every_quadric_are_refused():
    rng = np.random.default_rng(7)
    for n in (2, 3, 4):
        assert not fit_quadrics(rng.normal(size=(200, bernstein.size(n), 4)))[1].any()
    assert not fit_quadrics(torus().control_points)[1].any()
    net = octants().control_points[0].copy()
    net[4, 0] += 1e-7  # a hundred times the tolerance
    assert fit_quadric(net) is None
    assert fit_quadric(net, tolerance=1e-5) is not None


def test_float32_nets_need_their_own_tolerance():
    net = octants().control_points.astype(np.float32)
    assert not fit_quadrics(net)[1].any()
    assert fit_quadrics(net, tolerance=1e-5, flat=1e-6)[1].all()


@pytest.mark.parametrize("n", [1, 2, 4])
def test_nets_on_many_quadrics_are_refused(n):
    rng = np.random.default_rng(8)
    k = bernstein.size(n)
    plane = rng.normal(size=(k, 3)) @ rng.normal(size=(3, 4))
    line = rng.normal(size=(k, 2)) @ rng.normal(size=(2, 4))
    point = rng.normal(size=(k, 1)) @ rng.normal(size=(1, 4))
    ideal = rng.normal(size=(k, 4)) * [1, 1, 1, 0]
    # a space curve, constant along the other direction of the domain
    curve = BezierTriangles(rng.normal(size=(k, 4)))
    powers = (bernstein.multi_indices(n)[:, :1] / n) ** np.arange(4)
    assert curve.degree == n
    nets = [plane, line, point, ideal, np.zeros((k, 4)), powers @ rng.normal(size=(4, 4))]
    a, ok = fit_quadrics(np.array(nets))
    assert not ok.any() and not a.any()


def test_white_nets_are_orthonormal_and_thickness_knows_no_place():
    here = quadrics.whiten(octants().control_points)
    for place in ((5, 5, 5, 2), (1e4, 0, 0, 1), (0, 0, 0, 1e-6)):
        nets = sphere(place[:3], place[3]).control_points
        white, back, thickness = quadrics.whiten(nets)
        # 1e-10: 1e-16 of the coordinates against the radius, 1e4 times smaller; and the net
        # times `back` has the condition 1e4 again
        assert np.allclose(thickness, here[2], rtol=1e-10)
        assert np.allclose(np.swapaxes(white, 1, 2) @ white, np.eye(4), atol=1e-14)
        assert np.allclose(nets @ back, white, atol=1e-10)


def test_thin_strip_along_a_space_curve():
    # on x y = z w, of width 2 width, along a space cubic that lies on many quadrics
    def net(width: float) -> np.ndarray:
        monomials = np.zeros((10, 4))
        for column, (i, j, factor) in enumerate([(2, 0, 1), (1, 0, 1), (3, 0, 1), (0, 0, 1)]):
            monomials[bernstein.row(3, i, j), column] = factor
        monomials[bernstein.row(3, 0, 1), 0] = width
        monomials[bernstein.row(3, 1, 1), 2] = width
        return np.linalg.solve(bernstein.monomial_matrix(3), monomials)

    want = np.zeros((4, 4))
    want[0, 1] = want[1, 0] = 1
    want[2, 3] = want[3, 2] = -1
    # 1e-15 over the width
    assert same_up_to_factor(fit_quadric(net(1e-3)), want) < 1e-11
    # the width times 0.5 is the second singular value, and the documented limit 1e-7
    assert fit_quadric(net(1e-8), tolerance=1e-6) is None


def test_single_and_batch_agree():
    nets = np.concatenate([octants().control_points, torus().control_points])
    a, ok = fit_quadrics(nets)
    for net, q, good in zip(nets, a, ok):
        found = fit_quadric(net)
        assert (found is not None) == good
        assert found is None or np.allclose(found, q, rtol=0, atol=1e-15)
    assert ok.sum() == 8


@pytest.mark.parametrize(
    "net", [np.zeros(4), np.zeros((5, 4)), np.zeros((6, 3)), np.full((6, 4), np.nan), "net"]
)
def test_fit_errors(net):
    with pytest.raises(NetError, match="net"):
        fit_quadric(net)
    with pytest.raises(BezierError, match="nets"):
        fit_quadrics(net)
