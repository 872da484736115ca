"""What a worker of dask does: hold the files of a scene, load it once, render parts of it."""

from __future__ import annotations

import argparse
import ctypes
import signal
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from .. import _runtime
from ..errors import BezierError, FileFormatError
from ..rendering.bundle import Bundle
from ..rendering.parts import Rendered, render_part
from ..rendering.passes import Pass, render_pass
from ..rendering.picture import machine
from ..rendering.plan import Plan

__all__ = ["Job", "probe", "receive", "work"]

#: One part at a time: a film belongs to one render.
_lock = threading.Lock()
_bundles: dict[str, tuple[Bundle, str | None]] = {}
_loaded: dict[str, Any] = {}
_films: dict[str, Any] = {}


@dataclass(frozen=True)
class Job:
    """What all parts of a render share.

    Attributes
    ----------
    digest : str
        Of the bundle.
    args : argparse.Namespace
        Of ``render``.
    variant : str
        Of Mitsuba.
    plan : Plan
        All passes.
    identity : dict
        Which render it is.
    threads : int or None
        Of Dr.Jit; None for all.
    frame : int or None
        Of a film.
    """

    digest: str
    args: argparse.Namespace
    variant: str
    plan: Plan
    identity: dict[str, Any]
    threads: int | None
    frame: int | None = None


def probe(variant: str) -> dict[str, str]:
    """Return versions and processor of this machine; the variant must start."""
    _runtime.check(variant)
    return machine()


def receive(bundle: Bundle, folder: str | None = None) -> None:
    """Take the files of a scene to a folder, which is dask's to remove."""
    with suppress(ValueError):  # of other threads than the main one
        # Ctrl-C is for the command, which ends its workers
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    _keep_memory()
    bundle.unpack(folder)
    _bundles[bundle.digest] = bundle, folder


def _keep_memory() -> None:
    """Let glibc keep memory that is free, which dask's workers are told to give back at once.

    Pictures come and go with every pass: giving their pages back and taking them again was a fifth
    of a small pass.
    """
    # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of malloc.h; other C libraries have no `mallopt`
    with suppress(AttributeError, OSError, TypeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(-1, 1 << 30)
        libc.mallopt(-3, 1 << 25)  # the largest that 64-bit glibc takes


def work(job: Job, indices: Sequence[int]) -> Rendered:
    """Render a part."""
    with _lock:
        mi = _runtime.import_mitsuba()
        mi.set_variant(job.variant)
        scene, sensor, integrator = _scene_of(job)

        def render(spp: int, seed: int) -> Pass:
            return render_pass(scene, sensor, integrator, spp, seed)

        return render_part(job.plan, indices, job.args.seed, job.identity, render)


def _scene_of(job: Job) -> tuple[Any, Any, Any]:
    """Return scene, sensor and integrator, which are loaded once."""
    key = repr((job.digest, sorted(job.identity.items())))
    if key not in _loaded:
        if job.digest not in _bundles:
            raise _of_machine(FileFormatError.expected("bundle", "the scene's files", "none"))
        if job.threads:
            import drjit as dr

            dr.set_thread_count(job.threads)
        loaded = _load(job)
        if loaded.digest != job.identity["scene"]:
            raise FileFormatError.expected(
                "scene",
                "names of files that are relative to it, for other machines",
                "files that they do not find",
            )
        sensor = loaded.scene.sensors()[job.args.sensor]
        _loaded.clear()
        _loaded[key] = loaded.scene, sensor, loaded.integrator
    found: tuple[Any, Any, Any] = _loaded[key]
    return found


def _load(job: Job) -> Any:
    """Load what is to be rendered from the files that have come."""
    from . import _inputs
    from ._movie_frames import Film

    bundle, folder = _bundles[job.digest]
    root = bundle.unpack(folder)  # again, if something has removed it
    args = argparse.Namespace(**vars(job.args))
    args.scene, *rest = (str(root / name) for name in bundle.inputs)
    args.more, light = rest[: len(args.more)], rest[len(args.more) :]
    if light:
        (args.light,) = light
    args.append = [str(root / name) for name in bundle.folders]
    args.scene_out = None  # which whoever gave the command has written
    if job.frame is None:
        return _inputs.load(args, job.variant)
    key = repr((job.digest, sorted(vars(args).items())))
    if key not in _films:  # its models are read once
        _films.clear()
        _films[key] = Film(args)
    return _films[key].load(job.frame)


def _of_machine(error: BezierError) -> BezierError:
    error.of_machine = True  # type: ignore[attr-defined]
    return error
