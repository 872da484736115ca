"""Attributes of Bézier shapes: numbers per patch, and Bernstein polynomials on the patches.

To Mitsuba they are texture attributes, so that its `mesh_attribute` texture finds them.
"""

from __future__ import annotations

from math import isqrt
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import BezierError
from ...geometry import bernstein
from ...geometry.linear import SINGULAR, hadamard_ratio
from ...kernels.patch import bernstein_basis

__all__ = [
    "check_attribute",
    "check_texcoords",
    "is_attribute",
    "make_attribute_class",
    "parameters_of",
    "spectrum_coefficients",
    "to_parameters",
]


def is_attribute(name: str) -> bool:
    """Return whether a parameter of this name is an attribute, as of `mi.Mesh`."""
    return name.startswith(("face_", "vertex_"))


def check_attribute(name: str, values: Any, count: int) -> np.ndarray:
    """Check an attribute.

    Parameters
    ----------
    name : str
        Begins with ``face_`` or ``vertex_``.
    values : array or tensor
    count : int
        Number `P` of patches.

    Returns
    -------
    (P, K, C) array
        Bernstein ordinates in net order, with ``K = 1`` for an attribute per patch.

    Raises
    ------
    BezierError
        If the shape is wrong or a number is not finite.
    """
    array = _numbers(name, values)
    if name.startswith("face_"):
        shapes = f"shape ({count},), ({count}, 1) or ({count}, 3), for {count} patches"
        good = array.ndim in (1, 2)
        rows = (-1, 1, array.shape[1] if array.ndim == 2 else 1)
    else:
        shapes = (
            f"shape ({count}, K) or ({count}, K, C), for {count} patches, with K = (m+1)(m+2)/2 "
            "ordinates, m >= 1, and C = 1 or 3"
        )
        good = array.ndim in (2, 3) and _degree(array.shape[1]) >= 1
        rows = (*array.shape[:2], *(array.shape[2:] or (1,)))
    if not good or len(array) != count or rows[2] not in (1, 3):
        raise BezierError.expected(name, shapes, f"{array.shape}")
    return array.reshape(rows)


def check_texcoords(values: Any, count: int) -> np.ndarray:
    """Check texture coordinates; return ``(P, 3, 2)``."""
    array = _numbers("texcoords", values)
    if array.shape == (3, 2):
        array = array[None]
    if array.shape != (count, 3, 2):
        raise BezierError.expected(
            "texcoords",
            f"shape ({count}, 3, 2): uv at the corners A, B, C of {count} patches",
            f"{array.shape}",
        )
    return array


def _numbers(name: str, values: Any) -> np.ndarray:
    if not hasattr(values, "shape"):
        raise BezierError.expected(name, "a tensor", repr(values))
    array = np.array(values, dtype=np.float64).reshape(tuple(values.shape))
    if not np.isfinite(array).all():
        place = tuple(int(x) for x in np.argwhere(~np.isfinite(array))[0])
        raise BezierError.expected(name, "finite numbers", f"{array[place]} at {place}")
    return array


def _degree(count: int) -> int:
    """Return m for ``(m+1)(m+2)/2`` ordinates, -1 for another number."""
    m = (isqrt(8 * count + 1) - 3) // 2
    return m if count and bernstein.size(m) == count else -1


def to_parameters(texcoords: np.ndarray, name: str) -> np.ndarray:
    """Return the maps ``(P, 6)`` from texture coordinates to ``(u, v)``: c, then two rows.

    Raises
    ------
    BezierError
        If the corners of a patch have texture coordinates on one line.
    """
    c = texcoords[:, 2]
    matrix = np.stack([texcoords[:, 0] - c, texcoords[:, 1] - c], axis=2)
    # 1e-12 of the sine: what rounding leaves of three corners on one line
    flat = ~(hadamard_ratio(matrix) > SINGULAR)
    if flat.any():
        patch = int(np.flatnonzero(flat)[0])
        raise BezierError.expected(
            "texcoords",
            f'corners that are not on one line, for "{name}" to be found by them',
            f"{texcoords[patch].tolist()} at patch {patch}",
        )
    return np.concatenate([c, np.linalg.inv(matrix).reshape(-1, 4)], axis=1)


def parameters_of(back: Any, si: Any, active: Any) -> tuple[Any, Any]:
    """Return the parameters of a hit from its texture coordinates, by the maps of `to_parameters`.

    With `back` None the texture coordinates are the parameters.
    """
    if back is None:
        return si.uv.x, si.uv.y
    x, y, a, b, c, d = (dr.gather(mi.Float, back, 6 * si.prim_index + k, active) for k in range(6))
    x, y = si.uv.x - x, si.uv.y - y
    return dr.fma(a, x, b * y), dr.fma(c, x, d * y)


def spectrum_coefficients(colours: np.ndarray) -> np.ndarray:
    """Return the coefficients ``(N, 3)`` of smooth spectra of linear colours ``(N, 3)``."""
    return np.array([np.array(mi.srgb_model_fetch(c.tolist())) for c in colours.clip(0, 1)])


def make_attribute_class() -> type:
    """Return the class for the variant that is set now."""

    class BezierAttribute(mi.Texture):
        """One attribute; evaluated from `prim_index` and `uv` of a surface interaction."""

        def __init__(self, name: str, ordinates: np.ndarray) -> None:
            super().__init__(mi.Properties("bezierattribute"))
            self.name = name
            self.back: Any = None
            self.set(ordinates)

        def set(self, ordinates: np.ndarray, values: Any = None) -> None:
            """Take over ordinates ``(P, K, C)``; `values` are the same, with derivatives."""
            #: As users give it: ``(P, C)`` for an attribute per patch, else ``(P, K, C)``.
            self.public = ordinates[:, 0] if self.name.startswith("face_") else ordinates
            self.count, self.channels = ordinates.shape[1:]
            self.degree = _degree(self.count)
            flat = ordinates.astype(np.float32)
            self.values = mi.Float(flat.ravel()) if values is None else values
            self._mean, self._max = float(flat.mean()), float(flat.max())
            self._coefficients = None
            if mi.is_spectral and self.channels == 3:
                # as Mitsuba's meshes: colours become the coefficients of smooth spectra
                self._coefficients = mi.Float(spectrum_coefficients(flat.reshape(-1, 3)).ravel())

        def place_by(self, texcoords: np.ndarray | None) -> None:
            """Take over the texture coordinates ``(P, 3, 2)`` of the shape, None for parameters."""
            if texcoords is None or self.degree == 0:
                self.back = None
            else:
                self.back = mi.Float(to_parameters(texcoords, self.name).ravel())

        def _channels(self, buffer: Any, si: Any, active: Any) -> list[Any]:
            basis = [1.0]
            if self.degree:
                u, v = parameters_of(self.back, si, active)
                basis = bernstein_basis(self.degree, u, v, 1.0 - u - v)
            first = si.prim_index * (self.count * self.channels)
            return [
                sum(
                    weight * dr.gather(mi.Float, buffer, first + (k * self.channels + c), active)
                    for k, weight in enumerate(basis)
                )
                for c in range(self.channels)
            ]

        def eval(self, si: Any, active: Any = True) -> Any:
            if self._coefficients is not None:
                spectrum = self._channels(self._coefficients, si, active)
                return mi.srgb_model_eval(mi.Vector3f(*spectrum), si.wavelengths)
            values = self._channels(self.values, si, active)
            if self.channels == 1:
                return mi.UnpolarizedSpectrum(values[0])
            colour = mi.Color3f(*values)
            return mi.UnpolarizedSpectrum(mi.luminance(colour) if mi.is_monochromatic else colour)

        def eval_1(self, si: Any, active: Any = True) -> Any:
            return self._of(1, si, active)[0]

        def eval_3(self, si: Any, active: Any = True) -> Any:
            return mi.Color3f(*self._of(3, si, active))

        def _of(self, channels: int, si: Any, active: Any) -> list[Any]:
            if self.channels != channels:
                raise BezierError.expected(
                    self.name, f"an attribute of size {channels}", f"one of size {self.channels}"
                )
            return self._channels(self.values, si, active)

        def mean(self) -> Any:
            return mi.Float(self._mean)

        def max(self) -> float:
            return self._max

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return f'BezierAttribute[name = "{self.name}", size = {self.channels}]'

        __repr__ = to_string

    return BezierAttribute
