"""Quadratic triangles on quadrics: the point S, stereographic projection, the patchwork theorem."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import GeometryError
from ...geometry.camera import Camera, look_at
from ...geometry.conics import circle
from ...geometry.covers import quadric_cover, sphere
from ...geometry.curves import BezierCurve
from ...geometry.four_sided import boundary_curve, four_sided_net
from ...geometry.isoparametric import isoparametric
from ...geometry.projective import affine, ideal, is_ideal, point
from ...geometry.quadric_types import classify_quadric
from ...geometry.quadrics import quadric_patch
from ...geometry.stereographic import StereographicProjection
from ...geometry.tensor import tensor_to_triangles
from ...geometry.triangles import BezierTriangles

if TYPE_CHECKING:
    from .. import Drawing

__all__ = ["FIGURES"]

SPHERE = np.diag([1.0, 1, 1, -1])
ONE_SHEET = np.diag([1.0, 1, -1, -1])
BOWL = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]])


def _camera(eye: Any, at: Any = (0, 0, 0), fov: float = 30) -> Camera:
    return Camera(look_at(eye, at, [0, 0, 1]), fov, "x", (1600, 900))


def _whole(arc: BezierCurve) -> tuple[BezierCurve, BezierCurve]:
    """Return an arc of a conic and the rest of the conic."""
    net = arc.control_points
    return arc, BezierCurve(net * [[1], [-1], [1]])


def _characterised(
    d: Drawing, A: np.ndarray, S: np.ndarray, corners: np.ndarray, oval: bool, extended: bool = True
) -> None:
    """Draw a patch, its extended boundary conics, S, and the tangents there in one plane."""
    net = quadric_patch(A, S, corners)
    patch = BezierTriangles(net)
    on = A if oval else None
    d.surface(patch, 32, grey=(0.45, 0.8), on=on)
    for edge in range(3):
        arc, rest = _whole(boundary_curve(net, edge))
        if extended:
            d._on_quadric(rest, on, "construction")
        d._on_quadric(arc, on, "curve")
    d.points(corners, kind="second point")
    if is_ideal(S):
        return
    s, normal = affine(S), (A @ S)[:3]
    normal = normal / np.linalg.norm(normal)
    ends = []
    for edge in range(3):
        b = boundary_curve(net, edge).control_points
        plane = np.linalg.svd(b)[2][3]
        way = np.cross(plane[:3], normal)
        way /= np.linalg.norm(way)
        ends += [(s - 0.55 * way, s + 0.55 * way)]
        d.segment(*ends[-1], "tangent", linewidth=1.9)
    u = ends[0][1] - s
    v = np.cross(normal, u)
    size = 0.75
    d.plane([s + size / 0.55 * (i * u + j * v) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))],
            grey=0.8, opacity=0.4)  # fmt: skip
    d.point(S, "$S$", (8, 9), markersize=9.0)


def sphere_point(style: str = "screen", height: float = 0.5) -> Drawing:
    """On the sphere: boundary circles meet in S, with tangents in one plane."""
    from .. import space

    d = space(_camera((2.2, -5.6, 2.0), (0.0, 0, 0.16), 38), style)
    d.surface(sphere(), 24, grey=(0.86, 0.99))
    d.quadric_outline(SPHERE, "line")
    if not height**2 <= 1 - 0.7**2:
        raise GeometryError.expected("height", "a point of the sphere above x = -0.7", height)
    s = np.array([-0.7, -np.sqrt(1 - 0.7**2 - height**2), height])
    x = np.array([[0.1, -0.95, -0.3], [0.95, -0.2, -0.1], [0.3, -0.35, 0.89]])
    x /= np.linalg.norm(x, axis=1)[:, None]
    _characterised(d, SPHERE, point(s), point(x), True)
    d.title(
        "A quadratic triangle on the sphere: its three boundary circles, extended, meet in $S$;\n"
        "their tangents there lie in one plane."
    )
    return d


def hyperboloid_point(style: str = "screen", turn: float = -38.0) -> Drawing:
    """On a hyperboloid of one sheet: the same point S decides."""
    from .. import space

    d = space(_camera((4.4, -5.4, 2.5), (0, 0, 0.3), 42), style)
    a = np.radians(turn)
    for k in range(24):
        t = 2 * np.pi * k / 24
        for way in (-1, 1):
            p = np.array([np.cos(t), np.sin(t), 0])
            q = np.array([-way * np.sin(t), way * np.cos(t), 1.0])
            d.segment(p - 1.3 * q, p + 1.3 * q, "thin", linewidth=0.45)

    def on(t: float, z: float) -> np.ndarray:
        return np.array([np.sqrt(1 + z * z) * np.cos(t + a), np.sqrt(1 + z * z) * np.sin(t + a), z])

    s = point(on(0.77, 0.87))
    corners = point([on(-1.47, 0.74), on(-1.26, -0.85), on(-0.08, 0.79)])
    _characterised(d, ONE_SHEET, s, corners, False)
    d.title(
        "On a hyperboloid of one sheet: extended boundary conics (dashed) meet in $S$,\n"
        "their tangents there lie in one plane."
    )
    return d


def ellipsoid_point(style: str = "screen") -> Drawing:
    """On an ellipsoid: an affine image of the sphere, S goes with it."""
    from .. import space

    d = space(_camera((2.6, -5.6, 2.2), (0.05, 0, 0.2), 36), style)
    m = np.array([[1.5, 0.25, 0, 0], [0, 0.85, 0.1, 0], [0, 0, 0.8, 0], [0, 0, 0, 1]])
    back = np.linalg.inv(m)
    A = back.T @ SPHERE @ back
    d.surface(quadric_cover(A), 28, grey=(0.86, 0.99))
    d.quadric_outline(A, "line")
    s = np.array([-0.6, -0.65, 0.5])
    s /= np.linalg.norm(s)
    x = np.array([[0.1, -0.95, -0.3], [0.95, -0.2, -0.1], [0.3, -0.35, 0.89]])
    x /= np.linalg.norm(x, axis=1)[:, None]
    _characterised(d, A, m @ point(s), point(x) @ m.T, True)
    d.title(
        "On an ellipsoid: $S$, the three conics, and their tangents in one plane\n"
        "are images of those on the sphere."
    )
    return d


def paraboloid(style: str = "screen", x: float = 0.75) -> Drawing:
    """A polynomial quadratic triangle on a paraboloid: S is the ideal point of the axis."""
    from .. import space

    d = space(_camera((2.9, -4.6, 2.4), (0, 0.0, 0.62), 42), style)
    angle = np.linspace(0, 2 * np.pi, 120)
    for r in (0.4, 0.8, 1.15):
        d._stroke(
            [d.place(np.stack([r * np.cos(angle), r * np.sin(angle), 0 * angle + r * r], axis=1))],
            "thin",
        )
    t = np.linspace(-1.15, 1.15, 60)
    for a in np.linspace(0, np.pi, 8, endpoint=False):
        d._stroke([d.place(np.stack([t * np.cos(a), t * np.sin(a), t * t], axis=1))], "thin")
    plan = np.array([[x, -0.35, 0], [-0.45, -0.65, 0], [-0.1, 0.75, 0]])
    lifted = plan.copy()
    lifted[:, 2] = (plan[:, :2] ** 2).sum(axis=1)
    net = quadric_patch(BOWL, ideal([0, 0, 1]), point(lifted))
    patch = BezierTriangles(net)
    low = plan - [0, 0, 0.35]
    d.plane(low, grey=0.85)
    for p, q in zip(low, lifted):
        d.segment(p, q, "construction")
    d.surface(patch, 32, grey=(0.45, 0.8))
    d.boundary(patch)
    d.points(point(lifted), kind="second point")
    d.title(
        "Equal weights and a quadric: a paraboloid. The projection is parallel to the axis,\n"
        "$S$ is its ideal point; parabolas bound the patch."
    )
    return d


def stereographic(style: str = "screen", lift: float = -1.0) -> Drawing:
    """Stereographic projection: a plane triangle becomes a quadratic triangle on the sphere."""
    from .. import space

    d = space(_camera((4.4, -7.2, 3.4), (0.2, -0.3, -0.12), 45), style)
    s = StereographicProjection(plane=[0, 0, 1, -lift])
    corners = np.array([[2.1, -1.2, lift], [-0.4, -1.9, lift], [0.9, 0.9, lift]])
    edge = np.array([[-2.6, -2.6, lift], [2.6, -2.6, lift], [2.6, 2.2, lift], [-2.6, 2.2, lift]])
    d.plane(edge, grey=0.93)
    d.fill(corners, 0.7)
    d.polyline(corners, "second", closed=True)
    d.surface(sphere(), 24, grey=(0.86, 0.99))
    d.quadric_outline(SPHERE, "line")
    patch = s.triangle(point(corners))
    d.surface(patch, 32, grey=(0.45, 0.8), on=SPHERE)
    d.isolines(patch, 3, on=SPHERE)
    d.boundary(patch, on=SPHERE)
    for x in corners:
        d.segment(s.center, x, "construction")
        d.point(s.inverse(point(x)), kind="second point")
        d.point(x, kind="second point")
    d.point(s.center, "$S$", (8, 8), markersize=9.0)
    d.title(
        "From $S$, lines of the plane become circles through $S$:\n"
        "a plane triangle is a quadratic Bézier triangle on the sphere."
    )
    return d


def _faces(spread: float) -> tuple[np.ndarray, list[Any], np.ndarray]:
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    faces = [(1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2)]
    nets = np.array(
        [
            quadric_patch(SPHERE, point(corners[k]), point(corners[list(f)]))
            for k, f in enumerate(faces)
        ]
    )
    edges: dict[frozenset[int], list[tuple[int, int]]] = {}
    for p, f in enumerate(faces):
        for e in range(3):
            edges.setdefault(frozenset((f[e], f[(e + 1) % 3])), []).append((p, e))
    return nets, [tuple(pair) for pair in edges.values()], corners * spread


def patchwork(style: str = "screen") -> Drawing:
    """The patchwork theorem: a four-sided patch, two sides of which are points, fills the gap."""
    from .. import space

    d = space(_camera((1.7, -5.4, 1.7), (0, 0, 0.1), 40), style)
    d.quadric_outline(SPHERE, "line")
    nets, edges, _ = _faces(1.0)
    d.surface(sphere(), 24, grey=(0.9, 0.99))
    seen = np.array([1.7, -5.4, 1.7])
    for net in nets:
        patch = BezierTriangles(net)
        d.surface(patch, 32, grey=(0.66, 0.88), on=SPHERE)
        d.isolines(patch, 3, on=SPHERE)
        d.boundary(patch, on=SPHERE)
    for (p, e), (q, f) in edges:
        one, two = boundary_curve(nets[p], e), boundary_curve(nets[q], f).reverse()
        net = four_sided_net(SPHERE, one, two)
        patch = tensor_to_triangles(net)
        if patch.points(0, [[0.5, 0.5]])[0] @ seen < 4.0:
            continue
        d.surface(patch, 24, grey=(0.38, 0.6), on=SPHERE)
        for s in (0.0, 0.25, 0.5, 0.75, 1.0):
            weights = np.array([(1 - s) ** 2, 2 * s * (1 - s), s * s])
            arc = BezierCurve(np.einsum("j,ijc->ic", weights, net))
            d._on_quadric(arc, SPHERE, "curve" if s in (0, 1) else "thin")
        ends = one.evaluate([0.0, 1.0])
        for x, name, way in zip(ends, ("$A$", "$B$"), ((0, 11), (0, -11))):
            d.point(x, name, way, kind="second point")
    d.title(
        "Between two triangles (light), the conics through $A$ and $B$ make\n"
        "a four-sided patch (dark): two of its sides have shrunk to $A$ and $B$."
    )
    return d


def figure2(style: str = "screen", apart: float = 0.55) -> Drawing:
    """Figure 2: four triangles and six lunes tile the sphere, moved apart."""
    from .. import space

    d = space(_camera((4.4, -6.6, 3.0), (0, 0, 0.1), 42), style)
    nets, edges, _ = _faces(1.0)
    parts: list[tuple[float, BezierTriangles, tuple[float, float], np.ndarray]] = []
    seen = np.array([4.4, -6.6, 3.0])
    for net in nets:
        patch = BezierTriangles(net)
        parts.append(_moved(patch, patch.points(0, [[1 / 3, 1 / 3]])[0], apart, (0.66, 0.95), seen))
    for (p, e), (q, f) in edges:
        one, two = boundary_curve(nets[p], e), boundary_curve(nets[q], f).reverse()
        patch = tensor_to_triangles(four_sided_net(SPHERE, one, two))
        middle = patch.points(0, [[0.5, 0.5]])[0]
        parts.append(_moved(patch, middle, apart, (0.4, 0.66), seen))
    for order, (_depth, patch, grey, _way) in enumerate(sorted(parts, key=lambda part: part[0])):
        d.surface(patch, 28, grey=grey, zorder=1.5 + order)
        for k in range(len(patch)):
            for edge in range(3):
                _outline(d, patch, k, edge, 1.6 + order)
    d.title(
        "Four triangles (light), each projected from the opposite corner, and six lunes (dark)."
    )
    return d


def _moved(
    patch: BezierTriangles,
    middle: np.ndarray,
    apart: float,
    grey: tuple[float, float],
    eye: np.ndarray,
) -> tuple[float, BezierTriangles, tuple[float, float], np.ndarray]:
    way = middle / np.linalg.norm(middle)
    m = np.eye(4)
    m[:3, 3] = apart * way
    place = middle + apart * way
    return -float(np.linalg.norm(eye - place)), patch.transform(m), grey, way


def _outline(d: Drawing, patch: BezierTriangles, k: int, edge: int, zorder: float) -> None:
    corners = np.eye(3)
    if len(patch) == 2 and edge == 0:
        return  # the diagonal along which the four-sided patch is cut
    curve = isoparametric(patch, k, corners[edge], corners[(edge + 1) % 3])
    if curve is not None:
        d.curve(curve, "line", zorder=zorder, linewidth=1.3)


def quadric_family(style: str = "screen", turn: float = 25.0) -> Drawing:
    """One collineation takes a paraboloid through all oval quadrics."""
    from .. import space

    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    # the poles of the surface are -s/c and c/s: it moves down as it is turned, and comes back
    middle = 0.95 * (c * c - s * s)
    d = space(_camera((3.4, -6.4, 1.85 + middle), (0, 0, middle), 54), style)
    # z and w are turned into each other, x^2 + y^2 = z w with them
    m = np.eye(4)
    m[2:, 2:] = [[c, -s], [s, c]]
    back = np.linalg.inv(m)
    A = back.T @ BOWL @ back
    for h in (0.02, 0.08, 0.2, 0.45, 0.9, 1.6, 3.0, 6.0, 14.0, 50.0):
        for arc in circle((0, 0), float(np.sqrt(h)), 4):  # circles of the bowl, at the height h
            net = np.insert(arc.control_points, 2, h * arc.weights, axis=1)
            d.curve(BezierCurve(net @ m.T), "line", linewidth=1.2)
    for a in np.linspace(0, np.pi, 9)[:-1]:  # its meridians, both halves, to the ideal point
        for sign in (1.0, -1.0):
            way = sign * np.array([np.cos(a), np.sin(a), 0, 0])
            net = np.array([[0, 0, 0, 1.0], 0.5 * way, [0, 0, 1.0, 0]])
            d.curve(BezierCurve(net @ m.T), "thin", linewidth=1.0)
    name = classify_quadric(A)
    d.title(f"$x^2 + y^2 = z w$, with $z$ and $w$ turned into each other by {turn:.0f}°: {name}.")
    return d


FIGURES = {
    "quadric_family": quadric_family,
    "paraboloid": paraboloid,
    "sphere_point": sphere_point,
    "hyperboloid_point": hyperboloid_point,
    "ellipsoid_point": ellipsoid_point,
    "stereographic": stereographic,
    "patchwork": patchwork,
    "figure2": figure2,
}
