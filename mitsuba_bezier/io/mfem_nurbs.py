"""NURBS meshes of MFEM: patches as Bézier triangles, and grid functions on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import GeometryError
from .cells import CellField, Cells, add_cells
from .files import damaged
from .limits import check_memory
from .mfem_spaces import Space, check_kind, read_space
from .mfem_topology import GEOMETRIES, Topology
from .nurbs import surface_to_bezier
from .report import Collector
from .text import Tokens

__all__ = ["add_nurbs"]

#: For each direction of a cube, and of a square, an edge that runs along it.
_ALONG = {3: ((0, 1), (1, 2)), 5: ((0, 1), (0, 3), (0, 4))}
_CUBE = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
)


@dataclass
class _Knots:
    """A knot vector: degree, number of control points, knots."""

    degree: int
    count: int
    knots: np.ndarray

    def turned(self) -> _Knots:
        """Return the same from its end."""
        k = self.knots
        return _Knots(self.degree, self.count, (k[0] + k[-1] - k)[::-1])


def _read_knots(tokens: Tokens) -> list[_Knots]:
    out = []
    for _ in range(tokens.integer("the number of knot vectors", 1, len(tokens))):
        degree = tokens.integer("a degree", 1, 40)
        count = tokens.integer("a number of control points", degree + 1, len(tokens))
        out.append(_Knots(degree, count, tokens.numbers(count + degree + 1, "knots")))
    return out


class _Patches:
    """The control points of a NURBS mesh: their numbers on faces of patches."""

    def __init__(self, topology: Topology, path: object) -> None:
        topology.number()
        self.topology, self.path = topology, path
        #: For each patch the knot vectors of its directions.
        self.knots: list[list[_Knots]] = []

    def check(self) -> None:
        """Check the counts of patches that share an edge, and number all control points."""
        topology = self.topology
        self.edge_counts = np.full(topology.edges, -1)
        for e, (kind, own) in enumerate(zip(topology.geometry.tolist(), self.knots)):
            for pair, number in zip(GEOMETRIES[kind][1], topology.edge_numbers[e]):
                count = own[_direction(*pair)].count - 2
                if self.edge_counts[number] not in (-1, count):
                    raise damaged(
                        str(self.path), "edges with one number of control points", "several"
                    )
                self.edge_counts[number] = count
        counts = np.maximum(self.edge_counts, 0)
        self.edge_start = topology.vertices + np.concatenate([[0], np.cumsum(counts)])
        face_counts = np.zeros(topology.faces, dtype=np.int64)
        inside = []
        for e, (kind, own) in enumerate(zip(topology.geometry.tolist(), self.knots)):
            inside.append(int(np.prod([k.count - 2 for k in own])))
            if kind == 5:
                for f, number in enumerate(topology.face_numbers[e]):
                    a, b, _c, d = GEOMETRIES[5][2][f]
                    m, n = (own[_direction(a, x)].count - 2 for x in (b, d))
                    face_counts[number] = m * n
        self.face_start = self.edge_start[-1] + np.concatenate([[0], np.cumsum(face_counts)])
        self.start = self.face_start[-1] + np.concatenate([[0], np.cumsum(inside)])
        self.size = int(self.start[-1])

    def face_numbers(self, e: int, f: int) -> np.ndarray:
        """Return the numbers ``(M, N)`` of the control points on a face; see `face_knots`."""
        topology = self.topology
        kind = int(topology.geometry[e])
        face = GEOMETRIES[kind][2][f]
        corners = [topology.corners[e][k] for k in face]
        first, second = self.face_knots(e, f)
        m, n = first.count, second.count
        out = np.empty((m, n), dtype=np.int64)
        ends = [(0, 0), (m - 1, 0), (m - 1, n - 1), (0, n - 1)]
        numbers = {
            frozenset(pair): k for pair, k in zip(GEOMETRIES[kind][1], topology.edge_numbers[e])
        }
        for k, ij in enumerate(ends):
            out[ij] = corners[k]
        for a, b, where in (
            (0, 1, np.s_[1:-1, 0]),
            (3, 2, np.s_[1:-1, n - 1]),
            (0, 3, np.s_[0, 1:-1]),
            (1, 2, np.s_[m - 1, 1:-1]),
        ):
            number = numbers[frozenset((face[a], face[b]))]
            own = self.edge_start[number] + np.arange(self.edge_counts[number])
            out[where] = own if corners[a] < corners[b] else own[::-1]
        start = self.start[e] if kind == 3 else self.face_start[topology.face_numbers[e][f]]
        inner = start + np.arange((m - 2) * (n - 2))
        out[1:-1, 1:-1] = inner.reshape(n - 2, m - 2).T
        return out

    def face_knots(self, e: int, f: int) -> tuple[_Knots, _Knots]:
        """Return the knot vectors of a face, along the sides from its first corner."""
        kind = int(self.topology.geometry[e])
        a, b, _c, d = GEOMETRIES[kind][2][f]
        out = []
        for x in (b, d):
            knots = self.knots[e][_direction(a, x)]
            out.append(knots if _forward(a, x) else knots.turned())
        return out[0], out[1]

    def slice_of(self, e: int, f: int, values: np.ndarray) -> np.ndarray:
        """Return what a patch ``(n0, n1[, n2], c)`` has on a face, ``(M, N, c)``."""
        kind = int(self.topology.geometry[e])
        if kind == 3:
            return values
        face = GEOMETRIES[5][2][f]
        a, b, d = (_CUBE[face[k]] for k in (0, 1, 3))
        shape = np.array(values.shape[:3]) - 1
        m, n = (values.shape[int(np.flatnonzero(x - a)[0])] for x in (b, d))
        i, j = np.meshgrid(np.arange(m), np.arange(n), indexing="ij")
        at = a * shape + i[..., None] * (b - a) + j[..., None] * (d - a)
        return values[at[..., 0], at[..., 1], at[..., 2]]


def _direction(a: int, b: int) -> int:
    return int(np.flatnonzero(_CUBE[a] - _CUBE[b])[0])


def _forward(a: int, b: int) -> bool:
    return bool((_CUBE[b] - _CUBE[a]).sum() > 0)


def add_nurbs(
    collector: Collector,
    topology: Topology,
    tokens: Tokens,
    functions: Sequence[str | PathLike[str]],
    fields: bool,
) -> None:
    """Read what follows the topology of a NURBS mesh, and convert it."""
    path = tokens.path
    wanted = 3 if topology.dimension == 2 else 5
    if topology.dimension == 1 or (topology.geometry != wanted).any():
        raise damaged(path, "patches that are squares or cubes", "others (curves, say)")
    patches = _Patches(topology, path)
    word = tokens.word("knotvectors or patches")
    if word == "patches":
        nets = [_read_patch(tokens, topology.dimension) for _ in topology.corners]
        patches.knots = [own for own, _net in nets]
        patches.check()
        given: list[np.ndarray] | None = [net for _own, net in nets]
        points = weights = None
    elif word == "knotvectors":
        given = None
        _share_knots(patches, _read_knots(tokens), tokens)
        patches.check()
        if tokens.peek() == "mesh_elements":
            raise tokens.error("a mesh of all elements of its patches", "mesh_elements")
        if tokens.peek() == "periodic":
            raise tokens.error("a mesh that is not periodic", "periodic")
        weights = np.ones(patches.size)
        if tokens.peek() == "weights":
            tokens.word("weights")
            weights = tokens.numbers(patches.size, "weights")
        space = read_space(tokens)
        check_kind(path, space, ("NURBS",))
        points = space.values
        if len(points) != patches.size or space.components > 3:
            raise damaged(path, f"{patches.size} control points", points.shape)
        points = np.pad(points, ((0, 0), (0, 3 - space.components)))
    else:
        raise tokens.error("knotvectors or patches", repr(word[:40]), back=1)
    others = [(Path(file).stem, _function(file, patches)) for file in functions]
    first = 0
    for e, kind in enumerate(topology.geometry.tolist()):
        for f in range(len(GEOMETRIES[kind][2])):
            if kind == 5 and topology.face_uses[topology.face_numbers[e][f]] > 1:
                continue
            numbers = patches.face_numbers(e, f)
            if given is not None:
                net = patches.slice_of(e, f, given[e])
            else:
                assert points is not None and weights is not None
                w = weights[numbers][..., None]
                net = np.concatenate([points[numbers] * w, w], axis=2)
            values = {name: space.values[numbers] for name, space in others}
            attribute = float(topology.attributes[e]) if fields else None
            first += _add_face(collector, patches, e, f, net, values, attribute, first)


def _share_knots(patches: _Patches, knots: list[_Knots], tokens: Tokens) -> None:
    """Give patches the knot vectors that the edges name."""
    topology = patches.topology
    edges = topology.given_edges
    assert edges is not None
    if len(edges) and not (edges[:, 0].min() >= 0 and edges[:, 0].max() < len(knots)):
        raise tokens.error(f"edges of the {len(knots)} knot vectors", "others")
    for e, kind in enumerate(topology.geometry.tolist()):
        own = []
        pairs = [frozenset(pair) for pair in GEOMETRIES[kind][1]]
        for a, b in _ALONG[kind]:
            number = topology.edge_numbers[e][pairs.index(frozenset((a, b)))]
            index, start, _end = edges[number].tolist()
            same = topology.corners[e][a] == start
            own.append(knots[index] if same else knots[index].turned())
        patches.knots.append(own)


def _read_patch(tokens: Tokens, dimension: int) -> tuple[list[_Knots], np.ndarray]:
    """Read a patch with its own knot vectors and homogeneous control points."""
    for word in ("knotvectors", "dimension"):
        if tokens.word(word) != word:
            raise tokens.error(word, "another word", back=1)
        if word == "knotvectors":
            own = _read_knots(tokens)
    width = tokens.integer("the dimension of space", 1, 3)
    form = tokens.word("controlpoints")
    known = ("controlpoints", "controlpoints_homogeneous", "controlpoints_cartesian")
    if form not in known or len(own) != dimension:
        raise tokens.error(f"{dimension} knot vectors, then controlpoints", repr(form[:40]), back=1)
    shape = [knots.count for knots in own]
    count = int(np.prod(shape, dtype=np.float64))
    flat = tokens.numbers(count * (width + 1), "control points").reshape(count, width + 1)
    net = np.zeros((count, 4))
    net[:, :width], net[:, 3] = flat[:, :width], flat[:, width]
    if form == "controlpoints_cartesian":
        net[:, :3] *= net[:, 3:]
    # the first direction runs fastest
    return own, np.moveaxis(net.reshape(*shape[::-1], 4), range(dimension), range(dimension)[::-1])


def _function(file: str | PathLike[str], patches: _Patches) -> Space:
    """Read a grid function on the patches."""
    space = read_space(Tokens(file), file=True)
    check_kind(file, space, ("NURBS",))
    if len(space.values) != patches.size:
        raise damaged(
            file,
            f"{patches.size} values, of the degree of the mesh",
            f"{len(space.values)} of {space.name}",
        )
    return space


def _add_face(
    collector: Collector,
    patches: _Patches,
    e: int,
    f: int,
    net: np.ndarray,
    values: dict[str, np.ndarray],
    attribute: float | None,
    first: int,
) -> int:
    """Convert a face of a patch, from `first` on; return how many Bézier patches it has."""
    u, v = patches.face_knots(e, f)
    degrees = u.degree, v.degree

    def pieces(control: np.ndarray) -> np.ndarray:
        try:
            return surface_to_bezier(control, u.knots, v.knots, degrees)[0]
        except GeometryError as error:
            raise damaged(str(patches.path), "knot vectors that fit", str(error)) from None

    spans = [len(np.unique(own.knots)) for own in (u, v)]
    size = 32 * spans[0] * spans[1] * (degrees[0] + 1) * (degrees[1] + 1)
    check_memory(str(patches.path), size, f"{spans[0]} x {spans[1]} spans")
    bezier = pieces(net)
    count, size = len(bezier), bezier.shape[1] * bezier.shape[2]
    points = bezier.reshape(-1, 4)
    p, q = degrees
    lattice = np.array([(i, j) for i in range(p + 1) for j in range(q + 1)])
    index = np.arange(count * size).reshape(count, size)
    fields: dict[str, CellField] = {}
    rational = bool((points[:, 3] != points[0, 3]).any())
    for name, own in values.items():
        width = own.shape[2]
        padded = np.pad(own, ((0, 0), (0, 0), (0, -width % 3)))
        parts = []
        for k in range(0, width, 3):
            control = np.concatenate([padded[..., k : k + 3] * net[..., 3:], net[..., 3:]], axis=2)
            piece = pieces(control).reshape(-1, 4)
            parts.append(piece[:, :3] / piece[:, 3:])
        table = np.concatenate(parts, axis=1)[:, :width]
        weights = points[:, 3] if rational else None
        fields[name] = CellField(lattice, index, table, weights, bezier=True)
    if attribute is not None:
        constant = np.full((count, 1), attribute)
        fields["attribute"] = CellField(0 * lattice[:1], np.arange(count)[:, None], constant)
    part = Cells("quad", lattice, index, bezier=True, fields=fields)
    add_cells(collector, part, points, first + np.arange(count))
    return count
