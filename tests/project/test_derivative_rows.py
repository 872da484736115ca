"""`benchmarks/derivatives.py` has its seventeen rows, and tells right from wrong and from noise."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb

# isort: split
import mitsuba as mi

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def modules():
    assert mb.__version__
    mi.set_variant(VARIANT)
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


def test_rows():
    from derivative_rows import SITUATIONS

    assert [row.name for row in SITUATIONS] == [
        "diffuse",
        "rough",
        "mirror",
        "glass",
        "nested glass",
        "textured light through glass",
        "medium",
        "boundary of a medium",
        "shadow through glass",
        "outline in a mirror",
        "trim",
        "instance",
        "caustic by light tracer",
        "ior",
        "to_world",
        "weights",
        "spectral",
    ]


@pytest.mark.parametrize(
    ("forward", "said"),
    [
        ((1.0, 0.01), "pass"),
        ((1.04, 0.001), "pass"),  # within 5 %
        ((1.06, 0.001), "forward: wrong"),
        ((1.06, 0.03), "pass"),  # within 3 standard errors
        ((1.06, 0.06), "forward: noise"),
        ((9.0, 0.06), "forward: noise, forward: wrong"),
        ((-1.0, 0.01), "forward: wrong"),
    ],
)
def test_verdicts(forward, said):
    from derivative_rows import SITUATIONS
    from derivatives import Estimate, verdict

    one = Estimate(1.0, 0.001)
    result = {"difference": one, "reverse": one, "forward": Estimate(*forward)}
    assert verdict(SITUATIONS[0], result) == said
    assert verdict(replace(SITUATIONS[0], missing="not yet"), result) == "none"
    assert verdict(SITUATIONS[0], result | {"reverse": "no"}) == ", ".join(
        [*([] if said == "pass" else [said]), "reverse: error"]
    )


def test_a_row():
    from derivative_rows import SITUATIONS
    from derivatives import measure, verdict

    row = SITUATIONS[0]
    assert verdict(row, measure(row, seeds=2, spp=0.02)) == "pass"


@pytest.mark.skipif(sys.platform != "linux", reason="what a process holds is read from /proc")
def test_steps_of_a_fit_hold_no_memory():
    import derivative_costs as costs

    net = costs.patches()
    tensor = mi.TensorXf(net.astype("float32").ravel(), shape=net.shape)
    glass = {"type": "beziertriangle", "control_points": tensor, "bsdf": {"type": "dielectric"}}
    scene = costs.scene_of(glass, 8, lens=True)
    step = costs.stepper(scene, "shape.control_points", {"type": "bezierpath"}, 1)
    with warnings.catch_warnings():  # of the lens's outline, which is not in view
        warnings.simplefilter("ignore", mb.DerivativeWarning)
        for k in range(5):
            step(k)
        early = costs.held()
        for k in range(5, 15):
            step(k)
    # 10 structures of 32 patches, or 10 graphs, would be more than that
    assert costs.held() - early < 4
