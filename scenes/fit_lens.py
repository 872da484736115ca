"""Find out from one blurred photograph what is wrong with a lens.

    python scenes/fit_lens.py [--side 48] [--steps 8] [--out renders]

The sensor `lens` photographs a slanted chart through a double Gauss at f/2. The lens that took the
photograph was put together badly: the film is too far away, and the rear element is bent too much.
The search begins at the prescription and has nothing but the photograph and the chart. Rays go
through all surfaces with derivatives by curvatures and thicknesses. Each place of the slanted chart
is at another distance, so that blur and magnification tell the two errors apart.

The loss compares images divided by their mean: derivatives leave out which rays the stop lets
through, and that changes brightness more than anything else. It is the mean product of the
differences of two renders with noise of their own, so that noise does not count as a difference.

Writes ``fit_lens.jpg`` (the photograph, the lens as prescribed, the lens found) and
``fit_lens.svg`` (errors by step), and prints what was found.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import Any, NamedTuple

import mitsuba_bezier  # noqa: F401  # first: it chooses LLVM before Dr.Jit does

import mitsuba as mi  # isort: skip
import numpy as np

from mitsuba_bezier import fit
from mitsuba_bezier._files import write_file

LENS = Path(__file__).parent / "lenses/double_gauss.csv"
#: The board's distance in metres, and by how much it is turned.
DISTANCE, ANGLE = 0.8, 20.0


class Fault(NamedTuple):
    """What is wrong with the lens: an entry of a parameter, and by how much it is off."""

    name: str
    parameter: str
    entry: int
    error: float
    unit: str


FAULTS = (
    Fault("distance of the film", "thicknesses", -1, 0.5, "mm"),
    Fault("curvature of the rear element", "curvatures", 9, 1e-4, "1/mm"),
)


def chart(cells: int = 7, pixels: int = 128) -> np.ndarray:
    """Return stars on squares of random grey: there is detail everywhere, fine and coarse."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(*2 * [(np.arange(pixels) + 0.5) / pixels * 2 - 1])
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    spokes = np.clip(0.5 + 0.25 * r * pixels * np.sin(12 * angle) / 6, 0, 1)
    rows = []
    for _row in range(cells):
        row = []
        for _column in range(cells):
            ground = np.kron(rng.random((4, 4)), np.ones((pixels // 4,) * 2))
            row.append(np.where(r < 0.8, spokes, ground))
        rows.append(np.concatenate(row, axis=1))
    grey = 0.04 + 0.92 * np.concatenate(rows)
    return grey[:, :, None].repeat(3, axis=2).astype(np.float32)


def scene_of(side: int, *, off: bool = False) -> Any:
    """Return the scene: the board fills the field of a lens, which is right or `off`."""
    camera = {
        "type": "lens",
        "filename": str(LENS),
        "f_number": 2.0,
        "focus_distance": DISTANCE,
        "dispersion": False,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": side * 3 // 2,
            "height": side,
            "rfilter": {"type": "box"},
            "sample_border": False,
            "pixel_format": "rgb",
        },
    }
    pixels = chart()
    texture = {"type": "bitmap", "data": mi.TensorXf(pixels), "raw": True}
    place = mi.ScalarTransform4f().translate([0, 0, -DISTANCE]).rotate([0, 1, 0], ANGLE)
    board = {
        "type": "rectangle",
        "to_world": place.scale(0.24),
        "emitter": {"type": "area", "radiance": texture},
    }
    scene = mi.load_dict({"type": "scene", "camera": camera, "board": board})
    if off:
        params = mi.traverse(scene)
        numbers = {k: np.array(params[k]) for k in {f"camera.{f.parameter}" for f in FAULTS}}
        for f in FAULTS:
            numbers[f"camera.{f.parameter}"][f.entry] += f.error
        set_lens(scene, numbers)
    return scene


def mean_one(image: Any) -> Any:
    """Return an image divided by its mean."""
    import drjit as dr

    return image / dr.mean(image, axis=None)


def search(scene: Any, photograph: Any, steps: int, spp: int, look: Any) -> fit.Fit:
    """Return what was found; the scene has it."""
    import drjit as dr

    wanted = mean_one(photograph)
    direct = mi.load_dict({"type": "direct"})

    def objective(params: Any, _seed: int) -> Any:
        offs = [
            mean_one(mi.render(scene, params, integrator=direct, spp=spp, seed=i)) - wanted
            for i in (1, 2)
        ]
        return dr.mean(offs[0] * offs[1], axis=None)

    return fit.minimize(
        scene,
        unknowns(scene),
        objective=objective,
        method="l-bfgs",
        steps=steps,
        callback=look,
        progress=False,
    )


def unknowns(scene: Any) -> dict[str, fit.Parametrization]:
    """Return what is searched: the entries that may be wrong, from the prescription on."""
    params = mi.traverse(scene)
    out: dict[str, fit.Parametrization] = {}
    for fault in FAULTS:
        key = f"camera.{fault.parameter}"
        out[key] = fit.Values(params[key], only=[fault.entry], scale=fault.error)
    return out


def errors(scene: Any, truth: Any) -> list[float]:
    """Return by how much each entry differs from that of the lens of the photograph."""
    params, right = mi.traverse(scene), mi.traverse(truth)
    keys = [f"camera.{f.parameter}" for f in FAULTS]
    return [float(params[k][f.entry] - right[k][f.entry]) for k, f in zip(keys, FAULTS)]


def draw(curves: list[list[float]]) -> bytes:
    """Return the plot of errors by step, as SVG."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for fault, curve, style in zip(FAULTS, zip(*curves), ("-o", "--s")):
        part = [abs(v) / fault.error for v in curve]
        axes.plot(part, style, color="#222", markersize=4, label=fault.name)
    axes.set(
        yscale="log", xlabel="step of L-BFGS", ylabel="error left, as a part of the fault",
        xticks=range(len(curves)),
    )  # fmt: skip
    axes.grid(True, which="both", color="#ddd")
    axes.legend()
    out = io.BytesIO()
    figure.savefig(out, format="svg")
    plt.close(figure)
    return out.getvalue()


def pictures(scenes: dict[str, Any], spp: int) -> bytes:
    """Return what each lens sees, one beside the other, with names, as a JPEG file."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    direct = mi.load_dict({"type": "direct"})
    figure = plt.figure(figsize=(16, 16 / 3 / 1.5), dpi=100)
    for i, (name, scene) in enumerate(scenes.items()):
        axes = figure.add_axes((i / 3 + 0.001, 0, 1 / 3 - 0.002, 1))
        image = np.array(mi.render(scene, integrator=direct, spp=spp))[..., :3]
        axes.imshow(np.clip(image, 0, 1) ** (1 / 2.2))
        axes.axis("off")
        box = {"facecolor": "#000", "alpha": 0.6, "edgecolor": "none"}
        axes.text(0.02, 0.96, name, color="white", fontsize=14, va="top",
                  transform=axes.transAxes, bbox=box)  # fmt: skip
    out = io.BytesIO()
    figure.savefig(out, format="jpg", pil_kwargs={"quality": 85})
    plt.close(figure)
    return out.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--side", type=int, default=48, help="rows of the photograph")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--shown", type=int, default=356, help="rows of a picture that is shown")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--out", type=Path, default=Path("renders"))
    options = parser.parse_args()
    mi.set_variant(options.variant)

    truth, scene = scene_of(options.side, off=True), scene_of(options.side)
    direct = mi.load_dict({"type": "direct"})
    photograph = mi.render(truth, integrator=direct, spp=8 * options.spp, seed=1000)
    curves = [errors(scene, truth)]

    def look(step: int, loss: float) -> None:
        curves.append(errors(scene, truth))
        told = ", ".join(f"{e:+.2g} {f.unit}" for e, f in zip(curves[-1], FAULTS))
        print(f"step {step}, loss {loss:.2e}, off by {told}", flush=True)

    found = search(scene, photograph, options.steps, options.spp, look)
    if len(curves) > 1:
        curves[-1] = errors(scene, truth)  # the best state, not the last that was looked at
    for fault, error in zip(FAULTS, curves[-1]):
        print(f"{fault.name}: off by {fault.error:g} {fault.unit}, found but for {error:+.2g}")
    print(f"{len(found.losses)} steps, {found.reason}")
    write_file(options.out / "fit_lens.svg", draw(curves), make_folders=True)
    shown = {"the photograph": scene_of(options.shown, off=True)}
    shown["the lens as prescribed"] = scene_of(options.shown)
    after = scene_of(options.shown)
    set_lens(after, found.values)
    shown["the lens that was found"] = after
    write_file(options.out / "fit_lens.jpg", pictures(shown, 256))


def set_lens(scene: Any, values: dict[str, np.ndarray]) -> None:
    """Give the scene's lens other curvatures and thicknesses."""
    params = mi.traverse(scene)
    for key, numbers in values.items():
        params[key] = mi.Float(numbers)
    params.update()


if __name__ == "__main__":
    main()
