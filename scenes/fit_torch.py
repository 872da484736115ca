"""Fit patches to a picture with a loss and an optimizer of PyTorch.

    pip install torch && python scenes/fit_torch.py [--steps 100] [--out renders]

`dr.wrap` makes a function of Dr.Jit one of PyTorch: unknowns come as tensors of PyTorch, the
picture goes back as one, and `backward` runs through both. Between them stands a parametrization
of `mitsuba_bezier.fit`, here a sphere's centre and the logarithm of its radius. The loss, Huber's
on three sizes of the picture, and Adam are PyTorch's. Prints the loss and what was found, and
writes ``fit_torch.svg``: errors by step.
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # first: it chooses LLVM before Dr.Jit does

import drjit as dr  # isort: skip
import mitsuba as mi
import numpy as np

from mitsuba_bezier import fit
from mitsuba_bezier._files import write_file

KEY = "ball.control_points"
CENTER, RADIUS = (0.25, -0.15, 0.0), 0.8


def scene_of(patches: mb.BezierTriangles, side: int) -> Any:
    """Return the scene: a ball under a lamp, seen by two cameras."""
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    film |= {"pixel_format": "rgb", "sample_border": False}
    cameras = {
        f"camera{i}": {
            "type": "perspective",
            "fov": 40,
            "to_world": mi.ScalarTransform4f().look_at(eye, [0, 0, 0], [0, 1, 0]),
            "film": film,
        }
        for i, eye in enumerate(([0, 0, 5], [5, 0, 0]))
    }
    lamp = {"type": "point", "position": [3, 3, 4], "intensity": 30.0}
    return mi.load_dict({"type": "scene", **cameras, "lamp": lamp, "ball": mb.shape(patches)})


def renderer(scene: Any, item: fit.Parametrization, integrator: Any, spp: int) -> Any:
    """Return a function of PyTorch: unknowns and the number of a step give a picture.

    The cameras take turns.
    """
    params = mi.traverse(scene)

    @dr.wrap(source="torch", target="drjit")
    def render(center: Any, logarithm: Any, step: int) -> Any:
        params[KEY] = item.value({"center": center, "logarithm": logarithm})
        params.update()
        return mi.render(
            scene,
            params,
            integrator=integrator,
            sensor=step % 2,
            spp=spp,
            seed=2 * step,
            seed_grad=2 * step + 1,
        )

    return render


def layers(image: Any) -> Any:
    """Return a picture as PyTorch has pictures: a batch of one, channels first."""
    return image.permute(2, 0, 1)[None]


def errors(unknowns: Any) -> tuple[float, float]:
    """Return by how much centre and radius are off."""
    center, logarithm = (unknowns[k].detach().numpy() for k in ("center", "logarithm"))
    return float(np.linalg.norm(center - CENTER)), float(abs(np.exp(logarithm[0]) - RADIUS))


def search(
    steps: int, side: int, spp: int, rate: float, integrator: str
) -> tuple[Any, list[tuple[float, float]]]:
    """Return the unknowns that were found, and the errors before each step and at the end."""
    import torch

    exact = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    truth = scene_of(mb.sphere(CENTER, RADIUS), side)
    targets = [
        layers(torch.from_numpy(np.array(mi.render(truth, integrator=exact, sensor=i, spp=64))))
        for i in range(2)
    ]

    item = fit.Sphere()
    unknowns = {
        name: torch.tensor(array, dtype=torch.float32, requires_grad=True)
        for name, array in item.start().items()
    }
    render = renderer(scene_of(mb.sphere(), side), item, mi.load_dict({"type": integrator}), spp)
    optimizer = torch.optim.Adam(unknowns.values(), lr=rate)
    # the rate falls to a twentieth, which averages over the noise of the pictures
    falling = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.05 ** (1 / steps))
    curve = [errors(unknowns)]
    for step in range(steps):
        optimizer.zero_grad()
        image = layers(render(unknowns["center"], unknowns["logarithm"], step))
        loss = sum(
            torch.nn.functional.huber_loss(
                torch.nn.functional.avg_pool2d(image, size),
                torch.nn.functional.avg_pool2d(targets[step % 2], size),
                delta=0.1,
            )
            for size in (1, 2, 4)
        )
        loss.backward()
        optimizer.step()
        falling.step()
        curve.append(errors(unknowns))
        print(f"step {step + 1}, loss {float(loss.detach()):.2e}", flush=True)
    return {name: x.detach().numpy() for name, x in unknowns.items()}, curve


def draw(curve: list[tuple[float, float]]) -> bytes:
    """Return the plot of errors by step, as SVG."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for values, style, name in zip(zip(*curve), ("-", "--"), ("centre", "radius")):
        axes.plot(values, style, color="#222", label=name)
    axes.set(yscale="log", xlabel="step of PyTorch's Adam", ylabel="error (the radius is 0.8)")
    axes.grid(True, which="both", color="#ddd")
    axes.legend()
    out = io.BytesIO()
    figure.savefig(out, format="svg")
    plt.close(figure)
    return out.getvalue()


def main() -> None:
    try:
        import torch  # noqa: F401
    except ImportError:
        sys.exit("fit_torch: expected PyTorch, got none; pip install torch")
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--side", type=int, default=32)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--rate", type=float, default=0.03)
    parser.add_argument("--integrator", default="bezier_direct_projective")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--out", type=Path, default=Path("renders"))
    options = parser.parse_args()
    mi.set_variant(options.variant)
    found, curve = search(
        options.steps, options.side, options.spp, options.rate, options.integrator
    )
    print(f"center {np.round(found['center'], 3).tolist()}, it is {list(CENTER)}")
    print(f"radius {np.exp(found['logarithm'][0]):.3f}, it is {RADIUS}")
    write_file(options.out / "fit_torch.svg", draw(curve), make_folders=True)


if __name__ == "__main__":
    main()
