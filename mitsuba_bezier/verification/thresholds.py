"""Limits that decide over pass and fail, from a TOML file or the command line.

::

    [default]
    rmse = 1e-3
    allow_nan = false

    [images."spheres/*"]          # file name without suffix, with its folders; * and ? match
    flip = 0.02

    [images."*:nn"]               # only the layer nn of every image
    max_abs = 1e-4

Tables further down overrule those before them; flags of the command line overrule all.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from typing import Any

from ..errors import FileFormatError
from .ztest import PASSING_SHARE

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["Limits", "Thresholds", "limits_from"]

_SWITCHES = ("z_test", "allow_nan")


@dataclass(frozen=True)
class Limits:
    """What one layer must keep to. None: no limit.

    Attributes
    ----------
    rmse, relative_mse, max_abs : float or None
        Upper limits, see `metrics.Metrics`.
    flip : float or None
        Upper limit of the mean FLIP error.
    z_test : bool or None
        True: the Z-test must be possible and pass; False: it is not judged; None: it is
        judged where it is possible.
    z_share : float
        Share of pixels that must pass the Z-test.
    allow_nan : bool
        Whether pixels that are not finite are let pass.
    """

    rmse: float | None = None
    relative_mse: float | None = None
    max_abs: float | None = None
    flip: float | None = None
    z_test: bool | None = None
    z_share: float = PASSING_SHARE
    allow_nan: bool = False

    @property
    def any_number(self) -> bool:
        """Whether a limit on a distance is given."""
        return any(v is not None for v in (self.rmse, self.relative_mse, self.max_abs, self.flip))


def limits_from(values: Mapping[str, Any], where: str, base: Limits | None = None) -> Limits:
    """Return `base` with the given values in place of its own, checked.

    Raises
    ------
    FileFormatError
        If a key is unknown or a value not of its kind; the message begins with `where`.
    """
    known = [f.name for f in fields(Limits)]
    checked: dict[str, Any] = {}
    for key, value in values.items():
        if key not in known:
            raise FileFormatError.expected(where, f"one of {', '.join(known)}", f"'{key}'")
        if key in _SWITCHES:
            if not isinstance(value, bool):
                raise FileFormatError.expected(f"{where}: {key}", "true or false", f"{value!r}")
        elif isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= 0:
            raise FileFormatError.expected(f"{where}: {key}", "a number >= 0", f"{value!r}")
        elif key == "z_share" and value > 1:
            raise FileFormatError.expected(f"{where}: {key}", "a share from 0 to 1", f"{value!r}")
        checked[key] = value
    return replace(base or Limits(), **checked)


#: What a file of limits may have: bytes, and dots or brackets in a line. tomllib takes memory with
#: the square of the parts of a dotted key, and Python's stack with the depth of brackets.
_MAX_BYTES = 1 << 20
_MAX_NESTED = 60


def _parse(name: str, text: bytes) -> dict[str, Any]:
    """Return the contents of a TOML file."""
    if len(text) > _MAX_BYTES:
        raise FileFormatError.expected(name, f"a TOML file of {_MAX_BYTES} bytes at most", "more")
    for number, line in enumerate(text.split(b"\n"), start=1):
        if line.count(b".") > _MAX_NESTED or line.count(b"[") + line.count(b"{") > _MAX_NESTED:
            expected = f"a TOML file with at most {_MAX_NESTED} dots or brackets in a line"
            raise FileFormatError.expected(name, expected, f"more in line {number}")
    try:
        return tomllib.loads(text.decode("utf-8-sig"))
    except RecursionError:
        raise FileFormatError.expected(name, "a valid TOML file", "one too deep") from None
    except ValueError as error:  # of tomllib itself, of the encoding, of numbers and dates
        raise FileFormatError.expected(name, "a valid TOML file", str(error)[:200]) from None


class Thresholds:
    """Limits by image and layer.

    Parameters
    ----------
    default : mapping, optional
        Values for all images.
    images : mapping of str to mapping, optional
        Values by pattern of ``image`` or ``image:layer``.
    flags : mapping, optional
        Values that overrule all others.
    where : str
        What error messages call the source.
    """

    def __init__(
        self,
        default: Mapping[str, Any] | None = None,
        images: Mapping[str, Mapping[str, Any]] | None = None,
        flags: Mapping[str, Any] | None = None,
        where: str = "thresholds",
    ) -> None:
        self._default = dict(default or {})
        self._images = {pattern: dict(values) for pattern, values in (images or {}).items()}
        self._flags = dict(flags or {})
        self._where = where
        limits_from(self._default, f"{where}: default")
        for pattern, values in self._images.items():
            limits_from(values, f'{where}: images."{pattern}"')
        limits_from(self._flags, "flags")

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], flags: Mapping[str, Any] | None = None
    ) -> Thresholds:
        """Read a TOML file.

        Raises
        ------
        FileFormatError
            If the file cannot be read, is no TOML, or has tables, keys or values that are
            not known.
        """
        name = os.fspath(path)
        try:
            with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as file:
                if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):  # it may never end
                    raise FileFormatError.expected(name, "a TOML file", "no regular file")
                text = file.read(_MAX_BYTES + 1)
            data = _parse(name, text)
        except OSError as error:
            raise FileFormatError.expected(name, "a TOML file", f"{error.strerror}") from None
        images = data.get("images", {})
        unknown = set(data) - {"default", "images"}
        tables = [data.get("default", {}), images]
        tables += images.values() if isinstance(images, dict) else []
        if unknown or not all(isinstance(table, dict) for table in tables):
            raise FileFormatError.expected(
                name, 'the tables [default] and [images."pattern"]', ", ".join(sorted(data))
            )
        return cls(data.get("default"), images, flags, name)

    def limits(self, image: str, layer: str = "") -> Limits:
        """Return the limits of one layer (``""``: colour) of the image of that name."""
        result = limits_from(self._default, self._where)
        for pattern, values in self._images.items():
            name = f"{image}:{layer}" if ":" in pattern else image
            if fnmatchcase(name, pattern):
                result = limits_from(values, self._where, result)
        return limits_from(self._flags, "flags", result)
