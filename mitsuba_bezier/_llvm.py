"""Find an LLVM library that Dr.Jit can use, and say how to install what is missing.

Order: the wheels ``karellen-llvm-core`` and ``llvm-nanobind``, then the newest library of the
system from `MINIMUM` up. Nothing here imports Dr.Jit or loads LLVM itself.

The table of package managers is kept although such tables age: it is one line a manager, and who
has no LLVM reads the command to type in the error itself, without a page to look up.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from glob import glob
from importlib import metadata
from pathlib import Path

from ._children import program

__all__ = [
    "MINIMUM",
    "WHEELS",
    "Library",
    "export",
    "find",
    "install_command",
    "load_error",
    "preload",
]

#: LLVM 14 is refused by Dr.Jit; 15 and 16 abort the process at the first minimum or maximum
#: ("Cannot select: fminimum").
MINIMUM = 17

#: Packages of the Python Package Index that carry an LLVM library.
WHEELS = ("karellen-llvm-core", "llvm-nanobind")

# libLLVM-17.so.1, libLLVM-14.0.6.so.1, libLLVM.so.19.1, libLLVM.dylib; not libLLVM-C.*, not the
# private builds of other projects (libLLVM-19-rust-1.84.so, libLLVM-17jl.so)
_NAME = re.compile(r"libLLVM(?:-(\d[\d.]*))?\.(?:so|dylib)((?:\.\d+)*)$")
# the name of a folder where the file name carries no version: llvm-19, llvm@19, llvm/19.1.7
_FOLDER = re.compile(r"llvm[-@/]?(\d[\d.]*)/")

_FOLDERS = {
    "linux": (
        "/usr/lib/llvm-*/lib",
        "/usr/lib/*-linux-gnu",
        "/usr/lib64",
        "/usr/lib64/llvm*/lib*",
        "/usr/lib",
        "/usr/local/lib",
        "/usr/local/lib64",
        "/opt/llvm*/lib",
    ),
    "darwin": (
        "/opt/homebrew/opt/llvm*/lib",
        "/usr/local/opt/llvm*/lib",
        "/opt/local/libexec/llvm-*/lib",
    ),
}


@dataclass(frozen=True)
class Library:
    """One LLVM library: its real file, version, and where it was found."""

    path: str
    version: tuple[int, ...]
    origin: str


def find() -> Library | None:
    """Return the library to use, or None if there is none from `MINIMUM` up."""
    for candidates in (_wheels(), _system()):
        usable = [lib for lib in candidates if lib.version >= (MINIMUM,)]
        if usable:
            return max(usable, key=lambda lib: lib.version)
    return None


def preload(path: str) -> None:
    """Load the C++ runtime that lies beside the library of ``karellen-llvm-core``.

    That wheel gets the symbolic links its libraries ask for only at the next start of the
    interpreter. A library that is already loaded is found by its internal name instead.
    They are loaded without making their symbols global: Mitsuba has another C++ runtime.
    """
    if not os.path.isabs(path):  # a bare name: beside it would be in the current folder
        return
    folder = Path(path).parent
    for name in ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0"):
        for file in folder.glob(f"*-unknown-linux-gnu/{name}"):
            with contextlib.suppress(OSError):  # if it matters, `load_error` tells
                ctypes.CDLL(str(file))


def export(variable: str, path: str) -> str:
    """Return the command that sets a variable of the environment in the usual shell."""
    if sys.platform == "win32":
        return f"set {variable}={path}"
    return f"export {variable}={shlex.quote(path)}"


def load_error(path: str) -> str | None:
    """Return why the dynamic loader refuses `path`, or None if it loads."""
    try:
        ctypes.CDLL(path)
    except OSError as error:
        return str(error)
    return None


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text))


def _version_of(path: str) -> tuple[int, ...]:
    match = _NAME.search(os.path.basename(path))
    version = (match and (match[1] or match[2])) or ""
    if not version and (folder := _FOLDER.search(path)):
        version = folder[1]
    return _numbers(version)


def _wheels() -> Iterator[Library]:
    for name in WHEELS:
        try:
            wheel = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue
        # RECORD is read as text: its thousands of lines would take 50 ms as PackagePaths
        lines = (wheel.read_text("RECORD") or "").splitlines()
        files = {line.split(",")[0] for line in lines if "/libLLVM" in line}
        found = {os.path.realpath(str(wheel.locate_file(file))) for file in files}
        # llvm-nanobind puts a hash into the name: libLLVM-a6b168f6.so.21.1
        for path in sorted(found):
            if os.path.isfile(path) and re.search(r"libLLVM(-\w+)?\.(so|dylib)", path):
                yield Library(path, _numbers(wheel.version)[:3], f"the wheel {name}")


def _system() -> Iterator[Library]:
    paths = set(_from_linker_cache())
    folders = [*_FOLDERS.get(sys.platform, ()), os.path.join(sys.prefix, "lib")]
    for folder in folders:
        paths.update(glob(os.path.join(folder, "libLLVM*")))
    paths = {path for path in paths if _NAME.search(os.path.basename(path))}
    real_of = {os.path.realpath(path): path for path in sorted(paths)}
    for real, path in real_of.items():
        version = _version_of(real) or _version_of(path)
        if version and os.path.isfile(real) and _same_machine(real):
            yield Library(real, version, "the system")


def _from_linker_cache() -> list[str]:
    if sys.platform != "linux":
        return []
    for path in ("/sbin/ldconfig", "/usr/sbin/ldconfig", program("ldconfig") or ""):
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            out = subprocess.run([path, "-p"], capture_output=True, text=True, timeout=10)
            return re.findall(r"=> (\S*/libLLVM\S*)", out.stdout)
    return []


def _same_machine(path: str) -> bool:
    """Return whether an ELF file is of the interpreter's class and machine (True off Linux)."""
    if sys.platform != "linux":
        return True
    try:
        with open(path, "rb") as file, open("/proc/self/exe", "rb") as own:
            a, b = file.read(20), own.read(20)
    except OSError:
        return False
    # e_ident: magic, class, byte order; e_machine
    return len(a) == 20 and (a[:6], a[18:]) == (b[:6], b[18:])


_PACKAGES = {  # manager: its command, and the packages with LLVM, libatomic, the NVIDIA driver
    "apt": ("apt install", "libllvm19", "libatomic1", "nvidia-driver"),
    "dnf": ("dnf install", "llvm-libs", "libatomic", "akmod-nvidia"),
    "zypper": ("zypper install", "libLLVM19", "libatomic1", "nvidia-driver-G06-kmp-default"),
    "pacman": ("pacman -S", "llvm-libs", "gcc-libs", "nvidia"),
}
_WANTED = {"llvm": "LLVM 19", "libatomic": "libatomic.so.1", "nvidia": "the NVIDIA driver"}
_MANAGERS = {
    "debian": "apt",
    "ubuntu": "apt",
    "fedora": "dnf",
    "rhel": "dnf",
    "centos": "dnf",
    "suse": "zypper",
    "opensuse": "zypper",
    "arch": "pacman",
}


def _release() -> list[str]:
    """Return the names of this Linux distribution and its relatives (/etc/os-release)."""
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        return []
    return [release.get("ID", ""), *release.get("ID_LIKE", "").split()]


def install_command(what: str) -> str:
    """Return the command that installs `what` on this machine.

    Parameters
    ----------
    what : {"llvm", "libatomic", "nvidia"}
        An LLVM for Dr.Jit, the library libatomic.so.1, or the driver of an NVIDIA GPU.
    """
    if what == "llvm":
        if sys.platform == "linux" and platform.machine() == "x86_64":
            return 'pip install "karellen-llvm-core>=19,<24"'
        if sys.platform == "darwin":
            return "brew install llvm"
        if sys.platform == "win32":
            return "winget install LLVM.LLVM"
    names = _release()
    manager = next((_MANAGERS[name] for name in names if name in _MANAGERS), None)
    if manager is None:
        return f"install {_WANTED[what]} with the system's package manager"
    sudo = "" if os.geteuid() == 0 else "sudo "
    if what == "nvidia" and "ubuntu" in names:
        return f"{sudo}ubuntu-drivers install"
    command, *packages = _PACKAGES[manager]
    return f"{sudo}{command} {packages[list(_WANTED).index(what)]}"
