"""Cut patches into leaves on which a ray meets the surface in a way that can be certified.

A *leaf* is a sub-triangle of a patch together with a chart, a collineation ``M`` of space in
which the leaf is nearly the unit triangle: the rows of ``M`` give homogeneous coordinates
``(x, y, z, W)`` of a point, the corners lie near ``(1,0,0,1), (0,1,0,1), (0,0,0,1)``, and the
surface is the graph ``z = h(x, y)`` of a function close to a quadratic one. There are two kinds:

*exact* leaves
    A whole patch whose inverse is linear: three rows take a point ``(p - shift, 1)`` of the
    patch to a multiple of its barycentrics, and the patch lies on a quadric, whose matrix we
    store. Every intersection has a closed form. All patches of `quadric_patch` and all planar
    triangles of degree one are of this kind. So are patches of higher degree on an ellipsoid
    whose edges are plane sections: then the rows give the stereographic coordinates of a point,
    and the net stores two complex polynomials, from which the parameters are found. So are
    sectors of cones, with four rows. And so are all other patches on quadrics and in
    planes, *inverted*: their parameters tell whether a point is on them. They may be cut.
*graph* leaves
    Everything else, subdivided until the bounds below are small. For them we store the
    quadratic ``a xy + b x(1-x-y) + c y(1-x-y)`` next to ``h`` and

    * ``remainder`` >= |h - quadratic|,
    * ``variation`` >= spectral norm of Hess(h) - Hess(quadratic),
    * ``bending``: so that ``bending d^2`` is at least the error, at distance d, of h's tangent
      plane with the quadratic's second derivative,
    * ``margin``: how far the leaf reaches out of the unit triangle in the chart,
    * ``outward`` and ``inward``, three of each: the leaf has only points whose barycentrics in the
      chart are at least ``-outward``, and covers all where they are at least ``inward``,

    proved (`graph.bounds`) over an enlarged triangle of parameters, one of the `SIZES`, whose image
    holds the unit triangle enlarged by the margin; and two more quadratics of the
    same form, which take ``(x, y)`` near to ``(u, v)``. The chart is affine where the weights
    of the leaf are of one sign and nearly equal, else projective (then W is not constant).
    ``docs/intersection.md`` says how the kernel uses them.

Everything is float64; what the kernel stores in float32 (``shift``, ``frame``) is rounded here
*before* the net is expressed in it, so that the rounding moves no surface point.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..geometry import bernstein

__all__ = [
    "BENDING_LIMIT",
    "DEVIATION",
    "FORM",
    "FORM_ENTRIES",
    "INVERTED",
    "INWARD",
    "LEAST",
    "LEAST_REACH",
    "MARGINS",
    "OUTWARD",
    "SECTION",
    "SIZES",
    "LeafSettings",
    "Leaves",
    "pack_bending",
    "round_reach",
    "unpack_bending",
    "weight_signs",
]


#: Numbers in `Leaves.form`.
FORM = 19

#: Place in the form of an exact leaf of a lower bound on ``|U_0 + U_1 + U_2|`` over the patch,
#: where the rows of the frame give ``U`` on ``(p - shift, 1)``. All four vanish at the centre of
#: projection, which is not on the patch unless this is zero.
LEAST = 10

#: Place of the largest distance of an exact leaf's patch from its quadric, in patch sizes.
DEVIATION = 11

#: Place of the mark of an exact leaf whose frame does not give barycentrics: 1 if it gives
#: stereographic coordinates, and barycentrics need a few steps of Newton's method, on the net
#: (`plane_sections`); `INVERTED` if such parameters tell whether a point is on the patch at all
#: (`inverted`); -1, -2 or -3 for a sector of a cone with its apex in this corner
#: (`sectors`).
SECTION = 12
INVERTED = 2.0

#: Places in the form of a graph leaf of its `outward` and `inward`.
OUTWARD = slice(13, 16)
INWARD = slice(16, 19)

#: ... and of an inverted leaf of how far its plane barycentrics go below zero (`inverted`).
MARGINS = slice(13, 16)

#: Order of the ten entries of a symmetric form in `Leaves.form`.
FORM_ENTRIES = (
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

#: The bending of graph leaves is below this, so that one number holds it and the size.
BENDING_LIMIT = 16.0


def pack_bending(bending: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return ``bending + BENDING_LIMIT * size``, rounded up to what float32 can hold.

    Parameters
    ----------
    bending : (L,) array
        At least 0, below `BENDING_LIMIT` where it matters.
    size : (L,) int array
        Index of `SIZES`.
    """
    # 2^-14: four bits for the size and four in front of the point leave it exact in 24
    steps = np.ceil(np.minimum(bending, BENDING_LIMIT - 2.0**-14) * 2.0**14)
    return steps / 2.0**14 + BENDING_LIMIT * size


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


def unpack_bending(packed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bending and size of what `pack_bending` gave."""
    size = np.floor(packed / BENDING_LIMIT)
    return packed - BENDING_LIMIT * size, size.astype(int)


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
        Whether patches with a linear inverse become exact leaves.
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


@dataclass
class Leaves:
    """Arrays of `L` leaves; see the module's docstring for the meaning."""

    patch: np.ndarray  #: (L,) patch number
    domain: np.ndarray  #: (L, 3, 3) leaf barycentrics to patch barycentrics, homogeneous
    exact: np.ndarray  #: (L,) bool
    shift: np.ndarray  #: (L, 3) origin of the frame, float32 numbers
    frame: np.ndarray  #: (L, 4, 4) rows x, y, z, W (exact: mostly u, v, w, 0) on (p - shift, 1)
    form: np.ndarray  #: (L, 19) a b c, bounds, six for (u, v), six for edges (exact: quadric)
    net: np.ndarray  #: (L, K, 4) monomial (x - u, y - v, z, W - 1) (exact: P, Q or 0)
    box: np.ndarray  #: (L, 2, 3) axis-aligned bounds, possibly infinite
    certified: np.ndarray  #: (L,) bool: the leaf is the surface, and its bounds hold
    group: np.ndarray  #: (L,) exact leaves with the same number share their quadric; else -1
    #: (L, 3, 3) for exact leaves, frame and form are on ``(axes (p - shift), 1)`` (`affine_frames`)
    axes: np.ndarray
    span: np.ndarray  #: (L, 2, 3) bounds of ``axes (p - shift)`` (exact leaves; else zero)

    def __len__(self) -> int:
        return len(self.patch)

    @property
    def are_sections(self) -> np.ndarray:
        """Which exact leaves take Newton's method for their parameters; see `SECTION`."""
        return self.exact & (self.form[:, SECTION] == 1)

    @property
    def are_inverted(self) -> np.ndarray:
        """Which exact leaves take Newton's method to tell whether a point is on them."""
        return self.exact & (self.form[:, SECTION] == INVERTED)

    @property
    def are_cones(self) -> np.ndarray:
        """Which exact leaves are sectors of cones."""
        return self.exact & (self.form[:, SECTION] < 0)

    @staticmethod
    def join(parts: list[Leaves]) -> Leaves:
        """Concatenate; nets are padded to the highest degree with zero monomials."""
        top = max(p.net.shape[1] for p in parts)
        out = {}
        first_group = 0
        for field in fields(Leaves):
            arrays = [getattr(p, field.name) for p in parts]
            if field.name == "group":
                for i, g in enumerate(arrays):
                    arrays[i] = np.where(g >= 0, g + first_group, -1)
                    first_group = max(first_group, int(arrays[i].max(initial=-1)) + 1)
            if field.name == "net":
                arrays = [_pad(a, top) for a in arrays]
            out[field.name] = np.concatenate(arrays)
        return Leaves(**out)

    def corners(self) -> np.ndarray:
        """Return the patch parameters ``(L, 3, 2)`` of the leaves' corners."""
        barycentrics = self.domain / self.domain.sum(axis=1, keepdims=True)
        return barycentrics[:, :2].transpose(0, 2, 1)

    def select(self, mask: np.ndarray) -> Leaves:
        """Return the leaves chosen by a mask or an index array."""
        return Leaves(**{f.name: getattr(self, f.name)[mask] for f in fields(Leaves)})

    @staticmethod
    def empty(count: int) -> Leaves:
        """Return no leaves, of nets with `count` control points."""
        return Leaves(
            patch=np.zeros(0, dtype=int),
            domain=np.zeros((0, 3, 3)),
            exact=np.zeros(0, dtype=bool),
            shift=np.zeros((0, 3)),
            frame=np.zeros((0, 4, 4)),
            form=np.zeros((0, FORM)),
            net=np.zeros((0, count, 4)),
            box=np.zeros((0, 2, 3)),
            certified=np.zeros(0, dtype=bool),
            group=np.zeros(0, dtype=int),
            axes=np.zeros((0, 3, 3)),
            span=np.zeros((0, 2, 3)),
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
