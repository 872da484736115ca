"""What the benchmarks share: rays, meshes, timing, child processes, the machine.

Timing is our own and not asv's: two things are compared by turns within one process, on a machine
that may have other work, while asv times one commit after the other.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import mitsuba_bezier as mb

__all__ = [
    "Options",
    "Timing",
    "camera_rays",
    "child",
    "into_view",
    "machine",
    "mesh",
    "random_rays",
    "resolution_for",
    "set_variant",
    "time_in_turns",
    "to_mesh",
    "to_rays",
]


@dataclass(frozen=True)
class Options:
    """What a run measures; the same for all tables."""

    variant: str = "llvm_ad_rgb"
    million: float = 4.0  #: rays of each kind, in millions
    runs: int = 7  #: repetitions of each ray query
    renders: int = 3  #: the same for renders
    side: int = 256  #: of the rendered images, in pixels
    spp: int = 64
    large: bool = False  #: with meshes of 16 million triangles: some 5 GB of memory
    mesh_unit: float = 1e6  #: triangles in a "million" of a mesh; smaller in tests
    patches: tuple[int, ...] = (1, 100, 10_000, 100_000)

    @property
    def side_of_rays(self) -> int:
        """Side of the square of coherent rays; a multiple of eight."""
        return max(8, int(np.sqrt(self.million * 1e6)) // 8 * 8)

    @property
    def mesh_sizes(self) -> dict[str, int]:
        """Triangles of the sphere meshes, by label."""
        sizes = {"mesh 65k": 0.065536, "mesh 1M": 1.0}
        if self.large:
            sizes["mesh 16M"] = 16.777216
        return {name: max(8, int(size * self.mesh_unit)) for name, size in sizes.items()}


# ---------------------------------------------------------------------- rays


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


# ---------------------------------------------------------------------- surfaces


def into_view(patches: mb.BezierTriangles) -> mb.BezierTriangles:
    """Move and scale patches so that they fill the frame of `camera_rays`, 2.4 wide."""
    box = patches.hulls()
    low, high = box[:, 0].min(axis=0), box[:, 1].max(axis=0)
    scale = 2.4 / float((high - low).max())
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = -scale * (low + high) / 2
    return patches.transform(matrix)


def resolution_for(patches: int, triangles: int) -> int:
    """Return the resolution at which that many patches give at least that many triangles."""
    return int(np.ceil(np.sqrt(triangles / patches)))


def mesh(patches: mb.BezierTriangles, triangles: int, bsdf: Any = None) -> Any:
    """Return the patches as a mesh of at least that many triangles."""
    return to_mesh(*patches.tessellate(resolution_for(len(patches), triangles)), bsdf=bsdf)


def to_mesh(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None = None, bsdf: Any = None
) -> Any:
    """Return a mesh of Mitsuba, given its vertices, triangles, and normals at the vertices."""
    props = mi.Properties()
    if bsdf is not None:
        props["bsdf"] = bsdf
    result = mi.Mesh(
        "mesh", len(vertices), len(faces), props=props, has_vertex_normals=normals is not None
    )
    params = mi.traverse(result)
    params["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    if normals is not None:
        params["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params.update()
    return result


# ---------------------------------------------------------------------- timing


@dataclass(frozen=True)
class Timing:
    """Seconds of one task, over its repetitions."""

    best: float  #: shortest time by the clock
    median: float
    cpu: float  #: least time of all threads together: the measure on a machine with other work

    def as_row(self) -> dict[str, float]:
        """Return the numbers for JSON."""
        return {"best": self.best, "median": self.median, "cpu": self.cpu}


def time_in_turns(tasks: dict[str, Callable[[], Any]], runs: int) -> dict[str, Timing]:
    """Time tasks in turns.

    The first two runs of each are not counted: they compile, the second one sometimes again, as
    kernels that use the same literals as another one before them are written in another order.
    Results are evaluated and waited for.
    """

    def once(task: Callable[[], Any]) -> tuple[float, float]:
        dr.sync_thread()
        cpu, start = time.process_time(), time.perf_counter()
        dr.eval(task())
        dr.sync_thread()
        return time.perf_counter() - start, time.process_time() - cpu

    for task in 2 * list(tasks.values()):
        once(task)
    seen: dict[str, list[tuple[float, float]]] = {name: [] for name in tasks}
    for _ in range(runs):
        for name, task in tasks.items():
            seen[name].append(once(task))
    return {
        name: Timing(
            best=min(wall for wall, _ in pairs),
            median=statistics.median(wall for wall, _ in pairs),
            cpu=min(cpu for _, cpu in pairs),
        )
        for name, pairs in seen.items()
    }


# ---------------------------------------------------------------------- processes


def set_variant(name: str) -> None:
    """Set the variant, or end the program with one line that says why it does not start."""
    try:
        mi.set_variant(name)
        dr.eval(mi.Float([0.0]) + 1.0)
    except Exception as error:  # what Dr.Jit raises without a driver has no class of its own
        reason = str(error).strip().splitlines()
        raise SystemExit(
            f"the variant {name} does not start here: {reason[0] if reason else error}"
        ) from None


def child(script: str, arguments: list[str], variables: dict[str, str] | None = None) -> Any:
    """Run a script of this folder in a process of its own; return the JSON of its last line."""
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name(script)), *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **(variables or {})},
    )
    if done.returncode != 0:
        raise SystemExit(f"{script} {' '.join(arguments)} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


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
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }
