"""The Dr.Jit kernels by themselves: evaluation, packets, and rays on nets of any degree."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from backend_cases import ad, plain

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.kernels import arrays, curvature, net, patch
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafKind, LeafSettings

FLOATS = {
    "float32": ad.Float,
    "float64": ad.Float64,
    "float32 without derivatives": plain.Float,
    "float64 without derivatives": plain.Float64,
}
#: Half a unit in the last place.
ROUNDING = {"float32": 6e-8, "float64": 1.2e-16}


@pytest.fixture(params=FLOATS)
def float_type(request) -> Any:
    return FLOATS[request.param]


@pytest.fixture(params=["float32", "float64"])
def ad_type(request) -> Any:
    return FLOATS[request.param]


def rounding_of(float_type: Any) -> float:
    return ROUNDING["float64" if dr.type_v(float_type) == dr.VarType.Float64 else "float32"]


def random_nets(n: int, count: int, seed: int, weights: tuple = (0.4, 2.5)) -> mb.BezierTriangles:
    """Return wavy patches over the unit triangle, with random weights."""
    rng = np.random.default_rng(seed)
    uv = bernstein.multi_indices(n)[:, :2] / n
    points = np.concatenate([uv, np.zeros((len(uv), 1))], axis=1)
    points = points + rng.normal(scale=0.25 / n, size=(count, *points.shape))
    w = rng.uniform(*weights, size=(*points.shape[:2], 1))
    return mb.BezierTriangles(np.concatenate([points * w, w], axis=-1))


def inner_points(count: int, seed: int) -> np.ndarray:
    """Return parameters, evenly spread over the triangle."""
    uv = np.random.default_rng(seed).random((count, 2))
    return np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)


# ---------------------------------------------------------------- arrays


def test_types_follow_the_argument(float_type):
    ty = arrays.types_of(float_type)
    assert ty is arrays.types_of(float_type([1, 2]))
    assert ty.Float is dr.detached_t(float_type)
    assert dr.type_v(ty.Float64) == dr.VarType.Float64
    assert dr.type_v(ty.Float32) == dr.VarType.Float32
    assert dr.type_v(ty.UInt) == dr.VarType.UInt32


@pytest.mark.parametrize("count", [1, 3, 8, 9, 16, 21])
def test_packets(float_type, count):
    rng = np.random.default_rng(0)
    width = -(-count // 8) * 8
    values = rng.normal(size=(50, width)).astype(np.float32)
    index = rng.integers(0, 50, 200)
    ty = arrays.types_of(float_type)
    buffer = arrays.upload(float_type, values)
    got = arrays.gather_packets(buffer, ty.UInt(index), count)
    assert len(got) == count
    for c in range(count):
        assert np.array_equal(np.array(got[c]), values[index, c])
    # an inactive lane gets zeros and reads nothing
    active = ty.Bool(index < 25)
    index = np.where(index < 25, index, 1_000_000)
    got = arrays.gather_packets(buffer, ty.UInt(index), count, active)
    expected = np.where(index < 25, values[np.minimum(index, 49), 0], 0)
    assert np.array_equal(np.array(got[0]), expected)


# ---------------------------------------------------------------- evaluation


@pytest.mark.parametrize("n", range(1, 9))
def test_patch_evaluation(ad_type, n):
    float_type = ad_type
    patches = random_nets(n, 5, seed=n)
    uv = inner_points(300, seed=n)
    which = np.arange(300) % 5
    buffer = arrays.upload(float_type, patch.pack(patches.control_points))
    ty = arrays.types_of(float_type)
    value, d_du, d_dv = curvature.evaluate_second(
        buffer, n, ty.UInt(which), float_type(uv[:, 0]), float_type(uv[:, 1])
    )[:3]
    eps = rounding_of(float_type)
    size = np.abs(patches.control_points).max()
    # convex combinations of 45 terms at most, products of n factors: roundings add up to n + 4,
    # times the n of the derivative of differences
    factors = (1, 2 * n, 2 * n)
    for got, exact, factor in zip((value, d_du, d_dv), patches.partials(which, uv), factors):
        error = np.abs(np.array(got).reshape(4, -1).T - exact).max()
        assert error <= 2 * (n + 4) * eps * size * factor, error / (eps * size * factor)
    p, pu, pv = patch.affine_partials(value, d_du, d_dv)
    exact = patches.differential(which, uv)
    for got, truth in ((p, exact.p), (pu, exact.dp_du), (pv, exact.dp_dv)):
        error = np.abs(np.array(got).reshape(3, -1).T - truth).max()
        # divided by weights down to 0.4, once for the point and twice for the partials
        assert error <= 40 * (n + 4) * n * eps * size


@pytest.mark.parametrize("n", range(1, 9))
def test_horner(ad_type, n):
    float_type = ad_type
    rng = np.random.default_rng(n)
    coefficients = rng.normal(size=(bernstein.size(n), 3))
    uv = inner_points(200, seed=n)
    u, v = float_type(uv[:, 0]), float_type(uv[:, 1])
    lists = [float_type(float(c)) for c in coefficients.ravel()]
    value, d_du, d_dv = net.horner(lists, n, u, v)

    i, j = bernstein.multi_indices(n)[:, :2].T
    x, y = uv[:, :1], uv[:, 1:]
    terms = (
        x**i * y**j,
        i * x ** np.maximum(i - 1, 0) * y**j,
        j * x**i * y ** np.maximum(j - 1, 0),
    )
    eps = rounding_of(float_type)
    for got, basis in zip((value, d_du, d_dv), terms):
        got = np.array(got).reshape(3, -1).T
        # twice n fused steps, each a rounding of the sum of absolute values at most
        bound = 2 * (n + 1) * eps * (basis @ np.abs(coefficients)) + 1e-300
        assert (np.abs(got - basis @ coefficients) <= bound).all()


def test_horner_on_the_monomials_of_a_net():
    patches = random_nets(4, 1, seed=3)
    monomial = bernstein.monomial_matrix(4) @ patches.control_points[0]
    uv = inner_points(50, seed=4)
    value, d_du, d_dv = net.horner(
        [ad.Float64(float(c)) for c in monomial.ravel()],
        4,
        ad.Float64(uv[:, 0]),
        ad.Float64(uv[:, 1]),
    )
    for got, exact in zip((value, d_du, d_dv), patches.partials(0, uv)):
        # the change of basis has entries up to 24, cancelled by others
        assert np.abs(np.array(got).reshape(4, -1).T - exact).max() < 1e-13


# ---------------------------------------------------------------- rays on any net


def rays_through(patches: mb.BezierTriangles, count: int, seed: int) -> tuple[np.ndarray, ...]:
    """Return rays from random places through random points of the surface, met at t = 1.

    Rays at less than a third of a degree are left out: a rounding of their direction may lift
    them off the surface.
    """
    rng = np.random.default_rng(seed)
    which, uv = rng.integers(0, len(patches), count), inner_points(count, seed)
    target = patches.points(which, uv)
    size = np.ptp(target, axis=0).max()
    o = (target + rng.normal(scale=size, size=target.shape)).astype(np.float32)
    d = (target - o).astype(np.float32)
    cosine = np.einsum("ni,ni->n", patches.normals(which, uv), d) / np.linalg.norm(d, axis=1)
    steep = np.abs(cosine) > 5e-3
    return o[steep], d[steep]


def check_hits(
    patches: mb.BezierTriangles, float_type: Any, seed: int, settings: LeafSettings | None = None
) -> Any:
    """Check hits without an oracle: none that is known is missed, and each is on its ray."""
    o, d = rays_through(patches, 2000, seed)
    structure = build_structure(build_leaves(patches, settings), float_type)
    columns = [[float_type(np.ascontiguousarray(a[:, c])) for c in range(3)] for a in (o, d)]
    hit = intersect(structure, *columns, dr.full(float_type, np.inf, len(o)))
    t, u, v = (np.array(a).astype(np.float64) for a in (hit.t, hit.u, hit.v))
    # the surface may be met before the point aimed at, never only behind it
    late = ~(t < 1 + 1e-4)
    assert not late.any(), f"{late.sum()} missed, first {o[late][0]}, {d[late][0]}"
    assert np.array(hit.valid).all() and t.min() > 0
    assert min(u.min(), v.min(), (1 - u - v).min()) > -5e-3
    p = patches.points(np.array(hit.patch), np.stack([u, v], axis=1))
    size = np.abs(o).max() + np.linalg.norm(d, axis=1)
    off = (np.linalg.norm(o + t[:, None] * d - p, axis=1) / size).max()
    check_any_hit(structure, float_type, columns, t)
    return off, structure


def check_any_hit(structure: Any, float_type: Any, columns: Any, t: np.ndarray) -> None:
    """Check that any hit agrees: there is one, and none before the nearest."""
    for end, expected in ((np.inf, True), (t * (1 + 1e-4), True), (t * (1 - 1e-4), False)):
        limit = float_type(np.broadcast_to(end, t.shape).copy())
        blocked = intersect(structure, *columns, limit, any_hit=True)
        assert (np.array(blocked.valid) == expected).all()


@pytest.mark.parametrize(
    ("n", "kind"), [*((n, "float32") for n in range(1, 9)), (1, "float64"), (3, "float64")]
)
def test_rays_through_points_of_a_net(n, kind):
    patches = random_nets(n, 3, seed=10 + n)
    off, structure = check_hits(patches, FLOATS[kind], n)
    # float32: two roundings of a coordinate; float64: the nets of leaves are stored in float32,
    # as differences from the unit triangle, a tenth of the size of a leaf
    assert off < (2e-7 if kind == "float32" else 2e-8)
    assert structure.kinds == {LeafKind.LINEAR if n == 1 else LeafKind.GRAPH_AFFINE}


@pytest.mark.parametrize("n", [2, 3, 6])
@pytest.mark.parametrize("weight", [1.0, 3.0])
def test_polynomial_nets_store_no_weights(n, weight):
    patches = random_nets(n, 3, seed=50 + n, weights=(1.0, 1.0))
    patches = mb.BezierTriangles(weight * patches.control_points)
    off, structure = check_hits(patches, ad.Float, n)
    assert off < 2e-7  # as above
    assert [bucket.components for bucket in structure.nets] == [3]


@pytest.mark.parametrize("n", [2, 3, 5])
def test_grazing_rays(n):
    # at half a degree to six degrees the march has to creep along the surface, and a bound that
    # is too bold jumps over both meetings
    patches = random_nets(n, 3, seed=30 + n)
    rng = np.random.default_rng(n)
    count = 50_000
    which, uv = rng.integers(0, 3, count), inner_points(count, n)
    target, normal = patches.points(which, uv), patches.normals(which, uv)
    along = np.cross(normal, rng.normal(size=(count, 3)))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    slope = rng.choice([-1, 1], count) * rng.uniform(0.008, 0.06, count)
    d = (along + slope[:, None] * normal).astype(np.float32)
    o = (target - d * rng.uniform(0.5, 2, (count, 1))).astype(np.float32)
    d = (target - o).astype(np.float32)
    structure = build_structure(build_leaves(patches), ad.Float)
    columns = [[ad.Float(np.ascontiguousarray(a[:, c])) for c in range(3)] for a in (o, d)]
    hit = intersect(structure, *columns, dr.full(ad.Float, np.inf, count))
    t = np.array(hit.t).astype(np.float64)
    # 1e-3: a rounding of the direction is felt a hundredfold at this slant
    late = ~(t < 1 + 1e-3)
    assert not late.any(), f"{late.sum()} missed, first {o[late][0]}, {d[late][0]}"


#: Rays that were missed once: where the march forgot the slope's error, or gave up too early.
#: Degree and seed of the net, origin, direction; each meets its net at t = 1.
MISSED = [
    (2, 40, [-0.9678848, 2.448512, -0.21915801], [1.7228041, -2.2239385, 0.19757396]),
    (4, 26, [-0.35495013, 2.1338065, 0.7283852], [0.43461105, -1.7769591, -0.67953587]),
    (6, 35, [0.26957524, 0.34574288, 0.017278817], [-0.0483027, 0.40323603, 0.013059531]),
    (8, 28, [1.7064887, 1.6273876, 0.07075968], [-1.1228011, -1.375615, -0.069507286]),
    (8, 24, [-1.4638399, 0.06921322, 0.13408363], [1.4785354, 0.086522125, -0.12944534]),
]


@pytest.mark.parametrize(("n", "seed", "o", "d"), MISSED)
def test_rays_that_were_missed(n, seed, o, d):
    structure = build_structure(build_leaves(random_nets(n, 3, seed=seed)), ad.Float)
    hit = intersect(structure, [ad.Float(x) for x in o], [ad.Float(x) for x in d], ad.Float(np.inf))
    assert hit.t[0] == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("kind", FLOATS)
def test_quadrics_in_closed_form(kind):
    patches = mb.sphere(cover="tetrahedral").transform(np.diag([1.0, 2.0, 0.5, 1]))
    off, structure = check_hits(patches, FLOATS[kind], 1)
    assert structure.graph_count == 0 and structure.leaf_count == len(patches)
    assert off < (3e-7 if "float32" in kind else 1e-13)


def test_roots_of_quadrics_are_as_exact_as_float32_can_tell():
    rng = np.random.default_rng(21)
    o, d = rng.uniform(-0.4, 0.4, (20000, 3)).astype(np.float32), rng.normal(size=(20000, 3))
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    columns = [[plain.Float(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in (o, d)]
    structure = build_structure(build_leaves(mb.sphere(cover="tetrahedral")), plain.Float)
    t = np.array(intersect(structure, *columns, plain.Float(np.inf)).t, dtype=np.float64)
    o, d = o.astype(float), d.astype(float)
    b, q = np.einsum("ni,ni->n", o, d), np.einsum("ni,ni->n", d, d)
    exact = (-b + np.sqrt(b * b - q * (np.einsum("ni,ni->n", o, o) - 1))) / q
    # half a unit in the last place; a hundredth more for what the fitted quadric is off
    assert (np.abs(t - exact) <= 0.51 * np.spacing(exact.astype(np.float32))).all()


@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_octants_through_their_quadric(kind):
    patches = mb.sphere(cover="octants").transform(np.diag([1.0, 2.0, 0.5, 1]))
    # a bent patch of degree 5 beside: then the nets of octants are padded
    both = mb.BezierTriangles.join([patches.elevate(1), random_nets(5, 1, seed=5)])
    off, structure = check_hits(patches, FLOATS[kind], 1)
    assert structure.has(LeafKind.PLANE_SECTIONS) and structure.graph_count == 0
    # the parameters come from nets in float32, by an iteration
    assert off < (3e-7 if kind == "float32" else 1e-7)
    off, structure = check_hits(both, FLOATS[kind], 2)
    assert structure.kinds == {LeafKind.PLANE_SECTIONS, LeafKind.GRAPH_AFFINE}
    assert off < (3e-7 if kind == "float32" else 1e-7)


def test_quadrics_as_graph_leaves():
    patches = mb.sphere(cover="tetrahedral").transform(np.diag([1.0, 2.0, 0.5, 1]))
    off, structure = check_hits(patches, ad.Float, 1, LeafSettings(closed_form=False))
    assert not structure.has_groups
    assert off < 3e-7


def test_both_kinds_of_leaves_in_one_structure():
    ball = mb.sphere(cover="tetrahedral")
    wavy = random_nets(2, 4, seed=5).transform(np.diag([2.0, 2, 2, 1]))
    both = mb.BezierTriangles(np.concatenate([ball.control_points, wavy.control_points]))
    off, structure = check_hits(both, ad.Float, 2)
    assert structure.kinds == {LeafKind.LINEAR, LeafKind.GRAPH_AFFINE}
    assert off < 3e-7


@pytest.mark.parametrize(
    ("name", "weights"),
    [
        ("large ratios", (1e-3, 1.0)),
        ("all negative", (-2.0, -0.5)),
        ("zero at a corner", (0.5, 2.0)),
        ("both signs", (0.5, 2.0)),
    ],
)
def test_unusual_weights(name, weights):
    net = random_nets(3, 3, seed=6, weights=weights).control_points.copy()
    if name == "zero at a corner":
        net[:, 0, 3] = 0.0  # the patch runs to infinity
    if name == "both signs":
        net[:, 0, 3] *= -1.0  # through infinity, and back from the other side
    patches = mb.BezierTriangles(net)
    # rays through the part within reach
    uv = inner_points(6000, 7)
    which = np.arange(6000) % 3
    target = patches.points(which, uv)
    near = np.linalg.norm(target, axis=1) < 20
    which, uv, target = which[near], uv[near], target[near]
    assert near.mean() > 0.5
    rng = np.random.default_rng(8)
    o = (target + rng.normal(size=target.shape)).astype(np.float32)
    d = (target - o).astype(np.float32)
    cosine = np.einsum("ni,ni->n", patches.normals(which, uv), d) / np.linalg.norm(d, axis=1)
    steep = np.abs(cosine) > 5e-3
    o, d = o[steep], d[steep]
    structure = build_structure(build_leaves(patches), ad.Float)
    columns = [[ad.Float(np.ascontiguousarray(a[:, c])) for c in range(3)] for a in (o, d)]
    hit = intersect(structure, *columns, dr.full(ad.Float, np.inf, len(o)))
    t = np.array(hit.t).astype(np.float64)
    late = ~(t < 1 + 1e-3)
    assert not late.any(), f"{late.sum()} of {len(t)} missed, first {o[late][0]}, {d[late][0]}"
    check_any_hit(structure, ad.Float, columns, t)
    p = patches.points(np.array(hit.patch), np.stack([np.array(hit.u), np.array(hit.v)], axis=1))
    # (u, v) are float32: near infinity a rounding of them is a long way
    on = np.linalg.norm(p, axis=1) < 20
    off = np.linalg.norm(o + t[:, None] * d - p, axis=1)[on]
    assert np.quantile(off, 0.99) < 1e-4


def test_kernels_do_not_depend_on_the_patches():
    # one compilation for all nets of a kind: nothing of a structure is a literal
    ray = [[ad.Float([0.2, 0.3]), ad.Float([0.3, 0.2]), ad.Float([5.0, 5.0])]]
    ray.append([ad.Float([0.0, 0.01]), ad.Float([0.0, 0.02]), ad.Float([-1.0, -1.0])])
    used = []
    for seed in range(3):
        patches = random_nets(3, 2 + seed, seed=20 + seed)
        structure = build_structure(build_leaves(patches), ad.Float)
        dr.eval(structure.nodes, *ray[0], *ray[1])
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            hit = intersect(structure, *ray, ad.Float([np.inf, np.inf]))
            dr.eval(*hit)
            dr.sync_thread()
            kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
        used.append([k["hash"] for k in kernels])
    assert len(used[0]) == 1 and used[1] == used[0] and used[2] == used[0]
