"""The examples of `mitsuba_bezier.fit`: their optics, their bodies, what they compare."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

from mitsuba_bezier import fit
from mitsuba_bezier.geometry.contours import open_edges

SCENES = Path(__file__).parents[2] / "scenes"


def script(name: str) -> Any:
    mi.set_variant(VARIANT)
    spec = importlib.util.spec_from_file_location(name, SCENES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def caustic() -> Any:
    return script("fit_caustic")


@pytest.fixture(scope="module")
def vase() -> Any:
    return script("fit_vase")


def test_a_tilted_plane_moves_the_light_by_snells_law(caustic):
    slope = 0.1
    knots = caustic._knots()
    places = np.array([knots[i + 1 : i + 4].mean() for i in range(caustic.COUNT)])
    heights = np.broadcast_to(slope * places, (caustic.COUNT,) * 2)
    side = 64
    image = np.array(caustic.Light(256, side)(mi.TensorXf(heights))).reshape(side, side)
    # out of glass at the angle of the slope, refracted, less the angle itself
    inside = np.arctan(slope)
    bent = np.arcsin(caustic.INDEX * np.sin(inside)) - inside
    shift = caustic.FLOOR * np.tan(bent)  # in the middle, where the height is zero
    column = (np.arange(side) + 0.5) / side * 2 - 1
    lit = image[side // 2] > 0.5 * image.max()
    # light moves against the slope: the glass is thicker there; a pixel is 1/32 wide
    assert abs(column[lit].max() - (1 - shift * (1 + slope / caustic.FLOOR))) < 2 / 32
    p, s = np.tan(bent) / np.tan(bent + 2 * inside), np.sin(bent) / np.sin(bent + 2 * inside)
    passed = 1 - (p * p + s * s) / 2
    inner = image[20:40, 10:30]
    # the floor is tilted against the beam: cos of nothing, as the beam is not widened but by
    # the height: 1 % within the field
    assert inner.mean() == pytest.approx(passed, rel=0.02)


def test_a_short_search_gets_near_the_picture(caustic):
    heights = caustic.search(12, levels=((16, 64),))
    seen = np.array(caustic.Light(64, 16)(mi.TensorXf(heights)))
    assert caustic.correlation(seen, caustic.picture(16)) > 0.9
    flat = np.array(caustic.Light(64, 16)(mi.TensorXf(np.zeros((caustic.COUNT,) * 2))))
    assert abs(caustic.correlation(flat, caustic.picture(16))) < 0.8


def test_the_pane_is_a_closed_body_with_the_spline_below(caustic):
    rng = np.random.default_rng(0)
    heights = 0.02 * rng.standard_normal((caustic.COUNT,) * 2)
    pane = caustic.glass(heights)
    assert len(open_edges(pane, creases=False)) == 0
    # the divergence theorem: normals point outward everywhere, or volumes would not add up
    uv = rng.dirichlet([1, 1, 1], 400)[:, :2]
    volume = 0.0
    for k in range(len(pane)):
        d = pane.differential(np.full(400, k), uv)
        volume += (d.p[:, 2] * np.cross(d.dp_du, d.dp_dv)[:, 2]).mean() / 2
    values, _slopes = caustic.spline_matrices(np.linspace(-1, 1, 400))
    mean = (values.mean(axis=0) @ heights @ values.mean(axis=0)).item()
    # 400 random points a patch, relief of 0.02 on an area of 4
    assert volume == pytest.approx(4 * (caustic.THICK - mean), abs=0.02)


def test_both_searches_of_the_vase_have_as_many_unknowns_and_begin_alike(vase):
    item = fit.Net(vase.start())
    unknowns = sum(v.size for v in item.start().values())
    points, faces = vase.start_mesh(unknowns)
    assert points.size == pytest.approx(unknowns, rel=0.05)
    laplacian = vase.Vertices(points, faces).laplacian("points")
    assert np.abs(laplacian.sum(axis=1)).max() == 0
    assert laplacian.diagonal().min() >= 2
    from scipy.spatial import cKDTree

    tree = cKDTree(vase.samples(vase.target(), 20_000))
    off = vase.distance(vase.samples(vase.start(), 2000), tree)
    mesh_off = vase.distance(vase.mesh_samples(points, faces, 2000), tree)
    assert off == pytest.approx(mesh_off, rel=0.1)
    assert (
        vase.distance(vase.samples(vase.target(), 500), tree) < 0.1 * off
    )  # 20 000 samples of 8: 0.01 apart


def test_the_lens_of_the_photograph_has_the_faults_and_the_others_are_those_prescribed():
    lens = script("fit_lens")
    truth, scene = lens.scene_of(2, off=True), lens.scene_of(2)
    # parameters are float32: 61 mm to 4e-6
    found = lens.errors(scene, truth)
    assert found == pytest.approx([-f.error for f in lens.FAULTS], rel=1e-4)
    params, right = mi.traverse(scene), mi.traverse(truth)
    for key, item in lens.unknowns(scene).items():
        value = np.array(item.value({k: mi.TensorXf(v) for k, v in item.start().items()}))
        assert np.array_equal(value, np.array(params[key]))
        assert (value != np.array(right[key])).sum() == 1


def test_pytorch_gets_the_gradient_that_there_is_without_it():
    torch = pytest.importorskip("torch")
    import drjit as dr

    import mitsuba_bezier as mb

    example = script("fit_torch")
    side, spp, item = 6, 16, fit.Sphere((0.1, 0.0, 0.2), 0.9)
    weights = np.random.default_rng(0).standard_normal((side, side, 3)).astype(np.float32)
    integrator = mi.load_dict({"type": "bezier_direct_projective", "sppi": 0, "spps": 0})
    start = item.start()

    inputs = {k: torch.tensor(v, dtype=torch.float32, requires_grad=True) for k, v in start.items()}
    render = example.renderer(example.scene_of(mb.sphere(), side), item, integrator, spp)
    image = render(inputs["center"], inputs["logarithm"], 3)
    (image * torch.from_numpy(weights)).sum().backward()

    scene = example.scene_of(mb.sphere(), side)
    params = mi.traverse(scene)
    own = {k: mi.TensorXf(v) for k, v in start.items()}
    dr.enable_grad(*own.values())
    params[example.KEY] = item.value(own)
    params.update()
    native = mi.render(scene, params, integrator=integrator, sensor=1, spp=spp, seed=6, seed_grad=7)
    dr.backward(dr.sum(native * mi.TensorXf(weights), axis=None))
    np.testing.assert_allclose(image.detach().numpy(), np.array(native), rtol=1e-6)
    for name in start:
        expected = np.array(dr.grad(own[name]))
        assert np.abs(expected).max() > 0.01
        # the same sums in float32, added by threads in another order
        np.testing.assert_allclose(inputs[name].grad.numpy(), expected, rtol=1e-3, atol=1e-3)
