"""End a render at random moments, look at what is there, let it go on, and compare the bits.

    python benchmarks/interrupted.py [--moments 10] [--signals SIGKILL SIGTERM SIGINT] [--disk]

For each signal and moment the program is started anew in an empty folder, and gets the signal
after a random share of the time that it takes undisturbed; the same command is repeated until it
ends by itself, each time with a new random moment for the first three. Counted are exit codes,
pictures that do not open, and pixels that differ from those of a render that nothing disturbed.
With ``--disk`` the folder is on disks (tmpfs, so Linux and root only) of many sizes, which get
full; the render then goes on where there is room. `docs/reliability.md` has the table.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.verification.images import read_image

SCENE = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="128"/><integer name="height" value="128"/>
      <rfilter type="box"/></film>
  </sensor>
  <shape type="beziertriangle"><string name="filename" value="ball.vtu"/></shape>
  <emitter type="constant"/>
</scene>
"""
WORDS = ["render", "ball.xml", "-q", "-o", "out.exr", "--spp-per-pass", "8"]


def program() -> str:
    """Return the program of the Python that runs this."""
    return str(Path(sys.executable).parent / "mitsuba-bezier")


def prepare(folder: Path) -> None:
    """Write the scene."""
    folder.mkdir(parents=True, exist_ok=True)
    mb.save(mb.sphere(), folder / "ball.vtu")
    (folder / "ball.xml").write_text(SCENE)


def start(folder: Path, spp: int, *more: str) -> subprocess.Popen[bytes]:
    """Start the render."""
    return subprocess.Popen(
        [program(), *WORDS, "--spp", str(spp), *more],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )


def opened(path: Path) -> int:
    """Return the samples of a picture, -1 if it does not open, 0 if it is not there."""
    if not path.exists():
        return 0
    try:
        return int(read_image(path).attributes["spp"])
    except BezierError:
        return -1


def differ(a: Path, b: Path) -> int:
    """Return how many numbers of two pictures differ, and some of their headers."""
    one, two = read_image(a), read_image(b)
    count = sum(
        int(np.count_nonzero(one.channels[name] != two.channels[name])) for name in one.channels
    )
    return count + sum(one.attributes[k] != two.attributes[k] for k in ("spp", "seeds", "passes"))


def interrupted(folder: Path, spp: int, name: str, seconds: float, reference: Path) -> Counter[str]:
    """Interrupt a render three times at random moments, let it end, and count what was seen."""
    prepare(folder)
    seen: Counter[str] = Counter()
    had = 0
    for attempt in range(100):
        process = start(folder, spp)
        if attempt < 3:
            time.sleep(random.uniform(0.0, seconds))
            process.send_signal(getattr(signal, name))
        _out, error = process.communicate(timeout=600)
        code = process.returncode
        seen["ended by itself" if code == 0 else f"exit {code}"] += 1
        seen["several lines or a traceback"] += len(error.splitlines()) > 1
        there = opened(folder / "out.exr")
        seen["pictures that do not open"] += there < 0
        seen["fewer samples than before"] += there < had
        seen["went on"] += attempt > 0 and had > 0
        had = max(had, there)
        if code == 0:
            break
    seen["numbers that differ"] += differ(reference, folder / "out.exr")
    seen["files left"] += len(os.listdir(folder)) - 4 - (name == "SIGKILL" and temporary(folder))
    shutil.rmtree(folder)
    return seen


def temporary(folder: Path) -> int:
    """Return the number of temporary files, which SIGKILL may leave."""
    return sum(name.endswith(".tmp") for name in os.listdir(folder))


def full_disk(folder: Path, spp: int, kilobytes: int, reference: Path) -> Counter[str]:
    """Render on a disk of a size, then go on where there is room."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
    subprocess.run(mount, check=True)
    seen: Counter[str] = Counter()
    large = folder.with_name("large")
    try:
        prepare(folder)
        process = start(folder, spp, "--save-every", "0")
        _out, _error = process.communicate(timeout=600)
        seen["ended by itself" if process.returncode == 0 else f"exit {process.returncode}"] += 1
        there = opened(folder / "out.exr")
        seen["pictures that do not open"] += there < 0
        seen["with samples"] += there > 0
        seen["temporary files"] += temporary(folder)
        shutil.copytree(folder, large)
    finally:
        subprocess.run(["umount", str(folder)], check=True)
    process = start(large, spp)
    process.communicate(timeout=600)
    seen["failed with room"] += process.returncode != 0
    seen["numbers that differ"] += differ(reference, large / "out.exr")
    shutil.rmtree(large)
    folder.rmdir()
    return seen


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=10)
    parser.add_argument("--spp", type=int, default=1028)
    parser.add_argument("--signals", nargs="*", default=["SIGKILL", "SIGTERM", "SIGINT"])
    parser.add_argument("--disk", action="store_true", help="full disks, too")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    args = parser.parse_args()
    random.seed(args.seed)
    results: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        prepare(root / "whole")
        for _ in range(2):  # the first compiles
            started = time.perf_counter()
            process = start(root / "whole", args.spp)
            process.communicate(timeout=600)
            seconds = time.perf_counter() - started
        reference = root / "whole/out.exr"
        for signal_name in args.signals:
            total: Counter[str] = Counter()
            for _ in range(args.moments):
                total.update(interrupted(root / "a", args.spp, signal_name, seconds, reference))
            results[signal_name] = total
        if args.disk:
            total = Counter()
            for kilobytes in range(20, 1400, 120):
                total.update(full_disk(root / "disk", args.spp, kilobytes, reference))
            results["full disk"] = total
    table = Table(title=f"{args.spp} spp, {seconds:.1f} s undisturbed")
    table.add_column("")
    for column in results:
        table.add_column(column, justify="right")
    for row in sorted({key for total in results.values() for key in total}):
        table.add_row(row, *(str(total[row]) for total in results.values()))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
