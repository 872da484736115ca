"""Rhino's ``.3dm`` files through rhino3dm (the extra ``[rhino]``).

Surfaces, faces of polysurfaces (Breps), extrusions and block instances are read. rhino3dm does
not tell the trimming curves in (u, v), so the edges in space are pulled back to the surface
(`pull_back`); plane faces take them as they are. Edges further from a surface than the file's own
tolerance are told.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BezierError, FileFormatError
from ...geometry import bernstein
from ...geometry.trims import Trims
from ..files import damaged, read_bytes
from ..isolated import read_isolated
from ..nurbs import curve_to_bezier
from ..nurbs_surface import PatchGrid
from ..parts import Colour
from ..parts import Part as IoPart
from ..report import Collector, Model, Report
from ..tensor_nets import tensor_nets
from ..trims import rectangles, rectilinear
from .closed_surfaces import BoundaryEdge, leaves_period, unrolled
from .plane_regions import chain, join_ends, region_to_triangles, standard
from .pull_back import grid_axes, pulled_back
from .trimmed_patches import closed_boundary, fit_parabolas, trimmed_grid, trimmed_patches

__all__ = ["import_library", "read", "read_here"]

_MAX_DEPTH = 8  # blocks within blocks
_MAX_PLACES = 1_000_000
#: Names of units.
_UNITS = {
    "None": "",
    "Unset": "",
    "CustomUnits": "",
    "Microns": "um",
    "Millimeters": "mm",
    "Centimeters": "cm",
    "Meters": "m",
    "Kilometers": "km",
    "Inches": "inch",
    "Feet": "foot",
}
#: An edge is refused further than that from its surface, in units of the surface's size. Files
#: have edges at a hundred times their own tolerance, where a fillet meets another.
_FAR = 1e-2


def import_library() -> Any:
    """Return rhino3dm, or raise `FileFormatError` with how to install it."""
    try:
        import rhino3dm
    except ImportError as error:
        raise FileFormatError.expected(
            "path",
            "a file that can be read",
            f"a .3dm file, which needs rhino3dm ({error}): pip install 'mitsuba-bezier[rhino]'",
        ) from None
    return rhino3dm


#: Nets of one degree, and the trims of their patches.
_Part = tuple[np.ndarray, Trims | None]


#: In place of the name of a block, for what is in none.
_TOP = ""


class _Reader:
    """Reads the objects of a file, each block once, and where blocks are placed."""

    def __init__(
        self, path: str | PathLike[str], library: Any, file: Any, trims: bool = False
    ) -> None:
        self.library, self.path, self.file = library, path, file
        self.trims = trims
        self.report = Report(str(path), "3dm")
        self.objects = {str(o.Attributes.Id): o for o in file.Objects}
        self.blocks = {str(d.Id): d for d in file.InstanceDefinitions}
        self.others: dict[str, int] = {}
        self.tolerance = float(file.Settings.ModelAbsoluteTolerance)
        self.off: list[float] = []  # how far edges of faces are from them
        self.layers = {int(layer.Index): layer for layer in file.Layers}
        self.materials = list(file.Materials)
        #: Placements of each block, and their names.
        self.placements: dict[str, list[tuple[np.ndarray, str]]] = {_TOP: [(np.eye(4), "")]}
        #: Parts by block, name, layer and whether they are shown.
        self.parts: dict[tuple[str, str, str, bool], _Gathered] = {}

    # ---------------------------------------------------------------- structure

    def place(self, item: Any, name: str, matrix: np.ndarray, path: str, depth: int = 0) -> None:
        """Enter the places of a block instance, and of those within."""
        key = str(item.Geometry.ParentIdefId)
        block = self.blocks.get(key)
        if block is None or depth >= _MAX_DEPTH:
            self.report.refuse(name, "block instance without its definition")
            return
        inner = matrix @ np.array(item.Geometry.Xform.ToFloatArray(True)).reshape(4, 4)
        places = self.placements.setdefault(key, [])
        if len(places) >= _MAX_PLACES:
            raise damaged(self.path, f"at most {_MAX_PLACES} instances of a block", "more")
        here = _clean(item.Attributes.Name) or _clean(block.Name) or name
        here = f"{path}/{here}" if path else here
        places.append((inner, here))
        for number, part in enumerate(self.members(key)):
            if type(part.Geometry).__name__ == "InstanceReference":
                self.place(part, f"{name}.{number}", inner, here, depth + 1)

    def members(self, block: str) -> list[Any]:
        """Return the objects of a block, or those that are in none."""
        if block == _TOP:
            return [o for o in self.file.Objects if not o.Attributes.IsInstanceDefinitionObject]
        keys = self.blocks[block].GetObjectIds()
        return [self.objects[str(key)] for key in keys if str(key) in self.objects]

    def read(self) -> Model:
        """Return the model."""
        for number, item in enumerate(self.members(_TOP)):
            if type(item.Geometry).__name__ == "InstanceReference":
                self.place(item, f"object {number}", np.eye(4), "")
        for block in self.placements:
            title = f"{_clean(self.blocks[block].Name)} " if block != _TOP else ""
            for number, item in enumerate(self.members(block)):
                self.geometry(item, f"{title}object {number}", block)
        parts = self.finished()
        if not parts:
            error = damaged(self.path, "surfaces", "none that can be converted")
            if self.report.refused:
                raise FileFormatError(f"{error} ({self.report.summary()})")
            raise error
        unit = str(self.file.Settings.ModelUnitSystem).rpartition(".")[2]
        return Model(report=self.report, parts=parts, unit=_UNITS.get(unit, unit.lower()))

    def finished(self) -> list[IoPart]:
        """Return the parts that have surfaces."""
        out: list[IoPart] = []
        taken: dict[str, int] = {}
        stem = Path(self.path).stem
        for (block, name, layer, visible), part in self.parts.items():
            if not part.converted:
                continue
            layers = {key[2] for key in self.parts}
            own = name or (_clean(self.blocks[block].Name) if block != _TOP else "")
            own = own or (layer if len(layers) > 1 and layer else stem)
            taken[own] = taken.get(own, 0) + 1
            own = own if taken[own] == 1 else f"{own}.{taken[own]}"
            model = part.collector.model(lambda: damaged(self.path, "surfaces", "none"))
            paints = list(dict.fromkeys(c for c in part.colours if c is not None))
            colour = None
            if len(paints) == 1 and None not in part.colours:
                colour, paints = paints[0], []
            codes = np.array([-1 if c is None else paints.index(c) for c in part.colours if paints])
            places = self.placements[block]
            out.append(
                IoPart(
                    own,
                    model.groups,
                    model.sources,
                    list(model.trims),
                    np.stack([matrix for matrix, _name in places]),
                    [f"{place}/{own}" if place else own for _matrix, place in places],
                    colour,
                    paints,
                    [codes[source] for source in model.sources] if paints else [],
                    layer,
                    ", ".join(dict.fromkeys(m for m in part.materials if m)),
                    visible,
                    len(part.colours),
                )
            )
        return out

    def look(self, attributes: Any) -> tuple[str, bool, Colour | None, str]:
        """Return layer, visibility, colour and material of an object."""
        layer = self.layers.get(int(attributes.LayerIndex))
        name = _clean(layer.FullPath or layer.Name) if layer is not None else ""
        hidden = str(attributes.Mode).endswith("Hidden") or not attributes.Visible
        visible = not hidden and (layer is None or self.is_shown(layer))
        number = int(attributes.MaterialIndex)
        if str(attributes.MaterialSource).endswith("FromLayer") and layer is not None:
            number = int(layer.RenderMaterialIndex)
        if 0 <= number < len(self.materials):
            material = self.materials[number]
            colour, title = material.DiffuseColor, _clean(material.Name)
            if colour[:3] != (0, 0, 0) or title:
                return name, visible, _linear(colour), title
        source = str(attributes.ColorSource).rpartition("From")[2]
        if source == "Object":
            return name, visible, _linear(attributes.ObjectColor), ""
        # black, or white by default: colours of lines on the screen
        if layer is not None and layer.Color[:3] not in ((0, 0, 0), (255, 255, 255)):
            return name, visible, _linear(layer.Color), ""
        return name, visible, None, ""

    def is_shown(self, layer: Any) -> bool:
        """Return whether a layer and those that it is in are shown."""
        by_id = {str(one.Id): one for one in self.layers.values()}
        for _ in range(len(by_id)):
            if not layer.Visible:
                return False
            if str(layer.ParentLayerId) not in by_id:
                return True
            layer = by_id[str(layer.ParentLayerId)]
        return True

    # ---------------------------------------------------------------- surfaces

    def geometry(self, thing: Any, name: str, block: str) -> None:
        """Convert an object of a block."""
        item = thing.Geometry
        kind = type(item).__name__
        if kind == "InstanceReference":
            return  # `place` has been there
        times = len(self.placements[block])
        layer, visible, colour, material = self.look(thing.Attributes)
        key = (block, _clean(thing.Attributes.Name), layer, visible)
        if key not in self.parts:
            collector = Collector(self.path, "3dm")
            collector.report = self.report
            self.parts[key] = _Gathered(collector)
        part = self.parts[key]
        part.materials.append(material)

        def add(name: str, convert: Any, *arguments: Any) -> None:
            part.colours.append(colour)
            self.add(part, name, times, convert, *arguments)

        if kind == "Extrusion":
            item, kind = item.ToBrep(True), "Brep"
        if kind == "Brep":
            for number in range(len(item.Faces)):
                face = item.Faces[number]
                convert = partial(_brep_face, told=self.off.append)
                add(f"{name} face {number}", convert, item, face, self.trims)
        elif kind in ("NurbsSurface", "RevSurface", "PlaneSurface", "Surface", "SumSurface"):
            add(name, _whole_surface, item)
        elif kind in ("Mesh", "SubD"):
            self.report.refuse(name, f"{kind}: no NURBS surface", times)
        else:
            self.others[kind] = self.others.get(kind, 0) + times

    def add(self, part: _Gathered, name: str, times: int, convert: Any, *arguments: Any) -> None:
        """Convert a face, the last of a part, which stands at so many places."""
        try:
            parts: list[_Part] | str = convert(*arguments)
        except BezierError as error:
            parts = str(error)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            # a face like no other must not cost the rest
            parts = f"failed with {type(error).__name__}: {str(error)[:80]}"
        if isinstance(parts, str):
            self.report.refuse(name, parts, times)
            return
        for nets, part_trims in parts:
            part.collector.add(nets, len(part.colours) - 1, part_trims)
        part.converted += 1
        self.report.accept(times)


@dataclass
class _Gathered:
    """What becomes a part: its faces, each with a colour."""

    collector: Collector
    colours: list[Colour | None] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)
    converted: int = 0


def _clean(name: Any) -> str:
    text = "".join(c if c.isprintable() else " " for c in str(name or "")).strip()
    return text.replace("/", "-")


def _linear(colour: Any) -> Colour:
    x = np.array(colour[:3]) / 255
    values = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return float(values[0]), float(values[1]), float(values[2])


def read(path: str | PathLike[str], trims: bool = False) -> Model:
    """Read a ``.3dm`` file.

    It is read in a process of its own (see `isolated`).

    Parameters
    ----------
    path : path
        The file.
    trims : bool
        Whether patches may have trims.

    Raises
    ------
    FileFormatError
        If rhino3dm is not installed, the file is missing or damaged, or no face of it can
        be converted.
    """
    return read_isolated("cad.rhino", path, trims)


def read_here(path: str | PathLike[str], trims: bool = False) -> Model:
    """Read a ``.3dm`` file, in this process: a damaged file can end it.

    Raises
    ------
    FileFormatError
        If rhino3dm is not installed, the file is missing or damaged, or no face of it can be
        converted.
    """
    data = read_bytes(path)
    if not data.startswith(b"3D Geometry File Format "):
        raise damaged(path, "a .3dm file ('3D Geometry File Format' at its start)", "other data")
    library = import_library()
    file = library.File3dm.Read(str(path))
    if file is None:
        raise damaged(path, "a file that rhino3dm can read", "one it refuses")
    reader = _Reader(path, library, file, trims)
    model = reader.read()
    for kind, count in reader.others.items():
        model.report.remarks.append(f"{count} objects of type {kind}, no surfaces")
    far = [off for off in reader.off if off > reader.tolerance > 0]
    if far:
        model.report.notes.append(
            f"{len(far)} faces have edges up to {max(far):.2g} from their surface, by the file's "
            f"own tolerance {reader.tolerance:.2g}; their boundaries are the nearest points"
        )
    return model


def _knots(knots: Any) -> np.ndarray:
    """Return knots with the first and the last, which Rhino leaves out."""
    values = [knots[k] for k in range(len(knots))]
    return np.array([values[0], *values, values[-1]])


def _nurbs(surface: Any) -> PatchGrid:
    form = surface if type(surface).__name__ == "NurbsSurface" else surface.ToNurbsSurface()
    if form is None:
        raise FileFormatError("a surface without NURBS form")
    m, n = form.Points.CountU, form.Points.CountV
    net = np.empty((m, n, 4))
    for i in range(m):
        for j in range(n):
            p = form.Points.GetControlPoint(i, j)  # homogeneous
            net[i, j] = p.X, p.Y, p.Z, p.W
    degrees = (form.OrderU - 1, form.OrderV - 1)
    return PatchGrid.from_nurbs(net, _knots(form.KnotsU), _knots(form.KnotsV), degrees)


def _whole_surface(surface: Any) -> list[_Part]:
    grid = _nurbs(surface)
    return [(tensor_nets(grid.rectangle(grid.domain)), None)]


def _edge(edge: Any) -> np.ndarray:
    """Return the Bézier pieces ``(S, n+1, 4)`` of an edge in space."""
    curve = edge.ToNurbsCurve()
    points = [curve.Points[k] for k in range(len(curve.Points))]
    net = np.array([[p.X, p.Y, p.Z, p.W] for p in points])
    return curve_to_bezier(net, _knots(curve.Knots), curve.Order - 1)


def _brep_face(
    brep: Any, face: Any, trims: bool, told: Callable[[float], None] | None = None
) -> list[_Part] | str:
    """Convert a face; `told` is given how far its edges are from its surface."""
    surface = _nurbs(face.UnderlyingSurface())
    turned = face.OrientationIsReversed
    loops: list[list[tuple[np.ndarray, bool]]] = []
    all_trims = [[loop.Trims[k] for k in range(loop.TrimCount)] for loop in face.Loops]
    uses = Counter(trim.EdgeIndex for loop in all_trims for trim in loop)
    for loop in all_trims:
        edges = []
        for trim in loop:
            if trim.EdgeIndex < 0:
                continue  # a pole: no length in space
            pieces = _edge(brep.Edges[trim.EdgeIndex])
            if trim.IsReversed:
                pieces = pieces[::-1, ::-1]
            edges.append((pieces, uses[trim.EdgeIndex] > 1))
        loops.append(edges)
    if (surface.patches[..., 3] <= 0).any():
        return "a surface with weights that are not positive"
    plane = _plane_frame(surface)
    nets: list[np.ndarray] | str = "trimmed by curves"
    if plane is not None:
        nets = _plane_face(plane, loops)
    if isinstance(nets, str):
        extent = surface.domain[:, 1] - surface.domain[:, 0]
        # trims cost little: they follow the edge a hundred times closer
        found = _boundary(surface, loops, 1e-7 if trims else 1e-5)
        if isinstance(found, str):
            return found
        boundary, off = found
        if told is not None:
            told(off)
        tolerance = 1e-7 * extent
        straight = rectilinear([[c[:, :2] / c[:, 2:] for c in boundary]], tolerance)
        if straight is not None:
            boxes = rectangles(straight, tolerance)
            if isinstance(boxes, str):
                return boxes
            nets = [tensor_nets(surface.rectangle(box)) for box in boxes]
        else:
            closed = closed_boundary(boundary, surface.domain) if trims else "no trims"
            if not isinstance(closed, str):
                part = trimmed_grid(surface, closed, turned=turned)
                return part if isinstance(part, str) else [part]
            nets = trimmed_patches(surface, boundary)
    if isinstance(nets, str):
        return nets
    if turned:
        nets = [
            net[:, bernstein.permutation(bernstein.degree_of(net.shape[1]), (0, 2, 1))]
            for net in nets
        ]
    return [(net, None) for net in nets]


def _plane_frame(surface: PatchGrid) -> np.ndarray | None:
    """Return ``(3, 4)`` rows X, Y, O of a plane surface with X x Y along its normal, or None."""
    points = (surface.patches[..., :3] / surface.patches[..., 3:]).reshape(-1, 3)
    center = points.mean(axis=0)
    _u, sigma, axes = np.linalg.svd(points - center, full_matrices=False)
    if sigma[2] > 1e-10 * sigma[0]:
        return None
    x, y = axes[0], axes[1]
    _p, du, dv = surface.jet((surface.domain @ [0.63, 0.37])[None])
    if np.cross(x, y) @ np.cross(du[0], dv[0]) < 0:
        y = -y
    frame = np.zeros((3, 4))
    frame[:, :3] = x, y, center
    frame[2, 3] = 1.0
    return frame


def _plane_face(
    frame: np.ndarray, loops: list[list[tuple[np.ndarray, bool]]]
) -> list[np.ndarray] | str:
    flat = []
    for piece in (piece for loop in loops for pieces, _seam in loop for piece in pieces):
        local = piece[:, :3] - piece[:, 3:] * frame[2, :3]
        flat.append(np.column_stack([local @ frame[:2, :3].T, piece[:, 3]]))
    if any((c[:, 2] <= 0).any() for c in flat):
        return "trimmed by curves with weights that are not positive"
    extent = np.ptp(np.concatenate([c[:, :2] / c[:, 2:] for c in flat]), axis=0).max()
    chained = chain(flat, 1e-3 * float(extent))
    if chained is None:
        return "its boundary is not closed"
    found = region_to_triangles(chained)
    return found if isinstance(found, str) else [(net @ frame)[None] for net in found]


def _boundary(
    surface: PatchGrid, loops: list[list[tuple[np.ndarray, bool]]], accuracy: float
) -> tuple[list[np.ndarray], float] | str:
    """Pull the edges back to (u, v).

    Returns
    -------
    boundary : list of (n+1, 3) arrays
        Parabolas and straight pieces.
    off : float
        How far the edges are from the surface, at most.
    str
        In place of both, the reason why there are none.
    """
    extent = surface.domain[:, 1] - surface.domain[:, 0]
    _p, du, dv = surface.jet((surface.domain @ [0.63, 0.37])[None])
    scale = np.array([np.linalg.norm(du), np.linalg.norm(dv)])
    axes = grid_axes(surface)
    edges: list[list[BoundaryEdge]] = []
    worst = 0.0
    for loop in loops:
        edges.append([])
        for pieces, seam in loop:
            places, off = pulled_back(surface, axes, pieces)
            worst = max(worst, off)
            if off > _FAR * surface.size:
                return "an edge that does not lie on its surface"
            for place in places:
                curves = _fitted(place, extent, scale, accuracy * surface.size)
                if curves is None:
                    return "trimmed by a curve that parabolas cannot follow"
                edges[-1].append(BoundaryEdge(np.stack(curves), seam))
    flat = [edge for part in edges for edge in part]
    points = np.concatenate([c[:, :2] / c[:, 2:] for edge in flat for c in edge.curves])
    low, high = surface.domain.T
    outside = (points < low - 1e-7 * extent) | (points > high + 1e-7 * extent)
    if leaves_period(flat, axes) or (outside.any(axis=0) & (axes.period > 0)).any():
        chains = unrolled(flat, axes)
        if isinstance(chains, str):
            return chains
        boundary = [c for chain in chains for c in chain]
    else:
        boundary = []
        for part in edges:
            # an edge that occurs twice on an open surface is a slit: it bounds nothing
            curves = [standard(c) for edge in part if not edge.seam for c in edge.curves]
            boundary += join_ends(curves, 1e-7 * float(extent.max()))
    return [c for c in boundary if np.ptp(c[:, :2] / c[:, 2:], axis=0).any()], worst


def _fitted(
    place: Callable[[np.ndarray], np.ndarray],
    extent: np.ndarray,
    scale: np.ndarray,
    tolerance: float,
) -> list[np.ndarray] | None:
    """Return a straight piece along a parameter line, or parabolas."""
    uv = place(np.linspace(0, 1, 9))
    spread = np.ptp(uv, axis=0) / extent
    if spread.min() > 1e-7:
        return fit_parabolas(place, scale, tolerance)
    axis = int(np.argmin(spread))
    line = uv[[0, -1]]
    line[:, axis] = uv[:, axis].mean()
    return [np.column_stack([line, np.ones(2)])]
