"""The state of a shape, without a scene and without Mitsuba."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError, NetError
from mitsuba_bezier.geometry.trims import Trims
from mitsuba_bezier.plugins.shape import state as module
from mitsuba_bezier.plugins.shape.state import PatchState

BALL = mb.sphere()
MOVED = np.diag([2.0, 2.0, 2.0, 1.0])
MOVED[:3, 3] = 0.1, 5.0, -3.0


def test_it_imports_no_mitsuba():
    tree = ast.parse(Path(module.__file__).read_text())
    names = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    names += [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    assert not [name for name in names if name.split(".")[0] in ("mitsuba", "drjit")]


def test_patches_are_placed():
    state = PatchState(BALL, MOVED)
    assert state.object_patches is BALL
    # the box is tight to a thousandth of the size, 4
    np.testing.assert_allclose(state.box, [[-1.9, 3, -5], [2.1, 7, -1]], atol=4e-3)
    assert state.area() == pytest.approx(16 * np.pi, rel=1e-6)


@pytest.mark.parametrize("flip", [False, True])
def test_a_mirror_image_keeps_its_outside_out(flip):
    sign = -1.0 if flip else 1.0
    assert PatchState(BALL, np.eye(4), flip).orientation == sign
    assert PatchState(BALL, np.diag([-1.0, 1, 1, 1]), flip).orientation == -sign


def test_instances():
    maps = np.stack([np.eye(4), MOVED])
    state = PatchState(BALL, np.eye(4), instances=maps)
    assert state.area() == pytest.approx(20 * np.pi, rel=1e-6)
    assert state.instance_boxes.shape == (2, 2, 3)
    assert (state.box[0] <= [-1.9, -1, -5]).all() and (state.box[1] >= [2.1, 7, 1]).all()
    with pytest.raises(BezierError, match="instances: expected patches of finite size"):
        PatchState(mb.plane(), np.eye(4), instances=maps)


def test_digits_beyond_float32_stay_where_nothing_changed():
    state = PatchState(BALL, MOVED)
    shown = BALL.control_points.astype(np.float32).astype(float)
    patches, matrix, exposed = state.changed(shown, MOVED.astype(np.float32).astype(float))
    assert patches is BALL and matrix is MOVED and exposed is state.exposed
    shown[2, 3] += 0.5
    patches, _matrix, exposed = state.changed(shown, MOVED)
    assert np.array_equal(patches.control_points, shown)
    assert np.array_equal(exposed, shown.astype(np.float32))


def test_trims_are_those_of_as_many_patches():
    state = PatchState(BALL, np.eye(4), trims=Trims.none(8))
    with pytest.raises(NetError, match="expected 8 patches, as the trims have, got 2"):
        state.changed(BALL.control_points[:2], np.eye(4))
