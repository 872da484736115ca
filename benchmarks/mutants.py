"""Faults that tests must find: the package with one line changed, time and again.

    python benchmarks/mutants.py              all of them (a few minutes)
    python benchmarks/mutants.py NAME ...     some
    python benchmarks/mutants.py --list

Each mutant is a copy of the package with one piece of code exchanged, against which the tests run
that are named with it. It dies if one of them fails. Before, these tests are run with no change,
and must pass. The exit code is 1 if a mutant survives, and 2 if its piece of code is not there,
just once: then the code has changed, and the mutant has to be written anew.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Mutant:
    """One change.

    Parameters
    ----------
    name : str
    file : str
        The module, from the package's folder.
    old, new : str
        The piece of code, and what takes its place. White space does not count in `old`.
    tests : tuple of str
        Names of tests, ``file.py::name``.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def apply(self, package: Path) -> None:
        path = package / self.file
        text = path.read_text(encoding="utf-8")
        pattern = r"\s+".join(map(re.escape, self.old.split()))
        count = len(re.findall(pattern, text))
        if count != 1:
            raise LookupError(
                f"{self.name}: expected {self.old!r} once in {self.file}, found it {count} times: "
                "the code has changed, write the mutant anew"
            )
        path.write_text(re.sub(pattern, lambda _: self.new, text), encoding="utf-8")


MUTANTS = (
    Mutant(
        "no bending",
        "kernels/graph/march.py",
        "sure = dr.select(signed > 0.0, dr.maximum(signed - slack, 0.0), signed)",
        "sure = signed",
        ("kernels/test_march.py::test_no_root_is_passed_wherever_the_march_begins",),
    ),
    Mutant(
        "slabs as they are",
        "kernels/walk.py",
        "_ROUNDING = 4.0 * 6e-8",
        "_ROUNDING = 0.0",
        ("kernels/test_kernel_nodes.py::test_rays_from_afar_at_edges_of_the_box_of_all",),
    ),
    Mutant(
        "no variation",
        "kernels/graph/march.py",
        "self.wobble = 0.5 * net.variation * lateral2",
        "self.wobble = 0.0 * net.variation * lateral2",
        ("kernels/test_march.py::test_rays_along_ruled_lines",),
    ),
    Mutant(
        "no tilt",
        "kernels/graph/march.py",
        "self.tilt = 2.0 * self.bending * dr.sqrt(lateral2)",
        "self.tilt = 0.0 * self.bending * dr.sqrt(lateral2)",
        ("kernels/test_march.py::test_no_root_is_passed_wherever_the_march_begins",),
    ),
    Mutant(
        "the side of the surface stays",
        "kernels/graph/march.py",
        "replace(place, tau=tau, u=u, v=v, sign=-place.sign)",
        "replace(place, tau=tau, u=u, v=v, sign=place.sign)",
        ("kernels/test_march.py::test_rays_along_ruled_lines",),
    ),
    Mutant(
        "one root a leaf",
        "kernels/graph/march.py",
        "run = run & root.found & (~accept | self.there.turns) & (back > 0.0)",
        "run = run & root.found & (~accept | self.there.turns) & (back < 0.0)",
        ("plugins/test_trimmed_shapes.py::test_trimmed_hits_are_skipped",),
    ),
    Mutant(
        "prisms are not enlarged",
        "kernels/graph/chart.py",
        "cut = (-outward[k] - f0) * inverse",
        "cut = -f0 * inverse",
        ("kernels/test_march.py::test_no_leaf_is_culled_that_is_met",),
    ),
    Mutant(
        "prisms end at the quadratic",
        "kernels/graph/chart.py",
        "total, 0.26), remainder)",
        "total, 0.26), 0.0 * remainder)",
        ("kernels/test_march.py::test_what_is_within_the_remainder_is_not_culled",),
    ),
    Mutant(
        "the surface is the quadratic",
        "kernels/graph/chart.py",
        "gap = dr.abs(value) - remainder",
        "gap = dr.abs(value) - 0.0 * remainder",
        ("kernels/test_march.py::test_a_leaf_whose_edge_bends_inwards",),
    ),
    Mutant(
        "sure near the surface",
        "kernels/graph/chart.py",
        "certain = certain & (dr.abs(first) > remainder) & (dr.abs(last) > remainder)",
        "certain = certain & (dr.abs(first) > 0.0) & (dr.abs(last) > 0.0)",
        ("kernels/test_certain_hits.py",),
    ),
    Mutant(
        "sure beyond the leaf",
        "kernels/graph/chart.py",
        "cut = (inward[k] - f0) * inverse",
        "cut = (-inward[k] - f0) * inverse",
        ("kernels/test_certain_hits.py",),
    ),
    Mutant(
        "grazing hits stay rough",
        "kernels/graph/grazing.py",
        "_GRAZING = 0.1",
        "_GRAZING = 0.0",
        ("kernels/test_march.py::test_grazing_hits",),
    ),
    Mutant(
        "faces are rounded to the nearest",
        "kernels/nodes.py",
        "low = np.floor(steps[:, :, 0] - _SLACK)",
        "low = np.rint(steps[:, :, 0] - _SLACK)",
        ("kernels/test_kernel_nodes.py::test_no_box_is_missed",),
    ),
    Mutant(
        "instances are entered in the middle",
        "kernels/instances.py",
        "start = dr.maximum(ahead - m.radius * inv_length, 0.0)",
        "start = dr.maximum(ahead, 0.0)",
        ("plugins/test_instances.py::test_instances_are_what_as_many_shapes_are",),
    ),
    Mutant(
        "trims count both ends",
        "kernels/trim.py",
        "level = (t >= t0) & (t < t1)",
        "level = (t >= t0) & (t <= t1)",
        ("geometry/test_trims.py",),
    ),
    Mutant(
        "no slack at trims",
        "kernels/trim.py",
        "beside = (s >= low - SLACK) & (s <= high + SLACK)",
        "beside = (s >= low + SLACK) & (s <= high - SLACK)",
        ("geometry/test_trims.py",),
    ),
    Mutant(
        "variation of samples only",
        "leaves/graph/bounds.py",
        "variation + c * k2, remainder",
        "variation, remainder",
        ("leaves/test_leaf_bounds.py::test_bounds_hold_and_are_not_loose",),
    ),
    Mutant(
        "bending of one direction",
        "leaves/graph/bounds.py",
        "bending = np.where(proved, (f[1] / mu) ** 2, 2.0) * some_variation / 2",
        "bending = np.where(proved, 0.5, 0.5) * some_variation / 2",
        ("leaves/test_leaf_bounds.py::test_tangent_planes_from_anywhere",),
    ),
    Mutant(
        "culling has no rounding",
        "leaves/graph/subdivision.py",
        '"remainder": bounds.remainder + bends * rounding',
        '"remainder": bounds.remainder + 0 * bends * rounding',
        ("leaves/test_leaf_bounds.py::test_what_culling_in_float32_may_be_off",),
    ),
    Mutant(
        "trees are cut too deep",
        "leaves/bvh.py",
        "left_count = np.clip(left_count, length - room, room)",
        "left_count = np.clip(left_count, 1, length - 1)",
        ("leaves/test_leaves_tree.py::test_trees_are_shallow",),
    ),
    Mutant(
        "instances forget their nearest hit",
        "kernels/instances.py",
        "[dot3(row, d) for row in m.rows], nearest.t - start)",
        "[dot3(row, d) for row in m.rows], nearest.t)",
        ("plugins/test_instances.py::test_instances_are_what_as_many_shapes_are",),
    ),
)


def _copy(folder: Path) -> Path:
    """Copy the package and the tests, link what they read; return the package."""
    for name in ("mitsuba_bezier", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.iterdir():
        if not path.name.startswith(".") and not (folder / path.name).exists():
            (folder / path.name).symlink_to(path)
    return folder / "mitsuba_bezier"


def _failed(folder: Path, tests: tuple[str, ...]) -> tuple[bool, str]:
    """Run tests; return whether one failed, and what pytest said last."""
    command = [sys.executable, "-B", "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
    process = subprocess.run(
        [*command, *(f"tests/{test}" for test in tests)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
    )
    last = (process.stdout.strip().splitlines() or [process.stderr[-300:]])[-1]
    if process.returncode not in (0, 1):
        raise RuntimeError(f"pytest {' '.join(tests)}: {process.stdout}{process.stderr}")
    return process.returncode == 1, last


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", metavar="NAME", nargs="*", help="mutants; all if none is named")
    parser.add_argument("--list", action="store_true", help="list them and stop")
    parser.add_argument("--no-baseline", action="store_true", help="do not run the tests unchanged")
    args = parser.parse_args()
    unknown = set(args.names) - {mutant.name for mutant in MUTANTS}
    if unknown:
        parser.error(f"NAME: expected names that --list shows, got {', '.join(sorted(unknown))}")
    chosen = [m for m in MUTANTS if m.name in args.names or not args.names]
    if args.list:
        for mutant in chosen:
            print(f"{mutant.name}: {mutant.file}: {mutant.old} -> {mutant.new}")
        return 0
    code, survived = 0, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        package = _copy(folder)
        if not args.no_baseline:
            tests = tuple(dict.fromkeys(test for mutant in chosen for test in mutant.tests))
            failed, last = _failed(folder, tests)
            print(f"unchanged: {last}", flush=True)
            if failed:
                print("the tests fail as it is: no mutant can be judged")
                return 2
        for mutant in chosen:
            path = package / mutant.file
            original = path.read_text(encoding="utf-8")
            begin = time.perf_counter()
            try:
                mutant.apply(package)
            except LookupError as error:
                print(error)
                code = 2
                continue
            failed, last = _failed(folder, mutant.tests)
            path.write_text(original, encoding="utf-8")
            verdict = "died" if failed else "SURVIVED"
            seconds = time.perf_counter() - begin
            print(f"{verdict:9s}{mutant.name} ({mutant.file}): {last}; {seconds:.0f} s", flush=True)
            if not failed:
                survived.append(mutant.name)
    print(f"{len(chosen)} mutants, {len(survived)} survived{': ' if survived else ''}", end="")
    print(", ".join(survived))
    return code or int(bool(survived))


if __name__ == "__main__":
    sys.exit(main())
