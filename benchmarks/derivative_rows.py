"""The situations of `derivatives.py`: a scene, what moves in it, and who differentiates it.

Small scenes, without what a row is not about: where outlines are no subject, none is in the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import mitsuba as mi
import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map
from mitsuba_bezier.io.trim_arrays import trims_to_numbers

__all__ = ["SITUATIONS", "Situation"]

#: Gives the scene its state at a number with derivatives.
Move = Callable[[Any], None]

PATH = {"type": "bezierpath", "max_depth": 6, "rr_depth": 20}
OUTLINES = {"type": "bezier_prb_projective", "max_depth": 6, "rr_depth": 20}


@dataclass(frozen=True)
class Situation:
    """A row of the table."""

    name: str
    by: str  #: what the picture is differentiated by
    make: Callable[[], tuple[Any, Move]]
    step: float  #: of the differences: their error by it is far below what is asked
    spp: int  #: samples a pixel of one image
    integrator: dict[str, Any] = field(default_factory=lambda: dict(PATH))
    #: what differences are taken of, where the integrator has samples of its own for outlines
    primal: dict[str, Any] | None = None
    variant: str = "llvm_ad_rgb"
    #: why there is no derivative yet: the row is measured, and not judged
    missing: str = ""


# ---------------------------------------------------------------------- parts of scenes


def _tensor(net: np.ndarray) -> Any:
    values = np.asarray(net, dtype=np.float32)
    return mi.TensorXf(values.ravel(), shape=values.shape)


def _shape(net: Any, **more: Any) -> dict[str, Any]:
    points = getattr(net, "control_points", net)
    return {"type": "beziertriangle", "control_points": _tensor(points), **more}


def _sheet(z: float, phase: float, up: bool = True) -> np.ndarray:
    """Return a bent cubic, wider than what the camera sees of it: no outline is in the image."""
    ij = np.array(bernstein.multi_indices(3))[:, :2]
    x, y = (3 * (ij if up else ij[:, ::-1]) - 3).T
    bend = 0.1 * np.sin(1.3 * (x + y) + phase) + 0.05 * np.cos(x - phase)
    w = 1 + 0.2 * np.sin(x + 2 * y + phase)
    return (np.c_[x, y, z + bend, np.ones(len(x))] * w[:, None])[None]


def _lens(half: float, phase: float = 0.0) -> np.ndarray:
    return np.concatenate([_sheet(half, phase), _sheet(-half, phase + 2, up=False)])


def _picture(cycles: float = 1.0) -> dict[str, Any]:
    """Return a texture that is smooth over the steps of the differences."""
    x = np.linspace(0, cycles, 32)
    values = [np.add.outer(np.sin(7 * x + k), np.cos(9 * x - k)) / 4 + 0.5 for k in range(3)]
    data = np.stack(values, axis=-1).astype(np.float32)
    # spectral variants take colours for those of sRGB, not for numbers
    return {"type": "bitmap", "bitmap": mi.Bitmap(data), "raw": not mi.is_spectral}


def _look(origin: Any, target: Any, up: Any = (0, 1, 0)) -> Any:
    return mi.ScalarTransform4f().look_at(list(origin), list(target), list(up))


def _camera(origin: Any, target: Any, fov: float, up: Any = (0, 1, 0)) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": 4, "height": 4, "pixel_format": "rgb"}
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": _look(origin, target, up),
        "film": film | {"rfilter": {"type": "box"}},
        "sampler": {"type": "multijitter"},
    }


def _above(fov: float = 12) -> dict[str, Any]:
    return _camera([0, 0, 4], [0, 0, 0], fov)


def _bright(z: float, target: float) -> dict[str, Any]:
    """Return a bright picture at height `z` that faces height `target`."""
    place = _look([0, 0, z], [0, 0, target]).scale(6)
    return {
        "type": "rectangle",
        "to_world": place,
        "emitter": {"type": "area", "radiance": _picture()},
    }


def _lamp(origin: Any, target: Any, radiance: float, size: float = 1.0) -> dict[str, Any]:
    place = _look(origin, target, (0, 1, 0.1)).scale(size)
    return {
        "type": "rectangle",
        "to_world": place,
        "emitter": {"type": "area", "radiance": radiance},
    }


def _glass(inside: float = 1.5, outside: float = 1.0) -> dict[str, Any]:
    return {"type": "dielectric", "int_ior": inside, "ext_ior": outside}


def _mirror() -> dict[str, Any]:
    return {"type": "twosided", "metal": {"type": "conductor", "material": "none"}}


# ---------------------------------------------------------------------- what moves


def _by_net(scene: Any, scale: Any = (0.3, 0.3, 0.3, 0), key: str = "surface") -> Move:
    """Return the motion of all control points by vectors that no symmetry hides an error from."""
    params = mi.traverse(scene)
    key = f"{key}.control_points"
    net = np.array(params[key])
    change = np.random.default_rng(3).normal(size=net.shape) * scale
    # along with their weights, so that the points move by that much
    change[..., :3] *= net[..., 3:]

    def move(e: Any) -> None:
        params[key] = _tensor(net) + e * _tensor(change)
        params.update()

    return move


def _by_growth(scene: Any) -> Move:
    """Return growth of a net about the origin."""
    params = mi.traverse(scene)
    net = np.array(params["surface.control_points"])
    change = net * (1, 1, 1, 0)

    def move(e: Any) -> None:
        params["surface.control_points"] = _tensor(net) + e * _tensor(change)
        params.update()

    return move


def _by_weights(scene: Any) -> Move:
    """Return the change of all weights, of control points that stay where they are."""
    params = mi.traverse(scene)
    net = np.array(params["surface.control_points"])
    change = net * np.random.default_rng(5).normal(size=(*net.shape[:2], 1))

    def move(e: Any) -> None:
        params["surface.control_points"] = _tensor(net) + e * _tensor(change)
        params.update()

    return move


def _by_place(scene: Any, key: str = "surface", turns: float = 6.0) -> Move:
    params = mi.traverse(scene)
    key = f"{key}.to_world"
    first = np.array(params[key].matrix).reshape(4, 4)

    def move(e: Any) -> None:
        shift = mi.Transform4f().translate(mi.Vector3f(0.3, -0.2, 0.25) * e)
        turn = mi.Transform4f().rotate([0.3, 1, 0.2], turns * e) if turns else mi.Transform4f()
        params[key] = shift @ turn @ mi.Transform4f(mi.Matrix4f(mi.ScalarMatrix4f(first)))
        params.update()

    return move


def _by_size(scene: Any) -> Move:
    """Return growth about the shape's own origin."""
    params = mi.traverse(scene)
    first = np.array(params["surface.to_world"].matrix).reshape(4, 4)

    def move(e: Any) -> None:
        place = mi.Transform4f(mi.Matrix4f(mi.ScalarMatrix4f(first)))
        params["surface.to_world"] = place @ mi.Transform4f().scale(mi.Vector3f(1 + e))
        params.update()

    return move


def _by_value(scene: Any, key: str, rate: float = 1.0) -> Move:
    params = mi.traverse(scene)
    # below it there is a texture, or a volume
    key = next(k for k in params.keys() if k.startswith(key))  # noqa: SIM118
    first = type(params[key])(params[key])

    def move(e: Any) -> None:
        params[key] = first + rate * e
        params.update()

    return move


def _with(move: Callable[[Any], Move], make: Callable[[], Any]) -> Callable[[], tuple[Any, Move]]:
    def made() -> tuple[Any, Move]:
        scene = make()
        return scene, move(scene)

    return made


def _scene(**shapes: Any) -> Any:
    return mi.load_dict({"type": "scene", **shapes})


# ---------------------------------------------------------------------- scenes


def _diffuse() -> Any:
    bsdf = {"type": "diffuse", "reflectance": _picture()}
    point = {"type": "point", "position": [1, 3, 4.0], "intensity": 20.0}
    return _scene(camera=_above(), surface=_shape(_sheet(0, 0), bsdf=bsdf), point=point)


def _rough() -> Any:
    bsdf = {"type": "twosided", "metal": {"type": "roughconductor", "alpha": 0.3}}
    return _scene(camera=_above(), surface=_shape(_sheet(0, 0), bsdf=bsdf), picture=_bright(5, 0))


def _in_mirror() -> Any:
    return _scene(
        camera=_above(), surface=_shape(_sheet(0, 0), bsdf=_mirror()), picture=_bright(5, 0)
    )


def _wall_behind_glass() -> Any:
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -2.5]).scale(6),
        "bsdf": {"type": "diffuse", "reflectance": _picture()},
    }
    lamp = {"type": "point", "position": [0.4, 0.2, -1.2], "intensity": 3.0}
    surface = _shape(_lens(0.5), bsdf=_glass())
    return _scene(camera=_above(), surface=surface, wall=wall, lamp=lamp)


def _light_behind_glass() -> Any:
    surface = _shape(_lens(0.5), bsdf=_glass())
    return _scene(camera=_above(), surface=surface, picture=_bright(-3, 0))


def _light_behind_any_glass() -> Any:
    """The same with glass whose index is a parameter."""
    surface = _shape(_lens(0.5), bsdf={"type": "dispersive", "int_ior": 1.5})
    return _scene(camera=_above(), surface=surface, picture=_bright(-3, 0))


def _nested() -> Any:
    inside = _shape(_lens(0.2, 1.0), bsdf=_glass(1.2, 1.5))
    outside = _shape(_lens(0.5), bsdf=_glass())
    return _scene(camera=_above(), surface=inside, outside=outside, picture=_bright(-3, 0))


def _fog() -> Any:
    medium = {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": [0.8, 0.5, 0.3]},
        "sigma_t": {"type": "rgb", "value": [0.9, 0.7, 0.5]},
        "phase": {"type": "hg", "g": 0.3},
    }
    surface = _shape(mb.sphere(), bsdf={"type": "null"}, interior=medium)
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -1.5]).scale(4),
    }
    return _scene(
        camera=_camera([0, 0.5, 5], [0, 0, 0], 30),
        surface=surface,
        wall=wall,
        lamp=_lamp([2, 3, 2], [0, 0, 0], 5.0),
        sky={"type": "constant", "radiance": 0.3},
    )


def _shadow_behind_glass() -> Any:
    """A ball beside the view throws a soft shadow on a floor that is seen through a lens."""
    floor = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -3]).scale(6),
    }
    return _scene(
        camera=_above(),
        lens=_shape(_lens(0.5), bsdf=_glass()),
        # black: what the ball itself throws onto the floor has no derivative at its outline
        surface=_shape(
            mb.sphere((1.5, 0.4, -2.1), 0.6), bsdf={"type": "diffuse", "reflectance": 0}
        ),
        floor=floor,
        lamp=_lamp([3.2, 0.8, -1.2], [0, 0, -3], 20.0, 0.5),
    )


def _ball_in_mirror() -> Any:
    """A ball behind the camera, before a bright backdrop, in a plane mirror."""
    bsdf = {"type": "diffuse", "reflectance": 0.4}
    return _scene(
        camera=_above(20),
        glass=_shape(_flat(0.0, 4.0), bsdf=_mirror()),
        surface=_shape(
            mb.sphere((0, 0, 0), 0.9),
            bsdf=bsdf,
            to_world=mi.ScalarTransform4f().translate([0.2, 0.1, 6.0]),
        ),
        picture=_bright(9, 0),
    )


def _flat(z: float, half: float) -> np.ndarray:
    a, b, c, d = (
        [x, y, z, 1] for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))
    )
    return np.array([[a, b, c], [a, c, d]], dtype=np.float64)


def _window() -> Any:
    """A pane with a round hole before a bright backdrop."""
    w = np.sqrt(0.5)
    curves = []
    for k in range(4):
        rows = []
        for j, weight in enumerate((1, w, 1)):
            angle = np.pi / 4 * (2 * k + j)
            point = np.array([0.5, 0.5]) + 0.3 * np.array([np.cos(angle), np.sin(angle)]) / weight
            rows.append([*point * weight, weight])
        curves.append(np.array(rows))
    corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    square = [np.array([[*a, 1], [*b, 1]], float) for a, b in pairwise(corners)]
    trims = Trims(
        [square + closed_region(curves, 1e-9)],
        [0, 0],
        [square_map(), square_map(True)],
        [[[0, 0], [1, 1]]] * 2,
    )
    pane = mb.tensor_to_triangles(
        np.array([[[-1, -1, 0, 1], [-1, 1, 0, 1]], [[1, -1, 0, 1], [1, 1, 0, 1]]], dtype=float)
    )
    surface = _shape(pane, trims=_tensor(trims_to_numbers(trims)), bsdf={"type": "diffuse"})
    return _scene(camera=_above(24), surface=surface, picture=_bright(-3, 0))


def _copies() -> Any:
    """Two instances of a ball before a bright backdrop."""
    maps = np.stack([np.eye(4), np.eye(4)])
    maps[0, 0, 3], maps[1, 0, 3], maps[1, 1, 3] = -0.5, 0.45, 0.2
    ball = mb.sphere((0, 0, 0), 0.35)
    surface = _shape(ball, instances=_tensor(maps), bsdf={"type": "diffuse"})
    return _scene(camera=_above(24), surface=surface, picture=_bright(-3, 0))


def _caustic() -> Any:
    camera = _camera([0, -6, -1.2], [0, 0, -3], 35, (0, 0, 1))
    camera["film"] |= {"width": 8, "height": 8, "rfilter": {"type": "gaussian"}}
    floor = mi.ScalarTransform4f().translate([0, 0, -3]).scale(8)
    lamp = {
        "type": "spot",
        "to_world": _look([0.2, 0.1, 4], [0, 0, 0]),
        "cutoff_angle": 8,
        "beam_width": 2,
        "intensity": 900.0,
    }
    surface = _shape(_lens(0.5), bsdf=_glass())
    return _scene(
        camera=camera, surface=surface, floor={"type": "rectangle", "to_world": floor}, lamp=lamp
    )


def _net(scene: Any) -> Move:
    return _by_net(scene)


SITUATIONS = [
    Situation("diffuse", "net", _with(_net, _diffuse), 0.02, 1024),
    Situation("rough", "net", _with(_net, _rough), 0.02, 4096),
    Situation("mirror", "net", _with(_net, _in_mirror), 0.02, 1024),
    Situation("glass", "net", _with(_net, _wall_behind_glass), 0.02, 4096),
    Situation("nested glass", "net", _with(_net, _nested), 0.02, 4096),
    Situation("textured light through glass", "net", _with(_net, _light_behind_glass), 0.02, 4096),
    Situation(
        "medium",
        "extinction",
        _with(lambda scene: _by_value(scene, "surface.interior_medium.sigma_t"), _fog),
        0.2,
        4096,
        {"type": "beziervolpath", "max_depth": 6, "rr_depth": 20},
    ),
    Situation(
        "boundary of a medium",
        "net",
        _with(_by_growth, _fog),
        0.04,
        8192,
        {"type": "beziervolpath", "max_depth": 6, "rr_depth": 20},
    ),
    Situation(
        "shadow through glass",
        "place of the caster",
        _with(lambda scene: _by_place(scene, turns=0), _shadow_behind_glass),
        0.1,
        4096,
        PATH | {"shadow_steps": 8},
    ),
    Situation(
        "outline in a mirror",
        "size",
        _with(_by_size, _ball_in_mirror),
        0.05,
        4096,
        OUTLINES,
        PATH,
    ),
    Situation(
        "trim",
        "place",
        _with(lambda scene: _by_place(scene, turns=0), _window),
        0.1,
        4096,
        OUTLINES,
        PATH,
    ),
    Situation(
        "instance",
        "place",
        _with(lambda scene: _by_place(scene, turns=0), _copies),
        0.1,
        4096,
        OUTLINES,
        PATH,
    ),
    Situation(
        "caustic by light tracer",
        "net",
        _with(_net, _caustic),
        0.03,
        2025,
        {"type": "bezierptracer", "max_depth": 4, "rr_depth": 20},
    ),
    Situation(
        "ior",
        "int_ior",
        _with(lambda scene: _by_value(scene, "surface.bsdf.int_ior"), _light_behind_any_glass),
        0.04,
        4096,
    ),
    Situation(
        "to_world", "place", _with(lambda scene: _by_place(scene), _light_behind_glass), 0.04, 4096
    ),
    Situation("weights", "weights", _with(_by_weights, _light_behind_glass), 0.04, 4096),
    Situation(
        "spectral",
        "net",
        _with(_net, _light_behind_glass),
        0.02,
        4096,
        variant="llvm_ad_spectral",
    ),
]
