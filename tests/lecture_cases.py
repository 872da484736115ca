"""The lecture's scenes and the rays with which their tests look at them."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from copy import copy
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.camera import Camera

__all__ = ["SCENES", "Shot", "edge_between", "make_lecture", "shot"]

SCENES = Path(__file__).resolve().parents[1] / "scenes"


@cache
def make_lecture() -> ModuleType:
    """Return the script that writes the models, as a module."""
    sys.path.insert(0, str(SCENES))  # it imports its neighbours
    try:
        spec = importlib.util.spec_from_file_location("make_lecture", SCENES / "make_lecture.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules["make_lecture"] = module
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(SCENES))
    return module


class Shot:
    """A scene with one of its sensors, looked at by exact rays through its pixels."""

    def __init__(self, scene: Any, sensor: int = 0) -> None:
        self.scene = scene
        self.curtain: np.ndarray | None = None
        self.sensor = scene.sensors()[sensor]
        # the map of the sensor's own float32 parameters
        self.camera = Camera.from_parameters(mi.traverse(self.sensor))
        self.ids = [shape.id() for shape in scene.shapes()]

    def rays(self, pixels: np.ndarray) -> Any:
        """Return world rays of unit direction through pixels ``(N, 2)``."""
        d = self.camera.direction(pixels)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        o = np.broadcast_to(self.camera.center[:3] / self.camera.center[3], d.shape)
        if self.curtain is not None:
            o = o - d * ((o @ self.curtain[:3] + self.curtain[3]) / (d @ self.curtain[:3]))[:, None]
        return mi.Ray3f(mi.Point3f(*o.T.astype(np.float32)), mi.Vector3f(*d.T.astype(np.float32)))

    def behind(self, plane: Any) -> Shot:
        """Return the same view with rays that start where they meet a plane ``(4,)``."""
        out = copy(self)
        out.curtain = np.array(plane, dtype=np.float64)
        return out

    def look(self, pixels: np.ndarray) -> tuple[np.ndarray, Any]:
        """Return what is seen at pixels: numbers of shapes in `ids` (-1 for none) and the hits."""
        si = mb.ray_intersect(self.scene, self.rays(pixels))
        known = np.array(dr.reinterpret_array(mi.UInt32, self.scene.shapes_dr()))
        met = np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(si.shape)))
        number = np.full(max(known.max(), met.max()) + 1, -1)
        number[known] = np.arange(len(known))
        return np.where(np.array(si.is_valid()), number[met], -1), si

    def sees(self, pixels: np.ndarray, *names: str) -> np.ndarray:
        """Return where one of these shapes is the first that the rays meet."""
        numbers = [self.ids.index(name) for name in names]
        return np.isin(self.look(pixels)[0], numbers)


@cache
def shot(name: str, sensor: int = 0) -> Shot:
    """Return a scene of this folder, at its own resolution."""
    return Shot(mi.load_file(str(SCENES / f"{name}.xml")), sensor)


def edge_between(
    inside: Callable[[np.ndarray], np.ndarray], a: np.ndarray, b: np.ndarray, steps: int = 16
) -> np.ndarray:
    """Return pixels ``(N, 2)`` where `inside` changes between pixels a (inside) and b (not).

    Bisection: 16 steps leave 2^-17 of the distance, some 1e-5 px from a start of a few pixels.
    """
    a, b = np.array(a, dtype=np.float64), np.array(b, dtype=np.float64)
    assert inside(a).all() and not inside(b).any(), "the ends are not on both sides of the edge"
    for _ in range(steps):
        middle = (a + b) / 2
        within = inside(middle)[:, None]
        a, b = np.where(within, middle, a), np.where(within, b, middle)
    return (a + b) / 2
