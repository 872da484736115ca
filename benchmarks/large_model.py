"""A model of 100 000 patches: file, loading, structure, memory.

    python benchmarks/large_model.py [--patches 100000] [--degree 3] [--json FILE]

Rational patches of a wavy sphere are written as binary ``.vtu``, read, and made into the structure
that rays meet; each step in a process of its own, which tells its time and its largest resident
memory. Times are processor seconds, so that other programs on the machine matter little.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier._files import write_file


def model(count: int, degree: int) -> mb.BezierTriangles:
    """Return at least `count` patches that cover a wavy sphere, with weights from 0.8 to 1.25."""
    # a tessellated octant's triangles as patches: corners, edge and inner points on the surface
    resolution = int(np.ceil(np.sqrt(count / 8)))
    vertices, faces = mb.sphere(cover="octants").tessellate(resolution)
    from mitsuba_bezier.geometry import bernstein

    lattice = bernstein.multi_indices(degree) / degree
    points = np.einsum("kc,fcx->fkx", lattice, vertices[faces])
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points *= 1 + 0.05 * np.sin(9 * points[..., :1]) * np.cos(7 * points[..., 1:2])
    weight = 1.25 ** np.sin(11 * points[..., 2:])
    nets = np.concatenate([points * weight, weight], axis=-1)
    return mb.BezierTriangles(nets)


def step(name: str, path: Path, count: int, degree: int) -> dict[str, Any]:
    """Run one step in this process and return its figures."""
    start = time.process_time()
    facts: dict[str, Any] = {}
    if name == "write":
        patches = model(count, degree)
        start = time.process_time()
        io.save(patches, path, encoding="binary")
        facts["patches"] = len(patches)
    elif name == "load":
        facts["patches"] = len(io.load(path))
    else:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        patches = io.load(path)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        start = time.process_time()
        from mitsuba_bezier.kernels.structure import build_structure
        from mitsuba_bezier.leaves.builder import build_leaves

        leaves = build_leaves(patches)
        facts["leaves_s"] = time.process_time() - start
        structure = build_structure(leaves, mi.Float)
        facts["leaves"] = structure.leaf_count
        facts["structure_MB"] = structure.bytes / 1e6
        facts["bytes_a_leaf"] = structure.bytes / structure.leaf_count
        facts["before_MB"] = before / 1e3
    facts["cpu_s"] = time.process_time() - start
    facts["peak_MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return facts


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--patches", type=int, default=100_000)
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--step", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.step:
        print(json.dumps(step(args.step[0], Path(args.step[1]), args.patches, args.degree)))
        return
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.vtu"
        for name in ("write", "load", "build"):
            command = [sys.executable, __file__, "--step", name, str(path)]
            command += ["--patches", str(args.patches), "--degree", str(args.degree)]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            out[name] = json.loads(done.stdout.splitlines()[-1])
        out["file_MB"] = path.stat().st_size / 1e6
    build = out["build"]
    print(f"patches            {out['load']['patches']} of degree {args.degree}, rational")
    print(f"file               {out['file_MB']:.1f} MB")
    for name in ("write", "load"):
        print(f"{name:18} {out[name]['cpu_s']:.1f} s, {out[name]['peak_MB']:.0f} MB at most")
    print(f"build: leaves      {build['leaves_s']:.1f} s, {build['leaves']} leaves")
    print(f"build: structure   {build['cpu_s'] - build['leaves_s']:.1f} s")
    print(
        f"structure          {build['structure_MB']:.0f} MB, {build['bytes_a_leaf']:.0f} B a leaf"
    )
    print(
        f"build: memory      {build['peak_MB']:.0f} MB at most, {build['before_MB']:.0f} MB before"
    )
    if args.json:
        write_file(args.json, json.dumps(out, indent=2).encode())


if __name__ == "__main__":
    main()
