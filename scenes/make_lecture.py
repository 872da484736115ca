"""Write the models of the lecture's scenes: ``python scenes/make_lecture.py``.

Surfaces are written as exact patches, in world coordinates. Thin curves (boundary conics,
threads, drawn lines) are written as control points of Mitsuba's ``bsplinecurve``.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import duerer_machine
import lecture_drawings
import numpy as np
from lecture_tools import TRACK, boxes, prism, segment, tube

import mitsuba_bezier as mb
from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry import plane_shapes, shapes
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.developable import DevelopableSurface
from mitsuba_bezier.geometry.duality import dual_form
from mitsuba_bezier.geometry.quadric_types import collineation_to_paraboloid
from mitsuba_bezier.geometry.triangles import BezierTriangles

__all__ = [
    "FOLDER",
    "REGRESSION",
    "RIBBON_PLANES",
    "TRACK",
    "WEIGHTS",
    "figure2",
    "figure2_arcs",
    "main",
    "models",
    "paraboloids",
    "railroad",
    "ribbon",
    "ribbon_rulings",
    "shown",
    "weighted_net",
    "weights",
    "weights_tubes",
]

FOLDER = Path(__file__).resolve().parent / "models"

#: Distance of the inner edges of the rails, and the section of a rail, in metres.
GAUGE, RAIL_WIDTH, RAIL_HEIGHT = 1.435, 0.1, 0.17
#: Height of the ballast above the ground and of the sleepers above the ballast.
BALLAST, SLEEPER = 0.3, 0.08


# ---------------------------------------------------------------------- railroad


def railroad() -> dict[str, BezierTriangles]:
    """Return the parts of the railroad along +y: everything long ends at the horizon."""
    y = 0.65 * np.arange(-12, 1600)
    top = BALLAST + SLEEPER
    lower = np.column_stack([np.full(len(y), -1.25), y, np.full(len(y), BALLAST - 0.05)])
    upper = np.column_stack([np.full(len(y), 1.25), y + 0.26, np.full(len(y), top)])
    near = 100  # beyond, only the tops and the fronts of the sleepers are seen
    sleepers = [
        boxes(lower[:near], upper[:near], ("+z", "-y", "-x", "+x")),
        boxes(lower[near:], upper[near:], ("+z", "-y")),
        # beyond a kilometre fronts and tops hide what lies between: a strip to the horizon
        prism([(-1.25, top), (1.25, top)], y[-1] + 0.65),
    ]
    behind = -20.0
    ballast = prism([(-2.6, 0), (-1.7, BALLAST), (1.7, BALLAST), (2.6, 0)], behind)
    # wires pass over the arms of the posts
    posts_y = 14.0 * np.arange(1, 401) - 6  # the last one is as high as a pixel
    x = -6.0
    size = np.array([0.11, 0.11, 0])
    feet = np.column_stack([np.full(len(posts_y), x), posts_y, np.zeros(len(posts_y))])
    heads = feet + size + (0, 0, 6.3)
    low, high = feet - (0.9, 0.08, -5.6), feet - (-0.9, -0.08, -5.8)
    whole, seen = slice(None, 45), slice(45, None)
    posts = BezierTriangles.join(
        [
            boxes((feet - size)[whole], heads[whole], ("+z", "-y", "-x", "+x")),
            boxes((feet - size)[seen], heads[seen], ("-y", "+x")),
            boxes(low[seen], high[seen], ("-z", "-y")),
        ]
    )
    arms = boxes(low[whole], high[whole], ("+z", "-z", "-y", "-x", "+x"))
    wires = [
        prism([(x + a, 5.83), (x + a - 0.015, 5.845), (x + a, 5.86), (x + a + 0.015, 5.845),
               (x + a, 5.83)], behind)
        for a in (-0.8, 0.8)
    ]  # fmt: skip
    return {
        # four wedges around a point under the camera: a whole plane, normal upwards
        "ground": plane_shapes.plane((0, 0, 0), (10, 0, 0), (0, 10, 0)),
        "ballast": ballast,
        "sleepers": BezierTriangles.join(sleepers),
        "rail_left": rail(-1, behind),
        "rail_right": rail(1, behind),
        "posts": BezierTriangles.join([posts, arms]),
        "wires": BezierTriangles.join(wires),
    }


def rail(side: int, start: float) -> BezierTriangles:
    """Return a rail, the left (-1) or the right one (+1): two sides and the head."""
    inner = side * GAUGE / 2
    a, b = sorted((inner, inner + side * RAIL_WIDTH))
    low = BALLAST + SLEEPER
    return prism([(a, low), (a, low + RAIL_HEIGHT), (b, low + RAIL_HEIGHT), (b, low)], start)


# ---------------------------------------------------------------------- figure 2


def figure2() -> dict[str, BezierTriangles]:
    """Return the ten patches of the tetrahedral cover of the unit sphere, one by one."""
    cover = mb.sphere(cover="tetrahedral")
    names = [f"face_{k}" for k in range(4)] + [f"lune_{k}" for k in range(6)]
    return {name: cover[k] for k, name in enumerate(names)}


def figure2_arcs() -> list[BezierCurve]:
    """Return the twelve boundary conics: the edges of the four faces."""
    nets = mb.sphere(cover="tetrahedral").control_points[:4]
    return [BezierCurve(net[list(e)]) for net in nets for e in ((0, 1, 3), (3, 4, 5), (5, 2, 0))]


# ---------------------------------------------------------------------- one paraboloid


class Member(NamedTuple):
    """A quadric of the picture: its type, the patches before, and the collineation."""

    name: str
    base: BezierTriangles
    matrix: np.ndarray


def perspective(*plane: float) -> np.ndarray:
    """Return the collineation that keeps x, y, z and takes ``w`` to ``plane . (x, y, z, w)``.

    The given plane goes to infinity.
    """
    matrix = np.eye(4)
    matrix[3] = plane
    return matrix


def over_rectangle(A: Any, a: float, b: float) -> BezierTriangles:
    """Return the part with ``|x| <= a``, ``|y| <= b`` of a paraboloid along z, two patches."""
    corners = [[-a, -b, 0, 1], [a, -b, 0, 1], [a, b, 0, 1], [-a, b, 0, 1]]
    triples = ((0, 1, 2), (0, 2, 3))
    return BezierTriangles(
        [mb.quadric_patch(A, [0, 0, 1, 0], [corners[k] for k in t]) for t in triples]
    )


def paraboloids() -> list[Member]:
    """Return the quadrics of the picture, made from three surfaces.

    The ovals come from the cap ``z = x^2 + y^2``, the cones and cylinders from the parabolic
    cylinder ``z = x^2``. The ruled ones are seen the other way round: from the collineation
    that takes the hyperboloid to ``z = x^2 - y^2``.
    """
    cap = shapes.elliptic_paraboloid((0, 0, 0), (2, 2), 4)
    # what the plane at infinity was becomes the plane 1 + s z = 0: it misses, touches or cuts
    ovals = [
        Member(name, cap, perspective(0, 0, s, 1))
        for name, s in (
            ("hyperboloid of two sheets", -0.16),
            ("elliptic paraboloid", 0.0),
            ("ellipsoid", 1.1),
        )
    ]
    to_saddle = collineation_to_paraboloid(np.diag([1.0, 1.0, -1.0, -1.0]))
    saddle = over_rectangle(to_saddle.paraboloid, 1.3, 0.62)
    ruled = [
        Member("hyperbolic paraboloid", saddle, np.eye(4)),
        Member("hyperboloid of one sheet", saddle, to_saddle.inverse),
    ]
    bowl = np.diag([1.0, 0, 0, 0])
    bowl[2, 3] = bowl[3, 2] = -0.5
    gutter = over_rectangle(bowl, 1.4, 1.0)
    cones = [
        Member(name, gutter, perspective(*plane))
        for name, plane in (
            ("hyperbolic cylinder", (0, 0, -0.32, 1)),
            ("parabolic cylinder", (0, 0, 0, 1)),
            ("elliptic cylinder", (0, 0, 1.3, 1)),
            ("cone", (0, 0.55, 0, 1)),
        )
    ]
    return ovals + ruled + cones


def shown(member: Member) -> tuple[BezierTriangles, np.ndarray]:
    """Return the patches as they stand in the picture, and the whole map from their base.

    After the collineation a member is turned, scaled to its place, and set on the plane z = 0.
    """
    turn = np.eye(4)
    if "cylinder" in member.name or member.name == "cone":
        turn[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # upright, open to the front
    elif member.name == "hyperboloid of one sheet":
        turn[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # the waist to the front
    matrix = turn @ member.matrix
    box = member.base.transform(matrix).split().split().hulls()
    lo, hi = box[:, 0].min(axis=0), box[:, 1].max(axis=0)
    scale = min(1.4 / (hi[2] - lo[2]), 1.6 / (hi[0] - lo[0]))
    place = np.diag([scale, scale, scale, 1.0])
    place[:3, 3] = -scale * np.array([(lo[0] + hi[0]) / 2, (lo[1] + hi[1]) / 2, lo[2]])
    return member.base.transform(place @ matrix), place @ matrix


# ---------------------------------------------------------------------- weights and infinity

#: The weight of the control point in the middle of the front edge, row by row.
WEIGHTS = (6.0, 1.0, 0.25, 0.0, -0.25, -0.45)
#: Distance of the copies in the picture, to the right and downwards: two rows of three.
WEIGHTS_STEP = (2.9, 2.75)
_WEIGHT_POINTS = np.array(
    [[-1, 0, 0], [0, 0, 1.5], [-0.5, 0.6, 0.9], [1, 0, 0], [0.5, 0.6, 0.9], [0, 1.2, 0.1]]
)


def weighted_net(weight: float) -> np.ndarray:
    """Return the net ``(6, 4)`` whose control point b_110 has this weight; the others have 1."""
    w = np.array([1.0, weight, 1, 1, 1, 1])
    return np.column_stack([w[:, None] * _WEIGHT_POINTS, w])


def weights() -> dict[str, BezierTriangles]:
    """Return one patch for each weight, side by side."""
    out = {}
    for k, weight in enumerate(WEIGHTS):
        move = np.eye(4)
        move[0, 3] = (k % 3 - 1) * WEIGHTS_STEP[0]
        move[2, 3] = -(k // 3) * WEIGHTS_STEP[1]
        out[f"{k}"] = BezierTriangles(weighted_net(weight)).transform(move)
    return out


def weights_tubes() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the legs of the control nets, and the edges u + v = 1 where they are finite."""
    legs, edges = [], []
    # rows of the control points at the ends of the legs
    pairs = ((0, 1), (0, 2), (1, 2), (1, 3), (1, 4), (3, 4), (2, 4), (2, 5), (4, 5))
    for patch in weights().values():
        x = _WEIGHT_POINTS + patch.control_points[0, 0, :3] - _WEIGHT_POINTS[0]
        legs += [segment(x[a], x[b], 0.012) for a, b in pairs]
        arc = BezierCurve(patch.control_points[0, [0, 1, 3]])
        edges.append(tube(arc.points, 32, 0.025))
    return legs, edges


# ---------------------------------------------------------------------- developable

#: The curve of regression, a cubic that climbs as it turns.
REGRESSION = BezierCurve.from_points(
    [[0.35, 0, 0], [0.45, 0.6, 0.35], [-0.45, 0.6, 0.7], [-0.35, 0, 1.05]]
)
#: The planes between which the ribbon is cut.
RIBBON_PLANES = ((0.0, 0.2, 1, -1.17), (0.0, 0.2, 1, -1.75))


def ribbon() -> DevelopableSurface:
    """Return the developable of the planes that osculate the curve of regression."""
    return DevelopableSurface(dual_form(REGRESSION).control_elements)


def ribbon_rulings(count: int = 13) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return pairs: a point of the curve of regression, and where its tangent leaves the ribbon."""
    t = np.linspace(0, 1, count)
    upper = ribbon().trace(RIBBON_PLANES[1])
    return list(zip(REGRESSION.points(t), upper.points(t)))


# ---------------------------------------------------------------------- Dürer's machine


def frame() -> BezierTriangles:
    """Return the frame around the opening |y| < 0.72, 0.06 < z < 1.16 of the plane x = 0."""
    lower = [(-0.03, -0.8, 0.0), (-0.03, -0.8, 1.16), (-0.03, -0.8, 0.06), (-0.03, 0.72, 0.06)]
    upper = [(0.03, 0.8, 0.06), (0.03, 0.8, 1.24), (0.03, -0.72, 1.16), (0.03, 0.8, 1.16)]
    return boxes(lower, upper)


def table() -> BezierTriangles:
    """Return the table, its top in z = 0, and its legs."""
    legs = np.array([(x, y, -0.9) for x in (-1.75, 0.35) for y in (-0.9, 0.78)])
    lower = np.concatenate([[(-1.9, -1.0, -0.08)], legs])
    upper = np.concatenate([[(0.6, 1.0, 0.0)], legs - (-0.12, -0.12, -0.82)])
    return boxes(lower, upper)


# ---------------------------------------------------------------------- files


def write_tubes(name: str, tubes: Iterable[np.ndarray]) -> None:
    """Write tubes as a file of Mitsuba's ``bsplinecurve``."""
    lines = ["\n".join(" ".join(f"{x:.7g}" for x in row) for row in t) for t in tubes]
    write_file(FOLDER / f"{name}.txt", ("\n\n".join(lines) + "\n").encode())


def models() -> dict[str, dict[str, BezierTriangles]]:
    """Return the patches of all scenes: ``models()[scene][part]``."""
    return {
        "railroad": railroad(),
        "figure2": figure2(),
        "paraboloids": {m.name.replace(" ", "_"): shown(m)[0] for m in paraboloids()},
        "weights": weights(),
        "duerer": duerer_machine.lute() | {"frame": frame(), "table": table()},
        "relief": lecture_drawings.relief(),
        "developable": {"ribbon": ribbon().patch(*RIBBON_PLANES)},
    }


def main() -> None:
    """Write all files."""
    FOLDER.mkdir(exist_ok=True)
    for scene, parts in models().items():
        for name, patches in parts.items():
            mb.save(patches, FOLDER / f"{scene}_{name}.vtu")
    legs, edges = weights_tubes()
    write_tubes("weights_net", legs)
    write_tubes("weights_edges", edges)
    write_tubes("developable_regression", [tube(REGRESSION.points, 48, 0.022)])
    write_tubes("developable_rulings", (segment(p, q, 0.007) for p, q in ribbon_rulings()))
    write_tubes("duerer_threads", (segment(a, b, 0.004) for a, b in duerer_machine.threads()))
    write_tubes("duerer_strings", (segment(a, b, 0.0025) for a, b in duerer_machine.strings()))
    drawing = duerer_machine.drawn_curves().values()
    write_tubes("duerer_drawing", (tube(c.points, 24, 0.005) for c in drawing))
    for name, curve, t in lecture_drawings.DRAWINGS:
        levels = lecture_drawings.scheme(curve, t)
        shape = tube(lambda x, c=curve: lecture_drawings.standing(c.evaluate(x)), 64, 0.03)
        write_tubes(f"{name}_curve", [shape])
        for k, (x, _farin) in enumerate(levels[:-1]):
            write_tubes(f"{name}_level{k}", (segment(a, b, 0.014) for a, b in pairwise(x)))
        a, b = levels[-2][0]
        write_tubes(f"{name}_tangent", [segment(1.9 * a - 0.9 * b, 1.9 * b - 0.9 * a, 0.014)])
    write_tubes("figure2_conics", (tube(c.points, 24, 0.016) for c in figure2_arcs()))


if __name__ == "__main__":
    main()
