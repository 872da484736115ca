"""What a ray reads: records of each kind and bytes, and how fast this machine gathers packets."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from common import Options, camera_rays, random_rays, time_in_turns, to_rays
from speed_report import Section, short
from speed_surfaces import BEZIER, bezier

from mitsuba_bezier.kernels import traverse
from mitsuba_bezier.kernels.arrays import gather_packets, types_of, upload
from mitsuba_bezier.kernels.structure import Structure

__all__ = ["count_reads", "measure", "sections"]

#: Buffers of `Structure` and the names of their records.
RECORDS = {
    "nodes": "nodes",
    "affine": "quadratics",
    "projective": "projective quadratics",
    "nets": "nets",
    "far_nets": "projective nets",
    "groups": "quadrics",
    "members": "their patches",
    "inverses": "their inverses",
    "polynomials": "their polynomials",
    "domain": "domains",
}
#: Most places in the kernels that gather from one buffer.
PLACES = 8


@contextmanager
def _counted(structure: Structure, width: int) -> Iterator[dict[str, Any]]:
    """Count the gathers from each buffer while the kernels are recorded.

    Yields the counters of each buffer, one number a ray, and the bytes of a record in `sizes`.
    Each place in the kernels has a counter of its own: Dr.Jit does not let two loops share one.
    """
    lane = dr.opaque(types_of(mi.Float).UInt, 0, width) + dr.arange(types_of(mi.Float).UInt, width)
    dr.eval(lane)
    buffers = {name: [getattr(structure, name)] for name in RECORDS}
    buffers["nodes"] = [structure.nodes.records]
    for name in ("nets", "far_nets"):
        # not the rows of nets of high degree, which none of our surfaces has
        buffers[name] = [bucket.records for bucket in getattr(structure, name)]
    names = {x.index: name for name, every in buffers.items() for x in every if x is not None}
    counters: dict[str, Any] = {
        n: [dr.zeros(types_of(mi.Float).UInt, width) for _ in range(PLACES)] for n in RECORDS
    }
    unused = {n: list(every) for n, every in counters.items()}
    dr.eval(counters)
    sizes: dict[str, int] = {}

    def gather(
        buffer: Any, index: Any, count: int, active: Any = True, stride: int | None = None
    ) -> list[Any]:
        name = names.get(buffer.index)
        if name is not None:
            # eight numbers each: float64, or float32 where pairs of those take its place
            sizes[name] = -(-count // 8) * 8 * dr.itemsize_v(buffer)
            dr.scatter_inc(unused[name].pop(), lane, active)
        return gather_packets(buffer, index, count, active, stride)

    modules = [
        module
        for name, module in sys.modules.items()
        if name.startswith("mitsuba_bezier.kernels.") and hasattr(module, "gather_packets")
    ]
    for module in modules:
        module.gather_packets = gather
    try:
        yield {"counters": counters, "sizes": sizes}
    finally:
        for module in modules:
            module.gather_packets = gather_packets


def count_reads(structure: Structure, o: np.ndarray, d: np.ndarray) -> dict[str, dict[str, float]]:
    """Return records and bytes a ray reads, on average, of each buffer."""
    ty = types_of(mi.Float)
    columns = [[ty.Float(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in (o, d)]
    with _counted(structure, len(o)) as counted:
        hit = traverse.intersect(structure, *columns, ty.Float(dr.inf))
        dr.eval(*hit, counted["counters"])
    out = {}
    for name, size in counted["sizes"].items():
        number = sum(float(np.array(c).mean()) for c in counted["counters"][name])
        out[name] = {"records": number, "bytes": number * size}
    return out


def packet_rate(options: Options, size: int, alike: bool) -> float:
    """Return packets of eight floats a second that are gathered one after the other.

    Each address depends on the packet before, as in a tree.

    Parameters
    ----------
    size : int
        Bytes of the buffer, a power of two.
    alike : bool
        Whether all rays read the same packets, as coherent ones nearly do.
    """
    ty = types_of(mi.Float)
    count, steps, lanes = size // 32, 32, max(1024, int(options.million * 2.5e5))
    rng = np.random.default_rng(0)
    values = rng.random((count, 8), dtype=np.float32)
    values[:, 7] = rng.integers(0, count, count, dtype=np.uint32).view(np.float32)
    buffer = upload(ty.Float, values)
    start = dr.zeros(ty.UInt, lanes) if alike else dr.arange(ty.UInt, lanes) * 2654435769
    start = start & (count - 1)
    dr.make_opaque(start)

    def body(step: Any, index: Any, total: Any) -> tuple:
        packet = gather_packets(buffer, index, 8)
        for value in packet[:7]:
            total = total + value
        # the last is a number below `count`; the step keeps the walk out of short cycles
        index = (dr.reinterpret_array(ty.UInt, packet[7]) + step * 97) & (count - 1)
        return step + 1, index, total

    def task() -> Any:
        state = (dr.zeros(ty.UInt, lanes), ty.UInt(start), dr.zeros(ty.Float, lanes))
        return dr.while_loop(state, lambda step, *_: step < steps, body)[2]

    return lanes * steps / time_in_turns({"": task}, options.runs)[""].best


def measure(options: Options) -> dict[str, Any]:
    """Count reads on all surfaces, and measure gathers from buffers of three sizes."""
    side = min(512, options.side_of_rays)
    reads = []
    for name in BEZIER:
        surface = bezier(name)
        structure = surface.structure
        for kind, pair in (("coherent", camera_rays(side)), ("random", random_rays(side * side))):
            ray = to_rays(*pair)
            timing = time_in_turns(
                {"": lambda s=surface, r=ray: s.ray_intersect_preliminary(r).t}, options.runs
            )[""]
            reads.append(
                {
                    "surface": name,
                    "rays": kind,
                    "leaves": structure.leaf_count,
                    "bytes": structure.bytes,
                    "rays_per_second": len(pair[0]) / timing.best,
                    "reads": count_reads(structure, *pair),
                }
            )
    rates = [
        {"bytes": size, "alike": alike, "packets_per_second": packet_rate(options, size, alike)}
        for size in (2**15, 2**20, 2**26)
        for alike in (True, False)
    ]
    return {"reads": reads, "rates": rates}


def sections(data: dict[str, Any]) -> list[Section]:
    """Return the tables for people."""
    used = [n for n in RECORDS if any(n in r["reads"] for r in data["reads"])]
    rows = []
    for r in data["reads"]:
        reads = r["reads"]
        total = sum(v["bytes"] for v in reads.values())
        packets = sum(v["bytes"] / 32 for v in reads.values())
        rows.append(
            [
                r["surface"],
                r["rays"],
                str(r["leaves"]),
                *(short(reads[n]["records"]) if n in reads else "" for n in used),
                short(total),
                short(packets * r["rays_per_second"] / 1e6),
            ]
        )
    return [
        Section(
            "Records read a ray",
            ["surface", "rays", "leaves", *(RECORDS[n] for n in used), "bytes", "packets, M/s"],
            rows,
            text_columns=2,
        ),
        Section(
            "Dependent gathers of 32-byte packets on this machine, millions a second",
            ["buffer", "all rays alike", "each its own"],
            [
                [
                    f"{row['bytes'] // 1024} KiB",
                    short(row["packets_per_second"] / 1e6),
                    short(other["packets_per_second"] / 1e6),
                ]
                for row, other in zip(data["rates"][::2], data["rates"][1::2])
            ],
        ),
    ]
