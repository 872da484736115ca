"""The file from which a search goes on."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._files import write_file
from ..errors import FileFormatError

__all__ = ["read", "write"]

#: Goes up when the contents change.
_VERSION = 1


def write(
    path: str | os.PathLike[str], about: Mapping[str, Any], arrays: Mapping[str, Any]
) -> None:
    """Write a checkpoint in one step: the old one stays until the new one is there.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    text = json.dumps({"version": _VERSION, "arrays": list(arrays), **about}, sort_keys=True)
    buffer = io.BytesIO()
    for array in (np.frombuffer(text.encode(), dtype=np.uint8), *arrays.values()):
        np.save(buffer, array, allow_pickle=False)
    write_file(path, buffer.getvalue(), "checkpoint")


def read(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return what `write` has written.

    Raises
    ------
    FileFormatError
        If it is not a checkpoint, or damaged.
    """
    try:
        with open(path, "rb") as file:
            about = json.loads(np.load(file, allow_pickle=False).tobytes())
            if about.pop("version") != _VERSION:
                raise ValueError("of another version")
            arrays = {name: np.load(file, allow_pickle=False) for name in about.pop("arrays")}
    except (OSError, ValueError, KeyError, EOFError, MemoryError, AttributeError) as error:
        reason = str(error).split("\n")[0]
        raise FileFormatError(
            f"checkpoint: expected a file of mitsuba_bezier.fit, got {os.fspath(path)} ({reason})"
        ) from None
    return about, arrays
