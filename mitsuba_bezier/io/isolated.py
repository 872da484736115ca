"""Run readers that use large C++ libraries in a process of their own.

A damaged file can crash such a library, and with it the Python that called it. So the file is
read by a second Python, which hands its nets over in a file; if it dies, that is an error like
any other. Its processor time and its memory are limited (see `limits`), so a busy machine makes
it late, but not fail; and it ends with its parent, however that ends.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .._children import READER, python_command
from .._files import temporary_folder
from ..errors import BezierError, FileFormatError
from .files import damaged, read_bytes
from .limits import memory_limit, seconds_limit, too_large, too_slow
from .packing import packed_model, unpacked_model
from .report import Model

__all__ = ["read_isolated"]

#: Seconds after which a process that waits for something, and computes nothing, is given up.
IDLE_LIMIT = 60.0

_POLL = 1.0  # seconds between two looks at it

#: Exit code of a process that tells an error of ours, as the last line of what it prints.
_TOLD = 3
#: Exit code of a process that ran out of memory.
_FULL = 4


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
        As the reader itself, or if its process died or went beyond its limits.
    """
    size = len(read_bytes(path))  # a missing file is told at once
    seconds, memory = seconds_limit(size), memory_limit(size)
    with temporary_folder() as folder:
        out = Path(folder) / "model.npz"
        arguments = [module, str(path), str(out), str(seconds), str(memory), str(int(trims))]
        arguments += [str(os.getpid())]
        # it ends when the pipe to its standard input does: when this process closes it, or ends
        theirs, ours = os.pipe()
        try:
            process = subprocess.Popen(
                python_command(f"import {__name__} as i; i.work()", *arguments),
                stdin=theirs,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env={
                    "OPENBLAS_NUM_THREADS": "1",  # its matrices are small
                    **os.environ,
                    "TMPDIR": folder,  # what it leaves goes with the folder
                    READER: str(os.getpid()),
                },
            )
            try:
                stderr = _wait(process, seconds)
            except TimeoutError:
                expected = f"a file whose reader is not idle for {IDLE_LIMIT:.0f} s"
                raise damaged(path, expected, "one that is") from None
            finally:  # also after Ctrl-C
                if process.poll() is None:
                    process.kill()
                    process.communicate()
        finally:
            os.close(theirs)
            os.close(ours)
        if out.exists():
            return _unpack(out)
    text = stderr.decode(errors="replace").strip().splitlines()
    code = process.returncode
    if code == _TOLD and text:
        raise FileFormatError(text[-1])
    if code == _FULL:
        raise too_large(path)
    if code < 0:
        names = {int(s): s.name for s in signal.Signals}
        name = names.get(-code, str(-code))
        if name == "SIGXCPU":
            raise too_slow(path, seconds)
        reason = f"its process died of {name}"
    else:
        reason = text[-1] if text else f"exit code {code}"
    raise damaged(path, "a file that its library can read", reason[:200])


def _wait(process: subprocess.Popen[bytes], seconds: float) -> bytes:
    """Wait for the end of a process; return what it printed.

    Raises
    ------
    TimeoutError
        If it has waited for something, and computed nothing, for `IDLE_LIMIT`; where the system
        does not tell, if it took 20 times the processor time that it may take.
    """
    start = since = time.monotonic()
    used = -1
    while True:
        try:
            return process.communicate(timeout=_POLL)[1]
        except subprocess.TimeoutExpired:
            pass
        now = time.monotonic()
        state = _state(process.pid)
        if state is None:
            idle = now - start > IDLE_LIMIT + 20 * seconds
        else:
            sleeps, ticks = state
            if ticks != used or not sleeps:  # one that waits for the processor does not sleep
                used, since = ticks, now
            idle = now - since > IDLE_LIMIT
        if idle:
            raise TimeoutError


def _state(pid: int) -> tuple[bool, int] | None:
    """Return whether a process sleeps, and its processor time in clock ticks (Linux)."""
    try:
        words = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        return words[0] in (b"S", b"T"), int(words[11]) + int(words[12])
    except (OSError, ValueError, IndexError):
        return None


def _end_with(parent: int) -> None:
    """End this process when its parent does, or has done."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:
            os._exit(1)

    def watch() -> None:  # for other systems
        os.read(0, 1)  # nothing comes: this returns when the pipe ends
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _limit(seconds: float, memory: int) -> None:
    """Limit what this process may take from now on."""
    try:
        import resource
    except ImportError:
        return  # not every system has such limits
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        taken = pages * resource.getpagesize()
    except (OSError, ValueError):
        taken = 1 << 30
    limits = {
        # whole seconds; the one more is for what importing the library took
        resource.RLIMIT_CPU: int(time.process_time() + seconds) + 1,
        resource.RLIMIT_AS: taken + memory,
        resource.RLIMIT_CORE: 0,
    }
    for kind, wanted in limits.items():
        try:
            hard = resource.getrlimit(kind)[1]
            soft = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
            resource.setrlimit(kind, (soft, hard))
        except (ValueError, OSError):
            pass


def work() -> None:
    """Read a file in this process and write what was found; for `read_isolated` only."""
    name, path, out, seconds, memory, trims, parent = sys.argv[1:]
    _end_with(int(parent))
    module = import_module(f".{name}", __package__)
    with suppress(FileFormatError):  # `read_here` tells it, too
        module.import_library()
    try:
        _limit(float(seconds), int(memory))
        model = module.read_here(path, trims == "1")
    except BezierError as error:
        print(" ".join(str(error).split()), file=sys.stderr, flush=True)
        os._exit(_TOLD)
    except MemoryError:
        os._exit(_FULL)
    facts, packed = packed_model(model)
    arrays: dict[str, Any] = {**packed}
    partial = Path(out).with_suffix(".partial.npz")
    np.savez(partial, facts=np.array(json.dumps(facts)), **arrays)
    os.replace(partial, out)
    os._exit(0)  # the library's own end of process is none of our business


def _unpack(path: Path) -> Model:
    with np.load(path, allow_pickle=False) as data:
        return unpacked_model(json.loads(str(data["facts"])), dict(data))
