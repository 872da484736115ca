"""Write files atomically: a file is whole and on the disk, or the old one stays.

All bytes are there before the first is written, so that no library's own writing, whose errors
may get lost when it closes a file, comes between. They go to a new file of a random name in the
same folder, which nobody can have prepared, and that file takes the place of the old one when the
disk has it. Whatever fails on the way, the old file is as it was and nothing lies beside it.

A symbolic link is replaced, what it points to is never touched. Devices and pipes are refused.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping

from . import _signals
from .errors import FileFormatError

__all__ = [
    "Files",
    "check_target",
    "encoded",
    "free_space",
    "is_same",
    "is_utf8",
    "refuse_inputs",
    "temporary_folder",
    "write_file",
    "write_files",
]

#: Files of one result, with their contents.
Files = dict[str | os.PathLike[str], bytes | bytearray | memoryview]

#: Temporary files and folders that exist, or are about to; the end by a signal removes them.
_unfinished: set[str] = set()
_written: set[str] = set()

_EXCLUSIVE = (
    os.O_WRONLY
    | os.O_CREAT
    | os.O_EXCL
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)


def write_file(
    path: str | os.PathLike[str],
    data: bytes | bytearray | memoryview,
    parameter: str = "",
    make_folders: bool = False,
) -> None:
    """Write a file, or leave what is there.

    The file has the permissions of the one it replaces, else those of the umask.

    Parameters
    ----------
    path : path-like
        The file.
    data : bytes
        All of its contents.
    parameter : str
        What errors name; by default the path.
    make_folders : bool
        Make the folders on the way.

    Raises
    ------
    FileFormatError
        If the file cannot be written, or not be brought to the disk.
    """
    with _told(path, parameter):
        if make_folders:
            os.makedirs(os.path.dirname(path) or ".", exist_ok=True)
    write_files({path: data}, parameter)


def write_files(
    files: Mapping[str | os.PathLike[str], bytes | bytearray | memoryview], parameter: str = ""
) -> None:
    """Write files of one result, as `write_file` does: no old one goes before all are there.

    Raises
    ------
    FileFormatError
        If a file cannot be written, or not be brought to the disk.
    """
    temporaries: dict[str, str] = {}
    try:
        for path, data in files.items():
            with _told(path, parameter):
                path = os.fspath(path)
                _refuse(path, parameter or _shown(path))
                temporaries[path] = temporary = _temporary(os.path.dirname(path))
                _write_new(temporary, memoryview(data).cast("B"), _old(path))
        for path, temporary in temporaries.items():
            with _told(path, parameter):
                os.replace(temporary, path)
                _written.add(path)
    finally:
        for temporary in temporaries.values():
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            _unfinished.discard(temporary)
    for path in temporaries:
        with _told(path, parameter):
            _sync_folder(os.path.dirname(path) or ".")


def check_target(
    path: str | os.PathLike[str], parameter: str, size: int = 0, make_folders: bool = False
) -> None:
    """Make sure, before any work, that `write_file` will be able to write a file.

    Parameters
    ----------
    path : path-like
        The file.
    parameter : str
        What errors name.
    size : int
        Bytes that the file will have at least.
    make_folders : bool
        As for `write_file`: folders that are missing are no error, if they can be made.

    Raises
    ------
    FileFormatError
        If the name is empty, too long or that of a folder, device or pipe, the folder
        is missing or cannot be written to, the old file is write-protected, or the disk is full.
    """
    path = os.fspath(path)
    with _told(path, parameter):
        _refuse(path, parameter)
        folder = os.path.dirname(path) or "."
        while make_folders and not os.path.lexists(folder) and os.path.dirname(folder) != folder:
            folder = os.path.dirname(folder) or "."
        if not os.path.isdir(folder):
            raise FileFormatError.expected(parameter, "a folder that exists", _shown(folder))
        _try_folder(folder, parameter)
        _check_owner(path, folder, parameter)
        free = free_space(folder)
        if free is not None and free <= size:
            raise FileFormatError.expected(
                parameter, f"at least {max(size, 1)} bytes of free space", f"{free} in {folder}"
            )


def is_utf8(name: str) -> bool:
    """Return whether the bytes of a file name or an argument are text in UTF-8."""
    try:
        os.fsencode(name).decode("utf-8")
    except UnicodeError:
        return False
    return True


def is_same(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> bool:
    """Return whether two paths name one file, which need not exist."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return os.path.realpath(a) == os.path.realpath(b)


def refuse_inputs(
    path: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]], parameter: str
) -> None:
    """Raise an error if a file to be written is one of those that are read.

    Raises
    ------
    FileFormatError
        If so.
    """
    for file in inputs:
        if is_same(path, file):
            got = _shown(os.fspath(path))
            raise FileFormatError.expected(parameter, "another file than those that are read", got)


def encoded(write: Callable[[str], None]) -> bytes:
    """Return what a function writes that can only write to a file it is given the name of.

    On Linux that file is in memory. The caller has to see whether it is whole.
    """
    if hasattr(os, "memfd_create") and os.path.isdir("/proc/self/fd"):
        descriptor = os.memfd_create("mitsuba_bezier")
        try:
            write(f"/proc/self/fd/{descriptor}")
            with open(descriptor, "rb", closefd=False) as file:
                file.seek(0)
                return file.read()
        finally:
            os.close(descriptor)
    with temporary_folder() as folder:
        name = os.path.join(folder, "file")
        write(name)
        with open(name, "rb") as file:
            return file.read()


@contextlib.contextmanager
def temporary_folder() -> Iterator[str]:
    """Give a folder for the block; it is removed afterwards, also by the end through a signal."""
    folder = os.path.join(tempfile.gettempdir(), f"mitsuba_bezier_{secrets.token_hex(8)}")
    _unfinished.add(folder)
    try:
        os.mkdir(folder, 0o700)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unfinished.discard(folder)


def _discard_unfinished() -> str:
    for path in list(_unfinished):
        shutil.rmtree(path, ignore_errors=True)
        with contextlib.suppress(OSError):
            os.unlink(path)
    return "" if _written else ", no file was written"


_signals.always_at_end(_discard_unfinished)


def _refuse(path: str, parameter: str) -> None:
    """Raise an error for a path that no file can or should have."""
    if not path or path.endswith((os.sep, os.altsep or os.sep)) or "\0" in path:
        raise FileFormatError.expected(parameter, "the name of a file", repr(path))
    folder = os.path.realpath(os.path.dirname(path) or ".")
    if folder == "/dev" or folder.startswith("/proc/"):
        raise FileFormatError.expected(parameter, "the name of a file", f"the device {path}")
    try:
        old = os.stat(path)  # ENAMETOOLONG comes here, too
    except (FileNotFoundError, NotADirectoryError):
        return  # nothing there, or a link that leads nowhere
    if stat.S_ISDIR(old.st_mode):
        raise FileFormatError.expected(parameter, "the name of a file", f"the folder {path}")
    if not stat.S_ISREG(old.st_mode):
        raise FileFormatError.expected(parameter, "the name of a file", f"the device {path}")
    if not os.path.islink(path) and not os.access(path, os.W_OK):
        raise FileFormatError.expected(
            parameter, "a file that can be written", f"{path}, which is write-protected"
        )


def _temporary(folder: str) -> str:
    # short, so that every name that is legal for the file itself is so for this one
    return os.path.join(folder, f".{secrets.token_hex(8)}.tmp")


def _try_folder(folder: str, parameter: str) -> None:
    """Make a file and remove it again: the only sure sign that this works."""
    if not os.access(folder, os.W_OK):
        raise FileFormatError.expected(parameter, "a folder that can be written to", folder)
    temporary = _temporary(folder)
    _unfinished.add(temporary)
    try:
        os.close(os.open(temporary, _EXCLUSIVE, 0o600))
    except OSError as error:
        raise FileFormatError.expected(
            parameter, "a folder that can be written to", _reason(folder, error)
        ) from None
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        _unfinished.discard(temporary)


def _check_owner(path: str, folder: str, parameter: str) -> None:
    """Raise an error for another user's file in a folder such as /tmp, where it cannot be replaced.

    There only root and the owners of the file and of the folder may do so.
    """
    if not hasattr(os, "geteuid") or not os.path.lexists(path):
        return
    place, user = os.stat(folder), os.geteuid()
    if place.st_mode & stat.S_ISVTX and user not in (0, place.st_uid, os.lstat(path).st_uid):
        raise FileFormatError.expected(
            parameter, "a file that can be replaced", f"{_shown(path)}, which is another user's"
        )


def free_space(folder: str) -> int | None:
    """Return the free bytes of a folder's disk, or None where that cannot be told."""
    try:
        found = os.statvfs(folder)
    except (AttributeError, OSError):
        return None
    return found.f_bavail * found.f_frsize if found.f_blocks else None


@contextlib.contextmanager
def _told(path: str | os.PathLike[str], parameter: str) -> Iterator[None]:
    """Turn errors of the system into ours."""
    try:
        yield
    except (OSError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        name = os.fspath(path)
        raise FileFormatError.expected(
            parameter or _shown(name), "a file that can be written", _reason(name, error)
        ) from None


def _write_new(temporary: str, data: memoryview, old: os.stat_result | None) -> None:
    """Bring a new file to the disk; whatever fails is told, the last bytes' fate too."""
    _unfinished.add(temporary)
    mode = 0o666 if old is None else old.st_mode & 0o777
    descriptor = os.open(temporary, _EXCLUSIVE, mode)
    try:
        if old is not None:
            _take_permissions(descriptor, old)
        at = 0
        while at < len(data):
            # Linux writes no more than 2 GiB at once, macOS refuses to
            written = os.write(descriptor, data[at : at + (1 << 30)])
            if not written:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            at += written
        os.fsync(descriptor)
    except BaseException:
        with contextlib.suppress(OSError):
            os.close(descriptor)
        raise
    os.close(descriptor)  # some network file systems tell only here that the disk is full


def _old(path: str) -> os.stat_result | None:
    """Return what is known of the file that will be replaced; of a link nothing is taken over."""
    try:
        old = os.lstat(path)
    except OSError:
        return None
    return old if stat.S_ISREG(old.st_mode) else None


def _take_permissions(descriptor: int, old: os.stat_result) -> None:
    """Give a new file the permissions, and if possible the owner, of an old one."""
    if not hasattr(os, "fchmod"):
        return
    new = os.fstat(descriptor)
    with contextlib.suppress(OSError):  # only root may give files away
        if (old.st_uid, old.st_gid) != (new.st_uid, new.st_gid):
            os.fchown(descriptor, old.st_uid, old.st_gid)
    with contextlib.suppress(OSError):  # some disks know no permissions; the umask took bits away
        os.fchmod(descriptor, old.st_mode & 0o777)


def _sync_folder(folder: str) -> None:
    """Bring the new name to the disk; the file itself is there already."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    except OSError:  # Windows opens no folders, nor do others that may be written to only
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):  # not for folders there
            raise
    finally:
        os.close(descriptor)


def _shown(path: str) -> str:
    return path.encode("utf-8", "backslashreplace").decode("utf-8")


def _reason(path: str, error: Exception) -> str:
    return f"{_shown(path)}: {getattr(error, 'strerror', None) or error}"
