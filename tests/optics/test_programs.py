"""Focal lengths and spots against Optiland and ray-optics, and by the kernels with every cover."""

from __future__ import annotations

import numpy as np
import pytest
from optics_cases import by_kernels, lens_at, lens_of, recorded, recorded_beam, rms

from mitsuba_bezier.optics import first_order, trace

REPORT = recorded()


@pytest.mark.parametrize("name", REPORT)
def test_spots_at_three_fields_and_wavelengths_are_those_of_both_programs(name):
    record = REPORT[name]
    rows = record["spectrum"]
    assert len({row["wavelength"] for row in rows}) == 3
    for row in rows:
        lens = lens_at(record, row)
        # one that has mirrors is negative for ray-optics
        focal = first_order(lens).focal_length
        assert focal == pytest.approx(abs(row["focal_length"]), rel=1e-12)
        for k, field in enumerate(lens.fields):
            rays = recorded_beam(record, field)
            found = rms(trace(lens, *rays, vignetting=False).local[-1][:, :2])
            # required 2e-5; of a spot of 1e-5 of the image's height, which is known to 1e-15
            assert found == pytest.approx(row["spots"][k], rel=1e-9)
            assert found == pytest.approx(row["rayoptics"][k], rel=1e-9)


@pytest.mark.parametrize("cover", ["cap", "octants", "tetrahedral"])
def test_the_kernels_see_these_spots_by_every_cover(cover):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    for name in ("CookeTriplet", "CementedAchromat"):
        record = REPORT[name]
        lens = lens_at(record, record["spectrum"][0])
        focal = first_order(lens_of(record)).focal_length
        beams = [recorded_beam(record, field) for field in lens.fields]
        o, d = (np.concatenate(parts) for parts in zip(*beams))
        truth = trace(lens, o, d, vignetting=False).local[-1][:, :2]
        got = by_kernels(lens, o, d, lens.wavelengths[0], cover)[:, :2]
        # required 2e-5; a rounding of whole spheres, which are larger than f, is 2.5e-7
        assert np.linalg.norm(got - truth, axis=1).max() < 2e-6 * focal
        for part in np.split(np.arange(len(o)), 3):
            assert rms(got[part]) == pytest.approx(rms(truth[part]), abs=2e-6 * focal)
