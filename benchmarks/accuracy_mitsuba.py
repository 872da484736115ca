"""The rows of the accuracy suite that need Mitsuba: its own sphere, and spawned rays."""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import numpy as np
from accuracy_rows import of_revolution, scaled
from accuracy_tools import GENERAL, Line, Tracer, at_random, describe, toward, unit

import mitsuba_bezier as mb
from mitsuba_bezier.oracles import analytic

__all__ = ["leaving", "spheres"]

Rng = np.random.Generator
VARIANT = "llvm_ad_rgb"


def _rays(o: np.ndarray, d: np.ndarray):
    columns = [mi.Float(np.ascontiguousarray(a[:, k])) for a in (o, d) for k in range(3)]
    return mi.Ray3f(mi.Point3f(*columns[:3]), mi.Vector3f(*columns[3:]))


def _coherent(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays of a camera at distance 3.5, one through each pixel's centre."""
    side = int(np.sqrt(count))
    x = ((np.arange(side) + 0.5) / side - 0.5) * 0.75
    x, y = np.meshgrid(x, x)
    target = np.stack([x.ravel(), y.ravel(), np.full(side * side, 2.5)], axis=1)
    return toward(np.array([0, 0, 3.5]), target)


#: Covers, and how they are cut into leaves.
COVERS = (
    ("tetrahedral", None),
    ("octants", None),
    ("lunes", None),
    ("tetrahedral", GENERAL),
    ("octants", GENERAL),
    ("of revolution", None),
)


def spheres(rng: Rng, scale: float, covers: tuple = ()) -> Iterator[Line]:
    """Both covers of the sphere, coherent and random rays, beside Mitsuba's own sphere."""
    mi.set_variant(VARIANT)
    native = mi.load_dict({"type": "scene", "sphere": {"type": "sphere"}})
    for cover, settings in covers or COVERS:
        patches = of_revolution("sphere") if cover == "of revolution" else mb.sphere(cover=cover)
        tracer = Tracer(patches, settings)
        for kind, full in (("coherent", 4_000_000), ("random", 2_000_000)):
            count = scaled(full, scale)
            o, d = _coherent(count) if kind == "coherent" else at_random(rng, count)
            truth = analytic.sphere((0, 0, 0), 1, o, d)
            t = truth.first()
            hit = np.isfinite(t)
            got = tracer(o, d)
            clear = np.abs(truth.clearance) > 2e-6
            theirs = np.array(native.ray_intersect_preliminary(_rays(o, d), coherent=False).t)
            with np.errstate(invalid="ignore"):
                error, native_error = np.abs(got.t - t), np.abs(theirs.astype(float) - t)
            both = clear & hit & got.valid
            wrong = clear & (got.valid != hit)
            compared = both & np.isfinite(theirs)
            mean, native_mean = (float(e[compared].mean()) for e in (error, native_error))
            largest = float(error[both].max(initial=0.0))
            bad = wrong | (both & (error > 2e-5))
            yield Line(
                f"{cover}{', general' if settings else ''}, {kind}",
                int(clear.sum()),
                "0 wrong, max |dt| 2e-5, mean <= 2 x native",
                f"{int(wrong.sum())} wrong, max |dt| {largest:.1e}, "
                f"mean {mean:.1e} = {mean / native_mean:.2f} x",
                not bad.any() and mean <= 2 * native_mean,
                {
                    "wrong": int(wrong.sum()),
                    "max |dt|": largest,
                    "mean": mean,
                    "native mean": native_mean,
                    "native max": float(native_error[compared].max()),
                },
                describe(o, d, bad, got.valid, got.t, t, truth.clearance),
            )


#: Offsets and sizes of the spheres that rays leave.
PLACES = ((0.0, 1.0), (1e3, 1.0), (0.0, 1e-3), (1e4, 1e3), (0.0, 1e3))


def _around(rng: Rng, normals: np.ndarray) -> np.ndarray:
    """Return directions on the side of the normals, a third of them grazing."""
    d = unit(rng.normal(size=normals.shape))
    height = np.einsum("ni,ni->n", d, normals)
    d -= 2 * np.minimum(height, 0)[:, None] * normals
    height = np.abs(height)
    # cosines of 1e-5 to 1: grazing rays are those that meet a surface again, but of cosines below
    # 3e-7 float32 does not know the sign
    wanted = np.where(np.arange(len(d)) % 3 == 0, 10 ** rng.uniform(-5, 0, len(d)), height)
    across = unit(d - height[:, None] * normals)
    return wanted[:, None] * normals + np.sqrt(1 - wanted**2)[:, None] * across


def leaving(rng: Rng, scale: float, places: tuple = PLACES) -> Iterator[Line]:
    """Rays spawned from hits: none outwards may hit again, all inwards hit the other side."""
    mi.set_variant(VARIANT)
    count = scaled(2**16, scale)
    for cover in ("tetrahedral", "octants"):
        net = mb.sphere(cover=cover).control_points.astype(np.float32)
        for offset, size in places:
            center = offset * np.array([1.0, -1.0, 1.0])
            shape = mi.load_dict(
                {
                    "type": "beziertriangle",
                    "control_points": mi.TensorXf(net.ravel(), shape=net.shape),
                    "to_world": mi.ScalarTransform4f().translate(center.tolist()).scale(size),
                }
            )
            scene = mi.load_dict({"type": "scene", "shape": shape})
            o, d = at_random(rng, count, ball=0.95)
            o, d = toward(o * size + center, o * size + center + d)
            si = mb.ray_intersect(scene, _rays(o, d))
            found = np.array(si.is_valid())
            normals = np.array(si.n).T.astype(float)
            outwards = _around(rng, normals).astype(np.float32)
            inwards = -_around(rng, normals).astype(np.float32)
            columns = [mi.Float(np.ascontiguousarray(outwards[:, k])) for k in range(3)]
            ray = si.spawn_ray(mi.Vector3f(*columns))
            again = np.array(mb.ray_test(scene, ray)) & found
            failures = describe(np.array(ray.o).T, outwards, again)
            columns = [mi.Float(np.ascontiguousarray(inwards[:, k])) for k in range(3)]
            ray = si.spawn_ray(mi.Vector3f(*columns))
            start = np.array(ray.o).T
            other = mb.ray_intersect(scene, ray)
            t = np.array(other.t).astype(float)
            truth = analytic.sphere(center, size, start, inwards)
            expected = truth.first()
            cosine = np.abs(np.einsum("nki,ni->nk", truth.normals, inwards)[:, 1])
            # the spawned origin must be inside; the error of t is that of a position over the
            # cosine, a position being good to a few roundings of the sphere, and t to its own
            inside = np.linalg.norm(start - center, axis=1) < size * (1 - 1e-6)
            with np.errstate(invalid="ignore"):
                off = np.abs(t - expected) > 2e-6 * size / np.maximum(cosine, 1e-3)
            astray = found & inside & (off | ~np.isfinite(t))
            failures += describe(start, inwards, astray, t, expected, cosine)
            lost = int((~found).sum())
            bad = int(again.sum()), int(astray.sum())
            yield Line(
                f"{cover}, offset {offset:g}, size {size:g}",
                count,
                "0 re-hits, 0 astray inwards",
                f"{bad[0]} re-hits, {bad[1]} astray" + (f", {lost} lost" if lost else ""),
                not any(bad) and not lost,
                {"re-hits": bad[0], "astray": bad[1], "lost": lost, "inside": float(inside.mean())},
                failures,
            )
            dr.sync_thread()
