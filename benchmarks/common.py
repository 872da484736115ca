"""What the benchmarks share: rays, meshes, the machine, timing."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import mitsuba_bezier as mb

__all__ = ["best_times", "camera_rays", "machine", "random_rays", "sphere_mesh", "to_rays"]


def camera_rays(side: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return `side**2` coherent rays: a jittered pinhole grid in front of the unit sphere.

    The frame is as wide as the sphere; about two thirds of the rays hit.
    """
    rng = np.random.default_rng(seed)
    o = np.array([0.3, -0.4, 3.0])
    forward = -o / np.linalg.norm(o)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    y, x = np.mgrid[0:side, 0:side]
    x = (x + rng.random((side, side))) * (2 / side) - 1
    y = (y + rng.random((side, side))) * (2 / side) - 1
    d = forward + 0.4 * (x[..., None] * right + y[..., None] * up)
    d = (d / np.linalg.norm(d, axis=-1, keepdims=True)).reshape(-1, 3)
    return np.broadcast_to(o, d.shape).astype(np.float32), d.astype(np.float32)


def random_rays(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from a sphere of radius 2.5 to points of a ball of radius 1.2."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, count, 3))
    a *= 2.5 / np.linalg.norm(a, axis=1, keepdims=True)
    b *= 1.2 * np.cbrt(rng.random((count, 1))) / np.linalg.norm(b, axis=1, keepdims=True)
    d = b - a
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return a.astype(np.float32), d.astype(np.float32)


def to_rays(o: np.ndarray, d: np.ndarray) -> Any:
    """Return evaluated `mi.Ray3f`."""
    ray = mi.Ray3f(mi.Point3f(*o.T.copy()), mi.Vector3f(*d.T.copy()))
    dr.eval(ray)
    return ray


def sphere_mesh(triangles: int) -> Any:
    """Return a mesh of the unit sphere, at least `triangles` large: the octants, tessellated."""
    resolution = int(np.ceil(np.sqrt(triangles / 8)))
    vertices, faces = mb.sphere(cover="octants").tessellate(resolution)
    mesh = mi.Mesh("sphere", len(vertices), len(faces))
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params.update()
    return mesh


def best_times(tasks: dict[str, Callable[[], Any]], runs: int) -> dict[str, float]:
    """Time tasks in turns and return the best of each, in seconds.

    The first run of each, which compiles, is not counted. Results are evaluated and waited for.
    """

    def once(task: Callable[[], Any]) -> float:
        dr.sync_thread()
        start = time.perf_counter()
        dr.eval(task())
        dr.sync_thread()
        return time.perf_counter() - start

    best = {}
    for name, task in tasks.items():
        once(task)
        best[name] = float("inf")
    for _ in range(runs):
        for name, task in tasks.items():
            best[name] = min(best[name], once(task))
    return best


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as lines:
            for line in lines:
                if line.startswith("model name"):
                    return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def machine() -> dict[str, Any]:
    """Return versions and hardware, for the record."""
    llvm = mi.variant().startswith("llvm")
    return {
        "variant": mi.variant(),
        "mitsuba_bezier": mb.__version__,
        "mitsuba": version("mitsuba"),
        "drjit": version("drjit"),
        "llvm": ".".join(map(str, dr.detail.llvm_version())) if llvm else None,
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "threads": dr.thread_count() if llvm else None,
    }
