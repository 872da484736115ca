"""Measure what many instances of a model cost: ``python benchmarks/instances.py``.

Renders 10 000 instances of the teapot that share one net, and 20 tessellated teapots, each in its
own process, and prints the peak memory of both beyond that of an empty scene.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mitsuba_bezier as mb  # before anything imports Dr.Jit

TEAPOT = Path(__file__).resolve().parents[1] / "scenes" / "models" / "teapot.vtu"
KINDS = ("empty", "instances", "meshes")


def render(kind: str, count: int, cuts: int) -> dict:
    """Render one scene in this process; return its figures."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    start = time.perf_counter()
    rng = np.random.default_rng(1)
    side = int(np.ceil(np.sqrt(count)))
    turn = rng.uniform(0, 2 * np.pi, count)
    maps = np.zeros((count, 3, 4))
    maps[:, 0, 0] = maps[:, 1, 1] = np.cos(turn)
    maps[:, 1, 0] = np.sin(turn)
    maps[:, 0, 1] = -np.sin(turn)
    maps[:, 2, 2] = 1.0
    maps[:, 0, 3] = 8.0 * (np.arange(count) % side - side / 2)
    maps[:, 1, 3] = 8.0 * (np.arange(count) // side - side / 2)
    scene: dict = {"type": "scene", "light": {"type": "constant"}}
    triangles = 0
    if kind == "instances":
        maps_tensor = mi.TensorXf(maps.astype(np.float32).ravel(), shape=maps.shape)
        scene["teapots"] = {"type": "beziertriangle", "filename": str(TEAPOT)}
        scene["teapots"]["instances"] = maps_tensor
    elif kind == "meshes":
        vertices, faces = mb.load(TEAPOT).tessellate(cuts)
        triangles = len(faces)
        for k, m in enumerate(maps):
            mesh = mi.Mesh(f"teapot{k}", len(vertices), len(faces))
            params = mi.traverse(mesh)
            moved = vertices @ m[:, :3].T + m[:, 3]
            params["vertex_positions"] = moved.astype(np.float32).ravel()
            params["faces"] = faces.astype(np.uint32).ravel()
            params.update()
            scene[f"teapot{k}"] = mesh
    reach = 8.0 * side
    scene["sensor"] = {
        "type": "perspective",
        "fov": 40,
        "to_world": mi.ScalarTransform4f().look_at(
            [0.9 * reach, -0.9 * reach, 0.7 * reach], [0, 0, 0], [0, 0, 1]
        ),
        "film": {"type": "hdrfilm", "width": 256, "height": 256},
        "sampler": {"type": "independent", "sample_count": 4},
    }
    loaded = mi.load_dict(scene)
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 3})
    image = np.array(mi.render(loaded, integrator=integrator))
    return {
        "kind": kind,
        "count": 0 if kind == "empty" else count,
        "triangles": triangles,
        "seconds": time.perf_counter() - start,
        "peak MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "mean": float(image.mean()),
    }


def main() -> None:
    """Run the three scenes, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--count", type=int, default=10_000, help="instances (10000)")
    parser.add_argument("--meshes", type=int, default=20, help="tessellated teapots (20)")
    parser.add_argument(
        "--cuts", type=int, default=64, help="cuts of a patch's edge; 64: 262 144 triangles (64)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    parser.add_argument("--only", choices=KINDS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        count = options.meshes if options.only == "meshes" else options.count
        print(json.dumps(render(options.only, count, options.cuts)))
        return
    rows = []
    for kind in KINDS:
        command = [sys.executable, __file__, *sys.argv[1:], "--only", kind]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        rows.append(json.loads(done.stdout.strip().splitlines()[-1]))
    for row in rows:
        row["MiB beyond empty"] = row["peak MiB"] - rows[0]["peak MiB"]
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    table = Table(title="Memory of teapots")
    for column in ("kind", "count", "triangles each", "peak MiB", "beyond empty", "seconds"):
        table.add_column(column, justify="left" if column == "kind" else "right")
    for row in rows:
        table.add_row(
            row["kind"],
            str(row["count"]),
            str(row["triangles"]),
            f"{row['peak MiB']:.0f}",
            f"{row['MiB beyond empty']:.0f}",
            f"{row['seconds']:.1f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
