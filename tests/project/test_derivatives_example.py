"""The unknowns of the inverse rendering example are the net, written in another way."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

SCRIPT = Path(__file__).parents[2] / "scenes" / "inverse_quadric.py"


@pytest.fixture(scope="module")
def example() -> Any:
    mi.set_variant(VARIANT)
    spec = importlib.util.spec_from_file_location("inverse_quadric", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_target_is_a_quadric_with_weights(example):
    net = example.target_net()
    # roundings of float64
    np.testing.assert_allclose(net[example.CORNERS, 3], 1, atol=1e-14)
    assert (np.abs(net[example.MIDDLE, 3] - 1) > 0.2).all()
    assert example.off_the_quadric(net, net) < 1e-12
    assert example.off_the_quadric(example.start_net(net), net) > 0.1


@pytest.mark.parametrize("which", ["target", "start"])
def test_points_and_weights_make_the_net(example, which):
    net = example.target_net()
    net = net if which == "target" else example.start_net(net)
    points = example.tensor(example.surface_points(net))
    logarithms = example.tensor(np.log(net[example.MIDDLE, 3]))
    got = np.array(example.net_of(points, logarithms))[0]
    # 1e-6: some roundings of float32
    np.testing.assert_allclose(got, net, atol=1e-6)
    assert example.distance(got, net) < (1e-5, 1e-5)
