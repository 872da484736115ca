"""Boundaries on closed surfaces, laid out in one period, and bodies that have them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map
from mitsuba_bezier.io.cad import opencascade as cad
from mitsuba_bezier.io.cad.closed_surfaces import (
    BoundaryEdge,
    ClosedAxes,
    leaves_period,
    unrolled,
)

TURN = 2 * np.pi
SPHERE = ClosedAxes(np.array([0, -np.pi / 2]), np.array([TURN, 0]), ([], [-np.pi / 2, np.pi / 2]))
CYLINDER = ClosedAxes(np.zeros(2), np.array([TURN, 0]))
TORUS = ClosedAxes(np.zeros(2), np.array([TURN, TURN]))


def line(*points) -> BoundaryEdge:
    """Return straight pieces through points."""
    rows = np.column_stack([points, np.ones(len(points))])
    return BoundaryEdge(np.stack([rows[:-1], rows[1:]], axis=1))


def seam(*points) -> list[BoundaryEdge]:
    edge = line(*points)
    return [BoundaryEdge(edge.curves, seam=True), BoundaryEdge(edge.curves[::-1, ::-1], seam=True)]


def bow(center, radius, start, stop, shift=(0, 0)) -> BoundaryEdge:
    """Return part of a circle by its angles, in arcs of at most 90 degrees."""
    count = max(1, int(np.ceil(abs(stop - start) / (np.pi / 2) - 1e-9)))
    out = []
    for a, b in itertools.pairwise(np.linspace(start, stop, count + 1)):
        w = np.cos((b - a) / 2)
        rows = [
            [np.cos(a), np.sin(a), 1],
            [np.cos((a + b) / 2), np.sin((a + b) / 2), w],
            [np.cos(b), np.sin(b), 1],
        ]
        out.append(rows)
    out = np.array(out)
    place = np.array(center, dtype=float) + shift
    out[..., :2] = radius * out[..., :2] + place * out[..., 2:]
    return BoundaryEdge(out)


def turned(edge: BoundaryEdge) -> BoundaryEdge:
    return BoundaryEdge(edge.curves[::-1, ::-1], edge.seam)


def inside(edges, axes, points):
    """Tell which points are in the face that edges bound, as a render does."""
    found = unrolled(edges, axes)
    assert not isinstance(found, str), found
    curves = [c for chain in found for c in chain]
    region = closed_region(curves, 1e-9)
    trims = Trims([region], [0], [square_map()], [[[0.0, 0], [1, 1]]])
    return trims.inside(0, points)


def grid(axes, v=(-1.5, 1.5)):
    """Return points of one period that lie on no line of the cases below."""
    low, high = axes.low, axes.low + axes.period
    if not axes.period[1]:
        low, high = np.array([low[0], v[0]]), np.array([high[0], v[1]])
    u, v = (np.linspace(a + 0.0371, b - 0.0413, 23) for a, b in zip(low, high))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def near(points, center, radius, period=(TURN, 0)):
    way = points - center
    for axis in range(2):
        if period[axis]:
            way[:, axis] -= period[axis] * np.round(way[:, axis] / period[axis])
    return np.linalg.norm(way, axis=1) < radius


@pytest.mark.parametrize("left, right", itertools.product((-1, 0, 1), repeat=2))
@pytest.mark.parametrize("ways", itertools.product((False, True), repeat=2))
def test_hole_on_the_seam_of_a_sphere(left, right, ways):
    """Its halves in any period and of any direction: STEP readers mix them up."""
    r = 0.45
    halves = [
        bow((0, 0), r, np.pi / 2, -np.pi / 2, (left * TURN, 0)),
        bow((0, 0), r, -np.pi / 2, -3 * np.pi / 2, (right * TURN, 0)),
    ]
    edges = [turned(half) if way else half for half, way in zip(halves, ways)]
    edges += seam((0, -np.pi / 2), (0, -r)) + seam((TURN, r), (TURN, np.pi / 2))
    edges += [line((0, np.pi / 2), (TURN, np.pi / 2)), line((TURN, -np.pi / 2), (0, -np.pi / 2))]
    edges.append(bow((3, 0.3), 0.5, 0, TURN if ways[0] else -TURN, (right * TURN, 0)))
    assert leaves_period(edges, SPHERE)
    points = grid(SPHERE)
    want = ~near(points, (0, 0), r) & ~near(points, (3, 0.3), 0.5)
    assert (inside(edges, SPHERE, points) == want).all()


@pytest.mark.parametrize("start", [0.0, 1.0, -3.0, 11.0])
@pytest.mark.parametrize("with_seam", [False, True])
@pytest.mark.parametrize("ways", itertools.product((False, True), repeat=2))
def test_two_loops_around_a_cylinder(start, with_seam, ways):
    waves = []
    for k, (height, way) in enumerate(zip((-0.7, 0.6), ways)):
        u = start + 2 * k + TURN * np.arange(9) / 8
        wave = line(*zip(u, height + 0.3 * np.sin(4 * u - 4 * start)))
        waves.append(turned(wave) if way else wave)
    edges = list(waves)
    if with_seam:
        at = start + 2
        edges += seam((at, -0.7 + 0.3 * np.sin(8)), (at, 0.6))
    points = grid(CYLINDER)
    if with_seam:  # then a period begins there
        points[:, 0] += (start + 2) % TURN
    heights = []
    for k, height in enumerate((-0.7, 0.6)):
        u = start + 2 * k + TURN * np.arange(9) / 8
        v = height + 0.3 * np.sin(4 * u - 4 * start)
        heights.append(np.interp((points[:, 0] - u[0]) % TURN + u[0], u, v))
    want = (points[:, 1] > heights[0]) & (points[:, 1] < heights[1])
    assert (inside(edges, CYLINDER, points) == want).all() and want.any()


@pytest.mark.parametrize("upper", [False, True])
@pytest.mark.parametrize("told", ["seam", "direction"])
def test_cap_of_a_sphere(upper, told):
    """One loop that wraps around: which side of it is the face?"""
    points = grid(SPHERE)
    loop = line((0.5, 0.4), (3, 0.4), (0.5 + TURN, 0.4))
    if told == "seam":
        pole = np.pi / 2 if upper else -np.pi / 2
        edges = [loop, *seam((0.5, 0.4), (0.5, pole)), line((0.5, pole), (0.5 + TURN, pole))]
        points[:, 0] += 0.5
    else:
        edges = [loop if upper else turned(loop)]
    assert (inside(edges, SPHERE, points) == ((points[:, 1] > 0.4) == upper)).all()


def test_whole_sphere_and_torus():
    pole = np.pi / 2
    edges = [*seam((0, -pole), (0, pole)), line((0, pole), (TURN, pole))]
    assert inside(edges, SPHERE, grid(SPHERE)).all()
    edges = [*seam((0, 0), (TURN, 0)), *seam((TURN, 0), (TURN, TURN))]
    assert inside(edges, TORUS, grid(TORUS)).all()


@pytest.mark.parametrize("center", [(0, 0), (0.1, 3), (3, TURN), (2, 2), (-TURN, 3 * TURN + 0.2)])
@pytest.mark.parametrize("told", ["seam", "direction"])
@pytest.mark.parametrize("hole", [False, True])
def test_hole_in_a_torus(center, told, hole):
    """At its two seams, where they meet, in another period; or all but the hole."""
    edges = [bow(center, 0.6, 0, -TURN if hole else TURN)]
    if told == "seam" and hole:
        edges = [turned(edges[0])]  # the direction is not asked
        edges += seam((0, 1.5), (0, 5.2)) + seam((1.5, 0), (4.7, 0))
    points = grid(TORUS)
    want = near(points, center, 0.6, (TURN, TURN)) != hole
    assert (inside(edges, TORUS, points) == want).all()


def test_part_across_the_seam_with_a_hole_of_another_period():
    outer = line((5.5, -1), (7.5, -1), (7.5, 1), (5.5, 1), (5.5, -1))
    hole = bow((0.5, 0.1), 0.4, 0, TURN)
    assert leaves_period([outer, hole], CYLINDER) and not leaves_period([outer], CYLINDER)
    points = grid(CYLINDER)
    u = (points[:, 0] - 5.5) % TURN
    want = (u < 2) & (np.abs(points[:, 1]) < 1) & ~near(points, (0.5, 0.1), 0.4)
    assert (inside([outer, hole], CYLINDER, points) == want).all()


def test_axes_exchanged_and_gaps_at_the_seam():
    """Edges that end beside the seam, as files with six digits have them."""
    axes = ClosedAxes(np.array([-1.0, 0]), np.array([0, 1.0]), ([-1.0, 1.0], []))
    gap = 1e-5
    edges = [
        line((0.3, gap), (0.3, 0.4)),
        line((0.3, 0.4 + gap), (0.2, 0.7), (0.3, 1 - gap)),
        line((-0.6, 0), (-0.6, 1)),
        *seam((-0.6, 0), (0.3, 0)),
    ]
    points = np.stack(np.meshgrid(np.linspace(-0.97, 0.96, 17), np.linspace(0.03, 0.98, 13)), -1)
    points = points.reshape(-1, 2)
    right = np.interp(points[:, 1], [0, 0.4, 0.7, 1], [0.3, 0.3, 0.2, 0.3])
    want = (points[:, 0] > -0.6) & (points[:, 0] < right)
    assert (inside(edges, axes, points) == want).all()


@pytest.mark.parametrize("edges", [[line((0, 0.3), (TURN, 0.3))], [line((1, 0), (2, 1))]])
def test_open_boundaries_are_refused(edges):
    assert unrolled(edges, CYLINDER) == "its boundary is not closed"


# ---------------------------------------------------------------------------- bodies


BODIES = {
    "ball": ("sphere", (12.0,), 4.0, (0, 0), 4 * np.pi * 12 * np.sqrt(12**2 - 4**2)),
    "torus": ("torus", (10.0, 4.0), 1.5, (9, 0.5), None),
}


@pytest.mark.parametrize(
    "axis", [(0, 0, 1), (1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 2, 3), (-3, 1, 1)]
)
@pytest.mark.parametrize("name", BODIES)
def test_bores_are_open(tmp_path, name, axis):
    """Nothing of the body is in the bore, and nothing is cut off elsewhere."""
    pytest.importorskip("OCP")
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepGProp import BRepGProp
    from OCP.BRepPrimAPI import (
        BRepPrimAPI_MakeCylinder,
        BRepPrimAPI_MakeSphere,
        BRepPrimAPI_MakeTorus,
    )
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
    from OCP.GProp import GProp_GProps
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    kind, sizes, bore, (x, y), outside = BODIES[name]
    make = {"sphere": BRepPrimAPI_MakeSphere, "torus": BRepPrimAPI_MakeTorus}[kind]
    body = make(gp_Ax2(gp_Pnt(0, 0, 0), gp_Dir(*axis)), *sizes).Shape()
    drill = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(x, y, -30), gp_Dir(0, 0, 1)), bore, 60).Shape()
    body = BRepAlgoAPI_Cut(body, drill).Shape()
    total = GProp_GProps()
    BRepGProp.SurfaceProperties_s(body, total, 1e-9)
    writer = STEPControl_Writer()
    writer.Transfer(body, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(tmp_path / "body.step"))
    model = cad.read_here(tmp_path / "body.step", trims=True)
    assert not model.report.refused
    u, v = (np.arange(40) + 0.5) / 40, (np.arange(40) + 0.5) / 40
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    uv = np.concatenate([uv[uv.sum(axis=1) < 1 - 1e-9], uv[uv.sum(axis=1) < 1 - 1e-9] - 1 / 120])
    area = curved = 0.0
    for patches, trims in zip(model.groups, model.trims or [None] * len(model.groups)):
        patch, at = np.repeat(np.arange(len(patches)), len(uv)), np.tile(uv, (len(patches), 1))
        d = patches.differential(patch, at)
        keep = trims.inside(patch, at) if trims is not None else np.ones(len(at), dtype=bool)
        assert (np.hypot(*(d.p[keep, :2] - (x, y)).T) > bore - 1e-5).all()
        size = np.linalg.norm(np.cross(d.dp_du, d.dp_dv), axis=1) / 2 / len(uv)
        area += size @ keep
        on_ball = np.abs(np.linalg.norm(d.p, axis=1) - sizes[0]) < 1e-9
        curved += size[on_ball] @ keep[on_ball]
    # 1 %: the rule has 1560 points a patch, and the boundary passes between them
    assert area == pytest.approx(total.Mass(), rel=0.01)
    if outside:
        assert curved == pytest.approx(outside, rel=0.01)
