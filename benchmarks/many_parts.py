"""What 10 000 parts cost besides rendering: dask's scheduler, messages, merging, the checkpoint.

    python benchmarks/many_parts.py [--parts 10000] [--width 1920] [--height 1080]

The loop of `rendering.farm` runs with as many parts, which workers (threads of this process) answer
at once with small sums: its processor time, the scheduler's included, is what a part costs that
takes no time to render. Sums of a film of the size given are made of noise: their bytes are those
of a message, and adding them up, encoding them and encoding the picture is timed. Last, so many
small files are merged by the command. `docs/many-machines.md` has the figures.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mitsuba_bezier.cli import main
from mitsuba_bezier.rendering.farm import Farm
from mitsuba_bezier.rendering.parts import Rendered, render_part
from mitsuba_bezier.rendering.passes import Pass
from mitsuba_bezier.rendering.picture import Picture, encode_sums
from mitsuba_bezier.rendering.plan import Plan
from mitsuba_bezier.verification.images import encode_exr

SMALL = (6, 8)


def noise(size: tuple[int, int], spp: int, seed: int) -> Pass:
    """Return a pass of noise."""
    rng = np.random.default_rng(seed)
    channels = {c: rng.random(size, dtype=np.float32) for c in "RGB"}
    return Pass(channels, np.full(size, spp, np.float32), spp, seed)


def work(plan: Plan, indices: tuple[int, ...]) -> Rendered:
    """Render a part of nothing; it tells that each pass takes long, so that parts stay small."""
    import dataclasses

    rendered = render_part(plan, indices, 0, {}, lambda spp, seed: noise(SMALL, spp, seed))
    return dataclasses.replace(rendered, seconds=1e3 * len(indices))


def scheduler(parts: int) -> None:
    """Tell the cost of a part that takes no time."""
    import dask
    from distributed import Client

    plan = Plan(parts, 1, 1)
    picture = Picture(plan)
    with (
        dask.config.set({"distributed.admin.tick.limit": "60s"}),
        Client(n_workers=8, threads_per_worker=1, processes=False, dashboard_address=None) as found,
    ):
        farm = Farm(found, work, plan, picture, 0, {}, SMALL, print)
        started, wall = time.process_time(), time.perf_counter()
        farm.run(range(parts), lambda _: False, lambda: None)
    seconds, wall = time.process_time() - started, time.perf_counter() - wall
    assert picture.complete
    print(
        f"{parts} parts that take no time: {seconds:.1f} s of processor time in all, "
        f"{1e3 * seconds / parts:.2f} ms a part ({wall:.1f} s by the clock)"
    )


def messages(parts: int, size: tuple[int, int]) -> None:
    """Tell bytes and times for a film of a size."""
    plan = Plan(64, 2, 2)
    rendered = render_part(plan, (0, 1, 2, 3), 0, {}, lambda spp, seed: noise(size, spp, seed))
    count = sum(values.nbytes for values in rendered.sums.values())
    picture = Picture(plan)
    picture.add_sums(rendered.indices, rendered.sums, rendered.spp, rendered.seeds)
    started = time.process_time()
    other = render_part(plan, (4, 5, 6), 0, {}, lambda spp, seed: noise(size, spp, seed))
    began = time.process_time()
    picture.add_sums(other.indices, other.sums, other.spp, other.seeds)
    merged = time.process_time() - began
    began = time.process_time()
    data = encode_sums(picture, {}, (0, 0), size[::-1])
    sums = time.process_time() - began
    began = time.process_time()
    half = {n: p.astype(np.float16) for n, p in picture.total.mean().items()}
    shown = encode_exr(half)
    seen = time.process_time() - began
    print(
        f"{size[1]} x {size[0]}: {count / 1e6:.1f} MB a message, {count * parts / 1e9:.0f} GB for "
        f"{parts} parts; adding one {merged:.2f} s, {merged * parts / 60:.0f} min for all; the "
        f"sums {len(data) / 1e6:.1f} MB in {sums:.2f} s, the picture {len(shown) / 1e6:.1f} MB in "
        f"{seen:.2f} s (processor time; making the sums of three passes "
        f"{began - started:.1f} s)"
    )


def merge(parts: int) -> None:
    """Tell the time of the command for so many small files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan = f"{parts} spp in passes of 1"
        for index in range(parts):
            one = noise(SMALL, 1, index)
            attributes = {"spp": 1, "seed": 0, "seeds": str(index + 1), "plan": plan}
            attributes |= {"part": f"{index + 1}/{parts}", "rfilter": "box"}
            data = encode_exr(one.channels, attributes)
            (folder / f"{index:06d}.exr").write_bytes(data)
        files = [str(path) for path in sorted(folder.iterdir())]
        started = time.process_time()
        if main.main(["merge", *files, "-q", "-o", str(folder / "out.exr")]):
            sys.exit(1)
        seconds = time.process_time() - started
    print(f"merge of {parts} files of 8 x 6 pixels: {seconds:.1f} s of processor time")


def run() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", type=int, default=10_000)
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    args = parser.parse_args()
    messages(args.parts, (args.height, args.width))
    merge(args.parts)
    scheduler(args.parts)


if __name__ == "__main__":
    run()
