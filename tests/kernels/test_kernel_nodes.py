"""Tests of the walk through the tree: every box that a ray meets, in sparse bytes of float32."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from backend_cases import plain

from mitsuba_bezier.kernels import nodes as nodes_module
from mitsuba_bezier.kernels.arrays import types_of
from mitsuba_bezier.kernels.nodes import build_nodes
from mitsuba_bezier.kernels.walk import BvhRays, begin, begin_at_root, next_leaf, prepare
from mitsuba_bezier.leaves.bvh import NO_LEAF, build_bvh


def visits(boxes, o, d, t_max=np.inf, owner=None, tree=0, float_type=plain.Float):
    """Return for each ray the leaves the kernel stops at, in order."""
    ty = types_of(float_type)
    nodes = build_nodes(boxes, ty, owner)
    o, d = ([ty.Float(a[:, i].astype(np.float32)) for i in range(3)] for a in (o, d))
    slabs = prepare(ty, o, d)
    t_max = dr.full(ty.Float, t_max, dr.width(o[0]))
    bvh = BvhRays(nodes, ty, ty.UInt(int(nodes.first[tree])), slabs)
    every = dr.full(ty.Bool, True, dr.width(o[0]))
    walk = begin(ty, nodes, slabs, t_max)
    if tree:  # the kernel of instances begins like this
        walk = begin_at_root(ty, nodes, ty.Bool(bool(nodes.single[tree])), every)
    out = [[] for _ in range(dr.width(o[0]))]
    while True:
        run = walk.goes_on() & every
        dr.eval(walk, run)
        if not dr.any(run):
            return out
        walk, leaf = next_leaf(bvh, walk, t_max, run)
        for ray, number in enumerate(np.array(leaf)):
            if number != NO_LEAF:
                out[ray].append(int(number))


def expected(boxes, o, d, t_max=np.inf):
    """Return which boxes rays meet, in float64, and which by a hair."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slabs = np.sort((boxes[None] - o[:, None, None]) / d[:, None, None], axis=2)
        enter = np.maximum(np.nanmax(slabs[:, :, 0], axis=2), 0)
        leave = np.minimum(np.nanmin(slabs[:, :, 1], axis=2), t_max)
    return (enter <= leave) & (enter < np.inf)  # beside a slab that it never enters


def some_boxes(count, seed, size=0.1, at=0.0):
    rng = np.random.default_rng(seed)
    centre, half = rng.uniform(-1, 1, (count, 3)), rng.uniform(0, size, (count, 3))
    return np.stack([centre - half, centre + half], axis=1) + at


def some_rays(count, seed, at=0.0):
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(count, 3)) * 2
    d = rng.uniform(-1, 1, (count, 3)) - o
    d[::7, 0], d[3::11, 2] = 0.0, -0.0
    # what the kernel sees
    return (o + at).astype(np.float32).astype(float), d.astype(np.float32).astype(float)


SPREAD = np.concatenate([some_boxes(60, 1), 1e4 * some_boxes(5, 2), some_boxes(40, 3, at=1e3)])
#: Bodies far from each other: of many boxes, of one, and two that are in a row along x.
APART = {
    "two bodies": [some_boxes(90, 21), some_boxes(1, 22, at=[0.0, 30.0, 0.0])],
    "three bodies": [
        some_boxes(40, 23),
        some_boxes(25, 24, at=[12.0, 1.0, 0.0]),
        some_boxes(70, 25, at=[-14.0, 0.0, 2.0]),
    ],
    "four bodies": [
        some_boxes(count, 26 + count, at=at)
        for count, at in ((1, [9.0, 0, 0]), (50, [0, 9.0, 0]), (1, [0, 0, 9.0]), (7, [0, 0, -9.0]))
    ],
    "six bodies": [some_boxes(9, 31 + k, at=[8.0 * k * k, 0, 0]) for k in range(6)],
}
CASES = {
    "one": some_boxes(1, 4, 1.0),
    "two": some_boxes(2, 5, 1.0),
    "hundreds": some_boxes(700, 6),
    "sizes apart": SPREAD,
    "far off": some_boxes(200, 7, at=1e4),
    "far off and small": some_boxes(200, 7, 1e-6) * 1e-3 + 1e4,
    "flat": some_boxes(100, 8) * [1, 1, 0],
    "the same": np.repeat(some_boxes(1, 9, 1.0), 20, axis=0),
    **{name: np.concatenate(bodies) for name, bodies in APART.items()},
}


@pytest.mark.parametrize("float_type", [plain.Float, plain.Float64])
@pytest.mark.parametrize("name", CASES)
def test_no_box_is_missed(name, float_type):
    boxes = CASES[name]
    o, d = some_rays(300, 10, at=boxes[0].mean(axis=0).round() if "far off" in name else 0.0)
    met = visits(boxes, o, d, float_type=float_type)
    hit = expected(boxes, o, d)
    for ray in range(len(o)):
        assert len(met[ray]) == len(set(met[ray])), "a leaf came twice"
        assert set(np.flatnonzero(hit[ray])) <= set(met[ray])
    # boxes are stored in 31sts of their parents' at most, which makes them larger
    extra = sum(map(len, met)) - hit.sum()
    assert extra <= 0.3 * hit.sum() + 0.2 * len(o)


@pytest.mark.parametrize("count", [1, 30])
def test_rays_from_afar_at_edges_of_the_box_of_all(count):
    # where one rounding of the origin is much more than what boxes are padded by
    boxes = some_boxes(count, 13)
    rng = np.random.default_rng(14)
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    at = rng.random((4000, 3))
    for face in rng.permuted(np.tile([0, 1, 2], (len(at), 1)), axis=1)[:, :2].T:  # on an edge
        at[np.arange(len(at)), face] = rng.integers(0, 2, len(at))
    target = low + (high - low) * at
    o = rng.normal(size=target.shape)
    o = (target + 1000 * o / np.linalg.norm(o, axis=1, keepdims=True)).astype(np.float32)
    o, d = o.astype(float), (target - o).astype(np.float32).astype(float)
    hit = expected(np.stack([low, high])[None], o, d)[:, 0]
    assert 0.2 < hit.mean() < 0.8
    ty = types_of(plain.Float)
    nodes = build_nodes(boxes, ty)
    rays = [[ty.Float(a[:, i].astype(np.float32)) for i in range(3)] for a in (o, d)]
    walk = begin(ty, nodes, prepare(ty, *rays), dr.full(ty.Float, np.inf, len(o)))
    assert np.array(walk.goes_on())[hit].all()


@pytest.mark.parametrize("name", APART)
def test_rays_that_pass_by_bodies_far_apart_read_no_node(name):
    # a scene of few bodies has a large box, which says little
    bodies = APART[name]
    boxes = np.random.default_rng(41).permutation(np.concatenate(bodies))
    ty = types_of(plain.Float)
    nodes = build_nodes(boxes, ty)
    assert len(nodes.bodies.bounds) == min(len(bodies), 4)
    around = np.array([[b[:, 0].min(axis=0), b[:, 1].max(axis=0)] for b in bodies])
    low, high = around[:, 0].min(axis=0), around[:, 1].max(axis=0)
    rng = np.random.default_rng(42)
    start, end = rng.uniform(low - 1, high + 1, (2, 3000, 3))
    o, d = (a.astype(np.float32).astype(float) for a in (start - 20 * (end - start), end - start))
    rays = [[ty.Float(a[:, i].astype(np.float32)) for i in range(3)] for a in (o, d)]
    walk = begin(ty, nodes, prepare(ty, *rays), dr.full(ty.Float, np.inf, len(o)))
    goes_on, hit = np.array(walk.goes_on()), expected(around, o, d).any(axis=1)
    assert goes_on[hit].all() and 0.02 < hit.mean() < 0.6
    if len(bodies) <= 4:  # not those of more, some of which share a box
        assert goes_on.sum() <= hit.sum() + 0.002 * len(o)  # a hair is all that boxes are padded by


def test_bodies_that_are_near_have_one_box():
    ty = types_of(plain.Float)
    touching = [some_boxes(50, 43), some_boxes(50, 44, at=[2.1, 0.0, 0.0])]
    assert build_nodes(np.concatenate(touching), ty).bodies is None
    assert build_nodes(some_boxes(1, 45), ty).bodies is None
    unbounded = np.concatenate(APART["two bodies"])
    unbounded[3, 1, 2] = np.inf
    assert build_nodes(unbounded, ty).bodies is None


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("places", [(0.0, 20.0), (0.0, 20.0, 90.0), (0.0, 20.0, 90.0, 110.0)])
def test_nearer_bodies_come_first(places, axis):
    along = np.eye(3)[axis]
    starts = np.array([[x, x + 0.75] for x in places]).ravel()
    boxes = np.stack([[x * along, x * along + 0.5 * along + 0.5] for x in starts])
    assert len(build_nodes(boxes, types_of(plain.Float)).bodies.bounds) == len(places)
    o = np.array([0.25 - 5 * along, 0.25 + 200 * along])
    there, back = visits(boxes, o, np.array([along, -along]))
    assert there == list(range(len(boxes))) and back == there[::-1]


def test_bodies_apart_do_not_make_a_tree_deep(monkeypatch):
    boxes = np.concatenate(APART["two bodies"])
    ty = types_of(plain.Float)
    monkeypatch.setattr(nodes_module, "_SHALLOW", 4)  # 90 boxes fill four levels by themselves
    nodes = build_nodes(boxes, ty)
    assert nodes.bodies is None and not nodes.deep
    monkeypatch.setattr(nodes_module, "_SHALLOW", 5)
    nodes = build_nodes(boxes, ty)
    assert nodes.bodies is not None and not nodes.deep


def test_faces_at_infinity():
    boxes = some_boxes(50, 11)
    boxes[3, 1, 0], boxes[8, 0] = np.inf, -np.inf
    boxes[20] = [[-np.inf] * 3, [np.inf] * 3]
    o, d = some_rays(300, 12)
    met, hit = visits(boxes, o, d), expected(boxes, o, d)
    for ray in range(len(o)):
        assert set(np.flatnonzero(hit[ray])) <= set(met[ray])


def test_directions_nearly_along_a_face_at_infinity():
    # 1e-9 is not zero: what is a thousand times the largest reciprocal has to fit into a float
    boxes = some_boxes(20, 15)
    boxes[::3, 0, 0], boxes[1::3, 1, 1] = -np.inf, np.inf
    o, d = some_rays(400, 16)
    d[:, 0] = np.float32(10.0) ** -np.arange(1, 41).repeat(10) * np.where(o[:, 1] > 0, 1, -1)
    d = d.astype(np.float32).astype(float)
    met, hit = visits(boxes, o, d, 1e15), expected(boxes, o, d, 1e15)
    for ray in range(len(o)):
        assert set(np.flatnonzero(hit[ray])) <= set(met[ray]), (o[ray], d[ray])


def test_nearer_boxes_come_first_and_those_behind_not_at_all():
    boxes = np.stack([np.array([[x, -1, -1], [x + 0.5, 1, 1]]) for x in range(9)])
    o = np.array([[-5.0, 0, 0], [20.0, 0.1, 0.1], [4.7, 0, 0]])
    d = np.array([[1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0]])
    forward, backward, middle = visits(boxes, o, d)
    assert forward == list(range(9)) and backward == list(range(9))[::-1]
    assert middle == [5, 6, 7, 8]
    assert visits(boxes, o, d, t_max=8.7)[0] == [0, 1, 2, 3]


@pytest.mark.parametrize("count", [1, 2, 3, 5, 300])
def test_deep_trees_have_wider_states(count, monkeypatch):
    boxes = some_boxes(count, 17, 0.3)
    o, d = some_rays(200, 18)
    monkeypatch.setattr(nodes_module, "_apart", lambda boxes: None)  # no boxes in full
    met = visits(boxes, o, d)
    monkeypatch.setattr(nodes_module, "_SHALLOW", 0)
    assert build_nodes(boxes, types_of(plain.Float)).deep
    assert visits(boxes, o, d) == met


def test_ten_levels_of_nodes():
    # more than 4^9 places: 32 bits would lose the uppermost siblings
    count = 215_000
    x = np.linspace(-1, 1, count + 1)
    boxes = np.zeros((count, 2, 3))
    boxes[:, 0] = np.stack([x[:-1], x[:-1] ** 2 - 1e-4, np.full(count, -1e-3)], axis=1)
    boxes[:, 1] = np.stack([x[1:], x[:-1] ** 2 + 1e-4, np.full(count, 1e-3)], axis=1)
    assert build_nodes(boxes, types_of(plain.Float)).deep
    o, d = some_rays(40, 19)
    # lines across the parabola meet it at its first, its last and boxes between
    o[:, 2] = d[:, 2] = 0.0
    o[0], d[0] = (-0.99, 1.5, 0.0), (0.0, -1.0, 0.0)
    o[1], d[1] = (-2.0, 0.5, 0.0), (1.0, 0.0, 0.0)
    met, hit = visits(boxes, o, d), expected(boxes, o, d)
    for ray in range(len(o)):
        assert set(np.flatnonzero(hit[ray])) <= set(met[ray])
    assert len(hit[1].nonzero()[0]) >= 2 and max(met[1]) - min(met[1]) > 1e5


def test_records_hold_boxes_in_float64_within_a_unit():
    boxes = some_boxes(300, 20)
    tree = build_bvh(boxes)
    records = nodes_module._records(tree, False).view(np.uint32)
    for k in (1, 4, 7, 21):
        words = records[k]
        if not words[7] >> 24:
            continue
        code = (words[7] >> (8 * np.arange(3))) & 255
        unit = 2.0 ** (code // 2 - 63.0) * (1 + code % 2 / 2)
        origin = words[:3].view(np.float32).astype(float) + np.array(nodes_module.SCALE) * unit
        for c in range(4):
            child = 4 * k + c
            leaf = bool(words[7] >> (28 + c) & 1)
            if not (leaf or words[7] >> (24 + c) & 1):
                continue
            if leaf and tree.leaf[child] == NO_LEAF:
                child //= 2  # a leaf at an odd depth
            word, turn = int(words[3 + c]), nodes_module.TURN
            turned = word << turn | word >> (32 - turn)
            low = np.array([word >> b & 31 for b in nodes_module.FACE])
            high = np.array([turned >> b & 31 for b in nodes_module.FACE])
            inner, outer = tree.bounds[child], origin + np.array([low, high]) * unit
            assert (outer[0] <= inner[0]).all() and (inner[1] <= outer[1]).all()
            assert (np.abs(outer - inner) <= 1.01 * unit).all()


def test_each_object_has_a_tree():
    boxes = some_boxes(40, 13, 0.5)
    owner = np.repeat([0, 1, 2], [25, 1, 14])
    o, d = some_rays(200, 14)
    for tree in range(3):
        mine = np.flatnonzero(owner == tree)
        hit = expected(boxes[mine], o, d)
        met = visits(boxes, o, d, owner=owner, tree=tree)
        for ray in range(len(o)):
            assert set(mine[hit[ray]]) <= set(met[ray]) <= set(mine)
