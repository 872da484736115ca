"""The reference intersector against analytic answers, known points, tessellations, itself."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import collineation
from reference_cases import rays, rays_through, wavy

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.geometry.covers import sphere
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.oracles import analytic
from mitsuba_bezier.oracles.bivariate import SIMPLE, UNRESOLVED
from mitsuba_bezier.oracles.reference import candidates, first_hit, intersect_all

QUARTER_PLANE = BezierTriangles([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ``a - b`` where both are finite, else 0."""
    both = np.isfinite(a) & np.isfinite(b)
    return np.where(both, a, 0) - np.where(both, b, 0)


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_sphere(cover: str) -> None:
    rng = np.random.default_rng(1)
    center, radius = np.array([0.3, -0.2, 0.1]), 1.3
    nets = sphere(center, radius, cover)
    o, d = rays(rng, 3000, distance=3, ball=1.7)
    exact = analytic.sphere(center, radius, o, d)
    hits = first_hit(nets, o, d)
    assert 0.3 < np.isfinite(hits.t).mean() < 0.9
    # the line is known to some 1e-15, relative to its distance of 3
    clear = np.abs(exact.clearance) > 1e-13
    assert np.array_equal(np.isfinite(exact.first())[clear], np.isfinite(hits.t)[clear])
    hit = np.isfinite(hits.t)
    error = np.abs(same(exact.first(), hits.t)) * np.linalg.norm(d, axis=1)
    assert (
        error[hit] * hits.margin.cosine[hit]
    ).max() < 1e-14  # a few eps of 3, across the surface
    true_cosine = (exact.normals[:, 0] * d).sum(axis=1) / np.linalg.norm(d, axis=1)
    np.testing.assert_allclose(hits.margin.cosine[hit], -true_cosine[hit], atol=1e-9)
    # exit points: together with the entry points these are all
    roots = intersect_all(nets, o, d)
    assert (roots.kind == SIMPLE).all()
    assert np.array_equal(np.bincount(roots.ray, minlength=3000), 2 * hit)
    last = np.full(3000, -np.inf)
    np.maximum.at(last, roots.ray, roots.t)
    np.testing.assert_allclose(last[hit], exact.t[hit, 1], rtol=1e-11)  # worst at the silhouette
    assert (np.sign(roots.cosine) == np.where(roots.t < last[roots.ray], -1, 1)).all()


def test_silhouette_of_the_sphere() -> None:
    """Right to 1e-12 of the silhouette, and `graze` knows how near it is."""
    rng = np.random.default_rng(2)
    nets = sphere()
    u = rng.normal(size=(300, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    side = np.cross(u, rng.normal(size=(300, 3)))
    side /= np.linalg.norm(side, axis=1)[:, None]
    offset = 10.0 ** rng.uniform(-12, -4.7, 300) * rng.choice([-1, 1], 300)
    hits = first_hit(nets, side * (1 + offset)[:, None] - 2.5 * u, u)
    hit = offset < 0
    assert np.array_equal(np.isfinite(hits.t), hit)
    margin = hits.margin
    ratio = (margin.graze * margin.scale)[hit] / -offset[hit]
    big = -offset[hit] > 1e-11  # below, rounding shows in the estimate
    assert (ratio[big] > 0.6).all() and (ratio[big] < 1.02).all()  # first order, see the module
    # misses: M/|w| lies between 2.5 and 2.5 + 3, origin and points as seen from the patches'
    # centres; nearer than 1e-5 of it all near misses are found
    ratio = margin.graze[~hit] / offset[~hit]
    assert (ratio > 1 / 5.5).all() and (ratio < 1 / 2.5).all()


def test_torus_all_roots() -> None:
    rng = np.random.default_rng(3)
    nets = shapes.torus(tube=0.4)
    o, d = rays(rng, 1500, ball=1.5)
    exact = analytic.torus((0, 0, 0), (0, 0, 1), 1, 0.4, o, d)
    roots = intersect_all(nets, o, d)
    assert roots.certain.all()
    # 32 patches of some 0.5 across: none of 1500 rays meets a shared edge within rounding
    assert np.array_equal(np.bincount(roots.ray, minlength=1500), np.isfinite(exact.t).sum(axis=1))
    assert (np.isfinite(exact.t).sum(axis=1) == 4).sum() > 10
    found = exact.t[np.isfinite(exact.t)]  # both are sorted by ray, then by t
    np.testing.assert_allclose(roots.t, found, atol=1e-12)


SADDLE = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]]

OPEN_QUADRICS = {
    "cylinder": (
        shapes.cylinder(),
        lambda o, d: analytic.cylinder((0, 0, 0), (0, 0, 1), 1, o, d),
        lambda x: np.minimum(x[..., 2], 1 - x[..., 2]),
    ),
    "cone": (
        shapes.cone(),
        lambda o, d: analytic.cone((0, 0, 1), (0, 0, 1), 1, o, d),
        lambda x: np.minimum(x[..., 2], 1 - x[..., 2]),
    ),
    "saddle": (
        shapes.hyperbolic_paraboloid(),
        lambda o, d: analytic.quadric(SADDLE, o, d),
        lambda x: 1 - np.abs(x[..., :2]).max(axis=-1),
    ),
}


@pytest.mark.parametrize("name", OPEN_QUADRICS)
def test_open_quadrics(name: str) -> None:
    """The roots are the points of the quadric between the rims, no more and no less."""
    nets, intersect, within = OPEN_QUADRICS[name]
    o, d = rays(np.random.default_rng(4), 1500)
    exact = intersect(o, d)
    finite = np.isfinite(exact.t)
    x = o[:, None] + np.where(finite, exact.t, 0)[..., None] * d[:, None]
    expected = finite & (within(x) > 0)
    assert (np.abs(within(x)[finite]) > 1e-9).all()  # none at the rim, where either is right
    roots = intersect_all(nets, o, d)
    assert roots.certain.all() and len(roots.t) > 500
    assert np.array_equal(np.bincount(roots.ray, minlength=1500), expected.sum(axis=1))
    np.testing.assert_allclose(roots.t, exact.t[expected], rtol=1e-10)  # worst near tangents


@pytest.mark.parametrize("n", range(1, 9))
@pytest.mark.parametrize("kind", ["positive", "signs", "vectors"])
def test_known_points_are_found(n: int, kind: str) -> None:
    rng = np.random.default_rng(n)
    nets = wavy(rng, n, signs=kind == "signs", vectors=int(kind == "vectors"))
    o, d, patch, uv, t = rays_through(rng, nets, 40)
    roots = intersect_all(nets, o, d)
    assert roots.certain.all()
    for ray in range(len(o)):
        mine = (roots.ray == ray) & (roots.patch == patch[ray])
        gap = np.linalg.norm(roots.uv[mine] - uv[ray], axis=1)
        # rounding of 1e-14 in the ray over the least singular value among 320 random places
        assert gap.min(initial=1) < 1e-8
        assert abs(roots.t[mine][gap.argmin()] - t[ray]) < 1e-8
    # Bezout
    pairs = np.unique(roots.ray * len(nets) + roots.patch, return_counts=True)[1]
    assert pairs.max() <= n * n
    # all that is reported lies on both
    finite = np.isfinite(roots.t) & (np.abs(roots.t) < 1e3)
    x = nets.points(roots.patch, roots.uv)[finite]
    on_ray = (o[roots.ray] + roots.t[:, None] * d[roots.ray])[finite]
    size = roots.scale[finite]
    assert (np.linalg.norm(x - on_ray, axis=1) / size).max() < 1e-12
    # the sign of the cosine is that of the normal
    normal = nets.normals(roots.patch, roots.uv)[finite]
    unit = d / np.linalg.norm(d, axis=1)[:, None]
    cosine = (normal * unit[roots.ray[finite]]).sum(axis=1)
    np.testing.assert_allclose(roots.cosine[finite], cosine, atol=1e-9)


def test_as_many_roots_as_a_fine_tessellation_has_crossings() -> None:
    rng = np.random.default_rng(5)
    nets = wavy(rng, 3, patches=2)
    o, d = rays(rng, 400, ball=0.8)
    vertices, faces = nets.tessellate(48)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    crossings = np.zeros(400, dtype=int)
    for ray in range(400):  # Moeller and Trumbore
        p = np.cross(d[ray], c - a)
        det = ((b - a) * p).sum(axis=1)
        s = o[ray] - a
        u = (s * p).sum(axis=1) / det
        v = (np.cross(s, b - a) @ d[ray]) / det
        crossings[ray] = ((u >= 0) & (v >= 0) & (u + v <= 1)).sum()
    roots = candidates(nets, o, d, extend=0.02, band=1e-2)
    inside = roots.inside & (roots.kind >= 0)
    # facets are 0.02 wide and at most 1e-3 off the surface: leave out what that can change
    doubtful = (np.abs(roots.edge) < 0.02) | (roots.graze < 5e-3)
    ok = np.bincount(roots.ray[doubtful], minlength=400) == 0
    count = np.bincount(roots.ray[inside], minlength=400)
    assert ok.sum() > 200 and np.array_equal(count[ok], crossings[ok])
    assert {0, 1, 2} <= set(count[ok].tolist())


def test_collineations_do_not_change_the_parameters() -> None:
    """The whole problem is projective: weights of both signs appear, roots pass infinity."""
    rng = np.random.default_rng(6)
    nets = wavy(rng, 3)
    o, d = rays(rng, 200)
    before = intersect_all(nets, o, d)
    signs = 0
    for _ in range(3):
        m = collineation(rng, 4)
        ends = np.stack([np.column_stack([o + s * d, np.ones(200)]) @ m.T for s in (0, 1)])
        ends = ends[..., :3] / ends[..., 3:]
        image = nets.transform(m)
        signs += ((image.weights.min(axis=1) < 0) & (image.weights.max(axis=1) > 0)).sum()
        after = intersect_all(image, ends[0], ends[1] - ends[0])
        order = [np.lexsort((r.uv[:, 0], r.patch, r.ray)) for r in (before, after)]
        assert np.array_equal(before.ray[order[0]], after.ray[order[1]])
        # conditions of collineation and roots multiply
        np.testing.assert_allclose(before.uv[order[0]], after.uv[order[1]], atol=1e-8)
    assert signs > 0


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_closed_covers_have_no_holes(cover: str) -> None:
    """From inside, at points of the shared edges and at the corners: every ray is caught."""
    rng = np.random.default_rng(7)
    nets = sphere(cover=cover)
    patch = rng.integers(0, len(nets), 600)
    s = rng.uniform(0, 1, 600) * (rng.uniform(size=600) < 0.97)  # some at the corners
    bary = np.column_stack([s, 1 - s, np.zeros(600)])
    bary = np.take_along_axis(bary, np.argsort(rng.uniform(size=(600, 3)), axis=1), axis=1)
    target = nets.points(patch, bary[:, :2])
    o = rng.normal(size=(600, 3))
    o *= (0.7 * rng.uniform(0, 1, 600) / np.linalg.norm(o, axis=1))[:, None]
    hits = first_hit(nets, o, target - o)
    np.testing.assert_allclose(hits.t, 1, atol=1e-9)  # at the corners of lunes sqrt(eps) counts


def test_decidable_rays_survive_rounding_to_float32() -> None:
    """What `decidable` promises, on rays that graze silhouettes and edges on purpose."""
    rng = np.random.default_rng(8)
    nets = wavy(rng, 4)
    count = 600
    patch = rng.integers(0, len(nets), count)
    uv = rng.dirichlet([1, 1, 1], count)[:, :2]
    offset = 10 ** rng.uniform(-10, -3, count) * rng.choice([-1, 1], count)
    edge = np.arange(count) % 2 == 0
    uv[edge, 1] = offset[edge]
    x, normal = nets.points(patch, uv), nets.normals(patch, uv)
    d = rng.normal(size=(count, 3))
    d[~edge] = np.cross(normal, d)[~edge]
    x[~edge] += (offset[:, None] * normal)[~edge]
    o = x - rng.uniform(1, 3, (count, 1)) * d
    hits = first_hit(nets, o, d)
    eps = 6e-8
    changed = np.zeros(count, dtype=bool)

    def off(a: np.ndarray) -> np.ndarray:
        return a * (1 + eps * rng.uniform(-1, 1, a.shape))

    for _ in range(2):
        other = first_hit(BezierTriangles(off(nets.control_points)), off(o), off(d))
        changed |= np.isfinite(hits.t) != np.isfinite(other.t)
        far = np.abs(same(hits.t, other.t)) * np.linalg.norm(d, axis=1)
        both = np.isfinite(hits.t) & np.isfinite(other.t)
        # 20 eps of the scale across the surface: a different root, not the same one moved
        moved = 20 * eps * hits.margin.scale[both] / hits.margin.cosine[both]
        changed[both] |= far[both] > moved
    decidable = hits.margin.decidable(5 * eps)
    assert changed.sum() > 40
    assert not (changed & decidable).any()
    assert decidable.mean() > 0.7  # and the band is not too wide: the aim was to be in it
    # of ordinary rays next to none is lost
    random = first_hit(nets, *rays(rng, 4000))
    assert random.margin.decidable(5 * eps).mean() > 0.999


def test_quarter_plane_to_the_horizon() -> None:
    rng = np.random.default_rng(9)
    o = rng.normal(size=(4000, 3)) * 3
    d = rng.normal(size=(4000, 3)) * [1, 1, 10.0 ** -rng.integers(0, 6)]
    d[:, 2] *= 10.0 ** -rng.integers(0, 4, 4000)
    exact = analytic.plane((0, 0, 0), (0, 0, 1), o, d).first()
    x = o + np.where(np.isfinite(exact), exact, 0)[:, None] * d
    exact = np.where((x[:, :2] > 0).all(axis=1), exact, np.inf)
    hits = first_hit(QUARTER_PLANE, o, d)
    assert np.array_equal(np.isfinite(hits.t), np.isfinite(exact))
    far = np.isfinite(exact)
    assert exact[far].max() > 1e9
    np.testing.assert_allclose(hits.t[far], exact[far], rtol=1e-12)  # the condition is that of z/dz


def test_a_root_at_infinity_is_no_hit() -> None:
    roots = intersect_all(QUARTER_PLANE, [[0, 0, 1.0]], [[1.0, 1, 0]])
    assert roots.t.tolist() == [np.inf] and roots.inside.all() and roots.horizon[0] < 1e-15
    np.testing.assert_allclose(roots.uv, [[0.5, 0.5]], atol=1e-15)
    # where u + v is 1 only up to rounding, too
    angle = np.linspace(0.1, 1.4, 40)
    d = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    roots = intersect_all(QUARTER_PLANE, np.tile([0.1, -0.2, 1.0], (40, 1)), d)
    assert roots.inside.all() and (roots.t == np.inf).all() and len(roots.t) == 40
    hits = first_hit(QUARTER_PLANE, [[0, 0, 1.0]] * 3, [[1, 1, 0], [1, 1, -1e-9], [1, 1, 1e-9]])
    assert np.isfinite(hits.t).tolist() == [False, True, False]
    # rounding decides which of the three it is: the margin says so
    assert not hits.margin.decidable(1e-7).any()


def test_rays_in_the_surface_are_never_certain() -> None:
    triangle = BezierTriangles([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]])
    o, d = [[-1, 0.25, 0], [2, 2, 0]], [[1, 0, 0], [-1, -1, 0]]
    roots = intersect_all(triangle, o, d)
    assert set(roots.kind.tolist()) == {UNRESOLVED} and set(roots.ray.tolist()) == {0, 1}
    at = np.array(o)[roots.ray] + roots.t[:, None] * np.array(d)[roots.ray]
    assert (at[:, :2].min(axis=1) > -1e-6).all() and (at.sum(axis=1) < 1 + 1e-6).all()
    hits = first_hit(triangle, o, d)
    assert not hits.margin.certain.any()
    # one in the plane x = 0 that only passes by is certain, one just above is a near miss
    hits = first_hit(triangle, [[-1, 2, 0], [-1, 0.25, 1e-6]], [[1, 0, 0]] * 2)
    assert np.isinf(hits.t).all() and hits.margin.certain[1]
    # 1e-6 over M: distance 1.3 from the centre plus the size, 0.75
    np.testing.assert_allclose(hits.margin.graze[1], 1e-6 / 2, rtol=0.3)


def test_collapsed_corners() -> None:
    """Rays that pass the apex of a cone, and the ends of the sphere's lunes, at all distances."""
    rng = np.random.default_rng(10)
    ends = sphere(cover="tetrahedral")
    for nets, apex, exact in (
        (ends, ends.points(0, [[1, 0]])[0], lambda o, d: analytic.sphere((0, 0, 0), 1, o, d)),
        (shapes.cone(), np.array([0, 0, 1.0]), None),
    ):
        for distance in (1e-3, 1e-6, 0.0):
            u = rng.normal(size=(8, 3))
            u /= np.linalg.norm(u, axis=1)[:, None]
            side = np.cross(u, rng.normal(size=(8, 3)))
            side /= np.linalg.norm(side, axis=1)[:, None]
            o = apex + distance * side - 2 * u
            hits = first_hit(nets, o, u)
            if exact is not None:
                first = exact(o, u).first()
            else:
                double = analytic.cone(apex, (0, 0, 1), 1, o, u)
                z = o[:, 2:] + np.where(np.isfinite(double.t), double.t, 0) * u[:, 2:]
                first = np.where((z >= 0) & (z <= 1), double.t, np.inf).min(axis=1)
            if distance == 0:
                # the apex itself is hit, or what lies in front of it
                assert (hits.t < 2 + 1e-9).all()
            else:
                assert np.array_equal(np.isfinite(first), np.isfinite(hits.t))
                gap = np.abs(same(first, hits.t))
                assert gap.max() < 1e-9  # sqrt(eps) times the distance from the apex


def test_range_of_t() -> None:
    nets = sphere()
    o, d = [[0, 0.1, -3.0]], [[0.1, 0.15, 2.0]]
    both = intersect_all(nets, o, d).t
    assert len(both) == 2
    near, far = both
    assert first_hit(nets, o, d).t[0] == near
    assert first_hit(nets, o, d, tmin=near + 1e-6).t[0] == far
    assert first_hit(nets, o, d, tmin=near + 1e-6, tmax=far - 1e-6).t[0] == np.inf
    assert first_hit(nets, o, d, tmax=near).t[0] == near
    assert first_hit(nets, o, d, tmin=-far, tmax=0).t[0] == np.inf
    assert intersect_all(nets, o, d, tmin=near + 1e-6).t.tolist() == [far]
    margin = first_hit(nets, o, d, tmin=near + 1e-6).margin
    # 1e-6 of t is 2e-6 of length; the scale is that of the root in question, about 3.5
    np.testing.assert_allclose(margin.range, 2e-6 / 3.5, rtol=0.3)
    assert not margin.decidable(1e-6)[0] and margin.decidable(1e-7, boundary=False)[0]
    # nobody looked for near misses in a band of 1e-4
    assert not first_hit(nets, o, d).margin.decidable(1e-4)[0]
    assert first_hit(nets, o, d, band=1e-4).margin.decidable(1e-4)[0]


def test_offset_and_length_of_the_direction_do_not_matter() -> None:
    rng = np.random.default_rng(11)
    nets = wavy(rng, 4)
    o, d = rays(rng, 300)
    plain = first_hit(nets, o, d)
    move = np.eye(4)
    move[:3, 3] = 1e4 * np.array([1, -1, 1])
    moved = first_hit(nets.transform(move), o + move[:3, 3], 8 * d)
    # rounding of 1e4 is 2e-12; graze and edges of 300 random rays are larger
    assert np.array_equal(plain.patch, moved.patch)
    np.testing.assert_allclose(same(8 * moved.t, plain.t), 0, atol=1e-8)
    # a power of two is exact in every step of the solution but the length
    scaled = first_hit(nets, o, 8 * d)
    np.testing.assert_allclose(same(8 * scaled.t, plain.t), 0, atol=1e-14)


def test_from_afar_less_is_decided() -> None:
    rng = np.random.default_rng(12)
    o, d = rays(rng, 1000, distance=1e4)
    exact = analytic.sphere((0, 0, 0), 1, o, d)
    hits = first_hit(sphere(), o, d)
    clear = np.abs(exact.clearance) > 1e-10  # rounding of 1e4 is 2e-12
    assert np.array_equal(np.isfinite(hits.t)[clear], np.isfinite(exact.first())[clear])
    # a hundredth of the patch's size of some 0.8, or more, over 1e4; rays far off keep the band
    near = exact.clearance < 0
    assert (hits.margin.resolved[near] > 5e-7).all() and (hits.margin.resolved[near] < 2e-6).all()
    # 3e-7 of 1e4 moves the line by 3e-3 of the radius: about the share of rays left out
    assert 0.9 < hits.margin.decidable(3e-7, boundary=False).mean() < 0.999


def test_edge_margin_of_hits_and_of_misses() -> None:
    triangle = BezierTriangles([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]])
    x = np.array([[0.3, 0.002, 0], [0.3, -0.002, 0], [0.3, 0.3, 0], [0.3, -0.2, 0]])
    hits = first_hit(triangle, x + np.array([0, 0, 2]), np.tile([0, 0, -1.0], (4, 1)))
    assert np.isfinite(hits.t).tolist() == [True, False, True, False]
    np.testing.assert_allclose(hits.margin.edge, [0.002, 0.002, 0.3, np.inf], rtol=1e-12)
    # a shift by 0.002 against M: the distance from the centre (2.0 or so) plus size 0.75
    np.testing.assert_allclose(hits.margin.edge_shift[:2], 0.002 / 2.7, rtol=0.1)
    assert hits.margin.decidable(1e-7, edge=0.001).all()
    assert hits.margin.decidable(1e-7, edge=0.01).tolist() == [False, False, True, True]
    # an occluder behind the hit does not count
    two = BezierTriangles.join([triangle, triangle.transform(np.diag([1, 1, 1, 0.5]))])
    behind = first_hit(two, [[0.7, 0.1, 1.0]], [[0.0, 0, -1]])
    assert np.isfinite(behind.margin.edge[0])


def test_rays_without_any_patch_nearby() -> None:
    hits = first_hit(sphere(), [[5.0, 5, 5]] * 2, [[1.0, 0, 0]] * 2)
    assert np.isinf(hits.t).all() and (hits.patch == -1).all() and (hits.uv == 0).all()
    assert hits.margin.decidable(1e-5).all() and np.isinf(hits.margin.edge).all()
    none = intersect_all(sphere(), np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(none.t) == 0


def test_errors_name_the_parameter() -> None:
    nets = sphere()
    for o, d, message in (
        ([[0, 0]], [[0, 0, 1]], "origins: expected finite numbers of shape"),
        ([[0, 0, np.nan]], [[0, 0, 1]], "origins: expected .* got NaN or infinity"),
        ([[0, 0, 0]], [[0, np.inf, 1]], "directions: expected"),
        ([[0, 0, 0]], [[0, 0, 0]], "directions: expected vectors that are not zero"),
        ([[0, 0, 0]] * 2, [[0, 0, 1]], "directions: expected the shape of origins"),
    ):
        with pytest.raises(GeometryError, match=message):
            first_hit(nets, o, d)
        with pytest.raises(GeometryError, match=message):
            intersect_all(nets, o, d)
