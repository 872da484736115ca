"""Hold denoised pictures of few samples against references of many.

    python benchmarks/denoised.py [--width 512] [--spp 32] [--reference 4096] [--keep FOLDER]

Each scene is rendered by the command with ``--denoise``, so with the filter `box`, in few samples
and, with another seed, in many. Told are relative MSE and FLIP of the noisy and of the denoised
picture, how many times smaller the first gets, and the seconds that denoising took, albedo and
normals included. With `--keep`, pictures stay there, and a second run goes on from what is there.
`docs/verification.md` has the table.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mitsuba_bezier as mb
from mitsuba_bezier.cli import main
from mitsuba_bezier.verification.flip import flip_map
from mitsuba_bezier.verification.images import read_image
from mitsuba_bezier.verification.metrics import measure

ROOT = Path(mb.__file__).resolve().parents[1]
#: Height in width.
SCENES = {"quadrics": 324 / 576, "teapot": 320 / 512}
SEEDS = {"few": 7, "many": 1}
VARIANT = "llvm_ad_rgb"


def render(name: str, width: int, spp: int, seed: int, out: Path) -> None:
    """Render a scene, or what is left of it; a picture that is finished stays."""
    if out.is_file() and out.with_suffix(".denoised.exr").is_file():
        found = read_image(out).attributes
        if found.get("spp") == spp and found.get("seed") == seed:
            return
    size = {"width": width, "height": round(SCENES[name] * width)}
    words = [word for key, value in size.items() for word in ("-D", f"{key}={value}")]
    words += ["--spp", str(spp), "--seed", str(seed), "-m", VARIANT, "-o", str(out), "--denoise"]
    if main.main(["render", str(ROOT / "scenes" / f"{name}.xml"), *words, "-q"]):
        sys.exit(1)


def pixels(path: Path) -> np.ndarray:
    """Return the colours of a picture."""
    channels = read_image(path).channels
    return np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float64)


def one(name: str, folder: Path, args: argparse.Namespace) -> list[str]:
    """Return the figures of a scene."""
    few, many = (folder / f"{name}-{args.width}-{spp}.exr" for spp in (args.spp, args.reference))
    render(name, args.width, args.spp, SEEDS["few"], few)
    render(name, args.width, args.reference, SEEDS["many"], many)
    reference, clean = pixels(many), few.with_suffix(".denoised.exr")
    cells, errors = [], []
    for path in (few, clean):
        image = pixels(path)
        errors.append(measure(reference, image).relative_mse)
        flip = float(flip_map(reference, image, "linear").mean())
        cells.append((f"{errors[-1]:.5f}", f"{flip:.3f}"))
    seconds = float(read_image(clean).attributes["denoise_seconds"])
    (noisy, flip), (cleaned, flip_clean) = cells
    times = f"{errors[0] / errors[1]:.1f}"
    return [noisy, cleaned, times, flip, flip_clean, f"{seconds:.1f}"]


def run() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--reference", type=int, default=4096)
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
    parser.add_argument("--keep", type=Path, help="folder for pictures")
    args = parser.parse_args()
    table = Table(title=f"{args.width} pixels across, {args.spp} spp, against {args.reference}")
    for title in ("scene", "relMSE", "denoised", "times less", "FLIP", "denoised", "seconds"):
        table.add_column(title, justify="left" if title == "scene" else "right")
    with tempfile.TemporaryDirectory() as name:
        folder = args.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        for scene in args.scenes:
            cells = one(scene, folder, args)
            table.add_row(scene, *cells)
            print(scene, *cells, file=sys.stderr, flush=True)
    Console(width=100).print(table)


if __name__ == "__main__":
    run()
