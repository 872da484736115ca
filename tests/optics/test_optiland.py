"""First-order data and ray intercepts of sample lenses, against what Optiland says of them.

`record_optiland.py` wrote ``optiland.json``.
"""

from __future__ import annotations

import pytest
from optics_cases import lens_of, recorded

from mitsuba_bezier.optics import beam, first_order, trace

REPORT = recorded()


def test_there_are_lenses_enough():
    assert len(REPORT) >= 15


@pytest.mark.parametrize("name", REPORT)
def test_first_order_data_agree(name):
    record = REPORT[name]
    data = first_order(lens_of(record))
    # required 1e-6; both are float64, so all but some ten roundings agree
    scale = abs(record["focal_length"])
    assert data.focal_length == pytest.approx(record["focal_length"], rel=1e-12)
    assert data.entrance_diameter == pytest.approx(record["entrance_diameter"], rel=1e-12)
    assert data.exit_diameter == pytest.approx(record["exit_diameter"], rel=1e-11)
    assert data.entrance_pupil == pytest.approx(record["entrance_pupil"], abs=1e-11 * scale)
    # Optiland measures the exit pupil from the image
    last = record["surfaces"][-1]["z"] - record["surfaces"][-2]["z"]
    assert data.exit_pupil - last == pytest.approx(record["exit_pupil"], abs=1e-11 * scale)


@pytest.mark.parametrize("name", REPORT)
def test_ray_intercepts_agree(name):
    record = REPORT[name]
    lens = lens_of(record)
    for height, px, py, x, y in record["rays"]:
        rays = beam(lens, (0, height * record["field"]), [[px, py]], aim=False)
        at = trace(lens, *rays, vignetting=False).points[-1][0]
        # required 1e-9 of a unit
        assert at[:2] == pytest.approx([x, y], abs=1e-10)
