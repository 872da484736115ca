"""Instances of a shape: the same picture as as many shapes, in the memory of one."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.plugins.scene_data import data_for_scene

#: A wavy patch beside a closed form: both kinds of leaves.
WAVY = mb.BezierTriangles(
    [[[1, 0, 0, 1], [0.5, 0.5, 0.8, 1.2], [0.5, 0, -0.5, 1], [0, 1, 0, 1], [0, 0.5, 0.7, 0.8],
      [0, 0, 0.3, 1]]]
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def maps(count: int, seed: int = 1) -> np.ndarray:
    """Return affine maps: turned, sheared, some mirrored, spread over a cube of size 20."""
    rng = np.random.default_rng(seed)
    out = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    linear = rng.normal(size=(count, 3, 3))
    u, s, vt = np.linalg.svd(linear)
    s = rng.uniform(0.5, 1.5, size=(count, 3))
    out[:, :3, :3] = np.einsum("nij,nj,njk->nik", u, s, vt)
    out[:, :3, 3] = rng.uniform(-10, 10, size=(count, 3))
    return out.astype(np.float32).astype(np.float64)


def tensor(values: np.ndarray):
    return mi.TensorXf(values.astype(np.float32).ravel(), shape=values.shape)


def scenes(patches: mb.BezierTriangles, matrices: np.ndarray, **more):
    """Return a scene of instances and one of as many shapes."""
    once = mi.load_dict(
        {"type": "scene", "s": {**bezier(patches), "instances": tensor(matrices), **more}}
    )
    apart = mb.BezierTriangles.join([patches.transform(m) for m in matrices])
    many = mi.load_dict({"type": "scene", "s": {**bezier(apart), **more}})
    return once, many


def rays(count: int, reach: float = 20.0, seed: int = 2):
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(3, count))
    o *= reach / np.linalg.norm(o, axis=0)
    d = rng.uniform(-10, 10, size=(3, count)) - o
    d /= np.linalg.norm(d, axis=0)
    return mi.Ray3f(mi.Point3f(o.astype(np.float32)), mi.Vector3f(d.astype(np.float32)))


@pytest.mark.parametrize(
    "patches",
    [mb.sphere(), mb.sphere(cover="tetrahedral"), WAVY],
    ids=["octants", "tetrahedral", "wavy"],
)
def test_instances_are_what_as_many_shapes_are(patches):
    once, many = scenes(patches, maps(40))
    ray = rays(20000)
    a, b = mb.ray_intersect(once, ray), mb.ray_intersect(many, ray)
    hit, other = np.array(a.is_valid()), np.array(b.is_valid())
    assert 500 < hit.sum() < 19000
    # at silhouettes roundings of different maps decide; nearly all rays are off them
    assert (hit != other).mean() < 2e-4
    both = hit & other
    t, u = np.array(a.t)[both], np.array(b.t)[both]
    same = np.abs(t - u) < 1e-4  # grazing rays amplify the rounding of the maps, 1e-6
    assert same.mean() > 0.9995
    for name, tolerance in (("p", 1e-4), ("n", 1e-3), ("dp_du", 1e-3)):
        x, y = (np.array(getattr(si, name)).T[both][same] for si in (a, b))
        # mirrored: joined nets turn their normals with u and v, an instance keeps its outside out
        error = np.minimum(np.abs(x - y), np.abs(x + y)) if name == "n" else np.abs(x - y)
        assert np.quantile(error.max(axis=1), 0.999) < tolerance, name
    assert (np.array(mb.ray_test(once, ray)) == hit).all()
    # the patch is that of the net, the frame is one
    assert np.array(a.prim_index)[both].max() < len(patches)
    n, dp = np.array(a.sh_frame.n).T[both], np.array(a.dp_du).T[both]
    assert np.abs((n * np.array(a.n).T[both]).sum(axis=1) - 1).max() < 1e-6
    assert np.abs((n * dp).sum(axis=1)).max() < 1e-5 * np.abs(dp).max()


def test_outside_stays_out_in_mirrored_instances():
    mirrored = maps(30)
    mirrored[:, :3, :3] *= np.sign(np.linalg.det(mirrored[:, :3, :3]))[:, None, None]
    mirrored[::2, :3, 0] *= -1
    once, _many = scenes(mb.sphere(), mirrored)
    si = mb.ray_intersect(once, rays(5000, 60))
    valid = np.array(si.is_valid())
    # from far outside of convex instances each first hit is on an outside
    assert (np.array(si.wi.z)[valid] > 0).all() and valid.sum() > 500


def test_partials_of_normals():
    once, _many = scenes(mb.sphere(), maps(12, seed=4))
    ray = rays(1500)
    si = mb.ray_intersect(once, ray, mi.RayFlags.All | mi.RayFlags.dNGdUV)
    hit = np.array(si.is_valid())
    step = 1e-3
    p, n, du = (np.array(x).T.astype(float) for x in (si.p, si.n, si.dp_du))
    size = np.linalg.norm(du, axis=1, keepdims=True)
    # a ray from just outside to a point a step along dp_du
    target = p + step * du / np.where(size > 0, size, 1)
    o = (target + 0.02 * n).astype(np.float32)
    d = (-n).astype(np.float32)
    near = mb.ray_intersect(once, mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(d.T)))
    moved = np.array(near.n).T.astype(float)
    expected = np.array(si.dn_du).T / np.where(size > 0, size, 1)
    found = hit & np.array(near.is_valid()) & (np.abs((moved * n).sum(axis=1)) > 0.99)
    error = np.abs((moved - n) / step - expected).max(axis=1)[found]
    # half the second derivative times the step, curvatures to 8, and 1e-7 / step of rounding
    assert np.median(error) < 0.01 and found.sum() > 50


def test_instances_far_away_are_as_exact():
    far = np.eye(4)
    far[:3, 3] = (8192, -4096, 2048)  # so that the rays are exact
    once, _many = scenes(mb.sphere(), far[None])
    ray = rays(5000, 3)
    ray.o *= 0.125
    ray.d = dr.normalize(-ray.o + mi.Vector3f(0.1, 0.2, 0))
    scene = mi.load_dict({"type": "scene", "s": bezier(mb.sphere())})
    here = mb.ray_intersect(scene, ray)
    o = np.array(ray.o).T + np.array([8192, -4096, 2048], dtype=np.float32)
    exact = (o - np.array([8192, -4096, 2048], dtype=np.float32) == np.array(ray.o).T).all(axis=1)
    shifted = mi.Ray3f(ray)
    shifted.o = mi.Point3f(o.T)
    there = mb.ray_intersect(once, shifted)
    # origins are rounded by 5e-4 there; t follows them, and no more
    error = np.abs(np.array(here.t) - np.array(there.t))
    assert np.quantile(error, 0.99) < 2e-3
    assert error[exact].max(initial=0) < 1e-6


def test_with_other_shapes_and_shapes_without_instances():
    matrices = maps(20)
    scene = mi.load_dict(
        {
            "type": "scene",
            "instances": {**bezier(mb.sphere()), "instances": tensor(matrices)},
            "more": {**bezier(WAVY), "instances": tensor(maps(10, seed=7))},
            "one": bezier(mb.torus()),
            "native": {"type": "sphere", "center": [4, 4, 4], "radius": 3},
        }
    )
    ray = rays(20000)
    si = mb.ray_intersect(scene, ray)
    parts = [mb.BezierTriangles.join([mb.sphere().transform(m) for m in matrices])]
    parts.append(mb.BezierTriangles.join([WAVY.transform(m) for m in maps(10, seed=7)]))
    parts.append(mb.torus())
    flat = {f"s{k}": bezier(p) for k, p in enumerate(parts)}
    flat["native"] = {"type": "sphere", "center": [4, 4, 4], "radius": 3}
    apart = mi.load_dict({"type": "scene", **flat})
    expected = mb.ray_intersect(apart, ray)
    t, u = np.array(si.t), np.array(expected.t)
    with np.errstate(invalid="ignore"):
        near = np.abs(t - u) < 1e-4
    close = near | (np.isinf(t) & np.isinf(u))
    assert close.mean() > 0.999  # the rest: silhouettes
    assert (np.array(mb.ray_test(scene, ray)) == np.isfinite(t)).all()


def test_memory_is_that_of_one():
    matrices = maps(2000)
    once = mi.load_dict(
        {"type": "scene", "s": {**bezier(mb.torus()), "instances": tensor(matrices)}}
    )
    one = mi.load_dict({"type": "scene", "s": bezier(mb.torus())})
    data, single = data_for_scene(once), data_for_scene(one)
    assert data.structure is None
    # a record, eight times two nodes, and the map
    assert data.instances.bytes - single.structure.bytes < 2000 * 700
    assert mi.traverse(once)["s.control_points"].shape[0] == len(mb.torus())


def test_a_picture():
    matrices = maps(15)
    matrices[:, :3, 3] *= 0.3
    light = {"type": "constant"}
    sensor = {
        "type": "perspective", "fov": 40,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 16], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 64},
    }  # fmt: skip
    bsdf = {"type": "twosided", "b": {"type": "diffuse"}}
    once, many = scenes(mb.sphere(), matrices, bsdf=bsdf)
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 3})
    images = []
    for scene in (once, many):
        shape = next(s for s in scene.shapes())
        whole = mi.load_dict({"type": "scene", "s": shape, "light": light, "sensor": sensor})
        images.append(np.array(mi.render(whole, integrator=integrator, seed=3)))
    # the same random numbers; paths differ where a rounding decides
    assert np.abs(images[0] - images[1]).mean() < 2e-3
    assert images[0].std() > 0.05


def test_surface_area():
    matrices = maps(5)
    shape = mi.load_dict({**bezier(mb.sphere()), "instances": tensor(matrices)})
    expected = sum(mb.sphere().transform(m).area().sum() for m in matrices)
    assert shape.surface_area()[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.zeros((2, 3, 3)), r"instances.*shape \(2, 3, 3\)"),
        (np.zeros((1, 3, 4)), "instances.*regular.*map 0"),
        (np.full((1, 4, 4), np.nan), "instances.*finite"),
        (np.eye(4)[None] * 2, "instances.*affine"),
    ],
)
def test_bad_maps(values, words):
    with pytest.raises(RuntimeError, match=words):
        mi.load_dict({**bezier(mb.sphere()), "instances": tensor(values)})


def test_bad_use(tmp_path):
    eye = tensor(np.eye(4)[None])
    with pytest.raises(RuntimeError, match="emitter"):
        mi.load_dict({**bezier(mb.sphere()), "instances": eye, "e": {"type": "area"}})
    with pytest.raises(RuntimeError, match=r"instances.*infinity"):
        plane = mb.BezierTriangles([[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]])
        mi.load_dict({**bezier(plane), "instances": eye})
    shape = mi.load_dict({**bezier(mb.sphere()), "instances": eye})
    with pytest.raises(BezierError, match="without instances"):
        shape.sample_position(0, mi.Point2f(0.5, 0.5))
    with pytest.raises(RuntimeError, match="instances_filename"):
        mi.load_dict({**bezier(mb.sphere()), "instances_filename": str(tmp_path / "none.npy")})
    np.save(tmp_path / "maps.npy", maps(3))
    np.savetxt(tmp_path / "maps.txt", maps(3)[:, :3].reshape(3, 12))
    for name in ("maps.npy", "maps.txt"):
        shape = mi.load_dict({**bezier(mb.sphere()), "instances_filename": str(tmp_path / name)})
        assert np.allclose(shape.instances, maps(3))
