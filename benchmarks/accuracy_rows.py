"""The rows of the accuracy suite, but for those that need Mitsuba: see `accuracy_mitsuba`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from accuracy_tools import (
    GENERAL,
    PRECISION,
    Line,
    Tracer,
    against_reference,
    against_truth,
    at_random,
    describe,
    toward,
    unit,
)

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein, shapes
from mitsuba_bezier.geometry.covers import quadric_cover, ruled_cover
from mitsuba_bezier.geometry.plane_shapes import quarter_plane
from mitsuba_bezier.geometry.quadrics import quadric_patch
from mitsuba_bezier.geometry.tensor import revolved, tensor_to_triangles
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.geometry.triangulations import triangulated
from mitsuba_bezier.oracles import analytic
from mitsuba_bezier.oracles.reference import first_hit

__all__ = [
    "collineations",
    "factors",
    "infinity",
    "leaks",
    "models",
    "odd",
    "of_revolution",
    "proportions",
    "random_triangles",
    "sectors",
]

Rng = np.random.Generator
SPHERE = np.diag([1.0, 1.0, 1.0, -1.0])
RULED = np.diag([1.0, 1.0, -1.0, -1.0])
#: ``x^2 + y^2 = z``
BOWL = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]])


def scaled(full: int, scale: float) -> int:
    """Return the number of rays of a row at a scale."""
    return max(64, round(full * scale))


# ------------------------------------------------------------------ closed covers


def _icosahedron() -> BezierTriangles:
    g = (1 + np.sqrt(5)) / 2
    signs = [(s, t * g) for s in (1, -1) for t in (1, -1)]
    points = unit(np.array([p for s, t in signs for p in ((0, s, t), (s, t, 0), (t, 0, s))]))
    near = points @ points.T > 0.4
    faces = [
        (i, j, k) if np.linalg.det(points[[i, j, k]]) > 0 else (i, k, j)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[i, k] and near[j, k]
    ]
    return triangulated(points, faces)


def _in_ball(rng: Rng, count: int) -> np.ndarray:
    # 0.99: the covers hold the unit sphere up to rounding only
    return 0.99 * unit(rng.normal(size=(count, 3))) * np.cbrt(rng.random((count, 1)))


def _in_torus(rng: Rng, count: int) -> np.ndarray:
    a, b = rng.random((2, count)) * 2 * np.pi
    r = 0.99 * 0.25 * np.sqrt(rng.random(count))
    out = 1 + r * np.cos(b)
    return np.stack([out * np.cos(a), out * np.sin(a), r * np.sin(b)], axis=1)


def _in_cone(rng: Rng, count: int) -> np.ndarray:
    z = rng.uniform(0.01, 0.99, count)
    a, r = rng.random(count) * 2 * np.pi, 0.99 * (1 - z) * np.sqrt(rng.random(count))
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)


def _in_cylinder(rng: Rng, count: int) -> np.ndarray:
    z = rng.uniform(0.01, 0.99, count)
    a, r = rng.random(count) * 2 * np.pi, 0.99 * np.sqrt(rng.random(count))
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)


#: Profiles of a sphere, a capped cylinder and a capped cone, oriented outwards.
H = np.sqrt(0.5)
_PROFILES = {
    "sphere": [[(0, -1, 1), (H, -H, H), (1, 0, 1)], [(1, 0, 1), (H, H, H), (0, 1, 1)]],
    "cylinder": [[(0, 0, 1), (1, 0, 1)], [(1, 0, 1), (1, 1, 1)], [(1, 1, 1), (0, 1, 1)]],
    "cone": [[(0, 0, 1), (1, 0, 1)], [(1, 0, 1), (0, 1, 1)]],
}


#: A ball that is some roundings of float32 from round, 6e-7 of its size.
_FAR_CENTRE, _FAR_RADIUS = np.array([0.9, -0.3, 0.7]), 0.1


def of_revolution(name: str) -> BezierTriangles:
    """Return a closed surface as CAD systems write it, cut along diagonals; edges collapse."""
    return BezierTriangles.join([tensor_to_triangles(revolved(p)) for p in _PROFILES[name]])


def _covers():
    return (
        ("tetrahedral", mb.sphere(cover="tetrahedral"), None, _in_ball),
        ("octants", mb.sphere(cover="octants"), None, _in_ball),
        ("lunes", mb.sphere(cover="lunes"), None, _in_ball),
        ("icosahedron", mb.sphere(cover=_icosahedron()), None, _in_ball),
        ("tetrahedral, general", mb.sphere(cover="tetrahedral"), GENERAL, _in_ball),
        ("lunes, general", mb.sphere(cover="lunes"), GENERAL, _in_ball),
        ("torus", shapes.torus(), None, _in_torus),
        ("capped cone", shapes.cone(capped=True), None, _in_cone),
        ("capped cone, general", shapes.cone(capped=True), GENERAL, _in_cone),
        ("capped cylinder", shapes.cylinder(capped=True), None, _in_cylinder),
        ("capped cylinder, general", shapes.cylinder(capped=True), GENERAL, _in_cylinder),
        ("sphere of revolution", of_revolution("sphere"), None, _in_ball),
        ("cylinder of revolution", of_revolution("cylinder"), None, _in_cylinder),
        ("cone of revolution", of_revolution("cone"), None, _in_cone),
        ("tetrahedral, small and far, float32", _far("tetrahedral"), None, _in_far_ball),
        ("octants, small and far, float32", _far("octants"), None, _in_far_ball),
    )


def _far(cover: str) -> BezierTriangles:
    """Return a ball whose patches differ by rounding: some share a quadric, some are general."""
    matrix = np.diag([_FAR_RADIUS] * 3 + [1.0])
    matrix[:3, 3] = _FAR_CENTRE
    nets = mb.sphere(cover=cover).transform(matrix).control_points
    return BezierTriangles(nets.astype(np.float32).astype(np.float64))


def _in_far_ball(rng: Rng, count: int) -> np.ndarray:
    return _FAR_CENTRE + _FAR_RADIUS * _in_ball(rng, count)


def leaks(rng: Rng, scale: float, only: tuple[str, ...] = ()) -> Iterator[Line]:
    """Closed covers from inside, at shared edges and at corners, closest and any hit."""
    for name, patches, settings, inside in _covers():
        if only and name not in only:
            continue
        tracer = Tracer(patches, settings)
        count = scaled(2_000_000, scale)
        o = inside(rng, count)
        kind = np.arange(count) % 3
        which = rng.integers(0, len(patches), count)
        s = rng.random(count)
        s = np.where(kind == 2, np.round(s), s)  # 0: a corner
        edge = np.stack([s, 1 - s, np.zeros(count)], axis=1)
        turn = rng.integers(0, 3, count)
        edge = edge[np.arange(count)[:, None], (np.arange(3) + turn[:, None]) % 3]
        target = np.where(
            kind[:, None] == 0, o + rng.normal(size=o.shape), patches.points(which, edge[:, :2])
        )
        o, d = toward(o, target)
        out = {}
        for query, any_hit in (("closest", False), ("any", True)):
            out[query] = ~tracer(o, d, any_hit=any_hit).valid
        total = {q: int(x.sum()) for q, x in out.items()}
        where = ("random", "edges", "corners")
        bad = out["closest"] | out["any"]
        failures = describe(o, d, bad, np.array(where)[kind], which, s)
        yield Line(
            name,
            count,
            "0 escapes",
            f"{total['closest']} closest, {total['any']} any",
            not bad.any(),
            dict(total) | {w: int((bad & (kind == k)).sum()) for k, w in enumerate(where)},
            failures,
        )


# ------------------------------------------------------------------ thin bodies


#: Closed bodies, and a point well inside of each.
_BODIES = {
    "octants": (mb.sphere(), (0, 0, 0)),
    "tetrahedral": (mb.sphere(cover="tetrahedral"), (0, 0, 0)),
    "lunes": (mb.sphere(cover="lunes"), (0, 0, 0)),
    "paraboloid": (shapes.elliptic_paraboloid(capped=True), (0, 0, 0.5)),
    "one sheet": (shapes.hyperboloid_one_sheet(capped=True), (0, 0, 0)),
    "two sheets": (shapes.hyperboloid_two_sheets(capped=True), (0, 0, 1.6)),
    "cone": (shapes.cone(capped=True), (0, 0, 0.3)),
    "cylinder": (shapes.cylinder(capped=True), (0, 0, 0.5)),
}


def proportions(rng: Rng, scale: float) -> Iterator[Line]:
    """Closed bodies a hundred to a million times as long as they are thick, from inside.

    Those of even proportions have the same parameters along rays, and answer in float64.
    """
    for name, (body, middle) in _BODIES.items():
        for ratio in (1e2, 1e4, 1e6):
            count = scaled(100_000, scale)
            left, right = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
            matrix = np.eye(4)
            matrix[:3, :3] = left @ np.diag([ratio**0.5, 1.0, ratio**-0.5]) @ right
            tracer = Tracer(body.transform(matrix))
            at = rng.dirichlet([0.5, 0.5, 0.5], count)
            edges = np.arange(0, count, 3)
            at[edges, rng.integers(0, 3, len(edges))] = 0.0
            at /= at.sum(axis=1, keepdims=True)
            target = body.points(rng.integers(0, len(body), count), at[:, :2])
            target = np.where(np.isfinite(target), target, middle)
            start = middle + rng.uniform(-0.1, 0.1, size=(count, 3))
            o, d = toward(start @ matrix[:3, :3].T, target @ matrix[:3, :3].T)
            d[1::3] = unit(rng.normal(size=d[1::3].shape))
            back = np.linalg.inv(matrix[:3, :3]).T
            o_there, d_there = o @ back, d.astype(float) @ back
            # rounding of origins is little where the body is thin
            keep = np.flatnonzero(np.abs(o_there - middle).max(axis=1) < 0.15)
            got = tracer(o[keep], d[keep])
            escaped = ~got.valid | ~tracer(o[keep], d[keep], any_hit=True).valid
            some = keep[: max(100, len(keep) // 50)]
            length = np.linalg.norm(d_there[some], axis=1)
            truth = first_hit(body, o_there[some], d_there[some] / length[:, None])
            with np.errstate(invalid="ignore"):
                off = np.abs(got.t[: len(some)] * length / truth.t - 1)
            worst = float(off[np.isfinite(off) & truth.margin.decidable(PRECISION)].max(initial=0))
            yield Line(
                f"{name}, {ratio:.0e} : 1, turned",
                len(keep),
                "0 escapes, relative error 1e-06",
                f"{int(escaped.sum())} escapes, relative {worst:.1e}",
                not escaped.any() and worst <= 1e-6,
                {"escapes": int(escaped.sum()), "relative error": worst},
                describe(o[keep], d[keep], escaped),
            )


# ------------------------------------------------------------------ factors of nets


def factors(rng: Rng, scale: float) -> Iterator[Line]:
    """Nets times 1e-300 to 1e300, of either sign, another for each patch: as those without."""
    count = scaled(300_000, scale)
    for name, patches in (
        ("octants", mb.sphere()),
        ("tetrahedral", mb.sphere(cover="tetrahedral")),
        ("torus", shapes.torus()),
    ):
        sign = rng.choice([-1.0, 1.0], len(patches))
        by = (sign * 10 ** rng.uniform(-300, 300, len(patches)))[:, None, None]
        one, other = (Tracer(BezierTriangles(patches.control_points * f)) for f in (1.0, by))
        o, d = at_random(rng, count, ball=3.0)
        a, b = one(o, d), other(o, d)
        with np.errstate(invalid="ignore"):  # of misses
            moved = np.abs(a.t - b.t) > 2e-5 * np.maximum(a.t, 1)
        # where a ray grazes, a rounding decides: those in a million that change, and no more
        changed = (a.valid != b.valid) | (a.valid & b.valid & moved)
        allowed = count // 100_000
        yield Line(
            f"{name}, factors 1e-300 to 1e300",
            count,
            f"at most {allowed} changed (rays that graze)",
            f"{int(changed.sum())} changed",
            int(changed.sum()) <= allowed,
            {"changed": int(changed.sum())},
            describe(o, d, changed),
        )


# ------------------------------------------------------------------ plane sectors


def _sector(turn: float, angle: float, weight: float = 1.0, apex: float = 0.0) -> np.ndarray:
    """Return the net of a sector of the unit circle, its apex moved back along its middle."""
    half = angle / 2
    ends = [np.array([np.cos(turn + x), np.sin(turn + x), 0, 1]) for x in (-half, half)]
    arc = weight * np.array([np.cos(turn), np.sin(turn), 0, np.cos(half)])
    a = np.array([-apex * np.cos(turn), -apex * np.sin(turn), 0, 1])
    return np.array([ends[0], arc, (ends[0] + a) / 2, ends[1], (ends[1] + a) / 2, a])


def sectors(rng: Rng, scale: float) -> Iterator[Line]:
    """Plane sectors, also many in one plane and one set."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    grid = []
    for k in range(16):
        move = np.eye(4)
        move[:2, 3] = 600 * (k % 4), 340 * (k // 4)
        grid.append(_sector(k, 1.5) @ move.T)
    sets = {
        "fan of 20 sectors": [_sector(0.3 * k, 0.29) for k in range(20)],
        "16 sectors, 300 sizes apart": grid,
        "weight 0.01": [_sector(0.2, 1.5, 0.01)],
        "weight 100": [_sector(0.2, 1.5, 100.0)],
        "apex 100 sizes away": [_sector(0.5, 1.0, 1.0, 100.0)],
    }
    for name, nets in sets.items():
        patches = BezierTriangles(np.array(nets)).transform(matrix)
        count = scaled(100_000, scale)
        which = rng.integers(0, len(patches), count)
        at = rng.dirichlet([1.0, 1.0, 1.0], count) * 1.3 - 0.1
        x, y, z, w = np.moveaxis(patches.evaluate(which, at[:, :2]), -1, 0)
        target = np.stack([x, y, z], axis=1) / w[:, None]
        size = np.ptp(patches[which[:1]].hulls().reshape(-1, 3), axis=0).max()
        tracer = Tracer(patches)
        o, d = toward(target + size * unit(rng.normal(size=target.shape)), target)
        yield against_reference(name, tracer, o, d)


# ------------------------------------------------------------------ random triangles


def _wavy(rng: Rng, n: int, signs: bool = False) -> np.ndarray:
    """Return a net over an equilateral triangle, moved by a third of its size."""
    corners = np.array([[1.0, 0, 0], [-0.5, 0.87, 0], [-0.5, -0.87, 0]])
    p = bernstein.multi_indices(n) / n @ corners
    p = p + rng.normal(scale=0.3, size=p.shape)
    w = np.exp(rng.uniform(np.log(0.3), np.log(3), len(p)))
    if signs:
        w = w * rng.choice([1, -1], len(p), p=[0.8, 0.2])
    return np.concatenate([p * w[:, None], w[:, None]], axis=1)


def _at_patches(rng: Rng, patches: BezierTriangles, count: int, noise: float = 0.15):
    uv = rng.dirichlet(np.ones(3), count)[:, :2]
    target = patches.points(rng.integers(0, len(patches), count), uv)
    target = target + rng.normal(scale=noise, size=target.shape)
    return toward(4 * unit(rng.normal(size=(count, 3))), target)


def random_triangles(
    rng: Rng, scale: float, degrees: tuple[int, ...] = (2, 3, 4, 5, 6, 7, 8)
) -> Iterator[Line]:
    """Random rational triangles of degree 2 to 8, weights 0.3 to 3, against the reference."""
    count = scaled(100_000, scale)
    # the build of a leaf structure, not the rays, bounds how many nets a small run can take
    nets = 2 if scale < 0.03 else 8
    for n in degrees:
        parts = []
        for _ in range(nets if n < 7 else max(nets // 4, 1)):
            patches = BezierTriangles([_wavy(rng, n)])
            share = count // (nets if n < 7 else max(nets // 4, 1))
            o, d = _at_patches(rng, patches, share)
            parts.append(against_reference("", Tracer(patches), o, d))
        yield _merged(f"degree {n}, {len(parts)} nets", parts)


def _merged(what: str, parts: list[Line]) -> Line:
    """Return one line for several of the same requirement."""
    rays = sum(p.rays for p in parts)
    values = {
        key: (max if "max" in key or key in ("reach", "relative error") else sum)(
            p.values[key] for p in parts
        )
        for key in parts[0].values
    }
    for share in ("decidable", "judged", "firm"):
        if share in values:
            values[share] /= len(parts)
    wrong = int(values["wrong"] + values["wrong root"])
    measured = f"{wrong} wrong, max |dt| {values['max |dt|']:.1e}"
    if "relative error" in values:
        measured = (
            f"{wrong} wrong, relative {values['relative error']:.1e} to t {values['reach']:.0e}"
        )
    return Line(
        what,
        rays,
        parts[0].required,
        measured,
        all(p.passed for p in parts),
        values,
        [f"case {k}: {f}" for k, p in enumerate(parts) for f in p.failures][:5],
    )


# ------------------------------------------------------------------ infinity and sign


def _reaching(rng: Rng, near: np.ndarray, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rays to the points `far` of a surface: from nearby, from as far away, from between.

    `near` are origins of size one.
    """
    size = np.linalg.norm(far, axis=1, keepdims=True)
    kind = (np.arange(len(far)) % 3)[:, None]
    beside = far + 0.5 * size * unit(rng.normal(size=far.shape))
    aloof = near * np.maximum(size, 1.0)
    return toward(np.where(kind == 0, near, np.where(kind == 1, beside, aloof)), far)


def _log_uniform(rng: Rng, low: float, high: float, count: int) -> np.ndarray:
    return np.exp(rng.uniform(np.log(low), np.log(high), count))


def _quarter_plane(rng: Rng, count: int, settings, name: str) -> Line:
    patches = quarter_plane((0.1, -0.2, 0.3), (1, 0.2, 0), (0, 1, 0.3))
    a, b = _log_uniform(rng, 1e-2, 1e6, count), _log_uniform(rng, 1e-2, 1e6, count)
    corner, u, v = np.array([0.1, -0.2, 0.3]), np.array([1, 0.2, 0]), np.array([0, 1, 0.3])
    far = corner + a[:, None] * u + b[:, None] * v
    far[::7] -= 2 * (b[:, None] * v)[::7]  # misses, too
    o, d = _reaching(rng, 3 * rng.normal(size=(count, 3)), far)
    n = unit(np.cross(u, v))
    hits = analytic.plane(corner, n, o, d)
    t = hits.first()
    with np.errstate(invalid="ignore"):
        x = o.astype(float) + np.where(np.isfinite(t), t, 0.0)[:, None] * d - corner
    ab = x @ np.linalg.pinv(np.stack([u, v]))
    inside = np.isfinite(t) & (ab >= 0).all(axis=1)
    # a band along the edges, as wide as 1e-4 of the coordinates
    size = 1 + np.abs(ab).sum(axis=1) + np.linalg.norm(o, axis=1)
    # nearly parallel rays may meet the horizon on either side
    cosine = np.abs(d.astype(float) @ n)
    band = 1e-4
    with np.errstate(invalid="ignore"):
        judged = (~np.isfinite(t) | (np.abs(ab).min(axis=1) > band * size)) & ~(t > 1e6)
    judged &= cosine > 1e-6
    judged &= np.abs((o - corner) @ n) > 1e-6 * size
    return against_truth(
        name, Tracer(patches, settings), o, d, np.where(inside, t, np.inf), cosine, judged, 1e-4
    )


def _quadric(rng: Rng, count: int, matrix, patches, far, settings, name: str) -> Line:
    """Judge a whole quadric by the analytic answer, up to ``t = 1e6``."""
    o, d = _reaching(rng, 2 * rng.normal(size=(count, 3)), far)
    hits = analytic.quadric(matrix, o, d)
    t, cosine, judged = _first(hits, o, d)
    return against_truth(name, Tracer(patches, settings), o, d, t, cosine, judged, 1e-4)


def _first(hits: analytic.AnalyticHits, o: np.ndarray, d: np.ndarray):
    """Return first `t`, cosine, and which rays are off the silhouettes and horizons."""
    t = hits.first()
    index = np.argmin(np.where(hits.t >= 0, hits.t, np.inf), axis=1)
    rows = np.arange(len(t))
    direction = unit(d.astype(float))
    cosine = np.einsum("ni,ni->n", hits.normals[rows, index], direction)
    hit = np.isfinite(t)
    size = np.linalg.norm(o.astype(float), axis=1)
    size = size + np.where(np.isfinite(hits.t), np.abs(hits.t), 0.0).max(axis=1)
    # 1e-5 of the size off the silhouette
    judged = (np.abs(hits.clearance) > 1e-5 * (1 + size)) & ~(hit & (t > 1e6))
    judged &= ~(np.abs(hits.t) < 1e-5 * (1 + size)[:, None]).any(axis=1)
    # the other root beyond 1e6, or at infinity, may be on either side of it
    judged &= np.isfinite(hits.t).all(axis=1) | ~np.isfinite(hits.t).any(axis=1)
    judged &= ~(np.abs(np.where(np.isfinite(hits.t), hits.t, 0.0)) > 1e6).any(axis=1)
    return t, cosine, judged


def infinity(
    rng: Rng, scale: float, paths: tuple[str, ...] = ("closed", "general", "signs")
) -> Iterator[Line]:
    """Quarter plane, paraboloid, hyperboloids with ideal corners, weights of both signs."""
    count = scaled(1_000_000, scale)
    turn = rng.random(count) * 2 * np.pi
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    r = _log_uniform(rng, 1e-3, 1e3, count)
    bowl = np.concatenate([r[:, None] * ring, (r * r)[:, None]], axis=1)
    z = _log_uniform(rng, 1e-2, 1e6, count) * rng.choice([-1, 1], count)
    one = np.concatenate([np.sqrt(1 + z * z)[:, None] * ring, z[:, None]], axis=1)
    two = np.concatenate(
        [np.abs(z)[:, None] * ring, (np.sign(z) * np.sqrt(1 + z * z))[:, None]], axis=1
    )
    one_sheet, two_sheets = np.diag([1.0, 1, -1, -1]), np.diag([1.0, 1, -1, 1])
    for choice, path, settings in (("closed", "", None), ("general", ", general", GENERAL)):
        if choice not in paths:
            continue
        yield _quarter_plane(rng, count, settings, "quarter plane" + path)
        for name, matrix, patches, far in (
            ("paraboloid", BOWL, quadric_cover(BOWL), bowl),
            ("hyperboloid of one sheet", one_sheet, ruled_cover(one_sheet), one),
            ("hyperboloid of two sheets", two_sheets, quadric_cover(two_sheets), two),
        ):
            yield _quadric(rng, count, matrix, patches, far, settings, name + path)
    if "general" in paths:
        yield _quadric(
            rng, count, BOWL, quadric_cover(BOWL, "octants"), bowl, None, "paraboloid, octants"
        )
    for n in (2, 3, 4) if "signs" in paths else ():
        parts = []
        for _ in range(4):
            patches = BezierTriangles([_wavy(rng, n, signs=True)])
            o, d = _to_the_horizon(rng, patches, count // 12)
            parts.append(against_reference("", Tracer(patches), o, d, 1e-4))
        yield _merged(f"weights of both signs, degree {n}, 4 nets", parts)


def _to_the_horizon(rng: Rng, patches: BezierTriangles, count: int):
    """Return rays to points at all distances up to 1e6 of patches with weights of both signs."""
    a, b = (rng.dirichlet(np.ones(3), 4 * count)[:, :2] for _ in range(2))
    which = rng.integers(0, len(patches), 4 * count)
    wa, wb = (patches.evaluate(which, p)[:, 3] for p in (a, b))
    across = wa * wb < 0
    lo, hi = np.where(wa[:, None] > 0, a, b), np.where(wa[:, None] > 0, b, a)
    start = lo.copy()
    for _ in range(60):
        middle = (lo + hi) / 2
        up = (patches.evaluate(which, middle)[:, 3] > 0)[:, None]
        lo, hi = np.where(up, middle, lo), np.where(up, hi, middle)
    side = rng.choice([-1, 1], 4 * count)[:, None]
    uv = lo + side * (start - lo) * _log_uniform(rng, 1e-6, 1, 4 * count)[:, None]
    uv = np.where(across[:, None], uv, a)
    inside = (uv.min(axis=1) >= 0) & (uv.sum(axis=1) <= 1)
    far = patches.points(which, uv)
    far = far[inside & (np.linalg.norm(far, axis=1) < 1e6)][:count]
    return _reaching(rng, 2 * rng.normal(size=far.shape), far)


# ------------------------------------------------------------------ quadrics anywhere


def collineations(rng: Rng, scale: float) -> Iterator[Line]:
    """Random collineations of sphere and ruled quadric, a random patch on each."""
    count = scaled(400_000, scale) // 2
    for name, matrix in (("sphere", SPHERE), ("ruled quadric", RULED)):
        for path, settings in (("", None), (", general", GENERAL)):
            parts = [_one_patch(rng, count, matrix, settings) for _ in range(12)]
            yield _merged(f"12 images of the {name}{path}", parts)


def _on_quadric(rng: Rng, matrix: np.ndarray, count: int) -> np.ndarray:
    """Return homogeneous points of the sphere or of ``x^2 + y^2 = z^2 + w^2``."""
    if matrix is SPHERE:
        return np.concatenate([unit(rng.normal(size=(count, 3))), np.ones((count, 1))], axis=1)
    a, b = rng.random((2, count)) * 2 * np.pi
    return np.stack([np.cos(a), np.sin(a), np.sin(b), np.cos(b)], axis=1)


def _one_patch(rng: Rng, count: int, matrix: np.ndarray, settings) -> Line:
    while True:
        m = np.eye(4) + 0.35 * rng.normal(size=(4, 4))
        center, *points = _on_quadric(rng, matrix, 4)
        corners = np.array([*points, center])
        # neither a collineation nor a patch that is nearly flat or drawn out
        if np.linalg.cond(m) < 8 and np.linalg.cond(corners) < 12:
            break
    patches = BezierTriangles([quadric_patch(matrix, center, np.array(points))]).transform(m)
    inverse = np.linalg.inv(m)
    image = inverse.T @ matrix @ inverse
    uv = rng.dirichlet(np.ones(3), count)[:, :2]
    target = patches.points(np.zeros(count, dtype=int), uv)
    target = np.where(np.linalg.norm(target, axis=1, keepdims=True) < 30, target, 0.0)
    target += (
        0.2 * (1 + np.linalg.norm(target, axis=1, keepdims=True)) * rng.normal(size=target.shape)
    )
    o, d = toward(4 * unit(rng.normal(size=(count, 3))), target)
    hits = analytic.quadric(image, o, d)
    size = 4 + np.where(np.isfinite(hits.t), np.abs(hits.t), 0.0)
    at = (
        o[:, None].astype(float)
        + np.where(np.isfinite(hits.t), hits.t, 0.0)[..., None] * d[:, None]
    )
    ends = np.concatenate([at, np.ones((*at.shape[:2], 1))], axis=2) @ inverse.T
    # the projection from the centre inverts the patch: b(u) = 2 l(u) sum u_j P_j - Q(u) S
    coordinates = (ends @ np.linalg.inv(corners))[..., :3]
    bary = coordinates / coordinates.sum(axis=2, keepdims=True)
    edge = bary.min(axis=2)
    inside = np.isfinite(hits.t) & (edge >= 0) & (hits.t > 0)
    t = np.where(inside, hits.t, np.inf).min(axis=1)
    index = np.argmin(np.where(inside, hits.t, np.inf), axis=1)
    rows = np.arange(count)
    unit_d = unit(d.astype(float))
    cosines = np.abs(np.einsum("nki,ni->nk", hits.normals, unit_d))
    # bands: 1e-4 of the edges, in parameters, at any root before the hit; grazing
    before = np.isfinite(hits.t) & (hits.t > -1e-3) & (hits.t <= t[:, None] + 1e-3)
    # parameters move by rounding / cosine
    band = 1e-4 + 1e-6 / np.maximum(cosines, 1e-6)
    doubtful = before & (np.abs(edge) < band)
    judged = ~doubtful.any(axis=1) & (np.abs(hits.clearance) > 1e-5 * size.max(axis=1))
    judged &= ~(np.isfinite(t) & (t > 1e3))
    judged &= (np.abs(coordinates.sum(axis=2)) > 1e-4 * np.abs(coordinates).sum(axis=2)).all(axis=1)
    return against_truth("", Tracer(patches, settings), o, d, t, cosines[rows, index], judged)


# ------------------------------------------------------------------ models


def _bicubic(rng: Rng) -> np.ndarray:
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 4), np.linspace(-1, 1, 4), indexing="ij"), -1)
    net = np.ones((4, 4, 4))
    net[..., :2], net[..., 2] = grid, 0.4 * rng.normal(size=(4, 4))
    return net


def models(rng: Rng, scale: float) -> Iterator[Line]:
    """Teapot as sextics (or a bicubic patch without it), torus, cone to its apex."""
    count = scaled(1_000_000, scale)
    path = Path(__file__).parents[1] / "scenes" / "models" / "teapot.vtu"
    # the reference takes half a millisecond a ray of a sextic
    if path.exists():
        patches = mb.load(path)
        points = patches.points(np.arange(len(patches)), np.full((len(patches), 2), 1 / 3))
        middle, size = points.mean(axis=0), np.abs(points - points.mean(axis=0)).max()
        o, d = at_random(rng, count // 4)
        o, d = (o * size + middle).astype(np.float32), d
        yield against_reference("teapot", Tracer(patches), o, d)
    else:
        patches = tensor_to_triangles(_bicubic(rng)[None])
        o, d = at_random(rng, count // 4)
        yield against_reference("bicubic patch as two sextics", Tracer(patches), o, d)
    patches = shapes.torus()
    o, d = at_random(rng, count, 3.0, 1.3)
    hits = analytic.torus((0, 0, 0), (0, 0, 1), 1.0, 0.25, o, d)
    t = hits.first()
    index = np.argmin(np.where(hits.t >= 0, hits.t, np.inf), axis=1)
    cosine = np.einsum("ni,ni->n", hits.normals[np.arange(count), index], unit(d.astype(float)))
    judged = np.abs(hits.clearance) > 2e-6
    yield against_truth("torus", Tracer(patches), o, d, t, cosine, judged)
    yield _cone(rng, count // 2, shapes.cone(), None, "cone")
    yield _cone(rng, count // 2, shapes.cone(), GENERAL, "cone, general")
    # its last eight patches, without the foot
    revolution = of_revolution("cone")[np.arange(8, 16)]
    yield _cone(rng, count // 2, revolution, None, "cone of revolution")


def _cone(rng: Rng, count: int, patches: BezierTriangles, settings, name: str) -> Line:
    """Rays to points at all distances down to 1e-6 from the apex."""
    depth, turn = _log_uniform(rng, 1e-6, 1, count), rng.random(count) * 2 * np.pi
    target = np.stack([depth * np.cos(turn), depth * np.sin(turn), 1 - depth], axis=1)
    target = target + 0.3 * depth[:, None] * rng.normal(size=target.shape)
    o, d = toward([0, 0, 0.5] + 2.5 * unit(rng.normal(size=(count, 3))), target)
    hits = analytic.cone((0, 0, 1), (0, 0, 1), 1.0, o, d)
    finite = np.isfinite(hits.t)
    at = np.where(finite, hits.t, 0.0)
    z = o[:, 2:].astype(float) + at * d[:, 2:]
    inside = finite & (z >= 0) & (z <= 1) & (hits.t > 0)
    t = np.where(inside, hits.t, np.inf).min(axis=1)
    index = np.argmin(np.where(inside, hits.t, np.inf), axis=1)
    cosine = np.einsum("ni,ni->n", hits.normals[np.arange(count), index], unit(d.astype(float)))
    o64, d64 = o.astype(float), unit(d.astype(float))
    foot = o64 - [0, 0, 1]
    foot = foot - np.einsum("ni,ni->n", foot, d64)[:, None] * d64
    apart = np.linalg.norm(foot, axis=1)
    # float32 places the apex to 3e-6 (`docs/intersection.md`); so it does silhouettes near it
    judged = (apart > 1e-5) & (np.abs(hits.clearance) > 4e-6)
    # the two nappes meet at the apex, the base is an edge
    judged &= ~(finite & ((np.abs(z) < 1e-4) | (np.abs(z - 1) < 3e-6))).any(axis=1)
    return against_truth(name, Tracer(patches, settings), o, d, t, cosine, judged)


# ------------------------------------------------------------------ odd rays


class _Check:
    """Counts of rays that do not do what they must."""

    def __init__(self, tracer: Tracer) -> None:
        self.tracer = tracer
        self.total = self.wrong = 0
        self.failures: list[str] = []

    def count(self, label: str, o, d, wrong, *columns) -> None:
        self.total += len(o)
        self.wrong += int(wrong.sum())
        self.failures += [f"{label}: {f}" for f in describe(o, d, wrong, *columns)]

    def must(self, o, d, expected, t_max=np.inf, t=None, label="") -> None:
        """Demand hits or misses, and the parameters `t` of hits."""
        got = self.tracer(o, d, t_max)
        wrong = got.valid != expected
        if t is not None:
            # 2e-5: the error the table allows
            with np.errstate(invalid="ignore"):
                wrong |= got.valid & ~(np.abs(got.t - t) < 2e-5 * np.maximum(t, 1))
        self.count(label, o, d, wrong, got.valid, got.t)


def odd(rng: Rng, scale: float) -> Iterator[Line]:
    """NaN, infinity, no direction, no length, axis-aligned, zero components, finite maxt."""
    count = scaled(100_000, scale)
    for name, patches, settings in (
        ("tetrahedral", mb.sphere(cover="tetrahedral"), None),
        ("octants", mb.sphere(), None),
        ("tetrahedral, general", mb.sphere(cover="tetrahedral"), GENERAL),
    ):
        check = _Check(Tracer(patches, settings))
        tracer, must = check.tracer, check.must
        o, d = at_random(rng, count, ball=0.9)
        where = rng.integers(0, 3, count), np.arange(count)

        for value in (np.nan, np.inf, -np.inf):
            for k, label in enumerate(("origin", "direction")):
                pair = [o.copy(), d.copy()]
                pair[k][where[1], where[0]] = value
                must(*pair, False, label=f"{value} in {label}")
        must(o, 0 * d, False, label="zero direction")
        for t_max in (0.0, -1.0, np.nan):
            must(o, d, False, t_max, label=f"maxt {t_max}")
        truth = analytic.sphere((0, 0, 0), 1, o, d)
        t = truth.first()
        steep = truth.clearance < -1e-2
        must(o[steep], d[steep], False, (t[steep] * 0.9999), label="maxt before the hit")
        must(o[steep], d[steep], True, (t[steep] * 1.0001), t[steep], "maxt behind the hit")
        for factor in (1e-6, 1e6):
            scaled_d = (d * np.float32(factor)).astype(np.float32)
            again = analytic.sphere((0, 0, 0), 1, o, scaled_d).first()
            got = tracer(o, scaled_d)
            wrong = steep & ~(np.abs(got.t - again) * factor < 2e-5)
            check.count(f"length {factor}", o, scaled_d, wrong, got.t, again)
        # along an axis, through points on and off the symmetry planes (shared edges)
        axis = rng.integers(0, 3, count)
        sign = rng.choice(np.float32([-1, 1]), count)
        d = np.zeros((count, 3), np.float32)
        d[where[1], axis] = sign
        d = np.where(d == 0, np.copysign(d, rng.choice(np.float32([-1, 1]), d.shape)), d)
        o = rng.uniform(-0.55, 0.55, (count, 3)).astype(np.float32)
        o[rng.random((count, 3)) < 0.3] = 0.0
        o[::2][where[1][: len(o[::2])], axis[::2]] = -3 * sign[::2]
        must(o, d, True, t=analytic.sphere((0, 0, 0), 1, o, d).first(), label="axis")
        # one component zero, origins inside and outside
        o, d = at_random(rng, count, ball=0.5)
        d[where[1], where[0]] = 0.0
        truth = analytic.sphere((0, 0, 0), 1, o, d)
        clear = np.abs(truth.clearance) > 1e-4
        o, d, t = o[clear], d[clear], truth.first()[clear]
        must(o, d, np.isfinite(t), t=np.where(np.isfinite(t), t, 0), label="zero component")
        measured = f"{check.wrong} wrong"
        values = {"wrong": check.wrong}
        passed = not check.wrong
        yield Line(
            name, check.total, "0 wrong, no hang", measured, passed, values, check.failures[:5]
        )
