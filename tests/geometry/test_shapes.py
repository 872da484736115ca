"""The builders: implicit equations, closedness, orientation, volumes, edges, errors."""

from __future__ import annotations

import numpy as np
import pytest
from surface_checks import implicit, parameters, unpaired_edges, volume, winding

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.geometry.quadric_types import classify_quadric
from mitsuba_bezier.geometry.quadrics import fit_quadrics
from mitsuba_bezier.geometry.triangles import BezierTriangles

CENTER = np.array([1.0, -2.0, 0.5])
PI = np.pi


def quadric(diagonal, linear=0.0) -> np.ndarray:
    """``diagonal . (x^2, y^2, z^2, 1) = linear z`` around CENTER."""
    a = np.diag(np.array(diagonal, dtype=float))
    a[2, 3] = a[3, 2] = -linear / 2
    back = np.eye(4)
    back[:3, 3] = -CENTER
    return back.T @ a @ back


def make(name: str, **parameters) -> BezierTriangles:
    return getattr(shapes, name)(center=CENTER, **parameters)


#: name, parameters, quadric, type, patches, volume when capped. rx, ry, rz = 2, 1, 0.5.
QUADRICS = [
    ("ellipsoid", {"radii": (2, 1, 0.5)}, quadric([1 / 4, 1, 4, -1]), "ellipsoid", 8, None),
    (
        "ellipsoid",
        {"radii": (2, 1, 0.5), "cover": "tetrahedral"},
        quadric([1 / 4, 1, 4, -1]),
        "ellipsoid",
        10,
        None,
    ),
    (
        "elliptic_paraboloid",
        {"radii": (2, 1), "height": 3},
        quadric([3 / 4, 3, 0, 0], 1),
        "elliptic paraboloid",
        3,
        PI * 2 * 3 / 2,
    ),
    (
        "hyperboloid_one_sheet",
        {"radii": (2, 1, 0.5), "height": 1.5},
        quadric([1 / 4, 1, -4, -1]),
        "hyperboloid of one sheet",
        6,
        # pi rx ry times the integral of 1 + (z/rz)^2 over |z| < 0.75
        PI * 2 * 2 * (0.75 + 4 * 0.75**3 / 3),
    ),
    (
        "hyperboloid_two_sheets",
        {"radii": (2, 1, 0.5), "height": 0.5},
        quadric([1 / 4, 1, -4, 1]),
        "hyperboloid of two sheets",
        6,
        # pi rx ry times twice the integral of (z/rz)^2 - 1 over 0.5 < z < 1
        PI * 2 * 2 * (4 / 3 * (1 - 1 / 8) - 0.5),
    ),
    (
        "cylinder",
        {"radii": (2, 1), "height": 3},
        quadric([1 / 4, 1, 0, -1]),
        "elliptic cylinder",
        6,
        PI * 2 * 3,
    ),
    (
        "hyperbolic_paraboloid",
        {"radii": (2, 1), "height": 3},
        quadric([3 / 4, -3, 0, 0], 1),
        "hyperbolic paraboloid",
        2,
        None,
    ),
]
IDS = [f"{c[0]} {k}" for k, c in enumerate(QUADRICS)]


@pytest.mark.parametrize(("name", "how", "a", "kind", "count", "_volume"), QUADRICS, ids=IDS)
def test_quadrics_satisfy_their_equation(name, how, a, kind, count, _volume):
    patches = make(name, **how)
    assert len(patches) == count
    patch, uv = parameters(np.random.default_rng(1), count, 1000)
    assert implicit(a, patches.evaluate(patch, uv)) < 1e-14  # rounding
    fitted, ok = fit_quadrics(patches.control_points)
    assert ok.all()
    assert {classify_quadric(q) for q in fitted} == {kind}
    assert (patches.weights >= 0).all()
    if patches.degree == 2:
        # corner weights 1: equal parameters on common edges
        assert np.allclose(patches.weights[:, [0, 3, 5]], 1, rtol=1e-14)


def test_cone_satisfies_its_equation():
    patches = make("cone", radii=(2, 1), height=3)
    patch, uv = parameters(np.random.default_rng(2), 3, 1000)
    x = patches.points(patch, uv) - CENTER
    assert np.allclose((x[:, 0] / 2) ** 2 + x[:, 1] ** 2, (1 - x[:, 2] / 3) ** 2, atol=1e-14)
    assert (x[:, 2] <= 3).all() and (x[:, 2] >= -1e-15).all()  # one nappe
    assert classify_quadric(fit_quadrics(patches.control_points)[0][0]) == "cone"
    # the apex is a corner, with finite values and a normal from inside the patch
    assert np.allclose(patches.points([0, 1, 2], [[0, 0]] * 3), CENTER + np.array([0, 0, 3]))
    assert np.allclose(np.linalg.norm(patches.normals([0, 1, 2], [[0, 0]] * 3), axis=1), 1)


SOLIDS = [(c[0], c[1], c[5]) for c in QUADRICS if c[5]] + [
    ("cone", {"radii": (2, 1), "height": 3}, PI * 2 * 3 / 3)
]


@pytest.mark.parametrize(("name", "how", "want"), SOLIDS, ids=[s[0] for s in SOLIDS])
def test_caps_close_solids(name, how, want):
    shell = make(name, **how)
    closed = make(name, **how, capped=True)
    assert unpaired_edges(shell)
    assert not unpaired_edges(closed)
    # outwards, without overlap: the divergence theorem, with 1e-9 for the Gauss rule
    assert abs(volume(closed) / want - 1) < 1e-9
    # the shell comes first and is the same
    assert closed[np.arange(len(shell))] == shell or name == "hyperboloid_two_sheets"


CLOSED = [
    ("ellipsoid", {"radii": (2, 1, 0.5)}, [0, 0, 0], PI * 4 / 3),
    ("ellipsoid", {"radii": 0.7, "cover": "lunes"}, [0, 0, 0], PI * 4 / 3 * 0.7**3),
    ("torus", {"radius": 2, "tube": 0.75}, [2, 0, 0], 2 * PI**2 * 2 * 0.75**2),
    ("torus", {"radius": 2, "tube": 0.75, "segments": 3}, [0, 2, 0], 2 * PI**2 * 2 * 0.75**2),
]


@pytest.mark.parametrize(("name", "how", "inside", "want"), CLOSED)
def test_closed_surfaces(name, how, inside, want):
    patches = make(name, **how)
    assert not unpaired_edges(patches)
    assert abs(volume(patches) / want - 1) < 1e-9
    # quadrature of 1/r^2 at a distance of the size of a patch
    assert abs(winding(patches, CENTER + inside, 2) - 1) < 1e-3
    assert abs(winding(patches, CENTER + np.array([0, 0, 5]), 2)) < 1e-5


@pytest.mark.parametrize("segments", [3, 4, 5])
def test_torus_equation_and_area(segments):
    patches = make("torus", radius=2, tube=0.75, segments=segments)
    assert (len(patches), patches.degree) == (2 * segments**2, 4)
    patch, uv = parameters(np.random.default_rng(3), len(patches), 1000)
    x = patches.points(patch, uv) - CENTER
    ring = np.hypot(x[:, 0], x[:, 1]) - 2
    assert np.allclose(np.hypot(ring, x[:, 2]), 0.75, atol=1e-14)
    outwards = np.column_stack([x[:, :2] * (ring / (ring + 2))[:, None], x[:, 2]]) / 0.75
    assert np.allclose(patches.normals(patch, uv), outwards, atol=1e-12)
    assert np.isclose(patches.area(1e-8).sum(), 4 * PI**2 * 2 * 0.75, rtol=1e-8)


def test_saddle_is_a_graph_seen_from_above():
    patches = make("hyperbolic_paraboloid", radii=(2, 1), height=3)
    patch, uv = parameters(np.random.default_rng(4), 2, 500)
    x = patches.points(patch, uv) - CENTER
    assert np.allclose(x[:, 2], 3 * ((x[:, 0] / 2) ** 2 - x[:, 1] ** 2), atol=1e-14)
    assert (patches.normals(patch, uv)[:, 2] > 0).all()
    assert np.ptp(patches.weights) < 1e-15  # polynomial
    corners = patches.points([0] * 3 + [1] * 3, [[1, 0], [0, 1], [0, 0]] * 2) - CENTER
    assert {tuple(c) for c in np.round(corners[:, :2]).tolist()} == {
        (2, -1),
        (-2, 1),
        (-2, -1),
        (2, 1),
    }


@pytest.mark.parametrize("height", [1e-3, 0.1, 10.0, 1e3])
def test_hyperboloids_of_any_height(height):
    one = shapes.hyperboloid_one_sheet(height=height, capped=True)
    z = height / 2
    assert (one.weights > 0).all() and not unpaired_edges(one)
    # 4 levels: tall ones are uneven
    assert abs(volume(one, 4) / (2 * PI * (z + z**3 / 3)) - 1) < 1e-6
    # the terms of S'AP cancel to 1/height^2 of their size
    patch, uv = parameters(np.random.default_rng(5), 6, 500)
    error = implicit(np.diag([1.0, 1, -1, -1]), one.evaluate(patch, uv))
    assert error < 1e-15 * (4 + height**2)
    two = shapes.hyperboloid_two_sheets(height=height)
    patch, uv = parameters(np.random.default_rng(5), 6, 500)
    assert implicit(np.diag([1.0, 1, -1, 1]), two.evaluate(patch, uv)) < 1e-14
    heights = np.abs(two.points(patch, uv)[:, 2])
    assert heights.min() >= 1 - 1e-12 and heights.max() <= 1 + height * (1 + 1e-12)


def test_disk():
    patches = make("disk", radii=(2, 1))
    patch, uv = parameters(np.random.default_rng(6), 3, 500)
    x = patches.points(patch, uv) - CENTER
    assert np.abs(x[:, 2]).max() < 1e-15
    assert ((x[:, 0] / 2) ** 2 + x[:, 1] ** 2 <= 1 + 1e-14).all()
    assert np.allclose(patches.normals(patch, uv), [0, 0, 1])
    assert np.isclose(patches.area().sum(), 2 * PI, rtol=1e-10)
    # the parameters are regular at the centre
    d = patches.differential([0], [[0, 0]])
    assert np.linalg.norm(np.cross(d.dp_du, d.dp_dv)) > 0.5


def test_planes_run_to_the_horizon():
    point, u, v = np.array([1.0, 2, 3]), np.array([2.0, 0, 1]), np.array([0.0, 1, 0])
    wedge = shapes.quarter_plane(point, u, v)
    a, b = 3.0, 0.5
    x = wedge.points(0, [[a / (a + b + 1), b / (a + b + 1)]])[0]
    assert np.allclose(x, point + a * u + b * v, atol=1e-14)
    ends = wedge.evaluate(0, [[1, 0], [0, 1]])
    assert ends.tolist() == [[*u, 0], [*v, 0]]
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    for patches, angle in (
        (wedge, PI / 2),
        (shapes.half_plane(point, u, v), PI),
        (shapes.plane(point, u, v), 2 * PI),
    ):
        count = len(patches)
        assert np.allclose(patches.normals(np.arange(count), [[0.3, 0.3]] * count), normal)
        # angles at the common corner, in coordinates where u and v are orthonormal
        arms = patches.control_points[:, :2, :3] @ np.linalg.pinv(np.array([u, v]))
        turns = np.linalg.det(arms) / np.prod(np.linalg.norm(arms, axis=2), axis=1)
        assert np.isclose(np.arcsin(turns).sum(), angle)
        assert np.array_equal(patches.control_points[:, 2], np.tile([*point, 1], (count, 1)))
    # every ideal point of the plane belongs to the whole plane, in opposite pairs
    ideal = shapes.plane(point, u, v).control_points[:, 0, :3]
    assert np.allclose(ideal.sum(axis=0), 0)


@pytest.mark.parametrize(
    ("message", "call"),
    [
        ("center: .*shape", lambda: shapes.ellipsoid(center=(0, 0))),
        ("center: .*NaN", lambda: shapes.cone(center=(0, 0, np.nan))),
        ("radii: expected positive lengths", lambda: shapes.ellipsoid(radii=(1, 0, 1))),
        ("radii: .*shape", lambda: shapes.ellipsoid(radii=(1, 1))),
        ("radii: .*shape", lambda: shapes.cylinder(radii=(1, 1, 1))),
        ("radii: .*positive", lambda: shapes.disk(radii=-1)),
        ("radii: .*finite", lambda: shapes.disk(radii="big")),
        ("height: expected a positive length", lambda: shapes.cone(height=0)),
        ("height: .*positive", lambda: shapes.cylinder(height=-2)),
        ("height: .*NaN", lambda: shapes.elliptic_paraboloid(height=np.inf)),
        ("height: .*shape", lambda: shapes.hyperbolic_paraboloid(height=(1, 2))),
        ("height", lambda: shapes.hyperboloid_one_sheet(height=None)),
        ("height", lambda: shapes.hyperboloid_two_sheets(height=-1)),
        ("cover", lambda: shapes.ellipsoid(cover="cubic")),
        ("tube: expected less than the radius 1, got 1", lambda: shapes.torus(tube=1)),
        ("tube: .*positive", lambda: shapes.torus(tube=0)),
        ("radius: .*positive", lambda: shapes.torus(radius=-1)),
        ("segments: .*3 or more, got 2", lambda: shapes.torus(segments=2)),
        ("segments: .*integer", lambda: shapes.torus(segments=3.5)),
        ("u, v: .*independent", lambda: shapes.plane(u=(1, 0, 0), v=(2, 0, 0))),
        ("u, v: .*independent", lambda: shapes.quarter_plane(u=(0, 0, 0))),
        ("along, inwards: .*independent", lambda: shapes.half_plane(along=(0, 1, 0))),
        ("point: .*shape", lambda: shapes.half_plane(point=(0, 1))),
        ("corner: .*shape", lambda: shapes.quarter_plane(corner=3)),
    ],
)
def test_errors(message, call):
    with pytest.raises(GeometryError, match=message):
        call()
