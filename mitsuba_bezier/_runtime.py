"""Prepare what runs below Mitsuba: choose an LLVM, and check that a variant runs our kernels.

Dr.Jit looks for LLVM once, while it is imported, at ``DRJIT_LIBLLVM_PATH`` or under the linker's
default name, which on many machines is LLVM 14, 15 or 16 and ends in an aborted process. So
`prepare` sets the variable as soon as ``mitsuba_bezier`` is imported, and `check` looks at what
was really loaded before a kernel of ours runs. If Dr.Jit was imported first, as import sorters
have it, it is started anew with the right library as long as nothing rests on it; else a warning
tells at once what to do. Importing never fails for want of LLVM: it is not needed for the NumPy
geometry, nor on CUDA.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
import warnings
from importlib import import_module
from types import ModuleType
from typing import Any

from . import _llvm
from .errors import RuntimeSetupError, VariantError

__all__ = [
    "INSTALL_MITSUBA",
    "VARIABLE",
    "check",
    "check_folder",
    "import_mitsuba",
    "llvm_origin",
    "llvm_path",
    "llvm_problem",
    "llvm_version",
    "prepare",
    "usable_variants",
    "variable_is_users",
    "version_problem",
]

VARIABLE = "DRJIT_LIBLLVM_PATH"

#: Versions of Mitsuba whose interface for plugins is the one used here: from, and before.
MITSUBA = ((3, 9, 1), (3, 10))
INSTALL_MITSUBA = 'pip install "mitsuba>=3.9.1,<3.10"'

_prepared = False
_late = False  # Dr.Jit was imported before us: its LLVM is settled
_ours: _llvm.Library | None = None  # what we put into the variable
_good: set[str] = set()  # variants that passed `check`


def prepare() -> None:
    """Choose the LLVM library that Dr.Jit will load; called when the package is imported.

    A variable set by the user stays. If Dr.Jit was imported before, with an LLVM that will not
    do, it is started anew; where that cannot be, a warning says what to do.
    """
    global _prepared, _late, _ours
    if _prepared:
        return
    _prepared = True
    _late = "drjit" in sys.modules
    if os.environ.get(VARIABLE):
        # a child process inherits the variable, but not the libraries loaded beside it
        _llvm.preload(os.environ[VARIABLE])
        return
    if _late and (llvm_version() or (-1,))[0] >= _llvm.MINIMUM:
        return
    _ours = _llvm.find()
    if _ours is None:
        return
    if _late and not _may_restart():
        warnings.warn(str(llvm_problem()), RuntimeWarning, stacklevel=3)
        return
    _llvm.preload(_ours.path)
    os.environ[VARIABLE] = _ours.path
    if _late:
        _restart()
        if (llvm_version() or (-1,))[0] < _llvm.MINIMUM:
            del os.environ[VARIABLE]
            warnings.warn(str(llvm_problem()), RuntimeWarning, stacklevel=3)


def _may_restart() -> bool:
    """Return whether Dr.Jit may forget its LLVM: no array exists. GPUs are left alone."""
    dr = import_module("drjit")
    mitsuba = sys.modules.get("mitsuba")
    if mitsuba is not None and (mitsuba.variant() or "scalar").split("_")[0] != "scalar":
        return False  # Mitsuba holds objects of Dr.Jit
    return (
        _core() is not None
        and not dr.has_backend(dr.JitBackend.CUDA)
        and "No variables registered" in str(dr.whos(as_string=True))
    )


def _core() -> Any:
    """Return Dr.Jit's own library with ``jit_shutdown`` and ``jit_init``, or None."""
    folder = os.path.dirname(str(import_module("drjit").__file__))
    name = {"linux": "libdrjit-core.so", "darwin": "libdrjit-core.dylib"}.get(sys.platform, "")
    try:
        core = ctypes.CDLL(os.path.join(folder, name))
        core._Z12jit_shutdowni, core._Z8jit_initj  # noqa: B018 (looks the names up)
    except (OSError, AttributeError):
        return None
    return core


def _restart() -> None:
    """Let Dr.Jit look for LLVM again, in 15 ms; where it had found none at all, it does not."""
    dr, core = import_module("drjit"), _core()
    core._Z12jit_shutdowni(0)
    core._Z8jit_initj(sum(1 << kind.value for kind in (dr.JitBackend.CUDA, dr.JitBackend.LLVM)))


def check_folder() -> None:
    """Make sure that there is a current folder, without which Mitsuba aborts the process.

    Raises
    ------
    RuntimeSetupError
        If there is none.
    """
    try:
        os.getcwd()
    except OSError:
        raise RuntimeSetupError.expected(
            "current folder", "one that exists", "one that was removed"
        ) from None


def import_mitsuba() -> ModuleType:
    """Import and return Mitsuba.

    Raises
    ------
    RuntimeSetupError
        If Dr.Jit or Mitsuba cannot be loaded, above all without ``libatomic.so.1``.
    """
    check_folder()
    try:
        return import_module("mitsuba")
    except (ImportError, NameError) as error:
        # Dr.Jit's own handler fails with a NameError about `_drjit_ext` and hides the cause
        cause = error.__context__ if isinstance(error, NameError) else error
        if _llvm.load_error("libatomic.so.1") and "libatomic" in str(cause):
            raise RuntimeSetupError.expected(
                "libatomic",
                "libatomic.so.1, which Dr.Jit needs",
                f'"{cause}"; install it: {_llvm.install_command("libatomic")}',
            ) from None
        raise RuntimeSetupError.expected(
            "mitsuba", "a Mitsuba 3.9 that can be imported", f'"{cause or error}"'
        ) from error


def version_problem() -> str | None:
    """Return what is wrong with the version of Mitsuba and what to do, or None if it will do.

    Installers do not keep the version: a package that is upgraded later takes another.
    """
    version = str(getattr(import_mitsuba(), "__version__", ""))
    numbers = re.match(r"(\d+)\.(\d+)(?:\.(\d+))?", version)
    if numbers is None:  # built from source, perhaps: nothing is known
        return None
    first, before = MITSUBA
    found = tuple(int(x or 0) for x in numbers.groups())
    if first <= found < before:
        return None
    newer = ", or a newer mitsuba_bezier if there is one" if found >= before else ""
    return (
        f"mitsuba: expected version {'.'.join(map(str, first))} or later, before "
        f"{'.'.join(map(str, before))}, got {version}; install one: {INSTALL_MITSUBA}{newer}"
    )


def llvm_version() -> tuple[int, int, int] | None:
    """Return the version of the LLVM that Dr.Jit loaded, or None if it has none."""
    if "drjit" not in sys.modules:
        import_mitsuba()
    dr = import_module("drjit")
    dr.has_backend(dr.JitBackend.LLVM)  # waits until Dr.Jit has looked for it, in its own thread
    version = tuple(dr.detail.llvm_version())
    return version if version[0] >= 0 else None


def llvm_path() -> str | None:
    """Return the file of the LLVM that Dr.Jit loaded, or None if it cannot be told."""
    try:
        with open("/proc/self/maps") as maps:
            paths = [line.split(maxsplit=5)[-1].strip() for line in maps if "/libLLVM" in line]
    except OSError:  # no Linux
        return os.environ.get(VARIABLE)
    return paths[0] if paths else None


def variable_is_users() -> bool:
    """Return whether ``DRJIT_LIBLLVM_PATH`` is set, and not by `prepare`."""
    named = os.environ.get(VARIABLE)
    return bool(named) and (_ours is None or named != _ours.path)


def llvm_origin() -> str:
    """Return in words who chose the LLVM that Dr.Jit loaded."""
    if variable_is_users():
        return VARIABLE
    if _ours is not None:
        return f"mitsuba_bezier, from {_ours.origin}"
    return "Dr.Jit, which was imported first" if _late else "Dr.Jit"


def llvm_problem() -> str | None:
    """Return what is wrong with Dr.Jit's LLVM and what to do about it, or None if it will do."""
    version = llvm_version()
    if version is not None and version[0] >= _llvm.MINIMUM:
        return None
    named = os.environ.get(VARIABLE)
    by_user = variable_is_users()
    path = llvm_path()
    if version is not None:
        got = f"{'.'.join(map(str, version))}" + (f" ({path})" if path else "")
    elif named:
        reason = _llvm.load_error(named) or "loads, but Dr.Jit cannot use it"
        got = f"{VARIABLE}={named} ({reason})"
    else:
        got = "no LLVM library that Dr.Jit can use"

    better = _ours or _llvm.find()
    if better is None or (named == better.path and version is None):
        todo = f"install one: {_llvm.install_command('llvm')}"
        if by_user:
            todo += f", and unset {VARIABLE}"
    elif by_user and not (_late and path and os.path.realpath(str(named)) != path):
        todo = f"unset {VARIABLE}, or set it to {better.path}"
    else:
        todo = (
            "Dr.Jit was imported before mitsuba_bezier and keeps its choice. Set the variable "
            "before Python starts, then the order does not matter: "
            f"{_llvm.export(VARIABLE, better.path)}"
        )
    return f"LLVM: expected version {_llvm.MINIMUM} or newer, got {got}; {todo}"


def _starts(name: str) -> bool:
    """Return whether the backend of a variant exists and can run our kernels."""
    if name.startswith("llvm_"):
        return llvm_problem() is None
    dr = import_module("drjit")
    return name.startswith("cuda_") and bool(dr.has_backend(dr.JitBackend.CUDA))


def usable_variants() -> list[str]:
    """Return the variants of this Mitsuba that can run Dr.Jit kernels on this machine."""
    return [name for name in import_mitsuba().variants() if _starts(name)]


def check(variant: str | None) -> None:
    """Make sure that `variant` can run our kernels; to be called before one of them runs.

    Raises
    ------
    VariantError
        If no variant is set, or one that cannot run a Dr.Jit kernel, or an unknown one.
    RuntimeSetupError
        If the version of Mitsuba is none that will do, or the variant needs LLVM and Dr.Jit has
        none, or one that would abort the process.
    """
    if variant in _good:
        return
    version = version_problem()
    if version is not None:
        raise RuntimeSetupError(version)
    known = import_mitsuba().variants()
    if variant is not None and variant in known and _starts(variant):
        _good.add(variant)
        return
    problem = llvm_problem()
    if variant is not None and variant in known and variant.startswith("llvm_") and problem:
        raise RuntimeSetupError(problem)
    usable = usable_variants()
    if usable:
        expected = f"one of {', '.join(usable)}"
    else:
        expected = f"a JIT variant, of which none starts here ({problem})"
    if variant is None:
        got = "none; choose one, e.g. mi.set_variant('llvm_ad_rgb')"
    elif variant.startswith("scalar_"):
        got = f"{variant}, which cannot run a Dr.Jit kernel"
    elif variant.startswith("cuda_") and variant in known:
        got = f"{variant}, but there is no GPU with a CUDA driver that Dr.Jit can use"
    else:
        got = variant
    raise VariantError.expected("variant", expected, got)
