"""Writing a file whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import FileFormatError

__all__ = ["replacing"]


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path`, made to be `path` at the end if all went well.

    Folders on the way are made.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    path = Path(path)
    # the suffix stays: some writers choose the format by it
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # OpenEXR raises the latter
        reason = getattr(error, "strerror", None) or str(error)
        raise FileFormatError.expected(str(path), "a file that can be written", reason) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
