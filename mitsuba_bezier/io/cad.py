"""CAD models through OpenCASCADE: STEP, IGES and BREP files (the extra ``[cad]``).

Every face is converted exactly, or reported:

* Its surface is cut at the parameters of its trimming curves, if those are parameter lines, and
  each rectangle becomes Bézier patches, two triangles each. Planes, cylinders, cones, spheres,
  tori, surfaces of revolution and extrusion and NURBS are exact as rational patches.
* A plane face with other boundaries is filled with curved plane triangles (`plane_regions`).
* Other faces trimmed by curves are restricted to curved triangles of their parameter plane
  (`trimmed_patches`): the surface is exact; the trimming curve is, too, if it is a conic on a
  NURBS surface, and else replaced by parabolas within 1e-5 of the size of the face.

Lengths are those of the file in millimetres, as OpenCASCADE converts them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import FileFormatError
from ..geometry import bernstein
from .files import damaged, read_bytes
from .isolated import read_isolated
from .nurbs import curve_to_bezier, surface_to_bezier
from .nurbs_surface import bezier_points
from .plane_regions import chain, join_ends, region_to_triangles, standard
from .report import Collector, Model
from .tensor_nets import tensor_nets
from .trimmed_patches import fit_parabolas, trimmed_patches
from .trims import rectangles, rectilinear

__all__ = ["read", "read_here"]

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
        select, iges, step = IFSelect, IGESControl, STEPControl
        abs, exp = TopAbs, TopExp
        # the name of static methods changed between 7.9 and 8
        face = staticmethod(getattr(TopoDS.TopoDS, "Face_s", None) or TopoDS.TopoDS.Face)
        edge = staticmethod(getattr(TopoDS.TopoDS, "Edge_s", None) or TopoDS.TopoDS.Edge)
        shape = TopoDS.TopoDS_Shape

    messenger = Message.Message.DefaultMessenger_s()
    messenger.RemovePrinters(Message.Message_PrinterOStream.get_type_descriptor_s())
    return Occ


def _load(occ: Any, path: Path) -> Any:
    """Return the shape of a file."""
    head = read_bytes(path)[:4096]
    suffix = path.suffix.lower()
    if suffix in _SIGNATURES:
        signature, name = _SIGNATURES[suffix]
        if signature not in head:
            raise damaged(path, f"{name} ({signature.decode()!r} at its start)", "other data")
    elif len(head) < 80 or head[72:73] not in (b"S", b"C", b"B"):
        raise damaged(path, "an IGES file ('S' in column 73 of its first line)", "other data")
    shape = occ.shape()
    try:
        if suffix == ".brep":
            done = occ.tools.BRepTools.Read_s(shape, str(path), occ.brep.BRep_Builder())
        else:
            control = occ.step.STEPControl_Reader if "st" in suffix else occ.iges.IGESControl_Reader
            reader = control()
            done = reader.ReadFile(str(path)) == occ.select.IFSelect_RetDone
            if done:
                reader.TransferRoots()
                shape = reader.OneShape()
    except Exception as error:  # OpenCASCADE's own exceptions have no common base in Python
        raise damaged(path, "a file that OpenCASCADE can read", error) from None
    if not done or shape.IsNull():
        raise damaged(path, "a file that OpenCASCADE can read", "one it refuses")
    return shape


def _explore(occ: Any, shape: Any, kind: Any) -> Iterator[Any]:
    explorer = occ.exp.TopExp_Explorer(shape, kind)
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


def read(path: str | PathLike[str]) -> Model:
    """Read a STEP, IGES or BREP file.

    It is read in a process of its own (see `isolated`).

    Raises
    ------
    FileFormatError
        If OpenCASCADE is not installed, the file is missing or damaged, or no face of it can
        be converted.
    """
    return read_isolated("cad", path)


def read_here(path: str | PathLike[str]) -> Model:
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
    shape = _load(occ, path)
    collector = Collector(path, path.suffix.lower()[1:])
    for number, item in enumerate(_explore(occ, shape, occ.abs.TopAbs_FACE)):
        face = occ.face(item)
        name = f"face {number}"
        try:
            nets = _convert(occ, face, collector, name)
        except (FileFormatError, MemoryError):
            raise
        except Exception as error:  # OpenCASCADE fails on this face: report it, go on
            text = str(error).splitlines()
            collector.report.refuse(name, f"OpenCASCADE: {text[0][:80] if text else 'failed'}")
            continue
        if isinstance(nets, str):
            collector.report.refuse(name, nets)
            continue
        for net in nets:
            collector.add(net, number)
        collector.report.accept()
    return collector.model(lambda: damaged(path, "faces", "none that can be converted"))


def _convert(occ: Any, face: Any, collector: Collector, name: str) -> list[np.ndarray] | str:
    """Return nets ``(P, K, 4)`` of one face, or the reason why there are none."""
    turned = face.Orientation() == occ.abs.TopAbs_REVERSED
    face = occ.face(face.Oriented(occ.abs.TopAbs_FORWARD))
    surface = occ.brep.BRep_Tool.Surface_s(face)
    while isinstance(surface, occ.geom.Geom_RectangularTrimmedSurface):
        surface = surface.BasisSurface()
    edge_curves = _trims(occ, face)
    curves = [curve for edge in edge_curves for curve in edge]
    kind = type(surface).__name__.removeprefix("Geom_")
    if not curves:
        bounds = surface.Bounds()
        if not np.abs(bounds).max() < 1e50:
            return f"{kind} without boundary"
        u0, u1, v0, v1 = bounds
        corners = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
        curves = [np.stack([a, b]) for a, b in zip(corners, np.roll(corners, -1, axis=0))]
        curves = [np.pad(c, ((0, 0), (0, 1)), constant_values=1.0) for c in curves]
        edge_curves = [c[None] for c in curves]
    if any((c[:, 2] <= 0).any() for c in curves):
        return "trimmed by curves with weights that are not positive"
    points = [c[:, :2] / c[:, 2:] for c in curves]
    flat = np.concatenate(points)
    extent = np.ptp(flat, axis=0)
    # 1e-7 of the extent: the precision OpenCASCADE works with, relative to lengths near 1
    tolerance = 1e-7 * np.maximum(extent, 1e-12)
    edges = rectilinear([points], tolerance)
    if isinstance(surface, occ.geom.Geom_OffsetSurface):
        collector.report.notes.append(f"{name} is an offset surface, approximated to 0.0001 mm")
    if edges is None:
        if isinstance(surface, occ.geom.Geom_Plane):
            found = _plane_region(surface, curves, extent)
        else:
            found = _curved_region(occ, surface, edge_curves)
        if isinstance(found, str):
            return f"{kind}: {found}"
        return [_orient(net, turned) for net in found]
    boxes = rectangles(edges, tolerance)
    if isinstance(boxes, str):
        return f"{kind}: {boxes}"
    splines = [_spline(occ, surface, box) for box in boxes]
    return [
        _orient(tensor_nets(surface_to_bezier(s.net, *s.knots, s.degrees)[0]), turned)
        for s in splines
    ]


def _orient(nets: np.ndarray, turned: bool) -> np.ndarray:
    if not turned:
        return nets
    n = bernstein.degree_of(nets.shape[1])
    return nets[:, bernstein.permutation(n, (0, 2, 1))]


def _trims(occ: Any, face: Any) -> list[np.ndarray]:
    """Return the edges of a face as chains of rational Bézier curves ``(S, n+1, 3)`` in (u, v)."""
    out = []
    for item in _explore(occ, face, occ.abs.TopAbs_EDGE):
        edge = occ.edge(item)
        if edge.Orientation() not in (occ.abs.TopAbs_FORWARD, occ.abs.TopAbs_REVERSED):
            continue  # internal edges bound nothing
        adaptor = occ.adaptor.BRepAdaptor_Curve2d(edge, face)
        first, last = adaptor.FirstParameter(), adaptor.LastParameter()
        curve = occ.geom2d.Geom2d_TrimmedCurve(adaptor.Curve(), first, last)
        spline = occ.convert2d.CurveToBSplineCurve_s(curve)
        out.append(_curve(spline))
    return out


def _curve(spline: Any) -> np.ndarray:
    if spline.IsPeriodic():
        spline.SetNotPeriodic()
    count, p = spline.NbPoles(), spline.Degree()
    net = np.empty((count, 3))
    for i in range(count):
        pole, w = spline.Pole(i + 1), spline.Weight(i + 1)
        net[i] = pole.X() * w, pole.Y() * w, w
    knots = []
    for k in range(1, spline.NbKnots() + 1):
        knots += [spline.Knot(k)] * spline.Multiplicity(k)
    return curve_to_bezier(net, knots, p)


class _Spline(NamedTuple):
    """A NURBS surface.

    `occ` is OpenCASCADE's own object; its parameters are those of `knots` plus `shift`, which
    is a period or zero.
    """

    net: np.ndarray
    knots: tuple[np.ndarray, np.ndarray]
    degrees: tuple[int, int]
    occ: Any
    shift: np.ndarray


def _spline(occ: Any, surface: Any, box: np.ndarray) -> _Spline:
    """Convert a rectangle ``[[u0, u1], [v0, v1]]`` of the parameters of a surface."""
    box = np.array(box)
    for axis, (low, high) in enumerate(np.reshape(surface.Bounds(), (2, 2))):
        closed = surface.IsUPeriodic() if axis == 0 else surface.IsVPeriodic()
        if closed:  # a turn and a rounding error would be refused
            box[axis, 1] = min(box[axis, 1], box[axis, 0] + (high - low))
        else:
            box[axis] = np.clip(box[axis], low, high)
    (u0, u1), (v0, v1) = box.tolist()
    part = occ.geom.Geom_RectangularTrimmedSurface(surface, u0, u1, v0, v1)
    spline = occ.convert.SurfaceToBSplineSurface_s(part)
    if spline.IsUPeriodic():
        spline.SetUNotPeriodic()
    if spline.IsVPeriodic():
        spline.SetVNotPeriodic()
    m, n = spline.NbUPoles(), spline.NbVPoles()
    net = np.empty((m, n, 4))
    for i in range(m):
        for j in range(n):
            pole, w = spline.Pole(i + 1, j + 1), spline.Weight(i + 1, j + 1)
            net[i, j] = pole.X() * w, pole.Y() * w, pole.Z() * w, w
    knots: list[list[float]] = [[], []]
    for k in range(1, spline.NbUKnots() + 1):
        knots[0] += [spline.UKnot(k)] * spline.UMultiplicity(k)
    for k in range(1, spline.NbVKnots() + 1):
        knots[1] += [spline.VKnot(k)] * spline.VMultiplicity(k)
    degrees = (spline.UDegree(), spline.VDegree())
    shift = np.reshape(spline.Bounds(), (2, 2))[:, 0] - box[:, 0]
    # a rectangle of a closed surface may come back a period away
    shift = np.where([surface.IsUPeriodic(), surface.IsVPeriodic()], shift, 0.0)
    shifted = (np.array(knots[0]) - shift[0], np.array(knots[1]) - shift[1])
    return _Spline(net, shifted, degrees, spline, shift)


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


def _curved_region(occ: Any, surface: Any, edges: list[np.ndarray]) -> list[np.ndarray] | str:
    """Restrict a curved face to its trimming curves, chains ``(S, n+1, 3)``."""
    flat = np.concatenate([bezier_points(c, _SAMPLES) for edge in edges for c in edge])
    box = np.stack([flat.min(axis=0), flat.max(axis=0)], axis=1)
    box += (box[:, 1:] - box[:, :1]) * [-1e-9, 1e-9]
    spline = _spline(occ, surface, box)
    points = spline.net[..., :3] / spline.net[..., 3:]
    size = float(np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0)))
    place = _parameter_map(surface, spline, box, size)
    if isinstance(place, str):
        return place
    # lengths of the control polygons bound those of the parameter lines
    lengths = [
        np.linalg.norm(np.diff(points, axis=axis), axis=-1).sum(axis=axis).max() for axis in (0, 1)
    ]
    scale = np.array(lengths) / np.maximum(box[:, 1] - box[:, 0], 1e-300)
    out: list[np.ndarray] = []
    for edge in edges:
        if place is None and edge.shape[1] <= 3:
            out += [standard(curve) for curve in edge]
            continue

        def evaluate(t: np.ndarray, edge: np.ndarray = edge) -> np.ndarray:
            uv = _chain_points(edge, t)
            return uv if place is None else place(uv)

        fitted = fit_parabolas(evaluate, scale, 1e-5 * size, max(2, len(edge) // 4))
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
    return trimmed_patches(spline.net, spline.knots, spline.degrees, closed)


def _chain_points(edge: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return points of a chain of Bézier curves, run through for t in [0, 1]."""
    at = np.clip(t, 0, 1) * len(edge)
    piece = np.minimum(at.astype(int), len(edge) - 1)
    out = np.empty((len(t), 2))
    for k in np.unique(piece):
        out[piece == k] = bezier_points(edge[k], at[piece == k] - k)
    return out


def _identity(x: np.ndarray) -> np.ndarray:
    return x


def _angle_map(knots: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the map of an angle to the parameter of a rational circle with these knots.

    Each span is an arc ``[a, b]`` as a rational parabola with end weights 1, for which
    ``tan((angle - middle) / 2) = tan((b - a) / 4) (2 t - 1)``.
    """
    breaks = np.unique(knots)

    def place(x: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(breaks, x, side="right") - 1, 0, len(breaks) - 2)
        a, b = breaks[k], breaks[k + 1]
        return (a + b) / 2 + (b - a) / 2 * np.tan((x - (a + b) / 2) / 2) / np.tan((b - a) / 4)

    return place


def _parameter_map(
    surface: Any, spline: _Spline, box: np.ndarray, size: float
) -> Callable[[np.ndarray], np.ndarray] | str | None:
    """Return the map of the parameters of a surface to those of its NURBS form.

    Parameter lines are kept, so u and v are mapped each on its own.

    Returns
    -------
    callable, str or None
        None if the parameters are the same; a reason if they could not be related.
    """
    probes = box[:, 0] + (box[:, 1] - box[:, 0]) * [[0.21, 0.6], [0.47, 0.1], [0.83, 0.95]]
    wanted = [surface.Value(*uv) for uv in probes.tolist()]
    maps = [(_identity, _angle_map(knots)) for knots in spline.knots]
    for first in range(2):
        for second in range(2):
            chosen = (maps[0][first], maps[1][second])

            def place(uv: np.ndarray, chosen: tuple = chosen) -> np.ndarray:
                inside = np.clip(uv, box[:, 0], box[:, 1])
                return np.stack([chosen[axis](inside[:, axis]) for axis in range(2)], axis=1)

            got = [spline.occ.Value(*uv) for uv in (place(probes) + spline.shift).tolist()]
            # 1e-9 of the size: rounding, far below the difference of two parametrisations
            if max(a.Distance(b) for a, b in zip(got, wanted)) < 1e-9 * size:
                return place if first or second else None
    return "its parameters could not be related to those of its NURBS form"
