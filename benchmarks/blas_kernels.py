"""Run the tests of the geometry, and render the gallery, under each BLAS kernel of the processor.

    python benchmarks/blas_kernels.py                 # tests and gallery, a table
    python benchmarks/blas_kernels.py --scenes        # the gallery alone, 16 x 16 pixels
    python benchmarks/blas_kernels.py --files A.stp B.igs   # depth images of files, too
    python benchmarks/blas_kernels.py --other         # the tests under one other kernel, as CI does

NumPy's OpenBLAS has kernels for many processors, which round differently; ``OPENBLAS_CORETYPE``
tells which to take, and threadpoolctl which one runs. Nothing that is found may depend on it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KERNELS = ("Haswell", "SkylakeX", "Zen", "Prescott")
#: The first of them that is another than the default is what CI takes.
OTHERS = ("Haswell", "SkylakeX", "Prescott")
#: The tests of what rests on linear algebra: geometry, leaves and the kernels that meet them.
TESTS = (
    "conics",
    "covers",
    "degenerate_nets",
    "inverted_leaves",
    "kernels",
    "leaf_nets",
    "projective",
    "quadric_groups",
    "quadric_patches",
    "quadric_types",
    "quadrics",
    "rough_blas",
    "section_leaves",
    "shapes",
)

PROBE = """
import threadpoolctl, numpy as np
a = np.arange(4096.0).reshape(64, 64) % 7 + np.eye(64)
np.linalg.svd(a @ a)
print(*{x.get("architecture", x["internal_api"]) for x in threadpoolctl.threadpool_info()
        if x["user_api"] == "blas" and "numpy" in x["filepath"]} or {"unknown"})
"""
RENDER = """
import sys, numpy as np, mitsuba as mi, mitsuba_bezier as mb
mi.set_variant("llvm_ad_rgb")
scene = mi.load_file(sys.argv[1], width="16", height="16", spp="1")
assert np.isfinite(np.array(mi.render(scene))).all()
"""
DEPTH = """
import sys, numpy as np, mitsuba as mi, mitsuba_bezier as mb
mi.set_variant("llvm_ad_rgb")
shape = mi.load_dict({"type": "beziertriangle", "filename": sys.argv[1]})
box = np.array([shape.bbox().min, shape.bbox().max], dtype=float)
middle, size = box.mean(axis=0), np.linalg.norm(box[1] - box[0])
x, y = np.meshgrid(*[(np.arange(64) + 0.5) / 32 - 1] * 2)
d = np.array([0.48, 0.64, -0.6])
across = np.array([[0.8, -0.6, 0], [0.36, 0.48, 0.8]]) * size / 2
o = middle - size * d + x.ravel()[:, None] * across[0] + y.ravel()[:, None] * across[1]
si = shape.ray_intersect(mi.Ray3f(mi.Point3f(*o.T.astype(np.float32)), mi.Vector3f(*d.tolist())))
t, hit = np.array(si.t), np.array(si.is_valid())
assert hit.any() and np.isfinite(np.array(si.p)[:, hit]).all()
print(hit.sum(), "hits, mean depth", round(float(t[hit].mean() / size), 6))
"""


def python(*arguments: str, kernel: str | None = None) -> subprocess.CompletedProcess[str]:
    """Run Python under a kernel, None for what runs here without being asked for."""
    environment = os.environ | ({} if kernel is None else {"OPENBLAS_CORETYPE": kernel})
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True
    )


def runs(kernel: str | None) -> str | None:
    """Return what runs if this kernel is asked for, as threadpoolctl calls it; None if it cannot.

    Some builds have one kernel for several processors: Zen's is Haswell's in NumPy's wheels.
    """
    found = python("-c", PROBE, kernel=kernel)
    return found.stdout.strip() if found.returncode == 0 else None


def other(default: str | None) -> str | None:
    """Return a kernel that the processor can run and that is not what runs by default."""
    return next((k for k in OTHERS if runs(k) not in (None, default)), None)


def tests(workers: int) -> list[str]:
    files = [str(next(ROOT.glob(f"tests/*/test_{name}.py"))) for name in TESTS]
    return ["-m", "pytest", "-q", "-n", str(workers), "-p", "no:cacheprovider", *files]


def last_line(run: subprocess.CompletedProcess[str]) -> str:
    lines = (run.stdout.strip() or run.stderr.strip()).splitlines()
    return lines[-1].strip("= ") if lines else f"exit code {run.returncode}"


def run_other(workers: int) -> int:
    """Run the tests under another kernel than the default."""
    default = runs(None)
    kernel = other(default)
    if kernel is None:
        print(f"BLAS kernel by default: {default}; no other can run here")
        return 0
    print(f"BLAS kernel by default: {default}; now: {kernel}, runs: {runs(kernel)}", flush=True)
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    return subprocess.run([sys.executable, *tests(workers)], cwd=ROOT, env=environment).returncode


def main() -> int:
    """Print the table; the exit code is 1 if something failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--other", action="store_true", help="tests, under one other kernel")
    parser.add_argument("--scenes", action="store_true", help="only the gallery")
    parser.add_argument("--files", nargs="+", default=[], metavar="FILE", help="depth images, only")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    if arguments.other:
        return run_other(arguments.workers)
    jobs: list[tuple[str, list[str]]] = []
    files = [str(Path(f).resolve()) for f in arguments.files]
    if not files:
        scenes = sorted(str(f) for f in (ROOT / "scenes").glob("*.xml"))
        jobs += [(Path(f).name, ["-c", RENDER, f]) for f in scenes]
    if not files and not arguments.scenes:
        jobs.append(("tests", tests(arguments.workers)))
    jobs += [(Path(f).name, ["-c", DEPTH, f]) for f in files]
    found = {k: runs(k) for k in KERNELS}
    kernels = [k for k in KERNELS if found[k] is not None]
    names = ", ".join(f"{k} (runs: {found[k]})" for k in kernels)
    print(f"default: {runs(None)}; the processor can run {names}")
    print(f"| | {' | '.join(kernels)} |\n|{' --- |' * (len(kernels) + 1)}", flush=True)
    failed = 0
    for name, command in jobs:
        cells = []
        for kernel in kernels:
            run = python(*command, kernel=kernel)
            failed += run.returncode != 0
            word = "" if run.returncode else "ok "
            said = run.returncode or name == "tests" or files
            cells.append((word + last_line(run) if said else "ok").strip())
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
