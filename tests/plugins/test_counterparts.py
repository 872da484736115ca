"""Mitsuba's integrators by their own names, and other people's code, see Bézier shapes.

Pictures of balls of patches are held against those of Mitsuba's own spheres by Z-tests.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier
from render_cases import SHARE, ball, bsdfs, camera, floor, lamp, share_that_agrees

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError


def T() -> Any:
    return mi.ScalarTransform4f()


BATCHES = 16
SPP = 16


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def balls(kind: str) -> Any:
    """A diffuse ball, one of rough metal, one of glass, and one that shines."""
    glow = {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}}
    shapes = {
        f"ball{i}": ball(kind, [2.2 * i - 3.3, 0, 0], 1.0, bsdf=bsdfs()[name])
        for i, name in enumerate(bsdfs())
    }
    shapes["light"] = ball(kind, [3.3, 0, 0], 0.8, emitter=glow)
    return mi.load_dict(
        {"type": "scene", "camera": camera(64, 16), "floor": floor(), "lamp": lamp(), **shapes}
    )


def moments(kind: str, integrator: dict, seed: int) -> tuple[np.ndarray, np.ndarray]:
    scene, own = balls(kind), mi.load_dict(integrator)
    images = np.stack(
        [np.array(mi.render(scene, integrator=own, spp=SPP, seed=seed + k)) for k in range(BATCHES)]
    ).astype(np.float64)
    assert np.isfinite(images).all()
    return images.mean(axis=0), images.var(axis=0, ddof=1) * SPP


INTEGRATORS: dict[str, dict[str, Any]] = {
    "path": {"type": "path", "max_depth": 4, "hide_emitters": True},
    "volpath": {"type": "volpath", "max_depth": 4},
    "volpathmis": {"type": "volpathmis", "max_depth": 4},
    "direct": {"type": "direct"},
    "direct by emitters": {"type": "direct", "emitter_samples": 2, "bsdf_samples": 0},
    "direct by bsdf": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 3},
    "depth": {"type": "depth"},
    "aov": {"type": "aov", "aovs": "d:depth,n:sh_normal", "image": {"type": "path"}},
    "moment": {"type": "moment", "image": {"type": "path", "max_depth": 3}},
    "prb": {"type": "prb", "max_depth": 4},
    "prbvolpath": {"type": "prbvolpath", "max_depth": 4},
    "prb_projective": {"type": "prb_projective", "max_depth": 3},
    "direct_projective": {"type": "direct_projective"},
    "ptracer": {"type": "ptracer", "max_depth": 4},
}


@pytest.mark.parametrize("name", INTEGRATORS)
def test_renders_as_mitsubas_spheres(name):
    integrator = INTEGRATORS[name]
    native = moments("native", integrator, 0)
    patches = moments("octants", integrator, 1000)
    assert native[0].shape == patches[0].shape
    # 64 x 16 pixels: Mitsuba's share of 99.75 % leaves two of them
    if name == "moment":  # squares are far from normal, see `test_second_moments`
        native, patches = ((m[..., :6], v[..., :6]) for m, v in (native, patches))
    share = share_that_agrees(native, patches, SPP)
    assert share >= SHARE, f"{share:.4%}"


@pytest.mark.parametrize("inner", ["prb", "whitted", "bezierpath"])
@pytest.mark.parametrize("outer", ["aov", "moment"])
def test_integrators_in_python_may_be_nested(outer, inner):
    own = whitted()
    mi.register_integrator("whitted", lambda props: own(props))
    nested = {"type": outer, "image": {"type": inner}}
    if outer == "aov":
        nested["aovs"] = "d:depth"
    native, patches = moments("native", nested, 0), moments("octants", nested, 1000)
    own_channels = slice(0, 3)  # not squares, see `test_second_moments`
    native, patches = ((m[..., own_channels], v[..., own_channels]) for m, v in (native, patches))
    assert share_that_agrees(native, patches, SPP) >= SHARE


def test_the_comparison_sees_an_empty_picture():
    empty = mi.load_dict({"type": "scene", "c": camera(64, 16), "f": floor(), "lamp": lamp()})
    image = np.array(mi.render(empty, integrator=mi.load_dict({"type": "direct"}), spp=SPP))
    mean, variance = moments("octants", {"type": "direct"}, 0)
    assert share_that_agrees((mean, variance), (image.astype(float), variance), SPP) < 0.9


def test_second_moments():
    film = {**camera(8, 8), "sampler": {"type": "independent", "sample_count": 1}}
    scene = mi.load_dict({"type": "scene", "c": film, "b": bezier(mb.sphere()), "lamp": lamp()})
    integrator = mi.load_dict({"type": "moment", "image": {"type": "path"}})
    image = np.array(mi.render(scene, integrator=integrator, spp=1))  # one sample: its square
    assert image[..., 3:6].max() > 0.01
    assert np.allclose(image[..., 6:9], image[..., 3:6] ** 2, rtol=1e-6)


def test_names_in_files_and_without_counterparts():
    xml = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="3"/>
    </integrator>{}<emitter type="constant"/><sensor type="perspective"><film type="hdrfilm">
    <integer name="width" value="8"/><integer name="height" value="8"/></film>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    </sensor></scene>"""
    scene = mi.load_string(xml.format('<shape type="sphere"/>'))
    assert type(scene.integrator()).__module__ == "mitsuba"  # Mitsuba's own object
    assert np.array(mi.render(scene, spp=4))[4, 4, 0] < 0.9
    with pytest.raises(RuntimeError, match="max_dpth"):
        mi.load_dict({"type": "path", "max_dpth": 3})


def test_scenes_without_bezier_shapes_are_untouched():
    scene = balls("native")
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    images = []
    for on in (True, False):
        with mb.native(on):
            images.append(np.array(mi.render(scene, integrator=integrator, spp=4, seed=3)))
    assert (images[0] == images[1]).all()


def test_turned_off_nothing_is_seen():
    scene = mi.load_dict(
        {"type": "scene", "sky": {"type": "constant"}, "c": camera(8, 8), "b": bezier(mb.sphere())}
    )
    integrator = mi.load_dict({"type": "path"})
    ray = mi.Ray3f([0.1, 0.2, -5], [0, 0, 1])
    assert np.array(mi.render(scene, integrator=integrator, spp=4)).min() < 0.9
    assert scene.ray_test(ray)[0]
    with mb.native(False):
        assert np.array(mi.render(scene, integrator=integrator, spp=4)).min() > 0.99
        assert not scene.ray_test(ray)[0]
    assert scene.ray_test(ray)[0]
    mb.native(False)  # without a block: until it is turned on again
    assert not scene.ray_test(ray)[0]
    mb.native(True)


@pytest.mark.parametrize("other", ["llvm_ad_mono", "scalar_rgb"])
def test_a_variant_changed_under_a_live_scene(other):
    path = {"type": "path", "max_depth": 3}
    sphere = bezier(mb.sphere())
    sky = {"type": "constant"}
    make = {"type": "scene", "c": camera(8, 8), "b": sphere, "sky": sky, "path": path}
    scene = mi.load_dict(make)
    shape, integrator = scene.shapes()[0], scene.integrator()
    before = np.array(mi.render(scene, spp=4))
    ray = mi.Ray3f([0, 0, -4], [0, 0, 1])
    said = f"variant: expected llvm_ad_rgb, in which the shapes were loaded .*, got {other}"
    try:
        mi.set_variant(other)
        with pytest.raises(mb.VariantError, match=said):
            mi.render(scene, spp=4)
        for ask in (
            lambda: integrator.render(scene, spp=4),
            lambda: scene.ray_test(ray),
            lambda: shape.ray_test(ray),
            lambda: mb.ray_test(scene, ray),
        ):
            with pytest.raises(mb.VariantError):
                ask()
        native = mi.load_dict({**make, "b": {"type": "sphere"}})
        assert np.array(mi.render(native, spp=1)).max() > 0
    finally:
        mi.set_variant(VARIANT)
    assert (np.array(mi.render(scene, spp=4)) == before).all()  # and all is as it was


def test_an_unknown_integrator_is_an_error():
    from mitsuba_bezier.plugins.native import counterparts

    scene = mi.load_dict({"type": "scene", "c": camera(8, 8), "b": bezier(mb.sphere())})
    path = mi.load_dict({"type": "path"})
    del counterparts._made[
        mi.variant(), path.ptr
    ]  # as if it had been made before the package was imported
    with pytest.raises(BezierError, match=r"sees Bézier shapes: path, .* got PathIntegrator"):
        path.render(scene)


# ---------------------------------------------------------------- other people's code


def whitted() -> type:
    """Return a user's integrator: direct light by the scene's own methods."""

    class Whitted(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            valid = si.is_valid()
            emitted = si.emitter(scene).eval(si, active)
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, valid)
            value = si.bsdf(ray).eval(mi.BSDFContext(), si, si.to_local(ds.d), valid)
            return emitted + dr.select(valid & (ds.pdf > 0), value * weight, 0.0), valid, []

    return Whitted


def test_an_integrator_that_nobody_here_wrote():
    own = whitted()
    mi.register_integrator("whitted", lambda props: own(props))
    integrator = {"type": "whitted"}
    native, patches = moments("native", integrator, 0), moments("tetrahedral", integrator, 500)
    assert share_that_agrees(native, patches, SPP) >= SHARE


def both(**more: Any) -> tuple[Any, Any]:
    """Return a scene with Mitsuba's sphere and one with patches, beside a wall of Mitsuba's."""
    wall = {"type": "rectangle", "to_world": T().translate([0, 0, 3]).scale(9)}
    return tuple(
        mi.load_dict({"type": "scene", "wall": wall, "ball": shape, **more})
        for shape in ({"type": "sphere"}, bezier(mb.sphere()))
    )


def rays(count: int = 4000) -> Any:
    rng = np.random.default_rng(7)
    o = rng.normal(size=(count, 3)) * 0.6 + [0, 0, -4]
    d = rng.normal(size=(count, 3)) * 1.2 - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return mi.Ray3f(mi.Point3f(np.float32(o.T)), mi.Vector3f(np.float32(d.T)))


QUERIES = {
    "ray, active": lambda s, r: s.ray_intersect(r, mi.Bool(True)),
    "flags": lambda s, r: s.ray_intersect(r, mi.RayFlags.All, False),
    "flags, active": lambda s, r: s.ray_intersect(r, int(mi.RayFlags.All), True, mi.Bool(True)),
    "reorder": lambda s, r: s.ray_intersect(
        r, ray_flags=mi.RayFlags.All, coherent=False, reorder=True, active=True
    ),
    "preliminary": lambda s, r: s.ray_intersect_preliminary(r).compute_surface_interaction(r),
    "preliminary with all arguments": lambda s, r: s.ray_intersect_preliminary(
        r, False, False, 0, 0, mi.Bool(True)
    ).compute_surface_interaction(r, mi.RayFlags.All, True),
}


@pytest.mark.parametrize("name", QUERIES)
def test_queries_of_scenes(name):
    native, patches = both()
    ray = rays()
    a, b = (QUERIES[name](scene, ray) for scene in (native, patches))
    hit = np.isfinite(np.array(a.t))
    assert 0.2 < (np.array(a.p.z)[hit] < 2).mean() < 0.95  # both the ball and the wall are met
    # float32 on both sides, some 5 units away: ten roundings of 5 over a cosine of 0.2
    steep = hit & (np.abs(np.array(a.wi.z)) > 0.2)
    assert (np.isfinite(np.array(b.t)) == hit)[steep].all()
    assert np.abs(np.array(a.t) - np.array(b.t))[steep].max() < 1.5e-5
    assert np.abs(np.array(a.n) - np.array(b.n))[:, steep].max() < 1.5e-5
    for active in (False, mi.Bool(False)):
        assert not dr.any(patches.ray_intersect(ray, active).is_valid())
        assert not dr.any(patches.ray_test(ray, active))
    seen = np.array(native.ray_test(ray)) == np.array(patches.ray_test(ray, True, mi.Bool(True)))
    assert seen[steep].all()


def test_preliminary_hits_of_several_scenes_at_once():
    ray = rays(500)
    scenes = [mi.load_dict({"type": "scene", "b": bezier(mb.sphere(radius=r))}) for r in (0.5, 1.0)]
    found = [scene.ray_intersect_preliminary(ray) for scene in scenes]
    for scene, pi in zip(scenes, found):
        si, want = pi.compute_surface_interaction(ray), mb.ray_intersect(scene, ray)
        assert (np.array(si.t) == np.array(want.t)).all()
        assert (np.array(si.p) == np.array(want.p)).all()


def test_many_scenes_alive(monkeypatch):
    from mitsuba_bezier.plugins import scene_data

    radii = np.linspace(0.3, 1.0, 12)  # more than a few
    scenes = [mi.load_dict({"type": "scene", "b": bezier(mb.sphere(radius=r))}) for r in radii]
    ray = mi.Ray3f([0, 0, -4], [0, 0, 1])
    found = [scene.ray_intersect_preliminary(ray) for scene in scenes]
    built = []
    make = scene_data.SceneData.__init__
    monkeypatch.setattr(
        scene_data.SceneData, "__init__", lambda *args: built.append(1) or make(*args)
    )
    for scene, pi, radius in zip(scenes, found, radii):
        t = pi.compute_surface_interaction(ray).t
        assert float(t[0]) == pytest.approx(4 - radius, abs=2e-6)
        assert scene.ray_test(ray)[0]
    assert not built  # scenes in turn are not built again and again
    # beyond so much memory only a few are kept
    monkeypatch.setattr(scene_data, "_CACHE_BYTES", 1)
    mi.load_dict(bezier(mb.sphere())).ray_test(ray)
    assert len(scene_data.known_data()) <= 8


def test_a_preliminary_hit_outlives_its_scene():
    shape = mi.load_dict(bezier(mb.sphere()))
    scene = mi.load_dict({"type": "scene", "s": shape})
    ray = mi.Ray3f([0.1, 0.2, -5], [0, 0, 1])
    del scene
    p = shape.ray_intersect_preliminary(ray).compute_surface_interaction(ray).p
    assert np.allclose(np.array(p).ravel(), [0.1, 0.2, -np.sqrt(0.95)], atol=1e-6)


def lights(kind: str) -> Any:
    glow = {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}}
    return mi.load_dict(
        {"type": "scene", "lamp": lamp(), "b": ball(kind, [0.5, 0, 0], 0.8, emitter=glow)}
    )


def points(count: int) -> Any:
    rng = np.random.default_rng(3)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p = mi.Point3f(np.float32(rng.normal(size=(3, count)) * 0.3 + [[0], [-3], [0]]))
    si.n = mi.Normal3f(0, 1, 0)
    return si


def test_sampling_of_emitters():
    count = 200_000
    si = points(count)
    irradiance, densities = [], []
    for kind in ("native", "octants"):
        scene = lights(kind)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, count)
        ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True)
        value = np.array(weight)[0] * np.maximum(np.array(ds.d)[1], 0)
        irradiance.append((value.mean(), value.std() / np.sqrt(count)))
        densities.append(np.array(scene.pdf_emitter_direction(si, ds)) / np.array(ds.pdf))
    (a, da), (b, db) = irradiance
    # area sampling of patches against cone sampling of the sphere: the mean is the same
    assert abs(a - b) < 4 * np.hypot(da, db)
    good = np.isfinite(densities[1])
    assert good.mean() > 0.4  # the others are hidden
    # float32: the density of a point near the outline changes as one over the cosine
    assert np.quantile(np.abs(densities[1][good] - 1), 0.999) < 1e-3


def test_rays_that_leave_emitters():
    count = 200_000
    flux = []
    for kind in ("native", "octants"):
        scene = lights(kind)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, count)
        ray, weight, _emitter = scene.sample_emitter_ray(
            0.0, sampler.next_1d(), sampler.next_2d(), sampler.next_2d(), True
        )
        value = np.array(weight)[0]
        flux.append((value.mean(), value.std() / np.sqrt(count)))
        centred = np.array(ray.o).T - [0.5, 0, 0]
        ours = np.linalg.norm(centred, axis=1) < 0.9
        assert ours.mean() == pytest.approx(0.5, abs=0.01)  # both emitters are as likely
        outward = (np.array(ray.d).T * centred).sum(axis=1)[ours]
        assert outward.min() > -1e-5
    assert abs(flux[0][0] - flux[1][0]) < 4 * np.hypot(flux[0][1], flux[1][1])


def test_light_along_normals():
    lamp = {"type": "directionalarea", "radiance": {"type": "rgb", "value": 1.0}}
    scene = mi.load_dict({"type": "scene", "d": bezier(mb.disk(), emitter=lamp)})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1000)
    ray, weight, _emitter = scene.sample_emitter_ray(
        0.0, sampler.next_1d(), sampler.next_2d(), sampler.next_2d(), True
    )
    assert np.allclose(np.array(ray.d).T, [0, 0, 1], atol=1e-6)
    # radiance times the area, whatever the density
    assert np.array(weight)[0].mean() == pytest.approx(np.pi, rel=1e-2)


# ---------------------------------------------------------------- derivatives


@pytest.mark.parametrize("name", ["prb", "prb_basic", "prb_projective"])
def test_derivatives_by_mitsubas_names(name):
    # a lit plate that is lifted towards the lamp: no outline is seen
    net = mb.disk().transform(np.diag([6.0, 6.0, 6.0, 1.0])).control_points
    eye = {
        "type": "perspective",
        "fov": 20,
        "to_world": T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
    }
    place = T().translate([0, 0, 2]).rotate([1, 0, 0], 180)
    light = {"type": "rectangle", "to_world": place.scale(0.5 if name != "prb_basic" else 3.0)}
    light["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    scene = mi.load_dict({"type": "scene", "plate": bezier(net), "light": light, "eye": eye})
    # the lamp is seen from behind, and would hide some of the plate
    integrator = mi.load_dict({"type": name, "max_depth": 2, "hide_emitters": True})
    params = mi.traverse(scene)
    key = "plate.to_world"

    def mean(lift: Any) -> Any:
        params[key] = mi.Transform4f().translate(mi.Point3f(0, 0, lift))
        params.update()
        image = mi.render(scene, params, integrator=integrator, spp=256, seed=1, seed_grad=2)
        return dr.mean(image, axis=None)

    lift = mi.Float(0.0)
    dr.enable_grad(lift)
    value = mean(lift)
    dr.backward(value)
    got = float(dr.grad(lift)[0])
    above, below = (float(mean(mi.Float(x)).array[0]) for x in (0.05, -0.05))
    want = (above - below) / 0.1
    # the differences' own error, of second order in the step, is below 1 %; the rest is noise
    assert got == pytest.approx(want, rel=0.05)


# ---------------------------------------------------------------- what a shape is asked for


def test_irradiance_meter_and_distant_sensor():
    film = {"type": "hdrfilm", "width": 1, "height": 1, "pixel_format": "luminance"}
    film["rfilter"] = {"type": "box"}
    white = {"type": "rgb", "value": 1.0}
    plate = {
        "type": "rectangle",
        "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(2),
        "emitter": {"type": "area", "radiance": white},
    }
    read, seen = [], []
    disks = [{"type": "disk"}, bezier(mb.disk())]
    for disk in disks:
        scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 3}, "plate": plate}
        scene["disk"] = {**disk, "meter": {"type": "irradiancemeter", "film": film}}
        read.append(float(np.array(mi.render(mi.load_dict(scene), spp=40_000)).ravel()[0]))
        del scene["plate"]
        scene["disk"] = {**disk, "bsdf": {"type": "diffuse"}}
        scene["sky"] = {"type": "constant"}
        scene["eye"] = {"type": "distant", "direction": [0, 0, -1], "target": disk, "film": film}
        seen.append(float(np.array(mi.render(mi.load_dict(scene), spp=10_000)).ravel()[0]))
    # Mitsuba's own disk beside it; standard errors are below 0.5 %
    assert read[1] == pytest.approx(read[0], rel=0.02)
    assert seen[1] == pytest.approx(0.5, rel=0.02)
    assert seen[0] == pytest.approx(0.5, rel=0.02)


def test_groups_of_shapes_are_an_error():
    with pytest.raises(RuntimeError, match=r"shapegroup: .* parameter `instances`"):
        mi.load_dict({"type": "shapegroup", "ball": bezier(mb.sphere())})
    mi.load_dict({"type": "shapegroup", "ball": {"type": "sphere"}})


def test_parameters_and_boxes_of_a_patch(tmp_path):
    patch = mi.load_dict(bezier(mb.sphere().control_points[:1]))
    uv = mi.Point2f([0.2, 0.3, 0.9], [0.3, 0.6, 0.9])
    si = patch.eval_parameterization(uv)
    assert (np.array(si.is_valid()) == [True, True, False]).all()
    points = patch.patches.points([0, 0], np.array(uv).T[:2])
    assert np.allclose(np.array(si.p).T[:2], points, atol=1e-6)
    ball = mi.load_dict(bezier(mb.sphere()))
    with pytest.raises(BezierError, match="eval_parameterization: expected a shape of one patch"):
        ball.eval_parameterization(uv)
    assert ball.primitive_count() == 8
    box = ball.bbox(0)
    low, high = ball.patches.bounds()[0]
    assert np.allclose([box.min, box.max], [low, high], atol=1e-3)
    with pytest.raises(BezierError, match="index: expected 0 to 7, got 8"):
        ball.bbox(8)
    ball.write_ply(str(tmp_path / "ball.ply"))
    mesh = mi.load_dict({"type": "ply", "filename": str(tmp_path / "ball.ply")})
    # a chord error of a thousandth of the diagonal takes some parts in a thousand of the area
    assert float(mesh.surface_area()[0]) == pytest.approx(4 * np.pi, rel=0.02)


# ---------------------------------------------------------------- nets in dictionaries


@pytest.mark.parametrize("form", ["net", "array", "list", "shape"])
def test_nets_as_values(form):
    ball = mb.sphere(cover="tetrahedral")
    net = {"net": ball, "array": ball.control_points, "list": ball.control_points.tolist()}
    given = mb.shape(ball, flip_normals=True)
    if form != "shape":
        given = {"type": "beziertriangle", "control_points": net[form], "flip_normals": True}
    scene = mi.load_dict({"type": "scene", "s": given})
    shape = scene.shapes()[0]
    assert (shape.patches.control_points == ball.control_points).all()  # all of float64
    assert "control_points" in given  # nothing of the caller's is changed
    with pytest.raises(mb.NetError, match="control_points: expected an array of numbers"):
        mi.load_dict({"type": "beziertriangle", "control_points": [["a"]]})


def test_shape_of_a_file(tmp_path):
    mb.save(mb.sphere(), tmp_path / "ball.vtu")
    scene = mi.load_dict({"type": "scene", "s": mb.shape(tmp_path / "ball.vtu")})
    assert scene.ray_test(mi.Ray3f([0, 0, -4], [0, 0, 1]))[0]


def test_three_patches_are_no_point(capfd):
    net = mb.sphere().control_points[:3]
    for value in (net, mb.BezierTriangles(net), net.tolist()):
        shape = mi.load_dict(mb.shape(value))
        assert (shape.patches.control_points == net).all()
    assert "implicit conversion" not in capfd.readouterr().err
