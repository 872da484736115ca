"""What stands before the studio's picture: curves, schemes, S; and figures as drawings."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.figures.catalogue import CATALOGUE
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.studio.front import front_of
from mitsuba_bezier.studio.presets import CURVES, NETS, arguments_of, drawings
from mitsuba_bezier.studio.state import State


def front(name: str, **moved) -> tuple[State, object]:
    look = NETS[name]
    state = State(look(), look.curve)
    for row, place in moved.items():
        state.move(int(row[1:]), place)
    return state, front_of(state, look.shows)


@pytest.mark.parametrize("name", NETS)
def test_all_figures_have_a_front(name):
    state, seen = front(name)
    for line in seen.lines:
        assert np.isfinite(seen.segments(line)).all()
    assert np.isfinite(state.places).all() and NETS[name].row < len(state.net)
    assert ("curve" if NETS[name].curve else "boundary") in seen.lines
    for row in range(len(state.net)):  # whatever is dragged, and whatever its weight
        for weight in (0.0, -1.0, 1e6):
            other = State(NETS[name](), NETS[name].curve)
            other.weigh(row, weight)
            other.move(row, other.places[row] + [0.1, 0, 0.2])
            front_of(other, NETS[name].shows)


def test_all_figures_of_the_lecture_are_there():
    assert set(NETS) - set(CATALOGUE) == {"octant"}
    assert {*NETS, *drawings()} == {*CATALOGUE, "octant"}
    for name in drawings():
        for a in arguments_of(name):
            assert a.low <= a.start <= a.high and a.step > 0


@pytest.mark.parametrize(
    "name", ["sphere_point", "ellipsoid_point", "hyperboloid_point", "figure2"]
)
def test_s_is_on_all_conics_and_goes_when_a_point_moves(name):
    state, seen = front(name)
    (s,) = seen.marks["S"][0]
    assert "It lies on a quadric" in seen.says
    # S is on the three extended boundary conics, whose chords are shorter than 1/50 of the size
    size = np.ptp(state.places, axis=0).max()
    for edge in ((0, 1, 3), (3, 4, 5), (5, 2, 0)):
        rest = BezierCurve(state.net[list(edge)] * [[1], [-1], [1]])
        h = rest.evaluate(np.linspace(0, 1, 4001))
        x = h[:, :3] / h[:, 3:]
        assert np.linalg.norm(x - s, axis=1).min() < 0.02 * size
    assert len(seen.lines["tangents"][0]) == 3
    ends = np.array([x[1] - x[0] for x in seen.lines["tangents"][0]])
    # in one plane: unit directions, up to rounding of the fit
    ends /= np.linalg.norm(ends, axis=1)[:, None]
    assert abs(np.linalg.det(ends)) < 1e-6
    state.move(1, state.places[1] + [0.05, 0, 0])
    moved = front_of(state, NETS[name].shows)
    assert "S" not in moved.marks and "It lies on no quadric" in moved.says


def test_the_scheme_ends_in_the_curve():
    state, seen = front("decasteljau")
    (at,) = seen.marks["at"][0]
    np.testing.assert_allclose(at, BezierCurve(state.net).points(0.4), atol=1e-12)
    (tangent,) = seen.lines["scheme2"][0]
    way = tangent[-1] - tangent[0]
    assert np.linalg.norm(np.cross(at - tangent[0], way)) < 1e-9


@pytest.mark.parametrize(("weight", "kind"), [(0.5, "ellipse"), (1, "parabola"), (2, "hyperbola")])
def test_the_middle_weight_names_the_conic(weight, kind):
    state = State(CURVES["conics_by_weight"](), curve=True)
    state.weigh(1, weight)
    assert kind in front_of(state, ("conics",)).says
    state.weigh(1, 0)
    assert "line" in front_of(state, ("conics",)).says


def test_curves_through_infinity_are_cut():
    state = State(CURVES["weights"](), curve=True)
    state.weigh(1, -2.0)  # the weight function has two zeros
    pieces = front_of(state).lines["curve"][0]
    assert len(pieces) == 3
    size = np.ptp(state.places, axis=0).max()
    assert max(np.abs(x).max() for x in pieces) < 50 * size


@pytest.mark.parametrize("curve", [True, False])
def test_lowering_undoes_raising(curve):
    net = CURVES["farin"]() if curve else NETS["sphere_point"]()
    state = State(net, curve)
    state.elevate()
    state.elevate()
    assert state.lower() < 1e-12 and state.lower() < 1e-12
    np.testing.assert_allclose(state.net, net, atol=1e-12)
    assert state.lower() > 1e-3  # and no further without a change
    assert state.undo()
    np.testing.assert_allclose(state.net, net, atol=1e-12)
    line = State([[0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1]])
    with pytest.raises(BezierError, match="degree"):
        line.lower()


def test_a_run_of_the_slider_is_one_step_back():
    state = State(NETS["rational_triangle"]())
    before = state.net.copy()
    for weight in np.linspace(1, -1, 21):
        state.weigh(4, float(weight))
    state.weigh(3, 2.0)
    assert state.undo() and state.net[3, 3] == 1 and state.net[4, 3] == -1
    assert state.undo() and np.array_equal(state.net, before) and not state.undo()


def test_a_control_vector_is_drawn_from_the_middle_of_the_points():
    state, seen = front("control_vectors")
    np.testing.assert_allclose(state.places[1], [0, 0, 1.4])
    state.move(1, [0.3, 0, 2.0])
    np.testing.assert_allclose(state.net[1], [0.3, 0, 2.0, 0])
    with pytest.raises(BezierError, match="a vector that is not zero"):
        state.move(1, [0, 0, 0])
    assert "vectors" in seen.lines


def test_a_drawing_moves_by_its_numbers():
    pytest.importorskip("matplotlib", reason="it draws")
    from mitsuba_bezier.studio.figure import Drawn

    drawn = Drawn("four_points")
    first = drawn.picture(200, 1.6)
    assert first.shape == (125, 200, 3)
    key = drawn.key
    drawn.move("tilt", 40.0)
    assert drawn.key != key and (drawn.picture(200, 1.6) != first).any()
    assert drawn.picture(200, 0.5).shape == (200, 100, 3)
    with pytest.raises(BezierError, match="a number of the figure"):
        drawn.move("colour", 1.0)
    assert drawn.values == {"tilt": 40.0}
