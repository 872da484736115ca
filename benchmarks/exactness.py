"""What exactness costs: patches beside their tessellations, by error, time and memory.

    python benchmarks/exactness.py [--surfaces sphere torus teapot part] [--chords 1e-2 ... 1e-7]
        [--plots FOLDER] [--json FILE]

The sphere (eight quartics), a torus, the teapot and the valve body of ``scenes/make_cad.py`` (extra
``[cad]``) fill the frame of a camera. Each is traced as patches, and as meshes whose chords are
off by at most 1e-2 to 1e-7 of its size, with normals of the surface at their vertices. Meshes of
patches cut all patches alike; those of the part are OpenCASCADE's. Four errors, against float64:

* *silhouette*: the area between the outline that is seen and the right one, by its length: rays
  that hit one surface and not the other, counted;
* *depth*: of rays that hit both, the root of the mean square;
* *normal*: the angle between the normal that shading gets and the right one, the same;
* *caustic*: how far apart light lands that a mirror sends on, one size of the surface away; the
  median, since at the outline all directions are to be had.

All lengths are in units of the size. The float64 answers of sphere and torus are closed forms.
Those of teapot and part are Newton's method on the patch that the kernels hit, so that their
silhouettes are compared with ours: that ours are right is what ``accuracy.py`` and
``cad_bodies.py`` show. Time is that of the processor for a ray, coherent and random, the least of
`--runs`. Memory is that of the arrays of patches and their leaves; of a mesh, what a process keeps
for it beyond what it had before. Each case is a process of its own, ended after `--limit` seconds
of the processor; meshes of more than 25 million triangles are not made.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit, for which it finds LLVM

sys.path.insert(0, str(Path(__file__).parent))  # for a caller that is not in this folder

import drjit as dr
import mitsuba as mi
import numpy as np
from common import camera_rays, machine, random_rays, set_variant, to_mesh, to_rays
from speed_surfaces import bezier_shape, patches_of
from tqdm import tqdm

from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.oracles import analytic
from mitsuba_bezier.plugins.scene_data import data_for_scene

#: Size of each surface: the width of the frame that it fills.
SIZE = 2.4
SURFACES = ("sphere", "torus", "teapot", "part")
ERRORS = ("silhouette", "depth", "normal", "caustic")
#: More triangles are not made: a mesh of so many takes some 6 GB.
MOST = 25_000_000


# ---------------------------------------------------------------------- surfaces


def part() -> Any:
    """Return the valve body as an OpenCASCADE shape that fills the frame."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "scenes"))
    from cad_bodies import box_of
    from make_cad import cad_part
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.gp import gp_Pnt, gp_Trsf, gp_Vec

    shape = cad_part()
    low, high = box_of(shape)
    shift, scale = gp_Trsf(), gp_Trsf()
    shift.SetTranslation(gp_Vec(*(-(low + high) / 2).tolist()))
    scale.SetScale(gp_Pnt(0, 0, 0), SIZE / float((high - low).max()))
    return BRepBuilderAPI_Transform(shape, scale.Multiplied(shift), True).Shape()


def shape_of(surface: str, step: Path) -> dict[str, Any]:
    """Return the dictionary of the exact shape."""
    if surface == "part":
        return {"type": "beziertriangle", "filename": str(step)}
    return bezier_shape(patches_of({"sphere": "sphere, octants"}.get(surface, surface)))


def cuts(patches: mb.BezierTriangles, chord: float) -> int:
    """Return into how many parts each edge is cut so that chords are off by `chord` of the size.

    Measured at 16 parts, by the distance of edges' and triangles' middles from the plane of their
    triangle; it falls with the square of the number.
    """
    n = 16
    at = bernstein.multi_indices(n)[:, :2] / n
    index = {tuple(x): r for r, x in enumerate(np.rint(at * n).astype(int).tolist())}
    faces = np.array(
        [
            (index[i, j], index[i + 1, j], index[i, j + 1])
            for i, j, _k in bernstein.multi_indices(n - 1).tolist()
        ]
    )
    corners = at[faces]
    middles = np.stack(
        [
            corners.mean(axis=1),
            *[(corners[:, a] + corners[:, b]) / 2 for a, b in ((0, 1), (1, 2), (2, 0))],
        ]
    )

    def points(uv: np.ndarray) -> np.ndarray:
        flat = uv.reshape(-1, 2)
        which = np.repeat(np.arange(len(patches)), len(flat))
        got = patches.points(which, np.tile(flat, (len(patches), 1)))
        return got.reshape(len(patches), *uv.shape[:-1], 3)

    p, m = points(corners), points(middles)
    normal = np.cross(p[:, :, 1] - p[:, :, 0], p[:, :, 2] - p[:, :, 0])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal /= np.where(length > 0, length, 1)
    off = np.abs(np.einsum("pktc,ptc->pkt", m - p[:, None, :, 0], normal)).max() / SIZE
    return max(1, int(np.ceil(n * np.sqrt(off / chord))))


def mesh_arrays(surface: str, chord: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return vertices, faces and normals of a tessellation; None if they are too many."""
    if surface == "part":
        return _opencascade(part(), chord * SIZE)
    patches = patches_of({"sphere": "sphere, octants"}.get(surface, surface))
    n = cuts(patches, chord)
    if len(patches) * n * n > MOST:
        return None
    vertices, faces = patches.tessellate(n)
    uv = bernstein.multi_indices(n)[:, :2] / n
    normals = [patches.normals(np.full(len(uv), k), uv) for k in range(len(patches))]
    return vertices, faces, np.concatenate(normals)


def _opencascade(shape: Any, chord: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return OpenCASCADE's mesh of a shape, at 0.5 radian, its default, with its normals."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepLib import BRepLib_ToolTriangulatedShape
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS

    as_face = getattr(TopoDS, "Face_s", None) or TopoDS.Face
    BRepMesh_IncrementalMesh(shape, chord, False, 0.5, True)
    vertices, normals, faces, count = [], [], [], 0
    explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
    while explorer.More():
        face = as_face(explorer.Current())
        triangles = BRep_Tool.Triangulation_s(face, TopLoc_Location())
        BRepLib_ToolTriangulatedShape.ComputeNormals_s(face, triangles)
        turned = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
        for k in range(1, triangles.NbNodes() + 1):
            p, n = triangles.Node(k), triangles.Normal(k)
            vertices.append((p.X(), p.Y(), p.Z()))
            normals.append((n.X(), n.Y(), n.Z()))
        for k in range(1, triangles.NbTriangles() + 1):
            a, b, c = triangles.Triangle(k).Get()
            faces.append((count + a - 1, count + b - 1, count + c - 1)[:: -1 if turned else 1])
        count += triangles.NbNodes()
        explorer.Next()
    return np.array(vertices), np.array(faces), np.array(normals)


# ---------------------------------------------------------------------- one case


def resident() -> int:
    """Return the memory of this process, in bytes (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def least(task: Any, runs: int) -> float:
    """Return the least processor time of a task, after two runs that are not counted."""
    start = time.perf_counter()
    for _ in range(2):
        dr.eval(task())
        dr.sync_thread()
        first, start = time.perf_counter() - start, time.perf_counter()
    # processor time comes in ticks of 4 ms on some systems: a run takes a quarter of a second
    repeats = max(1, int(np.ceil(0.25 / first)))
    times = []
    for _ in range(runs):
        start = time.process_time()
        for _repeat in range(repeats):
            dr.eval(task())
            dr.sync_thread()
        times.append((time.process_time() - start) / repeats)
    return min(times)


def case(options: argparse.Namespace) -> dict[str, Any] | None:
    """Trace one surface once as patches, or as a mesh; write depths and normals to files."""
    surface, side = options.surfaces[0], options.side_of_rays
    rays = {"coherent": camera_rays(side), "random": random_rays(side * side)}
    queries = {name: to_rays(*pair) for name, pair in rays.items()}

    def trace(scene: Any) -> Any:
        si = scene.ray_intersect(queries["coherent"])
        dr.eval(si.t, si.sh_frame.n)
        return si

    if options.side == "patches":
        made: Any = shape_of(surface, options.step)
        start = time.process_time()
        scene = mi.load_dict({"type": "scene", "shape": made})
        data = data_for_scene(scene)
        memory = data.bytes + data.shapes[0].patches.control_points.size * 4
        build = time.process_time() - start
        si = trace(scene)
    else:
        arrays = mesh_arrays(surface, float(options.side))
        if arrays is None:
            return None
        # what kernels and packages take is not the scene's
        tiny = to_mesh(np.eye(3), np.array([[0, 1, 2]]), np.eye(3))
        trace(mi.load_dict({"type": "scene", "shape": tiny}))
        dr.sync_thread()
        before, start = resident(), time.process_time()
        scene = mi.load_dict({"type": "scene", "shape": to_mesh(*arrays)})
        build = time.process_time() - start
        si = trace(scene)
        dr.sync_thread()
        memory = max(0, resident() - before)
    np.save(options.out / "t.npy", np.array(si.t))
    np.save(options.out / "n.npy", np.array(si.sh_frame.n).T)
    row: dict[str, Any] = {"build": build, "memory": memory}
    for name, query in queries.items():
        pi = least(lambda query=query: scene.ray_intersect_preliminary(query).t, options.runs)
        row[name] = pi / side**2
    if options.side == "patches":
        row["patches"] = len(scene.shapes()[0].patches)
        pi = scene.ray_intersect_preliminary(queries["coherent"])
        for name, value in (("patch", pi.prim_index), ("uv", pi.prim_uv)):
            np.save(options.out / f"{name}.npy", np.array(value).T)
        np.save(options.out / "net.npy", scene.shapes()[0].patches.control_points)
    else:
        row["triangles"] = len(arrays[1])
    return row


# ---------------------------------------------------------------------- errors


def right_answers(
    surface: str, out: Path, o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return float64 distances, infinite for a miss, and unit normals, of the camera's rays."""
    o, d = o.astype(float), d.astype(float)
    if surface == "sphere":
        hits = analytic.sphere([0, 0, 0], 1.0, o, d)
    elif surface == "torus":
        hits = analytic.torus([0, 0, 0], [0, 0, 1], 0.96, 0.24, o, d)
    else:
        return _polished(out, o, d)
    ahead = np.where(hits.t > 0, hits.t, np.inf)
    first = ahead.argmin(axis=1)
    every = np.arange(len(o))
    return ahead[every, first], hits.normals[every, first]


def _polished(out: Path, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances and normals by Newton's method in float64 from the kernels' hits."""
    patches = mb.BezierTriangles(np.load(out / "net.npy"))
    t = np.load(out / "t.npy").astype(float)
    patch, uv = np.load(out / "patch.npy"), np.load(out / "uv.npy").astype(float)
    hit = np.isfinite(t)
    o, d, s, patch, uv = o[hit], d[hit], t[hit], patch[hit], uv[hit]
    for _ in range(4):
        at = patches.differential(patch, uv)
        matrix = np.stack([at.dp_du, at.dp_dv, -d], axis=-1)
        step = np.linalg.solve(matrix, (o + s[:, None] * d - at.p)[..., None])[..., 0]
        uv, s = uv + step[:, :2], s + step[:, 2]
    t[hit] = s
    normals = np.zeros((len(t), 3))
    normals[hit] = patches.normals(patch, uv)
    return t, normals


def errors(
    t: np.ndarray, n: np.ndarray, right: tuple[np.ndarray, np.ndarray], o: np.ndarray, d: np.ndarray
) -> dict[str, float]:
    """Return the four errors; normals may point to either side."""
    wanted, normals = right
    side = int(np.sqrt(len(t)))
    seen, hit = np.isfinite(t), np.isfinite(wanted)
    # the camera's frame is 0.8 wide one unit away, and the surface as far as the camera
    pixel = 0.8 / side * float(np.linalg.norm(o[0]))
    inside = hit.reshape(side, side)
    # steps of an outline in a grid are 4 / pi times its length, over all directions
    steps = (inside[1:] != inside[:-1]).sum() + (inside[:, 1:] != inside[:, :-1]).sum()
    both = seen & hit
    t, wanted, a, b = t[both].astype(float), wanted[both], n[both].astype(float), normals[both]
    o, d = o[both].astype(float), d[both].astype(float)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", a, b)
    b = b * np.sign(np.where(cosine == 0, 1, cosine))[:, None]
    # rays that see different parts of a surface say nothing about its depth: they are outlines
    same = np.abs(t - wanted) < 0.02 * SIZE
    chord = np.linalg.norm(a - b, axis=1)
    angle = 2 * np.arcsin(np.minimum(chord / 2, 1))

    def lands(s: np.ndarray, m: np.ndarray) -> np.ndarray:
        sent = d - 2 * np.einsum("ij,ij->i", d, m)[:, None] * m
        return o + s[:, None] * d + SIZE * sent / np.linalg.norm(sent, axis=1, keepdims=True)

    apart = np.linalg.norm(lands(t, a) - lands(wanted, b), axis=1)
    return {
        "silhouette": float((seen != hit).sum() * pixel / (steps * np.pi / 4) / SIZE),
        "depth": float(np.sqrt(np.mean((t - wanted)[same] ** 2)) / SIZE),
        "normal": float(np.sqrt(np.mean(angle[same] ** 2))),
        "caustic": float(np.median(apart[same]) / SIZE),
    }


def measure(surface: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of a surface: patches, then meshes."""
    rows: list[dict[str, Any]] = []
    o, d = camera_rays(options.side_of_rays)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        step = out / "part.step"
        if surface == "part":
            from cad_bodies import write

            write(part(), step)
        right = None
        for name in tqdm(["patches", *map(str, options.chords)], desc=surface, leave=False):
            command = [sys.executable, __file__, "--surfaces", surface, "--side", name]
            command += ["--out", str(out), "--step", str(step), "--runs", str(options.runs)]
            command += ["--million", str(options.million), "--variant", options.variant]

            def limits() -> None:
                resource.setrlimit(resource.RLIMIT_CPU, (options.limit, options.limit))

            done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limits)
            if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
                print(f"{surface}, {name}: more than {options.limit} s", file=sys.stderr)
                continue
            if done.returncode:
                raise SystemExit(f"{surface}, {name} failed:\n{done.stderr}")
            row = json.loads(done.stdout.splitlines()[-1])
            if row is None:  # too many triangles
                continue
            if right is None:
                right = right_answers(surface, out, o, d)
            row |= errors(np.load(out / "t.npy"), np.load(out / "n.npy"), right, o, d)
            rows.append({"surface": surface, "side": name, **row})
    return rows


# ---------------------------------------------------------------------- what is shown


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table as Markdown."""
    titles = ["surface", "as", "triangles", "build, s", "MB", "ns, coherent", "ns, random", *ERRORS]
    lines = ["| " + " | ".join(titles) + " |", "| --- | --- |" + " ---: |" * (len(titles) - 2)]
    for row in rows:
        exact = row["side"] == "patches"
        cells = [row["surface"], f"{row['patches']} patches" if exact else f"mesh, {row['side']}"]
        cells += ["" if exact else f"{row['triangles']}", f"{row['build']:.2f}"]
        cells += [f"{row['memory'] / 1e6:.1f}"]
        cells += [f"{row[k] * 1e9:.0f}" for k in ("coherent", "random")]
        cells += [f"{row[k]:.1e}" if row[k] > 0 else "none seen" for k in ERRORS]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def plot(surface: str, rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the four errors of one surface against time and memory."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.fonttype"] = "none"  # letters, not their outlines
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 4, figsize=(16, 7.6), sharey="col", layout="constrained")
    meshes = [row for row in rows if row["side"] != "patches"]
    (exact,) = (row for row in rows if row["side"] == "patches")
    costs = (
        ("random", 1e9, "processor time of a random ray, ns"),
        ("memory", 1e-6, "memory of the scene, MB"),
    )
    for line, (key, scale, label) in zip(axes, costs):
        for axis, error in zip(line, ERRORS):
            xy = np.array([(row[key] * scale, row[error]) for row in meshes])
            seen = xy[:, 1] > 0
            axis.plot(*xy[seen].T, "o-", color="#6b7280", label="meshes")
            for row, (x, y) in zip(meshes, xy):
                if y > 0:
                    text = f"{row['triangles']:,}".replace(",", "\u2009")
                    axis.annotate(
                        text,
                        (x, y),
                        (5, 4),
                        textcoords="offset points",
                        fontsize=7,
                        color="#6b7280",
                    )
            x, y = exact[key] * scale, exact[error]
            if y > 0:
                axis.plot(x, y, "*", ms=15, color="#c2410c", label="patches")
            else:  # below what the rays can tell
                axis.axvline(x, color="#c2410c", label="patches: none seen")
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.grid(True, which="major", alpha=0.3)
            axis.set_xlabel(label)
            unit = "radian" if error == "normal" else "sizes"
            axis.set_title(f"{error}, {unit}", fontsize=11)
            axis.legend(fontsize=8)
    figure.suptitle(f"{surface}: error of patches and of meshes, by time and memory")
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print the table, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--surfaces", nargs="+", choices=SURFACES, default=list(SURFACES))
    chords = [10.0**-k for k in range(2, 8)]
    parser.add_argument("--chords", nargs="+", type=float, default=chords)
    parser.add_argument("--million", type=float, default=1.0, help="rays, in millions (1)")
    parser.add_argument("--runs", type=int, default=3, help="repetitions (3)")
    parser.add_argument("--limit", type=int, default=300, help="seconds for a case (300)")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb)")
    parser.add_argument("--plots", type=Path, help="a folder for one drawing a surface")
    parser.add_argument("--json", type=Path, help="write the numbers to a file, too")
    parser.add_argument("--side", help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--step", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    options.side_of_rays = max(8, int(np.sqrt(options.million * 1e6)) // 8 * 8)
    set_variant(options.variant)
    if options.side:
        print(json.dumps(case(options)))
        return
    rows = [row for surface in options.surfaces for row in measure(surface, options)]
    print(table(rows))
    if options.plots:
        options.plots.mkdir(parents=True, exist_ok=True)
        for surface in options.surfaces:
            own = [row for row in rows if row["surface"] == surface]
            plot(surface, own, options.plots / f"exactness-{surface}.svg")
    if options.json:
        text = json.dumps({"machine": machine(), "rows": rows}, indent=1)
        write_file(options.json, text.encode())


if __name__ == "__main__":
    main()
