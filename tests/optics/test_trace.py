"""Ray traces against laws and closed forms: Snell's, foci of conics, a prism."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import PrescriptionError
from mitsuba_bezier.optics import (
    Constant,
    Lens,
    Surface,
    beam,
    first_order,
    pupil_grid,
    spot,
    trace,
)
from mitsuba_bezier.optics.frames import shift, turn
from mitsuba_bezier.optics.trace import meet, normals

#: Roundings of float64 in lengths of some hundred.
ROUNDING = 1e-12


def parallel(radius: float, z: float = -50.0, count: int = 41) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    xy = radius * rng.uniform(-0.7, 0.7, (count, 2))
    o = np.concatenate([xy, np.full((count, 1), z)], axis=1)
    return o, np.tile([0.0, 0.0, 1.0], (count, 1))


def test_a_hyperboloid_behind_glass_focuses_a_parallel_beam_to_a_point():
    # flat in, hyperbolic out with k = -n^2: Descartes (La dioptrique, 1637)
    n = 1.5
    lens = Lens(
        [
            Surface(0.0, 10, Constant(n), 20),
            Surface(-1 / 50, 100.0, conic=-(n**2), semi_diameter=20),
        ]
    )
    focus = trace(lens, *parallel(20)).points[-1]
    # the focal length of the back surface is R / (n - 1) = 100
    assert np.abs(focus[:, :2]).max() < ROUNDING * 100


@pytest.mark.parametrize("conic, focus", [(-1.0, -100.0)])
def test_a_paraboloid_focuses_a_parallel_beam(conic, focus):
    mirror = Lens([Surface(-1 / 200, focus, mirror=True, conic=conic, semi_diameter=80)])
    assert np.abs(trace(mirror, *parallel(80)).points[-1][:, :2]).max() < ROUNDING * 100


def test_a_ritchey_chretien_pair_has_no_coma():
    # primary and secondary of conics that correct spherical aberration and coma (Schroeder,
    # *Astronomical Optics*, 2000, table 6.5): k = 0.25, m = 4, back focal distance 0.2 f1
    f1, k, m, beta = 1000.0, 0.25, 4.0, 0.25
    k1 = -1 - 2 * (1 + beta) / (m**2 * (m - beta))
    k2 = -(((m + 1) / (m - 1)) ** 2) - 2 * m * (m + 1) / ((m - beta) * (m - 1) ** 3)
    d = f1 * (m - beta) / (m + 1)
    r2 = 2 * (f1 - d) * m / (m - 1)
    back = m * (f1 - d)
    lens = Lens(
        [
            Surface(-1 / (2 * f1), -d, mirror=True, conic=k1, semi_diameter=100, stop=True),
            Surface(-1 / r2, back, mirror=True, conic=k2),
        ],
        aperture=("diameter", 200.0),
    )
    assert k == pytest.approx((f1 - d) / f1, abs=1e-12)
    assert first_order(lens).focal_length == pytest.approx(m * f1, rel=1e-12)
    rim = np.array([[0, 1], [0, -1], [1, 0], [-1, 0]], float)
    result = trace(lens, *beam(lens, (0, 0.05), np.concatenate([[[0, 0]], rim])))
    y = result.local[-1][:, 1]
    coma = (y[1] + y[2]) / 2 - y[0]
    sphere = Lens(
        [*(Surface(**{**vars(s), "conic": 0.0}) for s in lens.surfaces)], aperture=lens.aperture
    )
    y0 = trace(sphere, *beam(sphere, (0, 0.05), np.concatenate([[[0, 0]], rim]))).local[-1][:, 1]
    # of third order there is none; a thousandth of the spherical pair's is of the fifth
    assert abs(coma) < 1e-3 * abs((y0[1] + y0[2]) / 2 - y0[0])


def test_a_prism_turns_light_by_snells_law():
    n, apex = 1.52, 60.0
    lens = Lens(
        [
            Surface(
                0.0, 0.0, Constant(n), before=turn(apex / 2), after=np.linalg.inv(turn(apex / 2))
            ),
            Surface(
                0.0, 5.0, before=shift(z=10) @ turn(-apex / 2), after=np.linalg.inv(turn(-apex / 2))
            ),
        ]
    )
    angle = np.radians(48.0)  # of incidence on the first face
    # the first face's normal, and a ray at that angle to it
    normal = lens.frames()[0][:3, 2]
    # away from the edge, which is where the second face meets the first
    away = np.arctan2(normal[1], normal[2]) - np.sign(normal[1]) * angle
    d = np.array([0, np.sin(away), np.cos(away)])
    out = trace(lens, [-10 * d], [d]).directions[-1][0]
    turned = np.arccos(np.clip(out @ d, -1, 1))
    inside = np.arcsin(np.sin(angle) / n)
    second = np.radians(apex) - inside
    expected = angle + np.arcsin(n * np.sin(second)) - np.radians(apex)
    assert turned == pytest.approx(expected, abs=1e-13)


def test_aspheres_are_met_where_their_sag_is():
    rng = np.random.default_rng(1)
    s = Surface(1 / 30, coefficients=(1e-4, 2e-6, -3e-9, 1e-12), conic=-0.4, semi_diameter=12)
    o = np.concatenate([rng.uniform(-8, 8, (500, 2)), np.full((500, 1), -20.0)], axis=1)
    d = np.concatenate([rng.uniform(-0.2, 0.2, (500, 2)), np.ones((500, 1))], axis=1)
    t = meet(s, o, d)
    p = o + t[:, None] * d
    assert np.abs(p[:, 2] - s.sag(np.hypot(p[:, 0], p[:, 1]))).max() < 1e-13
    step = 1e-5
    r = np.hypot(p[:, 0], p[:, 1])
    slope = (s.sag(r + step) - s.sag(r - step)) / (2 * step)
    n = normals(s, p)
    # central differences are good to step^2 times the third derivative, 1e-12 here
    assert np.abs(-np.hypot(n[:, 0], n[:, 1]) / n[:, 2] * np.sign(-slope) - slope).max() < 1e-9


def test_total_reflection_and_misses_end_rays():
    lens = Lens([Surface(0.0, 1, Constant(1.5)), Surface(0.0, 1, before=turn(50))])
    assert trace(lens, [[0, 0, -1]], [[0, 0, 1]]).stopped.tolist() == [1]
    ball = Lens([Surface(1 / 5, 1, Constant(1.5))])
    assert trace(ball, [[0, 6, -1]], [[0, 0, 1]]).stopped.tolist() == [0]
    small = Lens([Surface(0.0, 1, semi_diameter=2, inner=0.5)])
    assert trace(small, [[0, y, -1] for y in (0, 1, 3)], [[0, 0, 1]] * 3).valid.tolist() == [
        False, True, False,
    ]  # fmt: skip


def test_the_optical_path_to_a_focus_is_the_same_for_all_rays():
    mirror = Lens([Surface(-1 / 200, -100, mirror=True, conic=-1, semi_diameter=80)])
    path = trace(mirror, *parallel(80)).path
    assert np.ptp(path) < ROUNDING * 100


def test_rays_are_aimed_at_the_real_stop():
    lens = Lens(
        [
            Surface(1 / 20, 5, Constant(1.7), 15),
            Surface(0, 8, semi_diameter=15),
            Surface(0, 20, stop=True),
        ],
        aperture=("diameter", 10.0),
        fields=[(0, 12)],
    )
    size = first_order(lens).stop_semi_diameter
    pupil = np.array([[0, 1], [0.6, -0.8], [0, 0]])
    at = trace(lens, *beam(lens, (0, 12), pupil)).local[2][:, :2]
    assert np.abs(at - size * pupil).max() < 1e-9 * size
    paraxial = trace(lens, *beam(lens, (0, 12), pupil, aim=False)).local[2][:, :2]
    assert np.abs(paraxial - size * pupil).max() > 1e-3 * size


@pytest.mark.parametrize("size", [5.0, 7.3, 11.1, 25.0])
def test_rays_aimed_at_a_rim_pass(size):
    mirror = Surface(-1 / 200, -101, mirror=True, conic=-1, semi_diameter=size)
    for rings in (3, 6, 11):
        found = spot(Lens([mirror]), pupil=pupil_grid(rings))
        assert found.transmitted == 1
        # 1 mm behind the focus, to which the ray from the rim has 100 - size^2 / 400 to go
        assert found.radius == pytest.approx(size / (100 - size**2 / 400), rel=1e-12)
    # no more than rounding: a micrometre beyond a rim is outside of it
    ring = Lens([Surface(0.0, 1, semi_diameter=size, inner=size / 2)])
    heights = [size, size + 1e-3, size / 2, size / 2 - 1e-3]
    passed = trace(ring, [[0, y, -1] for y in heights], [[0, 0, 1]] * 4).valid
    assert passed.tolist() == [True, False, True, False]


def test_arrays_of_other_shapes_are_refused():
    with pytest.raises(PrescriptionError, match=r"expected two arrays \(N, 3\)"):
        trace(Lens([Surface()]), [0, 0, 1], [0, 0, 1])
    with pytest.raises(PrescriptionError, match="expected one from which rays arrive"):
        spot(
            Lens(
                [Surface(0, 1), Surface(before=shift(9), semi_diameter=1)], aperture=("diameter", 2)
            )
        )
