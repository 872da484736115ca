"""Tests and benchmarks of the CUDA variants on a bare machine, unattended, in ten minutes.

On a machine with a network, make a folder with all wheels, for the same Python and system::

    python benchmarks/gpu.py --pack wheels

Carry the checkout with that folder to the machine with the GPU, which needs Python and its driver,
and no network::

    python benchmarks/gpu.py --wheels wheels --out results [--minutes 10]

It makes a virtual environment in a folder that goes afterwards, then takes these steps, each in a
share of the time that is left. One that fails or takes too long does not keep the others from
theirs:

* *device*: name, driver and memory, by ``nvidia-smi``, and a first render by ``cuda_ad_rgb``;
* *rays*: ``speed.py --variant cuda_ad_rgb --large``, tables ``rays``, ``batch`` and ``compile``;
* *tests*: those of kernels and plugins on CUDA arrays (``MITSUBA_BEZIER_BACKEND=cuda``);
* *render*: the tables ``render`` and ``memory``.

``results/summary.md`` says what each step gave, beside the logs, the numbers as JSON, and the
results of the tests as JUnit. The program ends with 1 if a step failed. ``--backend llvm --tiny``
tries all of that without a GPU. Only the standard library is needed to begin with.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: What a render needs to be right on the device: a sphere, its outline and a mirror in it.
FIRST = """
import mitsuba_bezier as mb
import mitsuba as mi
import numpy as np
mi.set_variant(VARIANT)
ball = mb.sphere().control_points.astype(np.float32)
shape = {"type": "beziertriangle", "control_points": mi.TensorXf(ball.ravel(), shape=ball.shape)}
ray = mi.Ray3f(mi.Point3f(0, 0, 5), mi.Vector3f(0, 0, -1))
hit = mi.load_dict({"type": "scene", "shape": shape}).ray_intersect(ray)
assert abs(float(np.asarray(hit.t).ravel()[0]) - 4) < 1e-5, hit.t
image = np.array(mi.render(mi.load_dict(mb.scene(mb.sphere(), size=(64, 64), spp=16))))
assert np.isfinite(image).all() and image[..., :3].std() > 0.01
print("first render:", image.shape, "mean", image[..., :3].mean())
"""


@dataclass
class Run:
    """A run of all steps: where it writes, and until when."""

    python: Path
    out: Path
    backend: str
    tiny: bool
    end: float  #: by the monotonic clock
    rows: list[tuple[str, str, float]] = field(default_factory=list)

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return max(0.0, self.end - time.monotonic())

    def step(self, name: str, command: list[str], share: float) -> bool:
        """Run a command in a share of the time that is left, with its output in a file."""
        limit = share * self.left
        variables = {**os.environ, "MITSUBA_BEZIER_BACKEND": self.backend, "COLUMNS": "200"}
        start = time.monotonic()
        with open(self.out / f"{name}.log", "w") as log:
            # a session of its own: what it started goes with it
            process = subprocess.Popen(
                command,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=ROOT,
                env=variables,
                start_new_session=True,
            )
            try:
                code = process.wait(limit)
                said = "done" if code == 0 else f"failed, exit code {code}"
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                code, said = 1, f"ended after {limit:.0f} s, its share of the time"
        self.rows.append((name, said, time.monotonic() - start))
        print(f"{name}: {said}", flush=True)
        self.write_summary()
        return code == 0

    def write_summary(self) -> None:
        """Write what is known so far; a machine may be taken away at any time."""
        lines = ["# CUDA" if self.backend == "cuda" else "# A trial without CUDA", ""]
        lines += [f"Python {platform.python_version()}, {platform.platform()}", ""]
        lines += ["| step | result | s |", "| --- | --- | ---: |"]
        lines += [f"| {name} | {said} | {seconds:.0f} |" for name, said, seconds in self.rows]
        for log, find in self.found().items():
            lines += ["", f"## {log}", "", *find]
        (self.out / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def found(self) -> dict[str, list[str]]:
        """Return of each log what a reader wants to see first."""
        picks: dict[str, Callable[[str], list[str]]] = {
            "device": lambda text: ["```", *text.splitlines()[-12:], "```"],
            "tests": lambda text: [
                *re.findall(r"^(?:FAILED|ERROR) .*", text, re.M)[:40],
                *text.splitlines()[-1:],
            ],
            "rays": lambda text: text.splitlines(),
            "render": lambda text: text.splitlines(),
        }
        logs = {name: self.out / f"{name}.log" for name in picks}
        texts = {
            name: log.read_text(errors="replace") for name, log in logs.items() if log.exists()
        }
        return {name: picks[name](text) for name, text in texts.items() if text.strip()}


def pack(folder: Path) -> None:
    """Fill a folder with the wheels of the project, its tests and what they need."""
    pip = [sys.executable, "-m", "pip"]
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run([*pip, "wheel", "-q", "--no-deps", "-w", str(folder), str(ROOT)], check=True)
    subprocess.run([*pip, "download", "-q", "-d", str(folder), f"{ROOT}[test]"], check=True)
    size = sum(p.stat().st_size for p in folder.iterdir())
    print(f"{folder}: {len(list(folder.iterdir()))} files, {size / 1e6:.0f} MB")


def environment(folder: Path, wheels: Path | None, out: Path) -> Path:
    """Make a virtual environment with the package and its tests; return its Python."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    source = [] if wheels is None else ["--no-index", "--find-links", str(wheels.resolve())]
    what = f"{ROOT}[test]" if wheels is None else "mitsuba-bezier[test]"
    command = [str(python), "-m", "pip", "install", "-q", *source, what]
    with open(out / "environment.log", "w") as log:
        done = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT)
    if done.returncode:
        raise SystemExit(f"the environment was not made: see {out / 'environment.log'}")
    return python


def take_steps(run: Run) -> bool:
    """Take all steps; tell whether none failed."""
    python, variant = str(run.python), f"{run.backend}_ad_rgb"
    smi = "nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv"
    first = FIRST.replace("VARIANT", repr(variant))
    look = smi if run.backend == "cuda" else "echo no GPU asked for"
    good = run.step("device", ["sh", "-ec", f'{look}; "$0" -c "$1"', python, first], 0.3)
    if not good:  # the others would fail for the same reason
        return False
    speed = [python, "benchmarks/speed.py", "--variant", variant, "--markdown"]
    speed += ["--tiny"] if run.tiny else ["--large", "--runs", "3", "--renders", "2"]
    rays = [*speed, "--tables", "rays,batch,compile", "--json", str(run.out / "rays.json")]
    good &= run.step("rays", rays, 0.45)
    tests = [python, "-m", "pytest", "-q", "-x" if run.tiny else "--maxfail=50", "-n", "2"]
    tests += ["-p", "no:cacheprovider", f"--junitxml={run.out / 'tests.xml'}"]
    tests += ["tests/kernels/test_march.py"] if run.tiny else ["tests/kernels", "tests/plugins"]
    good &= run.step("tests", tests, 0.75)
    render = [*speed, "--tables", "render,memory", "--json", str(run.out / "render.json")]
    return run.step("render", render, 1.0) and good


def main() -> None:
    """Pack wheels, or take all steps."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--pack", metavar="FOLDER", type=Path, help="fill a folder with wheels")
    parser.add_argument("--wheels", type=Path, help="the folder; without it pip uses the network")
    parser.add_argument("--out", type=Path, default=Path("results"), help="results (results)")
    parser.add_argument("--minutes", type=float, default=10.0, help="at most so long (10)")
    parser.add_argument("--backend", choices=("cuda", "llvm"), default="cuda")
    parser.add_argument("--tiny", action="store_true", help="a trial run: all steps, no meaning")
    options = parser.parse_args()
    if options.pack:
        pack(options.pack)
        return
    if options.wheels and not options.wheels.is_dir():
        parser.error(f"--wheels: expected a folder that --pack filled, got {options.wheels}")
    end = time.monotonic() + 60 * options.minutes
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        python = environment(Path(folder), options.wheels, out)
        run = Run(python, out, options.backend, options.tiny, end)
        good = take_steps(run)
    record = [{"step": a, "result": b, "seconds": round(c, 1)} for a, b, c in run.rows]
    (out / "summary.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    print(f"{out / 'summary.md'} says what was found")
    raise SystemExit(0 if good else 1)


if __name__ == "__main__":
    main()
