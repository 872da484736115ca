"""Send signals to the program at many moments from its start to its end, and look at what is left.

    python benchmarks/signals.py [--moments 40] [--command render|merge|convert|doctor]

For each of SIGINT, SIGTERM and SIGKILL the program is started anew for each moment, in a folder
with an old result, and gets the signal after a share of the time that it takes undisturbed. Counted
are exit codes, lines on standard error, tracebacks, results that are neither the old nor a whole
new file, temporary files, and processes that live on. `docs/reliability.md` has the table.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
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
from mitsuba_bezier.verification import png
from mitsuba_bezier.verification.images import read_image, write_exr

ROOT = Path(mb.__file__).resolve().parents[1]
SIGNALS = ("SIGINT", "SIGTERM", "SIGKILL")
OLD = b"old"

SCENE = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="256"/><integer name="height" value="256"/>
      <rfilter type="box"/></film>
  </sensor>
  <shape type="beziertriangle"><string name="filename" value="ball.vtu"/></shape>
  <emitter type="constant"/>
</scene>
"""
#: Arguments of each command, and the files that it writes.
COMMANDS = {
    "render": (
        ["render", "ball.xml", "-q", "--spp", "64", "-o", "out.exr"],
        ["out.exr", "out.png"],
    ),
    "merge": (["merge", "a.exr", "b.exr", "-q", "-o", "out.exr"], ["out.exr"]),
    "convert": (["convert", "part.step", "out.vtu", "-q"], ["out.vtu"]),
    "doctor": (["doctor"], []),
}


def prepare(folder: Path) -> None:
    """Write what the commands read."""
    mb.save(mb.sphere(), folder / "ball.vtu")
    (folder / "ball.xml").write_text(SCENE)
    for seed in (1, 2):
        pixels = {c: np.zeros((2048, 2048), np.float32) + seed for c in "RGB"}
        write_exr(folder / f"{'_ab'[seed]}.exr", pixels, {"spp": 1, "seed": seed})


def whole(path: Path) -> bool:
    """Tell whether a file is one that the program has finished."""
    try:
        if path.suffix == ".exr":
            return bool(read_image(path).channels)
        if path.suffix == ".png":
            return bool(png.decode(path.read_bytes(), path.name).size)
        return len(mb.load(path)) > 0
    except BezierError:
        return False


def alive(session: int) -> int:
    """Return how many processes of a session live."""
    count = 0
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        count += int(fields[3]) == session and fields[0] not in "ZX"
    return count


def one(words: list[str], outputs: list[str], folder: Path, name: str, wait: float) -> Counter:
    """Start the program, send a signal, and count what was seen."""
    for output in outputs:
        (folder / output).write_bytes(OLD)
    temporary = folder / "temporary"
    temporary.mkdir(exist_ok=True)
    before = set(os.listdir(folder))
    process = subprocess.Popen(
        [program(), *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        start_new_session=True,
    )
    time.sleep(wait)
    number = getattr(signal, name)
    process.send_signal(number)
    _out, error = process.communicate(timeout=300)
    for _ in range(50):  # children learn of it from a pipe, and have five seconds to go
        left = alive(process.pid)
        if not left:
            break
        time.sleep(0.1)
    if left:
        os.killpg(process.pid, signal.SIGKILL)
    code = process.returncode
    seen: Counter = Counter()
    seen["finished" if code == 0 else f"exit {code}"] += 1
    seen["children"] += left
    lines = error.decode(errors="replace").splitlines()
    seen["traceback"] += any("Traceback" in line for line in lines)
    seen["several lines"] += len(lines) > 1
    for output in outputs:
        path = folder / output
        state = "old" if path.read_bytes() == OLD else "new" if whole(path) else "BROKEN"
        seen[state] += 1
    seen["temporary"] += len(set(os.listdir(folder)) - before) + len(os.listdir(temporary))
    for path in [*(folder / n for n in set(os.listdir(folder)) - before), *temporary.iterdir()]:
        subprocess.run(["rm", "-rf", str(path)], check=True)
    return seen


def program() -> str:
    """Return the program of the Python that runs this."""
    return str(Path(sys.executable).parent / "mitsuba-bezier")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=40)
    parser.add_argument("--command", choices=COMMANDS, default="render")
    parser.add_argument("--signals", nargs="*", default=SIGNALS)
    parser.add_argument("--step", type=Path, help="a STEP file, for convert")
    args = parser.parse_args()
    words, outputs = COMMANDS[args.command]
    console = Console(width=160)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        if args.step:
            (folder / "part.step").write_bytes(args.step.read_bytes())
        times = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([program(), *words], cwd=folder, check=True, capture_output=True)
            times.append(time.perf_counter() - start)
        duration = statistics.median(times)
        table = Table("signal", "moments", "seen", title=f"{shown(words)}: {duration:.2f} s")
        for name in args.signals:
            total: Counter = Counter()
            for k in range(args.moments):
                wait = duration * 1.05 * k / max(args.moments - 1, 1)
                seen = one(words, outputs, folder, name, wait)
                if any(seen[bad] for bad in ("traceback", "several lines", "BROKEN", "children")):
                    console.print(f"{name} after {wait:.3f} s: {dict(seen)}")
                total += seen
            found = ", ".join(f"{key} {count}" for key, count in sorted(total.items()) if count)
            table.add_row(name, str(args.moments), found)
        console.print(table)


def shown(words: list[str]) -> str:
    """Return a command as one types it."""
    return " ".join(["mitsuba-bezier", *words])


if __name__ == "__main__":
    main()
