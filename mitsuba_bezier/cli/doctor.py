"""``mitsuba-bezier doctor``: what this machine has for rendering, and how to get what it lacks."""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from glob import glob
from importlib import import_module, metadata
from typing import Any

from .. import _llvm, _runtime
from .._children import program, python_command
from .._version import __version__
from ..errors import RuntimeSetupError
from ._limits import positive

__all__ = ["add_parser", "examine", "run"]

#: A variant starts if it computes this; minima and maxima are what old LLVMs abort at.
_TRIAL = """
import sys
from mitsuba_bezier import _runtime
try:
    _runtime.prepare()
    _runtime.check(sys.argv[1])
    import drjit as dr, mitsuba as mi
    mi.set_variant(sys.argv[1])
    x = mi.Float([1, 4, -2])
    low, high = dr.minimum(x, 3), dr.maximum(x, mi.Float([2, 2, 2]))
    if list(low) != [1, 3, -2] or list(high) != [2, 4, 2]:
        sys.exit("wrong results")
except Exception as error:
    sys.exit(" ".join(str(error).split()))
"""

_REQUIRED = ("mitsuba", "drjit", "numpy", "OpenEXR", "rich")
_WORKS = "works"


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "doctor",
        help="show what this machine has for rendering, and how to get what it lacks",
        description="Show the versions of everything a render needs and try each variant of "
        "Mitsuba. The exit code is 0 if at least one variant can render Bézier shapes, else 1.",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=positive,
        default=120.0,
        help="seconds that a variant may take to start (120)",
    )


def run(args: argparse.Namespace) -> int:
    """Print the findings; return 0 if a JIT variant works, else 1."""
    findings = examine(args.timeout)
    if args.json:
        print(json.dumps(findings, indent=2))
    else:
        _print(findings)
    return 0 if _WORKS in findings["variants"].values() else 1


def examine(timeout: float = 120.0) -> dict[str, Any]:
    """Return what was found, ready for JSON.

    Parameters
    ----------
    timeout : float
        Seconds that each variant may take to start.

    Returns
    -------
    dict
        ``versions`` by name (None where missing), ``llvm`` (``version``, ``path``, ``chosen_by``),
        ``libatomic`` and ``gpu`` (text or None), ``variants`` (by name: "works" or what went
        wrong), ``advice`` (a list of ``problem`` and ``command``).
    """
    versions: dict[str, str | None] = {
        "mitsuba_bezier": __version__,
        "python": platform.python_version(),
    }
    advice: list[dict[str, str]] = []

    def advise(problem: str, command: str) -> None:
        advice.append({"problem": problem, "command": command})

    for name in _REQUIRED:
        versions[name] = _version(name)
        if versions[name] is None:
            advise(f"the package {name} is missing", f"pip install {name}")
    for name in _llvm.WHEELS:  # either is one way among several
        versions[name] = _version(name)

    libatomic: str | None = "present"
    if sys.platform == "linux" and (error := _llvm.load_error("libatomic.so.1")):
        libatomic = None
        advise(f"Dr.Jit needs libatomic: {error}", _llvm.install_command("libatomic"))

    findings: dict[str, Any] = {
        "versions": versions,
        "llvm": {"version": None, "path": None, "chosen_by": None},
        "libatomic": libatomic,
        "gpu": None,
        "variants": {},
        "advice": advice,
    }
    try:
        mi = _runtime.import_mitsuba()
    except RuntimeSetupError as failure:
        if libatomic:
            advise(str(failure), "pip install --force-reinstall mitsuba")
        return findings

    problem = _runtime.version_problem()
    if problem:
        advise(problem.partition("; ")[0], _runtime.INSTALL_MITSUBA)
    version = _runtime.llvm_version()
    findings["llvm"] = {
        "version": version and ".".join(map(str, version)),
        "path": _runtime.llvm_path() if version else None,
        "chosen_by": _runtime.llvm_origin(),
    }
    problem = _runtime.llvm_problem()
    if problem:
        advise(problem, _llvm_remedy())
    findings["gpu"] = _gpu()
    if findings["gpu"] is None and _has_nvidia_card():
        advise(
            "an NVIDIA card, but no CUDA driver that Dr.Jit can use",
            _llvm.install_command("nvidia"),
        )
    hopeless = {
        "llvm_": problem and f"needs LLVM {_llvm.MINIMUM} or newer",
        "cuda_": findings["gpu"] is None and "needs an NVIDIA GPU and its driver",
    }
    names = [name for name in mi.variants() if name[:5] in hopeless]  # not scalar_*
    trials = [name for name in names if not hopeless[name[:5]]]
    # two at a time: most of a trial is the start of one process
    with ThreadPoolExecutor(max_workers=2) as pool:
        results = dict(zip(trials, pool.map(lambda name: _try(name, timeout), trials)))
    findings["variants"] = {name: results.get(name) or hopeless[name[:5]] for name in names}
    return findings


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _llvm_remedy() -> str:
    if _llvm.find() is not None and _runtime.variable_is_users():
        return f"unset {_runtime.VARIABLE}"
    return _llvm.install_command("llvm")


def _gpu() -> str | None:
    """Return the name of the GPU that Dr.Jit uses, and its CUDA version."""
    dr = import_module("drjit")
    if not dr.has_backend(dr.JitBackend.CUDA):
        return None
    query = [
        program("nvidia-smi") or "",
        "--query-gpu=name,driver_version",
        "--format=csv,noheader",
    ]
    try:
        name = subprocess.run(query, capture_output=True, text=True, timeout=30).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        name = ""
    cuda = ".".join(map(str, dr.detail.cuda_version()))
    return f"{name.splitlines()[0] if name else 'NVIDIA GPU'}, CUDA {cuda}"


def _has_nvidia_card() -> bool:
    for device in glob("/sys/bus/pci/devices/*"):
        try:
            with open(f"{device}/vendor") as vendor, open(f"{device}/class") as kind:
                # 0x10de: NVIDIA; class 0x03....: display controller
                if vendor.read().strip() == "0x10de" and kind.read().startswith("0x03"):
                    return True
        except OSError:
            continue
    return False


def _try(variant: str, timeout: float) -> str:
    """Run `_TRIAL` in a process of its own: what does not start may abort the process."""
    environment = dict(os.environ)
    if not _runtime.variable_is_users():  # the child is to make the same choice by itself
        environment.pop(_runtime.VARIABLE, None)
    try:
        done = subprocess.run(
            python_command(_TRIAL, variant),
            capture_output=True,
            text=True,
            timeout=timeout,
            env=environment,
        )
    except subprocess.TimeoutExpired:
        return f"did not start within {timeout:g} s"
    if done.returncode == 0:
        return _WORKS
    if done.returncode < 0:
        return f"aborted by {signal.Signals(-done.returncode).name}"
    lines = done.stderr.strip().splitlines()
    return lines[-1] if lines else f"exit code {done.returncode}"


def _print(findings: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()

    def row(table: Table, name: str, value: str | None, good: bool = True) -> None:
        table.add_row(name, Text(value or "missing", style="green" if good and value else "red"))

    table = Table("found", "", show_edge=False)
    for name, version in findings["versions"].items():
        if version or name in _REQUIRED:
            row(table, name, version)
    llvm = findings["llvm"]
    row(table, "LLVM", llvm["version"], good=_good_llvm(llvm["version"]))
    if llvm["path"]:
        row(table, "  path", llvm["path"])
        row(table, "  chosen by", llvm["chosen_by"])
    row(table, "libatomic", findings["libatomic"])
    table.add_row("GPU", findings["gpu"] or "none that Dr.Jit can use (not needed)")
    console.print(table)
    console.print()

    table = Table("variant", "", show_edge=False)
    for name, result in findings["variants"].items():
        row(table, name, result, good=result == _WORKS)
    if findings["variants"]:
        console.print(table)
        console.print()
    for item in findings["advice"]:
        console.print(Text(item["problem"]))
        console.print(Text(f"    {item['command']}", style="bold"), soft_wrap=True)
    if not findings["advice"]:
        console.print("Nothing is missing.")


def _good_llvm(version: str | None) -> bool:
    return version is not None and int(version.split(".")[0]) >= _llvm.MINIMUM
