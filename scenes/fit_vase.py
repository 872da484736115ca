"""Find a vase from ten photographs of it, by patches and by a mesh of as many unknowns.

    python scenes/fit_vase.py [--steps 200] [--side 64] [--out renders]
    python scenes/fit_vase.py --refine --steps 120

The photographs are renders of a vase of revolution, squeezed to one side. Both searches begin at
the same cylinder, see the same photographs in the same order, and take steps of Adam with the
Laplacian of their net as preconditioner: 32 rational cubic triangles by `fit.Net`, whose outlines
`bezier_direct_projective` differentiates, and a mesh whose vertices have as many coordinates as the
patches have unknowns, by Mitsuba's `direct_projective`.

Writes ``fit_vase.jpg`` (rows: photographs, patches, mesh) and ``fit_vase.svg`` (distance from the
true surface by processor time), and prints what was found. A search that was stopped goes on from
``--keep``.

With ``--refine`` patches are compared with patches: eight, split into 32 after a third of the steps
and raised to degree 4 after two, and the same net of degree 4 from the start. Writes
``fit_refine.svg`` alone.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # first: it chooses LLVM before Dr.Jit does

import mitsuba as mi  # isort: skip
import numpy as np

from mitsuba_bezier import fit
from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry.tensor import revolved

VIEWS = 10
HEIGHTS = np.linspace(-1.0, 1.0, 5)


def target() -> mb.BezierTriangles:
    """Return the vase: three cubic pieces of a profile around the axis, squeezed."""
    radii = [0.42, 0.62, 0.8, 0.8, 0.8, 0.3, 0.28, 0.26, 0.42, 0.5]
    heights = [-1.0, -0.8, -0.55, -0.3, -0.05, 0.2, 0.5, 0.8, 0.85, 1.0]
    profile = np.column_stack([radii, heights, np.ones(10)])
    parts = []
    for first in (0, 3, 6):
        parts += [mb.tensor_to_triangles(net) for net in revolved(profile[first : first + 4])]
    squeeze = np.diag([1.0, 0.8, 1.0, 1.0])
    squeeze[0, 2] = 0.12  # and leaning
    return mb.BezierTriangles.join(parts).transform(squeeze)


def start(heights: Any = HEIGHTS) -> mb.BezierTriangles:
    """Return a cylinder of rational cubic triangles, eight between two heights."""
    parts = []
    for low, high in pairwise(heights):
        parts += [mb.tensor_to_triangles(net) for net in revolved([[0.5, low, 1], [0.5, high, 1]])]
    return mb.BezierTriangles.join(parts)


def start_mesh(unknowns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the same cylinder as a mesh whose coordinates are about as many."""
    around = max(8, round(np.sqrt(unknowns / 3 * 1.6)))
    rows = max(3, round(unknowns / 3 / around))
    angle = 2 * np.pi * np.arange(around) / around
    points = [
        [0.5 * np.cos(a), 0.5 * np.sin(a), z] for z in np.linspace(-1, 1, rows) for a in angle
    ]
    faces = []
    for r in range(rows - 1):
        for a in range(around):
            i, j = r * around + a, r * around + (a + 1) % around
            faces += [[i, j, i + around], [j, j + around, i + around]]
    return np.array(points), np.array(faces)


class Vertices(fit.Parametrization):
    """The vertices of a mesh, with the Laplacian of its edges."""

    def __init__(self, points: np.ndarray, faces: np.ndarray) -> None:
        self.points, self.faces = points, faces

    def start(self) -> dict[str, np.ndarray]:
        return {"points": self.points}

    def scales(self) -> dict[str, float]:
        return {"points": 2.0}  # its height, as `fit.Net` takes it

    def value(self, unknowns: Any) -> Any:
        return unknowns["points"] + 0

    def laplacian(self, name: str) -> Any:
        from scipy.sparse import coo_array

        a, b = np.concatenate([self.faces[:, [i, (i + 1) % 3]] for i in range(3)]).T
        graph = coo_array((np.ones(len(a)), (a, b)), shape=[len(self.points)] * 2).tocsr()
        graph = ((graph + graph.T) > 0).astype(float)
        out = -graph
        out.setdiag(graph.sum(axis=1))
        return out.tocsc()


def scene_of(shape: Any, side: int) -> Any:
    """Return the scene: the surface under a sky, seen by ten cameras around it."""
    cameras = {}
    for i in range(VIEWS):
        angle = 2 * np.pi * i / VIEWS
        eye = [4 * np.cos(angle), 4 * np.sin(angle), 1.1 if i % 2 else -0.4]
        cameras[f"camera{i:02d}"] = {
            "type": "perspective",
            "fov": 36,
            "to_world": mi.ScalarTransform4f().look_at(eye, [0, 0, 0], [0, 0, 1]),
            "film": {
                "type": "hdrfilm",
                "width": side,
                "height": side,
                "rfilter": {"type": "box"},
                "sample_border": False,
                "pixel_format": "rgb",
            },
        }
    lamps = {
        f"lamp{i}": {"type": "point", "position": p, "intensity": {"type": "rgb", "value": c}}
        for i, (p, c) in enumerate(
            [([3, 3, 4], [22, 18, 14]), ([-4, 1, 2], [8, 12, 18]), ([0, -4, -1], [12, 10, 8])]
        )
    }
    return mi.load_dict({"type": "scene", **cameras, **lamps, "vase": shape})


def bsdf() -> dict[str, Any]:
    colour = {"type": "rgb", "value": [0.75, 0.7, 0.6]}
    return {"type": "twosided", "one": {"type": "diffuse", "reflectance": colour}}


def distance(points: np.ndarray, tree: Any) -> float:
    """Return the root of the mean square distance of points from dense samples of the target."""
    return float(np.sqrt(np.mean(tree.query(points)[0] ** 2)))


def samples(patches: mb.BezierTriangles, count: int) -> np.ndarray:
    """Return points of patches, spread over their parameters by area."""
    rng = np.random.default_rng(0)
    area = patches.area(1e-3)
    patch = rng.choice(len(patches), size=count, p=area / area.sum())
    return patches.points(patch, rng.dirichlet([1, 1, 1], count)[:, :2])


def mesh_samples(points: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Return points of a mesh, spread evenly."""
    rng = np.random.default_rng(0)
    a, b, c = (points[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(faces), size=count, p=area / area.sum())
    u = rng.dirichlet([1, 1, 1], count)
    return u[:, :1] * a[face] + u[:, 1:2] * b[face] + u[:, 2:] * c[face]


def search(
    name: str,
    scene: Any,
    key: str,
    item: Any,
    integrator: str,
    options: Any,
    measure: Any,
    refine: dict[int, str] | None = None,
) -> tuple[fit.Fit, list[tuple[float, float]]]:
    """Return what was found, and the distance by seconds of processor time."""
    params = mi.traverse(scene)
    began, measured = time.process_time(), 0.0
    curve: list[tuple[float, float]] = []

    def look(step: int, loss: float) -> None:
        nonlocal measured
        if step != 1 and step % 5:
            return
        begin = time.process_time()
        off = measure(np.array(params[key], dtype=np.float64))
        curve.append((begin - began - measured, off))
        measured += time.process_time() - begin
        print(f"{name}: step {step}, loss {loss:.2e}, distance {off:.4f}", flush=True)

    found = fit.minimize(
        scene,
        {key: item},
        options.photographs,
        integrator={"type": integrator, "sppi": 0},
        spp=options.spp,
        views=2,
        steps=options.steps,
        rate=options.rate,
        smoothing=options.smoothing,
        refine=refine,
        checkpoint=None if options.keep is None else options.keep / f"vase_{name}.fit",
        callback=look,
        progress=False,
    )
    return found, curve


def coarse_to_fine(options: Any, measure: Any) -> None:
    """Compare nets that grow during the search with one that is fine from its start."""
    coarse = start([-1.0, 1.0])
    fine = coarse.split().elevate()
    third = options.steps // 3
    curves, counts = {}, {}
    for name, patches, refine in (
        ("coarse to fine", coarse, {third: "split", 2 * third: "elevate"}),
        ("fine from the start", fine, None),
    ):
        scene = scene_of(mb.shape(patches, bsdf=bsdf()), options.side)
        item = fit.Net(patches)
        found, curves[name] = search(
            name,
            scene,
            "vase.control_points",
            item,
            "bezier_direct_projective",
            options,
            measure,
            refine,
        )
        counts[name] = sum(v.size for v in found.unknowns["vase.control_points"].values())
        told = [f"{curves[name][i][1]:.4f}" for i in range(0, len(curves[name]), 4)]
        print(f"{name}: {counts[name]} unknowns at the end, distances {', '.join(told)}")
    write_file(options.out / "fit_refine.svg", draw(curves, counts), make_folders=True)


def draw(curves: dict[str, list[tuple[float, float]]], counts: dict[str, int]) -> bytes:
    """Return the plot of distances by time, as SVG."""
    import io

    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for (name, curve), style in zip(curves.items(), ("-", "--")):
        seconds, off = np.array(curve).T
        axes.plot(seconds, off, style, color="#222", label=f"{name}, {counts[name]} unknowns")
    axes.set(
        yscale="log",
        xlabel="seconds of processor time",
        ylabel="distance from the vase (its height is 2)",
    )
    axes.grid(True, which="both", color="#ddd")
    axes.legend()
    out = io.BytesIO()
    figure.savefig(out, format="svg")
    plt.close(figure)
    return out.getvalue()


def pictures(shapes: dict[str, Any], side: int) -> np.ndarray:
    """Return three views of each surface, a surface a row, in 8 bits."""
    exact = mi.load_dict({"type": "bezierpath", "max_depth": 3})
    rows = []
    for shape in shapes.values():
        scene = scene_of(shape, side)
        row = [mi.render(scene, integrator=exact, sensor=i, spp=64) for i in (1, 4, 8)]
        rows.append(np.concatenate([np.array(image)[..., :3] for image in row], axis=1))
    image = mi.Bitmap(np.concatenate(rows).astype(np.float32))
    return np.array(image.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True))


def labelled(pixels: np.ndarray, names: list[str]) -> bytes:
    """Return rows of pictures with a name on each, as a JPEG file."""
    import io

    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    height, width = pixels.shape[:2]
    drawn = plt.figure(figsize=(width / 100, height / 100), dpi=100)
    axes = drawn.add_axes((0, 0, 1, 1))
    axes.imshow(pixels)
    axes.axis("off")
    for row, name in enumerate(names):
        place = (0.01 * width, (row + 0.03) * height / len(names))
        axes.text(*place, name, color="white", fontsize=width / 80, va="top")
    out = io.BytesIO()
    drawn.savefig(out, format="jpg", pil_kwargs={"quality": 85})
    plt.close(drawn)
    return out.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--side", type=int, default=64, help="pixels of a photograph")
    parser.add_argument("--shown", type=int, default=533, help="pixels of a picture that is shown")
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--rate", type=float, default=0.06)
    parser.add_argument("--smoothing", type=float, default=4.0)
    parser.add_argument("--refine", action="store_true", help="compare coarse to fine")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--keep", type=Path, help="folder of checkpoints")
    parser.add_argument("--out", type=Path, default=Path("renders"))
    options = parser.parse_args()
    mi.set_variant(options.variant)
    from scipy.spatial import cKDTree

    truth = target()
    tree = cKDTree(samples(truth, 200_000))
    exact = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    original = scene_of(mb.shape(truth, bsdf=bsdf()), options.side)
    options.photographs = [
        mi.render(original, integrator=exact, sensor=i, spp=16 * options.spp, seed=1000 + i)
        for i in range(VIEWS)
    ]

    def patches_off(net: Any) -> float:
        return distance(samples(mb.BezierTriangles(net), 20_000), tree)

    if options.refine:
        coarse_to_fine(options, patches_off)
        return
    item = fit.Net(start())
    unknowns = sum(v.size for v in item.start().values())
    patches = scene_of(mb.shape(start(), bsdf=bsdf()), options.side)
    found, curve = search(
        "patches",
        patches,
        "vase.control_points",
        item,
        "bezier_direct_projective",
        options,
        patches_off,
    )
    points, faces = start_mesh(unknowns)
    mesh = mi.Mesh("vase", len(points), len(faces), props=_material())
    shape = mi.traverse(mesh)
    shape["vertex_positions"] = mi.Float(points.ravel())
    shape["faces"] = mi.UInt32(faces.ravel())
    shape.update()
    meshes = scene_of(mesh, options.side)
    other, mesh_curve = search(
        "mesh",
        meshes,
        "vase.vertex_positions",
        Vertices(points, faces),
        "direct_projective",
        options,
        lambda p: distance(mesh_samples(p.reshape(-1, 3), faces, 20_000), tree),
    )
    counts = {"patches": unknowns, "mesh": points.size}
    for name, result, line in (("patches", found, curve), ("mesh", other, mesh_curve)):
        print(
            f"{name}: {counts[name]} unknowns, {result.seconds:.0f} s, {result.halved} halved, "
            f"distance {line[0][1]:.4f} -> {line[-1][1]:.4f}"
        )
    write_file(
        options.out / "fit_vase.svg",
        draw({"patches": curve, "mesh": mesh_curve}, counts),
        make_folders=True,
    )
    found_shape = mb.shape(found.patches("vase.control_points"), bsdf=bsdf())
    shapes = {"photographs": mb.shape(truth, bsdf=bsdf()), "patches": found_shape, "mesh": mesh}
    shown = pictures(shapes, options.shown)
    write_file(
        options.out / "fit_vase.jpg",
        labelled(shown, ["the vase", "found: patches", "found: a mesh of as many unknowns"]),
    )


def _material() -> Any:
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf())
    return props


if __name__ == "__main__":
    main()
