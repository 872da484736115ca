"""The stand-in's libraries, and processes that use them."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mitsuba_bezier

__all__ = ["KNOWN", "StandIn", "reason_without"]

#: The version of Dr.Jit for which all of this was written.
KNOWN = "1.5.0"
HERE = Path(__file__).resolve().parent


def reason_without() -> str | None:
    """Return why there is no stand-in on this machine, None where there is one."""
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        return f"CUDA's stand-in: expected Linux on x86-64, got {platform.platform()}"
    if shutil.which("gcc") is None:
        return "CUDA's stand-in: expected gcc on the PATH to build it, got none"
    return None


class StandIn:
    """The stand-in, built in a folder.

    Parameters
    ----------
    folder : Path
        For the libraries and for all that processes leave.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("driver", "optix"):
            self._gcc(HERE / f"{name}.c", folder / f"{name}.so")

    @staticmethod
    def _gcc(source: Path, target: Path) -> None:
        words = ["gcc", "-O1", "-shared", "-fPIC", "-o", target, source, "-ldl", "-lpthread"]
        subprocess.run(words, check=True)

    def environment(
        self, runs: bool = True, rough: bool = False, some: bool = False
    ) -> dict[str, str]:
        """Return the variables of a process that takes the stand-in for CUDA.

        Parameters
        ----------
        runs : bool
            Whether kernels are run, on the CPU; otherwise they are only written down.
        rough : bool
            Whether results of float32 instructions are off by as much as they may be.
        some : bool
            Whether kernels that the translator does not understand are left out.
        """
        result = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(
                (str(HERE.parent), str(Path(mitsuba_bezier.__file__).parents[1]))
            ),
            "DRJIT_LIBCUDA_PATH": str(self.folder / "driver.so"),
            "DRJIT_LIBOPTIX_PATH": str(self.folder / "optix.so"),
        }
        if runs:
            result["CUDA_STANDIN_TRANSLATE"] = f"'{sys.executable}' '{HERE / 'translate.py'}'"
        if some:
            result["CUDA_STANDIN_SOME"] = "1"
        if rough:
            result["CUDA_STANDIN_ROUGH"] = "1"
        return result

    def run(
        self, module: str, out: str, names: Sequence[str], **variables: Any
    ) -> tuple[Path, list[dict[str, Any]]]:
        """Run a module of this folder; return where it left its kernels, and what it printed."""
        folder = self.folder / out
        command = [sys.executable, "-m", f"cuda_standin.{module}", str(folder), *names]
        process = subprocess.run(
            command, env=self.environment(**variables), capture_output=True, text=True
        )
        if process.returncode:
            raise AssertionError(f"{self.about()}{process.stderr[-4000:]}")
        return folder, [json.loads(x) for x in process.stdout.splitlines() if x.startswith("{")]

    @staticmethod
    def about() -> str:
        """Return what to know before a failure is looked into."""
        found = version("drjit")
        if found == KNOWN:
            return ""
        return (
            f"the stand-in for CUDA knows Dr.Jit {KNOWN}, and here is {found}: look through "
            "tests/cuda_standin/README.md first\n"
        )
