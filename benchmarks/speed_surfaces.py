"""The surfaces that the tables of `speed` share."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from common import into_view

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.kernels.structure import Structure, build_structure
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafSettings
from mitsuba_bezier.plugins.scene_data import data_for_scene, data_for_shapes

__all__ = [
    "BEZIER",
    "Surface",
    "balls",
    "bezier",
    "bezier_shape",
    "height_field",
    "patches_of",
    "switch_off",
    "tensor",
]

#: Surfaces of our own, and what they are.
BEZIER = {
    "sphere, tetrahedral": "ten quadratic patches: closed form",
    "sphere, octants": "eight quartic patches, as a user gets them",
    "sphere, general": "the same with closed forms switched off",
    "torus": "32 quartic patches",
    "teapot": "64 sextic patches",
}

_TEAPOT = Path(__file__).parents[1] / "scenes" / "models" / "teapot.vtu"


@cache
def patches_of(name: str) -> mb.BezierTriangles:
    """Return the patches of a surface of `BEZIER`, as large as the rays of `common` want it."""
    if name == "sphere, tetrahedral":
        return mb.sphere(cover="tetrahedral")
    if name.startswith("sphere"):
        return mb.sphere(cover="octants")
    return into_view(mb.torus() if name == "torus" else mb.load(_TEAPOT))


def tensor(patches: mb.BezierTriangles) -> Any:
    """Return the control points as a parameter of the shape."""
    net = patches.control_points.astype(np.float32)
    return mi.TensorXf(net.ravel(), shape=net.shape)


def bezier_shape(patches: mb.BezierTriangles) -> dict[str, Any]:
    """Return the dictionary of a shape."""
    return {"type": "beziertriangle", "control_points": tensor(patches)}


class Surface:
    """A shape's ray queries, with a structure that is kept, whatever else is built."""

    def __init__(self, data: Any) -> None:
        self._data = data
        self.structure: Structure = data.structure

    def ray_intersect_preliminary(self, ray: Any) -> Any:
        """Return the nearest hit, as the method of shapes and scenes of that name."""
        return self._data.preliminary(ray).pi

    def ray_test(self, ray: Any) -> Any:
        """Return whether rays hit."""
        return self._data.test(ray)


@cache
def bezier(name: str) -> Surface:
    """Return a surface of `BEZIER`, built once a process."""
    shape = mi.load_dict(bezier_shape(patches_of(name)))
    _SHAPES.append(shape)  # a structure does not keep its shapes alive
    data = data_for_shapes([shape])
    if name == "sphere, general":
        switch_off(data)
    return Surface(data)


_SHAPES: list[Any] = []


def switch_off(data: Any) -> None:
    """Build a structure again without closed forms.

    Parameters
    ----------
    data : SceneData, or a scene whose data are meant
    """
    data = data_for_scene(data) if isinstance(data, mi.Scene) else data
    (shape,) = data.shapes
    general = build_leaves(shape.patches, LeafSettings(closed_form=False))
    data.structure = build_structure(general, mi.Float)


def balls(count: int, seed: int = 0) -> mb.BezierTriangles:
    """Return spheres of ten quadratic patches each, at random in the cube [-1, 1]^3, all alike.

    Parameters
    ----------
    count : int
        Number of patches.
    """
    spheres = max(1, count // 10)
    net = mb.sphere(cover="tetrahedral").control_points
    nets = np.tile(net, (spheres, 1, 1, 1))
    nets[..., :3] *= 0.4 * spheres ** (-1 / 3)
    centre = np.random.default_rng(seed).uniform(-1, 1, (spheres, 1, 1, 3))
    nets[..., :3] += nets[..., 3:] * centre
    return mb.BezierTriangles(nets.reshape(-1, *net.shape[1:]))


def height_field(count: int, noise: float = 0.05, seed: int = 0) -> mb.BezierTriangles:
    """Return cubic patches of a height field over the square [-1, 1]^2, two a cell.

    Parameters
    ----------
    count : int
        Number of patches.
    noise : float
        Standard deviation of the control points' heights about two waves, in cells: at 0.05 a
        patch has about two leaves.
    """
    cells = int(np.ceil(np.sqrt(count / 2)))
    points = 3 * cells + 1
    x, y = np.meshgrid(*[np.linspace(-1.0, 1.0, points)] * 2, indexing="ij")
    z = 0.1 * np.sin(5 * x + 1) * np.cos(4 * y)
    z += noise * 2 / cells * np.random.default_rng(seed).standard_normal(z.shape)
    grid = np.stack([x, y, z, np.ones_like(x)], axis=-1)
    a, b = bernstein.multi_indices(3)[:, :2].T
    corner = 3 * np.stack(np.meshgrid(*[np.arange(cells)] * 2, indexing="ij"), axis=-1)
    i, j = (corner[..., k].reshape(-1, 1) for k in range(2))
    nets = np.concatenate([grid[i + a, j + b], grid[i + 3 - a, j + 3 - b]])
    return mb.BezierTriangles(nets[:count])
