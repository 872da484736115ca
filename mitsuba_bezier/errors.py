"""The errors users can meet. Each message names the parameter, what was expected, what came."""

from __future__ import annotations

__all__ = [
    "BezierError",
    "FileFormatError",
    "GeometryError",
    "NetError",
    "PrescriptionError",
    "RuntimeSetupError",
    "VariantError",
]


class BezierError(ValueError):
    """Base of every error this package raises on purpose.

    The command line prints it as one line and exits with code 2.
    """

    @classmethod
    def expected(cls, parameter: str, expected: str, got: object) -> BezierError:
        """Build the standard message: ``parameter: expected ..., got ...``."""
        return cls(f"{parameter}: expected {expected}, got {got}")


class NetError(BezierError):
    """A control net of the wrong shape or with unusable numbers."""


class GeometryError(BezierError):
    """A geometric construction that its input does not determine."""


class FileFormatError(BezierError):
    """A file that is missing, damaged, or of a kind that cannot be used."""


class VariantError(BezierError):
    """A Mitsuba variant that cannot run these plugins, or none at all."""


class RuntimeSetupError(BezierError):
    """Something the machine lacks (LLVM, libatomic); the message says how to install it."""


class PrescriptionError(BezierError):
    """A prescription of a lens, or a glass in it, that is not what was expected."""
