"""Modulation transfer, foci of the field, and the charts that the command draws of them."""

from __future__ import annotations

import numpy as np
import pytest
from optics_cases import lens_of, recorded

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import PrescriptionError
from mitsuba_bezier.optics import (
    Abbe,
    Constant,
    Lens,
    Surface,
    arrivals,
    beam,
    diffraction_limit,
    field_curvature,
    first_order,
    mtf,
    trace,
)
from mitsuba_bezier.optics.mtf import transfer

REPORT = recorded()

TABLE = """# title: a triplet
# aperture: f_number 5
# wavelengths: 0.6563 0.5876 0.4861
# reference: 2
# fields: 0 7 10
radius, thickness, nd, vd, semi_diameter, stop
22.01359, 3.25896, 1.62041, 60.32, 9.5,
-435.76044, 6.00755, , , 9.5,
-22.21328, 0.99997, 1.62004, 36.37, 5, yes
20.29192, 4.75041, , , 5,
79.68360, 2.95208, 1.62041, 60.32, 7.5,
-18.39533, 42.20778, , , 7.5,
"""


def paraboloid(defocus=0.0, diameter=20.0):
    """Return a perfect mirror on its axis, f = 100, whose image plane is off by `defocus`."""
    surface = Surface(-1 / 200, -100 - defocus, mirror=True, conic=-1, semi_diameter=15, stop=True)
    return Lens([surface], aperture=("diameter", diameter))


def bessel(order, x):
    """Return J of order 0 or 1 by its integral, ``1 / pi int cos(order t - x sin t) dt``."""
    t = (np.arange(400) + 0.5) * np.pi / 400
    return np.cos(order * t - np.asarray(x)[..., None] * np.sin(t)).mean(axis=-1)


def test_a_defocused_perfect_beam_is_a_blur_disc():
    lens = paraboloid(0.5)
    f = np.linspace(0.5, 60, 40)
    curve = mtf(lens, frequencies=f)
    # a ray at height h meets the plane at h dz / (f - h^2 / 4 f): an even disc to 0.25 %, so it is
    # summed over rings of the stop, by Gauss and Legendre's rule in h^2
    x, w = np.polynomial.legendre.leggauss(100)
    h = 10 * np.sqrt((x + 1) / 2)
    radius = 0.5 * h / (100 - h * h / 400)
    exact = np.abs(bessel(0, 2 * np.pi * f[:, None] * radius) @ w / 2)
    assert curve.tangential == pytest.approx(exact, abs=1e-9)
    assert curve.sagittal == pytest.approx(exact, abs=1e-9)
    x = 2 * np.pi * f * 0.05
    assert curve.tangential == pytest.approx(np.abs(2 * bessel(1, x) / x), abs=4e-3)


def test_in_focus_a_perfect_lens_keeps_all_contrast():
    lens = paraboloid()
    curve = mtf(lens, frequencies=[0, 100, 200, 400])
    assert curve.tangential == pytest.approx(np.ones(4), abs=1e-9)
    # N = 5, 0.5876 micrometres: no contrast from 340 periods in a millimetre on
    cutoff = 1 / (0.5875618e-3 * 5)
    assert curve.diffraction[-1] == 0
    # of half the cutoff: 2 / pi (pi / 3 - sqrt(3) / 4)
    half = diffraction_limit(lens, [cutoff / 2])[0]
    assert half == pytest.approx(2 / 3 - np.sqrt(3) / (2 * np.pi), rel=1e-12)
    assert mtf(lens, frequencies=[30], defocus=-0.5).tangential[0] == pytest.approx(
        mtf(paraboloid(0.5), frequencies=[30]).tangential[0], abs=1e-12
    )


def test_lengths_in_other_units_are_the_same_lens():
    lens = paraboloid(0.5)
    inch = Lens(lens.scaled(1 / 25.4).surfaces, aperture=("diameter", 20 / 25.4), unit="in")
    a, b = mtf(lens, frequencies=[30]), mtf(inch, frequencies=[30 * 25.4])
    assert b.tangential == pytest.approx(a.tangential, rel=1e-9)
    assert b.diffraction == pytest.approx(a.diffraction, rel=1e-9)


def test_wavelengths_count_by_their_weights():
    surfaces = [
        Surface(1 / 50, 4, Abbe(1.62, 36.37), 5, stop=True),
        Surface(-1 / 50, 38.0, semi_diameter=5),
    ]
    waves = (0.4861, 0.6563)
    lens = Lens(surfaces, wavelengths=waves, weights=(1, 3))
    f = np.array([4.0])

    def amplitude(w):
        rays = arrivals(lens, wavelength=w)
        return rays.weights @ np.exp(-2j * np.pi * f * rays.points[:, 0])

    mean = abs(amplitude(waves[0]) + 3 * amplitude(waves[1])) / 4
    assert mtf(lens, frequencies=f).tangential[0] == pytest.approx(mean, abs=1e-12)
    assert mtf(lens, frequencies=f, wavelength=0.4861).tangential[0] != pytest.approx(
        mean, abs=0.05
    )


@pytest.mark.parametrize("name", REPORT)
def test_foci_are_those_of_optiland(name):
    record = REPORT[name]
    heights = np.linspace(0, record["field"], len(record["foci"][0]))
    foci = field_curvature(lens_of(record), [(0, h) for h in heights], aim=False)
    # Optiland's rays are 1e-5 of the pupil beside the chief ray: rounding of 1e-15 over that, and
    # over the aperture of f/8, is 1e-9; ours are off by the square of 1e-4
    scale = abs(record["focal_length"])
    assert foci.tangential == pytest.approx(record["foci"][0], abs=1e-7 * scale)
    assert foci.sagittal == pytest.approx(record["foci"][1], abs=1e-7 * scale)


@pytest.mark.parametrize("name", REPORT)
def test_modulation_is_that_of_optiland(name):
    record = REPORT[name]
    lens = lens_of(record)
    for height, (tangential, sagittal) in zip((0, record["field"]), record["mtf"]):
        rays = arrivals(lens, (0, height), aim=False)
        got = transfer(rays, np.array(record["frequencies"]))
        # its grid of 200 x 200 squares fills the round pupil to 0.5 % of its rim
        assert got[0] == pytest.approx(tangential, abs=5e-3)
        assert got[1] == pytest.approx(sagittal, abs=5e-3)


def test_foci_of_a_tilted_narrow_beam_are_those_of_coddington():
    # one refracting sphere whose stop is on it: n' cos^2 t' / s' = n cos^2 t / s + (n' cos t' - n
    # cos t) / r, and the same without squares for the sagittal focus
    n, r, angle = 1.6, 40.0, np.radians(25)
    lens = Lens([Surface(1 / r, 100, Constant(n), 2, stop=True)], fields=[(0, 25)])
    inside = np.arcsin(np.sin(angle) / n)
    power = (n * np.cos(inside) - np.cos(angle)) / r
    tangential, sagittal = n * np.cos(inside) ** 2 / power, n / power
    foci = field_curvature(lens, [(0, 25)])
    # to the square of the pupil's 1e-4, and rounding of 1e-15 over it
    assert foci.tangential[0] == pytest.approx(tangential * np.cos(inside) - 100, abs=1e-6)
    assert foci.sagittal[0] == pytest.approx(sagittal * np.cos(inside) - 100, abs=1e-6)
    # the field may lie in any direction
    skew = field_curvature(lens, [(25, 0)])
    assert skew.tangential[0] == pytest.approx(foci.tangential[0], abs=1e-6)
    assert skew.sagittal[0] == pytest.approx(foci.sagittal[0], abs=1e-6)


def test_a_spot_is_smallest_where_it_is_said_to_be():
    lens = paraboloid(0.5)
    rays = arrivals(lens, (0, 0.5))
    best = rays.best()
    assert rays.rms(best) < min(rays.rms(best - 1e-3), rays.rms(best + 1e-3))
    o, d = beam(lens, (0, 0.5))
    assert rays.rms() == pytest.approx(
        trace(lens, o, d).points[-1][:, :2].std(axis=0).dot([1, 1]), rel=0.5
    )


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: mtf(paraboloid(), frequencies=[-1.0]), "frequencies: expected numbers from 0"),
        (lambda: mtf(paraboloid(), frequencies=[]), "frequencies: expected numbers from 0"),
        (lambda: mtf(paraboloid(), frequencies=[1], defocus=np.nan), "defocus: expected a finite"),
        (lambda: field_curvature(paraboloid()), "fields: expected one off the axis"),
        (lambda: field_curvature(paraboloid(), [1.0]), "fields: expected finite pairs"),
        (
            lambda: mtf(Lens([Surface(0, 10, semi_diameter=3)]), frequencies=[1]),
            "lens: expected one that forms an image",
        ),
    ],
)
def test_what_cannot_be_is_one_error(call, message):
    with pytest.raises(PrescriptionError, match=message):
        call()


def test_the_command_draws_every_chart(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    path = tmp_path / "triplet.csv"
    path.write_text(TABLE)
    names = ("mtf", "distortion", "field-curvature", "focus")
    words = [w for name in names for w in (f"--{name}", str(tmp_path / f"{name}.svg"))]
    assert main(["lens", str(path), *words, "--frequency", "40"]) == 0
    for name in names:
        assert (tmp_path / f"{name}.svg").read_text().count("<path") > 10
    assert main(["lens", str(path), "--mtf", str(tmp_path / "a.png")]) == 0
    head = (tmp_path / "a.png").read_bytes()[:24]
    assert int.from_bytes(head[16:20], "big") == 1600  # pixels wide
    for words, told in (
        (["--mtf", "a.gif"], "--mtf: expected a file .svg, .png, .pdf, got 'a.gif'"),
        (["--focus", str(tmp_path / "no/a.svg")], "--focus"),
        (["--mtf", "a.svg", "--focus", "./a.svg"], "--focus: expected a file of its own"),
        (["--frequency", "nan"], "--frequency: expected a positive number, got nan"),
    ):
        capsys.readouterr()
        assert main(["lens", str(path), *words]) == 2
        error = capsys.readouterr().err.strip()
        assert told in error and "\n" not in error


def test_first_order_data_are_json_even_of_an_afocal_lens(tmp_path, capsys):
    import json

    path = tmp_path / "window.csv"
    path.write_text("radius, thickness, nd, semi_diameter\n0, 5, 1.5, 9\n0, 10, , 9\n")
    assert main(["lens", str(path), "--json"]) == 0
    data = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert data["focal_length"] is None and data["length"] == 5
    assert not np.isfinite(first_order(Lens([Surface(0, 5)])).focal_length)
