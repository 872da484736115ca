"""Sampling of Bézier surfaces against its density, by Mitsuba's chi-square test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.trims import Trims, closed_region
from mitsuba_bezier.plugins.scene_data import data_for_shapes

TORUS = 2.0, 0.75
# a quadratic patch of uneven weights, as Euclidean points and weights
POINTS = [[1, 0, 0], [0.8, 0.9, 0.5], [0.4, 0, 0.6], [0, 2, 0.3], [0.1, 0.7, 0.3], [0, 0, 0]]
WEIGHTS = np.array([1, 1, 1, 3, 0.4, 0.7])[:, None]


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def uneven_patch() -> mb.BezierTriangles:
    return mb.BezierTriangles(np.hstack([np.array(POINTS) * WEIGHTS, WEIGHTS])[None])


def chi_square(domain: Any, sample: Callable, pdf: Callable, resolution: int = 51) -> tuple:
    """Return whether the test at 1 % passes (six tests, Šidák), and the sum of the density."""
    test = mi.chi2.ChiSquareTest(
        domain=domain, sample_func=sample, pdf_func=pdf, sample_count=400_000, res=resolution
    )
    accepted = test.run(significance_level=0.01, test_count=6, quiet=True)
    return accepted, float(test.pdf_sum[0]), test.messages


def position_sample(p: Any, n: Any) -> Any:
    ps = dr.zeros(mi.PositionSample3f, dr.width(p))
    ps.p, ps.n = p, n
    return ps


def positions(shape: Any) -> Callable[[Any], Any]:
    return lambda sample: shape.sample_position(0.0, mi.Point2f(sample.x, sample.y)).p


# ---------------------------------------------------------------- surfaces with a chart


def ellipsoid_chart(axes: tuple[float, float, float]) -> tuple[Any, Callable, Callable]:
    """Unit vectors of the sphere whose affine image the ellipsoid is."""
    a = mi.Vector3f(*axes)

    def to_surface(d: Any) -> tuple[Any, Any, Any]:
        # area of an affine image: det(A) |A^-T n|
        turned = d / a
        return mi.Point3f(a * d), dr.normalize(turned), a.x * a.y * a.z * dr.norm(turned)

    return mi.chi2.SphericalDomain(), to_surface, lambda p: mi.Vector3f(p) / a


def torus_chart() -> tuple[Any, Callable, Callable]:
    """Angles around the axis and around the tube."""
    major, minor = TORUS

    def to_surface(xy: Any) -> tuple[Any, Any, Any]:
        (s, c), (sin, cos) = dr.sincos(xy.x), dr.sincos(xy.y)
        ring = major + minor * cos
        n = mi.Vector3f(c * cos, s * cos, sin)
        return mi.Point3f(ring * c, ring * s, minor * sin), n, minor * ring

    def to_chart(p: Any) -> Any:
        ring = dr.sqrt(dr.square(p.x) + dr.square(p.y))
        return mi.Vector2f(dr.atan2(p.y, p.x), dr.atan2(p.z, ring - major))

    square = mi.ScalarBoundingBox2f([-dr.pi, -dr.pi], [dr.pi, dr.pi])
    return mi.chi2.PlanarDomain(square), to_surface, to_chart


@pytest.mark.parametrize(
    ("net", "chart"),
    [
        (lambda: mb.sphere(cover="octants"), lambda: ellipsoid_chart((1, 1, 1))),
        (lambda: mb.sphere(cover="tetrahedral"), lambda: ellipsoid_chart((1, 1, 1))),
        (lambda: mb.ellipsoid(radii=(2, 1, 0.5)), lambda: ellipsoid_chart((2, 1, 0.5))),
        (lambda: mb.torus(radius=TORUS[0], tube=TORUS[1]), torus_chart),
    ],
    ids=["octants", "tetrahedral", "ellipsoid", "torus"],
)
def test_positions_follow_their_density(net, chart):
    shape = mi.load_dict(bezier(net()))
    domain, to_surface, to_chart = chart()

    def pdf(x: Any) -> Any:
        p, n, stretch = to_surface(x)
        return shape.pdf_position(position_sample(p, n)) * stretch

    accepted, total, messages = chi_square(
        domain, lambda sample: to_chart(positions(shape)(sample)), pdf
    )
    assert accepted, messages
    # 1e-3: the trapezoid rule on these cells
    assert abs(total - 1) < 1e-3


def test_positions_on_one_patch_of_uneven_weights():
    # chart: (s, t) of the unit square, u = s, v = (1 - s) t
    patches = uneven_patch()
    shape = mi.load_dict(bezier(patches))

    def sample(numbers: Any) -> Any:
        uv = shape.sample_position(0.0, mi.Point2f(numbers.x, numbers.y)).uv
        return mi.Vector2f(uv.x, uv.y / (1 - uv.x))

    def pdf(st: Any) -> Any:
        uv = np.array([st.x, (1 - st.x) * st.y]).T
        d = patches.differential(0, uv)
        cross = np.cross(d.dp_du, d.dp_dv)
        stretch = np.linalg.norm(cross, axis=1)
        ps = position_sample(mi.Point3f(d.p.T), mi.Normal3f((cross / stretch[:, None]).T))
        return shape.pdf_position(ps) * mi.Float(stretch) * (1 - st.x)

    # cells of the test end at the patch's edges, where half of the points are rounded to outside
    domain = mi.chi2.PlanarDomain(mi.ScalarBoundingBox2f([0, 0], [1, 1]))
    accepted, total, messages = chi_square(domain, sample, pdf)
    assert accepted, messages
    assert abs(total - 1) < 1e-3


def test_directions_follow_their_density():
    # from inside of a sphere every direction meets it once, and nowhere at a slant
    shape = mi.load_dict(bezier(mb.sphere(cover="tetrahedral")))
    it = dr.zeros(mi.Interaction3f)
    it.p = mi.Point3f(0.3, -0.2, 0.4)

    def pdf(d: Any) -> Any:
        si = shape.ray_intersect(mi.Ray3f(it.p, d))
        ds = dr.zeros(mi.DirectionSample3f, dr.width(d))
        ds.p, ds.n, ds.d, ds.dist = si.p, si.n, d, si.t
        return shape.pdf_direction(it, ds)

    def sample(numbers: Any) -> Any:
        return shape.sample_direction(it, mi.Point2f(numbers.x, numbers.y)).d

    accepted, total, messages = chi_square(mi.chi2.SphericalDomain(), sample, pdf)
    assert accepted, messages
    assert abs(total - 1) < 1e-3


# ---------------------------------------------------------------- densities


@pytest.mark.parametrize(
    ("net", "spread"),
    # measured: 0.0007, 0.0064, 0.0038; a density that is constant in each cell has 0.03 to 0.06
    [
        (lambda: mb.sphere(cover="octants"), 0.002),
        (lambda: mb.sphere(cover="tetrahedral"), 0.01),
        (uneven_patch, 0.01),
    ],
    ids=["octants", "tetrahedral", "uneven"],
)
def test_density_of_a_sample_is_that_of_its_point_and_nearly_uniform(net, spread):
    shape = mi.load_dict(bezier(net()))
    sampler = np.random.default_rng(3).random((2, 50_000), dtype=np.float32)
    ps = shape.sample_position(0.25, mi.Point2f(sampler))
    assert dr.all(ps.time == 0.25)
    ratio = np.array(shape.pdf_position(ps)) / np.array(ps.pdf)
    # 1e-3: parameters near a collapsed corner are determined to that in float32
    assert np.abs(ratio - 1).max() < 1e-3
    weight = 1 / (np.array(ps.pdf) * float(shape.surface_area()[0]))
    # the mean weight is the area over itself; its standard error is below spread / 200
    assert abs(weight.mean() - 1) < spread / 40
    assert weight.std() < spread


def test_texture_coordinates_of_samples():
    corners = np.array([[[0.2, 0.1], [0.9, 0.3], [0.4, 0.8]]])
    values = mi.TensorXf(corners.astype(np.float32))
    patches = uneven_patch()
    plain = mi.load_dict(bezier(patches))
    textured = mi.load_dict(bezier(patches, texcoords=values))
    sample = mi.Point2f([0.1, 0.5, 0.9], [0.3, 0.7, 0.2])
    uv = np.array(plain.sample_position(0.0, sample).uv).T
    expected = np.column_stack([uv, 1 - uv.sum(axis=1)]) @ corners[0]
    got = np.array(textured.sample_position(0.0, sample).uv).T
    assert np.abs(got - expected).max() < 1e-6  # roundings of numbers below 1
    # ... and the density does not depend on them
    ps = textured.sample_position(0.0, sample)
    assert np.allclose(np.array(textured.pdf_position(ps)), np.array(ps.pdf), rtol=1e-5)


def lamp(pixels: np.ndarray) -> Any:
    """Return one octant of a sphere that shines as an image over (u, v)."""
    radiance = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(pixels.astype(np.float32)),
        "filter_type": "nearest",
        "raw": not mi.is_spectral,
    }
    net = mb.sphere(cover="octants").control_points[:1]
    return mi.load_dict(bezier(net, emitter={"type": "area", "radiance": radiance}))


@pytest.mark.parametrize("name", ["llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono"])
def test_textured_emitters_are_sampled_where_they_shine(name):
    if name not in mi.variants():
        pytest.skip("this Mitsuba has no such variant")
    mi.set_variant(name)
    try:
        pixels = np.zeros((8, 8, 3))
        pixels[1, 2] = [5, 4, 3]
        shape = lamp(pixels)
        sampling = data_for_shapes([shape]).surface_sampling((0,), by_emission=True)
        rng = np.random.default_rng(2)
        sample = mi.Point2f(rng.random((2, 100_000), dtype=np.float32))
        which = mi.UInt32(0)
        ps, patch = sampling.sample(which, sample, mi.Bool(True))
        pdf, uv = np.array(ps.pdf), np.array(ps.uv).T
        # the density is that of the samples' points, and its inverse's mean is the area
        again = np.array(sampling.pdf(which, patch, ps.uv, mi.Bool(True)))
        assert np.abs(again / pdf - 1).max() < 1e-3  # points on a side of a cell
        area, error = np.pi / 2, 5 * (1 / pdf).std() / np.sqrt(len(pdf))
        assert (1 / pdf).mean() == pytest.approx(area, abs=error)
        # one pixel of 64 shines, on a surface of half of them: 1 / 1.1 of the samples are there,
        # less those of its edge
        column, row = np.floor(8 * uv).astype(int).T
        share = max(((column == 2) & (row == r)).mean() for r in (1, 6))
        assert share > 0.75
        # nothing is left out, even the darkest
        assert len({*zip(column.tolist(), row.tolist())}) >= 36
        # without light, and for whoever does not ask for it, by area
        unlit = lamp(0 * pixels)  # a structure does not keep its shapes alive
        dark = data_for_shapes([unlit]).surface_sampling((0,), by_emission=True)
        for other in (dark, data_for_shapes([shape]).surface_sampling((0,))):
            flat = np.array(other.sample(which, sample, mi.Bool(True))[0].pdf)
            assert (flat * area).std() < 0.01
    finally:
        mi.set_variant(VARIANT)


def test_points_off_the_surface_have_no_density():
    shape = mi.load_dict(bezier(mb.sphere(cover="octants")))
    ps = position_sample(mi.Point3f([1.0, 1.01, 0.99], 0, 0), mi.Normal3f(1, 0, 0))
    assert (np.array(shape.pdf_position(ps)) > 0).tolist() == [True, False, False]


def test_inactive_lanes_have_no_density():
    shape = mi.load_dict(bezier(mb.sphere(cover="octants")))
    ps = position_sample(mi.Point3f([1.0, 1.0], 0, 0), mi.Normal3f(1, 0, 0))
    assert (np.array(shape.pdf_position(ps, mi.Bool([True, False]))) > 0).tolist() == [True, False]
    ps = shape.sample_position(0.0, mi.Point2f([0.5, 0.5], 0.5), mi.Bool([True, False]))
    assert (np.array(ps.pdf) > 0).tolist() == [True, False]


# ---------------------------------------------------------------- trimmed surfaces


def trimmed_disk(tmp_path: Path) -> Any:
    """Return a flat triangle of which a disk is left, and the disk's centre and radius."""
    center, radius, half = np.array([0.35, 0.3]), 0.25, np.pi / 4
    arcs = []
    for start in (0, 1, 2, 3):
        a = np.array([start, start + 0.5, start + 1]) * 2 * half
        w = np.array([1, np.cos(half), 1])
        xy = radius * np.stack([np.cos(a), np.sin(a)], axis=1) + center * w[:, None]
        arcs.append(np.column_stack([xy, w]))
    square = [[[1, 0, 0], [0, 1, 0]]]
    trims = Trims([closed_region(arcs, 1e-9)], [0], square, [[[0, 0], [1, 1]]])
    flat = mb.BezierTriangles([[[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]]])
    io.save(flat, tmp_path / "disk.vtu", trims=trims)
    shape = mi.load_dict({"type": "beziertriangle", "filename": str(tmp_path / "disk.vtu")})
    return shape, center, radius


def test_positions_on_a_trimmed_patch(tmp_path):
    shape, center, radius = trimmed_disk(tmp_path)
    # 1e-3: the unit at the trimming curve is 1/192 of the patch (7e-4 measured)
    assert float(shape.surface_area()[0]) == pytest.approx(np.pi * radius**2, rel=1e-3)
    rng = np.random.default_rng(1)
    ps = shape.sample_position(0.0, mi.Point2f(rng.random((2, 200_000)).astype(np.float32)))
    pdf, p = np.array(ps.pdf), np.array(ps.p).T[:, :2]
    inside = np.linalg.norm(p - center, axis=1) < radius
    # 1e-5: the trims' slack and roundings
    sure = np.abs(np.linalg.norm(p - center, axis=1) - radius) > 1e-5
    assert ((pdf > 0) == inside)[sure].all()
    assert inside.mean() > 0.75  # cells that are trimmed away are not sampled
    # the samples' own density tells the area; 5 standard errors of the share inside
    weights = np.divide(1.0, pdf, where=pdf > 0, out=np.zeros_like(pdf))
    error = 5 * weights.std() / np.sqrt(len(weights))
    assert weights.mean() == pytest.approx(np.pi * radius**2, abs=error)
    again = np.array(shape.pdf_position(ps))
    assert np.abs(again[inside & sure] / pdf[inside & sure] - 1).max() < 1e-3
    # uniform in the disk: centre of the samples, and the mean of the squared radius
    kept = p[pdf > 0] - center
    assert np.abs(kept.mean(axis=0)).max() < 5 * radius / 2 / np.sqrt(len(kept))
    assert (kept**2).sum(axis=1).mean() == pytest.approx(radius**2 / 2, rel=5e-3)


def test_everything_is_trimmed_away(tmp_path):
    far = [[[2, 2, 1], [3, 2, 1]], [[3, 2, 1], [3, 3, 1]], [[3, 3, 1], [2, 2, 1]]]
    square = [[[1, 0, 0], [0, 1, 0]]]
    trims = Trims([[np.array(c, float) for c in far]], [0], square, [[[0, 0], [1, 1]]])
    flat = mb.BezierTriangles([[[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]]])
    io.save(flat, tmp_path / "none.vtu", trims=trims)
    shape = mi.load_dict({"type": "beziertriangle", "filename": str(tmp_path / "none.vtu")})
    assert np.array(shape.surface_area()).tolist() == [0]
    with pytest.raises(GeometryError, match=r"finite area.*got area 0"):
        shape.sample_position(0.0, mi.Point2f(0.5, 0.5))


# ---------------------------------------------------------------- surfaces without area


@pytest.mark.parametrize("net", [mb.plane, mb.half_plane], ids=["plane", "half_plane"])
def test_surfaces_at_infinity(net):
    shape = mi.load_dict(bezier(net(), id="field"))
    assert np.isinf(np.array(shape.surface_area())).all()
    with pytest.raises(GeometryError, match=r'shape "field": expected .*finite area.*infinity'):
        shape.sample_position(0.0, mi.Point2f(0.5, 0.5))


def test_weights_that_change_sign_within_a_patch():
    # weights 1, -1, 1, ... : some points of the patch are at infinity, though no control point is
    net = np.hstack([np.array(POINTS), np.ones((6, 1))])
    net[1] *= -4
    shape = mi.load_dict(bezier(net[None]))
    assert np.isinf(np.array(shape.surface_area())).all()
    with pytest.raises(GeometryError, match="points at infinity"):
        shape.sample_position(0.0, mi.Point2f(0.5, 0.5))


def test_a_control_vector_does_not_make_a_surface_unbounded():
    net = np.hstack([np.array(POINTS), np.ones((6, 1))])
    net[4, 3] = 0.0
    shape = mi.load_dict(bezier(net[None]))
    ps = shape.sample_position(0.0, mi.Point2f(0.5, 0.5))
    assert np.isfinite(np.array(shape.surface_area())).all()
    assert np.array(ps.pdf)[0] > 0
