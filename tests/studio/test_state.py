"""What the studio shows: points, weights, degree, and the way back."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.studio.state import PRESETS, State, slider_of, weight_of

UV = np.random.default_rng(0).dirichlet([1, 1, 1], 20)[:, :2]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_nets(name):
    state = State(PRESETS[name]())
    assert np.isfinite(state.patches.points(0, UV)).all()
    assert state.places.shape == (len(state.net), 3)


def test_moving_keeps_the_weight_and_undo_goes_back():
    state = State(PRESETS["sphere_point"]())
    before = state.net.copy()
    state.move(1, [0.3, -1.2, 0.4])
    assert state.net[1, 3] == before[1, 3]
    np.testing.assert_allclose(state.net[1, :3] / state.net[1, 3], [0.3, -1.2, 0.4])
    assert state.version == 1
    assert state.undo() and np.array_equal(state.net, before)
    assert not state.undo()


def test_a_drag_is_one_step():
    state = State(PRESETS["rational_triangle"]())
    before = state.net.copy()
    state.move(4, state.places[4])  # where it begins
    for k in range(30):
        state.move(4, [0, -0.9, 1.5 + 0.1 * k], remember=False)
    assert state.undo() and np.array_equal(state.net, before)


def test_weights_run_through_zero_and_to_infinity():
    state = State(PRESETS["rational_triangle"]())
    place = state.places[4].copy()
    for weight in (1.0, 0.4, 0.0, -0.3, 0.0, 2.5, 1e6):
        state.weigh(4, weight)
        np.testing.assert_array_equal(state.net[4], np.append(weight * place, weight))
        np.testing.assert_array_equal(state.places[4], place)  # nothing is lost at 0
    # of infinite weight, nearly all of the patch is in its point
    x = state.patches.points(0, [[0.2, 0.4]])[0]
    assert np.linalg.norm(x - place) < 1e-4
    for row in (0, 1, 2, 3, 5):
        state.weigh(row, 0)
    with pytest.raises(BezierError, match="a net with a point in it"):
        state.weigh(4, 0)
    assert state.net[4, 3] == 1e6  # as it was


def test_the_slider_is_the_weight_up_to_two_and_ends_at_infinity():
    for s in (-2.0, -0.5, 0.0, 1.0, 2.0, 3.0, 3.9):
        assert abs(slider_of(weight_of(s)) - s) < 1e-12
    assert weight_of(4.0) == 1e6 and weight_of(3.0) == 4.0
    values = [weight_of(s) for s in np.linspace(-2, 4, 200)]
    assert (np.diff(values) > 0).all()


def test_elevation_is_the_same_surface():
    state = State(PRESETS["rational_triangle"]())
    x = state.patches.points(0, UV)
    state.elevate()
    assert state.degree == 3
    np.testing.assert_allclose(state.patches.points(0, UV), x, atol=1e-14)


def test_control_vectors_stay_vectors():
    state = State([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    state.move(0, [2.0, 1.0, 0.0])
    assert state.net[0].tolist() == [2, 1, 0, 0]


@pytest.mark.parametrize(
    "call",
    [
        lambda s: s.move(9, [0, 0, 0]),
        lambda s: s.move(0, [0, np.nan, 0]),
        lambda s: s.move(0, [0, 0]),
        lambda s: s.weigh(0, np.inf),
        lambda s: s.weigh(-1, 1),
        lambda s: s.load(np.zeros((6, 4))),
    ],
)
def test_what_is_wrong_changes_nothing(call):
    state = State(PRESETS["rational_triangle"]())
    before = state.net.copy()
    with pytest.raises(BezierError):
        call(state)
    assert np.array_equal(state.net, before) and not state.undo()
