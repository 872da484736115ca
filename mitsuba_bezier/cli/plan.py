"""``mitsuba-bezier plan``: write the scripts that render a scene in parts, on many machines."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import BezierError
from ._streams import printable

__all__ = ["add_parser", "run", "scripts"]

MAX_PARTS = 1_000_000


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "plan",
        help="write the scripts that render a scene in parts, on many machines",
        description="Print the commands that render a scene in parts and merge them, to the bit "
        "that one machine would render. --slurm and --make write them as a job array of Slurm and "
        "as a Makefile. Both may be started again: parts that are done are not rendered again, "
        "and those that were interrupted go on. All machines must see the scene's files and "
        "the folder of the parts under the same names.",
    )
    add = parser.add_argument
    add("scene", metavar="SCENE", help="the scene file, or a model")
    add("--parts", metavar="N", type=int, required=True, help="how many parts")
    add("-o", "--output", metavar="OUT.exr", help="the picture; default: SCENE.exr")
    add("--slurm", metavar="FILE", nargs="?", const="", help="write a job array (OUT.slurm)")
    add("--make", metavar="FILE", nargs="?", const="", help="write a Makefile (OUT.mk)")
    add("--folder", metavar="DIR", help="of the parts (OUT.parts)")
    add("--hours", metavar="H", type=float, default=24.0, help="time limit of a part, Slurm (24)")
    add("--cpus", metavar="N", type=int, default=8, help="processors of a part, Slurm (8)")
    add("-m", "--mode", metavar="VARIANT", help="variant of Mitsuba")
    add("-D", "--define", metavar="KEY=VALUE", action="append", default=[], help="as for render")
    add("-s", "--sensor", metavar="N", type=int, default=0, help="as for render")
    add("-a", "--append", metavar="PATHS", action="append", default=[], help="as for render")
    add("--spp", metavar="N", type=int, help="samples per pixel (the scene's)")
    add("--seed", metavar="K", type=int, default=0, help="seed of the render (0)")
    add(
        "--render",
        metavar="OPTIONS",
        default="",
        help="more options of render, in one word: --render '--view front --ortho'",
    )


def run(args: argparse.Namespace) -> int:
    """Plan, write the scripts, print the commands; return 0."""
    from .._files import check_target, refuse_inputs, write_file
    from ..rendering.plan import make_plan, sampled_pixels, usual_style
    from . import _images, _inputs, _scene, main, render

    if not 1 <= args.parts <= MAX_PARTS:
        raise BezierError.expected("--parts", f"a number from 1 to {MAX_PARTS}", args.parts)
    scene = Path(args.scene)
    output = _images.check_output(args.output or scene.with_suffix(".exr"))
    words = _render_words(args)
    _scene.check_name(args.scene)
    parsed = main.parse(["render", *words])
    variant = render.set_variant(parsed.mode)
    loaded = _inputs.load(parsed, variant)
    sensor = _inputs.chosen_sensor(loaded.scene, parsed.sensor)
    spp = parsed.spp or sensor.sampler().sample_count()
    if spp < args.parts:
        raise BezierError.expected("--parts", f"no more than the {spp} samples a pixel", args.parts)
    pixels = sampled_pixels(sensor.film())
    plan = make_plan(pixels, spp, variant, parsed.spp_per_pass, usual_style(sensor.sampler()))
    if len(plan) < args.parts * 4 and parsed.spp_per_pass is None:
        # as large as lets each part have a like share
        size = max(1, min(plan.size, spp // (4 * args.parts) or spp // args.parts))
        words += ["--spp-per-pass", str(size)]
        plan = make_plan(pixels, spp, variant, size)
    if len(plan) < args.parts:
        raise BezierError.expected("--parts", f"at most {len(plan)}, one a pass", args.parts)
    folder = Path(args.folder or output.with_suffix(".parts"))
    made = scripts(words, args.parts, output, folder, args.hours, args.cpus)
    files = []
    for kind, suffix in (("slurm", ".slurm"), ("make", ".mk")):
        chosen = getattr(args, kind)
        if chosen is not None:
            path = Path(chosen) if chosen else output.with_suffix(suffix)
            refuse_inputs(path, loaded.files, f"--{kind}")
            check_target(path, f"--{kind}")
            files.append((path, made[kind]))
    for path, text in files:
        write_file(path, text.encode("utf-8", "surrogateescape"))
        print(f"mitsuba-bezier: wrote {printable(str(path))}", file=sys.stderr)
    print(made["shell"])
    return 0


def _render_words(args: argparse.Namespace) -> list[str]:
    """Return the arguments of ``render`` without output and part."""
    words = [args.scene]
    for flag, value in (("-m", args.mode), ("--spp", args.spp)):
        words += [flag, str(value)] if value is not None else []
    for flag, values in (("-D", args.define), ("-a", args.append)):
        for value in values:
            words += [flag, value]
    for flag, number in (("-s", args.sensor), ("--seed", args.seed)):
        words += [flag, str(number)] if number else []
    more = shlex.split(args.render)
    for word in more:
        if word.split("=")[0] in (
            "--part",
            "-o",
            "--output",
            "--until-noise",
            "--until-flip",
            "--time",
        ):
            raise BezierError.expected("--render", "options that all parts share", word)
    return [*words, *more]


def scripts(
    words: Sequence[str], parts: int, output: Path, folder: Path, hours: float, cpus: int
) -> dict[str, str]:
    """Return a shell line, a job array of Slurm, and a Makefile.

    Parameters
    ----------
    words : sequence of str
        Arguments of ``render``.
    parts : int
        How many.
    output, folder : Path
        The picture, and where its parts go.
    hours, cpus : float, int
        Of one part, for Slurm.
    """
    width = len(str(parts))
    command = shlex.join(["mitsuba-bezier", "render", *words])
    place, out = shlex.quote(str(folder)), shlex.quote(str(output))
    name = f'"$(printf %0{width}d "$i")"'
    # a part that is there with all its samples is not rendered again: its sums are gone then
    one = f"{command} -q --part $i/{parts} -o {place}/{name}.exr"
    done = f"{place}/{name}.done"
    part = f"[ -e {done} ] || {{ {one} && touch {done}; }}"
    merge = f"mitsuba-bezier merge {place}/{'[0-9]' * width}.exr -o {out}"
    shell = f"mkdir -p {place} && for i in $(seq {parts}); do {part}; done && {merge}"
    limit = max(1, round(hours * 60))
    slurm = f"""#!/bin/sh
# written by: mitsuba-bezier plan
#   sbatch THIS                  renders the parts, and merges them if all are done
#   sbatch THIS, once more       renders what is missing
#SBATCH --job-name=mitsuba-bezier
#SBATCH --array=1-{parts}
#SBATCH --time={limit}
#SBATCH --cpus-per-task={cpus}
#SBATCH --signal=TERM@60
#SBATCH --requeue
mkdir -p {place}
# kernels are kept on the disk of the node: a shared home would be asked by all at once
export DRJIT_CACHE_DIR="${{TMPDIR:-/tmp}}/drjit-$(id -u)"
i=$SLURM_ARRAY_TASK_ID
if ! [ -e {done} ]; then
  # in the background, so that the signal at the end of the time reaches it
  {command} -q -t "${{SLURM_CPUS_PER_TASK:-{cpus}}}" --part $i/{parts} \\
    -o {place}/{name}.exr & pid=$!
  trap 'kill -TERM $pid' TERM
  wait $pid || wait $pid || exit $?
  touch {done}
fi
# the last one merges
if [ "$(ls {place}/*.done | wc -l)" -eq {parts} ]; then
  {merge}
fi
"""
    return {"shell": shell, "slurm": slurm, "make": _makefile(command, parts, output, folder)}


def _makefile(command: str, parts: int, output: Path, folder: Path) -> str:
    width = len(str(parts))
    place, out = shlex.quote(str(folder)), shlex.quote(str(output))
    if any(c in place + out for c in " '\"$#:%\\"):
        raise BezierError.expected("--make", "names without blanks and marks, for make", place)
    call = command.replace("$", "$$")
    return f"""# written by: mitsuba-bezier plan
#   make -f THIS -j 4            renders the parts, four at a time, and merges them
PARTS := $(shell seq -f '{place}/%0{width}.0f.done' {parts})

{out}: $(PARTS)
\tmitsuba-bezier merge $(PARTS:.done=.exr) -o $@

{place}/%.done:
\t@mkdir -p {place}
\t{call} -q --part $$(expr $* + 0)/{parts} -o {place}/$*.exr
\t@touch $@
"""
