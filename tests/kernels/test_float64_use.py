"""Kernels without float64: their code has none, and they find what kernels with float64 find."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from backend_cases import NAME, Float, Float64, has_float64
from leaf_cases import SPHERE, rays, traced

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.geometry.aspheres import EvenAsphere
from mitsuba_bezier.kernels import float64_use
from mitsuba_bezier.kernels.float64_use import uses_pairs
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import (
    ClosedFormLeaves,
    GraphLeaves,
    LeafKind,
    LeafSettings,
    Leaves,
)
from mitsuba_bezier.leaves.revolution import revolution_leaf

GENERAL = LeafSettings(closed_form=False)


@pytest.fixture(autouse=True)
def as_it_is_from_the_start(monkeypatch):
    monkeypatch.setattr(float64_use, "_chosen", None)
    monkeypatch.delenv(float64_use.VARIABLE, raising=False)


def asphere() -> Leaves:
    surface = EvenAsphere(0.8, 1.0, -0.4, (0, 0.05, -0.1, 0.07, 0, -0.02, 0, 0.01), inner=0.2)
    return Leaves(
        GraphLeaves.zeros(), ClosedFormLeaves.zeros(), revolution_leaf(surface, np.eye(4))
    )


def at_infinity(degree: int) -> Leaves:
    """Patches that a plane through them takes to infinity, as graphs, some in projective charts."""
    m = np.eye(4)
    m[3] = (0.2, 0.1, 0.9, 0.6)
    patches = mb.sphere(cover="octants")[:2].elevate(degree - 4).transform(m)
    leaves = build_leaves(patches, GENERAL)
    assert LeafKind.GRAPH_PROJECTIVE in leaves.kinds
    return leaves


KINDS = {
    "inverted": lambda: build_leaves(SPHERE),
    "sections": lambda: build_leaves(mb.sphere()),
    "linear inverse": lambda: build_leaves(mb.sphere(cover="tetrahedral")),
    "cones and planes": lambda: build_leaves(shapes.cone(capped=True)),
    "graphs": lambda: build_leaves(mb.torus(tube=0.3)),
    "graphs of high degree": lambda: build_leaves(mb.torus(tube=0.3)[:2].elevate(5)),
    "projective charts": lambda: at_infinity(4),
    "projective charts of high degree": lambda: at_infinity(9),
    "asphere": asphere,
}


def code_of(run) -> tuple[str, object]:
    """Return what Dr.Jit generated, and what `run` returned."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        result = run()
        dr.eval(result)
        texts = [h["ir"] for h in dr.kernel_history() if "ir" in h]
    return "".join(x if isinstance(x, str) else x.read() for x in texts), result


@pytest.mark.parametrize("name", KINDS)
def test_code_and_hits(name):
    leaves = KINDS[name]()
    o, d = rays(mb.sphere(), 1500)
    # half of them graze: there float32 alone would not do
    along = np.cross(o, d)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    start = o / np.linalg.norm(o, axis=1, keepdims=True) * (1 - 1e-5)
    o[::2], d[::2] = (start - 3 * along)[::2], along[::2]
    found = {}
    for use in ("always", "never"):
        mb.set_float64(use)
        code, hit = code_of(lambda: traced(leaves, o, d))
        assert has_float64(code) == (use == "always")
        found[use] = {k: np.array(x) for k, x in zip(hit._fields, hit)}
    with_it, without = found["always"], found["never"]
    valid = with_it["valid"]
    assert valid.mean() > 0.02 and np.array_equal(without["valid"], valid)
    code, hit = code_of(lambda: traced(leaves, o, d, any_hit=True))
    assert not has_float64(code)
    assert np.array_equal(np.array(hit.valid), valid)
    assert np.array_equal(without["patch"][valid], with_it["patch"][valid])
    # both are exact but for their last rounding, to one of two neighbours
    assert np.allclose(without["t"][valid], with_it["t"][valid], rtol=2.0**-23, atol=0)
    assert np.abs(without["u"] - with_it["u"])[valid].max() < 2.0**-22


@pytest.mark.parametrize("size", (1e-6, 1e6))
@pytest.mark.parametrize("name", ("octants", "tetrahedral", "cone", "graphs", "infinity"))
def test_sizes_and_places(name, size):
    """Pairs have the exponents of float32: nothing overflows or is lost in any usual unit."""
    moved = np.diag([size, size, size, 1.0])
    moved[:3, 3] = [3 * size, -200 * size, 0.7 * size]
    nets = {
        "octants": mb.sphere(),
        "tetrahedral": mb.sphere(cover="tetrahedral"),
        "cone": shapes.cone(capped=True),
        "graphs": mb.torus(tube=0.3),
        "infinity": shapes.quarter_plane(),
    }
    leaves = build_leaves(nets[name].transform(moved))
    o, d = rays(mb.sphere(), 1000)
    o = o * size + moved[:3, 3]
    hits = []
    for use in ("always", "never"):
        mb.set_float64(use)
        hit = traced(leaves, o, d)
        hits.append((np.array(hit.valid), np.array(hit.t)))
    (valid, t), (same, other) = hits
    assert valid.mean() > 0.05 and np.array_equal(same, valid)
    assert np.allclose(other[valid], t[valid], rtol=2.0**-23, atol=0)


def test_what_is_chosen(monkeypatch):
    assert mb.float64() == "auto" and uses_pairs(Float) == (NAME == "cuda" and uses_pairs(Float))
    monkeypatch.setenv("MITSUBA_BEZIER_FLOAT64", "never")
    assert mb.float64() == "never" and uses_pairs(Float)
    assert not uses_pairs(Float64)  # all of it is float64
    mb.set_float64("always")  # before what the environment says
    assert mb.float64() == "always" and not uses_pairs(Float)


def test_consumers_chips_and_others(monkeypatch):
    from drjit import cuda, llvm

    assert not uses_pairs(llvm.Float)
    expected = {75: True, 86: True, 89: True, 120: True, 61: True, 70: False, 80: False, 90: False}
    for capability, pairs in {**expected, 100: False, 103: True}.items():
        monkeypatch.setattr(dr.detail, "cuda_compute_capability", lambda c=capability: c)
        assert uses_pairs(cuda.Float) == pairs
        assert not uses_pairs(cuda.Float64)


@pytest.mark.parametrize("word", ("sometimes", "", None, True))
def test_other_words(word, monkeypatch):
    with pytest.raises(mb.BezierError, match="use: expected 'auto' or 'always' or 'never', got"):
        mb.set_float64(word)
    assert mb.float64() == "auto"
    monkeypatch.setenv("MITSUBA_BEZIER_FLOAT64", "Never")
    with pytest.raises(mb.BezierError, match=r"MITSUBA_BEZIER_FLOAT64: expected .* got 'Never'"):
        uses_pairs(Float)
