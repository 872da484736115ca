"""The BSDF ``dispersive``: smooth glass whose index depends on the wavelength, with thin films."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError, VariantError
from ..optics import Medium, coating, glass
from ..optics.glass import CHANNELS, LINE_D, Constant
from .lens.ghosts import reflected
from .lens.glass import COUNT, FIRST, LAST, tabulated, wavelength_place
from .one_color import channel_of

__all__ = ["make_dispersive_class"]


def make_dispersive_class() -> type:
    """Return the class for the variant that is set now."""

    class Dispersive(mi.BSDF):
        r"""
        .. _bsdf-dispersive:

        Dispersive glass (:monosp:`dispersive`)
        ---------------------------------------

        .. pluginparameters::

         * - material
           - |string|
           - What is inside: a glass of a catalogue (``N-BK7``), n_d:V_d, or an index
             (Default: ``1.5168:64.17``).
         * - exterior
           - |string|
           - What is outside, on the side of the normals (Default: ``air``).
         * - int_ior, ext_ior
           - |float|
           - Indices in place of `material` and `exterior`, the same for all wavelengths. Whichever
             names the media, these are parameters with derivatives: the index at 587.6 nm, along
             with which those of all wavelengths move.
         * - coating
           - |string|
           - ``none``, ``ideal``, ``quarter_wave[:NANOMETRES]``, or layers
             ``INDEX:NANOMETRES, ...`` from the medium of the lower index to the other
             (Default: ``none``).

        Smooth glass as :monosp:`dielectric`, with the index of each wavelength. Light that is
        reflected keeps all of its wavelengths, or channels. One of them chooses where refracted
        light goes, and those that would have gone elsewhere end, which the weight makes up for.
        In rgb variants each channel has one index, and paths through two surfaces take three
        times the samples. Paths of one wavelength, or channel, as the sensor :monosp:`lens` sends
        them with ``dispersion``, lose nothing.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            if mi.is_polarized:
                raise VariantError("dispersive: expected a variant without polarization")
            inside = _medium(props, "material", "int_ior", "1.5168:64.17")
            outside = _medium(props, "exterior", "ext_ior", "air")
            self._names = inside.name, outside.name
            self._layers = coating(str(props.get("coating", "none")))
            self._inside, self._outside = _indices(inside), _indices(outside)
            self.int_ior, self.ext_ior = (
                dr.gather(mi.Float, table, 0) for table in (self._inside, self._outside)
            )
            dr.make_opaque(self.int_ior, self.ext_ior)
            both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            reflection = mi.BSDFFlags.DeltaReflection | both
            transmission = mi.BSDFFlags.DeltaTransmission | both | mi.BSDFFlags.NonSymmetric
            self.m_components = [reflection, transmission]
            self.m_flags = reflection | transmission

        def sample(
            self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """Return a direction and the weights of wavelengths, or channels."""
            cosine = mi.Frame3f.cos_theta(si.wi)
            active = mi.Mask(active) & (cosine != 0)
            front = cosine > 0
            before, behind, waves = self._lanes(si, front)
            lanes = range(len(before))
            across = dr.minimum(dr.abs(cosine), 1.0)
            share = [
                _mirrored(a, b, across, w, self._layers) for a, b, w in zip(before, behind, waves)
            ]
            passed = [1.0 - r for r in share]
            mirrored, through = sum(share) / len(lanes), sum(passed)
            reflects = ctx.is_enabled(mi.BSDFFlags.DeltaReflection, 0)
            transmits = ctx.is_enabled(mi.BSDFFlags.DeltaTransmission, 1)
            chance = mirrored if reflects and transmits else mi.Float(1.0 if reflects else 0.0)
            back = sample1 < chance
            # what is left of the number is uniform again: a lane is chosen by what it lets through
            rest = (sample1 - chance) / dr.maximum(1.0 - chance, 1e-7) * through
            n1, n2 = mi.Float(before[0]), mi.Float(behind[0])
            for a, b, t in zip(before[1:], behind[1:], passed):
                rest = rest - t
                later = rest >= 0
                n1, n2 = dr.select(later, a, n1), dr.select(later, b, n2)
            m = n1 / n2
            square = 1.0 - m * m * (1.0 - cosine * cosine)
            agree = [(a == n1) & (b == n2) for a, b in zip(before, behind)]
            same = sum(dr.select(ok, t, 0.0) for ok, t in zip(agree, passed))
            # radiance is spread over another solid angle
            spread = m * m if ctx.mode == mi.TransportMode.Radiance else mi.Float(1.0)
            part = same / dr.maximum(through, 1e-12) * (1.0 - chance)
            weights = []
            for r, t, ok in zip(share, passed, agree):
                one = dr.select(chance > 0, r / dr.maximum(chance, 1e-12), 0.0)
                two = dr.select(ok & (same > 0), t / dr.maximum(part, 1e-12) * spread, 0.0)
                weights.append(dr.select(active, dr.select(back, one, two), 0.0))
            out = dr.sqrt(dr.maximum(square, 0.0))
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = dr.select(
                back,
                mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z),
                mi.Vector3f(-m * si.wi.x, -m * si.wi.y, dr.select(front, -out, out)),
            )
            bs.eta = dr.select(back, 1.0, n2 / n1)
            bs.pdf = dr.select(active, dr.select(back, chance, part), 0.0)
            bs.sampled_component = dr.select(back, mi.UInt32(0), mi.UInt32(1))
            bs.sampled_type = dr.select(
                back,
                mi.UInt32(+mi.BSDFFlags.DeltaReflection),
                mi.UInt32(+mi.BSDFFlags.DeltaTransmission),
            )
            return bs, mi.Spectrum(*weights) if len(weights) > 1 else mi.Spectrum(weights[0])

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """Return zero: no direction that is not sampled carries light."""
            return mi.Spectrum(0.0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """Return zero: an ideal direction is never met by chance."""
            return mi.Float(0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            """Return zeros: an ideal direction is never met by chance."""
            return mi.Spectrum(0.0), mi.Float(0.0)

        def traverse(self, cb: Any) -> None:
            """Show the indices; they turn light, so that outlines behind the glass move."""
            flags = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
            cb.put("int_ior", self.int_ior, flags)
            cb.put("ext_ior", self.ext_ior, flags)

        def parameters_changed(self, keys: Any) -> None:
            """Check the indices; those that are none are set back to the media's own."""
            for name, table in (("int_ior", self._inside), ("ext_ior", self._outside)):
                value = np.array(dr.detach(getattr(self, name))).ravel()
                if value.shape != (1,) or not (np.isfinite(value) & (value > 0)).all():
                    setattr(self, name, dr.gather(mi.Float, table, 0))
                    raise BezierError.expected(name, "one positive number", value.tolist())

        def _shifted(self, value: Any, table: Any, ior: Any) -> Any:
            # read as a table is, so that derivatives come out of recorded loops
            return value + (dr.gather(mi.Float, ior, 0) - dr.gather(mi.Float, table, 0))

        def _pair(self, read: Any) -> list[Any]:
            """Return indices outside and inside, of which `read` finds those of the tables."""
            return [
                self._shifted(read(table), table, ior)
                for table, ior in ((self._outside, self.ext_ior), (self._inside, self.int_ior))
            ]

        def _lanes(self, si: Any, front: Any) -> tuple[list[Any], list[Any], list[Any]]:
            """Return indices before and behind, and nanometres, of each wavelength or channel."""
            before: list[Any] = []
            behind: list[Any] = []
            waves: list[Any] = []
            if mi.is_spectral:
                for k in range(len(si.wavelengths)):
                    w = si.wavelengths[k]
                    place = wavelength_place(w)
                    row = mi.UInt32(place)
                    pair = self._pair(
                        lambda table, row=row, place=place: dr.lerp(
                            dr.gather(mi.Float, table, row + 4),
                            dr.gather(mi.Float, table, row + 5),
                            place - mi.Float(row),
                        )
                    )
                    _append(pair, w, front, (before, behind, waves))
            elif mi.is_rgb:
                channel, known = channel_of(si.time)
                for k, w in enumerate(CHANNELS):
                    row = dr.select(known, channel, k) + 1
                    pair = self._pair(lambda table, row=row: dr.gather(mi.Float, table, row))
                    _append(pair, 1e3 * w, front, (before, behind, waves))
            else:
                row = mi.UInt32(0)
                pair = self._pair(lambda table: dr.gather(mi.Float, table, row))
                _append(pair, 587.6, front, (before, behind, waves))
            return before, behind, waves

        def to_string(self) -> str:
            return f"Dispersive[{self._names[0]} in {self._names[1]}]"

    return Dispersive


def _medium(props: mi.Properties, name: str, ior: str, default: str) -> Medium:
    """Return a medium by its name, or by its index."""
    if ior not in props:
        return glass(str(props.get(name, default)))
    value = props[ior]
    if name in props:
        raise BezierError.expected(ior, f"it or {name}, not both", f"{value} and {props[name]}")
    if not isinstance(value, int | float) or not 0 < value < np.inf:
        raise BezierError.expected(ior, "a positive number", repr(value))
    return Constant(float(value), f"{value:g}")


def _append(pair: list[Any], wave: Any, front: Any, lanes: tuple[list[Any], ...]) -> None:
    outside, inside = pair
    lanes[0].append(dr.select(front, outside, inside))
    lanes[1].append(dr.select(front, inside, outside))
    lanes[2].append(wave)


def _indices(medium: Medium) -> Any:
    """Return indices on the device: at the d line, of three channels, and at equal steps."""
    steps = np.linspace(FIRST, LAST, COUNT) * 1e-3
    return mi.Float(tabulated(medium, np.concatenate([[LINE_D], CHANNELS, steps]), LINE_D))


def _mirrored(before: Any, behind: Any, cosine: Any, wave: Any, layers: Any) -> Any:
    """Return the share that is reflected; layers are on the side of the lower index."""
    share = reflected(before, behind, cosine, wave, layers)
    return dr.select(before == behind, 0.0, share) if not layers else share
