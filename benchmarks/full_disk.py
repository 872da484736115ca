"""Write to disks of every size, from empty to large enough: `python benchmarks/full_disk.py`.

A tmpfs with an old picture is made for each size, in a mount namespace of its own (Linux, root),
and a render and a merge write to it. Whatever the size, the exit code is 0 and the new file whole,
or it is 2 and the old file there to the bit; nothing else is left. Prints how many were which.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from signals import SCENE, program, whole

import mitsuba_bezier as mb
from mitsuba_bezier.verification.images import write_exr

PAGE = 4096


def main() -> None:
    """Print a line for each command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--step", type=int, default=1, help="pages from one size to the next")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.inside:
        work(args.inside, args.step)
        return
    with tempfile.TemporaryDirectory() as name:
        again = [sys.executable, __file__, "--inside", name, "--step", str(args.step)]
        subprocess.run(["unshare", "--mount", *again], check=True)


def work(folder: Path, step: int) -> None:
    """Do what the module says, within the namespace."""
    (folder / "ball.xml").write_text(SCENE.replace('"256"', '"96"'))
    mb.save(mb.sphere(), folder / "ball.vtu")
    rng = np.random.default_rng(0)
    for seed in (1, 2):
        pixels = {c: rng.random((64, 64)).astype(np.float32) for c in "RGB"}
        write_exr(folder / f"part{seed}.exr", pixels, {"spp": 1, "seed": seed})
    disk = folder / "disk"
    disk.mkdir()
    parts = [str(folder / f"part{seed}.exr") for seed in (1, 2)]
    for words in (
        ["render", str(folder / "ball.xml"), "-q", "--spp", "1", "-o", str(disk / "out.exr")],
        ["merge", *parts, "-q", "-o", str(disk / "out.exr")],
    ):
        seen: Counter[str] = Counter()
        pages = 2
        while not seen["written"] or seen["written"] < 3:
            subprocess.run(
                ["mount", "-t", "tmpfs", "-o", f"size={pages * PAGE}", "none", str(disk)],
                check=True,
            )
            try:
                (disk / "out.exr").write_bytes(b"old")
                (disk / "out.png").write_bytes(b"old")
                done = subprocess.run([program(), *words], capture_output=True, text=True)
                seen[judge(disk, done)] += 1
            finally:
                subprocess.run(["umount", str(disk)], check=True)
            pages += step
        print(f"{words[0]}: {dict(seen)} of disks up to {(pages - step) * PAGE} bytes", flush=True)


def judge(disk: Path, done: subprocess.CompletedProcess[str]) -> str:
    """Say in words what happened."""
    if set(os.listdir(disk)) != {"out.exr", "out.png"}:
        return f"WRONG: {os.listdir(disk)}"
    old = {name: (disk / name).read_bytes() == b"old" for name in ("out.exr", "out.png")}
    if done.returncode == 0:
        good = not old["out.exr"] and whole(disk / "out.exr")
        return "written" if good else "WRONG: told as written"
    if done.returncode != 2 or done.stderr.count("\n") != 1:
        return f"WRONG: exit {done.returncode}, {done.stderr}"
    if all(old.values()):
        before = "free space" in done.stderr or "folder that can be written" in done.stderr
        return "refused before the work" if before else "an error, both old files there"
    if not old["out.exr"] and whole(disk / "out.exr") and "out.png" in done.stderr:
        return "an error of the preview, the new EXR whole"
    return f"WRONG: {old}, {done.stderr}"


if __name__ == "__main__":
    main()
