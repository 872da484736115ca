"""What is found does not depend on which BLAS kernel runs: it holds under any, see `rough_blas`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rough_blas import EPS, ROUNDINGS, rough_blas

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.linear import SINGULAR, hadamard_ratio, inverses
from mitsuba_bezier.io import load_trimmed
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import Leaves

MODELS = Path(__file__).parents[2] / "scenes" / "models"
#: In general position, of numbers that are the same on every machine.
MOVE = np.array([[0.36, 0.48, -0.8, 3], [-0.8, 0.6, 0, -2], [0.48, 0.64, 0.6, 5], [0, 0, 0, 1]])
H, T = 0.4999999999975, 0.33333333333
#: A piece of a cylinder, as CAD systems write it: ten points of it lie on many quadrics.
CYLINDER = np.array(
    [
        [160.0, 75.0, -3.0, 1.0],
        [79.99999999959999, 34.9999999998375, -0.7499999999925, H],
        [160.0, 75.0, -2.25, 1.0],
        [51.66666666614999, 21.66666666645, -0.499999999995, T],
        [79.99999999959999, 34.9999999998375, -0.499999999995, H],
        [160.0, 75.0, -1.5, 1.0],
        [74.999999999625, 34.9999999998375, -0.75, H],
        [51.66666666614999, 21.66666666645, -0.2499999999975, T],
        [79.99999999959999, 34.9999999998375, -0.2499999999975, H],
        [160.0, 75.0, -0.75, 1.0],
        [150.0, 75.0, 0.0, 1.0],
        [74.999999999625, 34.9999999998375, 0.0, H],
        [51.66666666614999, 21.66666666645, 0.0, T],
        [79.99999999959999, 34.9999999998375, 0.0, H],
        [160.0, 75.0, 0.0, 1.0],
    ]
)
BODIES = {
    "singular net": lambda: mb.BezierTriangles(CYLINDER),
    "octants": mb.sphere,
    "tetrahedral": lambda: mb.sphere(cover="tetrahedral"),
    "lunes": lambda: mb.sphere(cover="lunes"),
    "ellipsoid": lambda: mb.ellipsoid(radii=(5, 1, 0.4)),
    "cone": lambda: mb.cone(capped=True),
    "cylinder": lambda: mb.cylinder(capped=True),
    "disk": mb.disk,
    "saddle": mb.hyperbolic_paraboloid,
    "two sheets": mb.hyperboloid_two_sheets,
    "half plane": mb.half_plane,
    "CAD part": lambda: load_trimmed(MODELS / "cad_part.vtu")[0][::40],
}


def kinds(leaves: Leaves) -> list[tuple[int, int]]:
    """Return the kind of each leaf, patch by patch."""
    return sorted(zip(leaves.patch.tolist(), leaves.kind.tolist()))


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("as_given", [True, False], ids=["as given", "moved, in float32"])
def test_leaves_are_the_same_under_any_blas(body, as_given):
    patches = BODIES[body]()
    if not as_given:
        net = patches.transform(MOVE).control_points
        patches = mb.BezierTriangles(net.astype(np.float32))
    expected = kinds(build_leaves(patches))
    for seed in range(2):
        with rough_blas(seed):
            assert kinds(build_leaves(patches)) == expected


def test_singular_matrices_are_told_and_leave_the_others_alone():
    regular = np.array([[2.0, 1, 0], [0, 1, 3], [1, 0, 1]])
    first, second, _third = regular
    bad = np.nan * regular
    nearly = np.stack([first, second, first + second * 2 + [0, 0, 1e-13]])
    singular = np.stack([first, second, first + second * 2])
    given = np.stack([regular, singular, 0 * regular, bad, nearly, regular * 1e-200])
    with rough_blas(0):
        inverse, found = inverses(given)
    assert found.tolist() == [True, False, False, False, False, True]
    # `ROUNDINGS` of three entries each, times a condition of six
    bound = 3 * ROUNDINGS * EPS * 6
    assert np.abs(inverse[0] @ regular - np.eye(3)).max() < bound
    assert np.abs(inverse[5] * 1e-200 @ regular - np.eye(3)).max() < bound
    assert np.abs(inverse[1:5] - np.eye(3)).max() < bound


def test_hadamard_ratio_is_that_of_the_columns():
    angle = np.array([[1.0, 0.6], [0.0, 0.8]]) * [1e150, 1e-150]
    assert hadamard_ratio(angle[None]) == pytest.approx(0.8, rel=1e-14)  # the sine
    assert hadamard_ratio(np.array([[[1.0, 1.0], [0.0, SINGULAR / 2]]])) < SINGULAR
