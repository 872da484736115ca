"""The texture ``bezierfield``: a field on Bézier patches as colours, with isolines and edges."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError
from ..geometry import bernstein
from ..geometry.fields import MAGNITUDE
from ..kernels.arrays import upload
from ..kernels.float64_use import uses_pairs
from ..kernels.patch import bernstein_basis
from .colormaps import banded, color_table, linear_rgb
from .field_parameters import (
    read_color,
    read_count,
    read_field,
    read_limits,
    read_projection,
    read_width,
)
from .shape.attributes import (
    check_texcoords,
    parameters_of,
    spectrum_coefficients,
    to_parameters,
)

__all__ = ["make_field_class"]

#: Colours of a map in spectral variants: the nearest is taken, half a step off at most.
_SPECTRA = 1024


def make_field_class() -> type:
    """Return the class for the variant that is set now."""

    class BezierFieldTexture(mi.Texture):
        r"""
        .. _texture-bezierfield:

        Fields on Bézier patches (:monosp:`bezierfield`)
        ------------------------------------------------

        .. pluginparameters::

         * - ordinates
           - |tensor|
           - Bernstein ordinates of shape ``(P, K)`` or ``(P, K, C)`` on the patches of the shape,
             with ``K = (m+1)(m+2)/2`` for any degree ``m >= 0``.
         * - weights
           - |tensor|
           - Weights ``(P, K)``, if the field is a quotient; `ordinates` are multiplied by them.
         * - filename, field
           - |string|
           - A file, and the name of a field in it, instead.
         * - component
           - |string|
           - A number, or :monosp:`magnitude` (Default: the only one, or the magnitude).
         * - colormap
           - |string|
           - A name of matplotlib's, or :monosp:`none` for the values themselves
             (Default: :monosp:`viridis`).
         * - minimum, maximum
           - |float|
           - Values of the first and the last colour (Default: those of the field).
         * - levels
           - |int|
           - Number of bands of one colour each (Default: 0, colours run).
         * - isolines
           - |int|
           - Number of intervals between isolines (Default: 0, none).
         * - isoline_width, edge_width
           - |float|
           - Width of isolines, and of the sides of elements, in pixels (Default: 1.5, and 0: none).
         * - isoline_color, edge_color
           - |spectrum|
           - Their colour, linear RGB (Default: 0.02).
         * - edges
           - |tensor|
           - For each patch, whether the sides opposite of A, B, C are sides of an element,
             of shape ``(P, 3)`` (Default: those of the file, or all).
         * - world_to_pixel
           - |string|
           - Sixteen numbers: the projective map from the world to pixels, which lines need.
         * - texcoords
           - |tensor|
           - Those of the shape, if it has any.

        Values are exact at the hit. For a slot of one number, such as ``alpha``, it is the value
        itself, else its colour.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            field, edges = read_field(props)
            if (missing := field.missing()).any():
                raise BezierError.expected(
                    f"field {field.name!r}",
                    f"finite values on all {len(field)} patches",
                    f"none on {int(missing.sum())} of them",
                )
            self.field = field
            self.component = field.component(props.get("component", None))
            self.colormap = str(props.get("colormap", "viridis"))
            #: Values of the first and the last colour.
            self.limits = read_limits(
                props.get("minimum", None), props.get("maximum", None), field, self.component
            )
            self.levels = read_count(props, "levels")
            self.isolines = read_count(props, "isolines")
            self.width = read_width(props, "isoline_width", 1.5)
            self.edge_width = read_width(props, "edge_width", 0.0)
            self.isoline_color = read_color(props, "isoline_color")
            self.edge_color = read_color(props, "edge_color")
            self.pixels = read_projection(props)
            if self.pixels is None and (self.isolines or self.edge_width):
                raise BezierError.expected(
                    "world_to_pixel", "the map to pixels, for lines of some pixels", "none"
                )
            corners = props.get("texcoords", None)
            self.back = None
            if corners is not None:
                corners = check_texcoords(corners, len(field))
                self.back = mi.Float(to_parameters(corners, "bezierfield").ravel())
            self._prepare(edges)

        def _prepare(self, edges: np.ndarray | None) -> None:
            field = self.field
            if self.component == MAGNITUDE:
                values = field.ordinates
            else:
                values = field.ordinates[..., [int(self.component)]]
            self.channels = values.shape[2]
            if field.weights is not None:
                values = np.concatenate([values, field.weights[..., None]], axis=2)
            self.row = values.shape[1] * values.shape[2]
            #: Type of values, and what they are counted from: float32 has room for differences.
            self.number, self.vector, self.offset = mi.Float64, mi.Vector3d, 0.0
            if uses_pairs(mi.Float):
                self.number, self.vector = mi.Float, mi.Vector3f
                if self.component != MAGNITUDE:
                    self.offset = sum(self.limits) / 2
                    weight = 1.0 if field.weights is None else values[..., 1]
                    values[..., 0] -= self.offset * weight
            self.values = upload(self.number, values.ravel())
            self.edges = None
            if self.edge_width:
                sides = np.ones((len(field), 3), bool) if edges is None else edges
                self.edges = upload(mi.UInt32, (sides @ [1, 2, 4]).astype(np.uint32))
            self.table = self.spectra = None
            if self.colormap == "none":
                return
            if self.levels:
                colors = banded(self.colormap, self.levels)
            elif mi.is_spectral:
                colors = banded(self.colormap, _SPECTRA)
            else:
                colors = np.array(color_table(self.colormap))
            if mi.is_spectral:
                self.spectra = mi.Float(spectrum_coefficients(linear_rgb(colors)).ravel())
            if self.levels:
                colors = linear_rgb(colors)
            self.count = len(colors)
            self.table = mi.Float(colors.astype(np.float32).ravel())

        # ------------------------------------------------------------ values

        def value(self, si: Any, active: Any = True) -> tuple[Any, Any, Any]:
            """Return the value at a hit, less `offset`, and its partials by the parameters."""
            active = mi.Bool(active)
            u, v = (self.number(x) for x in parameters_of(self.back, si, active))
            n, width = self.field.degree, self.channels + (self.field.weights is not None)
            first = si.prim_index * self.row

            def net(channel: int) -> list[Any]:
                return [
                    dr.gather(self.number, self.values, first + (k * width + channel), active)
                    for k in range(bernstein.size(n))
                ]

            jets = [_jet(net(c), n, u, v) for c in range(self.channels)]
            if self.field.weights is not None:
                w, wu, wv = _jet(net(self.channels), n, u, v)
                w = dr.select(active, w, 1.0)
                jets = [(f / w, (fu - f / w * wu) / w, (fv - f / w * wv) / w) for f, fu, fv in jets]
            if self.component != MAGNITUDE:
                return jets[0]
            length = dr.sqrt(sum(f * f for f, _fu, _fv in jets))
            safe = dr.select(length > 0, length, 1.0)
            du, dv = (sum(jet[0] * jet[k] for jet in jets) / safe for k in (1, 2))
            return length, du, dv

        def scaled(self, value: Any) -> Any:
            """Return a value as a number from 0 to 1 between the limits."""
            low, high = self.limits
            return mi.Float((value - (low - self.offset)) / (high - low))

        # ------------------------------------------------------------ lines

        def _on_line(self, si: Any, value: Any, fu: Any, fv: Any, active: Any) -> tuple[Any, Any]:
            """Return whether a hit is on an isoline, and on the side of an element."""
            isoline = edge = mi.Bool(False)
            if self.pixels is None:
                return isoline, edge
            px, py, pw = (self._row(k, si.p, 1.0) for k in (0, 1, 3))
            across = []
            for d in self._partials(si, active):
                dx, dy, dw = (self._row(k, d, 0.0) for k in (0, 1, 3))
                across.append(((dx - px / pw * dw) / pw, (dy - py / pw * dw) / pw))
            (xu, yu), (xv, yv) = across
            det = xu * yv - xv * yu
            seen = active & (det != 0) & dr.isfinite(det)
            inv = 1.0 / dr.select(seen, det, 1.0)

            def per_pixel(du: Any, dv: Any) -> Any:
                """Return the length of the gradient by pixels."""
                gx, gy = (yv * du - yu * dv) * inv, (xu * dv - xv * du) * inv
                return dr.sqrt(gx * gx + gy * gy)

            if self.isolines > 1:
                low, high = (x - self.offset for x in self.limits)
                step = (high - low) / self.isolines
                # not at the ends: where the field has its extrema, lines shrink to points
                nearest = dr.clip(dr.round((value - low) / step), 1.0, self.isolines - 1.0)
                off = dr.abs(value - (low + nearest * step))
                slope = per_pixel(fu, fv)
                isoline = seen & (slope > 0) & (off < 0.5 * self.width * slope)
            if self.edges is not None:
                u, v = (self.number(x) for x in parameters_of(self.back, si, active))
                sides = dr.gather(mi.UInt32, self.edges, si.prim_index, active)
                for bit, (at, du, dv) in enumerate(
                    ((u, 1.0, 0.0), (v, 0.0, 1.0), (1.0 - u - v, -1.0, -1.0))
                ):
                    # half of it on either side: the other half is the neighbour's
                    near = at < 0.5 * self.edge_width * per_pixel(self.number(du), self.number(dv))
                    edge = edge | (seen & near & ((sides & (1 << bit)) != 0))
            return isoline, edge

        def _row(self, k: int, x: Any, w: float) -> Any:
            m = self.pixels[k]  # type: ignore[index]
            x = self.vector(x)
            return m[0] * x.x + m[1] * x.y + m[2] * x.z + m[3] * w

        def _partials(self, si: Any, active: Any) -> tuple[Any, Any]:
            """Return the partials of the point by the parameters of the patch."""
            pu, pv = self.vector(si.dp_du), self.vector(si.dp_dv)
            if self.back is None:
                return pu, pv
            # `back` takes texture coordinates to parameters: by its inverse partials go there
            a, b, c, d = (
                self.number(dr.gather(mi.Float, self.back, 6 * si.prim_index + k, active))
                for k in range(2, 6)
            )
            det = a * d - b * c
            det = dr.select(det != 0, det, 1.0)
            return (pu * d - pv * c) / det, (pv * a - pu * b) / det

        # ------------------------------------------------------------ mi.Texture

        def eval(self, si: Any, active: Any = True) -> Any:
            active = mi.Bool(active)
            value, fu, fv = self.value(si, active)
            if self.table is None:
                out = mi.UnpolarizedSpectrum(mi.Float(value + self.offset))
            elif self.spectra is not None:
                where = self._entry(value)
                parts = [dr.gather(mi.Float, self.spectra, 3 * where + k, active) for k in range(3)]
                out = mi.srgb_model_eval(mi.Vector3f(*parts), si.wavelengths)
            else:
                out = self._spectrum(self._rgb(value, active))
            isoline, edge = self._on_line(si, value, fu, fv, active)
            out = dr.select(edge, self._line(self.edge_color), out)
            return dr.select(isoline, self._line(self.isoline_color), out)

        def eval_1(self, si: Any, active: Any = True) -> Any:
            return mi.Float(self.value(si, active)[0] + self.offset)

        def eval_1_grad(self, si: Any, active: Any = True) -> Any:
            _value, fu, fv = self.value(si, active)
            if self.back is None:
                return mi.Vector2f(mi.Float(fu), mi.Float(fv))
            a, b, c, d = (
                dr.gather(mi.Float, self.back, 6 * si.prim_index + k, active) for k in range(2, 6)
            )
            fu, fv = mi.Float(fu), mi.Float(fv)
            return mi.Vector2f(a * fu + c * fv, b * fu + d * fv)

        def eval_3(self, si: Any, active: Any = True) -> Any:
            active = mi.Bool(active)
            value, fu, fv = self.value(si, active)
            if self.table is None:
                rgb = mi.Color3f(mi.Float(value + self.offset))
            else:
                rgb = self._rgb(value, active)
            isoline, edge = self._on_line(si, value, fu, fv, active)
            rgb = dr.select(edge, mi.Color3f(self.edge_color), rgb)
            return dr.select(isoline, mi.Color3f(self.isoline_color), rgb)

        def _entry(self, value: Any) -> Any:
            """Return the number of the colour of a value, where there are bands."""
            at = self.scaled(value) * self.count
            return mi.UInt32(dr.clip(at, 0.0, self.count - 1.0))

        def _rgb(self, value: Any, active: Any) -> Any:
            """Return the colour of a value, in linear RGB."""
            if self.levels or self.spectra is not None:
                where = self._entry(value)
                parts = [dr.gather(mi.Float, self.table, 3 * where + k, active) for k in range(3)]
                rgb = mi.Color3f(*parts)
                return rgb if self.levels else _linear(rgb)
            at = dr.clip(self.scaled(value), 0.0, 1.0) * (self.count - 1.0)
            low = dr.minimum(mi.UInt32(at), self.count - 2)
            share = at - mi.Float(low)
            ends = [
                [dr.gather(mi.Float, self.table, 3 * (low + e) + k, active) for k in range(3)]
                for e in (0, 1)
            ]
            return _linear(mi.Color3f(*(dr.lerp(a, b, share) for a, b in zip(*ends))))

        def _spectrum(self, rgb: Any) -> Any:
            return mi.UnpolarizedSpectrum(mi.luminance(rgb) if mi.is_monochromatic else rgb)

        def _line(self, color: list[float]) -> Any:
            rgb = mi.Color3f(color)
            if mi.is_spectral:
                return mi.UnpolarizedSpectrum(mi.luminance(rgb))
            return self._spectrum(rgb)

        def mean(self) -> Any:
            return mi.Float(0.5 if self.table is not None else sum(self.limits) / 2)

        def max(self) -> float:
            return 1.0 if self.table is not None else self.limits[1]

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            low, high = self.limits
            return (
                f"BezierFieldTexture[\n  field = {self.field!r},\n  component = {self.component},\n"
                f"  colormap = {self.colormap} from {low:.9g} to {high:.9g}\n]"
            )

        __repr__ = to_string

    return BezierFieldTexture


def _jet(net: list[Any], n: int, u: Any, v: Any) -> tuple[Any, Any, Any]:
    """Return a polynomial and its partials, by the last step of de Casteljau's algorithm."""
    if n == 0:
        zero = dr.zeros(type(u), dr.width(u))
        return net[0], zero, zero
    basis = [1.0] if n == 1 else bernstein_basis(n - 1, u, v, 1.0 - u - v)
    a = b = c = type(u)(0.0)
    for factor, (i, j, _k) in zip(basis, bernstein.multi_indices(n - 1).tolist()):
        a = a + factor * net[bernstein.row(n, i + 1, j)]
        b = b + factor * net[bernstein.row(n, i, j + 1)]
        c = c + factor * net[bernstein.row(n, i, j)]
    return u * a + v * b + (1.0 - u - v) * c, n * (a - c), n * (b - c)


def _linear(rgb: Any) -> Any:
    high = dr.power((rgb + 0.055) / 1.055, 2.4)
    return dr.select(rgb <= 0.04045, rgb / 12.92, high)
