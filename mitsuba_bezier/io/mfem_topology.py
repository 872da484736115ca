"""Number the edges and faces of MFEM's elements, and the degrees of freedom on them."""

from __future__ import annotations

import numpy as np

from .files import damaged
from .mfem_spaces import Space
from .text import Tokens

__all__ = ["GEOMETRIES", "Topology"]

#: Geometry to corners, edges, and faces (of a plane element, itself).
GEOMETRIES: dict[int, tuple[int, list[tuple[int, int]], list[tuple[int, ...]]]] = {
    0: (1, [], []),
    1: (2, [(0, 1)], []),
    2: (3, [(0, 1), (1, 2), (2, 0)], [(0, 1, 2)]),
    3: (4, [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, 1, 2, 3)]),
    4: (
        4,
        [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)],
        [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)],
    ),
    5: (
        8,
        [
            (0, 1),
            (1, 2),
            (3, 2),
            (0, 3),
            (4, 5),
            (5, 6),
            (7, 6),
            (4, 7),
            (0, 4),
            (1, 5),
            (2, 6),
            (3, 7),
        ],
        [(3, 2, 1, 0), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7)],
    ),
    6: (
        6,
        [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
        [(0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
    ),
    7: (
        5,
        [(0, 1), (1, 2), (3, 2), (0, 3), (0, 4), (1, 4), (2, 4), (3, 4)],
        [(3, 2, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
    ),
}
_DIMENSION = {0: 0, 1: 1, 2: 2, 3: 2, 4: 3, 5: 3, 6: 3, 7: 3}
_CUBE = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
)


def _first_seen(rows: np.ndarray) -> np.ndarray:
    """Return numbers of equal rows, in the order in which they are met first."""
    _unique, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse.ravel()]


class Topology:
    """Elements, read from the head of a mesh.

    Attributes
    ----------
    dimension : int
    attributes, geometry : (E,) int arrays
    corners : list of (c,) int lists
        The vertices of each element.
    edge_numbers : list of lists
        For each element the numbers of its edges.
    face_numbers : list of lists
        Of volume elements, those of its faces.
    vertices : int
    """

    def __init__(self, tokens: Tokens, nurbs: bool) -> None:
        path = tokens.path
        _expect(tokens, "dimension")
        self.dimension = tokens.integer("the dimension", 1, 3)
        _expect(tokens, "elements")
        count = tokens.integer("the number of elements", 0, max(len(tokens) // 3, 1))
        attributes, geometry, corners = [], [], []
        for _ in range(count):
            attributes.append(tokens.integer("an attribute", -(2**31), 2**31))
            kind = tokens.integer("a geometry", 0, 7)
            geometry.append(kind)
            corners.append(tokens.integers(GEOMETRIES[kind][0], "vertices").tolist())
        self.attributes, self.geometry = np.array(attributes), np.array(geometry)
        self.corners = corners
        if tokens.peek() == "attribute_sets":
            tokens.skip_to("boundary")
        _expect(tokens, "boundary")
        for _ in range(tokens.integer("the number of boundary elements", 0, len(tokens))):
            tokens.integer("an attribute", -(2**31), 2**31)
            kind = tokens.integer("a geometry", 0, 5)
            tokens.integers(GEOMETRIES[kind][0], "vertices")
        if tokens.peek() == "bdr_attribute_sets":
            tokens.skip_to("edges" if nurbs else "vertices")
        self.vertices = 0
        self.given_edges: np.ndarray | None = None
        if nurbs:
            _expect(tokens, "edges")
            edges = tokens.integer("the number of edges", 0, len(tokens))
            self.given_edges = tokens.integers(3 * edges, "edges").reshape(-1, 3)
            self.read_vertices(tokens)
        self._path = path
        self._numbered = False

    def read_vertices(self, tokens: Tokens) -> int:
        """Read the section ``vertices`` up to the number; return it."""
        _expect(tokens, "vertices")
        self.vertices = tokens.integer("the number of vertices", 0, 2**40)
        largest = max((max(c) for c in self.corners), default=-1)
        least = min((min(c) for c in self.corners), default=0)
        if least < 0 or largest >= self.vertices:
            raise tokens.error(
                f"elements of vertices from 0 to {self.vertices - 1}", f"{least} to {largest}"
            )
        return self.vertices

    def number(self) -> None:
        """Give numbers to edges and faces, as MFEM does."""
        if self._numbered:
            return
        self._numbered = True
        pairs, sizes = [], []
        for kind, c in zip(self.geometry.tolist(), self.corners):
            edges = GEOMETRIES[kind][1]
            sizes.append(len(edges))
            pairs += [(c[a], c[b]) if c[a] < c[b] else (c[b], c[a]) for a, b in edges]
        rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        if self.given_edges is not None:
            ends = np.sort(self.given_edges[:, 1:], axis=1)
            known = {tuple(e): k for k, e in enumerate(ends.tolist())}
            numbers = np.array([known.get(tuple(p), -1) for p in rows.tolist()], dtype=np.int64)
            if (numbers < 0).any():
                raise damaged(self._path, "all edges of elements in 'edges'", "some missing")
            self.edges = len(ends)
        else:
            numbers = _first_seen(rows)
            self.edges = int(numbers.max(initial=-1)) + 1
        ends_of = np.cumsum(np.array(sizes, dtype=np.int64))[:-1]
        self.edge_numbers = [part.tolist() for part in np.split(numbers, ends_of)]
        faces, counts = [], []
        for kind, c in zip(self.geometry.tolist(), self.corners):
            own = GEOMETRIES[kind][2] if _DIMENSION[kind] == 3 else []
            counts.append(len(own))
            faces += [sorted([c[k] for k in f]) + [-1] * (4 - len(f)) for f in own]
        rows = np.array(faces, dtype=np.int64).reshape(-1, 4)
        numbers = _first_seen(rows)
        self.faces = int(numbers.max(initial=-1)) + 1
        self.face_numbers = [part.tolist() for part in np.split(numbers, np.cumsum(counts)[:-1])]
        #: Corners of each face (3 or 4).
        self.face_sizes = np.full(self.faces, 4)
        self.face_sizes[numbers[rows[:, 3] < 0]] = 3
        self.face_sizes[numbers[rows[:, 0] < 0]] = 3
        self.face_uses = np.bincount(numbers, minlength=self.faces)

    # ------------------------------------------------------------ degrees of freedom

    def _counts(self, space: Space) -> tuple[int, np.ndarray, np.ndarray]:
        """Return how many degrees of freedom an edge, each face, each element has inside."""
        p = space.order
        if space.kind == "L2":
            size = {
                1: p + 1,
                2: (p + 1) * (p + 2) // 2,
                3: (p + 1) ** 2,
                4: (p + 1) * (p + 2) * (p + 3) // 6,
                5: (p + 1) ** 3,
                6: (p + 1) ** 2 * (p + 2) // 2,
                7: (p + 1) * (p + 2) * (2 * p + 3) // 6,
            }
            inside = np.array([size.get(k, 1) for k in self.geometry.tolist()], dtype=np.int64)
            return 0, np.zeros(self.faces, dtype=np.int64), inside
        q = max(p - 1, 0)
        size = {
            1: 0,  # of segments: the edge itself
            2: q * (p - 2) // 2,
            3: q * q,
            4: q * (p - 2) * (p - 3) // 6,
            5: q**3,
            6: q * (q * (p - 2) // 2),
            7: q * (p - 2) * (2 * p - 3) // 6,
        }
        faces = np.where(self.face_sizes == 3, size[2], size[3])
        inside = np.array([size.get(k, 0) for k in self.geometry.tolist()], dtype=np.int64)
        return q, faces, inside

    def _offsets(self, space: Space) -> tuple[int, int, np.ndarray, np.ndarray, int]:
        edge, faces, inside = self._counts(space)
        vertices = 0 if space.kind == "L2" else self.vertices
        after_edges = vertices + edge * self.edges if space.kind != "L2" else 0
        face_start = after_edges + np.concatenate([[0], np.cumsum(faces)])
        start = face_start[-1] + np.concatenate([[0], np.cumsum(inside)])
        return vertices, edge, face_start, start, int(start[-1])

    def size(self, space: Space) -> int:
        """Return how many degrees of freedom a space has."""
        self.number()
        return self._offsets(space)[4]

    def shown(self, space: Space) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Return what is shown: kind, numbers of elements, and which of their faces it is.

        Raises
        ------
        FileFormatError
            If the nodes of volume elements are not on their faces.
        """
        self.number()
        found: dict[tuple[str, int, int], list[int]] = {}
        for e, kind in enumerate(self.geometry.tolist()):
            faces = GEOMETRIES[kind][2]
            if _DIMENSION[kind] == 2:
                found.setdefault(("triangle" if kind == 2 else "quad", kind, 0), []).append(e)
            elif _DIMENSION[kind] == 3:
                for f, number in enumerate(self.face_numbers[e]):
                    # nodes of their own for each element: a periodic mesh, whose box is shown
                    if self.face_uses[number] == 1 or (
                        space.kind == "L2" and self._is_rim(space, e, f)
                    ):
                        name = "triangle" if len(faces[f]) == 3 else "quad"
                        found.setdefault((name, kind, f), []).append(e)
        return [
            (name, np.array(elements), np.full(len(elements), f))
            for (name, _kind, f), elements in found.items()
        ]

    def _is_rim(self, space: Space, element: int, face: int) -> bool:
        """Return whether no other element has the same corners of a face in space."""
        if not hasattr(self, "_rims"):
            keys: dict[tuple[object, ...], int] = {}
            own: dict[tuple[int, int], tuple[object, ...]] = {}
            size = float(np.abs(space.values).max(initial=0.0)) or 1.0
            for e, kind in enumerate(self.geometry.tolist()):
                for f in range(len(GEOMETRIES[kind][2])):
                    at = self._l2_nodes(space, kind, e, f, corners=True)
                    # 1e-9: coordinates are written with that many digits
                    places = np.round(space.values[at] / (1e-9 * size)).astype(np.int64)
                    key = tuple(sorted(map(tuple, places.tolist())))
                    own[e, f] = key
                    keys[key] = keys.get(key, 0) + 1
            self._rims = {ef: keys[key] == 1 for ef, key in own.items()}
        return self._rims[element, face]

    def nodes(
        self, space: Space, kind: str, elements: np.ndarray, faces: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the lattice of faces, or of plane elements, and their degrees of freedom."""
        self.number()
        lattice = self._lattice(space, kind)
        rows = []
        offsets = self._offsets(space)
        for e, f in zip(elements.tolist(), faces.tolist()):
            geometry = int(self.geometry[e])
            if space.kind == "L2":
                rows.append(self._l2_nodes(space, geometry, e, f))
            else:
                rows.append(self._h1_nodes(space, geometry, e, f, offsets))
        return lattice, np.array(rows, dtype=np.int64).reshape(len(rows), -1)

    @staticmethod
    def _lattice(space: Space, kind: str) -> np.ndarray:
        p = space.order
        if kind == "triangle":
            return np.array([(p - i - j, i, j) for j in range(p + 1) for i in range(p + 1 - j)])
        return np.array([(i, j) for j in range(p + 1) for i in range(p + 1)])

    def _h1_nodes(
        self,
        space: Space,
        geometry: int,
        e: int,
        f: int,
        offsets: tuple[int, int, np.ndarray, np.ndarray, int],
    ) -> list[int]:
        """Return the nodes of a face in the order of `_lattice`."""
        vertices, edge_size, face_start, start, _size = offsets
        p = space.order
        face = GEOMETRIES[geometry][2][f]
        corners = [self.corners[e][k] for k in face]
        edges = {
            frozenset(pair): number
            for pair, number in zip(GEOMETRIES[geometry][1], self.edge_numbers[e])
        }

        def along(a: int, b: int) -> list[int]:
            """Return the nodes inside of the edge from corner a to corner b of the face."""
            first = vertices + edge_size * edges[frozenset((face[a], face[b]))]
            own = list(range(first, first + edge_size))
            return own if corners[a] < corners[b] else own[::-1]

        plane = _DIMENSION[geometry] == 2
        inner = int(start[e] if plane else face_start[self.face_numbers[e][f]])
        grid: dict[tuple[int, int], int] = {}
        if len(face) == 3:
            ends = [(0, 0), (p, 0), (0, p)]
            inside = [(i, j) for j in range(1, p) for i in range(1, p - j)]
        else:
            ends = [(0, 0), (p, 0), (p, p), (0, p)]
            inside = [(i, j) for j in range(1, p) for i in range(1, p)]
        for k, (i, j) in enumerate(ends):
            grid[i, j] = corners[k]
            b = (k + 1) % len(ends)
            di, dj = ((ends[b][c] - ends[k][c]) // p for c in (0, 1))
            for t, node in enumerate(along(k, b), start=1):
                grid[i + t * di, j + t * dj] = node
        for t, ij in enumerate(inside):
            grid[ij] = inner + t
        if len(face) == 3:
            return [grid[i, j] for j in range(p + 1) for i in range(p + 1 - j)]
        return [grid[i, j] for j in range(p + 1) for i in range(p + 1)]

    def _l2_nodes(
        self, space: Space, geometry: int, e: int, f: int, corners: bool = False
    ) -> list[int]:
        """Return the nodes of a face of an element that has its own, or its corners only."""
        first = int(self._offsets(space)[3][e])
        p = space.order
        if p == 0:
            return [first]
        if _DIMENSION[geometry] == 2:
            count = (p + 1) ** 2 if geometry == 3 else (p + 1) * (p + 2) // 2
            return list(range(first, first + count))
        if geometry not in (4, 5) or space.basis not in ("G", "U", "P"):
            raise damaged(
                self._path,
                "L2 nodes of tetrahedra and hexahedra that are on their faces",
                space.name,
            )
        face = GEOMETRIES[geometry][2][f]
        if geometry == 5:
            number = {
                (i, j, k): first + i + (p + 1) * (j + (p + 1) * k)
                for k in range(p + 1) for j in range(p + 1) for i in range(p + 1)
            }  # fmt: skip
            a, b, d = (_CUBE[face[k]] for k in (0, 1, 3))
            steps = [(i, j) for j in range(p + 1) for i in range(p + 1)]
        else:
            order = [(i, j, k) for k in range(p + 1) for j in range(p + 1 - k)
                     for i in range(p + 1 - j - k)]  # fmt: skip
            number = {ijk: first + t for t, ijk in enumerate(order)}
            tetra = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
            a, b, d = (tetra[face[k]] for k in (0, 1, 2))
            steps = [(i, j) for j in range(p + 1) for i in range(p + 1 - j)]
        if corners:
            ends = [(0, 0), (p, 0), (0, p)] + ([(p, p)] if geometry == 5 else [])
            steps = ends
        return [number[tuple((p * a + i * (b - a) + j * (d - a)).tolist())] for i, j in steps]


def _expect(tokens: Tokens, word: str) -> None:
    if tokens.word(word) != word:
        raise tokens.error(word, "another word", back=1)
