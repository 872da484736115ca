"""Leaves: that they tile, and that what they claim holds. Bvh: the layout traversal relies on."""

from __future__ import annotations

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.bvh import NO_LEAF, Bvh, build_bvh
from mitsuba_bezier.leaves.closed_form.plane_sections import edge_planes
from mitsuba_bezier.leaves.records import (
    INVERTED_KINDS,
    QUADRIC_ENTRIES,
    GraphLeaves,
    LeafSettings,
    Leaves,
)

# ---------------------------------------------------------------- nets


def wavy(n: int, count: int = 4, seed: int = 0, weights: tuple = (0.5, 2.0)) -> mb.BezierTriangles:
    rng = np.random.default_rng(seed)
    uv = bernstein.multi_indices(n)[:, :2] / n
    points = np.pad(uv, ((0, 0), (0, 1))) + np.array([3.0, -2.0, 1.0])
    points = points + rng.normal(scale=0.3 / n, size=(count, *points.shape))
    w = rng.uniform(*weights, size=(*points.shape[:2], 1))
    return mb.BezierTriangles(np.concatenate([points * w, w], axis=-1))


def through_infinity() -> mb.BezierTriangles:
    net = wavy(3, 2, 5).control_points.copy()
    net[0, 0, 3] = 0.0
    net[1, -1, 3] *= -1.0
    return mb.BezierTriangles(net)


NETS = {
    "octants": mb.sphere(cover="octants"),
    "lunes": mb.sphere(cover="lunes"),  # collapsed edges
    "degree 2": wavy(2),
    "degree 3": wavy(3),
    "degree 5": wavy(5),
    "negative weights": wavy(3, seed=1, weights=(-2.0, -0.5)),
    "through infinity": through_infinity(),
    "singular point": wavy(3, weights=(-2.0, -0.5)),  # both partials are parallel somewhere
}
#: Nets that end in planar leaves, at a collapsed edge or a singular point.
STAND_INS = ("lunes", "singular point")
#: Every net as graph leaves, also those that have a closed form.
GENERAL = LeafSettings(closed_form=False)


@pytest.fixture(scope="module", params=NETS)
def whole(request) -> tuple[str, Leaves]:
    """A net's name, and all of its leaves."""
    return request.param, build_leaves(NETS[request.param], GENERAL)


@pytest.fixture(scope="module")
def cut(whole) -> tuple[mb.BezierTriangles, Leaves]:
    """A net, and those of its leaves that are the surface itself; not too many of them."""
    return NETS[whole[0]], some(whole[1])


def some(leaves: Leaves) -> Leaves:
    leaves = leaves.select(leaves.certified)
    return leaves.select(slice(None, None, 1 + len(leaves) // 150))


@pytest.fixture(scope="module", params=[name for name in NETS if name != "singular point"])
def regular(request) -> Leaves:
    """Leaves of a net whose charts are regular everywhere."""
    return some(build_leaves(NETS[request.param], GENERAL))


def lattice(n: int) -> np.ndarray:
    return bernstein.multi_indices(n)[:, :2] / n


# ---------------------------------------------------------------- graph leaves


def test_domains_tile_the_triangle(whole):
    name, leaves = whole
    count = len(NETS[name])
    corners = leaves.domain / leaves.domain.sum(axis=1, keepdims=True)  # columns: barycentrics
    assert corners.min() > -1e-12
    areas = np.abs(np.linalg.det(corners))
    total = np.bincount(leaves.patch, weights=areas, minlength=count)
    if name not in STAND_INS:
        assert leaves.certified.all()
        assert np.linalg.det(corners).min() > 0  # none turned over
        assert np.abs(total - 1).max() < 1e-9
    else:
        # planar leaves close the rest, with a little overlap, down to where there is no area
        assert 0 < (~leaves.certified).sum() < 100
        real = np.bincount(leaves.patch, weights=areas * leaves.certified, minlength=count)
        assert real.min() > 1 - 1e-3 and real.max() < 1 + 1e-9
        assert np.abs(total - 1).max() < 1e-3
    # no two of them overlap: random points lie in one each
    points = np.random.default_rng(0).dirichlet([1, 1, 1], 200)
    for p in range(count):
        mine = (leaves.patch == p) & leaves.certified
        inside = np.einsum("lij,nj->nli", np.linalg.inv(corners[mine]), points)
        assert ((inside > -1e-12).all(axis=2).sum(axis=1) == 1).all()


def test_numbers_the_kernel_stores_are_float32(cut):
    _patches, leaves = cut
    for values in (leaves.graph.shift, leaves.graph.chart):
        assert np.array_equal(values, values.astype(np.float32))
    assert not leaves.is_closed_form.any()


def chart_points(leaves: GraphLeaves, uv: np.ndarray) -> np.ndarray:
    """Evaluate the nets in the charts at ``(L, S, 2)`` or ``(S, 2)``: ``(L, S, 4)``, x y z W."""
    n = bernstein.degree_of(leaves.net.shape[1])
    i, j = bernstein.multi_indices(n)[:, :2].T
    uv = np.broadcast_to(uv, (len(leaves), *uv.shape[-2:]))
    out = (uv[..., :1] ** i * uv[..., 1:] ** j) @ leaves.net
    out[..., :2] += uv
    out[..., 3] += 1.0
    return out


def test_nets_are_the_patch_in_the_chart(cut):
    patches, leaves = cut[0], cut[1].graph
    uv = lattice(5)
    chart = chart_points(leaves, uv)
    bary = np.concatenate([uv, 1 - uv.sum(axis=1, keepdims=True)], axis=1)
    on_patch = np.einsum("lij,sj->lsi", leaves.domain, bary)
    on_patch = on_patch[..., :2] / on_patch.sum(axis=-1, keepdims=True)
    h = patches.evaluate(np.repeat(leaves.patch, len(uv)), on_patch.reshape(-1, 2))
    h = h.reshape(len(leaves), len(uv), 4)
    moved = np.concatenate([h[..., :3] - h[..., 3:] * leaves.shift[:, None], h[..., 3:]], axis=-1)
    truth = np.einsum("lrc,lsc->lsr", leaves.chart, moved)
    # equal up to a factor, the same at all points: that of the weights
    finite = np.abs(truth[..., 3]) > 1e-12
    a, b = chart[finite], truth[finite]
    error = np.abs(a[:, :3] / a[:, 3:] - b[:, :3] / b[:, 3:]).max(axis=1)
    # cuts down to 1e-5 of the patch, with a frame as large, lose that many digits of float64
    assert error.max() < 1e-6


def height(leaves: GraphLeaves, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``h(x, y)`` and ``(u, v)`` at ``(L, S, 2)`` chart points, by Newton's iteration."""
    uv = xy.copy()
    step = 1e-6
    for _ in range(9):
        p = chart_points(leaves, uv)
        flat = p[..., :2] / p[..., 3:]
        columns = []
        for axis in range(2):
            move = np.zeros(2)
            move[axis] = step
            q = chart_points(leaves, uv + move)
            columns.append((q[..., :2] / q[..., 3:] - flat) / step)
        jacobian = np.stack(columns, axis=-1)
        uv = uv - np.linalg.solve(jacobian, (flat - xy)[..., None])[..., 0]
    p = chart_points(leaves, uv)
    assert np.abs(p[..., :2] / p[..., 3:] - xy).max() < 1e-11
    return p[..., 2] / p[..., 3], uv


def test_bounds_hold_on_dense_samples(regular):
    leaves = regular.graph
    a, b, c = leaves.quadratic.T[:, :, None]
    remainder, variation, bending = (
        x[:, None] for x in (leaves.remainder, leaves.variation, leaves.bending)
    )
    margin = leaves.outward.max(axis=1)[:, None]
    # the surface stays within the margin of the unit triangle
    p = chart_points(leaves, lattice(20))
    x, y = p[..., 0] / p[..., 3], p[..., 1] / p[..., 3]
    assert (np.minimum(np.minimum(x, y), 1 - x - y) >= -margin - 1e-12).all()

    # all that a clipped ray may see: the unit triangle enlarged
    outward = leaves.outward[:, None]
    xy = lattice(11) * (1 + outward.sum(axis=2, keepdims=True)) - outward[..., :2]
    h, _uv = height(leaves, xy)
    x, y = xy[..., 0], xy[..., 1]
    rest = 1 - x - y
    excess = np.abs(h - (a * x * y + b * x * rest + c * y * rest)) - remainder
    assert excess.max() <= 0, f"{(excess > 0).any(axis=1).sum()} of {len(leaves)} leaves"

    # second derivatives by differences; their error, 1e-16 / step^2, is 1e-9
    step = 3e-4
    ex, ey = np.array([step, 0]), np.array([0, step])
    hxx = (height(leaves, xy + ex)[0] - 2 * h + height(leaves, xy - ex)[0]) / step**2
    hyy = (height(leaves, xy + ey)[0] - 2 * h + height(leaves, xy - ey)[0]) / step**2
    hxy = (
        height(leaves, xy + ex + ey)[0]
        - height(leaves, xy + ex - ey)[0]
        - height(leaves, xy - ex + ey)[0]
        + height(leaves, xy - ex - ey)[0]
    ) / (4 * step**2)
    hess = np.stack([np.stack([hxx, hxy], axis=-1), np.stack([hxy, hyy], axis=-1)], axis=-2)
    mixed = np.broadcast_to(a - b - c, h.shape)
    quadratic = np.stack(
        [
            np.stack([np.broadcast_to(-2 * b, h.shape), mixed], axis=-1),
            np.stack([mixed, np.broadcast_to(-2 * c, h.shape)], axis=-1),
        ],
        axis=-2,
    )
    # 1e-5: of fourth derivatives, step^2 / 12 of them
    excess = np.linalg.norm(hess - quadratic, 2, axis=(-2, -1)) - variation - 1e-5
    assert excess.max() <= 0, f"{(excess > 0).any(axis=1).sum()} of {len(leaves)} leaves"
    excess = np.linalg.norm(hess - quadratic, 2, axis=(-2, -1)) / 2 - bending - 1e-5
    assert excess.max() <= 0, f"{(excess > 0).any(axis=1).sum()} of {len(leaves)} leaves"


def test_seeds_for_the_march(regular):
    # two quadratics take (x, y) near to (u, v): the better, the fewer steps
    leaves = regular.graph
    uv = lattice(8)
    p = chart_points(leaves, uv)
    x, y = p[..., 0] / p[..., 3], p[..., 1] / p[..., 3]
    w = 1 - x - y
    q = leaves.start.reshape(-1, 6, 1)
    u = x + q[:, 0] * x * y + q[:, 1] * x * w + q[:, 2] * y * w
    v = y + q[:, 3] * x * y + q[:, 4] * x * w + q[:, 5] * y * w
    # without them |x - u| is up to 1/4 (the setting `lateral`)
    assert max(np.abs(u - uv[:, 0]).max(), np.abs(v - uv[:, 1]).max()) < 0.04


def test_boxes_hold_the_surface(cut):
    patches, leaves = cut
    uv = lattice(12)
    bary = np.concatenate([uv, 1 - uv.sum(axis=1, keepdims=True)], axis=1)
    on_patch = np.einsum("lij,sj->lsi", leaves.domain, bary)
    on_patch = on_patch[..., :2] / on_patch.sum(axis=-1, keepdims=True)
    p = patches.points(np.repeat(leaves.patch, len(uv)), on_patch.reshape(-1, 2))
    p = p.reshape(len(leaves), len(uv), 3)
    finite = np.isfinite(p) & (np.abs(p) < 1e9)
    slack = 1e-9 * (1 + np.abs(np.where(finite, p, 0)))
    assert (~finite | (p >= leaves.box[:, None, 0] - slack)).all()
    assert (~finite | (p <= leaves.box[:, None, 1] + slack)).all()


@pytest.mark.parametrize(
    ("name", "most"), [("octants", 200), ("lunes", 12_000), ("degree 5", 1000)]
)
def test_number_of_leaves(name, most):
    # what a change of the bounds may not undo unseen
    assert len(build_leaves(NETS[name], GENERAL)) < most


def test_stricter_settings_give_more_leaves():
    few = build_leaves(NETS["degree 3"])
    many = build_leaves(NETS["degree 3"], LeafSettings(remainder=0.002))
    assert len(many) > 1.5 * len(few)
    assert many.graph.remainder[many.graph.certified].max() < 0.0021


DEGENERATE = {
    "a point": np.tile([1.0, 2, 3, 1], (1, 6, 1)),
    "zero vectors": np.concatenate([wavy(2, 1).control_points[:, :4], np.zeros((1, 2, 4))], axis=1),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_nets_end_soon(name):
    leaves = build_leaves(mb.BezierTriangles(DEGENERATE[name]))
    # hardly a surface; no error, no endless cutting, numbers the kernel can take
    assert len(leaves) < 10_000
    for values in [*vars(leaves.graph).values(), *vars(leaves.closed_form).values()]:
        assert np.isfinite(values).all()


# ---------------------------------------------------------------- exact leaves


def random_quadric_patches(count: int, seed: int) -> mb.BezierTriangles:
    """Return patches of the sphere under moderate collineations: quadrics of all oval kinds."""
    rng = np.random.default_rng(seed)
    ball = mb.sphere(cover="tetrahedral")
    nets = []
    while len(nets) < count:
        matrix = np.eye(4) + 0.3 * rng.normal(size=(4, 4))
        net = ball[int(rng.integers(0, 10))].transform(matrix).control_points[0]
        if (net[:, 3] > 0.05).all():  # within reach; the rest is tested above
            nets.append(net)
    return mb.BezierTriangles(nets)


RULED = [
    ("hyperbolic paraboloid", [[0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1], [1, 1, 1, 1]]),
    ("one sheet", [[1, 0, 0, 1], [0, 1, 0, 1], [1, 1, 1, 1], [-1, 0, 0, 1]]),
]
RULED_FORMS = {
    "hyperbolic paraboloid": np.array(
        [[0, 0.5, 0, 0], [0.5, 0, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]]
    ),
    "one sheet": np.diag([1.0, 1, -1, -1]),
}


def check_exact(patches: mb.BezierTriangles, leaves: Leaves, slack: float) -> None:
    """Check that the frame inverts the patch and that the form vanishes on it."""
    assert len(leaves) == len(patches) and leaves.is_closed_form.all()
    leaves = leaves.closed_form
    assert sorted(leaves.patch) == list(range(len(patches)))
    uv = lattice(8)[[9, 17, 20, 25, 30, 33]]  # inside and on edges
    for l in range(len(leaves)):
        h = patches.evaluate(int(leaves.patch[l]), uv)
        x = (h[:, :3] / h[:, 3:] - leaves.shift[l]) @ leaves.axes[l].T
        x = np.concatenate([x, np.ones((len(uv), 1))], axis=1)
        bary = x @ leaves.rows[l, :3].T
        total = bary.sum(axis=1)
        assert (np.abs(total) >= leaves.least_sum[l]).all()
        assert np.abs(bary[:, :2] / total[:, None] - uv).max() < slack
        form = np.zeros((4, 4))
        for value, (i, j) in zip(leaves.quadric[l], QUADRIC_ENTRIES):
            form[i, j] = form[j, i] = value
        value = np.einsum("ni,ij,nj->n", x, form, x)
        gradient = 2 * np.linalg.norm(x @ form[:, :3], axis=1)
        size = np.ptp(leaves.span[l], axis=0).max()
        assert np.abs(value).max() < slack * (gradient * size).max()  # distance over size
    assert (leaves.domain == np.eye(3)).all()


@pytest.mark.parametrize("rounded", [False, True])
@pytest.mark.parametrize(
    "patches",
    [
        pytest.param(mb.sphere(cover="tetrahedral"), id="sphere"),
        pytest.param(mb.sphere(cover="lunes"), id="lunes"),
        pytest.param(mb.sphere(center=(30, -20, 10), radius=2, cover="tetrahedral"), id="far"),
        pytest.param(mb.sphere(radius=1e-4, cover="tetrahedral"), id="small"),
        pytest.param(random_quadric_patches(40, 1), id="ellipsoids"),
    ],
)
def test_closed_forms_are_found(patches, rounded):
    if rounded:  # as they come through Mitsuba's tensors
        patches = mb.BezierTriangles(patches.control_points.astype(np.float32))
    leaves = build_leaves(patches)
    # 1e-5: the rounding of float32, 6e-8, of numbers up to 15 times the size of the patch
    check_exact(patches, leaves, 1e-5 if rounded else 1e-11)


@pytest.mark.parametrize(("name", "points"), RULED)
def test_closed_forms_of_ruled_quadrics(name, points):
    net = mb.quadric_patch(RULED_FORMS[name], points[3], points[:3])
    patches = mb.BezierTriangles(net)
    check_exact(patches, build_leaves(patches), 1e-11)


def test_planar_triangles_have_a_closed_form():
    rng = np.random.default_rng(2)
    net = np.concatenate([rng.normal(size=(20, 3, 3)), rng.uniform(0.5, 2, (20, 3, 1))], axis=-1)
    net[..., :3] *= net[..., 3:]
    patches = mb.BezierTriangles(net)
    check_exact(patches, build_leaves(patches), 1e-11)
    unbounded = mb.BezierTriangles([[[0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 0, 0]]])
    leaves = build_leaves(unbounded)
    assert leaves.is_closed_form.all() and np.isinf(leaves.box).any()


def test_other_nets_have_no_closed_form():
    assert not build_leaves(wavy(2, 30)).is_closed_form.any()
    assert not build_leaves(mb.torus()).is_closed_form.any()
    ball = mb.sphere(cover="tetrahedral").control_points
    rng = np.random.default_rng(3)
    bent = mb.BezierTriangles(ball * (1 + 1e-4 * rng.normal(size=ball.shape)))
    assert not build_leaves(bent).is_closed_form.any()


def ellipsoid(rng):
    affine = np.eye(4)
    affine[:3] += 0.4 * rng.normal(size=(3, 4))
    return mb.sphere(cover="octants").transform(affine)


@pytest.mark.parametrize("rounded", [False, True])
def test_octants_of_ellipsoids_are_met_through_their_quadric(rounded):
    patches = ellipsoid(np.random.default_rng(5)).elevate(1)
    if rounded:
        patches = mb.BezierTriangles(patches.control_points.astype(np.float32))
    leaves = build_leaves(patches)
    assert leaves.is_closed_form.all() and len(leaves) == 8
    leaves = leaves.closed_form
    assert len(np.unique(leaves.group)) == 1
    assert build_leaves(patches, LeafSettings(sections=False)).kinds <= INVERTED_KINDS
    planes = edge_planes(leaves)
    # the planes' values tell the octants apart, and are zero on the edges only
    uv = np.random.default_rng(6).dirichlet(np.ones(3), 40)[:, :2]
    for leaf, patch in enumerate(leaves.patch):
        for other in range(8):
            p = patches.points(np.full(40, other), uv) - leaves.shift[leaf]
            inside = (p @ planes[leaf, :, :3].T + planes[leaf, :, 3] > 0).all(axis=1)
            assert inside.all() if other == patch else not inside.any()


def test_patches_near_to_octants_have_no_closed_form():
    net = mb.sphere(cover="octants").control_points
    rng = np.random.default_rng(4)
    bent = mb.BezierTriangles(net * (1 + 1e-5 * rng.normal(size=net.shape)))
    assert not build_leaves(bent).is_closed_form.any()
    # an octant in other parameters of degree 8: its edges stay plane, so it has one
    assert build_leaves(mb.BezierTriangles(net).elevate(4)).is_closed_form.all()
    # a part of one, cut out along curves that are not plane: the planes do not tell what is on it
    domain = np.array([[0.8, 0.1, 0.1], [0.2, 0.6, 0.2], [0.1, 0.2, 0.7]])
    assert build_leaves(mb.BezierTriangles(net).subtriangle(domain)).kinds <= INVERTED_KINDS


def test_one_quadric_is_met_once():
    leaves = build_leaves(mb.sphere(cover="tetrahedral")).closed_form
    assert len(np.unique(leaves.group)) == 1
    forms = leaves.quadric
    assert (forms == forms[0]).all() and (leaves.shift == leaves.shift[0]).all()
    # two quadrics, two groups; those of many patches are cut
    two = mb.BezierTriangles.join(
        [mb.sphere(cover="tetrahedral"), mb.sphere(center=(0.1, 0, 0), cover="tetrahedral")]
    )
    leaves = build_leaves(two).closed_form
    assert len(np.unique(leaves.group)) == 2
    for g in np.unique(leaves.group):
        assert len(np.unique(leaves.patch[leaves.group == g] // 10)) == 1


def test_joined_leaves():
    parts = [build_leaves(wavy(2)), build_leaves(mb.sphere(cover="tetrahedral"))]
    parts += [build_leaves(wavy(4)), build_leaves(mb.sphere(cover="lunes"))]
    both = Leaves.join(parts)
    assert len(both) == sum(len(p) for p in parts)
    assert both.graph.net.shape[1] == bernstein.size(4)
    group = both.closed_form.group
    assert not set(group[:10]) & set(group[10:])
    # nets of lower degree are padded: the same points
    first = both.graph.select(np.arange(len(parts[0])))
    uv = lattice(4)
    assert np.abs(chart_points(first, uv) - chart_points(parts[0].graph, uv)).max() < 1e-15


# ---------------------------------------------------------------- tree


def random_boxes(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    centre = rng.normal(size=(count, 3)) * [10, 1, 0.1]
    half = rng.exponential(size=(count, 3)) * 0.2
    return np.stack([centre - half, centre + half], axis=1)


def with_infinite_faces(boxes: np.ndarray) -> np.ndarray:
    boxes = boxes.copy()
    boxes[::7, 0, 1] = -np.inf
    boxes[::11, 1, 0] = np.inf
    boxes[3] = [[-np.inf] * 3, [np.inf] * 3]
    return boxes


BOXES = {
    "one": random_boxes(1, 0),
    "two": random_boxes(2, 1),
    "three": random_boxes(3, 2),
    "thousand": random_boxes(1000, 3),
    "identical": np.repeat(random_boxes(1, 4), 50, axis=0),
    "points": np.repeat(random_boxes(40, 5)[:, :1], 2, axis=1),
    "infinite": with_infinite_faces(random_boxes(100, 6)),
    "all infinite": np.tile([[-np.inf] * 3, [np.inf] * 3], (9, 1, 1)),
    "far": random_boxes(60, 7) * 1e12,
}


@pytest.fixture(scope="module", params=BOXES)
def tree(request) -> tuple[np.ndarray, Bvh]:
    boxes = BOXES[request.param]
    return boxes, build_bvh(boxes)


def test_each_leaf_is_one_node(tree):
    boxes, t = tree
    is_leaf = t.leaf != NO_LEAF
    assert sorted(t.leaf[is_leaf]) == list(range(len(boxes)))
    assert np.array_equal(t.bounds[is_leaf], boxes[t.leaf[is_leaf]])
    assert len(t.inner) == len(boxes) - 1
    assert not is_leaf[t.inner].any()


def test_children_fill_their_parents(tree):
    _boxes, t = tree
    is_node = t.leaf != NO_LEAF
    is_node[t.inner] = True
    assert is_node[1] and not is_node[0]
    for node in t.inner:
        assert is_node[2 * node] and is_node[2 * node + 1]
        lower = np.minimum(t.bounds[2 * node, 0], t.bounds[2 * node + 1, 0])
        upper = np.maximum(t.bounds[2 * node, 1], t.bounds[2 * node + 1, 1])
        assert np.array_equal(t.bounds[node], [lower, upper])


def test_trees_are_shallow(tree):
    # the numbers of nodes must fit into memory: kernels have every other level, 8 bytes a number
    boxes, t = tree
    assert len(t.leaf) <= max(2, 10 * len(boxes))


def walk(t: Bvh, o: np.ndarray, d: np.ndarray) -> tuple[list[int], int]:
    """Traverse nearer child first; return the leaves whose boxes the ray meets, in order."""
    with np.errstate(divide="ignore"):
        rcp = 1 / d
    met: list[int] = []
    read = 0

    def entry(node: int) -> float:
        with np.errstate(invalid="ignore"):
            slabs = (t.bounds[node] - o) * rcp
        enter = max(0.0, np.nanmax(slabs.min(axis=0)))
        return enter if enter <= np.nanmin(slabs.max(axis=0)) else np.inf

    def visit(node: int) -> None:
        nonlocal read
        if t.leaf[node] != NO_LEAF:
            met.append(int(t.leaf[node]))
            return
        read += 1
        children = [2 * node, 2 * node + 1]
        for child in sorted((c for c in children if entry(c) < np.inf), key=entry):
            visit(child)

    if entry(1) < np.inf:
        visit(1)
    return met, read


def test_traversal_meets_all_boxes_on_a_ray():
    boxes = BOXES["infinite"]
    tree = build_bvh(boxes)
    rng = np.random.default_rng(8)
    for _ in range(100):
        o, d = rng.normal(size=3) * [10, 2, 2], rng.normal(size=3)
        met, _read = walk(tree, o, d)
        slabs = np.sort((boxes - o) / d, axis=1)
        enter = np.maximum(slabs[:, 0].max(axis=1), 0)
        expected = np.flatnonzero(enter <= slabs[:, 1].min(axis=1))
        assert sorted(met) == list(expected)


def test_trees_are_worth_their_keep():
    # near children first, and few nodes read: 1000 small boxes spread in space
    rng = np.random.default_rng(9)
    centre = rng.uniform(-1, 1, (1000, 3))
    boxes = np.stack([centre - 0.03, centre + 0.03], axis=1)
    tree = build_bvh(boxes)
    reads, ordered = [], []
    for _ in range(100):
        o = rng.normal(size=3)
        o *= 3 / np.linalg.norm(o)
        d = rng.uniform(-0.7, 0.7, 3) - o
        met, read = walk(tree, o, d)
        reads.append(read)
        place = (boxes[met].mean(axis=1) - o) @ d
        if len(met) > 2:
            ordered.append(np.corrcoef(np.arange(len(met)), place)[0, 1])
    assert np.mean(reads) < 75  # of 999
    assert np.mean(ordered) > 0.9


def test_thin_strips_are_cut_along_only() -> None:
    """A piece of a ring 20 times as wide as its tube has 1054 leaves if it is cut in four only."""
    ring = mb.torus((0, 0, 0), 1.0, tube=0.05)
    leaves = build_leaves(ring[[0]])
    assert leaves.certified.all()
    # 204 today; with room for other orders of the cuts, and far from what cuts across make
    assert len(leaves) < 400
