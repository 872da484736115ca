"""The folder of what a run leaves, `bezier-artifacts/`: nothing of an earlier run stays in it.

Every file is noted in ``files.txt`` before it is written, so that the next run can remove it, even
after a run that was killed, and removes nothing else, whatever the folder is.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import stat
import tempfile
from pathlib import Path

from .._files import write_file
from ..errors import FileFormatError

__all__ = ["Artifacts", "safe_name"]

_LIST = "files.txt"


def safe_name(nodeid: str) -> str:
    """Return a folder name for a test, another for each."""
    name = re.sub(r"[^\w.-]+", "_", nodeid)
    if re.fullmatch(r"[\w.-]+::\w+", nodeid) and len(name) < 120:
        return name
    return f"{name[:100]}-{hashlib.sha256(nodeid.encode('utf-8', 'replace')).hexdigest()[:8]}"


class Artifacts:
    """Files below one folder.

    Parameters
    ----------
    folder : Path
        The folder; it need not be there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def clean(self) -> None:
        """Remove the files that earlier runs noted, and folders that are empty then."""
        notes = self.folder / _LIST
        try:
            lines = notes.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeError):
            return
        folders = set()
        for line in dict.fromkeys(lines):
            path = self.folder / line
            # a list that somebody else wrote leads nowhere else
            inside = not Path(line).is_absolute() and ".." not in Path(line).parts
            if not line or not inside or not self._is_own(path.parent):
                continue
            with contextlib.suppress(OSError):
                path.unlink()
            folders |= {self.folder / parent for parent in Path(line).parents}
        with contextlib.suppress(OSError):
            notes.unlink()
        for place in sorted(folders, key=lambda p: len(p.parts), reverse=True):
            with contextlib.suppress(OSError):
                place.rmdir()  # only if nothing else is in it

    def _is_own(self, folder: Path) -> bool:
        """Tell whether a folder is below ours without a link on the way."""
        try:
            folder.resolve().relative_to(self.folder.resolve())
        except (OSError, ValueError):
            return False
        return True

    def write(self, name: str, data: bytes) -> Path:
        """Write a file below the folder.

        Where that cannot be, such as in a checkout that is read-only, it goes to a folder of the
        same user's temporary files, and so do all later ones.

        Raises
        ------
        FileFormatError
            If neither can be written.
        """
        try:
            return self._write(name, data)
        except FileFormatError:
            spare = _spare(self.folder)
            if self.folder == spare or not _is_read_only(self.folder):
                raise
            _own_folder(spare.parent)
            self.folder = spare
            return self._write(name, data)

    def _write(self, name: str, data: bytes) -> Path:
        path = self.folder / name
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with open(self.folder / _LIST, "a", encoding="utf-8") as notes:
                notes.write(f"{name}\n")
        except OSError as error:
            raise FileFormatError.expected(
                str(path), "a file that can be written", error.strerror or error
            ) from None
        write_file(path, data, make_folders=True)
        return path

    def remove(self, name: str) -> None:
        """Remove a file of this run, if it is there."""
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()


def _is_read_only(folder: Path) -> bool:
    """Tell whether no file can be made in a folder, or in the first above it that is there."""
    while not folder.exists() and folder.parent != folder:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            return not folder.is_dir()
    except FileNotFoundError:
        return True
    except OSError as error:
        return error.errno in (errno.EROFS, errno.EACCES, errno.EPERM, errno.ENOTDIR)


def _own_folder(folder: Path) -> None:
    """Make a folder that nobody else can write to, or be sure that it is one."""
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or (hasattr(os, "getuid") and found.st_uid != os.getuid()):
        raise FileFormatError.expected("artefacts", "a folder of one's own", f"{folder}")


def _spare(folder: Path) -> Path:
    user = os.getuid() if hasattr(os, "getuid") else ""
    number = hashlib.sha256(str(folder).encode("utf-8", "replace")).hexdigest()[:12]
    return Path(tempfile.gettempdir(), f"mitsuba-bezier-{user}-{number}", folder.name)
