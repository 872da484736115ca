"""Indices of a lens's glass on the device: by channel or wavelength, with derivatives."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import PrescriptionError
from ...optics import Lens, Medium
from ...optics.glass import CHANNELS, abbe_numbers, abbe_terms, absorption

__all__ = ["COUNT", "FIRST", "LAST", "Glass", "Light", "tabulated", "wavelength_place"]

#: Wavelengths in nanometres at which indices are tabulated.
FIRST, LAST, COUNT = 360.0, 830.0, 95


class Light:
    """What a ray is made of: the rows of tables that its index is read from.

    Attributes
    ----------
    row : UInt32 or None
        A row of the table, or None for one between two of them.
    place : Float
        Where between the rows, for wavelengths.
    waves : float, Color3f or Spectrum
        In nanometres, of what a weight has components for.
    """

    def __init__(self, row: Any, place: Any, waves: Any):
        self.row, self.place, self.waves = row, place, waves


def wavelength_place(nanometres: Any) -> Any:
    """Return where wavelengths stand between the rows of a table."""
    place = (nanometres - FIRST) * ((COUNT - 1) / (LAST - FIRST))
    return dr.clip(place, 0.0, COUNT - 1.001)


class Glass:
    """The media of a lens, from the scene to the film.

    Attributes
    ----------
    nd, vd : Float
        ``(S,)`` of the medium behind each surface, front first; V_d is 0 without dispersion.
    """

    def __init__(self, lens: Lens):
        media = lens.media()
        self.count = len(media)
        reference = lens.wavelengths[lens.reference]
        waves = np.linspace(FIRST, LAST, COUNT) * 1e-3
        # rows: the reference, three channels, then wavelengths; columns: media
        self._waves = np.concatenate([[reference], CHANNELS, waves])
        rows = np.array([tabulated(m, self._waves, reference) for m in media]).T
        self._index = mi.Float(rows.ravel())
        scale = lens.millimetres
        fades = np.array([scale * absorption(m, self._waves) for m in media]).T
        self.absorbs = bool(fades.any())
        self._fades = mi.Float(fades.ravel())
        numbers = np.array([_numbers(m, rows[0, i]) for i, m in enumerate(media)])[1:]
        self.nd, self.vd = mi.Float(numbers[:, 0]), mi.Float(numbers[:, 1])
        self._start = mi.Float(self.nd), mi.Float(self.vd)
        p, q = abbe_terms(self._waves)
        self._p, self._q = mi.Float(p), mi.Float(q)
        self.changed = False  # whether n_d and V_d are no longer the prescription's

    def index(self, light: Light, k: Any) -> Any:
        """Return the index of medium `k`, counted from the film."""
        medium = self.count - 1 - mi.UInt32(k)

        def read(row: Any) -> Any:
            n = dr.gather(mi.Float, self._index, row * self.count + medium)
            if self.changed or dr.grad_enabled(self.nd, self.vd):
                n = n + self._moved(row, medium)
            return n

        if light.row is not None:
            return read(light.row)
        row = mi.UInt32(light.place)
        return dr.lerp(read(row + 4), read(row + 5), light.place - mi.Float(row))

    def _moved(self, row: Any, medium: Any) -> Any:
        """Return how far n_d and V_d have moved an index: as on the normal line of glass."""
        inside = medium > 0
        at = dr.select(inside, medium - 1, 0)
        p, q = dr.gather(mi.Float, self._p, row), dr.gather(mi.Float, self._q, row)
        values = []
        for nd, vd in ((self.nd, self.vd), self._start):
            n, v = dr.gather(mi.Float, nd, at), dr.gather(mi.Float, vd, at)
            # V_d of 0 stands for no dispersion
            spread = dr.select(v > 0, p / dr.select(v > 0, v, 1.0) + q, 0.0)
            values.append(n + (n - 1) * spread)
        return dr.select(inside, values[0] - values[1], 0.0)

    def medium(self, i: int, given: Medium, nd: float, vd: float) -> Medium:
        """Return the medium behind surface `i` with other numbers, as the device has it."""
        if nd == float(self._start[0][i]) and vd == float(self._start[1][i]):
            return given
        return Moved(given, nd, vd)

    def faded(self, light: Light, k: Any, way: Any) -> Any:
        """Return the share of light left after a way in medium `k`, a weight's component each."""
        medium = self.count - 1 - mi.UInt32(k)

        def read(row: Any) -> Any:
            return dr.gather(mi.Float, self._fades, mi.UInt32(row) * self.count + medium)

        if mi.is_rgb:
            rate = mi.Spectrum(read(1), read(2), read(3))
        elif mi.is_spectral:
            rate = mi.Spectrum(0.0)
            for i in range(len(rate)):
                place = wavelength_place(light.waves[i])
                row = mi.UInt32(place)
                rate[i] = dr.lerp(read(row + 4), read(row + 5), place - mi.Float(row))
        else:
            rate = mi.Spectrum(read(0))
        return dr.exp(-rate * dr.maximum(way, 0.0))


class Moved:
    """A medium whose n_d and V_d have moved: its index follows the normal line of glass."""

    def __init__(self, medium: Medium, nd: float, vd: float):
        self.name, self._medium, self._numbers = medium.name, medium, (nd, vd)

    def index(self, wavelength: np.ndarray | float) -> np.ndarray:
        """Return indices at wavelengths in micrometres."""
        p, q = abbe_terms(wavelength)

        def model(nd: float, vd: float) -> np.ndarray:
            return nd + (nd - 1) * (p / vd + q if 0 < vd < np.inf else 0.0 * p)

        start = abbe_numbers(self._medium)
        return self._medium.index(wavelength) + model(*self._numbers) - model(*start)


def tabulated(medium: Medium, waves: np.ndarray, reference: float) -> np.ndarray:
    """Return indices at wavelengths; beyond the range of a glass those at its ends."""
    out = np.full(len(waves), np.nan)
    for i, w in enumerate(waves):
        try:
            out[i] = float(medium.index(w))
        except PrescriptionError:
            continue
    known = np.isfinite(out)
    if not known.any():
        return np.full(len(waves), float(medium.index(reference)))
    order = np.argsort(waves[known])
    return np.interp(waves, waves[known][order], out[known][order])


def _numbers(medium: Medium, n: float) -> tuple[float, float]:
    nd, vd = abbe_numbers(medium)
    return (nd if np.isfinite(nd) else float(n)), (vd if np.isfinite(vd) else 0.0)
