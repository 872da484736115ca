"""Render a loaded scene in passes to its files: kept while they are made, until it is good enough.

The developed passes are averaged by the film's filter weights, pixel by pixel, which gives the
image of a single long render. The sum is exact (`verification.merge`), so the passes may as well
be rendered by several runs or machines.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .. import _signals
from .._files import Files, check_target, refuse_inputs, write_file, write_files
from ..errors import BezierError, FileFormatError, RuntimeSetupError
from ..rendering import passes as _rendering
from ..rendering.denoise import auxiliary, check_denoiser, denoise, denoiser_name
from ..rendering.goal import Goal, shown_time
from ..rendering.keeper import Keeper
from ..rendering.perceived import expected_flip
from ..rendering.picture import Picture, beside, encode_sums, load_sums, machine, sums_path
from ..rendering.plan import STYLES, make_plan, pass_seed, sampled_pixels, usual_style
from ..verification import flip
from ..verification.images import encode_exr, read_image
from . import _images
from ._scene import Loaded
from ._streams import printable

__all__ = ["Shot", "render"]

#: Samples per pixel where something else is to end the render. Below it products with a float32
#: are exact.
NO_END = 10_000_000
#: Seconds between two lines of progress where there is no terminal.
LOG_EVERY = 60.0
#: Of the time of this process, the most for looking how noisy what workers have rendered is.
JUDGING = 0.1
#: What tells that two pictures are of one render, whatever their seeds.
SAME = ("scene", "sensor", "integrator", "rfilter", "variant", "part")


class Shot:
    """What is to be rendered, and how: scene, sensor, film, passes, and the names of the files.

    Attributes
    ----------
    plan : Plan
        The passes.
    part : (int, int)
        Which part of how many, from 0: passes ``part[0]``, ``part[0] + part[1]``, ...
    identity : dict
        Header attributes that tell this render from others, whatever its number of samples.
    frame : int or None
        Which frame of a film it is.
    flip_found : float or None
        The FLIP error to be expected, at the end of a render that asked for one.
    """

    def __init__(
        self,
        args: argparse.Namespace,
        loaded: Loaded,
        sensor: Any,
        variant: str,
        output: Path,
        frame: int | None = None,
    ) -> None:
        self.args, self.loaded, self.sensor = args, loaded, sensor
        self.integrator, self.frame = loaded.integrator, frame
        self.variant, self.output = variant, output
        self.flip_found: float | None = None
        self.preview, self.sums = output.with_suffix(".png"), sums_path(output)
        self.denoised = beside(output, ".denoised.exr")
        film, sampler = sensor.film(), sensor.sampler()
        until = args.until_noise is not None or args.until_flip is not None
        open_end = until or args.time is not None
        if args.part and open_end:
            raise BezierError.expected("--part", "no --until-noise, --until-flip, --time", "both")
        spp = args.spp or (NO_END if open_end else sampler.sample_count())
        pixels = sampled_pixels(film)
        self.plans = {
            style: make_plan(pixels, spp, variant, args.spp_per_pass, style) for style in STYLES
        }
        self.plan = self.plans["fine" if until else usual_style(sampler)]
        self.part = args.part or (0, 1)
        if self.part[1] > len(self.plan):
            raise BezierError.expected(
                "--part",
                f"at most {len(self.plan)} parts, one a pass (see --spp-per-pass)",
                self.part[1],
            )
        self.half = "component_format = float16" in str(film)
        self.size = tuple(map(int, film.crop_size()))
        self.offset = int(film.crop_offset()[0]), int(film.crop_offset()[1])
        self.full_size = int(film.size()[0]), int(film.size()[1])
        self.identity: dict[str, str | int] = {
            "scene": loaded.digest,
            "sensor": args.sensor,
            "integrator": loaded.integrator_name,
            "rfilter": film.rfilter().class_name().removesuffix("Filter").lower(),
            "variant": variant,
            "seed": args.seed,
            "plan": self.plan.kind,
            "film": "{} x {} at {}, {} of {} x {}".format(
                *self.size, *self.offset, *self.full_size
            ),
        }
        if args.part:
            self.identity["part"] = f"{self.part[0] + 1}/{self.part[1]}"
        self._check_files()

    @property
    def indices(self) -> range:
        """Numbers of the passes of this part."""
        return range(self.part[0], len(self.plan), self.part[1])

    @property
    def asked(self) -> int:
        """Samples per pixel that this part is to take in all."""
        if self.part[1] == 1:
            return self.plan.spp
        return sum(self.plan[i] for i in self.indices)

    def _check_files(self) -> None:
        """Make sure, before any work, that what is rendered can be kept."""
        for file in (self.output, self.preview, self.sums, self.denoised):
            refuse_inputs(file, self.loaded.files, "--output")
        width, height = self.size
        _images.check_memory(width, height)
        # ZIP halves a picture, roughly; no render has been seen to become an eighth
        check_target(self.output, "--output", width * height * 3 * (2 if self.half else 4) // 8)
        check_target(self.sums, "--output")
        if self.args.workers or self.args.scheduler:
            from ._many import check_dask

            check_dask()
        if self.args.until_flip is not None and not flip.available():
            raise RuntimeSetupError(
                "--until-flip needs flip-evaluator: pip install 'mitsuba-bezier[compare]'"
            )
        if self.args.denoise:
            check_target(self.denoised, "--output")
            check_denoiser()
            names = _rendering.channels_of(_rendering.empty_bitmap(self.sensor, self.integrator))
            if not names.keys() & {"R", "Y"} or "X" in names:
                got = ", ".join(names)
                raise BezierError.expected("--denoise", "a film of channels R, G, B, or Y", got)
            if self.identity["rfilter"] != "box":
                raise BezierError.expected("--denoise", "the filter box", self.identity["rfilter"])
        if self.args.json and self.args.json != "-":
            check_target(self.args.json, "--json", make_folders=True)

    def attributes(self, picture: Picture, stopped_by: str) -> dict[str, str | int | float]:
        """Return the header of a picture."""
        total = picture.total
        noise = total.noise()
        found: dict[str, str | int | float] = {
            "command": shlex.join(self.args.argv),
            **self.identity,
            "spp": total.spp,
            "passes": total.passes,
            # in the order of the plan, whatever came first
            "seeds": " ".join(str(pass_seed(self.args.seed, i)) for i in sorted(picture.done)),
            "stopped_by": stopped_by,
            "render_seconds": picture.seconds,
            **machine(),
        }
        if self.plan.spp < NO_END:
            found["spp_asked"] = self.asked
        if noise is not None:
            found["noise"] = noise
        if self.args.until_noise is not None:
            found["noise_asked"] = self.args.until_noise
        if self.args.until_flip is not None:
            found["flip_asked"], found["flip_share"] = self.args.until_flip
            if self.flip_found is not None:
                found["flip_expected"] = self.flip_found
        if self.args.part:
            found["plan"] = f"{self.plan.spp} spp in {self.plan.kind}"
        else:
            del found["plan"]
        del found["film"]  # EXR has windows for that
        return found

    def encode_picture(self, picture: Picture, stopped_by: str = "") -> Files:
        """Return the picture's file; no Mitsuba is needed."""
        channels = picture.total.mean()
        if self.half:
            channels = _rendering.halved(channels)
        if self.args.part:
            channels |= picture.total.sums()
        attributes = self.attributes(picture, stopped_by or "not yet")
        return {self.output: encode_exr(channels, attributes, self.offset, self.full_size)}

    def encode_sums(self, picture: Picture) -> Files:
        """Return the file of its sums."""
        if not picture.whole.passes:
            return {}
        return {self.sums: encode_sums(picture, self.identity, self.offset, self.full_size)}

    def encode_preview(self, picture: Picture) -> Files:
        """Return its preview, if it has colours."""
        return self._encode_preview(picture.total.mean())

    def _encode_preview(self, channels: dict[str, np.ndarray]) -> Files:
        bitmap = _rendering.empty_bitmap(self.sensor, self.integrator)
        _rendering.fill_bitmap(bitmap, channels)
        png = (self.loaded.preview or _images.encode_preview)(bitmap, self.args.exposure)
        return {} if png is None else {self.preview: png}

    def encode_denoised(self, picture: Picture, stopped_by: str) -> Files:
        """Return the denoised picture and its preview."""
        mean = picture.total.mean()
        names = [name for name in ("RGB" if "R" in mean else "Y") if name in mean]
        started = time.perf_counter()
        guides = auxiliary(self.loaded.scene, self.sensor, self.variant)
        # what an aperture blurs has noise in albedo and normals
        blurred = self.sensor.needs_aperture_sample()
        pixels = np.stack([mean[name] for name in names], axis=-1)
        clean = denoise(pixels, guides, noisy_aovs=blurred)
        channels = {name: clean[..., i] for i, name in enumerate(names)}
        mean |= channels
        if "A" in mean:
            channels["A"] = mean["A"]
        attributes = {
            **self.attributes(picture, stopped_by),
            "denoised": denoiser_name(),
            "denoise_seconds": time.perf_counter() - started,
        }
        data = encode_exr(
            _rendering.halved(channels) if self.half else channels,
            attributes,
            self.offset,
            self.full_size,
        )
        return {self.denoised: data, **self._encode_preview(mean)}

    def finished(self) -> bool:
        """Tell whether the picture is there as it was asked for, with nothing left to do."""
        with suppress(FileFormatError):
            if self.output.is_file() and not self.sums.exists():
                found = read_image(self.output).attributes
                same = all(found.get(key) == self.identity.get(key) for key in (*SAME, "seed"))
                if self.args.until_flip is not None:
                    error, share = self.args.until_flip
                    done = found.get("flip_share") == np.float32(share)
                    done = done and float(found.get("flip_expected", 1.0)) <= error
                elif self.args.until_noise is not None:
                    done = found.get("noise", 1.0) <= self.args.until_noise
                else:
                    done = found.get("spp_asked") == self.asked
                return bool(same and done and found.get("stopped_by") in ("spp", "noise", "flip"))
        return False

    def better(self) -> int:
        """Return the samples of a picture of this render that lies there, 0 if none does."""
        with suppress(FileFormatError, TypeError, ValueError):
            if self.output.is_file():
                found = read_image(self.output).attributes
                if all(found.get(key) == self.identity.get(key) for key in SAME):
                    return (
                        int(found["spp"]) if found.get("part") == self.identity.get("part") else 0
                    )
        return 0


def render(shot: Shot, say: Callable[[str], None], client: Any = None) -> None:
    """Render what is not there yet, and write the files.

    Parameters
    ----------
    shot : Shot
        What is to be rendered.
    say : callable
        Tells the user something.
    client : distributed.Client, optional
        Connected already; by default it is, if workers are asked for.
    """
    args, plan = shot.args, shot.plan
    picture = _begin(shot, say)
    before = picture.total.spp
    goal = Goal(args.until_noise, args.until_flip, args.time)
    better = shot.better()  # also one that was finished just before the sums were to go

    def shown(state: Picture) -> Files:
        # a better picture of the same render stays until this one is as good
        return shot.encode_picture(state) if state.total.spp >= better else {}

    def words(state: Picture) -> str:
        where = shot.output if state.total.spp >= better else shot.sums
        amount = f"{state.total.spp} spp"
        if plan.spp < NO_END:
            amount = f"{state.total.spp} of {shot.asked} spp"
        return f"kept {amount} in {printable(str(where))}; the same command goes on"

    keeper = Keeper(
        shot.encode_sums,
        shown,
        lambda state: shot.encode_preview(state) if state.total.spp >= better else {},
        lambda line: say(f"mitsuba-bezier: {line}"),
        words,
        args.save_every,
    )
    with (
        _progress(shot, picture, goal, args.quiet) as (report, stop),
        _signals.at_end(stop),
        keeper.at_end(),
    ):
        if args.workers or args.scheduler:
            _render_by_many(shot, picture, goal, report, keeper, say, client)
        else:
            _render_here(shot, picture, goal, report, keeper)
        stop()
        _finish(shot, picture, goal, before, say)


def _render_here(
    shot: Shot, picture: Picture, goal: Goal, report: Callable[[], None], keeper: Keeper
) -> None:
    """Render in this process."""
    plan = shot.plan
    for index in shot.indices:
        if index in picture.done:
            continue
        if picture.done and goal.reached(picture, plan[index]):
            break
        started = time.perf_counter()
        rendered = _rendering.render_pass(
            shot.loaded.scene,
            shot.sensor,
            shot.integrator,
            plan[index],
            pass_seed(shot.args.seed, index),
        )
        picture.add(index, rendered)
        seconds = time.perf_counter() - started
        picture.seconds += seconds
        if index != shot.indices[0]:
            goal.measured(plan[index], seconds)
        report()
        keeper.offer(picture, last=index == shot.indices[-1])


def _render_by_many(
    shot: Shot,
    picture: Picture,
    goal: Goal,
    report: Callable[[], None],
    keeper: Keeper,
    say: Callable[[str], None],
    client: Any,
) -> None:
    """Render by the workers of dask."""
    from ..rendering.farm import Farm
    from . import _many, _worker

    def note(line: str) -> None:
        say(f"mitsuba-bezier: {printable(line)}")

    last = shot.indices[-1]
    before = time.perf_counter()
    had = picture.seconds
    with _many.connected(shot.args) if client is None else nullcontext(client) as client:
        job = _many.prepare(client, shot, note)
        farm = Farm(
            client,
            _worker.work,
            job,
            picture,
            shot.args.seed,
            job.identity,
            (shot.size[1], shot.size[0]),
            note,
            _many.reachable(client),
        )

        def progress() -> None:
            picture.seconds = had + time.perf_counter() - before
            report()
            keeper.offer(picture, last=len(picture.done) == len(shot.indices))

        judged, cost = 0.0, 0.0

        def stop(index: int) -> bool:
            nonlocal judged, cost
            workers = max(1, len(farm.shares))
            if farm.seconds_a_pass:
                # by all of them together
                goal.measured(shot.plan[index], farm.seconds_a_pass / workers)
            now = time.perf_counter()
            if (goal.noise or goal.flip) and now - judged < cost / JUDGING:
                return False  # parts come one after the other, and a large film takes a while
            ended = goal.reached(picture, shot.plan[index], True)
            judged = time.perf_counter()
            cost = judged - now
            return ended

        if picture.done and shot.indices and goal.reached(picture, shot.plan[last]):
            return
        farm.run(shot.indices, stop, progress)
    shares = ", ".join(f"{name} {count}" for name, count in sorted(farm.shares.items()))
    note(f"passes by worker: {shares}")


def _begin(shot: Shot, say: Callable[[str], None]) -> Picture:
    """Return what is there of a render, by its file of sums."""
    args = shot.args
    name = printable(str(shot.sums))
    if args.fresh or not os.path.lexists(shot.sums):
        if args.resume:
            say(f"mitsuba-bezier: note: there is no {name} to go on from: beginning anew")
        return Picture(shot.plan)
    image = read_image(shot.sums)
    for other_plan in shot.plans.values():
        if image.attributes.get("plan") == other_plan.kind:
            # begun with or without --until-noise, which does not matter
            shot.plan, shot.identity["plan"] = other_plan, other_plan.kind
    picture, other = load_sums(image, shot.identity, shot.plan, " (or --fresh to begin anew)")
    if not picture.done <= set(shot.indices):
        raise FileFormatError.expected(name, "passes of this part", "others")
    if other:
        say(
            f"mitsuba-bezier: note: {name} was made otherwise, so the last bits may differ from "
            f"those of one run: {'; '.join(other)}"
        )
    say(f"mitsuba-bezier: going on from {picture.total.spp} spp in {name}")
    return picture


def _finish(
    shot: Shot, picture: Picture, goal: Goal, before: int, say: Callable[[str], None]
) -> None:
    """Write the files of a render that has come to its end, and tell what was reached."""
    args = shot.args
    complete = picture.done >= set(shot.indices)
    stopped_by = "spp" if complete else goal.stopped_by
    if args.until_flip is not None:
        shot.flip_found = expected_flip(picture.total, args.until_flip[1])
    files = shot.encode_picture(picture, stopped_by)
    if args.denoise:
        files |= shot.encode_denoised(picture, stopped_by)
    else:
        files |= shot.encode_preview(picture)
    if complete and not args.resume:
        write_files(files)
        with suppress(OSError):
            os.unlink(shot.sums)
    else:
        write_files({**shot.encode_sums(picture), **files})
    names = " and ".join(str(name) for name in files)
    if shot.preview not in files:
        names += " (no colours: no PNG)"
    noise = picture.total.noise()
    reached = "" if noise is None else f", noise {noise:.2%}"
    if args.until_noise is not None and stopped_by != "noise":
        reached += f" of {args.until_noise:.2%} (stopped by {stopped_by})"
    if shot.flip_found is not None:
        reached += f", FLIP of {args.until_flip[0]:g} expected to be {shot.flip_found:.4f}"
    say(
        f"mitsuba-bezier: wrote {printable(names)}: {picture.total.spp} spp, seed {args.seed}, "
        f"{shot.variant}{reached}, {picture.seconds:.1f} s"
    )
    if args.json:
        _write_json(args.json, shot, picture, stopped_by, before)


def _write_json(path: str, shot: Shot, picture: Picture, stopped_by: str, before: int) -> None:
    document: Mapping[str, Any] = {
        "output": str(shot.output),
        **shot.attributes(picture, stopped_by),
        "spp_before": before,
    }
    document = {key: value for key, value in document.items() if key != "seeds"}
    text = json.dumps(document, indent=2) + "\n"  # in ASCII, whatever the locale
    if path == "-":
        print(text, end="")
    else:
        write_file(path, text.encode(), "--json", make_folders=True)


@contextmanager
def _progress(
    shot: Shot, picture: Picture, goal: Goal, quiet: bool
) -> Iterator[tuple[Callable[[], None], Callable[[], None]]]:
    """Show progress on stderr; give what reports a pass, and what stops the display."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} spp"),
        TextColumn("{task.fields[noise]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        disable=quiet,
    )
    began = looked = logged = time.perf_counter()
    had = picture.total.spp
    noise: float | None = None
    end = float(shot.asked)
    looks_anyway = goal.noise is not None and not (shot.args.workers or shot.args.scheduler)

    def report() -> None:
        nonlocal looked, logged, noise, end
        if quiet:
            return
        now = time.perf_counter()
        if now - looked > 1 or looks_anyway:
            looked, noise = now, picture.total.noise()
            looked += 10 * (time.perf_counter() - now)  # a large film takes a while
        end = min(float(shot.asked), goal.expected_spp(picture, noise))
        words = "" if noise is None else f"noise {noise:.2%}"
        if goal.noise is not None:
            words += f" of {goal.noise:.2%}"
        progress.update(task, completed=picture.total.spp, total=end, noise=words)
        if not console.is_terminal and now - logged > LOG_EVERY:
            logged = now
            done = max(1, picture.total.spp - had)
            left = shown_time((now - began) * max(0.0, end - picture.total.spp) / done)
            print(
                f"mitsuba-bezier: {picture.total.spp} of {end:.0f} spp, {words}, {left} left",
                file=sys.stderr,
                flush=True,
            )

    stopped = False

    def stop() -> None:
        nonlocal stopped
        if not stopped:  # each time it would print an empty line
            stopped = True
            progress.stop()

    title = printable(shot.output.stem)
    task = progress.add_task(title, total=end, completed=picture.total.spp, noise="")
    progress.start()
    try:
        yield report, stop
    finally:
        stop()
