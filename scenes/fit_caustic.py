"""Find a pane of glass whose caustic is a given picture, and prove it by the light tracer.

    python scenes/fit_caustic.py [--out renders] [--photons 4000]

Light falls straight down on the flat top of a pane, leaves its bottom, a bicubic spline of 19 x 19
heights, and falls on a floor. The heights are searched by `mitsuba_bezier.fit` such that what
arrives is the picture: rays on a grid are refracted at the spline by Snell's law, and spread over
the floor's pixels. Coarse to fine: 32, 64, then 128 pixels. What is found becomes Bézier
triangles, a closed body of glass. The light tracer, which knows nothing of the search, renders its
caustic.

Writes ``fit_caustic.jpg`` (target, what the search sees, what the light tracer sees, the glass from
below) and prints correlations.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # first: it chooses LLVM before Dr.Jit does

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip
import numpy as np

from mitsuba_bezier import fit
from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry.splines import basis_functions

COUNT = 19  # heights along a side
FLOOR = 2.5  # below the bottom of the glass
INDEX = 1.5
THICK = 0.25


def picture(side: int) -> np.ndarray:
    """Return the target: a heart with soft edges on a grey ground; its mean is one."""
    from scipy.ndimage import gaussian_filter

    fine = 4
    x, y = np.meshgrid(*2 * [(np.arange(fine * side) + 0.5) / (fine * side) * 2 - 1])
    a, b = 1.6 * x, -1.6 * y + 0.15
    inside = (a * a + b * b - 1) ** 3 < a * a * b**3
    soft = gaussian_filter(inside.astype(float), 0.04 * fine * side / 2, mode="nearest")
    image = 0.35 + soft.reshape(side, fine, side, fine).mean(axis=(1, 3))
    return image / image.mean()


def spline_matrices(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values and slopes of the spline's basis at places from -1 to 1, ``(N, COUNT)``."""
    knots = _knots()
    h = 1e-6
    basis = basis_functions
    low, high = np.clip(t - h, -1, 1), np.clip(t + h, -1, 1)
    slopes = (basis(knots, 3, high) - basis(knots, 3, low)) / (high - low)[:, None]
    return basis(knots, 3, t), slopes


def _knots() -> np.ndarray:
    step = 2 / (COUNT - 3)
    return -1 + step * np.arange(-3, COUNT + 1)


class Light:
    """The picture that heights make: rays on a grid, refracted, spread over pixels."""

    def __init__(self, rays: int, side: int) -> None:
        self.side, self.rays = side, rays
        place = (np.arange(rays) + 0.5) / rays * 2 - 1
        value, slope = spline_matrices(place)
        self.value, self.slope = mi.TensorXf(value), mi.TensorXf(slope)
        y, x = np.meshgrid(place, place, indexing="ij")
        self.x, self.y = mi.Float(x.ravel()), mi.Float(y.ravel())

    def __call__(self, heights: Any) -> Any:
        """Return the irradiance of the floor's pixels, 1 where no glass is."""
        z = (self.value @ heights @ self.value.T).array
        zx = (self.value @ heights @ self.slope.T).array
        zy = (self.slope @ heights @ self.value.T).array
        # down, out of glass through z(x, y): Snell's law in vectors
        normal = dr.normalize(mi.Vector3f(-zx, -zy, 1))
        cosine = normal.z
        out = dr.sqrt(1 - INDEX**2 * (1 - cosine * cosine))
        way = mi.Vector3f(0, 0, -INDEX) + (INDEX * cosine - out) * normal
        s, p = INDEX * cosine, INDEX * out
        parallel, across = (cosine - p) / (cosine + p), (s - out) / (s + out)
        passed = 1 - (parallel * parallel + across * across) / 2
        fall = (FLOOR + z) / -way.z
        column = (self.x + fall * way.x + 1) * self.side / 2
        row = (self.y + fall * way.y + 1) * self.side / 2
        return self._spread(row, column, passed)

    def _spread(self, row: Any, column: Any, power: Any) -> Any:
        """Add rays to pixels by a quadratic B-spline, whose derivative is continuous."""
        image = dr.zeros(mi.Float, self.side**2)
        r, c = (mi.Int(dr.floor(dr.detach(x))) for x in (row, column))
        weights = []
        for place, pixel in ((row, r), (column, c)):
            t = place - mi.Float(pixel)
            weights.append([0.5 * (1 - t) ** 2, 0.75 - (t - 0.5) ** 2, 0.5 * t * t])
        for i in range(3):
            for j in range(3):
                y, x = r + i - 1, c + j - 1
                inside = (y >= 0) & (y < self.side) & (x >= 0) & (x < self.side)
                dr.scatter_reduce(
                    dr.ReduceOp.Add,
                    image,
                    power * weights[0][i] * weights[1][j],
                    mi.UInt32(y * self.side + x),
                    inside,
                )
        return image * (self.side / self.rays) ** 2


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


LEVELS = ((32, 128), (64, 256), (128, 512))


def search(steps: int, levels: tuple[tuple[int, int], ...] = LEVELS) -> np.ndarray:
    """Return the heights found; levels are pixels and rays along a side."""
    heights = np.zeros((COUNT, COUNT))
    for side, rays in levels:
        light = Light(rays, side)
        wanted = mi.Float(picture(side).ravel())

        def objective(params: Any, _seed: int, light: Light = light, wanted: Any = wanted) -> Any:
            image = light(params["heights"])
            return dr.mean(dr.square(image / dr.mean(image) - wanted))

        found = fit.minimize(
            None,
            {"heights": fit.Values(heights, scale=0.02)},
            objective=objective,
            method="l-bfgs",
            steps=steps,
            progress=False,
        )
        heights = found.values["heights"]
        seen = np.array(light(mi.TensorXf(heights))).reshape(side, side)
        print(
            f"{side} x {side}: loss {found.losses[0]:.4f} -> {found.losses[-1]:.5f} in "
            f"{len(found.losses)} steps, {found.seconds:.0f} s; correlation "
            f"{correlation(seen, picture(side)):.4f}",
            flush=True,
        )
    return heights


def glass(heights: np.ndarray) -> mb.BezierTriangles:
    """Return the pane as a closed body: the spline below, a flat top, and sides."""
    knots = _knots()
    places = np.array([knots[i + 1 : i + 4].mean() for i in range(COUNT)])  # Greville's
    points = np.empty((COUNT, COUNT, 3))
    points[..., 0], points[..., 1], points[..., 2] = places[None], places[:, None], heights
    nets = mb.BSplineSurface.from_points(points, knots=(knots, knots)).to_bezier()
    parts = [mb.tensor_to_triangles(net) for net in nets.reshape(-1, 4, 4, 4)]
    borders = [*nets[0][:, 0], *nets[-1][:, -1], *nets[:, 0][:, :, 0], *nets[:, -1][:, :, -1]]
    for curve in borders:
        above = curve.copy()
        above[:, 2] = THICK
        parts.append(mb.tensor_to_triangles(np.stack([curve, above])))
        # the top is a fan, whose edges are those of the sides
        parts.append(mb.BezierTriangles([[above[0], above[-1], [0, 0, THICK, 1.0]]]))
    middle = np.array([0, 0, THICK / 2])
    third = np.array([[1 / 3, 1 / 3]])
    nets = []
    for part in parts:  # normals point outward: the pane is convex but for its relief
        for one in part:
            p, n = one.points([0], third)[0], one.normals([0], third)[0]
            flat = np.array([p[0], p[1], THICK / 2]) if abs(n[2]) > 0.7 else middle
            nets.append(one if n @ (p - flat) > 0 else one.reverse())
    # one degree for all: that of the spline's triangles
    most = max(net.degree for net in nets)
    return mb.BezierTriangles.join([net.elevate(most - net.degree) for net in nets])


def scene_of(pane: mb.BezierTriangles, side: int) -> dict[str, Any]:
    """Return light from above, the pane, the floor, and a camera below the pane that sees it."""
    eye = -0.3
    return {
        "type": "scene",
        "camera": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(1 / (FLOOR + eye)))),
            # x to the right and y downward, as the rows of the picture go
            "to_world": mi.ScalarTransform4f().look_at([0, 0, eye], [0, 0, -FLOOR], [0, -1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": side,
                "height": side,
                "rfilter": {"type": "box"},
                "pixel_format": "luminance",
                "sample_border": False,
            },
        },
        "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
        "pane": mb.shape(pane, bsdf={"type": "dielectric", "int_ior": INDEX}),
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, -FLOOR]).scale(1.6),
        },
    }


def traced(pane: mb.BezierTriangles, side: int, photons: int, passes: int) -> np.ndarray:
    """Return the floor as the light tracer sees it, averaged over passes."""
    scene = mi.load_dict(scene_of(pane, side))
    integrator = mi.load_dict({"type": "ptracer", "max_depth": 6})
    total = np.zeros((side, side))
    for k in range(passes):
        image = mi.render(scene, integrator=integrator, spp=max(1, photons // passes), seed=k)
        total += np.array(image).reshape(side, side)
        print(f"light tracer: pass {k + 1} of {passes}", flush=True)
    return total / passes


def figure(columns: dict[str, np.ndarray], width: int = 1600) -> bytes:
    """Return pictures beside each other with their titles, as a JPEG file."""
    import io

    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    drawn, axes = plt.subplots(
        1, len(columns), figsize=(16, 4.4), dpi=width / 16, layout="constrained"
    )
    for place, (title, image) in zip(axes, columns.items()):
        place.imshow(image, cmap="gray", vmin=0, vmax=max(2.2, float(image.max())))
        place.set_title(title, fontsize=15)
        place.axis("off")
    out = io.BytesIO()
    drawn.savefig(out, format="jpg", pil_kwargs={"quality": 88})
    plt.close(drawn)
    return out.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=250, help="of each of the three searches")
    parser.add_argument("--side", type=int, default=256, help="pixels of the proof")
    parser.add_argument("--photons", type=int, default=3000, help="of the light tracer, a pixel")
    parser.add_argument("--passes", type=int, default=8)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--out", type=Path, default=Path("renders"))
    options = parser.parse_args()
    mi.set_variant(options.variant)

    heights = search(options.steps)
    side = options.side
    seen = np.array(Light(4 * side, side)(mi.TensorXf(heights))).reshape(side, side)
    proof = traced(glass(heights), side, options.photons, options.passes)
    wanted = picture(side)
    print(f"heights from {heights.min():.4f} to {heights.max():.4f}")
    print(f"{side} x {side}: what the search sees {correlation(seen, wanted):.4f}")
    print(f"{side} x {side}: what the light tracer sees {correlation(proof, wanted):.4f}")
    values, _slopes = spline_matrices((np.arange(side) + 0.5) / side * 2 - 1)
    relief = -(values @ heights @ values.T)  # how much thicker the pane is
    columns = {
        "the picture wanted": wanted,
        "what the search sees": seen / seen.mean(),
        f"light tracer, correlation {correlation(proof, wanted):.3f}": proof / proof.mean(),
        f"the glass: thickness, {1e3 * np.ptp(relief) / 2:.0f} mm in 1 m": 2.2
        * (relief - relief.min())
        / max(float(np.ptp(relief)), 1e-12),
    }
    write_file(options.out / "fit_caustic.jpg", figure(columns), make_folders=True)


if __name__ == "__main__":
    main()
