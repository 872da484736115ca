"""The sets of patches of `same_hits`, which have all kinds of leaves, and its scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.geometry.tensor import revolved, tensor_to_triangles
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map

__all__ = ["IMAGES", "SETS", "Case", "Image"]

MODELS = Path(__file__).resolve().parents[1] / "scenes" / "models"
H = np.sqrt(0.5)
#: Takes the plane z = -3 to infinity, and circles to other conics.
IMAGE = np.array([[1.0, 0.2, 0, 0.1], [0, 1.3, 0.3, 0], [0.1, 0, 0.8, 0.2], [0, 0.1, 0.3, 0.9]])
STRETCH = np.diag([1.0, 2.0, 0.7, 1.0])
STRETCH[:3, 3] = 0.3, -0.5, 0.8


@dataclass
class Case:
    """A scene of some shapes: each of patches, with trims or maps of instances perhaps."""

    parts: list[Callable[[], Any]]
    trimmed: bool = False
    instances: dict[int, np.ndarray] = field(default_factory=dict)  #: by the part's number
    many: bool = False  #: whether to trace enough rays for the wavefront
    double: bool = False
    rounded: bool = False  #: whether nets come as float32 tensors, not by a file

    def load(self, folder: Path) -> tuple[Any, mb.BezierTriangles]:
        """Return the scene, and what rays should be aimed at."""
        import mitsuba as mi

        scene: dict[str, Any] = {"type": "scene"}
        seen = []
        for number, part in enumerate(self.parts):
            patches = part()
            shape: dict[str, Any] = {"type": "beziertriangle"}
            if self.rounded:
                net = patches.control_points.astype(np.float32)
                shape["control_points"] = mi.TensorXf(net.ravel(), shape=net.shape)
            else:
                path = folder / f"{number}.vtu"
                io.save(patches, path, trims=windows(patches) if self.trimmed else None)
                shape["filename"] = str(path)
            maps = self.instances.get(number)
            if maps is not None:
                shape[instances_name()] = mi.TensorXf(maps.astype(np.float32).ravel(), maps.shape)
                seen += [patches.transform(m) for m in maps]
            else:
                seen.append(patches)
            scene[f"shape{number}"] = shape
        degree = max(p.degree for p in seen)
        aims = mb.BezierTriangles.join([p.elevate(degree - p.degree) for p in seen])
        return mi.load_dict(scene), aims


def instances_name() -> str:
    """Return the name of the shape's parameter for instances, which was `copies` once."""
    folder = Path(mb.__file__).parent / "plugins"
    return "copies" if (folder / "copies.py").exists() else "instances"


def windows(patches: mb.BezierTriangles) -> Trims:
    """Return a round window in each patch but every third, which is its pane, or whole."""

    def circle(x: float, y: float, radius: float) -> list[np.ndarray]:
        out = []
        for a in np.pi / 2 * np.arange(4):
            points = np.array([(np.cos(a + b), np.sin(a + b)) for b in (0, np.pi / 4, np.pi / 2)])
            w = np.array([1, H, 1])
            points[1] /= H
            out.append(np.column_stack([(points * radius + (x, y)) * w[:, None], w]))
        return closed_region(out, 1e-9)

    corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    square = [np.array([[*a, 1], [*b, 1]], float) for a, b in pairwise(corners)]
    regions = [square + circle(0.3, 0.35, 0.22), circle(0.4, 0.3, 0.27)]
    count = len(patches)
    region = np.array([0, 1, -1])[np.arange(count) % 3]
    return Trims(regions, region, [square_map()] * count, [[[0, 0], [1, 1]]] * count)


def revolution(segments: int = 4, *, height: float = 1.0) -> mb.BezierTriangles:
    """Return a sphere of tensor-product patches, whose diagonals are no plane sections."""
    profiles = (
        [(0, -1, 1), (H, -H, H), (1, 0, 1)],
        [(1, 0, 1), (H, H, H), (0, 1, 1)],
    )
    parts = [tensor_to_triangles(revolved(p, segments)) for p in profiles]
    return mb.BezierTriangles.join(parts).transform(np.diag([1, 1, height, 1.0]))


def cad_cone(segments: int = 4) -> mb.BezierTriangles:
    """Return a cone as CAD systems write it, with its apex."""
    return tensor_to_triangles(revolved([(1.0, 0.0, 1.0), (0.0, 1.5, 1.0)], segments))


def wild(degree: int, count: int, spread: float, seed: int = 3) -> mb.BezierTriangles:
    """Return random patches; weights from 1 - spread to 1 + spread, of both signs beyond one."""
    rng = np.random.default_rng(seed)
    k = (degree + 1) * (degree + 2) // 2
    points = rng.normal(size=(count, k, 3)) + 2 * rng.normal(size=(count, 1, 3))
    w = 1 + spread * rng.uniform(-1, 1, (count, k, 1))
    return mb.BezierTriangles(np.concatenate([points * w, w], axis=2))


def height_field(degree: int, side: int, seed: int = 5) -> mb.BezierTriangles:
    """Return a rough surface over a square, polynomial."""
    rng = np.random.default_rng(seed)
    from mitsuba_bezier.geometry import bernstein

    ijk = bernstein.multi_indices(degree) / degree
    nets = []
    for x in range(side):
        for y in range(side):
            for turn in (1, -1):
                xy = ijk[:, :2] if turn == 1 else 1 - ijk[:, :2]
                z = 0.3 * rng.normal(size=len(ijk))
                nets.append(np.column_stack([xy + np.array([x, y]), z, np.ones(len(ijk))]))
    return mb.BezierTriangles(np.array(nets))


def scattered(make: Callable[[], mb.BezierTriangles], count: int, seed: int) -> mb.BezierTriangles:
    """Return many affine images of a body."""
    body = make()
    return mb.BezierTriangles.join([body.transform(m) for m in maps(count, seed)])


def maps(count: int, seed: int = 1) -> np.ndarray:
    """Return affine maps: turned, sheared, some mirrored, spread over a cube; exact in float32."""
    rng = np.random.default_rng(seed)
    out = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    out[:, :3, :3] = np.round(64 * rng.normal(size=(count, 3, 3))) / 64 + 2 * np.eye(3)
    out[:, :3, 3] = np.round(64 * rng.uniform(-12, 12, size=(count, 3))) / 64
    return out


def along(*scale: float) -> Callable[[mb.BezierTriangles], mb.BezierTriangles]:
    """Return what stretches patches."""
    return lambda patches: patches.transform(np.diag([*scale, 1.0]))


def at(x: float, patches: mb.BezierTriangles) -> mb.BezierTriangles:
    """Return patches moved along the first axis."""
    move = np.eye(4)
    move[0, 3] = x
    return patches.transform(move)


def teapot() -> mb.BezierTriangles:
    """Return the teapot."""
    return mb.load(MODELS / "teapot.vtu")


def points_and_curves() -> mb.BezierTriangles:
    """Return a surface among nets that are none."""
    nets = wild(2, 4, 0.2).control_points.copy()
    nets[0] = nets[0, :1]
    nets[1] = np.linspace(0, 1, 6)[:, None] * (nets[1, 1] - nets[1, 0]) + nets[1, 0]
    return mb.BezierTriangles(nets)


SETS: dict[str, Case] = {
    "linear, one quadric": Case([lambda: mb.sphere(cover="tetrahedral")]),
    "linear, one patch": Case([lambda: mb.sphere(cover="tetrahedral")[:1]]),
    "linear in float32": Case([lambda: mb.sphere(cover="tetrahedral")], rounded=True),
    "planes": Case([lambda: wild(1, 40, 0.3)]),
    "plane sections": Case([mb.sphere]),
    "plane sections of two": Case(
        [lambda: mb.sphere().transform(STRETCH), lambda: mb.sphere(center=(3, 0, 0))]
    ),
    "plane sections in float32": Case([lambda: mb.sphere().transform(STRETCH)], rounded=True),
    "inverted": Case([revolution]),
    "inverted with cells": Case([lambda: revolution(7).transform(STRETCH)]),
    "inverted with an apex": Case([cad_cone]),
    "cone sectors": Case([lambda: mb.cone(capped=True)]),
    "cone sectors and planes": Case([lambda: mb.cone(capped=True), lambda: at(3, mb.cylinder())]),
    "disk": Case([mb.disk]),
    "closed forms of all kinds": Case(
        [
            revolution,
            lambda: at(3, mb.sphere()),
            lambda: at(-3, mb.cone(capped=True)),
            lambda: at(6, mb.sphere(cover="tetrahedral")),
            lambda: at(-6, cad_cone(3)),
        ]
    ),
    "many quadrics": Case([lambda: scattered(mb.sphere, 120, 3)], many=True),
    "many quadrics of some kinds": Case(
        [
            lambda: scattered(lambda: mb.cylinder(capped=True), 40, 4),
            lambda: scattered(revolution, 40, 5),
            lambda: scattered(mb.sphere, 40, 6),
        ],
        many=True,
    ),
    "thin bodies": Case(
        [lambda: along(1, 1, 1000)(mb.sphere()), lambda: along(300, 1, 1)(at(2, mb.cylinder()))]
    ),
    "thin and inverted": Case([lambda: revolution(height=0.001)]),
    "ruled, to infinity": Case([mb.hyperboloid_one_sheet]),
    "elliptic paraboloid": Case([mb.elliptic_paraboloid]),
    "hyperbolic paraboloid": Case([mb.hyperbolic_paraboloid]),
    "two sheets": Case([mb.hyperboloid_two_sheets]),
    "planes to infinity": Case([mb.plane, lambda: at(1, mb.quarter_plane()), mb.half_plane]),
    "graphs": Case([lambda: mb.torus(tube=0.4)], many=True),
    "graphs in float32": Case([lambda: mb.torus(tube=0.4)], rounded=True),
    "graphs, polynomial": Case([teapot], many=True),
    "graphs, one leaf": Case([lambda: height_field(2, 1)[:1]]),
    "height field": Case([lambda: height_field(3, 8)], many=True),
    "graphs, projective": Case([lambda: mb.torus(tube=0.4).transform(IMAGE)]),
    "weights of both signs": Case([lambda: wild(3, 6, 1.5)]),
    "weights of both signs, quadratic": Case([lambda: wild(2, 10, 3.0)], many=True),
    "rational cubics": Case([lambda: wild(3, 12, 0.6)]),
    "mixed degrees": Case([partial(wild, n, 3, 0.4, n) for n in (1, 2, 3, 5, 6)]),
    "graphs and closed forms": Case(
        [
            lambda: mb.torus(tube=0.4),
            lambda: at(4, mb.sphere()),
            lambda: at(-4, revolution()),
            lambda: at(8, mb.cone(capped=True)),
        ],
        many=True,
    ),
    "all kinds": Case(
        [
            lambda: mb.torus(tube=0.4),
            lambda: at(4, mb.sphere()),
            lambda: at(-4, revolution()),
            lambda: at(8, mb.torus(tube=0.3).transform(IMAGE)),
            lambda: at(-8, mb.cone(capped=True)),
            lambda: at(12, mb.sphere(cover="tetrahedral")),
            lambda: at(-12, cad_cone()),
            lambda: along(1, 1, 200)(at(16, mb.cylinder())),
        ]
    ),
    "points and curves": Case([points_and_curves]),
    "trimmed closed forms": Case([lambda: mb.sphere(cover="tetrahedral")], trimmed=True),
    "trimmed inverted": Case([mb.sphere], trimmed=True),
    "trimmed graphs": Case([lambda: mb.torus(tube=0.4)], trimmed=True),
    "trimmed, to infinity": Case([lambda: mb.hyperboloid_one_sheet().elevate()], trimmed=True),
    "trimmed, all kinds": Case(
        [lambda: mb.torus(tube=0.4).transform(IMAGE), lambda: at(5, mb.sphere()), teapot],
        trimmed=True,
    ),
    "instances of closed forms": Case([mb.sphere], instances={0: maps(60)}),
    "instances of graphs": Case([lambda: wild(3, 2, 0.3)], instances={0: maps(30)}),
    "instances beside others": Case(
        [mb.cylinder, lambda: mb.torus(tube=0.4), teapot], instances={0: maps(20), 1: maps(9, 2)}
    ),
    "instances with trims": Case([mb.sphere], trimmed=True, instances={0: maps(20)}),
    "closed forms in float64": Case(
        [mb.sphere, lambda: at(3, revolution()), lambda: at(-3, mb.cone(capped=True))], double=True
    ),
    "graphs in float64": Case(
        [lambda: mb.torus(tube=0.4), lambda: at(5, mb.torus().transform(IMAGE))], double=True
    ),
}


@dataclass
class Image:
    """A small picture by an integrator; by which parameter it is differentiated, if any."""

    integrator: dict[str, Any]
    derivative: str = ""
    medium: bool = False

    def load(self, _folder: Path) -> tuple[Any, Any, str]:
        """Return scene, integrator and parameter."""
        import mitsuba as mi

        to_world = mi.ScalarTransform4f().look_at([2.5, -5, 3], [0, 0, 0.4], [0, 0, 1])
        scene: dict[str, Any] = {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": 45,
                "to_world": to_world,
                "film": {"type": "hdrfilm", "width": 48, "height": 40},
                "sampler": {"type": "independent"},
            },
            "sky": {"type": "constant", "radiance": 0.3},
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -1]).scale(4),
            },
            "torus": shape(mb.torus(tube=0.4), {"type": "roughconductor", "alpha": 0.2}),
            "ball": shape(at(1.9, mb.sphere(radius=0.8)), {"type": "dielectric"}),
            "lamp": {
                **shape(mb.sphere(center=(-1, -1, 2.2), radius=0.4)),
                "light": {"type": "area", "radiance": 6.0},
            },
            "point": {"type": "point", "position": [2, -2, 4], "intensity": 8.0},
        }
        if self.medium:
            scene["ball"]["interior"] = {
                "type": "homogeneous",
                "albedo": 0.8,
                "sigma_t": 2.0,
            }
            scene["ball"]["bsdf"] = {"type": "null"}
        return mi.load_dict(scene), mi.load_dict(self.integrator), self.derivative


def shape(patches: mb.BezierTriangles, bsdf: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the dictionary of a shape."""
    import mitsuba as mi

    net = patches.control_points.astype(np.float32)
    tensor = mi.TensorXf(net.ravel(), shape=net.shape)
    return {"type": "beziertriangle", "control_points": tensor, "bsdf": bsdf or {"type": "diffuse"}}


IMAGES: dict[str, Image] = {
    "bezierpath": Image({"type": "bezierpath", "max_depth": 8, "rr_depth": 3}),
    "bezierpath, no emitters": Image({"type": "bezierpath", "hide_emitters": True}),
    "bezieraov": Image({"type": "bezieraov", "aovs": "p:position,n:sh_normal,i:prim_index"}),
    "path": Image({"type": "path", "max_depth": 6, "rr_depth": 2}),
    "direct": Image({"type": "direct", "emitter_samples": 2, "bsdf_samples": 2}),
    "volpath": Image({"type": "volpath", "max_depth": 8, "rr_depth": 3}, medium=True),
    "volpathmis": Image({"type": "volpathmis", "max_depth": 8, "rr_depth": 3}, medium=True),
    "ptracer": Image({"type": "ptracer", "max_depth": 6, "rr_depth": 3}),
    "prb": Image({"type": "prb", "max_depth": 6, "rr_depth": 3}, "torus.control_points"),
    "prb of the lamp": Image({"type": "prb", "max_depth": 4}, "lamp.control_points"),
    "prb_projective": Image({"type": "prb_projective", "max_depth": 4}, "torus.control_points"),
    "direct_projective": Image({"type": "direct_projective"}, "ball.control_points"),
}
