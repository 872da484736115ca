"""Patches of any degree on any quadric in closed form, against the float64 reference."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from backend_cases import Float
from geometry_cases import rotation
from leaf_cases import (
    HIGH,
    IMAGE,
    LOW,
    MOVE,
    SPHERE,
    assert_found_among_others,
    assert_hits_are_those_of_the_reference,
    moved,
    otherwise,
    rays,
    rays_to_edges,
    revolution,
    single,
    traced,
    turned,
)

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein, shapes
from mitsuba_bezier.geometry.tensor import revolved, tensor_to_triangles
from mitsuba_bezier.kernels import quadric_records
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.leaves.builder import build_leaves, rebuild_leaves
from mitsuba_bezier.leaves.closed_form import inverted as inverted_leaves
from mitsuba_bezier.leaves.closed_form import newton as plane_inverse
from mitsuba_bezier.leaves.records import INVERTED_KINDS, LeafKind, LeafSettings
from mitsuba_bezier.oracles.reference import first_hit


def twisted() -> mb.BezierTriangles:
    """Return a hyperboloid of one sheet, ruled by lines between two circles."""
    low, high = (revolved([(1, z, 1), (1, z, 1)])[:, :, :1] for z in (-1, 1))
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]]
    return tensor_to_triangles(np.concatenate([low, high @ turn.T], axis=2))


CYLINDER = revolution([(1, -1, 1), (1, 1, 1)])
CONE = revolution([(1, 0, 1), (0, 1, 1)])
SURFACES = {
    "cylinder": CYLINDER,
    "frustum": revolution([(1, -1, 1), (0.4, 1, 1)]),
    "cone": CONE,
    "sphere": SPHERE,
    "sphere, three segments": revolution(LOW, HIGH, segments=3),
    "paraboloid": revolution([(0, 0, 1), (0.5, 0, 1), (1, 1, 1)]),
    "hyperboloid": twisted(),
    "ring": revolution([(0.4, 0, 1), (1, 0, 1)]),
    "disk": revolution([(0, 0, 1), (1, 0, 1)]),
    "moved": moved(SPHERE),
    "image": SPHERE.transform(IMAGE),
    "negative weights": mb.BezierTriangles(-CONE.control_points),
    "elevated": CYLINDER.elevate(2),
    "corners": turned(CONE, (1, 2, 0)),
    "corners, mirrored": turned(SPHERE, (1, 0, 2)),
    "cylinder, degree 4": otherwise(shapes.cylinder()),
    "saddle, degree 4": otherwise(shapes.hyperbolic_paraboloid()),
    "lunes, degree 4": otherwise(mb.sphere(cover="lunes")),
    **{
        f"{name} as tensors are": single(patches)
        for name, patches in (
            ("sphere", SPHERE),
            ("cylinder", CYLINDER),
            ("cone", CONE),
            ("disk", revolution([(0, 0, 1), (1, 0, 1)])),
        )
    },
}


@pytest.mark.parametrize("patches", SURFACES.values(), ids=SURFACES.keys())
def test_hits(patches):
    leaves = build_leaves(patches)
    assert leaves.kinds <= INVERTED_KINDS and len(leaves) == len(patches)
    # a point in the tolerance of an edge may belong to the neighbour; 3 of 1000 rays aim there
    assert_hits_are_those_of_the_reference(patches, leaves, others=3e-3)


def test_one_quadric_is_one_group():
    for patches in (SPHERE, single(SPHERE), CYLINDER, CONE):
        assert len(np.unique(build_leaves(patches).closed_form.group)) == 1
    assert (
        len(np.unique(build_leaves(mb.BezierTriangles.join([CYLINDER, CONE])).closed_form.group))
        == 2
    )
    # a table has bits for sixteen
    groups = np.bincount(build_leaves(revolution(LOW, HIGH, segments=8)).closed_form.group)
    assert groups.tolist() == [16, 16]


@pytest.mark.parametrize("rounded", [False, True], ids=["float64", "float32"])
@pytest.mark.parametrize("name", ["sphere", "cone", "disk"])
def test_next_to_a_pole(name, rounded):
    # 10^-7 to 1 from where edges collapse: nothing is lost there, and what is near is exact
    patches = {"sphere": SPHERE, "cone": CONE, "disk": SURFACES["disk"]}[name]
    pole = np.array([0, 0, 0.0 if name == "disk" else 1.0])
    rng = np.random.default_rng(2)
    r, turn = 10 ** rng.uniform(-7, -0.3, 20_000), rng.random(20_000) * 2 * np.pi
    z = {"sphere": np.sqrt(1 - r * r), "cone": 1 - r, "disk": 0 * r}[name]
    target = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    o = pole + [0, 0, 2] + 0.7 * rng.uniform(-1, 1, size=target.shape)
    if rounded:
        matrix = np.eye(4)
        matrix[:3, :3] = rotation(rng, 3)
        matrix[:3, 3] = [0.3, -0.5, 0.8]
        patches = patches.transform(matrix)
        patches = mb.BezierTriangles(patches.control_points.astype(np.float32))
        o, target = (x @ matrix[:3, :3].T + matrix[:3, 3] for x in (o, target))
    o = o.astype(np.float32)
    d = (target - o).astype(np.float32)
    leaves = build_leaves(patches)
    assert leaves.kinds <= INVERTED_KINDS
    hit = traced(leaves, o, d)
    assert np.array(hit.valid).all()
    t = np.array(hit.t, dtype=float)
    # all are met at t = 1; rounding of d, and 6e-8 of a float32 net, over the cosine. The tip of
    # the cone's other nappe belongs to the patch, as a tolerance of edges
    assert np.abs(t - 1)[r > 1e-5].max() < 2e-6 and np.abs(t - 1).max() < 1e-5
    # parameters are those of the point; next to the pole another patch may be met, mirrored
    uv = np.stack([np.array(hit.u), np.array(hit.v)], axis=1).astype(float)
    off = np.linalg.norm(patches.points(np.array(hit.patch), uv) - (o + t[:, None] * d), axis=1)
    assert off[r > 1e-5].max() < 3e-6 and off.max() < 1e-5


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_one_patch_alone_has_all_of_its_corners(order):
    # no neighbour has what is missed
    rng = np.random.default_rng(6)
    patches = mb.BezierTriangles.join([SPHERE[np.arange(2)], CONE[np.arange(2)].elevate()])
    patches = turned(patches, order)
    for k in range(4):
        patch = patches[np.array([k])]
        leaves = build_leaves(patch)
        assert leaves.kinds <= INVERTED_KINDS
        near, share, zero = (
            10 ** rng.uniform(-6, -1, 900),
            rng.random(900),
            np.zeros(900, dtype=int),
        )
        inner = np.stack([1 - near, near * share, near * (1 - share)], axis=1)
        uv = inner[np.arange(900)[:, None], (np.arange(3) + np.arange(900)[:, None]) % 3][:, :2]
        target = patch.points(zero, uv)
        o = target + 0.5 * patch.normals(zero, uv) + 0.1 * rng.normal(size=target.shape)
        o = o.astype(np.float32)
        hit = traced(leaves, o, (target - o).astype(np.float32))
        # some of those are on the edge to a rounding
        assert (np.abs(np.array(hit.t) - 1) < 1e-5).mean() > 0.995


@pytest.mark.parametrize("rounded", [False, True], ids=["float64", "float32"])
@pytest.mark.parametrize("name", ["sphere", "cylinder", "cone"])
def test_nothing_leaks(name, rounded):
    disk = [(0, 0, 1), (1, 0, 1)]
    patches = {
        "sphere": SPHERE,
        "cylinder": revolution(disk, [(1, 0, 1), (1, 1, 1)], [(1, 1, 1), (0, 1, 1)]),
        "cone": revolution(disk, [(1, 0, 1), (0, 1, 1)]),
    }[name]
    radius = {"sphere": lambda z: np.sqrt(1 - z * z), "cylinder": np.ones_like}
    o, target = rays_to_edges(patches, radius.get(name, lambda z: 1 - z), corners=True)
    if rounded:
        patches = single(patches)
        o, target = (x @ MOVE[:3, :3].T + MOVE[:3, 3] for x in (o, target))
    o, d = o.astype(np.float32), (target - o).astype(np.float32)
    leaves = build_leaves(patches)
    assert leaves.kinds <= INVERTED_KINDS
    assert np.array(traced(leaves, o, d).valid).all()
    assert np.array(traced(leaves, o, d, any_hit=True).valid).all()


def test_cells_tell_all_members_that_have_a_point():
    patches = mb.BezierTriangles.join([single(SPHERE), CONE.transform(IMAGE)])
    leaves = build_leaves(patches)
    assert leaves.kinds <= INVERTED_KINDS
    structure = build_structure(leaves, Float)
    tables = np.array(structure.cells).reshape(-1, quadric_records.CELLS.size)
    groups = np.array(structure.groups).reshape(-1, quadric_records.GROUP.size)
    assert len(tables) == (groups[:, 14] >= 32).sum() >= 2
    # members are as the leaves are: sorted by group
    uv = np.random.default_rng(5).dirichlet(np.ones(3), 3000)[:, :2]
    members = []
    leaves = leaves.closed_form
    for leaf, group in enumerate(leaves.group):
        first, number = int(groups[group, 13]), int(groups[group, 14])
        number, count = number // 32, number % 32
        if not number:
            continue
        table = tables[number - 1]
        inner = np.column_stack([uv, 1 - uv.sum(axis=1)]) @ leaves.domain[leaf].T
        inner /= inner.sum(axis=1, keepdims=True)  # of the patch, if the leaf is a part of it
        at = patches.points(np.full(3000, leaves.patch[leaf]), inner[:, :2]) - leaves.shift[leaf]
        cell = np.floor(at * table[:3] + 4).astype(int)
        assert (cell >= 0).all() and (cell < 8).all()
        index = cell @ [1, 8, 64]
        words = table[8:].view(np.uint32)[index // 2] >> (16 * (index % 2)).astype(np.uint32)
        assert ((words >> np.uint32(leaf - first)) & 1).all()
        assert (words & 0xFFFF < 1 << count).all()
        members.append(np.mean([bin(w & 0xFFFF).count("1") for w in words.tolist()]))
    # or they would be no help: there are 16 and 8
    assert np.mean(members) < 5


def test_what_reaches_too_far_is_cut(monkeypatch):
    # nearer to the tangent plane of the centre of projection than is allowed here
    monkeypatch.setattr(inverted_leaves, "_LEAST", 0.8)
    patches = revolution([(1, -1, 1), (1, 1, 1)], segments=3)
    leaves = build_leaves(patches)
    assert leaves.kinds <= INVERTED_KINDS and len(leaves) > len(patches)
    area = np.abs(np.linalg.det(leaves.domain / leaves.domain.sum(axis=1, keepdims=True)))
    np.testing.assert_allclose(np.bincount(leaves.patch, area), 1.0, atol=1e-12)
    assert_hits_are_those_of_the_reference(patches, leaves, others=3e-3)
    # and if Newton's method does not find it, it is left to others
    monkeypatch.setattr(plane_inverse, "_STEPS", 1)
    assert not build_leaves(patches).is_closed_form.any()


def test_what_lies_on_no_quadric_is_left_to_others():
    for patches in (SPHERE, CONE, SURFACES["disk"], SURFACES["saddle, degree 4"]):
        net = patches.control_points.copy()
        # two points: with one, the disk's patch is on a quadric that is flat, to 2e-8 of its height
        net[0, [1, 4], :3] += 1e-5 * np.array([[1, 2, 3], [3, -2, -1]])
        leaves = build_leaves(mb.BezierTriangles(net))
        assert not leaves.is_closed_form[leaves.patch == 0].any()
        assert leaves.is_closed_form[leaves.patch == 1].all()
    # a quadric, and weights of both signs
    net = CYLINDER.control_points.copy()
    net[0] *= np.where(bernstein.multi_indices(3)[:, :1] % 2, -1, 1)
    leaves = build_leaves(mb.BezierTriangles(net))
    assert not leaves.is_one_of(INVERTED_KINDS)[leaves.patch == 0].any()
    # folded: planar, but no map that can be inverted
    points = [[0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0, 1, 0], [2, 2, 0], [0, 0.1, 0]]
    folded = mb.BezierTriangles([[[*p, 1] for p in points]])
    assert not build_leaves(folded).is_closed_form.any()
    assert not build_leaves(mb.torus()).is_closed_form.any()
    assert not build_leaves(SPHERE, LeafSettings(closed_form=False)).is_closed_form.any()


def test_among_others():
    # with sections, sectors, what has a linear inverse and what has none, under one tree
    parts = [
        SPHERE,
        mb.sphere(center=(30, 0, 0)),
        mb.sphere(center=(-30, 0, 0), cover="tetrahedral"),
        mb.torus(center=(0, 40, 0)),
        shapes.cone(center=(0, -30, 0), capped=True),
        CONE.transform(np.eye(4) + 40 * np.eye(4)[2][:, None] * np.eye(4)[3]),
    ]
    # a point in the tolerance of an edge may belong to the neighbour
    structure = assert_found_among_others(parts, others=3e-3)
    assert structure.has(*INVERTED_KINDS) and structure.has(LeafKind.PLANE_SECTIONS)


def test_one_group_of_two_kinds():
    tetrahedral = mb.sphere(cover="tetrahedral").elevate(2)
    patches = mb.BezierTriangles.join([tetrahedral[:4], SPHERE[8:16]])
    leaves = build_leaves(patches)
    assert leaves.is_closed_form.all() and leaves.is_one_of(INVERTED_KINDS).sum() == 8
    o, d = rays(patches, 4000)
    expected = first_hit(patches, o, d)
    judged = expected.margin.decidable(6e-7) & ~(expected.margin.cosine < 0.01)
    hit = traced(leaves, o, d)
    assert (np.array(hit.valid) == np.isfinite(expected.t))[judged].all()
    both = np.array(hit.valid) & judged
    off = np.abs(np.array(hit.t, dtype=float)[both] / expected.t[both] - 1)
    assert (off * expected.margin.cosine[both]).max() < 3e-7 and both.mean() > 0.3


def test_sets_of_mixed_degrees_are_inverted_at_their_own():
    # in float32, and elevated as they are beside a patch of degree 9
    patches = mb.BezierTriangles.join([single(CYLINDER), single(SPHERE)]).elevate(4)
    patches = mb.BezierTriangles(patches.control_points.astype(np.float32)).elevate(1)
    assert patches.degree == 9
    leaves = build_leaves(patches)
    assert leaves.kinds <= INVERTED_KINDS
    nets = leaves.closed_form.polynomials  # of the highest degree among them
    powers = bernstein.multi_indices(bernstein.degree_of(nets.shape[1]))[:, :2].sum(axis=1)
    used = [powers[net.any(axis=1)].max() for net in nets]
    assert used == np.where(leaves.patch < 8, 3, 4).tolist()
    assert_hits_are_those_of_the_reference(patches, leaves, others=3e-3)
    # sixteen would be too much for a kernel
    assert not build_leaves(otherwise(otherwise(SPHERE))).is_closed_form.any()


def test_the_rest_is_kept_when_some_change():
    leaves = build_leaves(SPHERE)
    net = SPHERE.control_points.copy()
    net[3, 4, :3] += 0.01
    changed = mb.BezierTriangles(net)
    again = rebuild_leaves(changed, LeafSettings(), SPHERE, leaves)
    assert (
        again.is_one_of(INVERTED_KINDS).sum() == 15
        and not again.is_closed_form[again.patch == 3].any()
    )


def test_deviation_is_that_of_the_net():
    assert build_leaves(SPHERE).closed_form.deviation.max() < 1e-11
    deviation = build_leaves(single(SPHERE)).closed_form.deviation
    # one rounding of float32 is 6e-8, in units of a patch, of which the largest is 2 long
    assert 1e-9 < deviation.max() < 3e-7


def test_no_hit_is_lost_in_thin_directions():
    # the origin of a group is a float32 number, beside its plane by a rounding, and so are points:
    # the cells of its table must be larger than both
    rng = np.random.default_rng(8)
    for k in range(12):
        matrix = np.eye(4)
        if k % 3 == 2:
            matrix[:3, :3] = rotation(rng, 3)
        matrix[:3, :3] = np.roll(matrix[:3, :3], k, axis=0) * 10.0 ** rng.uniform(-1, 1)
        matrix[:3, 3] = rng.uniform(-1, 1, size=3)
        patches = SURFACES["disk"].transform(matrix)
        uv = rng.dirichlet([2.0, 2.0, 2.0], 4000)[:, :2]
        target = patches.points(rng.integers(0, len(patches), 4000), uv)
        size = np.linalg.norm(np.ptp(patches.bounds().reshape(-1, 3), axis=0))
        o = (target + size * rng.normal(size=target.shape)).astype(np.float32)
        leaves = build_leaves(patches)
        assert leaves.kinds <= INVERTED_KINDS
        assert np.array(traced(leaves, o, (target - o).astype(np.float32)).valid).all()
