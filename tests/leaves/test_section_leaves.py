"""Leaves between plane sections of an ellipsoid, and the tables of which member a ray meets."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from drjit import llvm
from geometry_cases import rotation
from leaf_cases import otherwise

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.kernels import quadric_records, records, structure
from mitsuba_bezier.kernels.closed_form import members
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.closed_form.plane_sections import edge_planes, shared_map
from mitsuba_bezier.leaves.records import LeafKind, Leaves


def turned(patches: mb.BezierTriangles, scale=(1.0, 2.0, 0.5)) -> mb.BezierTriangles:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(np.random.default_rng(2), 3) * scale
    return patches.transform(matrix)


OCTANTS = {
    "degree 4": (mb.sphere(cover="octants"), 2),
    "elevated": (mb.sphere(cover="octants").elevate(2), 2),
    "degree 8": (otherwise(mb.sphere(cover="octants")), 4),
}
#: Not all congruent, so that each leaf has polynomials of its own.
BOTH = mb.BezierTriangles(
    np.concatenate(
        [
            mb.sphere(cover="octants").elevate(4).control_points,
            OCTANTS["degree 8"][0].control_points[::3] * [0.5, 0.5, 0.5, 1],
        ]
    )
)


def rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from a sphere of radius 4 to the inside of the turned ellipsoid's box."""
    a, b = np.random.default_rng(seed).normal(size=(2, count, 3))
    a *= 4 / np.linalg.norm(a, axis=1, keepdims=True)
    return a.astype(np.float32), (0.5 * b - a).astype(np.float32)


def hits(leaves: Leaves, o: np.ndarray, d: np.ndarray):
    built = structure.build_structure(leaves, llvm.Float)
    columns = [[llvm.Float(np.ascontiguousarray(x[:, k])) for k in range(3)] for x in (o, d)]
    hit = intersect(built, *columns, llvm.Float(dr.inf))
    return np.array(hit.valid), np.array(hit.t), np.array(hit.patch), np.array([hit.u, hit.v]).T


@pytest.mark.parametrize("kind", OCTANTS)
def test_fractions_give_the_stereographic_coordinates(kind):
    patches, degree = OCTANTS[kind]
    patches = turned(patches)
    leaves = build_leaves(patches)
    assert leaves.kinds == {LeafKind.PLANE_SECTIONS} and len(leaves) == 8
    leaves = leaves.closed_form
    powers = bernstein.multi_indices(patches.degree)[:, :2]
    assert powers[leaves.polynomials.any(axis=(0, 2))].sum(axis=1).max() == degree
    uv = np.random.default_rng(3).dirichlet(np.ones(3), 50)[:, :2]
    terms = np.prod((uv[:, None] - 1 / 3) ** powers, axis=2)
    for leaf, patch in enumerate(leaves.patch):
        p, q = ((terms @ leaves.polynomials[leaf]).reshape(-1, 2, 2) @ [1, 1j]).T
        x = patches.points(np.full(50, patch), uv) - leaves.shift[leaf]
        value = x @ leaves.rows[leaf, :3, :3].T + leaves.rows[leaf, :3, 3]
        value /= value.sum(axis=1, keepdims=True)
        # all clips of the kernel leave these coordinates alone
        assert (value[:, :2] > 0.04).all() and (value[:, :2] < 0.96).all()
        # float64, and the null vector of a system whose condition is about 1e3
        assert np.abs(p / q - (value[:, 0] + 1j * value[:, 1] - 0.5 - 0.5j)).max() < 1e-11


@pytest.mark.parametrize("kind", OCTANTS)
def test_planes_are_those_of_the_edges(kind):
    patches = turned(OCTANTS[kind][0])
    leaves = build_leaves(patches).closed_form
    planes = edge_planes(leaves)
    s = np.linspace(0.0, 1.0, 9)
    edges = [np.stack(x, axis=1) for x in ((0 * s, s), (s, 0 * s), (s, 1 - s))]
    corners = np.array([(1.0, 0.0), (0.0, 1.0), (0.0, 0.0)])
    for leaf, patch in enumerate(leaves.patch):
        for plane, edge, corner in zip(planes[leaf], edges, corners):
            x = patches.points(np.full(10, patch), np.vstack([edge, corner])) - leaves.shift[leaf]
            # float64 through the fit of a quadric and the null vector of a system
            assert np.abs(x @ plane[:3] + plane[3] - ([0.0] * 9 + [1.0])).max() < 1e-10


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
@pytest.mark.parametrize("kind", OCTANTS)
def test_congruent_patches_share_a_map(kind, single):
    patches = turned(OCTANTS[kind][0])
    if single:  # as nets come through Mitsuba's tensors
        patches = mb.BezierTriangles(patches.control_points.astype(np.float32).astype(float))
    leaves = build_leaves(patches).closed_form
    shared = shared_map(leaves, edge_planes(leaves))
    assert shared is not None
    matrix, net = shared
    # from a point's three sides to its parameters' powers
    uv = np.random.default_rng(3).dirichlet(np.ones(3), 50)[:, :2]
    powers = bernstein.multi_indices(patches.degree)[:, :2]
    terms = np.prod((uv[:, None] - 1 / 3) ** powers, axis=2)
    p, q = ((terms @ net).reshape(-1, 2, 2) @ [1, 1j]).T
    for leaf, patch in enumerate(leaves.patch):
        x = patches.points(np.full(50, patch), uv) - leaves.shift[leaf]
        sides = np.pad(x, ((0, 0), (0, 1)), constant_values=1.0) @ edge_planes(leaves)[leaf].T
        value = np.pad(sides, ((0, 0), (0, 1)), constant_values=1.0) @ matrix.T
        value /= value.sum(axis=1, keepdims=True)
        off = np.abs(value[:, 0] + 1j * value[:, 1] - 0.5 - 0.5j - p / q).max()
        # what is shared may be off by 1e-6 in parameters, which are as long; or nothing
        assert off < (1e-6 if single else 1e-11)


def test_others_do_not():
    leaves = build_leaves(BOTH)
    assert shared_map(leaves.closed_form, edge_planes(leaves.closed_form)) is None
    built = structure.build_structure(leaves, llvm.Float)
    assert built.has(LeafKind.PLANE_SECTIONS) and built.shared_section is None
    octants = build_leaves(mb.sphere(cover="octants"))
    assert structure.build_structure(octants, llvm.Float).shared_section is not None
    others = [mb.sphere(cover="octants"), mb.sphere(cover="lunes").elevate(2)]
    mixed = mb.BezierTriangles(np.concatenate([x.control_points for x in others]))
    assert structure.build_structure(build_leaves(mixed), llvm.Float).shared_section is None


@pytest.mark.parametrize("kind", [*OCTANTS, "both"])
def test_parameters_belong_to_the_hit(kind):
    patches = turned(BOTH if kind == "both" else OCTANTS[kind][0])
    o, d = rays(50_000, 4)
    valid, _t, patch, uv = hits(build_leaves(patches), o, d)
    assert valid.sum() > 10_000
    at = patches.differential(patch[valid], uv[valid].astype(np.float64))
    o, d = o[valid].astype(np.float64), d[valid].astype(np.float64)
    off = np.linalg.norm(np.cross(at.p - o, d), axis=1) / np.linalg.norm(d, axis=1)
    # parameters are float32 numbers (2^-25, some ten roundings)
    slope = np.linalg.norm(at.dp_du, axis=1) + np.linalg.norm(at.dp_dv, axis=1)
    assert (off < 10 * 2.0**-25 * slope).all()


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
@pytest.mark.parametrize("part", [slice(None), slice(0, 8, 3), slice(0, 2)])
def test_tables_change_the_order_only(cover, part, monkeypatch):
    patches = turned(mb.sphere(cover=cover))
    # a second ellipsoid, so that tables have places
    nets = [patches.control_points[part], patches.control_points[:3] * [0.5, 0.5, 0.5, 1]]
    patches = mb.BezierTriangles(np.concatenate(nets))
    o, d = rays(50_000, 5)
    found = hits(build_leaves(patches), o, d)
    for module in (quadric_records, members):
        monkeypatch.setattr(module, "MIN_GROUP_FOR_TABLE", 13)
    plain = hits(build_leaves(patches), o, d)
    assert found[0].sum() > 1000 and (found[0] == plain[0]).all()
    assert (found[1] == plain[1]).all()
    # on a common edge it may be either patch
    assert (found[2] != plain[2]).sum() <= 2


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_tables_tell_most_members(cover, monkeypatch):
    patches = turned(mb.sphere(cover=cover))
    leaves = build_leaves(patches)
    built = structure.build_structure(leaves, llvm.Float)
    reads = dr.zeros(llvm.UInt32, 1)
    dr.eval(reads)
    plain = records.gather_packets

    def counted(buffer, index, count, active=True):
        if buffer.index == built.members.index:
            dr.scatter_add(reads, llvm.UInt32(1), llvm.UInt32(0), active)
        return plain(buffer, index, count, active)

    monkeypatch.setattr(records, "gather_packets", counted)
    o, d = rays(50_000, 6)
    columns = [[llvm.Float(np.ascontiguousarray(x[:, k])) for k in range(3)] for x in (o, d)]
    hit = intersect(built, *columns, llvm.Float(dr.inf))
    dr.eval(hit.valid, reads)
    # one after the other it would be 4.5; in cells that an edge crosses half are told wrong
    assert reads[0] < 2.6 * np.array(hit.valid).sum()


@pytest.mark.parametrize("order", ["one", "two", "mixed", "interleaved", "single"])
def test_patch_numbers(order):
    octants = turned(mb.sphere(cover="octants")).control_points
    quadratic = turned(mb.sphere(cover="tetrahedral"), (0.3, 0.3, 0.3)).elevate(2).control_points
    nets = {
        "one": octants,
        "two": np.concatenate([octants, octants * [0.5, 0.5, 0.5, 1]]),
        "mixed": np.concatenate([octants[:3], quadratic]),
        "interleaved": np.stack([octants, octants * [0.5, 0.5, 0.5, 1]], axis=1).reshape(16, 15, 4),
        "single": octants[2:3],
    }[order]
    patches = mb.BezierTriangles(nets)
    if order == "mixed":
        parts = [
            mb.BezierTriangles(octants[:3]),
            turned(mb.sphere(cover="tetrahedral"), (0.3,) * 3),
        ]
        leaves = [build_leaves(p) for p in parts]
        leaves[1] = leaves[1].of_patches(3 + np.arange(len(parts[1])))
        leaves = Leaves.join(leaves)
    else:
        leaves = build_leaves(patches)
    assert leaves.is_closed_form.all()
    o, d = rays(50_000, 7)
    valid, t, patch, uv = hits(leaves, o, d)
    assert valid.sum() > 500
    points = patches.points(patch[valid], uv[valid].astype(np.float64))
    hit = o[valid].astype(np.float64) + t[valid, None].astype(np.float64) * d[valid]
    # float32 numbers: t of up to 1 times lengths of 8, u and v
    assert np.abs(points - hit).max() < 3e-6
