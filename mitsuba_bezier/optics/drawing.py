"""Draw the section of a lens with its rays, and spot diagrams (the extra ``[optics]``)."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np

from .._files import check_target, write_file
from ..errors import FileFormatError, PrescriptionError, RuntimeSetupError
from .beams import beam, pupil_grid, spot
from .lens import Lens
from .patches import clear_radii
from .trace import trace

#: Colours of fields that differ in print and to colour-blind eyes (Okabe and Ito 2008).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")

#: Width of drawings in pixels.
_PIXELS = 1600

_SUFFIXES = (".svg", ".png", ".pdf")


def field_name(lens: Lens, field: tuple[float, float]) -> str:
    """Return a field as charts name it: ``14°``, ``(3, 4) mm``."""
    x, y = field
    text = f"({x:g}, {y:g})" if x else f"{y:g}"
    return f"{text}°" if lens.field_kind == "angle" else f"{text} {lens.unit}"


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure, or raise an error that says how to install matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise RuntimeSetupError(
            "drawing: expected matplotlib, which draws lenses; install it with: "
            "pip install 'mitsuba-bezier[optics]'"
        ) from None
    return Figure(figsize=(width, height), layout="constrained")


def draw_section(lens: Lens, rays: int = 7) -> Any:
    """Return a figure of the section x = 0 of a lens, with rays of every field.

    Parameters
    ----------
    lens : Lens
        The lens. Surfaces without a semi-diameter are drawn as far as the beams reach.
    rays : int
        Rays in the fan of each field.

    Returns
    -------
    matplotlib.figure.Figure
        Lengths are to scale.

    Raises
    ------
    RuntimeSetupError
        Without matplotlib.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Abbe, Lens, Surface, draw_section
    >>> front = Surface(1 / 50, 4, Abbe(1.5168, 64.17), semi_diameter=10)
    >>> draw_section(Lens([front, Surface(-1 / 50, 47)], title="Singlet")).axes[0].get_title()
    'Singlet'
    """
    figure = new_figure(12, 6.75)
    axes = figure.add_subplot()
    sizes = clear_radii(lens)
    frames = lens.frames()
    profiles = []
    for s, size, frame in zip(lens.surfaces, sizes, frames):
        y = np.linspace(-size, size, 121)
        local = np.stack([0 * y, y, s.sag(np.abs(y)), np.ones_like(y)], axis=1)
        profiles.append((local @ frame.T)[:, [2, 1]])
    media, index = lens.media(), lens.indices(lens.wavelengths[lens.reference])
    for i, (s, line) in enumerate(zip(lens.surfaces, profiles)):
        if index[i + 1] > 1.0001 and i + 1 < len(profiles):
            other = profiles[i + 1]
            ring = np.concatenate([line, other[::-1], line[:1]])
            axes.fill(*ring.T, facecolor="#dbe9f4", edgecolor="#34495e", linewidth=1.2, zorder=1)
        elif s.mirror:
            axes.plot(*line.T, color="#34495e", linewidth=3, zorder=3)
        elif s.stop and media[i].name == media[i + 1].name:
            for end, inner in ((line[0], line[-1]), (line[-1], line[0])):
                out = end + 0.35 * (end - inner)
                axes.plot([end[0], out[0]], [end[1], out[1]], color="black", linewidth=3, zorder=3)
        else:
            axes.plot(*line.T, color="#34495e", linewidth=1.2, zorder=2)
    fan = np.stack([np.zeros(rays), np.linspace(-1, 1, rays)], axis=1)
    fields = lens.field_points()
    tallest = 0.0
    for number, field in enumerate(fields):
        try:
            o, d = beam(lens, field, fan)
        except PrescriptionError:
            break
        # some way in front of the lens
        o = o - d * 0.15 * max(abs(frames[-1][2, 3]), 1e-12)
        result = trace(lens, o, d, vignetting=bool(np.isfinite(sizes).all()))
        path = np.concatenate([o[None], result.points])
        for j in np.flatnonzero(result.valid):
            axes.plot(
                path[:, j, 2],
                path[:, j, 1],
                color=COLOURS[number % len(COLOURS)],
                linewidth=0.8,
                zorder=2,
                label=field_name(lens, field) if j == np.flatnonzero(result.valid)[0] else None,
            )
        if result.valid.any():
            tallest = max(tallest, np.abs(result.local[-1][result.valid][:, 1]).max())
    end = frames[-1] @ np.array([[0, 0], [-tallest, tallest], [0, 0], [1, 1]])
    axes.plot(end[2], end[1], color="black", linewidth=1.5, zorder=3)
    axes.set_aspect("equal")
    axes.set_xlabel(f"z / {lens.unit}")
    axes.set_ylabel(f"y / {lens.unit}")
    axes.set_title(lens.title or "Section")
    if axes.get_legend_handles_labels()[0]:
        where = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.09), "ncols": 8}
        axes.legend(title="field", frameon=False, **where)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure


def draw_spots(lens: Lens, rings: int = 12) -> Any:
    """Return a figure of the spot diagrams of all fields and wavelengths, to one scale.

    Raises
    ------
    RuntimeSetupError
        Without matplotlib.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, draw_spots
    >>> mirror = Surface(-1 / 200, -100, mirror=True, semi_diameter=10)
    >>> len(draw_spots(Lens([mirror], fields=[(0, 0), (0, 1)])).axes)  # a panel for each field
    2
    """
    fields = lens.field_points()
    figure = new_figure(16, 16 / max(len(fields), 3) + 1.5)
    panels = figure.subplots(1, len(fields), squeeze=False)[0]
    pupil = pupil_grid(rings)
    found = [[spot(lens, field, w, pupil) for w in lens.wavelengths] for field in fields]
    middles = [np.concatenate([s.points for s in row]).mean(axis=0) for row in found]
    reach = max(np.abs(s.points - m).max() for row, m in zip(found, middles) for s in row)
    marks = "os^vD*"
    for axes, field, row, middle in zip(panels, fields, found, middles):
        every = np.concatenate([s.points for s in row]) - middle
        rms = np.sqrt((every**2).sum(axis=1).mean())
        for k, (s, w) in enumerate(zip(row, lens.wavelengths)):
            points = s.points - middle
            axes.scatter(
                *points.T,
                s=9,
                marker=marks[k % len(marks)],
                color=COLOURS[k % len(COLOURS)],
                linewidths=0,
                label=f"{1000 * w:.1f} nm",
            )
        axes.set_xlim(-1.1 * reach, 1.1 * reach)
        axes.set_ylim(-1.1 * reach, 1.1 * reach)
        axes.set_aspect("equal")
        axes.set_title(f"field {field_name(lens, field)}: rms {rms:.4g} {lens.unit}")
        axes.set_xlabel(f"x / {lens.unit}")
    panels[0].set_ylabel(f"y / {lens.unit}")
    panels[-1].legend(loc="upper right")
    return figure


def check_drawing(path: str | PathLike[str], parameter: str = "path") -> None:
    """Raise an error if a figure cannot be written to a file.

    Raises
    ------
    FileFormatError
        If the suffix is none of those of `save_figure`, or the file cannot be written.
    """
    if str(path)[-4:].lower() not in _SUFFIXES:
        expected = f"a file {', '.join(_SUFFIXES)}"
        raise FileFormatError.expected(parameter, expected, repr(str(path)))
    check_target(path, parameter)


def save_figure(figure: Any, path: str | PathLike[str]) -> None:
    """Write a figure; the suffix is ``.svg``, ``.png`` (1600 pixels wide) or ``.pdf``.

    Raises
    ------
    FileFormatError
        If the suffix is another one, or the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from mitsuba_bezier.optics import Lens, Surface, draw_section, save_figure
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, semi_diameter=10)])
    >>> save_figure(draw_section(mirror), "mirror.svg")
    >>> "</svg>" in Path("mirror.svg").read_text(encoding="utf-8")
    True
    """
    import io

    check_drawing(path)
    suffix = str(path)[-4:].lower()
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix[1:], dpi=_PIXELS / figure.get_figwidth())
    write_file(path, buffer.getvalue())
