"""Registers and spills of the kernels on NVIDIA's GPUs, from NVIDIA's assembler; no GPU is needed.

    pip install ".[ptxas]"                    the assembler, from PyPI
    python benchmarks/ptxas.py                the table of benchmarks/README.md
    python benchmarks/ptxas.py --targets sm_86,sm_120 --cases "torus, closest"

The stand-in for CUDA's driver of ``tests/cuda_standin`` writes down what Dr.Jit generates for each
target, and `ptxas -v` assembles it. Linux on x86-64 and gcc are needed. Registers of a thread tell
how many can be under way at once (a multiprocessor has 65 536), spills what goes to memory and back
for want of them. The exit code is 1 if something is not assembled.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from cuda_standin.standin import KNOWN, StandIn, reason_without

TARGETS = ("sm_75", "sm_86", "sm_90")
#: `cuda_standin.cases`: all surfaces, and instances.
CASES = (
    *("tetrahedral", "octants", "capped cone", "inverted", "general", "torus", "infinity"),
    *("several kinds", "trims", "instances"),
)
#: Version of the driver that Dr.Jit is told: its PTX must not be newer than the assembler.
DRIVER = 12090


class MissingError(Exception):
    """What the benchmark needs is not there."""


def assembler() -> str:
    """Return the path of `ptxas`: of the wheel or, without it, of the PATH."""
    try:
        found = importlib.util.find_spec("nvidia.cuda_nvcc")
    except ModuleNotFoundError:
        found = None
    for folder in (found.submodule_search_locations or ()) if found else ():
        path = Path(folder) / "bin" / "ptxas"
        if path.is_file():
            return str(path)
    path = shutil.which("ptxas")
    if path is None:
        raise MissingError(
            "ptxas: expected the wheel nvidia-cuda-nvcc-cu12, or ptxas on the PATH, found neither: "
            'pip install "mitsuba-bezier[ptxas]"'
        )
    return path


def assemble(ptxas: str, path: Path, target: str) -> dict[str, int]:
    """Assemble a kernel; return its registers, and the bytes of its stack and spills."""
    with tempfile.NamedTemporaryFile(suffix=".cubin") as out:
        command = [ptxas, "-v", f"-arch={target}", "-o", out.name, str(path)]
        run = subprocess.run(command, capture_output=True, text=True)
    log = run.stdout + run.stderr
    if run.returncode:
        raise RuntimeError(f"{path}: {log}")

    def number(pattern: str) -> int:
        found = re.search(pattern, log)
        return int(found[1]) if found else 0

    return {
        "registers": number(r"Used (\d+) registers"),
        "stack": number(r"(\d+) bytes stack frame"),
        "spill_stores": number(r"(\d+) bytes spill stores"),
        "spill_loads": number(r"(\d+) bytes spill loads"),
        "shared": number(r"(\d+) bytes smem"),
        "ptx_bytes": path.stat().st_size,
    }


def measure(ptxas: str, target: str, cases: list[str]) -> dict[str, dict[str, int]]:
    """Return for each case the numbers of its largest kernel."""
    with tempfile.TemporaryDirectory() as name:
        stand_in = StandIn(Path(name))
        os.environ["CUDA_STANDIN_CC"] = target.removeprefix("sm_")
        os.environ["CUDA_STANDIN_VERSION"] = str(DRIVER)
        folder, _ = stand_in.run("cases", "out", cases, runs=False)
        result = {}
        for case in cases:
            kernels = [
                path
                for path in (folder / case).glob("*.ptx")
                if ".entry drjit_" in path.read_text(encoding="utf-8")
            ]
            largest = max(kernels, key=lambda path: path.stat().st_size)
            result[case] = assemble(ptxas, largest, target)
        return result


def table(numbers: dict[str, dict[str, dict[str, int]]]) -> str:
    """Lay out a table: registers, and spills where there are any."""
    targets = list(numbers)
    lines = [
        f"| kernel | PTX, kB | {' | '.join(targets)} |",
        "| --- | --- |" + " --- |" * len(targets),
    ]
    for case, first in numbers[targets[0]].items():
        cells = []
        for target in targets:
            x = numbers[target][case]
            spills = f", spills {x['spill_stores']} + {x['spill_loads']} bytes"
            local = f", {x['shared']} bytes shared" if x["shared"] else ""
            cells.append(f"{x['registers']}{spills if x['spill_stores'] else ''}{local}")
        lines.append(f"| {case} | {first['ptx_bytes'] / 1000:.0f} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    every = [f"{case}, {kind}" for case in CASES for kind in ("closest", "any")]
    parser.add_argument("--targets", default=",".join(TARGETS), help="sm_75,sm_86,sm_90")
    parser.add_argument(
        "--cases", nargs="*", default=every, metavar="CASE", help='such as "torus, any"; all'
    )
    parser.add_argument("--json", metavar="FILE", help="write the numbers, too")
    args = parser.parse_args()
    targets = args.targets.split(",")
    for target in targets:
        if not re.fullmatch(r"sm_\d+", target):
            parser.error(f"--targets: expected names as sm_86, got {target!r}")
    unknown = set(args.cases) - set(every)
    if unknown:
        parser.error(f"--cases: expected some of {every}, got {sorted(unknown)}")
    try:
        if reason := reason_without():
            raise MissingError(reason)
        ptxas = assembler()
    except MissingError as error:
        print(f"ptxas.py: {error}", file=sys.stderr)
        return 2
    try:
        numbers: dict[str, Any] = {x: measure(ptxas, x, args.cases) for x in targets}
    except RuntimeError as error:
        print(f"ptxas.py: not assembled: {error}", file=sys.stderr)
        return 1
    try:
        wheel = version("nvidia-cuda-nvcc-cu12")
    except PackageNotFoundError:
        wheel = "of the PATH"
    print(f"registers of a thread; ptxas {wheel}, Dr.Jit {version('drjit')} (known: {KNOWN})\n")
    print(table(numbers))
    if args.json:
        Path(args.json).write_text(json.dumps(numbers, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
