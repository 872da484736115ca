"""Render scenes of the lecture and draw over them, by the same camera.

    python docs/figures/overlays.py [NAME ...] [--spp 32] [--keep FOLDER]

Needs the extras ``figures`` and ``denoise``: what is shown here is denoised, the references in
`renders/` are not.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier import _loading, figures
from mitsuba_bezier._files import write_file
from mitsuba_bezier.cli.main import main as command
from mitsuba_bezier.geometry.camera import look_at
from mitsuba_bezier.geometry.projective import affine

HERE = Path(__file__).resolve().parent
SCENES = HERE.parents[1] / "scenes"
SIZE = (1600, 900)

sys.path.insert(0, str(SCENES))


#: Folder of renders, which are read if they are there; None: none is kept.
KEPT: Path | None = None


def rendered(scene: Any, name: str, spp: int) -> tuple[np.ndarray, mb.Camera]:
    """Return a picture as bytes, and the camera of the scene's first sensor."""
    own = scene.sensors()[0]
    camera = mb.Camera.from_parameters(mi.traverse(own))
    path = KEPT / f"{name}.exr" if KEPT else None
    if path is not None and path.exists():
        bitmap = mi.Bitmap(str(path))
    else:
        bitmap = mi.Bitmap(mi.render(scene, sensor=own, spp=spp, seed=0))
        if path is not None:
            bitmap.write(str(path))
    return as_bytes(bitmap), camera


def as_bytes(bitmap: Any) -> np.ndarray:
    """Return a picture with sRGB's curve, as bytes."""
    byte = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True)
    return np.array(byte)


def from_file(
    name: str, spp: int, size: tuple[int, int] = SIZE
) -> tuple[np.ndarray, mb.Camera, Any]:
    """Return a denoised picture of a scene of the lecture, its camera, and the scene."""
    values = {"width": str(size[0]), "height": str(size[1])}
    scene = _loading.load_file(mi, SCENES / f"{name}.xml", values)
    camera = mb.Camera.from_parameters(mi.traverse(scene.sensors()[0]))
    with tempfile.TemporaryDirectory() as own:
        folder = KEPT or Path(own)
        path = folder / f"{name}.denoised.exr"
        if not path.exists():
            words = [w for key, v in values.items() for w in ("-D", f"{key}={v}")]
            words += ["--spp", str(spp), "--denoise", "-o", str(folder / f"{name}.exr")]
            if command(["render", "-q", str(SCENES / f"{name}.xml"), *words]):
                raise SystemExit(f"{name}: not rendered")
        return as_bytes(mi.Bitmap(str(path))), camera, scene


def note(d: figures.Drawing, text: str, at: Any, offset: tuple[float, float]) -> None:
    """Write a text in a box, with a line to the place that it names."""
    d.axes.annotate(
        text, d.place(np.asarray(at, dtype=float)), offset, textcoords="offset points",
        fontsize=13.5, zorder=9, ha="right" if offset[0] < -9 else "left" if offset[0] > 9 else
        "center", va="bottom" if offset[1] > 0 else "top",
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": "0.4", "lw": 0.8},
        arrowprops={"arrowstyle": "-", "lw": 1.2, "color": "0.1"},
    )  # fmt: skip


def named(d: figures.Drawing, scene: Any, names: dict[str, str], above: float) -> None:
    """Write what shapes of a scene are: over those that reach behind y = `above`, else under."""
    for shape in scene.shapes():
        if shape.id() in names:
            low, high = (np.array(x) for x in (shape.bbox().min, shape.bbox().max))
            x = (low[0] + high[0]) / 2
            if high[1] > above:
                place, offset = d.place([x, (low[1] + high[1]) / 2, high[2]]), 7.0
            else:
                place, offset = d.place([x, low[1], low[2]]), -5.0
            d._write(place, names[shape.id()], (0, offset), fontsize=11.0)


def railroad(spp: int) -> figures.Drawing:
    """Return the railroad with the vanishing point V of its parallels, and the horizon."""
    import make_lecture

    picture, camera, _scene = from_file("railroad", spp)
    d = figures.overlay(picture, camera, fade=0.22)
    rail = np.array([0.0, 1, 0, 0])
    top = make_lecture.BALLAST + make_lecture.SLEEPER + make_lecture.RAIL_HEIGHT
    for x in (-make_lecture.GAUGE / 2, make_lecture.GAUGE / 2):
        d.segment([x, -2.6, top, 1], rail, "tangent", linewidth=1.8)
    v = affine(camera.vanishing_point(rail[:3]))
    ground = camera.horizon([0, 0, 1, 0])
    y = -(ground[2] + ground[0] * v[0]) / ground[1]
    left, right = np.array([0.0, y]), np.array([SIZE[0], y])
    d._stroke([np.stack([left, right])], "ideal", linewidth=2.0)
    d._write(np.array([500.0, y]), "horizon: image of the ideal line", (0, -9), fontsize=12.0)
    d.axes.plot(*v, "o", color="white", markeredgecolor="black", markersize=10, zorder=8)
    d._write(v, "$V$", (10, 12), fontsize=20)
    d.title("All that is parallel to the rails ends in one point, the image of an ideal point.")
    return d


def duerer(spp: int) -> figures.Drawing:
    """Return Dürer's machine with its eye, picture plane, threads and drawing named."""
    import duerer_machine as machine

    picture, camera, _scene = from_file("duerer", spp)
    d = figures.overlay(picture, camera, fade=0.22)
    d.point(machine.EYE, "eye: the centre $S$", (-12, 10), markersize=9.0)
    for text, at, offset in (
        ("picture plane", [0, -0.62, 1.22], (-10, 10)),
        ("drawing: the image", [0, 0.22, 0.62], (50, 46)),
        ("lute: the object", [-0.95, -0.55, 0.35], (-8, -62)),
    ):
        note(d, text, at, offset)
    d.title("Dürer, 1525: threads through a frame are a central projection.")
    return d


def sphere(spp: int) -> figures.Drawing:
    """Return a quadratic triangle on a glassy sphere, with its net, circles and the point S."""
    A = np.diag([1.0, 1, 1, -1])
    s = np.array([-0.7, -np.sqrt(1 - 0.49 - 0.25), 0.5])
    x = np.array([[0.1, -0.95, -0.3], [0.95, -0.2, -0.1], [0.3, -0.35, 0.89]])
    x /= np.linalg.norm(x, axis=1)[:, None]
    net = mb.quadric_patch(A, np.append(s, 1), np.append(x, np.ones((3, 1)), axis=1))
    patch = mb.BezierTriangles(net)
    view = mb.Camera(look_at([2.2, -5.6, 2.0], [0.55, 0, 0.1], [0, 0, 1]), 44, "x", SIZE)
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.62}}
    red = {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": {
        "type": "rgb", "value": [0.55, 0.16, 0.08]}}}  # fmt: skip
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "bezierpath", "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 44, "fov_axis": "x",
                   "to_world": mi.ScalarTransform4f(view.to_world),
                   "film": {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1]}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.75}},
        "lamp": {"type": "directional", "direction": [0.3, 0.8, -1.0],
                 "irradiance": {"type": "rgb", "value": 0.9}},
        "ball": mb.shape(mb.sphere(radius=0.999), bsdf=grey),
        "patch": mb.shape(patch, bsdf=red),
        **mb.net_shapes(patch, 0.007),
        **mb.boundary_curves(patch, 0.008),
    })  # fmt: skip
    picture, camera = rendered(scene, "sphere", spp)
    d = figures.overlay(picture, camera)
    for edge in range(3):
        rows = [(0, 1, 3), (3, 4, 5), (5, 2, 0)][edge]
        rest = mb.BezierCurve(net[list(rows)] * [[1], [-1], [1]])
        d._on_quadric(rest, A, "construction", linewidth=1.6)
    d.quadric_outline(A, "line")
    d.point(s, "$S$", (-12, 10), markersize=9.0)
    names = ("$b_{200}$", "$b_{110}$", "$b_{101}$", "$b_{020}$", "$b_{011}$", "$b_{002}$")
    for row, name in zip(net, names):
        d.label(row[:3] / row[3], name, (9, 8))
    d.title("Rendered: patch, net, boundary. Drawn over it: the circles through $S$, the outline.")
    return d


def weights(spp: int) -> figures.Drawing:
    """Return one net six times, each with another weight of the point with the ball."""
    import make_lecture

    picture, camera, _scene = from_file("weights", spp)
    d = figures.overlay(picture, camera)
    for k, weight in enumerate(make_lecture.WEIGHTS):
        step = make_lecture.WEIGHTS_STEP
        ball = [(k % 3 - 1) * step[0], 0, 1.5 - (k // 3) * step[1], 1]
        d.label(ball, f"$w = {weight:g}$", (13, 0), fontsize=16)
    d.title(
        "One net; the weight $w$ of the point with the ball pulls the patch or pushes it.",
        below=True,
    )
    return d


def developable(spp: int) -> figures.Drawing:
    """Return the developable ribbon with its rulings and its curve of regression named."""
    import make_lecture

    picture, camera, _scene = from_file("developable", spp)
    d = figures.overlay(picture, camera)
    rulings = make_lecture.ribbon_rulings()
    note(d, "curve of regression", make_lecture.REGRESSION.points(0.25), (-60, -14))
    a, b = rulings[1]
    note(d, "ruling: a tangent of the curve", 0.62 * a + 0.38 * b, (24, -45))
    a, b = rulings[0]
    note(d, "ribbon:\none tangent plane\nalong each ruling", 0.2 * a + 0.8 * b, (24, 22))
    d.title("The tangents of a space curve sweep a surface that unrolls into the plane.")
    return d


def paraboloids(spp: int) -> figures.Drawing:
    """Return the quadrics, named, that collineations make of paraboloids and a cylinder."""
    import make_lecture

    picture, camera, scene = from_file("paraboloids", spp)
    d = figures.overlay(picture, camera)
    originals = ("elliptic paraboloid", "hyperbolic paraboloid", "parabolic cylinder")
    names = {}
    for member in make_lecture.paraboloids():
        words = member.name.replace("hyperboloid of ", "hyperboloid\nof ")
        words = words.replace(" paraboloid", "\nparaboloid").replace(" cylinder", "\ncylinder")
        names[member.name.replace(" ", "_")] = words + ("*" if member.name in originals else "")
    named(d, scene, names, 0.3)
    text = "One colour, one surface: all are images of the starred one by collineations."
    d.title(text, fontsize=11.5)
    return d


def media(spp: int) -> figures.Drawing:
    """Return three bodies filled with media, each named."""
    picture, camera, scene = from_file("media", spp, (1600, 1000))
    d = figures.overlay(picture, camera)
    names = {
        "jade": "jade: scatters,\nbehind rough glass",
        "fog": "fog: scatters,\nwithout a surface",
        "wine": "red glass: absorbs",
    }
    named(d, scene, names, 9.0)
    d.title("Media end at the exact patches: light is scattered and absorbed inside.")
    return d


PICTURES = {
    "railroad_drawn": railroad,
    "duerer_drawn": duerer,
    "sphere_drawn": sphere,
    "weights_drawn": weights,
    "developable_drawn": developable,
    "paraboloids_drawn": paraboloids,
    "media": media,
}


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[], help=", ".join(PICTURES))
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--keep", type=Path, help="folder of renders: read, or written there")
    args = parser.parse_args()
    for name in args.names:
        if name not in PICTURES:
            parser.error(f"NAME: expected one of {', '.join(PICTURES)}, got {name}")
    global KEPT
    KEPT = args.keep
    mi.set_variant("llvm_ad_rgb")
    for name in args.names or PICTURES:
        data = PICTURES[name](args.spp).encoded(".webp", SIZE[0])
        # that of media belongs to another page
        write_file((HERE.parent if name == "media" else HERE) / f"{name}.webp", data)
        print(f"{name}.webp  {len(data) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
