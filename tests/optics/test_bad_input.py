"""What a user may get wrong in Python: one error that names the parameter and what came."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import PrescriptionError
from mitsuba_bezier.optics import (
    Abbe,
    Constant,
    Lens,
    Surface,
    absorbing,
    barrel_shapes,
    beam,
    camera_frame,
    distortion,
    first_order,
    focused,
    glass,
    lens_shapes,
    mtf,
    pupil_grid,
    spot,
    stopped_down,
    trace,
)

NAN = float("nan")
CROWN = Abbe(1.5168, 64.17)
LENS = Lens([Surface(1 / 50, 4, CROWN, 10, stop=True), Surface(-1 / 50, 47, semi_diameter=10)])
CROSSED = Lens([Surface(1 / 20, 1, CROWN, 10), Surface(-1 / 20, 10, semi_diameter=10)])


def lens(**other):
    return Lens([Surface(1 / 50, 4, CROWN, 10), Surface(-1 / 50, 47, semi_diameter=10)], **other)


CALLS = {
    "no surfaces": (lambda: Lens([]), "surfaces: expected one surface at least, got none"),
    "text": (lambda: Lens("abc"), "surfaces: expected a list of Surface, got 'abc'"),
    "a number": (lambda: Lens([1]), "surface 1: expected a Surface, got 1"),
    "word": (lambda: Lens([Surface("x")]), "curvature of surface 1: .*got 'x'"),
    "nan": (lambda: Lens([Surface(0, NAN)]), "thickness of surface 1: .*got nan"),
    "negative": (
        lambda: Lens([Surface(0.1, -4, CROWN), Surface(0, 5)]),
        "surfaces 1 and 2 cross: -4 mm apart at 0",
    ),
    "medium": (
        lambda: Lens([Surface(0, 1, "N-BK7")]),
        r"medium of surface 1: expected a medium, such as optics.glass\('N-BK7'\), got 'N-BK7'",
    ),
    "index": (lambda: Lens([Surface(0, 1, 1.5)]), "medium of surface 1: .*got 1.5"),
    "object": (lambda: lens(object_medium="water"), "object_medium: .*got 'water'"),
    "coefficients": (lambda: Lens([Surface(coefficients=1.0)]), "coefficients of surface 1"),
    "hole": (
        lambda: Lens([Surface(inner=5, semi_diameter=3)]),
        "inner of surface 1: expected a number from 0 to its semi-diameter 3, got 5",
    ),
    "rim": (lambda: Lens([Surface(0.1, semi_diameter=11)]), "at most 10, where the sphere ends"),
    "size": (lambda: Lens([Surface(semi_diameter=NAN)]), "semi-diameter of surface 1: .*got nan"),
    "motion": (lambda: Lens([Surface(before=np.eye(3))]), r"before of surface 1: .*shape \(3, 3\)"),
    "scaled": (lambda: Lens([Surface(after=2 * np.eye(4))]), "after of surface 1: .*rigid motion"),
    "no light": (lambda: lens(wavelengths=[]), "wavelengths: .*got none"),
    "dark": (lambda: lens(wavelengths=[0]), r"wavelengths: expected positive .*got \[0\]"),
    "one light": (lambda: lens(wavelengths=0.55), "wavelengths: .*got 0.55"),
    "weights": (lambda: lens(weights=[1, 2]), "weights: expected 1 numbers .*got .1, 2."),
    "no weight": (lambda: lens(weights=[0]), "weights: expected 1 numbers"),
    "reference": (lambda: lens(reference=0.5), "reference: expected an index below 1, got 0.5"),
    "right angle": (lambda: lens(fields=[(90, 0)]), "fields: .*below 90 degrees, got 90, 0"),
    "one number": (lambda: lens(fields=[5]), r"fields: expected finite pairs .*got \[5\]"),
    "no field": (lambda: lens(fields=[]), "fields: expected finite pairs .*got none"),
    "kind": (lambda: lens(field_kind="x"), "field_kind: expected one of angle"),
    "aperture": (lambda: lens(aperture=5), "aperture: expected a kind and a number, got 5"),
    "f-number": (lambda: lens(aperture=("f_number", NAN)), "aperture f_number: .*got nan"),
    "stop's size": (lambda: lens(aperture=("stop", -1)), "aperture stop: expected a positive"),
    "distance": (lambda: lens(object_distance=NAN), "object_distance: .*got nan"),
    "unit": (lambda: lens(unit="ft"), "unit: expected one of mm, cm, m, in, got 'ft'"),
    "vignetting": (lambda: lens(vignetting=[(0, 0)]), "vignetting: expected four numbers"),
    "two stops": (
        lambda: Lens([Surface(stop=True), Surface(stop=True)]),
        "stop: expected one surface, got surfaces 1, 2",
    ),
    "minus": (lambda: glass("-1.5"), "glass: .*a positive index, got '-1.5'"),
    "minus V_d": (lambda: glass("1.5:-50"), "glass: .*a positive index, got '1.5:-50'"),
    "no name": (lambda: glass(1.5), "glass: expected a name, such as 'N-BK7', got 1.5"),
    "dense": (lambda: Constant(1518), "index: expected a positive number up to 10, got 1518"),
    "V_d": (lambda: Abbe(1.5, 0), "n_d, V_d: expected positive numbers"),
    "range": (lambda: CROWN.index(12.0), "glass 1.5168:64.17: .*0.3 to 2.5 micrometres.*got 12"),
    "nanometres": (lambda: spot(LENS, wavelength=587.6), "0.3 to 2.5 micrometres.*got 587.6"),
    "no wave": (lambda: trace(Lens([Surface()]), [[0, 0, 0]], [[0, 0, 1]], 0), "wavelength: .*0"),
    "waves": (
        lambda: trace(LENS, np.zeros((2, 3)), np.ones((2, 3)), [0.5] * 3),
        "wavelength: expected one, or one for each of 2 rays",
    ),
    "direction": (lambda: trace(LENS, [[0, 0, 0]], [[0, 0, 0]]), "directions: .*not 0"),
    "field": (lambda: spot(LENS, (0, NAN)), "field: expected a finite pair"),
    "behind": (lambda: beam(LENS, (0, 95)), "field: expected angles below 90 degrees, got 0, 95"),
    "three": (lambda: mtf(LENS, (0, 1, 2)), "field: expected a finite pair"),
    "distortion": (lambda: distortion(LENS, (0, 91)), "field: expected angles below 90"),
    "pupil": (lambda: spot(LENS, pupil=[1, 2, 3]), "pupil: expected points"),
    "rings": (lambda: pupil_grid(2.5), "rings: expected a whole number from 0 on, got 2.5"),
    "focus": (lambda: focused(LENS, 10), "focus_distance: expected more than the front focal"),
    "fast": (lambda: stopped_down(LENS, 0.1), "f_number: expected at least 0.5.*got 0.1"),
    "stop": (lambda: stopped_down(lens(), 4), "stop: expected a surface that is the stop"),
    "crossed": (lambda: lens_shapes(CROSSED), "surfaces 1 and 2 cross: -4.359 mm apart at 10"),
    "barrel": (lambda: barrel_shapes(CROSSED, 5), "surfaces 1 and 2 cross"),
    "glassless": (
        lambda: barrel_shapes(Lens([Surface(0, 5, semi_diameter=5)]), 5),
        "lens: expected surfaces of glass, got none",
    ),
    "world": (lambda: lens_shapes(LENS, to_world=np.eye(3)), "to_world: .*shape"),
    "films": (lambda: lens_shapes(LENS, coating="x"), "coating: expected none, ideal"),
    "scale": (lambda: camera_frame(LENS, scale=0), "scale: expected a positive number, got 0"),
    "absorbing": (lambda: absorbing(CROWN, scale=0), "scale: expected a positive number, got 0"),
}


@pytest.mark.parametrize("what", CALLS)
def test_one_error_names_what_came(what):
    call, message = CALLS[what]
    with pytest.raises(PrescriptionError, match=message) as told:
        call()
    assert "\n" not in str(told.value)


def test_rays_that_miss_are_told_from_those_that_arrive():
    # above the rim, along the surface, past it, and with no number
    o = [[0, 100, -5], [0, 0, -5], [0, 11, -5], [0, NAN, -5], [0, 0, -5]]
    d = [[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 0, 1]]
    result = trace(LENS, o, d)
    assert result.valid.tolist() == [False, False, False, False, True]
    assert result.stopped.tolist() == [0, 0, 0, 0, -1]


def test_a_negative_radius_has_its_centre_in_front():
    bowl = Surface(-1 / 50, semi_diameter=10)
    assert bowl.sag(10) == pytest.approx(-(50 - np.sqrt(50**2 - 10**2)), rel=1e-14)
    # glass between two negative radii, the second the shorter, converges
    meniscus = Lens([Surface(-1 / 80, 4, CROWN), Surface(-1 / 40, 9)])
    assert first_order(meniscus).focal_length > 0


def test_sequences_of_numpy_are_as_good_as_lists():
    one = lens(wavelengths=np.array([0.5, 0.6]), weights=np.ones(2), fields=np.zeros((1, 2)))
    assert one.spectrum() == [(0.5, 0.5), (0.6, 0.5)]
    assert one.field_points() == [(0.0, 0.0)]
