"""Measure how exact ray intersections are: ``python benchmarks/accuracy.py``.

Every row of the table traces seeded random rays through the kernels, as a render would, in
float32, and compares with an analytic answer or with the float64 reference. ``--scale 1`` takes
some 60 million rays; the default takes a hundredth of them. The exit code is 1 if a
requirement is not met.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

import mitsuba_bezier  # before anything imports Dr.Jit

sys.path.insert(0, str(Path(__file__).parent))  # for a caller that is not in this folder

import accuracy_aspheres
import accuracy_mitsuba
import accuracy_points
import accuracy_rows
import numpy as np

#: Names of the rows, in the order of the table.
ROWS = {
    "spheres": accuracy_mitsuba.spheres,
    "collineations": accuracy_rows.collineations,
    "leaks": accuracy_rows.leaks,
    "proportions": accuracy_rows.proportions,
    "factors": accuracy_rows.factors,
    "sectors": accuracy_rows.sectors,
    "random": accuracy_rows.random_triangles,
    "models": accuracy_rows.models,
    "aspheres": accuracy_aspheres.aspheres,
    "infinity": accuracy_rows.infinity,
    "leaving": accuracy_mitsuba.leaving,
    "points": accuracy_points.points,
    "odd": accuracy_rows.odd,
}


def main(arguments: list[str] | None = None) -> int:
    """Run the rows asked for and print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("rows", nargs="*", help=f"rows to run (default: all): {', '.join(ROWS)}")
    parser.add_argument("--scale", type=float, default=0.01, help="share of the rays (0.01)")
    parser.add_argument("--seed", type=int, default=1, help="of the random generator (1)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    parser.add_argument(
        "--float64",
        choices=("auto", "always", "never"),
        default="auto",
        help="whether kernels use it, or pairs of float32 (auto)",
    )
    options = parser.parse_args(arguments)
    mitsuba_bezier.set_float64(options.float64)
    unknown = [name for name in options.rows if name not in ROWS]
    if unknown:
        parser.error(f"rows: expected some of {', '.join(ROWS)}, got {', '.join(unknown)}")
    if not 0 < options.scale <= 100:
        parser.error(f"--scale: expected a number above 0 and up to 100, got {options.scale}")

    console = Console(stderr=options.json)
    table = Table(title=f"Accuracy, scale {options.scale:g}, seed {options.seed}")
    for title in ("row", "case", "rays", "required", "measured"):
        table.add_column(title, justify="right" if title == "rays" else "left")
    table.add_column("", justify="center")
    results = []
    for name in options.rows or ROWS:
        # a generator of its own, so that a row gives the same rays whatever else is run
        rng = np.random.default_rng([options.seed, *name.encode()])
        begin = time.perf_counter()
        with console.status(name):
            for line in ROWS[name](rng, options.scale):
                seconds = time.perf_counter() - begin
                begin = time.perf_counter()
                results.append({"row": name, "seconds": round(seconds, 2), **asdict(line)})
                verdict = "[green]ok[/]" if line.passed else "[red]no[/]"
                table.add_row(
                    name, line.what, f"{line.rays:,}", line.required, line.measured, verdict
                )
    failed = [r for r in results if not r["passed"]]
    if options.json:
        report = {
            "version": mitsuba_bezier.__version__,
            "scale": options.scale,
            "seed": options.seed,
            "lines": results,
        }
        print(json.dumps(report, indent=1, default=float))
    else:
        console.print(table)
        for r in failed:
            console.print(f"{r['row']}, {r['what']}:", *r["failures"], sep="\n  ", highlight=False)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
