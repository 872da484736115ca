"""All tables of docs/performance.md, measured in one run and printed as ratios.

    python benchmarks/speed.py --large --json speed.json --update-docs

Everything is compared with Mitsuba's own sphere, or with meshes of the same surface, in one
process and in turns. `--tables` chooses some tables; `--from FILE` prints an earlier run. With
`--variant cuda_ad_rgb` the same tables come from a GPU.
"""

from __future__ import annotations

import argparse
import json
import time
from datetime import datetime, timezone
from importlib import import_module
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
from common import Options, machine, set_variant
from speed_report import markdown, print_sections, update_blocks

from mitsuba_bezier._files import write_file

#: Tables: module, function that measures, function that lays out.
TABLES = {
    "rays": ("speed_rays", "measure", "sections"),
    "batch": ("speed_batch", "measure", "sections"),
    "order": ("speed_rays", "measure_order", "order_sections"),
    "reads": ("speed_counts", "measure", "sections"),
    "compile": ("speed_compile", "measure", "sections"),
    "render": ("speed_render", "measure", "sections"),
    "scale": ("speed_scale", "measure", "sections"),
    "memory": ("speed_memory", "measure", "sections"),
}

PAGE = Path(__file__).parents[1] / "docs" / "performance.md"

#: A run that touches everything and measures nothing.
TINY = Options(
    million=0.004, runs=1, renders=1, side=16, spp=2, mesh_unit=1e3, large=True, patches=(1, 20)
)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--tables", default=",".join(TABLES), help=f"some of {','.join(TABLES)}")
    parser.add_argument("--million", type=float, default=4.0, help="rays of each kind, in millions")
    parser.add_argument("--runs", type=int, default=7, help="repetitions of ray queries")
    parser.add_argument("--renders", type=int, default=3, help="repetitions of renders")
    parser.add_argument("--large", action="store_true", help="meshes of 16 million triangles too")
    parser.add_argument("--tiny", action="store_true", help="a trial run: all rows, no meaning")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the numbers to a file")
    parser.add_argument("--from", dest="earlier", metavar="FILE", type=Path, help="do not measure")
    parser.add_argument("--markdown", action="store_true", help="print Markdown")
    parser.add_argument("--update-docs", action="store_true", help=f"rewrite the tables of {PAGE}")
    parser.add_argument("--page", type=Path, default=PAGE, help=argparse.SUPPRESS)
    out = parser.parse_args()
    out.tables = [name for name in out.tables.split(",") if name]
    unknown = [name for name in out.tables if name not in TABLES]
    if unknown:
        parser.error(f"--tables: expected some of {', '.join(TABLES)}, got {unknown[0]!r}")
    if out.earlier and out.json:
        parser.error("--json: expected a measurement to write, got --from too")
    return out


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Measure the tables asked for, and write them to the file of ``--json``."""
    mb.register()
    set_variant(args.variant)
    if args.tiny:
        options = Options(**{**TINY.__dict__, "variant": args.variant})
    else:
        options = Options(
            variant=args.variant,
            million=args.million,
            runs=args.runs,
            renders=args.renders,
            large=args.large,
        )
    about = {**machine(), "date": datetime.now(timezone.utc).strftime("%Y-%m-%d")}
    tables: dict[str, Any] = {}
    seconds: dict[str, float] = {}
    data = {"machine": about, "options": options.__dict__, "seconds": seconds, "tables": tables}
    for name in args.tables:
        module, function, _layout = TABLES[name]
        start = time.perf_counter()
        tables[name] = getattr(import_module(module), function)(options)
        seconds[name] = round(time.perf_counter() - start, 1)
        if args.json:  # after each table, so that nothing measured is lost
            write_file(args.json, (json.dumps(data, indent=1) + "\n").encode())
    return data


def describe(data: dict[str, Any]) -> str:
    """Return one line about where and how the numbers were taken."""
    about, options = data["machine"], data["options"]
    versions = ", ".join(
        f"{label} {about[key]}"
        for key, label in (
            ("mitsuba_bezier", "mitsuba_bezier"),
            ("mitsuba", "Mitsuba"),
            ("drjit", "Dr.Jit"),
            ("llvm", "LLVM"),
        )
        if about[key]
    )
    load = "" if about["load"] is None else f", load {about['load']:.1f} at the start"
    return (
        f"{about['date']}: {versions}, variant {about['variant']}; {about['processor']}, "
        f"{about['cores']} cores{load}; {options['million']:g} million rays, "
        f"{options['runs']} repetitions, renders of {options['side']} x {options['side']} with "
        f"{options['spp']} samples, {options['renders']} repetitions."
    )


def main() -> None:
    """Run the command."""
    args = arguments()
    if args.earlier:
        data = json.loads(args.earlier.read_text(encoding="utf-8"))
        data["tables"] = {n: t for n, t in data["tables"].items() if n in args.tables}
    else:
        data = measure(args)
    layouts = {
        name: getattr(import_module(TABLES[name][0]), TABLES[name][2])(table)
        for name, table in data["tables"].items()
    }
    for sections in layouts.values():
        if args.markdown:
            print(markdown(sections), end="\n\n")
        else:
            print_sections(sections)
    print(describe(data))
    if args.update_docs:
        blocks = {name: markdown(sections) for name, sections in layouts.items()}
        update_blocks(args.page, {**blocks, "machine": describe(data)})


if __name__ == "__main__":
    main()
