"""Start other programs without running code that lies in the current folder.

``python -c`` and ``python -m`` put the current folder first on `sys.path`, and a PATH may name it
by "." or by an empty entry. Whoever looks into a folder of foreign models must not run a
``numpy.py`` or an ``ldconfig`` that lies there.
"""

from __future__ import annotations

import os  # with sys the only import: any other could come from the current folder
import sys

__all__ = ["READER", "leave_current_folder", "program", "python_command", "reads"]

#: Set to the number of its parent for a process that only reads a file.
READER = "MITSUBA_BEZIER_READER"

#: Runs before anything is imported from a file. What an isolated Python has itself stays, even
#: where it is the current folder: someone installed it there.
_BOOTSTRAP = (
    "import sys; sys.path[:] = [p for p in {path!r} if p not in {here!r} or p in sys.path]; "
    "sys.path.append({package!r})"
)


def python_command(code: str, *arguments: str) -> list[str]:
    """Return the command that runs `code` in a second Python, which can import what this one can.

    Parameters
    ----------
    code : str
        Python statements.
    *arguments : str
        What they find in ``sys.argv[1:]``.
    """
    path = [entry for entry in sys.path if isinstance(entry, str) and os.path.isabs(entry)]
    bootstrap = _BOOTSTRAP.format(
        path=path,
        here=[entry for entry in path if _is_current(entry)],
        # last, since it may be the current folder: this process runs the package from there
        package=os.path.dirname(os.path.dirname(os.path.abspath(__file__))),
    )
    flags = ["-I"]  # no current folder, no PYTHON variables: what they say is in `path`
    if sys.flags.utf8_mode:
        flags += ["-X", "utf8"]
    if sys.dont_write_bytecode:
        flags += ["-B"]
    return [sys.executable, *flags, "-c", f"{bootstrap}\n{code}", *arguments]


def program(name: str) -> str | None:
    """Return the path of a program in an absolute folder of the PATH, or None."""
    suffix = ".exe" if sys.platform == "win32" else ""
    for folder in os.environ.get("PATH", "").split(os.pathsep):
        path = os.path.join(folder, name + suffix)
        if os.path.isabs(folder) and os.path.isfile(path) and os.access(path, os.X_OK):
            return path
    return None


def leave_current_folder() -> None:
    """Take the current folder off the path if ``python -m mitsuba_bezier...`` put it there."""
    if sys.argv[:1] != ["-m"]:  # this stands there as long as Python looks for the module
        return
    for word, following in zip(sys.orig_argv[1:], [*sys.orig_argv[2:], ""]):
        option, m, module = word.partition("m")
        if m and option[:1] == "-" and set(option[1:]) <= set("bBdEiIOPqRsSuvx"):
            ours = (module or following).partition(".")[0] == __package__
            if ours and sys.path and _is_current(sys.path[0]):
                del sys.path[0]
            return


def reads() -> bool:
    """Return whether this process only reads a file, and needs no Mitsuba, which takes a while."""
    return os.environ.get(READER) == str(os.getppid())


def _is_current(folder: str) -> bool:
    try:
        return os.path.samefile(folder or ".", ".")
    except OSError:  # either may be gone
        return folder in ("", ".")
