"""Ideal points, lines, planes, and the map between two completed planes."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.cross_ratio import cross_ratio
from mitsuba_bezier.geometry.ideal_elements import (
    Perspectivity,
    are_parallel,
    ideal_line,
    ideal_point,
    is_ideal_line,
    is_ideal_plane,
    is_ideal_point,
)
from mitsuba_bezier.geometry.projective import (
    IDEAL_LINE,
    IDEAL_PLANE,
    ideal,
    incidence,
    join,
    line_points,
    point,
)

seeds = pytest.mark.parametrize("seed", range(5))


def test_which_elements_are_ideal():
    assert is_ideal_point([[1, 2, 0], [1, 2, 3]]).tolist() == [True, False]
    assert is_ideal_point([0, 0, 1, 0])
    # the origin of the plane has the numbers of the ideal line
    assert is_ideal_line(IDEAL_LINE) and not is_ideal_point(IDEAL_LINE)
    assert is_ideal_plane(IDEAL_PLANE) and not is_ideal_point(IDEAL_PLANE)
    assert is_ideal_line(join(ideal([1, 0, 0]), ideal([0, 1, 0])))
    assert not is_ideal_line(join(point([1, 0, 0]), ideal([0, 1, 0])))
    with pytest.raises(GeometryError, match="of 3 or 6 numbers"):
        is_ideal_line([1, 2, 3, 4])


@seeds
def test_parallels_share_their_ideal_elements(seed):
    rng = np.random.default_rng(seed)
    a, b, d, e = rng.normal(size=(4, 3))
    lines = [join(point(x), ideal(d)) for x in (a, b)]
    assert are_parallel(*lines)
    assert apart(ideal_point(lines[0]), ideal_point(lines[1])) < 1e-14
    assert not are_parallel(lines[0], join(point(b), ideal(e)))
    planes = [join(point(x), ideal(d), ideal(e)) for x in (a, b)]
    assert are_parallel(*planes) and are_parallel(planes[1], lines[0])
    assert apart(ideal_line(planes[0]), ideal_line(planes[1])) < 1e-14
    assert incidence(ideal_line(planes[0]), lines[0]) < 1e-14  # the direction is in the plane
    p, q, r = point(rng.normal(size=(3, 2)))
    assert not are_parallel(join(p, q), join(p, r))
    assert are_parallel(join(p, q), [*join(p, q)[:2], 7.0])


@seeds
def test_the_map_of_completed_planes_is_one_to_one(seed):
    rng = np.random.default_rng(seed)
    eye, source, target = rng.normal(size=(3, 4))
    view = Perspectivity(eye, source, target)
    # points of the source, among them ideal ones and those of the vanishing line
    a, b = line_points(ideal_line(source))
    c, d = line_points(view.vanishing_line)
    own = np.concatenate([rng.normal(size=(20, 2)) @ [a, b], rng.normal(size=(20, 2)) @ [c, d]])
    own = np.concatenate([own, rng.normal(size=(20, 3)) @ [a, b, c]])
    seen = view.image(own)
    # products of three or four vectors of unit size, in generic position
    assert incidence(seen, target).max() < 1e-12
    assert apart(view.preimage(seen), own) < 1e-9
    # the ideal line goes to the horizon, the vanishing line to the ideal line
    p, q = line_points(view.horizon)
    assert np.linalg.matrix_rank(np.vstack([seen[:20], p, q]), tol=1e-8) == 2
    assert is_ideal_point(seen[20:40], 1e-9).all()
    assert is_ideal_point(own[:20], 1e-9).all()
    # the axis stays point by point
    r, s = line_points(view.axis)
    fixed = rng.normal(size=(9, 2)) @ [r, s]
    assert apart(view.image(fixed), fixed) < 1e-9
    # a cross ratio with an ideal point stays
    four = [a + x * c for x in (0.0, 0.5, 2.0, -1.0)]
    assert abs(cross_ratio(*four) - cross_ratio(*view.image(four))) < 1e-9


def test_parallel_planes_have_no_vanishing_line_of_their_own():
    view = Perspectivity([0, 0, 2, 1], [0, 0, 1, 0], [0, 0, 1, -1])
    assert is_ideal_line(view.vanishing_line) and is_ideal_line(view.horizon)
    assert is_ideal_line(view.axis)
    # and a centre at infinity keeps ideal points ideal
    view = Perspectivity([1, 2, 3, 0], [0, 0, 1, 0], [0, 1, 1, -1])
    assert is_ideal_line(view.vanishing_line) and is_ideal_line(view.horizon)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: ideal_point(IDEAL_LINE), "an ideal line"),
        (lambda: ideal_line(IDEAL_PLANE), "the ideal plane"),
        (lambda: are_parallel([1, 0, 0], [1, 0, 0, 0]), "of one plane, or of space"),
        (lambda: are_parallel([1, 0, 0, 0], IDEAL_PLANE), "b: expected an element with a direct"),
        (lambda: Perspectivity([0, 0, 0, 1], [0, 0, 1, 0], [0, 1, 0, -1]), "not on the axis"),
        (lambda: Perspectivity([0, 0, 1, 1], [0, 0, 1, 0], [0, 0, 2, 0]), "same element"),
        (lambda: Perspectivity([0, 0, 1, 1], IDEAL_PLANE, [0, 1, 0, -1]), "source: expected"),
        (lambda: Perspectivity([[0, 0, 1, 1]], [0, 0, 1, 0], [0, 1, 0, -1]), "one vector"),
        (
            lambda: Perspectivity([0, 0, 1, 1], [0, 0, 1, 0], [0, 1, 0, -1]).image([0, 0, 5, 1]),
            "points of the source plane",
        ),
    ],
)
def test_bad_elements(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
