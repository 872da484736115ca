"""What 10 000 parts cost besides rendering: dask's scheduler, messages, merging, the checkpoint.

    python benchmarks/many_parts.py [--parts 10000] [--large 200] [--width 1920] [--height 1080]

A scheduler and workers of dask, each a process, and the loop of `rendering.farm` here: as many
parts whose sums are there already, once of small pictures, and `--large` parts of a film of the
size given. Told are the processor time of each part for the scheduler, for this process, which
merges, and for the workers, and the most memory that scheduler and this process took. For the film
of that size also the bytes of a message, and the time of adding, of encoding sums and picture, are
timed alone. Last, so many small files are merged by the command. `docs/many-machines.md` has the
figures.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np

from mitsuba_bezier.cli import main
from mitsuba_bezier.rendering.farm import Farm
from mitsuba_bezier.rendering.parts import Rendered, render_part
from mitsuba_bezier.rendering.passes import Pass
from mitsuba_bezier.rendering.picture import Picture, encode_sums
from mitsuba_bezier.rendering.plan import Plan, pass_seed
from mitsuba_bezier.verification.images import encode_exr

SMALL = (6, 8)


def noise(size: tuple[int, int], spp: int, seed: int) -> Pass:
    """Return a pass of noise."""
    rng = np.random.default_rng(seed)
    channels = {c: rng.random(size, dtype=np.float32) for c in "RGB"}
    return Pass(channels, np.full(size, spp, np.float32), spp, seed)


@cache
def one_pass(size: tuple[int, int]) -> Rendered:
    """Return the sums of a pass of noise."""
    return render_part(Plan(1, 1, 1), (0,), 0, {}, lambda spp, seed: noise(size, spp, seed))


def work(size: tuple[int, int], indices: tuple[int, ...]) -> Rendered:
    """Give sums that are there; it tells that each pass takes long, so that parts stay small."""
    seeds = tuple(pass_seed(0, index) for index in indices)
    return dataclasses.replace(
        one_pass(size), indices=tuple(indices), seeds=seeds, spp=len(indices), seconds=1e9, cost=0.0
    )


def used(process: int) -> tuple[float, float]:
    """Return processor time and the most memory, in seconds and MB, of a process."""
    stat = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    status = Path(f"/proc/{process}/status").read_text()
    most = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK"), int(most.split()[1]) / 1e3


def scheduler(parts: int, size: tuple[int, int], workers: int, direct: bool) -> None:
    """Tell the cost of parts that take no time, by processes of their own."""
    import many_parts  # workers know this module by its name
    from distributed import Client
    from distributed.deploy.subprocess import SubprocessCluster

    where = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    os.environ["PYTHONPATH"] = where
    plan = Plan(parts, 1, 1)
    picture = Picture(plan)
    with (
        SubprocessCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=None,
            worker_kwargs={"memory_limit": 0},
            silence_logs=50,
        ) as cluster,
        Client(cluster) as client,
    ):
        client.wait_for_workers(workers)
        processes = list(client.run(os.getpid).values())
        boss = client.run_on_scheduler(os.getpid)
        farm = Farm(client, many_parts.work, size, picture, 0, {}, size, print, direct)
        began = [used(process)[0] for process in (boss, *processes)]
        started, wall, before = time.process_time(), time.perf_counter(), used(os.getpid())[1]
        farm.run(range(parts), lambda _: False, lambda: None)
        seconds, wall = time.process_time() - started, time.perf_counter() - wall
        found = [used(process) for process in (boss, *processes)]
    assert picture.complete
    spent = [after[0] - first for first, after in zip(began, found)]
    mine = used(os.getpid())[1]
    print(
        f"{parts} parts of {size[1]} x {size[0]}, {workers} workers: processor time of the "
        f"scheduler {1e3 * spent[0] / parts:.2f} ms a part, {spent[0]:.1f} s in all, of this "
        f"process {1e3 * seconds / parts:.2f} ms, {seconds:.1f} s, of the workers "
        f"{1e3 * sum(spent[1:]) / parts:.2f} ms; by the clock {wall:.1f} s; the most memory: "
        f"scheduler {found[0][1]:.0f} MB, this process {mine:.0f} MB, {before:.0f} before",
        flush=True,
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
    parser.add_argument("--large", type=int, default=200, help="parts of the film of that size")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--indirect", action="store_true", help="sums through the scheduler")
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    args = parser.parse_args()
    size = args.height, args.width
    if args.parts:
        messages(args.parts, size)
        merge(args.parts)
        scheduler(args.parts, SMALL, args.workers, not args.indirect)
    if args.large:
        scheduler(args.large, size, args.workers, not args.indirect)


if __name__ == "__main__":
    run()
