"""Derivatives in seventeen situations, forward and reverse, against central differences.

    python benchmarks/derivatives.py [--rows NAME,...] [--seeds 6] [--spp 1.0] [--json FILE]

Each is the derivative of one number, a weighted sum of all pixels, by one parameter along which
the scene changes. Forward mode, reverse mode and differences are estimated with several seeds
each; what is printed is their mean, and its standard error. Both sides of a difference have the
same random numbers. A row passes if both modes are within 3 standard errors of the difference, or
within 5 % of it, and if no standard error is above 5 %: else the row would say nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
from common import machine, set_variant
from derivative_rows import SITUATIONS, Situation
from rich.console import Console
from rich.table import Table

from mitsuba_bezier._files import write_file

__all__ = ["Estimate", "measure", "verdict"]

#: Standard errors, and the part of the difference, within which a derivative is right.
SIGMAS, PART = 3.0, 0.05


@dataclass(frozen=True)
class Estimate:
    """A mean, and its standard error."""

    mean: float
    error: float

    @staticmethod
    def of(values: list[float]) -> Estimate:
        """Return the estimate that several seeds make."""
        spread = float(np.std(values, ddof=1)) if len(values) > 1 else math.inf
        return Estimate(float(np.mean(values)), spread / math.sqrt(len(values)))

    def __str__(self) -> str:
        return f"{self.mean:+.3e} ± {self.error:.0e}"


def weights(shape: Any) -> np.ndarray:
    """Return weights of pixels: a loss that no symmetry hides an error from."""
    values = np.random.default_rng(0).uniform(0.2, 1.8, shape)
    return (values / values.size).astype(np.float32)


def measure(row: Situation, seeds: int, spp: float) -> dict[str, Estimate | str]:
    """Return forward, reverse and difference of a row; in place of an estimate, an error."""
    scene, move = row.make()
    integrator = mi.load_dict(row.integrator)
    primal = integrator if row.primal is None else mi.load_dict(row.primal)
    count = max(1, int(row.spp * spp))
    width, height = scene.sensors()[0].film().size()
    w = weights((height, width, 3))

    def attached() -> Any:
        e = mi.Float(0)
        dr.enable_grad(e)
        move(e)
        return e

    def render(seed: int) -> Any:
        return mi.render(
            scene,
            mi.traverse(scene),
            integrator=integrator,
            spp=1,
            spp_grad=count,
            seed=1000 + seed,
            seed_grad=seed,
        )

    def forward(seed: int) -> float:
        e = attached()
        image = render(seed)
        dr.forward(e)
        return float((np.array(dr.grad(image), dtype=np.float64) * w).sum())

    def reverse(seed: int) -> float:
        e = attached()
        dr.backward(dr.sum(render(seed) * mi.TensorXf(w), axis=None))
        return float(dr.grad(e)[0])

    def difference(seed: int) -> float:
        out = []
        for sign in (1, -1):
            move(mi.Float(sign * row.step))
            image = mi.render(scene, integrator=primal, spp=count, seed=seed)
            out.append(float((np.array(image, dtype=np.float64) * w).sum()))
        return (out[0] - out[1]) / (2 * row.step)

    result: dict[str, Estimate | str] = {}
    for name, one in (("difference", difference), ("reverse", reverse), ("forward", forward)):
        try:
            # the modes have other seeds, so that none shares its luck
            first = {"difference": 0, "reverse": 100, "forward": 200}[name]
            result[name] = Estimate.of([one(first + k) for k in range(seeds)])
        except Exception as error:  # of ours, or of Dr.Jit around it: the row says so
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            result[name] = str(cause).strip().splitlines()[-1]
    return result


def verdict(row: Situation, result: dict[str, Estimate | str]) -> str:
    """Return ``pass``, or what is wrong, or ``none`` where no derivative is promised."""
    if row.missing:
        return "none"
    want = result["difference"]
    if isinstance(want, str):
        return "error"
    said = []
    for mode in ("forward", "reverse"):
        got = result[mode]
        if isinstance(got, str):
            said.append(f"{mode}: error")
            continue
        both = math.hypot(got.error, want.error)
        if both > PART * abs(want.mean):
            said.append(f"{mode}: noise")
        if abs(got.mean - want.mean) > max(SIGMAS * both, PART * abs(want.mean)):
            said.append(f"{mode}: wrong")
    return ", ".join(said) or "pass"


def apart(row: Situation, seeds: int, spp: float) -> tuple[dict[str, Estimate | str], float]:
    """Return what `measure` does and its processor time, from a process of its own.

    So no row costs another one its table, whatever happens to it, and all begin alike.
    """
    start = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "row.json"
        options = [
            "--rows",
            row.name,
            "--seeds",
            str(seeds),
            "--spp",
            str(spp),
            "--json",
            str(file),
        ]
        command = [sys.executable, __file__, "--alone", *options]
        done = subprocess.run(command, capture_output=True, text=True)
        if not file.exists():
            said = (done.stderr.strip() or "no message").splitlines()[-1]
            return dict.fromkeys(("difference", "reverse", "forward"), said), 0.0
        found = json.loads(file.read_text())["rows"][0]
    result: dict[str, Estimate | str] = {}
    for name in ("difference", "reverse", "forward"):
        value = found[name]
        result[name] = value if isinstance(value, str) else Estimate(**value)
    return result, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - start


def _off(got: Estimate | str, want: Estimate | str) -> str:
    if isinstance(got, str):
        return got
    if isinstance(want, str):
        return str(got)
    both = math.hypot(got.error, want.error)
    part = 100 * (got.mean / want.mean - 1) if want.mean else math.nan
    return f"{got} ({part:+.1f} %, {(got.mean - want.mean) / both:+.1f} σ)"


def _chosen(names: str) -> list[Situation]:
    if not names:
        return SITUATIONS
    asked = [name.strip() for name in names.split(",")]
    known = [row.name for row in SITUATIONS]
    unknown = [name for name in asked if name not in known]
    if unknown:
        raise SystemExit(f"--rows: expected names of {', '.join(known)}; got {', '.join(unknown)}")
    return [row for row in SITUATIONS if row.name in asked]


def main() -> None:
    """Print the table; exit with 1 if a row fails."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--rows", default="", help="names, with commas (all)")
    parser.add_argument("--seeds", type=int, default=6, help="of each estimate (6)")
    parser.add_argument("--spp", type=float, default=1.0, help="times the samples of each row (1)")
    parser.add_argument("--alone", action="store_true", help="in this process")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    rows = _chosen(options.rows)
    table = Table(title=f"mitsuba_bezier {mb.__version__}: derivatives against differences")
    for column in ("situation", "by", "difference", "forward", "reverse", "verdict", "CPU s"):
        table.add_column(column, overflow="fold")
    record, failed = [], False
    for row in rows:
        if options.alone:
            set_variant(row.variant)
            start = time.process_time()
            result = measure(row, options.seeds, options.spp)
            spent = time.process_time() - start
        else:
            result, spent = apart(row, options.seeds, options.spp)
        said, want = verdict(row, result), result["difference"]
        failed |= said not in ("pass", "none")
        modes = [_off(result[mode], want) for mode in ("forward", "reverse")]
        table.add_row(row.name, row.by, str(want), *modes, said, f"{spent:.0f}")
        print(row.name, said, file=sys.stderr)
        record.append(
            {"situation": row.name, "by": row.by, "verdict": said, "missing": row.missing}
            | {k: v if isinstance(v, str) else asdict(v) for k, v in result.items()}
        )
    Console(width=max(Console().width, 150)).print(table)
    for row in rows:
        if row.missing:
            print(f"{row.name}: none, since {row.missing}")
    set_variant(rows[-1].variant)
    about = machine()
    print(
        f"{about['processor']}, {about['system']}, Mitsuba {about['mitsuba']}, "
        f"{options.seeds} seeds"
    )
    if options.json:
        text = json.dumps({"machine": about, "rows": record}, indent=1)
        write_file(options.json, text.encode())
    if failed:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
