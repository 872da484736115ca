"""Time from a CAD file to its first picture, beside OpenCASCADE's mesh of it in Mitsuba.

    python benchmarks/first_picture.py FILE.step FILE.iges ... [--size 256] [--rounds 1]

Each side is a process of its own, with a home folder of its own, so that Dr.Jit finds no compiled
kernel: it starts, imports, reads the file, builds or meshes, compiles and renders a picture of
256 x 256 pixels at 1 sample each, from the same camera. The other side reads with OpenCASCADE,
meshes at a chord error of 1e-5 of the part's size (and 0.5 radian, which is its default), and
renders the mesh with Mitsuba's ``path``. Rhino files, which OpenCASCADE does not read, stand alone.

Shown is processor time, of the process and its children; wall time in brackets. A process that
takes more than ``--limit`` seconds of the processor is ended. Needs the extras ``[cad]`` and
``[rhino]``.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

#: Chord error of the mesh, of the size of the part.
CHORD = 1e-5


def render(shape: dict[str, object] | object, low: np.ndarray, high: np.ndarray, size: int) -> None:
    """Render one shape, lit by a constant sky, and say how many pixels it covers."""
    import mitsuba as mi

    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    d = np.array([-0.48, 0.71, -0.515])
    place = mi.ScalarTransform4f().look_at(
        (middle - reach * d).tolist(), middle.tolist(), [0, 0, 1]
    )
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgba"}
    sensor = {"type": "orthographic", "near_clip": 1e-3 * reach, "far_clip": 3 * reach}
    sensor |= {"to_world": place.scale(reach / 2), "film": film}
    scene = {"type": "scene", "integrator": {"type": "path", "hide_emitters": True}}
    scene |= {"sky": {"type": "constant"}, "sensor": sensor, "shape": shape}
    image = np.array(mi.render(mi.load_dict(scene), spp=1))
    print(f"{int((image[..., 3] > 0).sum())} pixels", end="")


def ours(path: Path, size: int) -> None:
    """Render a file's exact patches."""
    import mitsuba_bezier  # noqa: F401, I001 (before Mitsuba, for which it finds LLVM)
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    shape = mi.load_dict({"type": "beziertriangle", "filename": str(path)})
    box = shape.bbox()
    render(shape, np.array(box.min), np.array(box.max), size)


def mesh(path: Path, size: int) -> None:
    """Render OpenCASCADE's mesh of a file."""
    import mitsuba as mi
    from cad_depth import load
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.StlAPI import StlAPI_Writer

    mi.set_variant("llvm_ad_rgb")
    shape = load(path)
    box = Bnd_Box()
    BRepBndLib.Add_s(shape, box, False)
    a, b = box.CornerMin(), box.CornerMax()
    BRepMesh_IncrementalMesh(shape, CHORD * a.Distance(b), False, 0.5, False)
    # a binary STL file is the quickest way from OpenCASCADE's triangles to an array
    out = Path(os.environ["HOME"]) / "mesh.stl"
    writer = StlAPI_Writer()
    writer.ASCIIMode = False
    writer.Write(shape, str(out))
    record = np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("rest", "<u2")])
    points = np.fromfile(out, record, offset=84)["points"].reshape(-1, 3)
    triangles = mi.Mesh("mesh", len(points), len(points) // 3)
    parameters = mi.traverse(triangles)
    parameters["vertex_positions"] = points.ravel()
    parameters["faces"] = np.arange(len(points), dtype=np.uint32)
    parameters.update()
    render(triangles, points.min(axis=0), points.max(axis=0), size)
    print(f", {len(points) // 3} triangles", end="")


def measure(side: str, path: Path, size: int, limit: int) -> tuple[float, float, str]:
    """Return processor and wall time of a fresh process, and what it says."""
    with tempfile.TemporaryDirectory() as home:
        command = [sys.executable, __file__, str(path), "--side", side, "--size", str(size)]
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()

        def limits() -> None:
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))

        done = subprocess.run(
            command,
            env={**os.environ, "HOME": home},
            capture_output=True,
            text=True,
            preexec_fn=limits,
        )
        after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic() - start
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    said = done.stdout.strip().splitlines()[-1:] or [""]
    if done.returncode:
        said = [f"failed: {(done.stderr.strip().splitlines() or ['no word'])[-1][:60]}"]
    return seconds, wall, said[0]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=256, help="pixels along a side")
    parser.add_argument("--rounds", type=int, default=1, help="the least time of so many")
    parser.add_argument("--limit", type=int, default=600, help="seconds of the processor a side")
    parser.add_argument("--only", choices=("ours", "mesh"), help="one of the sides")
    parser.add_argument("--side", choices=("ours", "mesh"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.side:
        (ours if args.side == "ours" else mesh)(args.files[0], args.size)
        return
    sides = [args.only] if args.only else ["ours", "mesh"]
    print("| file |", " | ".join(f"{s}, s | what" for s in sides), "| ratio |")
    print("| --- |", " | ".join("--- | ---" for _ in sides), "| --- |")
    for path in args.files:
        cells, least = [], {}
        for side in sides:
            if side == "mesh" and path.suffix.lower() == ".3dm":
                cells.append("no reader | ")
                continue
            times = [measure(side, path, args.size, args.limit) for _ in range(args.rounds)]
            seconds, wall, said = min(times)
            least[side] = seconds
            cells.append(f"{seconds:.2f} ({wall:.1f}) | {said}")
        ratio = f"{least['ours'] / least['mesh']:.2f}" if len(least) == 2 else ""
        print(f"| {path.name} |", " | ".join(cells), f"| {ratio} |", flush=True)


if __name__ == "__main__":
    main()
