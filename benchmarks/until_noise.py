"""Hold the error at which ``render --until-noise X`` stops against X, on scenes of the gallery.

    python benchmarks/until_noise.py [--noise 0.05] [--renders 12] [--scenes teapot quadrics ...]
    python benchmarks/until_noise.py --flip 0.05

The command renders each scene, in small, until it says that the mean relative standard error is X.
As many samples are then rendered with other seeds, some twelve times: the standard deviation of
each pixel over these renders is its true standard error, and their mean is taken over the pixels
as the command does (`Accumulator.noise` has the definition). With `--flip` the command stops by
``--until-flip X``, and the truth is FLIP between each of these renders and the mean of the others,
at 95 % of the pixels, on the average. `docs/verification.md` has the tables.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mitsuba_bezier as mb
from mitsuba_bezier.cli import _scene, main
from mitsuba_bezier.rendering.picture import render_picture
from mitsuba_bezier.rendering.plan import make_plan, sampled_pixels
from mitsuba_bezier.verification.flip import flip_map
from mitsuba_bezier.verification.merge import DARK, luminance

ROOT = Path(mb.__file__).resolve().parents[1]
SCENES = ("sphere", "quadrics", "cornell", "teapot", "weights", "relief")
VARIANT = "llvm_ad_rgb"
#: Of the pixels, as the command has it.
SHARE = 0.95


def true_error(path: Path, defines: dict[str, str], spp: int, renders: int, by_flip: bool) -> float:
    """Return the error of renders of so many samples."""
    loaded = _scene.load(path, VARIANT, defines)
    sensor = loaded.scene.sensors()[0]
    plan = make_plan(sampled_pixels(sensor.film()), spp, VARIANT, style="large")
    images, colours = [], []
    for seed in range(1000, 1000 + renders):
        picture = render_picture(loaded.scene, sensor, loaded.integrator, plan, seed)
        mean = picture.total.mean()
        images.append(luminance(mean))
        colours.append(np.stack([mean[c] for c in "RGB"], axis=-1).astype(np.float64))
    if by_flip:
        total = np.sum(colours, axis=0)
        found = [
            np.quantile(flip_map((total - one) / (renders - 1), one, "linear"), SHARE)
            for one in colours
        ]
        return float(np.mean(found))
    stack = np.stack(images).astype(np.float64)
    mean, spread = stack.mean(axis=0), stack.std(axis=0, ddof=1)
    n = renders
    small = math.sqrt(2 / (n - 1)) * math.exp(math.lgamma(n / 2) - math.lgamma((n - 1) / 2))
    return float((spread / np.maximum(mean, DARK * mean.mean())).mean()) / small


def one(
    name: str, noise: float, size: tuple[int, int], renders: int, by_flip: bool
) -> tuple[float, ...]:
    """Return samples, what the command says, and the truth, for a scene."""
    path = ROOT / "scenes" / f"{name}.xml"
    defines = {"width": str(size[0]), "height": str(size[1])}
    words = [word for key, value in defines.items() for word in ("-D", f"{key}={value}")]
    with tempfile.TemporaryDirectory() as folder:
        out, found = Path(folder) / "a.exr", Path(folder) / "a.json"
        flag = "--until-flip" if by_flip else "--until-noise"
        flags = ["-q", flag, str(noise), "-o", str(out), "--json", str(found)]
        started = time.process_time()
        code = main.main(["render", str(path), *words, *flags, "-m", VARIANT])
        if code:
            sys.exit(code)
        document = json.loads(found.read_text())
    seconds = time.process_time() - started
    spp = int(document["spp"])
    return (
        spp,
        document["passes"],
        document["flip_expected" if by_flip else "noise"],
        true_error(path, defines, spp, renders, by_flip),
        seconds,
    )


def run() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--noise", type=float, default=0.05)
    parser.add_argument("--flip", type=float, help="stop by --until-flip")
    parser.add_argument("--renders", type=int, default=12)
    parser.add_argument("--width", type=int, default=96)
    parser.add_argument("--height", type=int, default=64)
    parser.add_argument("--scenes", nargs="*", default=SCENES)
    args = parser.parse_args()
    by_flip = args.flip is not None
    asked = args.flip if by_flip else args.noise
    flag = "--until-flip" if by_flip else "--until-noise"
    table = Table(title=f"{flag} {asked:.2%}, {args.width} x {args.height}")
    for title in ("scene", "spp", "passes", "told", "true", "true / asked", "processor s"):
        table.add_column(title, justify="left" if title == "scene" else "right")
    for name in args.scenes:
        spp, passes, told, true, seconds = one(
            name, asked, (args.width, args.height), args.renders, by_flip
        )
        cells = (f"{spp}", f"{passes}", f"{told:.2%}", f"{true:.2%}")
        table.add_row(name, *cells, f"{true / asked:.2f}", f"{seconds:.1f}")
        print(name, *cells, file=sys.stderr, flush=True)
    Console(width=100).print(table)


if __name__ == "__main__":
    run()
