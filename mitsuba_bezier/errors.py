"""The errors users can meet. Each message names the parameter, what was expected, what came."""

from __future__ import annotations

__all__ = [
    "BezierError",
    "DerivativeWarning",
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

    Examples
    --------
    >>> try:
    ...     mb.sphere(radius=-1)
    ... except mb.BezierError as error:
    ...     print(error)
    radius: expected a positive length, got -1
    """

    @classmethod
    def expected(cls, parameter: str, expected: str, got: object) -> BezierError:
        """Build the standard message: ``parameter: expected ..., got ...``."""
        return cls(f"{parameter}: expected {expected}, got {got}")


class NetError(BezierError):
    """A control net of the wrong shape or with unusable numbers.

    Examples
    --------
    >>> mb.BezierTriangles(np.ones((1, 5, 4)))
    Traceback (most recent call last):
    ...
    mitsuba_bezier.errors.NetError: control_points: expected K = (n+1)(n+2)/2 ..., got K = 5
    """


class GeometryError(BezierError):
    """A geometric construction that its input does not determine.

    Examples
    --------
    >>> mb.plane(u=(1, 0, 0), v=(2, 0, 0))
    Traceback (most recent call last):
    ...
    mitsuba_bezier.errors.GeometryError: u, v: expected independent directions, got ...
    """


class FileFormatError(BezierError):
    """A file that is missing, damaged, or of a kind that cannot be used.

    Examples
    --------
    >>> mb.load("no such file.vtu")
    Traceback (most recent call last):
    ...
    mitsuba_bezier.errors.FileFormatError: path: expected a file that can be read, got ...
    """


class VariantError(BezierError):
    """A Mitsuba variant that cannot run these plugins, or none at all.

    Examples
    --------
    >>> mi.set_variant("scalar_rgb")
    >>> scene = mi.load_dict({"type": "scene", "ball": mb.shape(mb.sphere())})
    Traceback (most recent call last):
    ...
    RuntimeError: At dictionary node "ball": VariantError: variant: expected one of llvm_ad_rgb, ...
    """


class RuntimeSetupError(BezierError):
    """Something the machine lacks (LLVM, libatomic); the message says how to install it.

    Examples
    --------
    >>> issubclass(mb.RuntimeSetupError, mb.BezierError)
    True
    """


class PrescriptionError(BezierError):
    """A prescription of a lens, or a glass in it, that is not what was expected."""


class DerivativeWarning(UserWarning):
    """A derivative that leaves something out; the message names who has it. Said once.

    Examples
    --------
    >>> issubclass(mb.DerivativeWarning, UserWarning)
    True
    """
