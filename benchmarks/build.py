"""Build of patches beside Embree's build of a mesh that is as exact.

    python benchmarks/build.py [--patches 100000] [--runs 3]

Ours is a height field of cubic patches (`height_field`), from its control points to the structure
on the device. The mesh has the same surface, with patches cut alike into as many triangles as a
silhouette to 1/100 of a pixel needs, where the field is as wide as a frame of 3840 pixels; Mitsuba
gets it as arrays, and `load_dict` of a scene with it builds Embree's tree. Both in one process, by
turns; shown is the least time of the processor, the clock in brackets, and the memory that each
process of its own needs beyond one without a scene.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from common import set_variant, to_mesh

#: Pixels along the field, and how far the mesh may be off, in pixels.
FRAME, ERROR = 3840, 0.01


def cuts(patches: Any) -> tuple[int, float]:
    """Return into how many parts each edge is cut, and what the chords then are off, in pixels.

    On a patch of second derivatives up to `b`, along any direction, chords of a triangle of the
    longest edge `l` in the parameters are off by at most ``b l^2 / 8``; the least number for
    which 99 of 100 patches are within `ERROR`, as a mesher who cuts all alike would have it.
    """
    from mitsuba_bezier.geometry import bernstein

    net = patches.control_points
    points = net[..., :3] / net[..., 3:]
    n = patches.degree
    index = {tuple(x): r for r, x in enumerate(bernstein.multi_indices(n).tolist())}
    most = np.zeros(len(points))
    for i, j, k in bernstein.multi_indices(n - 2).tolist():
        for a, b in ((0, 1), (1, 2), (2, 0)):
            steps = np.zeros((3, 3), dtype=int)
            steps[0, a], steps[1, [a, b]], steps[2, b] = 2, 1, 2
            places = np.add(steps, (i, j, k)).tolist()
            one, two, three = (points[:, index[tuple(place)]] for place in places)
            bent = n * (n - 1) * (one - 2 * two + three)
            most = np.maximum(most, np.linalg.norm(bent, axis=1))
    pixels = most * FRAME / np.ptp(points.reshape(-1, 3), axis=0).max()
    worst = float(np.quantile(pixels, 0.99))
    count = int(np.ceil(np.sqrt(worst / 8 / ERROR)))
    return count, worst / 8 / count**2


def mesh_arrays(patches: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles: each patch cut into ``count^2``."""
    from mitsuba_bezier.geometry import bernstein

    at = bernstein.multi_indices(count)
    basis = bernstein.basis(patches.degree, at[:, :2] / count)
    points = np.empty((len(patches), len(at), 3), dtype=np.float32)
    for first in range(0, len(patches), 1000):  # in float64 they would take gigabytes
        part = slice(first, first + 1000)
        net = basis @ patches.control_points[part]
        points[part] = net[..., :3] / net[..., 3:]
    index = {(i, j): r for r, (i, j, _k) in enumerate(at.tolist())}
    faces = []
    for i, j, k in at.tolist():
        if k > 0:
            faces.append([index[i, j], index[i + 1, j], index[i, j + 1]])
        if i > 0 and j > 0:
            faces.append([index[i, j], index[i - 1, j], index[i, j - 1]])
    starts = len(at) * np.arange(len(points), dtype=np.uint32)
    triangles = np.array(faces, dtype=np.uint32) + starts[:, None, None]
    return points.reshape(-1, 3), triangles.reshape(-1, 3)


def load_mesh(points: np.ndarray, faces: np.ndarray) -> Any:
    """Make a scene of arrays; Embree's tree is built here."""
    import drjit as dr
    import mitsuba as mi

    scene = mi.load_dict({"type": "scene", "mesh": to_mesh(points, faces)})
    hit = scene.ray_test(mi.Ray3f([0, 0, 9], [0, 0, -1]))
    dr.eval(hit)
    dr.sync_thread()
    return scene


def build_patches(patches: Any) -> Any:
    """Build leaves and structure."""
    import drjit as dr
    import mitsuba as mi

    from mitsuba_bezier.kernels.structure import build_structure
    from mitsuba_bezier.leaves.builder import build_leaves

    structure = build_structure(build_leaves(patches), mi.Float)
    dr.sync_thread()
    return structure


def least(make: Callable[[], Any], runs: int) -> tuple[float, float]:
    """Return the least processor time of some runs, and the clock's."""
    found = []
    for _ in range(runs):
        cpu, wall = time.process_time(), time.perf_counter()
        kept = make()
        found.append((time.process_time() - cpu, time.perf_counter() - wall))
        del kept
    return min(found)


def peak(side: str, patches: int) -> float:
    """Return the peak memory of a process of its own, MiB."""
    command = [sys.executable, __file__, "--patches", str(patches), "--side", side]
    out = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
    return float(out.stdout.split()[-1])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--patches", type=int, default=100_000)
    parser.add_argument("--runs", type=int, default=3, help="the least time of so many")
    parser.add_argument("--side", choices=("none", "ours", "mesh"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    memory = {}
    if not args.side:  # first: a child starts with what its parent has had
        memory = {side: peak(side, args.patches) for side in ("none", "ours", "mesh")}
    set_variant("llvm_ad_rgb")
    from speed_surfaces import height_field

    patches = height_field(args.patches)
    count, error = cuts(patches)
    arrays = None if args.side in ("none", "ours") else mesh_arrays(patches, count)
    if args.side:
        kept = None
        if args.side == "ours":
            kept = build_patches(patches)
        elif arrays is not None:
            kept = load_mesh(*arrays)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        del kept
        return
    assert arrays is not None
    build_patches(height_field(100))
    load_mesh(*mesh_arrays(height_field(100), 2))
    ours = least(lambda: build_patches(patches), args.runs)
    mesh = least(lambda: load_mesh(*arrays), args.runs)
    own = {side: memory[side] - memory["none"] for side in ("ours", "mesh")}
    print(f"{len(patches)} patches; {len(arrays[1])} triangles, off by {error:.4f} pixels\n")
    print("| build | processor, s | by the clock | peak memory beyond the patches, MiB |")
    print("| --- | ---: | ---: | ---: |")
    print(f"| ours | {ours[0]:.2f} | {ours[1]:.2f} | {own['ours']:.0f} |")
    print(f"| Embree, as exact | {mesh[0]:.2f} | {mesh[1]:.2f} | {own['mesh']:.0f} |")
    print(f"| ratio (at most 3) | {ours[0] / mesh[0]:.2f} | {ours[1] / mesh[1]:.2f} | |")


if __name__ == "__main__":
    main()
