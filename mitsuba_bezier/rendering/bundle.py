"""The files of a scene in one piece, for machines that do not have them.

They keep their places relative to each other, so that names in the scene lead to the same files.
Where a bundle is unpacked, every file is held against its hash.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from .._files import write_file
from ..errors import FileFormatError

__all__ = ["Bundle", "make_bundle"]


@dataclass(frozen=True)
class Bundle:
    """Files by their relative names, and what the command line called them.

    Attributes
    ----------
    files : dict of str to bytes
        Contents.
    inputs : tuple of str
        Relative names of the scene, or of models.
    folders : tuple of str
        Relative names of more folders that are searched.
    digest : str
        Hash of all of that.
    """

    files: dict[str, bytes]
    inputs: tuple[str, ...]
    folders: tuple[str, ...]
    digest: str

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(map(len, self.files.values()))

    def unpack(self, folder: str | os.PathLike[str] | None = None) -> Path:
        """Write what is not there yet to a folder named by the hash, and return that.

        Parameters
        ----------
        folder : path-like, optional
            Where; by default in the folder for temporary files.

        Raises
        ------
        FileFormatError
            If the bundle is damaged, or a file cannot be written.
        """
        if _digest(self.files, self.inputs, self.folders) != self.digest:
            raise FileFormatError.expected("bundle", f"files of hash {self.digest}", "others")
        user = os.getuid() if hasattr(os, "getuid") else 0
        root = Path(folder or tempfile.gettempdir()) / f"mitsuba_bezier_{user}_{self.digest}"
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and root.stat().st_uid != user:
            raise FileFormatError.expected("bundle", "a folder of one's own", str(root))
        for name in self.folders:
            (root / name).mkdir(parents=True, exist_ok=True)
        for name, data in self.files.items():
            path = root / name
            # several processes of one machine may be at it
            if not path.is_file() or path.stat().st_size != len(data) or path.read_bytes() != data:
                write_file(path, data, make_folders=True)
        return root


def make_bundle(
    files: Sequence[Path], inputs: Sequence[str | Path], folders: Sequence[str | Path] = ()
) -> Bundle:
    """Read the files of a scene.

    Parameters
    ----------
    files : sequence of Path
        All of them, see `verification.fingerprint.scene_files`.
    inputs : sequence of path
        The scene, or models, as the command line names them.
    folders : sequence of path
        More folders in which the scene's files are looked for.
    """
    absolute = {Path(os.path.abspath(path)): None for path in (*files, *inputs)}
    homes = [str(path.parent) for path in absolute] + [os.path.abspath(f) for f in folders]
    root = os.path.commonpath(homes)

    def relative(path: str | os.PathLike[str]) -> str:
        return PurePosixPath(os.path.relpath(os.path.abspath(path), root)).as_posix()

    contents = {relative(path): path.read_bytes() for path in absolute}
    names = tuple(relative(path) for path in inputs)
    places = tuple(relative(path) for path in folders)
    return Bundle(contents, names, places, _digest(contents, names, places))


def _digest(files: dict[str, bytes], inputs: Sequence[str], folders: Sequence[str]) -> str:
    total = hashlib.sha256(repr((tuple(inputs), tuple(folders))).encode())
    for name in sorted(files):
        total.update(f"{name}\0".encode() + hashlib.sha256(files[name]).digest())
    return total.hexdigest()[:32]
