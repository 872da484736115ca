"""Cut patches into leaves on which a ray meets the surface in a way that can be certified.

A *leaf* is a sub-triangle of a patch, mostly all of it. Its `LeafKind` says how a ray meets it.

`ClosedFormLeaves`
    Patches on quadrics and in planes. The ray meets the quadric in closed form, and what the leaf
    stores tells whether the point is on the patch, and with which parameters. The rows of a leaf
    are linear forms of ``(p - shift, 1)``:

    * `LINEAR`: three rows give a multiple of the barycentrics. So it is for all patches of
      `quadric_patch` and all planar triangles of degree one.
    * `CONE`: sectors of cones, with four rows, see `closed_form.sectors`.
    * `PLANE_SECTIONS`: patches of higher degree on an ellipsoid whose edges are plane sections.
      The rows give stereographic coordinates, and two complex polynomials the parameters from
      these, by Newton's method, once the hit is known.
    * `INVERTED`, `INVERTED_APEX`: all other patches, which may be cut. Their parameters, found by
      Newton's method in the same way, tell whether a point is on them. The second kind is projected
      along the axis of a cone, and a fourth row tells two points apart.

`GraphLeaves`
    Everything else, subdivided until the bounds below are small. The *chart* of a leaf is a
    collineation of space in which the leaf is nearly the unit triangle: its rows give homogeneous
    coordinates ``(x, y, z, W)`` of a point, the corners lie near ``(1,0,0,1), (0,1,0,1),
    (0,0,0,1)``, and the surface is the graph ``z = h(x, y)`` of a function close to a quadratic
    one, ``a xy + b x(1-x-y) + c y(1-x-y)``. Stored are the quadratic and

    * ``remainder`` >= |h - quadratic|,
    * ``variation`` >= spectral norm of Hess(h) - Hess(quadratic),
    * ``bending``: so that ``bending d^2`` is at least the error, at distance d, of h's tangent
      plane with the quadratic's second derivative,
    * ``outward`` and ``inward``, three of each: the leaf has only points whose barycentrics in the
      chart are at least ``-outward``, and covers all where they are at least ``inward``,

    proved (`graph.bounds`) over an enlarged triangle of parameters, one of the `SIZES`, whose image
    holds the unit triangle enlarged by the largest of ``outward``; and two more quadratics of the
    same form, which take ``(x, y)`` near to ``(u, v)``. The chart is affine (`GRAPH_AFFINE`) where
    the weights of the leaf are of one sign and nearly equal, else projective (`GRAPH_PROJECTIVE`;
    then W is not constant). ``docs/intersection.md`` says how the kernel uses them.

`RevolutionLeaves`
    Even aspheres: graphs of functions of revolution over a disk or a ring, each one leaf, of kind
    `REVOLUTION`. `revolution` has the bounds.

Everything is float64; what the kernel stores in float32 (``shift``, ``chart``) is rounded here
*before* the net is expressed in it, so that the rounding moves no surface point.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np

from ..geometry import bernstein
from .nets import Nets

__all__ = [
    "BENDING_LIMIT",
    "CLOSED_FORMS",
    "GRAPHS",
    "INVERTED_KINDS",
    "LEAST_REACH",
    "NO_APEX",
    "QUADRIC_ENTRIES",
    "SIZES",
    "ClosedFormLeaves",
    "GraphLeaves",
    "LeafKind",
    "LeafSettings",
    "Leaves",
    "RevolutionLeaves",
    "round_reach",
    "weight_signs",
]


class LeafKind(IntEnum):
    """How a ray meets a leaf; see the module's docstring."""

    GRAPH_AFFINE = 0
    GRAPH_PROJECTIVE = 1
    LINEAR = 2
    CONE = 3
    PLANE_SECTIONS = 4
    INVERTED = 5
    INVERTED_APEX = 6
    REVOLUTION = 7


#: Kinds of graph leaves, and those with a closed form: all others but `REVOLUTION`.
GRAPHS = frozenset({LeafKind.GRAPH_AFFINE, LeafKind.GRAPH_PROJECTIVE})
CLOSED_FORMS = frozenset(LeafKind) - GRAPHS - {LeafKind.REVOLUTION}

#: Kinds whose parameters tell whether a point is on a leaf at all.
INVERTED_KINDS = frozenset({LeafKind.INVERTED, LeafKind.INVERTED_APEX})

#: `ClosedFormLeaves.corner` of leaves that are no sectors of cones: their parameters are in order.
NO_APEX = 2

#: Order of the ten entries of a symmetric matrix in `ClosedFormLeaves.quadric`.
QUADRIC_ENTRIES = (
    (0, 0),
    (1, 1),
    (2, 2),
    (0, 1),
    (0, 2),
    (1, 2),
    (0, 3),
    (1, 3),
    (2, 3),
    (3, 3),
)

#: By how much, in barycentrics, the parameter triangles reach out on which the bounds of graph
#: leaves hold. Few, so that leaves share their matrices; the kernel has the same formula.
SIZES = tuple(0.004 * 2 ** (k / 2) for k in range(16))

#: The least that `round_reach` returns.
LEAST_REACH = 2.0**-14

#: The bending of graph leaves is below this, so that the device has it and the size in one number.
BENDING_LIMIT = 16.0


def round_reach(reach: np.ndarray) -> np.ndarray:
    """Round `outward` and `inward` up to what the kernel can hold, in seven bits.

    Four binary digits and sixteen exponents, from `LEAST_REACH` on; infinite where that is too
    little.
    """
    mantissa, exponent = np.frexp(np.maximum(reach, LEAST_REACH))
    rounded = np.ldexp(np.ceil(mantissa * 16) / 16, exponent)
    return np.where(rounded < LEAST_REACH * 2**16, rounded, np.inf)


def weight_signs(nets: np.ndarray) -> np.ndarray:
    """Return the sign of the weights of nets ``(P, K, 4)``, zero where they have not the same."""
    w = nets[..., 3]
    return np.where((w > 0).all(axis=1), 1.0, np.where((w < 0).all(axis=1), -1.0, 0.0))


@dataclass(frozen=True)
class LeafSettings:
    """When a leaf is good enough (all in chart units, in which the leaf has size one).

    Parameters
    ----------
    lateral : float
        Largest spectral norm of ``J - I`` of the map from parameters to chart coordinates.
    remainder : float
        Largest distance of the surface from its quadratic.
    height : float
        Largest height above the chart's base plane, relative to the leaf's size.
    weight : float
        Largest ratio of weights on the leaf, less one.
    max_depth : int
        Subdivision ends here whatever the bounds say.
    closed_form : bool
        Whether patches on quadrics and in planes become leaves with a closed form.
    sections : bool
        Whether patches do that are bounded by planes on an ellipsoid, of higher degree, and
        sectors of cones. Not where the parameters of every hit are needed, as for
        trimmed patches.
    """

    lateral: float = 0.8
    remainder: float = 0.06
    height: float = 0.3
    weight: float = 0.3
    max_depth: int = 15
    closed_form: bool = True
    sections: bool = True


Some = TypeVar("Some", bound="_Records")


def _each(*shape: int, dtype: type = float) -> dict[str, Any]:
    """Return what `_Records` asks of a field: shape and type of its entry for a leaf."""
    return {"shape": shape, "dtype": dtype}


#: Rows of the fields that hold polynomials where there are no leaves; `join` pads to the highest.
_FEWEST = bernstein.size(1)


@dataclass
class _Records:
    """Arrays with one entry a leaf."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    @classmethod
    def zeros(cls: type[Some], count: int = 0, **known: Any) -> Some:
        """Return `count` leaves of which some arrays are known; the others are zero."""
        arrays = {
            f.name: Nets.zeros(count)
            if f.metadata["dtype"] is Nets
            else np.zeros((count, *f.metadata["shape"]), f.metadata["dtype"])
            for f in fields(cls)
            if f.name not in known
        }
        return cls(**arrays, **known)

    def select(self: Some, mask: np.ndarray) -> Some:
        """Return the leaves chosen by a mask or an index array."""
        return type(self)(**{f.name: getattr(self, f.name)[mask] for f in fields(self)})

    @classmethod
    def join(cls: type[Some], parts: list[Some]) -> Some:
        """Concatenate; polynomials are padded to the highest degree with zero monomials."""
        out: dict[str, Any] = {}
        for f in fields(cls):
            arrays = [getattr(p, f.name) for p in parts if len(p)]
            if f.metadata["dtype"] is Nets:
                if arrays:
                    out[f.name] = Nets.join(arrays)
                continue
            if f.metadata["shape"] == (_FEWEST, 4) and arrays:
                top = max(a.shape[1] for a in arrays)
                arrays = [_pad(a, top) for a in arrays]
            if arrays:
                out[f.name] = np.concatenate(arrays)
        return cls.zeros(0, **out)


@dataclass
class GraphLeaves(_Records):
    """Arrays of `L` leaves that are graphs in a chart."""

    patch: np.ndarray = field(metadata=_each(dtype=int))  #: (L,) patch number
    domain: np.ndarray = field(
        metadata=_each(3, 3)
    )  #: leaf barycentrics to patch barycentrics, homogeneous
    shift: np.ndarray = field(metadata=_each(3))  #: origin of the chart, float32 numbers
    chart: np.ndarray = field(
        metadata=_each(4, 4)
    )  #: rows x, y, z, W on (p - shift, 1), float32 numbers
    quadratic: np.ndarray = field(metadata=_each(3))  #: a, b, c
    remainder: np.ndarray = field(metadata=_each())
    variation: np.ndarray = field(metadata=_each())
    bending: np.ndarray = field(metadata=_each())  #: at most `BENDING_LIMIT`
    size: np.ndarray = field(metadata=_each(dtype=int))  #: index of `SIZES`
    start: np.ndarray = field(metadata=_each(2, 3))  #: quadratics that take (x, y) near to (u, v)
    outward: np.ndarray = field(metadata=_each(3))
    inward: np.ndarray = field(metadata=_each(3))
    nets: Nets = field(metadata=_each(dtype=Nets))  #: monomial (x - u, y - v, z, W - 1)
    box: np.ndarray = field(metadata=_each(2, 3))  #: axis-aligned bounds, possibly infinite
    certified: np.ndarray = field(
        metadata=_each(dtype=bool)
    )  #: the leaf is the surface, and its bounds hold

    @property
    def net(self) -> np.ndarray:
        """The nets as one array ``(L, K, 4)``, padded to the highest degree."""
        return self.nets.padded()

    @property
    def kind(self) -> np.ndarray:
        """The kinds ``(L,)`` of leaves."""
        affine = (self.chart[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
        return np.where(affine, LeafKind.GRAPH_AFFINE, LeafKind.GRAPH_PROJECTIVE)


@dataclass
class ClosedFormLeaves(_Records):
    """Arrays of `L` leaves on quadrics and in planes."""

    patch: np.ndarray = field(metadata=_each(dtype=int))  #: (L,) patch number
    domain: np.ndarray = field(
        metadata=_each(3, 3)
    )  #: leaf barycentrics to patch barycentrics, homogeneous
    kind: np.ndarray = field(metadata=_each(dtype=int))  #: `LeafKind`
    group: np.ndarray = field(
        metadata=_each(dtype=int)
    )  #: leaves with the same number share their quadric
    shift: np.ndarray = field(metadata=_each(3))  #: origin of all that follows, float32 numbers
    #: rows, quadric and span are on ``(axes (p - shift), 1)`` (`affine_frames`)
    axes: np.ndarray = field(metadata=_each(3, 3))
    quadric: np.ndarray = field(metadata=_each(10))  #: a symmetric matrix, see `QUADRIC_ENTRIES`
    #: largest distance of the patch from the quadric, in patch sizes
    deviation: np.ndarray = field(metadata=_each())
    rows: np.ndarray = field(metadata=_each(4, 4))  #: linear forms, see the module's docstring
    #: of `LINEAR`: a lower bound of the absolute sum of the first three rows over the patch. All
    #: three vanish at the centre of projection, which is not on the patch unless this is zero
    least_sum: np.ndarray = field(metadata=_each())
    corner: np.ndarray = field(
        metadata=_each(dtype=int)
    )  #: of `CONE`: where its apex is; else `NO_APEX`
    #: of inverted leaves: how far their plane barycentrics go below zero (`inverted`)
    margins: np.ndarray = field(metadata=_each(3))
    polynomials: np.ndarray = field(
        metadata=_each(_FEWEST, 4)
    )  #: (K, 4) monomial P and Q, complex, or zero
    box: np.ndarray = field(metadata=_each(2, 3))  #: axis-aligned bounds, possibly infinite
    span: np.ndarray = field(metadata=_each(2, 3))  #: bounds of ``axes (p - shift)``

    def is_one_of(self, kinds: frozenset[LeafKind]) -> np.ndarray:
        """Return a mask ``(L,)`` of the leaves of these kinds."""
        return np.isin(self.kind, list(kinds))

    @classmethod
    def join(cls, parts: list[ClosedFormLeaves]) -> ClosedFormLeaves:
        """Concatenate; groups of different parts stay apart."""
        first = 0
        moved = []
        for part in parts:
            moved.append(replace(part, group=part.group + first))
            first = max(first, int(moved[-1].group.max(initial=-1)) + 1)
        return super().join(moved)


@dataclass
class RevolutionLeaves(_Records):
    """Arrays of `L` even aspheres."""

    patch: np.ndarray = field(metadata=_each(dtype=int))  #: (L,) patch number
    domain: np.ndarray = field(metadata=_each(3, 3))  #: the identity
    shift: np.ndarray = field(metadata=_each(3))  #: the vertex
    #: linear map of ``p - shift`` to axes in which the aperture's radius is one
    axes: np.ndarray = field(metadata=_each(3, 3))
    profile: np.ndarray = field(metadata=_each(dtype=object))  #: (L,) `revolution.Profile`
    box: np.ndarray = field(metadata=_each(2, 3))  #: axis-aligned bounds

    @property
    def kind(self) -> np.ndarray:
        """The kinds ``(L,)`` of leaves."""
        return np.full(len(self), LeafKind.REVOLUTION)


@dataclass
class Leaves:
    """The leaves of some patches; where they are counted, graphs come first, aspheres last."""

    graph: GraphLeaves
    closed_form: ClosedFormLeaves
    revolution: RevolutionLeaves = field(default_factory=RevolutionLeaves.zeros)

    def __len__(self) -> int:
        return len(self.graph) + len(self.closed_form) + len(self.revolution)

    def _all(self, name: str) -> np.ndarray:
        parts = (self.graph, self.closed_form, self.revolution)
        return np.concatenate([getattr(part, name) for part in parts])

    @property
    def patch(self) -> np.ndarray:
        """The patches ``(L,)`` of all leaves."""
        return self._all("patch")

    @property
    def domain(self) -> np.ndarray:
        """Maps ``(L, 3, 3)`` of leaf barycentrics to patch barycentrics, homogeneous."""
        return self._all("domain")

    @property
    def box(self) -> np.ndarray:
        """Axis-aligned bounds ``(L, 2, 3)``, possibly infinite."""
        return self._all("box")

    @property
    def kind(self) -> np.ndarray:
        """The kinds ``(L,)`` of leaves."""
        return self._all("kind")

    @property
    def kinds(self) -> frozenset[LeafKind]:
        """The kinds that occur."""
        return frozenset(LeafKind(k) for k in np.unique(self.kind).tolist())

    def is_one_of(self, kinds: frozenset[LeafKind]) -> np.ndarray:
        """Return a mask ``(L,)`` of the leaves of these kinds."""
        return np.isin(self.kind, list(kinds))

    @property
    def is_closed_form(self) -> np.ndarray:
        """A mask ``(L,)`` of the leaves with a closed form."""
        return self.is_one_of(CLOSED_FORMS)

    @property
    def certified(self) -> np.ndarray:
        """A mask ``(L,)`` of the leaves that are the surface, and whose bounds hold."""
        count = len(self) - len(self.graph)
        return np.append(self.graph.certified, np.ones(count, dtype=bool))

    def corners(self) -> np.ndarray:
        """Return the patch parameters ``(L, 3, 2)`` of the leaves' corners."""
        domain = self.domain
        barycentrics = domain / domain.sum(axis=1, keepdims=True)
        return barycentrics[:, :2].transpose(0, 2, 1)

    def select(self, mask: np.ndarray) -> Leaves:
        """Return the leaves chosen by a mask or an index array, in their order by kind."""
        chosen, graphs = np.arange(len(self))[mask], len(self.graph)
        others = graphs + len(self.closed_form)
        closed = chosen[(chosen >= graphs) & (chosen < others)]
        return Leaves(
            self.graph.select(chosen[chosen < graphs]),
            self.closed_form.select(closed - graphs),
            self.revolution.select(chosen[chosen >= others] - others),
        )

    def of_patches(self, numbers: np.ndarray) -> Leaves:
        """Return the same leaves, of the patches `numbers` instead of 0, 1, ..."""
        return Leaves(
            replace(self.graph, patch=numbers[self.graph.patch]),
            replace(self.closed_form, patch=numbers[self.closed_form.patch]),
            replace(self.revolution, patch=numbers[self.revolution.patch]),
        )

    @staticmethod
    def join(parts: list[Leaves]) -> Leaves:
        """Concatenate the leaves of sets of patches; no group is in two sets."""
        return Leaves(
            GraphLeaves.join([p.graph for p in parts]),
            ClosedFormLeaves.join([p.closed_form for p in parts]),
            RevolutionLeaves.join([p.revolution for p in parts]),
        )


def _pad(net: np.ndarray, count: int) -> np.ndarray:
    """Return monomial nets ``(L, K, 4)`` with `count` rows; ``u^a v^b`` stays ``u^a v^b``."""
    if net.shape[1] == count:
        return net
    degree = bernstein.degree_of(count)
    powers = bernstein.multi_indices(bernstein.degree_of(net.shape[1]))[:, :2]
    out = np.zeros((len(net), count, 4))
    out[:, [bernstein.row(degree, a, b) for a, b in powers.tolist()]] = net
    return out
