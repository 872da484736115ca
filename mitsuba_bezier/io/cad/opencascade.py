"""CAD models through OpenCASCADE: STEP, IGES and BREP files (the extra ``[cad]``).

Every face is converted exactly, or reported:

* Its surface is cut at the parameters of its trimming curves, if those are parameter lines, and
  each rectangle becomes Bézier patches, two triangles each. Planes, cylinders, cones, spheres,
  tori, surfaces of revolution and extrusion and NURBS are exact as rational patches.
* A plane face with other boundaries is filled with curved plane triangles (`plane_regions`),
  unless these are of high degree and trims are wanted.
* Other faces trimmed by curves keep the patches of their surface, with the curves as trims
  (`trimmed_grid`), if the caller asks for them: both are exact.
* If not, they are restricted to curved triangles of their parameter plane (`trimmed_patches`): the
  surface is exact; the trimming curve is, too, if it is a conic on a NURBS surface, and else
  replaced by parabolas within 1e-5 of the size of the face.

Lengths are those of the file in millimetres, as OpenCASCADE converts them.
"""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...geometry import bernstein
from ...geometry.trims import Trims
from ..files import damaged, plain_copy, read_bytes
from ..isolated import read_isolated
from ..nurbs_surface import bezier_points
from ..parts import Colour
from ..parts import Part as IoPart
from ..report import Collector, Model, Report
from ..tensor_nets import has_area, tensor_nets
from ..trims import rectangles, rectilinear
from .assemblies import Document, Product, products, step_unit
from .closed_surfaces import BoundaryEdge, leaves_period, unrolled
from .opencascade_surfaces import (
    angular_axes,
    closed_axes,
    curve_pieces,
    parameter_map,
    surface_grid,
)
from .plane_regions import chain, join_ends, region_to_triangles, standard
from .trimmed_patches import closed_boundary, fit_parabolas, trimmed_grid, trimmed_patches

__all__ = ["import_library", "read", "read_here"]

_SAMPLES = np.linspace(0, 1, 17)

_SIGNATURES = {
    ".step": (b"ISO-10303-21", "a STEP file"),
    ".stp": (b"ISO-10303-21", "a STEP file"),
    ".brep": (b"CASCADE Topology", "an OpenCASCADE BREP file"),
}


def _occ() -> Any:
    """Import OpenCASCADE; return a namespace of what is used here."""
    try:
        from OCP import (
            BRep,
            BRepAdaptor,
            BRepTools,
            Geom,
            Geom2d,
            Geom2dConvert,
            GeomConvert,
            IFSelect,
            IGESControl,
            Interface,
            Message,
            STEPControl,
            TopAbs,
            TopExp,
            TopoDS,
        )
    except ImportError as error:
        raise FileFormatError.expected(
            "path",
            "a file that can be read",
            f"a CAD file, which needs OpenCASCADE ({error}): pip install 'mitsuba-bezier[cad]'",
        ) from None

    class Occ:
        brep, adaptor, tools = BRep, BRepAdaptor, BRepTools
        geom, geom2d = Geom, Geom2d
        convert, convert2d = GeomConvert.GeomConvert, Geom2dConvert.Geom2dConvert
        curve = staticmethod(GeomConvert.GeomConvert.CurveToBSplineCurve_s)
        select, iges, step = IFSelect, IGESControl, STEPControl
        settings = Interface.Interface_Static
        abs, exp = TopAbs, TopExp
        # the name of static methods changed between 7.9 and 8
        face = staticmethod(getattr(TopoDS.TopoDS, "Face_s", None) or TopoDS.TopoDS.Face)
        edge = staticmethod(getattr(TopoDS.TopoDS, "Edge_s", None) or TopoDS.TopoDS.Edge)
        shape = TopoDS.TopoDS_Shape

    messenger = Message.Message.DefaultMessenger_s()
    messenger.RemovePrinters(Message.Message_PrinterOStream.get_type_descriptor_s())
    return Occ


import_library = _occ


def _load(occ: Any, path: Path) -> Any:
    """Return the shape of a file, all parts in one."""
    with plain_copy(path) as plain:
        return _load_plain(occ, path, plain)


def _load_plain(occ: Any, path: Path, plain: Path) -> Any:
    _check_signature(path, plain)
    suffix = path.suffix.lower()
    shape = occ.shape()
    try:
        if suffix == ".brep":
            done = occ.tools.BRepTools.Read_s(shape, str(plain), occ.brep.BRep_Builder())
        else:
            control = occ.step.STEPControl_Reader if "st" in suffix else occ.iges.IGESControl_Reader
            reader = control()  # which also defines the settings
            _settle(occ)
            done = reader.ReadFile(str(plain)) == occ.select.IFSelect_RetDone
            if done:
                reader.TransferRoots()
                shape = reader.OneShape()
    except Exception as error:  # OpenCASCADE's own exceptions have no common base in Python
        raise damaged(path, "a file that OpenCASCADE can read", error) from None
    if not done or shape.IsNull():
        raise damaged(path, "a file that OpenCASCADE can read", "one it refuses")
    return shape


def _settle(occ: Any) -> None:
    """Set how files are read, once a reader has defined the settings."""
    # 3: curves in space before those in (u, v), if a file has both. With the latter the
    # reader loses seams of closed B-splines, and makes holes into faces
    occ.settings.SetIVal_s("read.surfacecurve.mode", 3)


def _check_signature(path: Path, plain: Path) -> None:
    head = read_bytes(plain)[:4096]
    suffix = path.suffix.lower()
    if suffix in _SIGNATURES:
        signature, name = _SIGNATURES[suffix]
        if signature not in head:
            raise damaged(path, f"{name} ({signature.decode()!r} at its start)", "other data")
    elif len(head) < 80 or head[72:73] not in (b"S", b"C", b"B"):
        raise damaged(path, "an IGES file ('S' in column 73 of its first line)", "other data")


def _products(occ: Any, path: Path) -> tuple[list[Product], Document | None, str]:
    """Return what is in a file, part by part, with the document of its colours, and its unit."""
    suffix = path.suffix.lower()
    if suffix == ".brep":
        return [Product([_load(occ, path)], path.stem, placements=[np.eye(4)])], None, ""
    iges = "ig" in suffix
    with plain_copy(path) as plain:
        _check_signature(path, plain)
        try:
            document = Document(plain, iges, lambda: _settle(occ))
            if document.done:
                document.transfer()
        except Exception as error:  # as in `_load_plain`
            raise damaged(path, "a file that OpenCASCADE can read", error) from None
        if not document.done:
            raise damaged(path, "a file that OpenCASCADE can read", "one it refuses")
        found = products(document, path.stem)
        if not found:
            raise damaged(path, "a file that OpenCASCADE can read", "one it refuses")
        return found, document, step_unit(document.reader, iges)


def _explore(occ: Any, shape: Any, kind: Any) -> Iterator[Any]:
    explorer = occ.exp.TopExp_Explorer(shape, kind)
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


#: Nets of one degree, and the trims of their patches.
Part = tuple[np.ndarray, Trims | None]


def read(path: str | PathLike[str], trims: bool = False) -> Model:
    """Read a STEP, IGES or BREP file.

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
        If OpenCASCADE is not installed, the file is missing or damaged, or no face of it can
        be converted.
    """
    return read_isolated("cad.opencascade", path, trims)


def read_here(path: str | PathLike[str], trims: bool = False) -> Model:
    """Read a STEP, IGES or BREP file, in this process: a damaged file can end it.

    Raises
    ------
    FileFormatError
        If OpenCASCADE is not installed, the file is missing or damaged, or no face of it can
        be converted.
    """
    path = Path(path)
    read_bytes(path)  # a missing file is told first
    occ = _occ()
    found, document, unit = _products(occ, path)
    report = Report(str(path), path.suffix.lower()[1:])
    parts = [
        part
        for product in found
        if (part := _part(occ, path, report, product, document, trims, len(found) > 1)) is not None
    ]
    if not parts:
        error = damaged(path, "faces", "none that can be converted")
        raise FileFormatError(f"{error} ({report.summary()})") if report.refused else error
    if unit and unit not in ("millimetre", "mm", "millimeter"):
        report.remarks.append(f"lengths are in {unit} in the file, and in mm here")
    return Model(report=report, parts=parts, unit="mm" if document is not None else "")


def _part(
    occ: Any,
    path: Path,
    report: Report,
    product: Product,
    document: Document | None,
    trims: bool,
    several: bool,
) -> IoPart | None:
    """Convert the faces of a product, once for all places; None if there are none."""
    collector = Collector(path, report.format)
    collector.report = report
    first, times = report.faces, len(product.placements)
    colours: list[Colour | None] = []  # by face
    converted = 0
    for shape, own in _faces(occ, product, document):
        number = len(colours)
        colours.append(own)
        face = occ.face(shape)
        name = f"face {first + number}" + (f" ({product.name})" if several else "")
        try:
            parts = _with_area(_convert(occ, face, collector, name, trims))
        except (FileFormatError, MemoryError):
            raise
        except Exception as error:  # a face like no other must not cost the rest: report it
            text = str(error).splitlines()
            reason = f"{type(error).__name__}: {text[0][:80] if text else ''}"
            parts = f"failed with {reason}"
        if isinstance(parts, str):
            report.refuse(name, parts, times)
            continue
        for nets, part_trims in parts:
            collector.add(nets, number, part_trims)
        report.accept(times)
        converted += 1
    if not converted:
        return None
    model = collector.model(lambda: damaged(path, "faces", "none that can be converted"))
    paints = list(dict.fromkeys(colour for colour in colours if colour is not None))
    colour = product.colour
    if len(paints) == 1 and None not in colours:
        colour, paints = paints[0], []
    number_of = {own: k for k, own in enumerate(paints)}
    codes = np.array([-1 if c is None else number_of.get(c, -1) for c in colours])
    return IoPart(
        product.name,
        model.groups,
        model.sources,
        list(model.trims),
        np.stack(product.placements),
        list(product.places),
        colour,
        paints,
        [codes[source] for source in model.sources] if paints else [],
        product.layer,
        visible=product.visible,
        faces=len(colours),
    )


def _faces(
    occ: Any, product: Product, document: Document | None
) -> Iterator[tuple[Any, Colour | None]]:
    """Yield the faces of a product with the colours that they, or their solids, have themselves."""
    for shape in product.shapes:
        solids: list[tuple[Any, Colour]] = []
        if document is not None:
            for kind in (occ.abs.TopAbs_SOLID, occ.abs.TopAbs_SHELL):
                for body in _explore(occ, shape, kind):
                    colour = document.face_colour(body)
                    if colour is not None and not body.IsSame(shape):
                        solids.append((body, colour))
        inherited = {
            face: colour
            for body, colour in reversed(solids)
            for face in _explore(occ, body, occ.abs.TopAbs_FACE)
        }
        for face in _explore(occ, shape, occ.abs.TopAbs_FACE):
            own = None if document is None else document.face_colour(face)
            yield face, inherited.get(face) if own is None else own


def _convert(occ: Any, face: Any, collector: Collector, name: str, trims: bool) -> list[Part] | str:
    """Return the parts of one face, or the reason why there are none."""
    turned = face.Orientation() == occ.abs.TopAbs_REVERSED
    face = occ.face(face.Oriented(occ.abs.TopAbs_FORWARD))
    surface = occ.brep.BRep_Tool.Surface_s(face)
    while isinstance(surface, occ.geom.Geom_RectangularTrimmedSurface):
        surface = surface.BasisSurface()
    kind = type(surface).__name__.removeprefix("Geom_")
    boundary = _boundary(occ, face, surface)
    if isinstance(boundary, str):
        return f"{kind}: {boundary}"
    edge_curves = boundary
    curves = [curve for edge in edge_curves for curve in edge]
    if not curves:
        bounds = surface.Bounds()
        if not np.abs(bounds).max() < 1e50:
            return f"{kind} without boundary"
        u0, u1, v0, v1 = bounds
        corners = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
        curves = [np.stack([a, b]) for a, b in zip(corners, np.roll(corners, -1, axis=0))]
        curves = [np.pad(c, ((0, 0), (0, 1)), constant_values=1.0) for c in curves]
        edge_curves = [c[None] for c in curves]
    points = [c[:, :2] / c[:, 2:] for c in curves]
    flat = np.concatenate(points)
    extent = np.ptp(flat, axis=0)
    # 1e-7 of the extent: the precision OpenCASCADE works with, relative to lengths near 1
    tolerance = 1e-7 * np.maximum(extent, 1e-12)
    if _is_sliver(surface, points):
        return "a sliver without area"
    edges = rectilinear([points], tolerance)
    if isinstance(surface, occ.geom.Geom_OffsetSurface):
        collector.report.notes.append(f"{name} is an offset surface, approximated to 0.0001 mm")
    if edges is None:
        found: list[np.ndarray] | str = "trimmed by curves"
        plane = isinstance(surface, occ.geom.Geom_Plane)
        # a triangle has the degree of its boundary: with trims a plane need not
        if plane and not (trims and max(map(len, curves)) > 4):
            found = _plane_region(surface, curves, extent)
        elif not trims:
            found = _curved_region(occ, surface, edge_curves)
        if not isinstance(found, str):
            return [(_orient(net, turned), None) for net in found]
        part = _trimmed_part(occ, surface, curves, turned) if trims else found
        return f"{kind}: {part}" if isinstance(part, str) else [part]
    boxes = rectangles(edges, tolerance)
    if isinstance(boxes, str):
        return f"{kind}: {boxes}"
    return [
        (_orient(tensor_nets(surface_grid(occ, surface, box).rectangle(box)), turned), None)
        for box in boxes
    ]


def _with_area(parts: list[Part] | str) -> list[Part] | str:
    """Leave out patches that are lines or points."""
    if isinstance(parts, str):
        return parts
    out: list[Part] = []
    for nets, trims in parts:
        good = has_area(nets)
        if good.any():
            out.append((nets[good], None if trims is None else trims[good]))
    return out or "a sliver without area"


def _is_sliver(surface: Any, points: list[np.ndarray]) -> bool:
    """Tell whether a face is less than a millionth as thick as it is long, in space."""
    flat = np.concatenate(points)
    middle = (flat.min(axis=0) + flat.max(axis=0)) / 2
    spread = flat - flat.mean(axis=0)
    steps = 1e-4 * np.maximum(np.ptp(flat, axis=0), 1e-12)
    rates = []
    for axis in range(2):
        ends = [middle + sign * steps * np.eye(2)[axis] for sign in (-1, 1)]
        a, b = (surface.Value(*uv) for uv in np.array(ends).tolist())
        rates.append(a.Distance(b) / (2 * steps[axis]))
    sigma = np.linalg.svd(spread * rates, compute_uv=False)
    return bool(sigma[1] < 1e-6 * sigma[0])


def _orient(nets: np.ndarray, turned: bool) -> np.ndarray:
    if not turned:
        return nets
    n = bernstein.degree_of(nets.shape[1])
    return nets[:, bernstein.permutation(n, (0, 2, 1))]


def _boundary(occ: Any, face: Any, surface: Any) -> list[np.ndarray] | str:
    """Return the boundary of a face as chains of rational Bézier curves ``(S, n+1, 3)`` in (u, v).

    On a closed surface they are laid out in one period.
    """
    edges = []
    items = [occ.edge(item) for item in _explore(occ, face, occ.abs.TopAbs_EDGE)]
    for edge in items:
        if edge.Orientation() not in (occ.abs.TopAbs_FORWARD, occ.abs.TopAbs_REVERSED):
            continue  # internal edges bound nothing
        adaptor = occ.adaptor.BRepAdaptor_Curve2d(edge, face)
        first, last = adaptor.FirstParameter(), adaptor.LastParameter()
        curve = occ.geom2d.Geom2d_TrimmedCurve(adaptor.Curve(), first, last)
        pieces = curve_pieces(occ.convert2d.CurveToBSplineCurve_s(curve), 2)[0]
        if (pieces[..., 2] <= 0).any():
            return "trimmed by curves with weights that are not positive"
        if edge.Orientation() == occ.abs.TopAbs_REVERSED:
            pieces = pieces[::-1, ::-1]
        seam = occ.brep.BRep_Tool.IsClosed_s(edge, face) and sum(map(edge.IsSame, items)) > 1
        edges.append(BoundaryEdge(pieces, seam))
    axes = closed_axes(occ, surface)
    if not edges or not axes.period.any():
        return [edge.curves for edge in edges]
    if leaves_period(edges, axes) or not _closes([c for e in edges for c in e.curves]):
        return unrolled(edges, axes)
    return [edge.curves for edge in edges]


def _closes(curves: list[np.ndarray]) -> bool:
    flat = np.concatenate([bezier_points(c, _SAMPLES) for c in curves])
    box = np.stack([flat.min(axis=0), flat.max(axis=0)], axis=1)
    return not isinstance(closed_boundary(curves, box), str)


def _plane_region(
    plane: Any, curves: list[np.ndarray], extent: np.ndarray
) -> list[np.ndarray] | str:
    """Fill a plane face; parameters of a plane are lengths, so nothing is distorted."""
    # edges of a CAD model meet within their tolerance, which may be coarse: 1e-3 of the face
    loops = chain(curves, 1e-3 * float(extent.max()))
    if loops is None:
        return "its boundary is not closed"
    nets = region_to_triangles(loops)
    if isinstance(nets, str):
        return nets
    position = plane.Pln().Position()
    frame = np.zeros((3, 4))
    for row, vector in enumerate((position.XDirection(), position.YDirection())):
        frame[row, :3] = vector.X(), vector.Y(), vector.Z()
    location = position.Location()
    frame[2] = location.X(), location.Y(), location.Z(), 1.0
    return [(net @ frame)[None] for net in nets]


def _trimmed_part(occ: Any, surface: Any, curves: list[np.ndarray], turned: bool) -> Part | str:
    """Return the patches of a face with its trimming curves, in its own parameters."""
    flat = np.concatenate([bezier_points(c, _SAMPLES) for c in curves])
    box = np.stack([flat.min(axis=0), flat.max(axis=0)], axis=1)
    grid = surface_grid(occ, surface, box)
    angular = angular_axes(surface, grid, box)
    if isinstance(angular, str):
        return angular
    closed = closed_boundary(curves, box)
    if isinstance(closed, str):
        return closed
    part = trimmed_grid(grid, closed, angular, turned)
    if isinstance(surface, occ.geom.Geom_Plane) and not isinstance(part, str):
        nets, trims = part
        return nets[:, bernstein.corner_rows(2)], trims  # of degree 1 in fact
    return part


def _curved_region(occ: Any, surface: Any, edges: list[np.ndarray]) -> list[np.ndarray] | str:
    """Restrict a curved face to its trimming curves, chains ``(S, n+1, 3)``."""
    flat = np.concatenate([bezier_points(c, _SAMPLES) for edge in edges for c in edge])
    box = np.stack([flat.min(axis=0), flat.max(axis=0)], axis=1)
    grid = surface_grid(occ, surface, box)
    place = parameter_map(surface, grid, box)
    if isinstance(place, str):
        return place
    points = grid.patches[..., :3] / grid.patches[..., 3:]
    # lengths of the control polygons bound those of the parameter lines
    lengths = [
        np.linalg.norm(np.diff(points, axis=2 + k), axis=-1).sum(axis=(k, 2 + k)).max()
        for k in (0, 1)
    ]
    scale = np.array(lengths) / np.maximum(grid.domain[:, 1] - grid.domain[:, 0], 1e-300)
    out: list[np.ndarray] = []
    for edge in edges:
        if place is None and edge.shape[1] <= 3:
            out += [standard(curve) for curve in edge]
            continue

        def evaluate(t: np.ndarray, edge: np.ndarray = edge) -> np.ndarray:
            uv = _chain_points(edge, t)
            return uv if place is None else place(uv)

        fitted = fit_parabolas(evaluate, scale, 1e-5 * grid.size, max(2, len(edge) // 4))
        if fitted is None:
            return "trimmed by a curve that parabolas cannot follow"
        out += fitted
    out = [c for c in out if np.ptp(c[:, :2] / c[:, 2:], axis=0).any()]
    ends = np.array([c[e, :2] / c[e, 2] for c in out for e in (0, -1)])
    extent = float(np.ptp(ends, axis=0).max())
    loops = chain(out, 1e-3 * extent)
    if loops is None:
        return "its boundary is not closed"
    closed = [c for loop in loops for c in join_ends(loop, 1e-6 * extent)]
    return trimmed_patches(grid, closed)


def _chain_points(edge: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return points of a chain of Bézier curves, run through for t in [0, 1]."""
    at = np.clip(t, 0, 1) * len(edge)
    piece = np.minimum(at.astype(int), len(edge) - 1)
    out = np.empty((len(t), 2))
    for k in np.unique(piece):
        out[piece == k] = bezier_points(edge[k], at[piece == k] - k)
    return out
