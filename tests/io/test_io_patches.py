"""Geomview, BezierView, OBJ and PLY files, and the knot insertion behind the NURBS readers."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest

from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError, GeometryError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.tensor import evaluate_tensor
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io import FormatWarning, bezierview, ply
from mitsuba_bezier.io.nurbs import curve_to_bezier, surface_to_bezier
from mitsuba_bezier.io.tensor_nets import fan


def put(tmp_path, text: str, name: str):
    path = tmp_path / name
    path.write_text(text)
    return path


def euclidean(h: np.ndarray) -> np.ndarray:
    return h[..., :3] / h[..., 3:]


# ---------------------------------------------------------------------------- Geomview

# The exact torus of Geomview's examples (R = 1, tube from -1/2 to 1/2 of y ...): a quarter of
# it, with three control points at infinity.
TORUS = """#rational patches for torus (exact)
BEZ224
 -1.0 .5 0 1    0 0 1.0 0   1.0 .5 0 1
 -.5  0  0 0    0 0 .5  0   .5  0  0 0
 -1.0 -.5 0 1   0 0 1.0 0   1.0 -.5 0 1
"""


def test_bez_with_control_points_at_infinity(tmp_path):
    t = io.load(put(tmp_path, TORUS, "torus.bez"))
    assert (len(t), t.degree) == (2, 4)
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 50)[:, :2]
    for patch in range(2):
        x, y, z = t.points(patch, uv).T
        # the tube is a circle of radius 1/2 about the circle of radius 1 in the plane y = 0;
        # 1e-13: rounding of terms of size 1
        np.testing.assert_allclose((np.hypot(x, z) - 1) ** 2 + y**2, 0.25, atol=1e-13)
    assert (t.points(0, uv)[:, 2] >= 0).all()  # the half of the control vectors


def test_bez_order_of_points(tmp_path):
    # u first: degree 1 along u, 2 along v
    t = io.load(put(tmp_path, "BEZ123  0 0 0 1 0 0   0 1 0 1 1 0   0 2 0 1 2 1", "a.bez"))
    corners = t.points(0, [[1, 0], [0, 1], [0, 0]])  # (s, t) = (1, 0), (0, 1), (0, 0)
    assert corners.tolist() == [[1, 0, 0], [0, 2, 0], [0, 0, 0]]


def test_bez_headers(tmp_path):
    net = " ".join(f"{i} {j} {i * j}" for j in range(4) for i in range(4))
    plain = io.load(put(tmp_path, "BEZ333 " + net, "a.bez"))
    st, color = " 0" * 8, " 1" * 16
    assert io.load(put(tmp_path, "BBP\n" + net, "a.bbp")) == plain
    wrapped = "{ appearance { +face { x } } BBP " + net + "}"
    assert io.load(put(tmp_path, wrapped, "a.bez")) == plain
    for text in (f"STBBP {net}{st}", f"BEZ333_ST {net}{st}", f"CBEZ333_ST {net}{st}{color}"):
        with pytest.warns(FormatWarning, match="texture coordinates"):
            assert io.load(put(tmp_path, text, "a.bez")) == plain


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("BEZ735 1", "line 1: expected a header such as BEZ334.*'BEZ735'"),
        ("BEZ113 1 2 3\n4 5 6 7", "line 2: expected 12 numbers for patch 0.*end of the file"),
        ("BEZ113", "at least one patch"),
        ("", "expected a header"),
        ("BEZ113\n0 0 0 1 0 0\n0 1 zero 1 1 0", "line 3: expected a finite number.*'zero'"),
        ("BEZ113 0 0 0 1 0 0 0 1 0 1 1 1e999", "finite number.*'1e999'"),
        ("BEZ113 0 0 0 1 0 0 0 1 0 1 1 0 7", "line 1"),
        ("appearance { { } BEZ113", "closing brace of 'appearance'"),
        ("BEZ113 BINARY\n", "BINARY"),
        ("BEZ114 " + "0 " * 16, "face 0.*only zero"),
        ("BEZ113 \0", "a null byte"),
    ],
)
def test_bez_bad(tmp_path, text, message):
    with pytest.raises(FileFormatError, match=message):
        io.load(put(tmp_path, text, "a.bez"))


def test_off(tmp_path):
    text = """OFF # a pyramid
    5 6 8
    0 0 0  1 0 0  1 1 0  0 1 0  .5 .5 1
    4 0 3 2 1 255 0 0  # with a colour
    3 0 1 4
    3 1 2 4 0.5 0.5 0.5 1
    3 2 3 4
    3 3 0 4
    2 0 1
    """
    with pytest.warns(FormatWarning, match="5 of 6 faces.*fewer than three corners"):
        t = io.load(put(tmp_path, text, "a.off"))
    assert (len(t), t.degree) == (6, 1)
    # base 1, four sides of height sqrt(1 + 1/4); 1e-15: rounding
    assert t.area().sum() == pytest.approx(1 + 2 * np.sqrt(1.25), abs=1e-14)


def test_off_variants(tmp_path):
    points = ["0 0 0", "1 0 0", "0 1 0"]
    plain = io.load(put(tmp_path, "OFF 3 1 3 " + " ".join(points) + " 3 0 1 2", "a.off"))
    for head, extra in (("NOFF", " 0 0 1"), ("COFF", " 1 1 1 1"), ("STOFF", " 0 0"), ("", "")):
        body = " ".join(p + extra for p in points)
        assert io.load(put(tmp_path, f"{head} 3 1 3 {body} 3 0 1 2", "a.off")) == plain
    four = io.load(put(tmp_path, "4OFF 3 1 3 0 0 0 2  1 0 0 0  0 1 0 1  3 0 1 2", "a.off"))
    assert four.control_points[0].tolist() == [[0, 0, 0, 2], [1, 0, 0, 0], [0, 1, 0, 1]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("OFF 99999999 1 0 0 0 0", "number of vertices from 1 to 6"),
        ("OFF 3 1 3 0 0 0 1 0 0 0 1 0 3 0 1 3", "a vertex of face 0 from 0 to 2, got '3'"),
        ("OFF 3 1 3 0 0 0 1 0 0 0 1 0 3 0 1", "a vertex of face 0.*end of the file"),
        ("OFF 3 2 3 0 0 0 1 0 0 0 1 0 3 0 1 2", "corners of face 1.*end of the file"),
        ("OFF 3 0 3 0 0 0 1 0 0 0 1 0", "at least one face"),
        ("OFF BINARY\n", "BINARY"),
        ("mesh", "number of vertices.*'mesh'"),
    ],
)
def test_off_bad(tmp_path, text, message):
    with pytest.raises(FileFormatError, match=message):
        io.load(put(tmp_path, text, "a.off"))


def test_fan():
    square = np.array([[0, 0, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1], [0, 1, 0, 1]], float)
    assert fan(square).shape == (2, 3, 4)
    assert fan(square + np.array([1e6, 0, 0, 0])) is not None
    dented = square.copy()
    dented[2, :2] = 0.2
    assert fan(dented) is None
    assert fan(np.concatenate([square, [[0.5, 1e-8, 0, 1]]])[[0, 4, 1, 2, 3]]) is not None
    star = square[[0, 2, 1, 3]]  # crosses itself
    assert fan(star) is None
    assert fan(square[[0, 1, 1, 0]]) is None
    saddle = square + np.array([0, 0, 1, 0]) * [[0], [0.3], [0], [0.3]]
    assert fan(saddle) is not None
    # a strip that reaches infinity: two finite corners, two ideal ones of one direction each
    strip = np.array([[0, 0, 0, 1], [1, 0, 0, 1], [1, 3, 0, 0], [-1, 3, 0, 0]], float)
    assert fan(strip) is not None
    assert fan(strip[[0, 1, 3, 2]]) is None


# ---------------------------------------------------------------------------- BezierView


def test_bv_kinds(tmp_path):
    # the picture of the format's description: 0 1 2 3 is the lowest row, 9 the top
    cubic = "\n".join(f"{i} 0 0" for i in range(10))
    text = f"""Group 1 name #5
3
3
{cubic}
group 2 other
4
1
0 0 0  0 1 0
1 0 0  1 1 0
5
1 2
0 0 0  0 1 0  0 2 0
1 0 0  1 1 0  1 2 5
8
1 1
0 0 0 1  0 2 0 2
1 0 0 1  3 3 0 3
1
4 2
0 0 0  1 0 0  1 1 0  0 1 0
3 0 1 2
4 0 1 2 3
9
1 2
0 0 0 1 0 0 0 1 0
{" 0 0 1" * 6}
10
1 1 1 1
0 0 0  0 1 0  1 0 0  1 1 0
{" 0 0 1" * 4}
"""
    model = io.read(put(tmp_path, text, "a.bv"))
    assert (model.report.faces, model.report.converted) == (8, 8)
    assert [(len(g), g.degree) for g in model.groups] == [(4, 1), (6, 2), (3, 3)]
    assert "kinds 9 and 10" in model.report.notes[0]
    cubic_net = model.groups[2].control_points[0]
    rows = {(3, 0): 0, (2, 1): 1, (1, 2): 2, (0, 3): 3, (2, 0): 4, (1, 1): 5, (0, 2): 6}
    rows |= {(1, 0): 7, (0, 1): 8, (0, 0): 9}
    for (i, j), number in rows.items():
        assert cubic_net[bernstein.row(3, i, j)].tolist() == [number, 0, 0, 1]
    # the first index of a tensor-product patch runs along x: z of the corner (1, 1) is 5
    five = model.groups[2].points(2, [[0, 0]])
    assert five.tolist() == [[1, 2, 5]]


def test_bv_rational_is_homogeneous(tmp_path):
    t = io.load(put(tmp_path, "8 1 1  0 0 0 1  0 2 0 2  1 0 0 1  3 3 0 3", "a.bv"))
    assert t.points(1, [[0, 0]]).tolist() == [[1, 1, 0]]
    assert t.control_points[1, -1].tolist() == [3, 3, 0, 3]


@pytest.mark.parametrize("n", [1, 2, 3, 5])
@pytest.mark.parametrize("rational", [False, True])
def test_bv_round_trip(tmp_path, n, rational):
    rng = np.random.default_rng(n)
    nets = rng.normal(size=(3, bernstein.size(n), 4))
    nets[..., 3] = rng.uniform(0.5, 2, nets.shape[:2]) if rational else 1.0
    t = BezierTriangles(nets)
    io.save(t, tmp_path / "a.bv")
    back = io.load(tmp_path / "a.bv")
    if not rational:
        assert back == t  # every bit
        return
    # a triangle comes back as two, of degree 2n, with the edge s = 0 collapsed to corner A:
    # (u, v, w) = (1 - s, s (1 - t), s t); the first has s = u', t = v'
    assert (len(back), back.degree) == (6, 2 * n)
    st = rng.dirichlet([1, 1, 1], 20)[:, :2]
    for patch in range(3):
        for half, (a, b) in enumerate((st.T, 1 - st.T)):
            uv = np.stack([1 - a, a * (1 - b)], axis=1)
            # 1e-12: sums of 66 terms of size 10
            np.testing.assert_allclose(
                back.points(2 * patch + half, st), t.points(patch, uv), rtol=0, atol=1e-12
            )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("7\n1 1", r"line 1: expected a kind of patch out of 1 \(polyhedron\).*got 7"),
        ("3\n41", "degree from 1 to 40, got '41'"),
        ("5\n3 3\n0 0 0", "48 numbers for patch 0"),
        ("1\n1000000 1\n0 0 0", "number of vertices from 1"),
        ("three", "kind of a patch from 0 to 99, got 'three'"),
        ("", "at least one patch"),
        ("Group 1 a", "at least one patch"),
    ],
)
def test_bv_bad(tmp_path, text, message):
    with pytest.raises(FileFormatError, match=message):
        io.load(put(tmp_path, text, "a.bv"))


# ---------------------------------------------------------------------------- knot insertion


def cox_de_boor(knots, p, i, t):
    """B-spline basis function by its definition: the oracle."""
    if p == 0:
        return float(knots[i] <= t < knots[i + 1])
    out = 0.0
    if knots[i + p] > knots[i]:
        out += (t - knots[i]) / (knots[i + p] - knots[i]) * cox_de_boor(knots, p - 1, i, t)
    if knots[i + p + 1] > knots[i + 1]:
        out += (
            (knots[i + p + 1] - t)
            / (knots[i + p + 1] - knots[i + 1])
            * cox_de_boor(knots, p - 1, i + 1, t)
        )
    return out


KNOTS = {
    "clamped": (3, [0, 0, 0, 0, 1, 2, 2, 5, 5, 5, 5]),
    "open": (3, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
    "quadratic, double": (2, [0, 0, 0, 1, 1, 2, 2, 3, 3, 3]),
    "discontinuous": (1, [0, 0, 1, 1, 1, 2, 2]),
}


@pytest.mark.parametrize("p, knots", KNOTS.values(), ids=KNOTS.keys())
@pytest.mark.parametrize("q, other", KNOTS.values(), ids=KNOTS.keys())
def test_surface_to_bezier(p, knots, q, other):
    rng = np.random.default_rng(p + 10 * q)
    m, n = len(knots) - p - 1, len(other) - q - 1
    net = rng.normal(size=(m, n, 4))
    patches, domains = surface_to_bezier(net, knots, other, (p, q), ([1.7], [0.3, 100]))
    area = np.prod(domains[:, :, 1] - domains[:, :, 0], axis=1).sum()
    assert area == pytest.approx((knots[-p - 1] - knots[p]) * (other[-q - 1] - other[q]))
    for patch, domain in zip(patches, domains):
        for st in rng.uniform(0, 1, (2, 2)):
            u, v = domain[:, 0] + st * (domain[:, 1] - domain[:, 0])
            bu = np.array([cox_de_boor(knots, p, i, u) for i in range(m)])
            bv = np.array([cox_de_boor(other, q, j, v) for j in range(n)])
            expected = np.einsum("i,j,ijc->c", bu, bv, net)
            # 1e-13: a dozen roundings of numbers of size 3
            np.testing.assert_allclose(evaluate_tensor(patch, st)[0], expected, atol=1e-13)


def test_curve_to_bezier_of_a_bezier_curve():
    net = np.random.default_rng(1).normal(size=(4, 3))
    assert np.array_equal(curve_to_bezier(net, [0, 0, 0, 0, 1, 1, 1, 1], 3), net[None])


@pytest.mark.parametrize(
    ("knots", "message"),
    [
        ([0, 0, 1], "4 knots for 2 control points"),
        ([0, 0, 1, 0], "do not fall"),
        ([0, 0, 1, np.nan], "finite"),
        ([0, 1, 1, 2], "positive length"),
    ],
)
def test_bad_knots(knots, message):
    with pytest.raises(GeometryError, match=message):
        curve_to_bezier(np.zeros((2, 3)), knots, 1)


# ---------------------------------------------------------------------------- OBJ

# Two Bézier pieces of degree 2 along u, degree 1 along v; z = u^2 over [0, 2] x [0, 1].
PIECES = """
v 0 0 0
v 0.5 0 0 9   # not a rational type: the weight is not used
v 1 0 1
v 1.5 0 2
v 2 0 4
v 0 1 0
v 0.5 1 0
v 1 1 1
v 1.5 1 2
v 2 1 4
cstype bezier
deg 2 1
surf 0 2 0 1 1 2 3 4 5 \\
  6 7 8 9 -1
parm u 0 1 2
parm v 0 1
{trim}end
"""


def curves(*loops) -> str:
    """Polygons in (u, v) as curv2 statements, before everything else."""
    out = ["cstype bspline", "deg 1"]
    number = 0
    for loop in loops:
        out += [f"vp {u} {v}" for u, v in [*loop, loop[0]]]
        count = len(loop) + 1
        numbers = " ".join(str(number + k + 1) for k in range(count))
        number += count
        knots = " ".join(map(str, [0, *range(count), count - 1]))
        out += [f"curv2 {numbers}", f"parm u {knots}", "end"]
    return "\n".join(out) + "\n"


def area_in_plan(t: BezierTriangles) -> float:
    """Area of the projection along z, from the corners (straight edges in plan)."""
    corners = euclidean(t.control_points[:, list(bernstein.corner_rows(t.degree))])[..., :2]
    return 0.5 * np.linalg.det(corners[:, 1:] - corners[:, :1]).sum()


def test_obj_bezier_pieces(tmp_path):
    t = io.load(put(tmp_path, PIECES.format(trim=""), "a.obj"))
    assert (len(t), t.degree) == (4, 3)
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 20)[:, :2]
    for patch in range(4):
        x, _y, z = t.points(patch, uv).T
        np.testing.assert_allclose(z, x**2, atol=1e-14)  # rounding
    assert area_in_plan(t) == pytest.approx(2, abs=1e-14)


def test_obj_range(tmp_path):
    text = PIECES.format(trim="").replace("surf 0 2 0 1", "surf 0.5 1.75 0.25 1")
    t = io.load(put(tmp_path, text, "a.obj"))
    # rounding of the blossoms
    assert area_in_plan(t) == pytest.approx(1.25 * 0.75, abs=1e-14)


def test_obj_trims_along_parameter_lines(tmp_path):
    outer = [(0, 0), (2, 0), (2, 1), (0, 1)]
    hole = [(0.5, 0.25), (1.25, 0.25), (1.25, 0.5), (0.5, 0.5)]
    text = curves(outer, hole) + PIECES.format(trim="trim 0 4 1\nhole 0 4 2\n")
    t = io.load(put(tmp_path, text, "a.obj"))
    assert area_in_plan(t) == pytest.approx(2 - 0.75 * 0.25, abs=1e-14)
    centers = t.points(np.arange(len(t)), np.full((len(t), 2), 1 / 3))[:, :2]
    within = (centers > [0.5, 0.25]) & (centers < [1.25, 0.5])
    assert not within.all(axis=1).any()
    # a hole alone: the range is the outer loop; an L in two parts of one curve
    bent = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 0.5), (0, 0.5)]
    text = curves(bent) + PIECES.format(trim="hole 0 2.5 1 2.5 6 1\n")
    t = io.load(put(tmp_path, text, "a.obj"))
    assert area_in_plan(t) == pytest.approx(0.5, abs=1e-14)


def statement(cstype, degree, points, parm, first=1) -> str:
    """One curv2 with its points."""
    numbers = " ".join(str(first + k) for k in range(len(points)))
    out = [f"vp {' '.join(map(repr, p))}" for p in points]
    out += [f"cstype {cstype}", f"deg {degree}", f"curv2 {numbers}"]
    return "\n".join([*out, "parm u " + " ".join(map(str, parm)), "end"]) + "\n"


def ring() -> tuple[str, float]:
    """A circle of radius 0.3 around (0.9, 0.5), in four rational arcs."""
    c = float(np.sqrt(0.5))
    corners = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)]
    points = [
        (0.9 + 0.3 * x, 0.5 + 0.3 * y, c if k % 2 else 1.0) for k, (x, y) in enumerate(corners)
    ]
    return statement("rat bezier", 2, points, range(5)), 4.0


def through(bases: str) -> np.ndarray:
    """Points of the closed curve below, for its area."""
    t = np.linspace(0, 1, 4000)[:, None]
    corners = np.array([(0.4, 0.3), (1.2, 0.2), (1.4, 0.8), (0.6, 0.7)])
    if bases == "parabola":
        return np.concatenate([np.hstack([0.5 + t, 0.9 - 0.7 * t + 0.4 * t * t - 0.3 * t])])
    out = []
    for k in range(4):
        a, b, c, d = (corners[(k + j) % 4] for j in (-1, 0, 1, 2))
        if bases == "cardinal":  # tangents are half of what is between the neighbours
            h = (2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, -2 * t**3 + 3 * t**2, t**3 - t**2)
            out.append(h[0] * b + h[1] * (c - a) / 2 + h[2] * c + h[3] * (d - b) / 2)
        else:  # uniform cubic B-spline
            h = ((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3)
            out.append(sum(w * p for w, p in zip(h, (a, b, c, d))) / 6)
    return np.concatenate(out)


def shoelace(p: np.ndarray) -> float:
    q = np.roll(p, -1, axis=0)
    return 0.5 * abs(float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()))


def curved_cases() -> dict[str, tuple[str, str, float, int]]:
    """Curves, what a trim says of them, and the area inside."""
    corners = [(0.4, 0.3), (1.2, 0.2), (1.4, 0.8), (0.6, 0.7)]
    wrapped = [corners[(k - 1) % 4] for k in range(7)]
    text, stop = ring()
    triangle = [(0.1, 0.1), (1.9, 0.5), (0.1, 0.9), (0.1, 0.1)]
    bow = [(0.5, 0.9), (1.0, -1.0), (0.0, 0.4)]  # 0.5 + t, 0.9 - t + 0.4 t^2
    line = [(1.5, 0.3), (0.5, 0.9)]
    taylor = statement("taylor", 2, bow, [0, 1]) + statement("bezier", 1, line, [0, 1], 4)
    return {
        "circle": (text, f"0 {stop} 1", np.pi * 0.09),
        "circle, turned round": (text, f"{stop} 0 1", np.pi * 0.09),
        "halves of a circle": (text, "0 2 1 2 4 1", np.pi * 0.09),
        "triangle": (statement("bezier", 1, triangle, range(4)), "0 3 1", 0.72),
        "cardinal": (
            statement("cardinal", 3, wrapped, range(5)),
            "0 4 1",
            shoelace(through("cardinal")),
        ),
        "B-spline": (
            statement("bspline", 3, wrapped, range(11)),
            "3 7 1",
            shoelace(through("bspline")),
        ),
        "taylor": (taylor, "0 1 1 0 1 2", 0.4 / 6),
    }


@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize("word", ["trim", "hole"])
@pytest.mark.parametrize("name", curved_cases())
def test_obj_curved_trims(tmp_path, name, word, keep):
    """As for STEP: the patches with trims, or restricted to them."""
    text, loop, area = curved_cases()[name]
    path = put(tmp_path, text + PIECES.format(trim=f"{word} {loop}\n"), "a.obj")
    model = io.read(path, trims=keep)
    assert not model.report.refused, model.report.summary()
    if word == "hole":
        area = 2 - area
    nodes, weights = np.polynomial.legendre.leggauss(12)
    found = 0.0
    for group, trims in zip(model.groups, model.trims or [None] * len(model.groups)):
        if keep:
            side = (np.arange(90) + 0.5) / 90
            uv = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
            uv = np.concatenate(
                [uv[uv.sum(axis=1) < 1 - 1e-9], uv[uv.sum(axis=1) < 1.001 - 1 / 90]]
            )
            weight = np.full(len(uv), 0.5 / len(uv))
        else:
            s, t = np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2)
            uv = np.stack([s, (1 - s) * t], axis=-1).reshape(-1, 2)
            weight = (np.outer(weights, weights) * (1 - s) / 4).ravel()
        patch, at = np.repeat(np.arange(len(group)), len(uv)), np.tile(uv, (len(group), 1))
        d = group.differential(patch, at)
        np.testing.assert_allclose(d.p[:, 2], d.p[:, 0] ** 2, atol=1e-12)
        size = np.cross(d.dp_du, d.dp_dv)[:, 2] * np.tile(weight, len(group))
        assert trims is not None if keep else trims is None
        found += size @ (trims.inside(patch, at) if keep else np.ones(len(at)))
    # counted points stand for 1/8100 of a patch each; parabolas are within 1e-5
    assert found == pytest.approx(area, rel=0.02 if keep else 1e-4)


def test_obj_trims_beyond_the_range(tmp_path):
    """What is outside of the surface's range is no surface, whatever the trims enclose."""
    wide = [(-1, -0.5), (3, 0.5), (-1, 1.5), (-1, -0.5)]
    text = statement("bezier", 1, wide, range(4)) + PIECES.format(trim="trim 0 3 1\n")
    (group,) = io.read(put(tmp_path, text, "a.obj")).groups
    # v between -1/4 + u/4 and 5/4 - u/4, cut at 0 and 1: 2 less two triangles of 1 x 1/4
    assert area_in_plan(group) == pytest.approx(2 - 0.25, rel=1e-9)


def test_obj_trims_of_other_bases_are_reported(tmp_path):
    odd = statement("bmatrix", 3, [(0, 0), (2, 0.5), (0, 1), (0, 0)], [0, 1])
    text = odd + PIECES.format(trim="trim 0 1 1\n") + PIECES.format(trim="")
    report = io.read(put(tmp_path, text, "a.obj")).report
    assert (report.faces, report.converted) == (2, 1)
    assert "trimmed by curves" in report.refused[0].reason
    assert re.fullmatch(r"surf in line \d+", report.refused[0].face)


def test_obj_rational_bspline(tmp_path):
    # a quarter of a cylinder of radius 1: weights of a circle's arc, one clamped span
    c = float(np.sqrt(0.5))
    text = f"""
v 1 0 0 1
v 1 1 0 {c!r}
v 0 1 0 1
v 1 0 2 1
v 1 1 2 {c!r}
v 0 1 2 1
cstype rat bspline
deg 2 1
surf 0 1 0 1 1/1/1 2/2/2 3//3 4 5 6
parm u 0 0 0 1 1 1
parm v 0 0 1 1
end
f 1 2 3
f 1 2 3
"""
    path = put(tmp_path, text, "a.obj")
    with pytest.warns(FormatWarning, match=r"1 of 3 faces converted; refused: 2 \(polygons"):
        t = io.load(path)
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 20)[:, :2]
    x, y, _z = np.concatenate([t.points(p, uv) for p in range(2)]).T
    np.testing.assert_allclose(np.hypot(x, y), 1, atol=1e-15)  # rounding


def test_obj_other_bases_are_reported(tmp_path):
    text = PIECES.format(trim="") + PIECES.format(trim="").replace("bezier", "bmatrix")
    report = io.read(put(tmp_path, text, "a.obj")).report
    assert (report.faces, report.converted) == (2, 1)
    assert "bmatrix" in report.refused[0].reason


def test_obj_bzp(tmp_path):
    vertices = "".join(f"v {i} {j} 0\n" for j in range(4) for i in range(4))
    text = vertices + "bzp " + " ".join(map(str, range(1, 17)))
    t = io.load(put(tmp_path, text, "a.obj"))
    assert area_in_plan(t) == pytest.approx(9, abs=1e-13)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("parm v 0 1\n", ""), "line 14: expected 'parm u' and 'parm v'"),
        (("6 7 8 9 -1", "6 7 8 9"), "line 14: expected 5 x 2 control points.*got 9"),
        (("6 7 8 9 -1", "6 7 8 9 99"), "one of the 10 vertices so far, got '99'"),
        (("6 7 8 9 -1", "6 7 8 9 0"), "vertices so far, got '0'"),
        (("surf 0 2 0 1", "surf 2 0 0 1"), "a range s0 < s1"),
        (("surf 0 2 0 1", "surf 5 6 0 1"), "free-form surfaces.*nothing is left"),
        (("parm u 0 1 2", "parm u 0 2 1"), "finite knots that do not fall"),
        (("deg 2 1", "deg 2 999"), "degrees from 1 to 30"),
        (("deg 2 1", "deg 2"), "'deg' with two degrees"),
        (("end\n", ""), "'end' after 'surf'"),
        (("v 2 1 4", "v 2 1"), "line 11: expected 3 to 8 numbers after 'v'"),
        (("v 2 1 4", "v 2 1 four"), "finite numbers after 'v', got 'four'"),
        (("surf 0 2", "serf 0 2"), "'parm u ...' after 'surf'"),
        (("cstype bezier", "cstype"), "'cstype \\[rat\\] TYPE'"),
    ],
)
def test_obj_bad(tmp_path, change, message):
    text = PIECES.format(trim="")
    assert change[0] in text
    with pytest.raises(FileFormatError, match=message):
        io.load(put(tmp_path, text.replace(*change), "a.obj"))


def test_obj_trims_cannot_fill_the_memory(tmp_path):
    """A staircase of n steps asks for n^2 / 4 patches."""
    n = 700
    stairs = [(2 * ((k + 1) // 2) / n, (k // 2) * 2 / n) for k in range(n + 1)]
    text = curves([*stairs, (0, 1)]) + PIECES.format(trim=f"trim 0 {n + 2} 1\n")
    with pytest.raises(FileFormatError, match="more than 100000 patches"):
        io.load(put(tmp_path, text, "a.obj"))


# ---------------------------------------------------------------------------- PLY


def read_ply(path):
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    vertices, faces = (int(x) for x in re.findall(rb"element \w+ (\d+)", head))
    v = np.frombuffer(body, "<f4", 6 * vertices).reshape(-1, 6)
    f = np.frombuffer(body[v.nbytes :], [("n", "u1"), ("i", "<i4", 3)])
    assert len(f) == faces and (f["n"] == 3).all()
    return v[:, :3], v[:, 3:], f["i"]


def octant_pair() -> BezierTriangles:
    """A quadratic triangle and a finer neighbour that shares a curved edge with it."""
    a = [[0, 0, 0, 1], [0.5, 0, 0.4, 1], [0, 0.5, 0, 1], [1, 0, 0, 1], [0.5, 0.5, 0, 1]]
    a.append([0, 1, 0, 1])
    b = [[1, 0, 0, 1], [0.5, 0, 0.4, 1], [0.6, -3, 9, 1], [0, 0, 0, 1], [0.2, -2, 8, 1]]
    b.append([0.5, -1, 0, 1])
    return BezierTriangles([a, b])


def test_ply_error_and_normals(tmp_path):
    # a quarter of a unit sphere's worth: the paraboloid z = x^2 + y^2 has known normals
    corners = np.array([[1, 0], [0, 1], [-1, -1]], float)
    rows = []
    for ijk in bernstein.multi_indices(2):
        p, q = np.repeat(np.arange(3), ijk)
        x = (corners[p] + corners[q]) / 2
        rows.append([*x, corners[p] @ corners[q], 1])
    t = BezierTriangles(rows)
    for chord_error in (0.1, 0.01, 0.001):
        io.save(t, tmp_path / "a.ply", chord_error=chord_error)
        v, n, f = read_ply(tmp_path / "a.ply")
        half = (v[f] + v[np.roll(f, -1, axis=1)]) / 2
        gap = half[..., 2] - (half[..., 0] ** 2 + half[..., 1] ** 2)
        # vertical gaps are larger than distances; 1e-6: float32 numbers of size 2
        steep = np.sqrt(1 + 4 * 2)
        assert gap.min() > -1e-6 and gap.max() <= chord_error * steep + 1e-6
        assert gap.max() > chord_error / 20  # and not much finer than asked
        expected = np.stack([-2 * v[:, 0], -2 * v[:, 1], np.ones(len(v))], axis=1)
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        np.testing.assert_allclose(n, expected, atol=1e-6)
        flat = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
        assert (np.einsum("fc,fc->f", flat, n[f[:, 0]]) > 0).all()


def test_ply_without_cracks():
    t = octant_pair()
    v, _n, f = ply.tessellate(t, 0.01)
    resolutions = ply._resolutions(t, 0.01)
    assert resolutions[0, 3] < resolutions[1, 3]  # or there is nothing to show
    _unique, number = np.unique(np.round(v, 12), axis=0, return_inverse=True)
    edges = np.sort(number[f][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _edges, count = np.unique(edges, axis=0, return_counts=True)
    # all edges have two faces, except the four outer boundary curves
    outer = resolutions[0, [1, 2]].sum() + resolutions[1, [1, 2]].sum()
    assert (count == 1).sum() == outer and count.max() == 2
    # Euler: a disk
    assert len(_unique) - len(_edges) + len(f) == 1


def test_ply_sees_a_turning_point(tmp_path):
    """An S-shaped edge meets its chord half way."""
    net = [[0, 0, 0, 1], [1, 0, 1, 1], [0, 1, 0, 1], [2, 0, -1, 1], [1, 1, 0, 1], [0, 2, 0, 1]]
    net += [[3, 0, 0, 1], [2, 1, 0, 1], [1, 2, 0, 1], [0, 3, 0, 1]]
    assert ply._resolutions(BezierTriangles(net), 0.01)[0, 0] >= 4


def test_ply_cannot_reach_infinity(tmp_path):
    t = BezierTriangles([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 0]])
    with pytest.raises(FileFormatError, match=r"do not reach infinity.*patch 0"):
        io.save(t, tmp_path / "a.ply")
    for bad in (0, -1, np.nan, np.inf):
        with pytest.raises(FileFormatError, match="chord_error: expected a positive length"):
            io.save(octant_pair(), tmp_path / "a.ply", chord_error=bad)
    with pytest.raises(FileFormatError, match="chord_error"):
        io.save(octant_pair(), tmp_path / "a.ply", chord_error=1e-12)


def test_no_warnings_for_whole_files(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        io.load(put(tmp_path, TORUS, "a.bez"))


def test_triangle_order_is_a_permutation():
    for n in range(1, 8):
        assert sorted(bezierview.triangle_order(n)) == list(range(bernstein.size(n)))


def test_polygons_of_enormous_size(tmp_path):
    """Coordinates near the end of float64 overflow nowhere."""
    path = tmp_path / "a.off"
    path.write_text("OFF\n4 1 4\n0 0 0\n1e308 0 0\n1e308 1e308 0\n0 1e308 0\n4 0 1 2 3\n")
    assert len(io.load(path)) == 2
    path.write_text("OFF\n4 1 4\n1 1e308 0\n1 0 0\n1 1e308 0\n0 1 0\n4 0 1 2 3\n")
    with pytest.raises(FileFormatError, match="without area"):
        io.load(path)
