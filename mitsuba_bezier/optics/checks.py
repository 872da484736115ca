"""Whether a prescription is possible: one error each, with the surface it is about.

`Lens` calls this when it is made; so there is no type here for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import PrescriptionError
from ..geometry.checks import finite_array

#: How the size of the beam is given: entrance pupil diameter, image-space f-number,
#: object-space numerical aperture, or the stop's own size.
APERTURES = ("diameter", "f_number", "object_na", "stop")

#: How fields are given.
FIELDS = ("angle", "object_height", "image_height")

#: Millimetres in the units of prescriptions.
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}

#: What is larger than the sun's distance in millimetres is a slip of the pen.
_LARGEST = 1e15

#: Points from the axis to the rim at which neighbours are compared.
_ACROSS = 65


def check_lens(lens: Any) -> None:
    """Raise an error if a lens is impossible.

    Raises
    ------
    PrescriptionError
        Which parameter, what was expected, what came.
    """
    _surfaces(lens)
    _beams(lens)
    _light(lens)
    _fields(lens)
    _crossing(crossings(lens, axis_only=True), "on the axis")


def check_body(lens: Any) -> None:
    """Raise an error if a lens cannot be made: a trace in order does not mind, a body does.

    Raises
    ------
    PrescriptionError
        If neighbours cross within their clear apertures.
    """
    _crossing(crossings(lens), "within their clear apertures")


def _crossing(found: Iterator[str], where: str) -> None:
    for sentence in found:
        raise PrescriptionError.expected(
            "surfaces", f"ones that do not cross {where}", f"a lens where {sentence}"
        )


def _numbers(name: str, expected: str, values: Any) -> np.ndarray:
    """Return values as an array of numbers."""
    try:
        return np.array(values, float)
    except (TypeError, ValueError):
        raise PrescriptionError.expected(name, expected, repr(values)) from None


def _finite(name: str, expected: str, values: Any) -> np.ndarray:
    """Return values as an array of finite numbers."""
    out = _numbers(name, expected, values)
    if not np.isfinite(out).all():
        raise PrescriptionError.expected(name, expected, values)
    return out


def _surfaces(lens: Any) -> None:
    if isinstance(lens.surfaces, str) or not hasattr(lens.surfaces, "__len__"):
        raise PrescriptionError.expected("surfaces", "a list of Surface", repr(lens.surfaces))
    if not len(lens.surfaces):
        raise PrescriptionError.expected("surfaces", "one surface at least", "none")
    for i, s in enumerate(lens.surfaces, start=1):
        if not hasattr(s, "curvature"):
            raise PrescriptionError.expected(f"surface {i}", "a Surface", repr(s))
        _medium(f"medium of surface {i}", s.medium)
    _medium("object_medium", lens.object_medium)
    stops = [str(i) for i, s in enumerate(lens.surfaces, start=1) if s.stop]
    if len(stops) > 1:
        raise PrescriptionError.expected("stop", "one surface", f"surfaces {', '.join(stops)}")
    for i, s in enumerate(lens.surfaces, start=1):
        _surface(f"of surface {i}", s)


def _medium(name: str, medium: Any) -> None:
    if not (hasattr(medium, "name") and hasattr(medium, "index")):
        raise PrescriptionError.expected(
            name, "a medium, such as optics.glass('N-BK7')", repr(medium)
        )


def _surface(where: str, s: Any) -> None:
    for name in ("curvature", "thickness", "conic"):
        value = _finite(f"{name} {where}", "a finite number", getattr(s, name))
        if not abs(value) <= _LARGEST:
            expected = f"a number up to {_LARGEST:g}"
            raise PrescriptionError.expected(f"{name} {where}", expected, getattr(s, name))
    if _finite(f"coefficients {where}", "finite numbers", s.coefficients).ndim != 1:
        raise PrescriptionError.expected(f"coefficients {where}", "numbers", s.coefficients)
    for name in ("before", "after"):
        motion = finite_array(f"{name} {where}", getattr(s, name), (4, 4), PrescriptionError)
        turn = motion[:3, :3]
        # angles of files have some six digits
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-5):
            raise PrescriptionError.expected(f"{name} {where}", "a rigid motion", motion.tolist())
    size = _numbers(f"semi-diameter {where}", "a positive number", s.semi_diameter)
    if not size > 0:
        raise PrescriptionError.expected(f"semi-diameter {where}", "a positive number", size)
    inner = _numbers(f"inner {where}", "a number from 0 on", s.inner)
    if not 0 <= inner < size:
        raise PrescriptionError.expected(
            f"inner {where}", f"a number from 0 to its semi-diameter {size:g}", inner
        )
    if np.isfinite(size) and size > s.reach() * (1 + 1e-9):
        end = "conic ends" if s.conic else "sphere ends"
        raise PrescriptionError.expected(
            f"semi-diameter {where}", f"at most {s.reach():.6g}, where the {end}", f"{size:.6g}"
        )


def _beams(lens: Any) -> None:
    if not _numbers("object_distance", "a length", lens.object_distance) > 0:
        raise PrescriptionError.expected(
            "object_distance", "a positive number or infinity", lens.object_distance
        )
    if lens.unit not in UNITS:
        raise PrescriptionError.expected("unit", f"one of {', '.join(UNITS)}", repr(lens.unit))
    if lens.aperture is None:
        return
    if isinstance(lens.aperture, str) or np.shape(lens.aperture) != (2,):
        raise PrescriptionError.expected("aperture", "a kind and a number", repr(lens.aperture))
    kind, value = lens.aperture
    if kind not in APERTURES:
        raise PrescriptionError.expected("aperture", f"one of {', '.join(APERTURES)}", repr(kind))
    number = _numbers(f"aperture {kind}", "a positive number", value)
    if not (0 < number < np.inf or (kind == "stop" and number == 0)):
        raise PrescriptionError.expected(f"aperture {kind}", "a positive number", value)


def _light(lens: Any) -> None:
    waves = _numbers("wavelengths", "positive numbers, in micrometres", lens.wavelengths)
    if waves.ndim != 1 or not len(waves) or not ((waves > 0) & (waves < np.inf)).all():
        got = lens.wavelengths if waves.size else "none"
        raise PrescriptionError.expected("wavelengths", "positive numbers, in micrometres", got)
    if lens.weights is not None:
        expected = f"{len(waves)} numbers from 0 on, not all of them 0"
        weights = _finite("weights", expected, lens.weights)
        if weights.shape != waves.shape or (weights < 0).any() or not weights.any():
            raise PrescriptionError.expected("weights", expected, lens.weights)
    if lens.reference not in range(len(waves)):
        raise PrescriptionError.expected(
            "reference", f"an index below {len(waves)}", lens.reference
        )


def _fields(lens: Any) -> None:
    if lens.field_kind not in FIELDS:
        raise PrescriptionError.expected(
            "field_kind", f"one of {', '.join(FIELDS)}", repr(lens.field_kind)
        )
    fields = _finite("fields", "finite pairs (x, y)", lens.fields)
    if fields.ndim != 2 or fields.shape[1:] != (2,):
        got = lens.fields if fields.size else "none"
        raise PrescriptionError.expected("fields", "finite pairs (x, y), one at least", got)
    for field in fields:
        check_field(lens, field, "fields")
    if lens.vignetting is not None:
        cuts = _finite("vignetting", "four finite numbers for each field", lens.vignetting)
        if cuts.shape != (len(fields), 4):
            raise PrescriptionError.expected(
                "vignetting", f"four numbers for each of {len(fields)} fields", cuts.shape
            )


def check_field(lens: Any, field: Any, name: str = "field") -> np.ndarray:
    """Return a field as an array, or raise an error.

    Raises
    ------
    PrescriptionError
        If it is no pair of finite numbers, or an angle of 90 degrees and more.
    """
    pair = _finite(name, "a finite pair (x, y)", field)
    if pair.shape != (2,):
        raise PrescriptionError.expected(name, "a finite pair (x, y)", field)
    if lens.field_kind == "angle" and not np.abs(pair).max() < 90:
        raise PrescriptionError.expected(
            name, "angles below 90 degrees", f"{pair[0]:g}, {pair[1]:g}"
        )
    return pair


def check_wavelength(wavelength: Any) -> np.ndarray:
    """Return wavelengths as an array, or raise an error.

    Raises
    ------
    PrescriptionError
        If one is not positive and finite.
    """
    w = _numbers("wavelength", "a positive number of micrometres", wavelength)
    if not ((w > 0) & (w < np.inf)).all():
        raise PrescriptionError.expected(
            "wavelength", "a positive number of micrometres", wavelength
        )
    return w


def placement(to_world: Any) -> np.ndarray:
    """Return the matrix ``(4, 4)`` of where a lens is to stand, by default where it is.

    Raises
    ------
    PrescriptionError
        If it is no finite matrix.
    """
    if to_world is None:
        return np.eye(4)
    return finite_array("to_world", to_world, (4, 4), PrescriptionError)


def crossings(lens: Any, axis_only: bool = False) -> Iterator[str]:
    """Yield a sentence for each pair of neighbours that cross inside their clear apertures.

    Neighbours are surfaces at which light is refracted or reflected. Planes in air between them, as
    stops, may stand anywhere. Without clear apertures, or if so asked, that is on the axis.
    """
    signs, media = lens.directions(), lens.media()
    last, way = -1, 0.0
    for i, s in enumerate(lens.surfaces):
        if last >= 0:
            turned = not (
                np.array_equal(lens.surfaces[i - 1].after, np.eye(4))
                and np.array_equal(s.before, np.eye(4))
            )
            if turned:
                last = -1
        if not (s.mirror or media[i] != media[i + 1]):
            way += s.thickness
            continue
        if last >= 0:
            front = lens.surfaces[last]
            size = min(front.semi_diameter, s.semi_diameter, front.reach(), s.reach())
            known = not axis_only and np.isfinite([front.semi_diameter, s.semi_diameter]).any()
            r = np.linspace(0, size, _ACROSS) if known else np.zeros(1)
            gap = signs[i] * (way + s.sag(r) - front.sag(r))
            least = int(np.nanargmin(gap))
            if gap[least] < -1e-9 * max(size if known else 0.0, abs(way)):
                yield (
                    f"surfaces {last + 1} and {i + 1} cross: {gap[least]:.4g} {lens.unit} "
                    f"apart at {r[least]:.4g} from the axis"
                )
        last, way = i, s.thickness
