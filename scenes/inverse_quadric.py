"""Recover control points and weights of a quadric patch from four pictures of it.

    python scenes/inverse_quadric.py [--steps 150] [--out renders]

The target is a quadratic patch on an ellipsoid: six control points, of which the three in the
middle have weights near 1/2. The search begins at a plane triangle with all weights one. Unknown
are 18 coordinates and three weights; those of the corners are one, which the parameters of a
patch leave free. `bezier_direct_projective` gives the derivatives, shading and outline; without
the outline the search goes astray.

Writes ``inverse_quadric.png`` (rows: target, start, found with the outline, found without it; the
target's boundary is drawn over each)
and ``inverse_quadric_loss.svg``, and prints what was found.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # first: it chooses LLVM before Dr.Jit does

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip
import numpy as np

from mitsuba_bezier._files import write_file

KEY = "surface.control_points"
CORNERS, MIDDLE = [0, 3, 5], [1, 2, 4]
ENDS = {1: (0, 3), 2: (0, 5), 4: (3, 5)}
EYES = ((0.4, 0.6, 4.5), (3.2, 0.8, 2.8), (-2.6, 1.6, 3.0), (0.6, -2.8, 3.2))


def target_net() -> np.ndarray:
    """Return the target ``(6, 4)``, corners of weight one."""
    ellipsoid = np.array([[1.3, 0.2, 0, 0], [0, 1.1, 0.1, 0], [0, 0, 0.9, 0], [0, 0, 0, 1]])
    patch = mb.sphere(cover="tetrahedral")[:1].transform(ellipsoid)
    net = patch.control_points[0].copy()
    # the parameters that give the corners the weight one: u_i -> s_i u_i
    s = 1 / np.sqrt(net[CORNERS, 3])
    net *= np.array([s[0] ** 2, s[0] * s[1], s[0] * s[2], s[1] ** 2, s[1] * s[2], s[2] ** 2])[
        :, None
    ]
    turn = np.eye(4)
    turn[:3, :3] = facing(net)
    return net @ turn.T


def facing(net: np.ndarray) -> np.ndarray:
    """Return a rotation that turns the plane of the corners towards +z."""
    a, b, c = net[CORNERS, :3] / net[CORNERS, 3:]
    n = np.cross(a - c, b - c)
    n /= np.linalg.norm(n)
    n = n if n @ (a + b + c) > 0 else -n
    x = np.cross([0, 1, 0], n)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(n, x), n])


def start_net(target: np.ndarray) -> np.ndarray:
    """Return a plane triangle, smaller than the target and to its side."""
    corners = target[CORNERS, :3] * [0.75, 0.75, 0] + [0.15, -0.1, 0.4]
    a, b, c = corners
    points = np.array([a, (a + b) / 2, (a + c) / 2, b, (b + c) / 2, c])
    return np.concatenate([points, np.ones((6, 1))], axis=1)


def tensor(values: np.ndarray) -> Any:
    return mi.TensorXf(np.float32(values).ravel(), shape=values.shape)


def scene_of(net: np.ndarray, side: int) -> Any:
    """Return the scene: the patch between three lights, seen by four cameras."""
    cameras = {
        f"camera{i}": {
            "type": "perspective",
            "fov": 40,
            "to_world": mi.ScalarTransform4f().look_at(list(eye), [0, 0, 0.3], [0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": side,
                "height": side,
                "rfilter": {"type": "box"},
                "sample_border": False,
                "pixel_format": "rgb",
            },
            "sampler": {"type": "independent"},
        }
        for i, eye in enumerate(EYES)
    }
    colour = {"type": "rgb", "value": [0.9, 0.75, 0.55]}
    return mi.load_dict(
        {
            "type": "scene",
            **cameras,
            "surface": {
                "type": "beziertriangle",
                "control_points": tensor(net[None]),
                "bsdf": {"type": "twosided", "one": {"type": "diffuse", "reflectance": colour}},
            },
            "key": {"type": "point", "position": [2.5, 3.0, 4.0], "intensity": 40.0},
            "fill": {
                "type": "point",
                "position": [-4.0, -1.0, 3.0],
                "intensity": {"type": "rgb", "value": [6.0, 9.0, 16.0]},
            },
            "below": {
                "type": "point",
                "position": [1.0, -4.0, 2.0],
                "intensity": {"type": "rgb", "value": [14.0, 8.0, 6.0]},
            },
        }
    )


def surface_points(net: np.ndarray) -> np.ndarray:
    """Return the corners and the middles of the edges, ``(6, 3)``: the unknown points."""
    uv = np.array([[1, 0], [0.5, 0.5], [0.5, 0], [0, 1], [0, 0.5], [0, 0]])
    return mb.BezierTriangles(net[None]).points(np.zeros(6, dtype=int), uv)


def net_of(points: Any, logarithms: Any) -> Any:
    """Return control points, homogeneous, of `surface_points` and logarithms of the weights.

    The middle of an edge is ``(A + 2 w P + B) / (2 (1 + w))``. It and the weight are nearly
    independent of each other in an image, the control point P and the weight are not.
    """
    point = [
        mi.Vector3f(*(dr.gather(mi.Float, points.array, mi.UInt32(3 * row + c)) for c in range(3)))
        for row in range(6)
    ]
    out = dr.zeros(mi.Float, 24)
    for row in range(6):
        p, w = point[row], mi.Float(1)
        if row in MIDDLE:
            a, b = ENDS[row]
            w = dr.exp(dr.gather(mi.Float, logarithms.array, mi.UInt32(MIDDLE.index(row))))
            p = (1 + w) * p - (point[a] + point[b]) / 2
        for c, value in enumerate([p.x, p.y, p.z, w]):
            dr.scatter(out, value, mi.UInt32(4 * row + c))
    return mi.TensorXf(out, shape=(1, 6, 4))


def render(scene: Any, integrator: Any, spp: int, seed: int) -> list[Any]:
    return [
        mi.render(scene, integrator=integrator, sensor=i, spp=spp, seed=seed + i)
        for i in range(len(EYES))
    ]


def distance(net: np.ndarray, target: np.ndarray) -> tuple[float, float]:
    """Return the largest error of a control point and of a weight."""
    points = [n[:, :3] / n[:, 3:] for n in (net, target)]
    return (
        float(np.linalg.norm(points[0] - points[1], axis=1).max()),
        float(np.abs(net[:, 3] - target[:, 3]).max()),
    )


def off_the_quadric(net: np.ndarray, target: np.ndarray) -> float:
    """Return the largest distance of points of the patch from the target's quadric, about."""
    q = mb.fit_quadric(target)
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 500)[:, :2]
    x = mb.BezierTriangles(net[None]).evaluate(np.zeros(500, dtype=int), uv)
    x = x / x[:, 3:]
    value = np.einsum("ni,ij,nj->n", x, q, x)
    return float(np.abs(value / (2 * np.linalg.norm((x @ q)[:, :3], axis=1))).max())


def search(
    target: np.ndarray, start: np.ndarray, steps: int, side: int, spp: int, interior: bool
) -> tuple[np.ndarray, list[float]]:
    """Return the net that was found, and the loss of each step."""
    kind = (
        {"type": "bezierpath", "max_depth": 2}
        if interior
        else {
            "type": "bezier_direct_projective",
            "sppi": 0,
        }
    )
    integrator = mi.load_dict(kind)
    exact = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    wanted = render(scene_of(target, side), exact, 16 * spp, 10_000)
    scene = scene_of(start, side)
    params = mi.traverse(scene)
    optimizer = mi.ad.Adam(lr=0.06)
    optimizer["points"] = tensor(surface_points(start))
    optimizer["logarithms"] = tensor(np.log(start[MIDDLE, 3]))
    losses = []
    for step in range(steps):
        # large steps first, then small ones, which average over the noise
        optimizer.set_learning_rate(0.06 * 0.05 ** (step / steps))
        params[KEY] = net_of(optimizer["points"], optimizer["logarithms"])
        params.update()
        total = 0.0
        for i, picture in enumerate(wanted):
            image = mi.render(
                scene,
                params,
                integrator=integrator,
                sensor=i,
                spp=spp,
                seed=8 * step + 2 * i,
                seed_grad=8 * step + 2 * i + 1,
            )
            loss = dr.mean(dr.square(image - picture), axis=None)
            dr.backward(loss)
            total += float(loss.array[0])
            if i + 1 < len(wanted):  # the graph from optimizer to net was used up
                params[KEY] = net_of(optimizer["points"], optimizer["logarithms"])
                params.update()
        optimizer.step()
        losses.append(total / len(wanted))
        if step % 20 == 0 or step == steps - 1:
            net = np.array(params[KEY], dtype=np.float64).reshape(6, 4)
            print(f"step {step:4d}  loss {losses[-1]:.2e}  errors {distance(net, target)}")
    return np.array(params[KEY], dtype=np.float64).reshape(6, 4), losses


def write_plot(name: Path, curves: dict[str, list[float]]) -> None:
    """Write losses by step, in powers of ten, as an SVG drawing."""
    width, height, left, bottom = 560, 280, 60, 36
    low = np.floor(np.log10(min(min(c) for c in curves.values())))
    high = np.ceil(np.log10(max(max(c) for c in curves.values())))
    steps = max(len(c) for c in curves.values())

    def place(step: float, loss: float) -> tuple[float, float]:
        x = left + step / steps * (width - left - 12)
        return x, 12 + (high - np.log10(loss)) / (high - low) * (height - bottom - 12)

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for power in range(int(low), int(high) + 1):
        _x, y = place(0, 10.0**power)
        lines.append(f'<path d="M{left} {y:.1f}H{width - 12}" stroke="#ccc"/>')
        lines.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">1e{power}</text>')
    for step in range(0, steps + 1, 50):
        x, _y = place(step, 10.0**low)
        lines.append(f'<text x="{x:.1f}" y="{height - 18}" text-anchor="middle">{step}</text>')
    lines.append(f'<text x="{width / 2}" y="{height - 3}" text-anchor="middle">step</text>')
    for k, ((label, curve), colour) in enumerate(zip(curves.items(), ("#06c", "#c30"))):
        at = " ".join("{:.1f},{:.1f}".format(*place(i, v)) for i, v in enumerate(curve))
        lines.append(f'<polyline points="{at}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        lines.append(
            f'<text x="{width - 20}" y="{28 + 16 * k}" text-anchor="end" fill="{colour}">'
            f"{label}</text>"
        )
    write_file(name, "\n".join([*lines, "</svg>\n"]).encode())


def write_pictures(path: Path, nets: dict[str, np.ndarray]) -> None:
    """Write what the four cameras see of each net, a net a row, with the target's outline over it.

    Needs the extra ``figures``.
    """
    import io

    from matplotlib.figure import Figure

    from mitsuba_bezier import figures

    exact = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    side = 320
    wanted = mb.BezierTriangles(nets["target"][None])
    sheet = Figure(figsize=(16, 13.2), dpi=100)
    first, width, height = 0.155, 0.845 / len(EYES), 0.955 / len(nets)
    for row, (name, net) in enumerate(nets.items()):
        scene = scene_of(net, side)
        low = 1 - 0.04 - (row + 1) * height
        sheet.text(0.012, low + height / 2, name, fontsize=15, va="center", linespacing=1.4)
        for column, picture in enumerate(render(scene, exact, 256, 0)):
            camera = mb.Camera.from_parameters(mi.traverse(scene.sensors()[column]))
            drawing = figures.overlay(on_grey(np.array(picture), scene, camera), camera)
            drawing.boundary(wanted, "third", linewidth=3.0)
            axes = sheet.add_axes((first + column * width, low, width * 0.985, height * 0.985))
            axes.imshow(drawing.pixels(400))
            axes.set_axis_off()
            if row == 0:
                sheet.text(first + (column + 0.5) * width, 0.972, f"camera {column + 1}",
                           fontsize=15, ha="center")  # fmt: skip
    buffer = io.BytesIO()
    sheet.savefig(buffer, format="png")
    write_file(path, buffer.getvalue())


def on_grey(picture: np.ndarray, scene: Any, camera: mb.Camera) -> np.ndarray:
    """Return a picture, linear, whose pixels beside the surface are light grey."""
    h, w = picture.shape[:2]
    y, x = np.mgrid[0:h, 0:w] + 0.5
    d = camera.direction(np.stack([x.ravel(), y.ravel()], axis=1))
    d /= np.linalg.norm(d, axis=1)[:, None]
    ray = mi.Ray3f(mi.Point3f(camera.center[:3].tolist()), mi.Vector3f(np.float32(d.T)))
    hit = np.array(scene.ray_test(ray)).reshape(h, w)
    return np.where(hit[..., None], picture, 0.85)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--side", type=int, default=48, help="pixels of a picture")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--interior-only", action="store_true", help="that search alone")
    parser.add_argument("--out", type=Path, default=Path("renders"))
    options = parser.parse_args()
    mi.set_variant(options.variant)

    target = target_net()
    start = start_net(target)
    curves, results = {}, {}
    kinds = {"shading and outline": False, "shading alone": True}
    for label, interior in kinds.items():
        if options.interior_only and not interior:
            continue
        begin = time.perf_counter()
        net, curves[label] = search(
            target, start, options.steps, options.side, options.spp, interior
        )
        results[label] = net
        points, weight = distance(net, target)
        print(
            f"{label}: {time.perf_counter() - begin:.0f} s, control points off by {points:.4f}, "
            f"weights by {weight:.4f}, the surface by {off_the_quadric(net, target):.5f}"
        )
        write_plot(options.out / "inverse_quadric_loss.svg", curves)
    found = {f"found by\n{label}": net for label, net in results.items()}
    write_pictures(
        options.out / "inverse_quadric.png",
        {"target": target, "start:\na plane triangle": start, **found},
    )


if __name__ == "__main__":
    main()
