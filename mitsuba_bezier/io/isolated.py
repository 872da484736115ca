"""Readers that rest on large C++ libraries, run in a process of their own.

A damaged file can crash such a library, and with it the Python that called it. So the file is
read by a second Python, which hands its nets over in a file; if it dies, that is an error like
any other.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from importlib import import_module
from os import PathLike
from pathlib import Path

import numpy as np

from .._children import python_command
from ..errors import BezierError, FileFormatError
from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims
from .files import damaged, read_bytes
from .report import Model, Refusal, Report
from .trim_arrays import packed_trims, unpacked_trims

__all__ = ["read_isolated"]

#: Longest time to read a file, in seconds: this, and a second more for each 10 kB. Damaged files
#: can keep a library busy for ever; sound ones took a tenth of that.
TIME_LIMIT = 60

_MEMORY = 16 << 30  # address space beyond 100 times the size of the file, in bytes


def read_isolated(module: str, path: str | PathLike[str], trims: bool = False) -> Model:
    """Call ``read_here`` of a module of this package in a second Python.

    Parameters
    ----------
    module : str
        Name of the module.
    path : path
        The file.
    trims : bool
        Whether patches may have trims.

    Raises
    ------
    FileFormatError
        As the reader itself, or if its process died or took longer than `TIME_LIMIT`.
    """
    size = len(read_bytes(path))  # a missing file is told at once
    limit = int(TIME_LIMIT + size / 10_000)
    with tempfile.TemporaryDirectory(prefix="mitsuba_bezier_") as folder:
        out = Path(folder) / "model.npz"
        arguments = [module, str(path), str(out), str(_MEMORY + 100 * size), str(int(trims))]
        try:
            done = subprocess.run(
                python_command(f"import {__name__} as i; i.work()", *arguments),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=limit,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise damaged(path, f"a file that can be read in {limit} s", "none") from None
        if out.exists():
            return _unpack(out)
    text = done.stderr.decode(errors="replace").strip().splitlines()
    if done.returncode == 3 and text:
        raise FileFormatError(text[-1])
    if done.returncode < 0:
        names = {int(s): s.name for s in signal.Signals}
        reason = f"its process died of {names.get(-done.returncode, -done.returncode)}"
    else:
        reason = text[-1] if text else f"exit code {done.returncode}"
    raise damaged(path, "a file that its library can read", reason[:200])


def work() -> None:
    """Read a file in this process and write what was found; for `read_isolated` only."""
    module, path, out, memory, trims = sys.argv[1:]
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(memory), resource.RLIM_INFINITY))
    except (ImportError, ValueError, OSError):
        pass  # not every system has such limits
    try:
        model = import_module(f".{module}", __package__).read_here(path, trims == "1")
    except BezierError as error:
        print(" ".join(str(error).split()), file=sys.stderr, flush=True)
        os._exit(3)
    except MemoryError:
        print(f"{path}: expected a file that fits the memory, got a larger one", file=sys.stderr)
        os._exit(3)
    report = model.report
    facts = {
        "path": report.path,
        "format": report.format,
        "faces": report.faces,
        "converted": report.converted,
        "refused": [[r.face, r.reason, r.count] for r in report.refused],
        "notes": report.notes,
        "remarks": report.remarks,
    }
    arrays = {f"net{k}": g.control_points for k, g in enumerate(model.groups)}
    arrays |= {f"source{k}": s for k, s in enumerate(model.sources)}
    for k, part in enumerate(model.trims):
        if part is not None:
            arrays |= {f"trim{k}.{name}": a for name, a in packed_trims(part).items()}
    partial = Path(out).with_suffix(".partial.npz")
    np.savez(partial, facts=np.array(json.dumps(facts)), **arrays)
    os.replace(partial, out)
    os._exit(0)  # the library's own end of process is none of our business


def _unpack(path: Path) -> Model:
    with np.load(path, allow_pickle=False) as data:
        facts = json.loads(str(data["facts"]))
        facts["refused"] = [Refusal(*item) for item in facts["refused"]]
        count = sum(name.startswith("net") for name in data.files)
        groups = [BezierTriangles(data[f"net{k}"]) for k in range(count)]
        sources = [data[f"source{k}"] for k in range(count)]
        trims: list[Trims | None] = []
        for k in range(count):
            part = {n.removeprefix(f"trim{k}."): data[n] for n in data.files if f"trim{k}." in n}
            trims.append(unpacked_trims(part) if part else None)
    some = any(t is not None for t in trims)
    return Model(groups, sources, Report(**facts), trims if some else [])
