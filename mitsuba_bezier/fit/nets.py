"""`Net`: control points and weights of patches, joined where they meet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .._runtime import import_mitsuba
from ..errors import BezierError, NetError
from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles
from .parametrization import Parametrization, as_patches, assembled, column

__all__ = ["Net"]

#: Relative to the size of the surface: control points this near are one. Nets of files and scenes
#: are float32, whose rounding is 6e-8; refined ones are float64.
_SAME = 1e-6


class Net(Parametrization):
    """Free control points, and weights that keep their sign.

    A weight is ``w0 exp(l)`` with its value ``w0`` at the start, so that no weight becomes zero or
    changes its sign; control vectors (weight zero) stay vectors. Control points in which patches
    meet are one unknown: the surface stays closed. Weights of corners stay, as the parameters of a
    patch leave them free (``u_i -> s_i u_i``, Farin, *Curves and Surfaces for CAGD*, 2002).

    Parameters
    ----------
    patches : BezierTriangles or (P, K, 4) array_like
        Where the search begins.
    points, weights : bool
        Whether they are unknown.
    hold : {"nothing", "corners", "boundary"} or (P, K) array of bool
        Control points that stay, with their weights: corners of all patches, the edges that
        belong to one patch only, or those marked.

    Raises
    ------
    NetError
        If the net is not valid, or `hold` of another shape.

    Examples
    --------
    >>> import mitsuba_bezier as mb
    >>> from mitsuba_bezier import fit
    >>> net = fit.Net(mb.sphere(cover="octants"))
    >>> {name: array.shape for name, array in net.start().items()}
    {'points': (66, 3), 'logarithms': (60, 1)}
    """

    can_refine = True

    def __init__(
        self,
        patches: Any,
        points: bool = True,
        weights: bool = True,
        hold: Any = "nothing",
    ) -> None:
        patches = as_patches(patches)
        if not points and not weights:
            raise BezierError.expected("points, weights", "at least one True", "False, False")
        self.options: dict[str, Any] = {"points": points, "weights": weights, "hold": hold}
        self.patches = patches
        rows = patches.control_points.reshape(-1, 4)
        self.positions, self.factors, self.ideal, self.size = _split(rows)
        self.vertex = _welded(self.positions, self.ideal, self.factors, patches, self.size)
        self.first = np.unique(self.vertex, return_index=True)[1]  # a row of each vertex
        held = self._held(hold)
        self.free = np.flatnonzero(~held) if points else np.zeros(0, dtype=int)
        self.weighted = np.zeros(0, dtype=int)
        if weights:
            corner = np.zeros((len(patches), rows.shape[0] // len(patches)), dtype=bool)
            corner[:, list(bernstein.corner_rows(patches.degree))] = True
            at_corner = np.bincount(self.vertex, corner.ravel()) > 0
            fixed = held | at_corner | self.ideal[self.first]
            self.weighted = np.flatnonzero(~fixed)
        if not len(self.free) and not len(self.weighted):
            raise BezierError.expected("hold", "control points that are not held", "all are")

    def start(self) -> dict[str, np.ndarray]:
        out = {}
        if len(self.free):
            out["points"] = self.positions[self.first[self.free]]
        if len(self.weighted):
            out["logarithms"] = np.zeros((len(self.weighted), 1))
        return out

    def scales(self) -> dict[str, float]:
        return {"points": self.size, "logarithms": 1.0}

    def value(self, unknowns: Mapping[str, Any]) -> Any:
        import drjit as dr

        mi = import_mitsuba()
        if len(self.free):
            places = mi.Float(self.positions[self.first].ravel())
            index = (3 * self.free[:, None] + np.arange(3)).ravel()
            dr.scatter(places, unknowns["points"].array, mi.UInt32(index))
            places = mi.TensorXf(places, shape=(len(self.first), 3))
            point = [column(places, self.vertex, 3, c) for c in range(3)]
        else:
            point = [mi.Float(self.positions[:, c]) for c in range(3)]
        factor = mi.Float(self.factors)
        if len(self.weighted):
            logarithms = dr.zeros(mi.Float, len(self.first))
            dr.scatter(logarithms, unknowns["logarithms"].array, mi.UInt32(self.weighted))
            factor *= dr.exp(dr.gather(mi.Float, logarithms, mi.UInt32(self.vertex)))
        weight = dr.select(mi.Bool(self.ideal), 0, factor)
        return assembled([*(x * factor for x in point), weight], self.patches.control_points.shape)

    def laplacian(self, name: str) -> Any:
        """Return the Laplacian of the control nets' edges, between the free rows."""
        kept = self.free if name == "points" else self.weighted
        count = len(self.first)
        a, b = self.vertex.reshape(len(self.patches), -1)[
            :, bernstein.net_edges(self.patches.degree)
        ].T
        a, b = a.ravel(), b.ravel()
        ones = np.ones(len(a))
        graph = csr_array(coo_array((ones, (a, b)), shape=(count, count)))
        graph = ((graph + graph.T) > 0).astype(float)
        graph.setdiag(0)
        degrees = graph.sum(axis=1)
        out = (csr_array((degrees, (range(count), range(count)))) - graph).tocsr()
        return out[kept][:, kept].tocsc()

    def refined(self, unknowns: Mapping[str, np.ndarray], how: str) -> Net:
        if how not in ("elevate", "split"):
            raise BezierError.expected("refine", '"elevate" or "split"', repr(how))
        if not isinstance(self.options["hold"], str):
            raise BezierError.expected("refine", "hold by name, not by a mask", "a mask")
        now = self.net(unknowns)
        return Net(now.elevate() if how == "elevate" else now.split(), **self.options)

    def net(self, unknowns: Mapping[str, np.ndarray]) -> BezierTriangles:
        """Return the patches for unknowns, in float64."""
        places = self.positions[self.first].copy()
        logarithms = np.zeros(len(self.first))
        if len(self.free):
            places[self.free] = unknowns["points"]
        if len(self.weighted):
            logarithms[self.weighted] = unknowns["logarithms"][:, 0]
        factor = self.factors * np.exp(logarithms[self.vertex])
        rows = np.empty((len(factor), 4))
        rows[:, :3] = places[self.vertex] * factor[:, None]
        rows[:, 3] = np.where(self.ideal, 0, factor)
        return BezierTriangles(rows.reshape(self.patches.control_points.shape))

    def state(self) -> dict[str, np.ndarray]:
        return {"control_points": self.patches.control_points}

    def restored(self, state: Mapping[str, np.ndarray]) -> Net:
        return Net(state["control_points"], **self.options)

    def _held(self, hold: Any) -> np.ndarray:
        """Return which vertices stay."""
        shape = self.patches.control_points.shape[:2]
        rows = np.zeros(shape, dtype=bool)
        n = self.patches.degree
        if isinstance(hold, str):
            if hold not in ("nothing", "corners", "boundary"):
                raise NetError.expected(
                    "hold", '"nothing", "corners", "boundary" or a mask', repr(hold)
                )
            if hold == "corners":
                rows[:, list(bernstein.corner_rows(n))] = True
            elif hold == "boundary":
                vertex = self.vertex.reshape(shape)
                edges = bernstein.edge_rows(n)
                keys = np.sort(vertex[:, edges[:, [0, -1]]], axis=-1).reshape(-1, 2)
                middle = vertex[:, edges].min(axis=-1).ravel()
                _u, back, count = np.unique(
                    np.column_stack([keys, middle]), axis=0, return_inverse=True, return_counts=True
                )
                lonely = (count[back.ravel()] == 1).reshape(len(vertex), 3)
                for e in range(3):
                    rows[np.ix_(lonely[:, e], edges[e])] = True
        else:
            hold = np.asarray(hold)
            if hold.shape != shape or hold.dtype != bool:
                raise NetError.expected(
                    "hold", f"Booleans of shape {shape}", f"{hold.dtype} of shape {hold.shape}"
                )
            rows = hold
        held: np.ndarray = np.bincount(self.vertex, rows.ravel()) > 0
        return held | (self.factors[self.first] == 0)


def _split(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return points, factors, which points are ideal, and the size of the finite ones.

    A row is ``factor (x, y, z, 1)``, an ideal one ``factor (x, y, z, 0)`` with a vector as long as
    the surface is large.
    """
    weight = rows[:, 3]
    ideal = weight == 0
    finite = rows[~ideal, :3] / rows[~ideal, 3:]
    size = float(np.ptp(finite, axis=0).max(initial=0.0)) if len(finite) else 0.0
    size = size or 1.0
    # a vector and its negative are one point: the largest coordinate is positive
    lead = np.take_along_axis(rows, np.abs(rows[:, :3]).argmax(axis=1)[:, None], axis=1)[:, 0]
    length = np.linalg.norm(rows[:, :3], axis=1) * np.where(lead < 0, -1, 1) / size
    factors = np.where(ideal, length, weight)
    safe = np.where(factors == 0, 1, factors)
    return rows[:, :3] / safe[:, None], factors, ideal, size


def _welded(
    positions: np.ndarray,
    ideal: np.ndarray,
    factors: np.ndarray,
    patches: BezierTriangles,
    size: float,
) -> np.ndarray:
    """Return the vertex of each row: rows of edges that are one point share theirs."""
    count = len(positions)
    border = np.zeros((len(patches), count // len(patches)), dtype=bool)
    border[:, np.unique(bernstein.edge_rows(patches.degree))] = True
    used = np.flatnonzero(border.ravel() & (factors != 0))
    # ideal points are far from finite ones
    places = np.column_stack([positions / size, 10.0 * ideal])
    pairs = cKDTree(places[used]).query_pairs(_SAME, output_type="ndarray")
    a, b = used[pairs[:, 0]], used[pairs[:, 1]]
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
    vertex: np.ndarray = connected_components(graph, directed=False)[1]
    return vertex
