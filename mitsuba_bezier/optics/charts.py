"""Draw charts of a lens: modulation transfer, distortion, field curvature, focus."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import PrescriptionError
from .beams import distortion
from .drawing import COLOURS, field_name, new_figure
from .field_curvature import field_curvature, field_scan
from .lens import Lens
from .mtf import Arrivals, arrivals, diffraction_limit, highest_frequency, transfer
from .paraxial import first_order

#: Fields from the axis to the edge in charts of them.
_FIELDS = 25
#: Frequencies of a chart of modulation, and places of one of focus.
_FREQUENCIES, _PLACES = 121, 61
#: Spots of a field in a chart of focus.
_SPOTS = 5


def _beams(lens: Lens) -> tuple[list[tuple[float, float]], list[Arrivals]]:
    fields = lens.field_points()
    return fields, [arrivals(lens, field) for field in fields]


def _titled(axes: Any, lens: Lens, what: str) -> None:
    axes.set_title(f"{lens.title}: {what}" if lens.title else what.capitalize())
    axes.grid(alpha=0.3)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _beside(axes: Any, **options: Any) -> None:
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, **options)


def draw_mtf(lens: Lens, highest: float | None = None) -> Any:
    """Return a figure of the modulation transfer function of every field.

    Parameters
    ----------
    lens : Lens
        The lens.
    highest : float, optional
        Where frequencies end; by default where there is nearly no contrast left.

    Returns
    -------
    matplotlib.figure.Figure
        Tangential curves are full, sagittal ones broken; the diffraction limit is black.

    Raises
    ------
    RuntimeSetupError
        Without matplotlib.
    PrescriptionError
        If the lens forms no image, or `highest` is not positive.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, draw_mtf
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, conic=-1, semi_diameter=25)])
    >>> len(draw_mtf(mirror).axes[0].lines)  # tangential, sagittal, diffraction limit
    3
    """
    if highest is not None and not 0 < highest < np.inf:
        raise PrescriptionError.expected("highest", "a positive frequency", highest)
    figure = new_figure(10, 6)
    axes = figure.add_subplot()
    fields, beams = _beams(lens)
    top = highest_frequency(lens, beams) if highest is None else highest
    f = np.linspace(0, top, _FREQUENCIES)
    for k, (field, rays) in enumerate(zip(fields, beams)):
        colour = COLOURS[k % len(COLOURS)]
        for curve, style, name in zip(transfer(rays, f), ("-", "--"), ("tangential", "sagittal")):
            axes.plot(f, curve, style, color=colour, label=f"{field_name(lens, field)} {name}")
    axes.plot(f, diffraction_limit(lens, f), color="black", lw=1, label="diffraction limit")
    axes.set_xlim(0, top)
    axes.set_ylim(0, 1.01)
    axes.set_xlabel(f"frequency / (1/{lens.unit})")
    axes.set_ylabel("modulation")
    _titled(axes, lens, "geometric MTF")
    _beside(axes)
    return figure


def _by_field(
    lens: Lens,
    what: str,
    label: str,
    curves: Callable[[np.ndarray, float], dict[str, np.ndarray]],
) -> Any:
    """Return a figure of departures from 0, to the right, by field, upwards.

    `curves` returns those of fields at a wavelength by their names; the second one is broken.
    """
    fields = field_scan(lens, _FIELDS)
    figure = new_figure(8, 6)
    axes = figure.add_subplot()
    r = np.hypot(*fields.T)
    reach = 0.0
    for k, w in enumerate(lens.wavelengths):
        for (name, curve), style in zip(curves(fields, w).items(), ("-", "--")):
            colour = COLOURS[k % len(COLOURS)]
            axes.plot(curve, r, style, color=colour, label=f"{1000 * w:.1f} nm {name}".rstrip())
            reach = max(reach, float(np.nanmax(np.abs(curve), initial=0.0)))
    reach = 1.1 * reach if reach > 1e-12 else 1.0
    axes.set_xlim(-reach, reach)
    axes.axvline(0, color="black", lw=0.8)
    axes.set_ylim(0, r[-1])
    kind = "angle / °" if lens.field_kind == "angle" else f"height / {lens.unit}"
    names = {"angle": "field", "object_height": "object", "image_height": "image"}
    axes.set_ylabel(f"{names[lens.field_kind]} {kind}")
    axes.set_xlabel(label)
    _titled(axes, lens, what)
    _beside(axes)
    return figure


def draw_distortion(lens: Lens) -> Any:
    """Return a figure of the distortion from the axis to the lens's farthest field.

    Returns
    -------
    matplotlib.figure.Figure
        In per cent of the paraxial image's height, a curve for each wavelength.

    Raises
    ------
    RuntimeSetupError
        Without matplotlib.
    PrescriptionError
        If the lens has no field off its axis.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, draw_distortion
    >>> ball = Lens([Surface(1 / 50, 4, Constant(1.5), 8), Surface(-1 / 50, 47)], fields=[(0, 9)])
    >>> draw_distortion(ball).axes[0].get_xlabel()
    'distortion / %'
    """

    def curves(fields: np.ndarray, w: float) -> dict[str, np.ndarray]:
        return {"": np.array([100 * distortion(lens, tuple(field), w) for field in fields])}

    return _by_field(lens, "distortion", "distortion / %", curves)


def draw_field_curvature(lens: Lens) -> Any:
    """Return a figure of the tangential and sagittal foci, from the axis to the farthest field.

    Returns
    -------
    matplotlib.figure.Figure
        How far behind the image plane they are, for each wavelength; tangential curves are full,
        sagittal ones broken.

    Raises
    ------
    RuntimeSetupError
        Without matplotlib.
    PrescriptionError
        If the lens has no field off its axis.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, draw_field_curvature
    >>> ball = Lens([Surface(1 / 50, 4, Constant(1.5), 8), Surface(-1 / 50, 47)], fields=[(0, 9)])
    >>> len(draw_field_curvature(ball).axes[0].lines)  # two curves and the image plane
    3
    """

    def curves(fields: np.ndarray, w: float) -> dict[str, np.ndarray]:
        foci = field_curvature(lens, fields, w)
        return {"tangential": foci.tangential, "sagittal": foci.sagittal}

    label = f"focus behind the image plane / {lens.unit}"
    return _by_field(lens, "field curvature", label, curves)


def draw_focus(lens: Lens, frequency: float | None = None) -> Any:
    """Return a focus chart: spots before and behind the image plane, and modulation there.

    Parameters
    ----------
    lens : Lens
        The lens.
    frequency : float, optional
        Periods in a unit of length at which modulation is drawn; by default one at which the best
        field has lost some contrast.

    Returns
    -------
    matplotlib.figure.Figure
        A row of spots for each field, all to one scale; below them the spot's radius and the
        modulation against the place of the image plane.

    Raises
    ------
    RuntimeSetupError
        Without matplotlib.
    PrescriptionError
        If the lens forms no image, or the frequency is not positive.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, draw_focus
    >>> mirror = Lens([Surface(-1 / 200, -101, mirror=True, conic=-1, semi_diameter=25)])
    >>> len(draw_focus(mirror, 20.0).axes)  # five spots and two charts
    7
    """
    if frequency is not None and not 0 < frequency < np.inf:
        raise PrescriptionError.expected("frequency", "a positive number", frequency)
    fields, beams = _beams(lens)
    number = first_order(lens).working_f_number
    top = highest_frequency(lens, beams)
    wanted = top / 4 if frequency is None else frequency
    # as far as all fields have been in focus, and modulation of that frequency has fallen
    reach = 1.15 * max(abs(rays.best()) for rays in beams) + number / wanted
    places = np.linspace(-reach, reach, _PLACES)
    figure = new_figure(10, 2.1 * len(fields) + 4)
    grid = figure.add_gridspec(len(fields) + 2, 2 * _SPOTS)
    stops = np.linspace(-reach, reach, _SPOTS)
    size = 1.1 * max(1e-12, *(np.abs(rays.centred(z)).max() for rays in beams for z in stops))
    for row, (field, rays) in enumerate(zip(fields, beams)):
        for column, z in enumerate(stops):
            axes = figure.add_subplot(grid[row, 2 * column : 2 * column + 2])
            p = rays.centred(z)
            colour = COLOURS[row % len(COLOURS)]
            axes.scatter(p[:, 1], p[:, 0], s=1, linewidths=0, color=colour, rasterized=True)
            axes.set(xlim=(-size, size), ylim=(-size, size), aspect="equal", xticks=[], yticks=[])
            if not row:
                axes.set_title(f"{z:+.3g} {lens.unit}")
            if not column:
                axes.set_ylabel(field_name(lens, field))
    left = figure.add_subplot(grid[-2:, :_SPOTS])
    right = figure.add_subplot(grid[-2:, _SPOTS:])
    f = np.array([wanted])
    for k, (field, rays) in enumerate(zip(fields, beams)):
        colour, name = COLOURS[k % len(COLOURS)], field_name(lens, field)
        left.plot(places, [rays.rms(z) for z in places], color=colour, label=name)
        curves = np.array([transfer(rays, f, z)[:, 0] for z in places]).T
        for curve, style in zip(curves, ("-", "--")):
            right.plot(places, curve, style, color=colour)
    left.set_ylabel(f"spot rms / {lens.unit}")
    left.set_ylim(bottom=0)
    left.legend(frameon=False, title="field")
    right.set_ylabel("modulation")
    right.set_ylim(0, 1.01)
    for axes, name in (
        (left, "spot radius"),
        (right, f"MTF at {wanted:.3g}/{lens.unit}, sagittal --"),
    ):
        axes.set_xlabel(f"defocus / {lens.unit}")
        axes.set_title(name)
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"{lens.title or 'Focus'}: spots to one scale, a side is {2 * size:.3g} {lens.unit}"
    )
    return figure
