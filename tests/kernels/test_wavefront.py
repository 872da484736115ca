"""Queries with many rays at once: the same hits, to the last bit, and when they are made."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT, Float, UInt
from mitsuba_cases import ball_rays, bezier, camera_rays, ray_of

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.trims import Trims, square_map
from mitsuba_bezier.kernels import nodes, wavefront
from mitsuba_bezier.kernels.arrays import upload
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import Hit, intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafKind, LeafSettings, Leaves

GENERAL = LeafSettings(closed_form=False)
COUNT = 20_011  # no multiple of anything


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


@pytest.fixture
def small(monkeypatch) -> None:
    """Let all rounds be done, lanes take several rays and arrays be cut, with few rays."""
    monkeypatch.setattr(wavefront, "_MIN_RAYS", 16)
    monkeypatch.setattr(wavefront, "_RAYS_A_LANE", 5)
    monkeypatch.setattr(wavefront, "_MAX_RAYS", 8000)
    monkeypatch.setattr(wavefront, "_threads", lambda: 1)


def random_rays(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from all sides, some of them from inside."""
    rng = np.random.default_rng(seed)
    o, d = ball_rays(count, seed)
    inside = rng.random(count) < 0.2
    o[inside] = rng.uniform(-0.5, 0.5, (inside.sum(), 3))
    return o.astype(np.float32), d.astype(np.float32)


def columns(o: np.ndarray, d: np.ndarray) -> list[list[Any]]:
    return [[upload(Float, a[:, i]) for i in range(3)] for a in (o, d)]


def assert_same(one: Hit, other: Hit, any_hit: bool) -> np.ndarray:
    """Check that hits are the same, bit by bit; return which rays have one."""
    valid = np.array(one.valid)
    np.testing.assert_array_equal(valid, np.array(other.valid))
    if not any_hit:
        np.testing.assert_array_equal(np.array(one.t), np.array(other.t))
        for x, y in zip(one[2:], other[2:]):
            np.testing.assert_array_equal(np.array(x)[valid], np.array(y)[valid])
    return valid


def at_infinity() -> mb.BezierTriangles:
    """A sphere under a collineation that takes a plane that cuts it to infinity."""
    m = np.eye(4)
    m[3] = (0.2, 0.1, 0.9, 0.6)
    return mb.sphere(cover="octants").transform(m)


def two_kinds() -> Leaves:
    """Closed forms beside graphs, flat and at infinity."""
    parts = [mb.sphere(cover="tetrahedral"), mb.torus(tube=0.3), at_infinity()]
    leaves = [build_leaves(parts[0]), build_leaves(parts[1]), build_leaves(parts[2], GENERAL)]
    first = np.cumsum([0, *(len(p) for p in parts)])
    return Leaves.join(
        [x.of_patches(k + np.arange(len(p))) for x, p, k in zip(leaves, parts, first.tolist())]
    )


def balls(count: int) -> Leaves:
    """Many quadrics, and nothing else."""
    rng = np.random.default_rng(3)
    net = mb.sphere(cover="lunes").control_points
    nets = np.tile(net, (count, 1, 1, 1))
    nets[..., :3] = 0.12 * nets[..., :3] + nets[..., 3:] * rng.uniform(-1, 1, (count, 1, 1, 3))
    return build_leaves(mb.BezierTriangles(nets.reshape(-1, *net.shape[1:])))


SURFACES = {
    "quadrics": lambda: balls(120),
    "general": lambda: build_leaves(mb.sphere(), GENERAL),
    "several roots": lambda: build_leaves(mb.torus(tube=0.4)),
    "infinity": lambda: build_leaves(at_infinity(), GENERAL),
    "two kinds": two_kinds,
}


@pytest.mark.parametrize("any_hit", [False, True], ids=["closest", "any"])
@pytest.mark.parametrize("name", SURFACES)
def test_the_same_hits(small, name, any_hit):
    structure = build_structure(SURFACES[name](), Float)
    assert structure.has(LeafKind.GRAPH_PROJECTIVE) == (name in ("infinity", "two kinds"))
    rays = columns(*random_rays(COUNT))
    expected = intersect(structure, *rays, Float(np.inf), any_hit=any_hit)
    found = wavefront.intersect_wavefront(structure, *rays, Float(np.inf), any_hit=any_hit)
    share = assert_same(found, expected, any_hit).mean()
    assert share > 0.2  # of hits


def test_a_deep_tree(small, monkeypatch):
    monkeypatch.setattr(nodes, "_SHALLOW", 1)
    structure = build_structure(build_leaves(mb.torus()), Float)
    assert structure.nodes.deep
    rays = columns(*random_rays(COUNT))
    found = wavefront.intersect_wavefront(structure, *rays, Float(np.inf))
    assert assert_same(found, intersect(structure, *rays, Float(np.inf)), False).any()


def test_trimmed_leaves(small, tmp_path):
    patches = mb.torus()
    corners = [(0.2, 0.2), (0.6, 0.2), (0.6, 0.6), (0.2, 0.6), (0.2, 0.2)]
    window = [[(*p, 1.0), (*q, 1.0)] for p, q in pairwise(corners)]
    size = len(patches)
    trims = Trims([window], [0] * size, [square_map()] * size, [[[0, 0], [1, 1]]] * size)
    mb.io.save(patches, tmp_path / "a.vtu", trims=trims)
    shape = mi.load_dict({"type": "beziertriangle", "filename": str(tmp_path / "a.vtu")})
    structure = shape._alone().structure
    assert structure.trim is not None
    rays = columns(*random_rays(COUNT))
    found = wavefront.intersect_wavefront(structure, *rays, Float(np.inf))
    valid = assert_same(found, intersect(structure, *rays, Float(np.inf)), False)
    whole = intersect(build_structure(build_leaves(patches), Float), *rays, Float(np.inf))
    assert 0 < valid.sum() < np.array(whole.valid).sum()


@pytest.mark.parametrize("count", [1, 15, 16, 17, 1000])
def test_any_number_of_rays(small, count):
    structure = build_structure(build_leaves(mb.sphere(), GENERAL), Float)
    rays = columns(*random_rays(count, seed=count))
    found = wavefront.intersect_wavefront(structure, *rays, Float(np.inf))
    assert_same(found, intersect(structure, *rays, Float(np.inf)), False)


def test_rays_with_ends_and_rays_that_are_none(small):
    structure = build_structure(build_leaves(mb.sphere(), GENERAL), Float)
    o, d = random_rays(COUNT)
    d[5], o[6, 1], d[7, 2], o[8, 0] = 0, np.nan, np.inf, -np.inf
    rays = columns(o, d)
    rng = np.random.default_rng(1)
    t_max = Float(rng.uniform(-0.5, 4.0, COUNT).astype(np.float32))
    active = mi.Bool(rng.random(COUNT) < 0.7)
    before = np.array(t_max)
    for any_hit in (False, True):
        found = wavefront.intersect_wavefront(structure, *rays, t_max, active, any_hit)
        expected = intersect(structure, *rays, t_max, active, any_hit)
        valid = assert_same(found, expected, any_hit)
        assert valid.any() and not valid[5:9].any() and not valid[~np.array(active)].any()
    np.testing.assert_array_equal(before, np.array(t_max))  # not written to


def test_rays_with_a_part_in_common(small):
    structure = build_structure(build_leaves(mb.torus()), Float)
    _o, d = columns(*random_rays(COUNT))
    o = [Float(0.1), Float(-0.2), Float(3.0)]
    found = wavefront.intersect_wavefront(structure, o, d, Float(np.inf))
    assert assert_same(found, intersect(structure, o, d, Float(np.inf)), False).any()


def test_kernels_serve_all_counts(small):
    structure = build_structure(build_leaves(mb.torus()), Float)
    used = []
    for count in (5000, 6001, 7002):
        rays = columns(*random_rays(count))
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            dr.eval(*wavefront.intersect_wavefront(structure, *rays, Float(np.inf)))
            dr.sync_thread()
            kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
        used.append({k["hash"] for k in kernels})
    assert len(used[0]) > 5
    assert used[1] == used[0] and used[2] == used[0]


# ---------------------------------------------------------------- when


@pytest.fixture
def batches(monkeypatch) -> list[int]:
    """The numbers of rays that were asked for at once."""
    made: list[int] = []
    original = wavefront.intersect_wavefront

    def spy(s, o, d, t_max, active=True, any_hit=False):
        made.append(max(dr.width(x) for x in (*o, *d)))
        return original(s, o, d, t_max, active, any_hit)

    monkeypatch.setattr(wavefront, "intersect_wavefront", spy)
    return made


@pytest.fixture(scope="module")
def torus(variant) -> Any:
    return mi.load_dict(bezier(mb.torus()))


def in_memory(o: np.ndarray, d: np.ndarray) -> Any:
    ray = ray_of(o, d)
    dr.eval(ray)
    return ray


def test_where_it_is_worthwhile():
    rays = columns(*random_rays(wavefront._MIN_RAYS))
    dr.eval(rays)
    structures = {
        "one quadric": build_leaves(mb.sphere(cover="tetrahedral")),
        "some": balls(wavefront._MIN_GROUPS - 1),
        "many": balls(wavefront._MIN_GROUPS),
        "few leaves": build_leaves(mb.sphere(), GENERAL).select(
            np.arange(wavefront._MIN_LEAVES - 1)
        ),
        "leaves": build_leaves(mb.sphere(), GENERAL),
    }
    asked = {
        name: wavefront.is_worthwhile(build_structure(leaves, Float), *rays)
        for name, leaves in structures.items()
    }
    assert [name for name, yes in asked.items() if yes] == ["many", "leaves"]


def test_many_rays_that_go_apart(torus, batches):
    ray = in_memory(*random_rays(wavefront._MIN_RAYS))
    together = torus._alone().preliminary(ray, True, None, True).pi
    assert not batches  # told that they go together
    pi = torus.ray_intersect_preliminary(ray)
    hit = torus.ray_test(ray)
    assert batches == [wavefront._MIN_RAYS] * 2
    valid = np.isfinite(np.array(pi.t))
    assert 0.2 < valid.mean() < 0.8
    np.testing.assert_array_equal(np.array(hit), valid)
    np.testing.assert_array_equal(np.array(pi.t), np.array(together.t))
    for x, y in ((pi.prim_index, together.prim_index), (pi.prim_uv, together.prim_uv)):
        np.testing.assert_array_equal(np.array(x)[..., valid], np.array(y)[..., valid])


def test_rays_of_a_camera_and_few_rays(torus, batches):
    side = int(np.sqrt(wavefront._MIN_RAYS))
    torus.ray_intersect_preliminary(in_memory(*camera_rays((0, 1, 3), side)))
    torus.ray_intersect_preliminary(in_memory(*random_rays(wavefront._MIN_RAYS - 1)))
    assert not batches


def test_rays_that_are_not_in_memory(torus, batches):
    ray = in_memory(*random_rays(wavefront._MIN_RAYS))
    ray.o = ray.o + 0.01 * mi.Vector3f(ray.o.y, ray.o.z, ray.o.x)
    torus.ray_intersect_preliminary(ray)
    assert not batches

    def body(k, t):
        hit = torus.ray_intersect_preliminary(in_memory_ray)
        return k + 1, dr.minimum(t, hit.t)

    in_memory_ray = in_memory(*random_rays(wavefront._MIN_RAYS))
    count = dr.zeros(UInt, wavefront._MIN_RAYS)
    dr.while_loop((mi.UInt32(count), mi.Float(4.0)), lambda k, _t: k < 2, body)
    assert not batches


def test_closed_forms_have_their_own_way(batches):
    sphere = mi.load_dict(bezier(mb.sphere()))
    sphere.ray_intersect_preliminary(in_memory(*random_rays(wavefront._MIN_RAYS)))
    assert not batches


def test_in_a_scene_with_other_shapes(batches):
    scene = mi.load_dict(
        {
            "type": "scene",
            "torus": bezier(mb.torus()),
            "ball": {"type": "sphere", "radius": 0.5},
        }
    )
    o, d = random_rays(wavefront._MIN_RAYS)
    si = mb.ray_intersect(scene, in_memory(o, d))
    assert batches == [wavefront._MIN_RAYS]
    told = mb.ray_intersect(scene, in_memory(o, d), coherent=True)
    assert len(batches) == 1
    np.testing.assert_array_equal(np.array(si.t), np.array(told.t))
    np.testing.assert_array_equal(np.array(si.n), np.array(told.n))
    blocked = mb.ray_test(scene, in_memory(o, d))
    np.testing.assert_array_equal(np.array(blocked), np.isfinite(np.array(si.t)))


def test_scenes_without_end(batches):
    cone = mi.load_dict(bezier(mb.hyperboloid_one_sheet().elevate()))
    structure = cone._alone().structure
    if not structure.has_graphs:
        structure = build_structure(build_leaves(mb.hyperboloid_one_sheet(), GENERAL), Float)
    o, d = columns(*random_rays(wavefront._MIN_RAYS))
    assert 0.0 <= wavefront._distance(structure, wavefront.types_of(Float), o, d) <= 1.0
