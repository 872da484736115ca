"""Render by four workers, of which one is killed, one is stopped, and one sends damaged bytes.

    python benchmarks/many_workers.py [--spp 4096] [--whole] [--bad killed stopped damaged]

The scene is rendered by one process, by four workers that nothing disturbs, and by four with one
of each kind of harm done to them after the first part has come. Told are the time of each, and how
many numbers of the pictures differ: it must be none. Linux only. `docs/many-machines.md` has the
figures.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from signals import SCENE

import mitsuba_bezier as mb
from mitsuba_bezier.cli import main
from mitsuba_bezier.verification.images import read_image


def damage() -> None:
    """Let a worker flip a bit in the sums that it sends."""
    from mitsuba_bezier.cli import _worker

    real = _worker.render_part

    def damaged(*arguments: Any) -> Any:
        rendered = real(*arguments)
        rendered.sums["sum1.R"].view(np.uint32)[5, 6] ^= 1
        return rendered

    _worker.render_part = damaged


def process_of(client: Any, address: str) -> int:
    """Return the number of a worker's process."""
    return int(client.run(os.getpid, workers=[address])[address])


def harm(client: Any, kinds: list[str], out: Path, told: list[str]) -> None:
    """Do harm to one worker for each kind, once there is a first picture."""
    workers = sorted(client.scheduler_info(n_workers=-1)["workers"])
    numbers = {address: process_of(client, address) for address in workers}
    if "damaged" in kinds:
        client.run(damage, workers=[workers[2]])
        told.append(f"{workers[2]} damages")
    while not out.with_suffix(".sums.exr").exists():
        time.sleep(0.05)
    time.sleep(1)
    if "killed" in kinds:
        os.kill(numbers[workers[0]], signal.SIGKILL)
        told.append(f"{workers[0]} killed")
    if "stopped" in kinds:
        os.kill(numbers[workers[1]], signal.SIGSTOP)
        told.append(f"{workers[1]} stopped")


def render(folder: Path, name: str, *words: str) -> float:
    """Render, and return the seconds that it took."""
    started = time.perf_counter()
    flags = ["-o", str(folder / f"{name}.exr"), "-m", "llvm_ad_rgb", "--spp-per-pass", "16"]
    if main.main(["render", str(folder / "ball.xml"), *flags, *words]):
        sys.exit(1)
    return time.perf_counter() - started


def differ(folder: Path, a: str, b: str) -> int:
    """Return how many numbers of two pictures differ."""
    one, two = (read_image(folder / f"{name}.exr").channels for name in (a, b))
    return sum(int(np.count_nonzero(one[name] != two[name])) for name in one)


def run() -> None:
    """Render and tell."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--spp", type=int, default=4096)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--bad", nargs="*", default=["killed", "stopped", "damaged"])
    parser.add_argument("--whole", action="store_true", help="also by workers that all are well")
    args = parser.parse_args()
    from distributed import Client, LocalCluster

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mb.save(mb.sphere(), folder / "ball.vtu")
        (folder / "ball.xml").write_text(SCENE)
        spp = ("--spp", str(args.spp))
        render(folder, "first", "--spp", "16")  # compiles
        print(f"one process: {render(folder, 'one', *spp, '-q'):.1f} s")
        if args.whole:
            seconds = render(folder, "well", *spp, "--workers", str(args.workers))
            print(
                f"{args.workers} workers, start included: {seconds:.1f} s, "
                f"{differ(folder, 'one', 'well')} numbers differ"
            )
        cluster = LocalCluster(
            n_workers=args.workers, threads_per_worker=1, dashboard_address=None, memory_limit=0
        )
        with cluster, Client(cluster) as client:
            told: list[str] = []
            arguments = (client, args.bad, folder / "many.exr", told)
            thread = threading.Thread(target=harm, args=arguments, daemon=True)
            # the workers know the package only then, which the harm needs
            thread.start()
            seconds = render(
                folder, "many", *spp, "--scheduler", cluster.scheduler_address, "--save-every", "0"
            )
            print(
                f"{', '.join(told)}: {seconds:.1f} s, "
                f"{differ(folder, 'one', 'many')} numbers differ"
            )
            for address, info in client.scheduler_info(n_workers=-1)["workers"].items():
                print(" ", address, info.get("status"))
            os._exit(0) if "stopped" in args.bad else None  # it would be waited for


if __name__ == "__main__":
    run()
