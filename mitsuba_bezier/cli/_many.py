"""``render --scheduler ADDRESS | --workers N``: the same render by the workers of dask."""

from __future__ import annotations

import argparse
import logging
import os
import socket
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from .._files import temporary_folder
from ..errors import BezierError, RuntimeSetupError
from ..rendering.bundle import make_bundle
from ..rendering.picture import machine
from . import _model, _worker

__all__ = ["check_dask", "connected", "job_of", "prepare", "reachable"]

#: Seconds that a scheduler has to answer, and its first worker to come.
ANSWER, FIRST_WORKER = 10, 120
#: Seconds that a worker has to answer where it can be reached.
REACH = 2
#: A worker that says nothing for so long is given up; those of a cluster of ours only.
SILENCE = "60 s"


def check_dask() -> None:
    """Make sure that ``distributed`` is there.

    Raises
    ------
    RuntimeSetupError
        If it is not.
    """
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise RuntimeSetupError(
            f"--scheduler and --workers need distributed ({error}): "
            "pip install 'mitsuba-bezier[dask]'"
        ) from None


@contextmanager
def connected(args: argparse.Namespace) -> Iterator[Any]:
    """Give a client of dask: of a scheduler that runs, or of workers on this machine.

    Raises
    ------
    BezierError
        If the scheduler does not answer, or no worker comes.
    """
    check_dask()
    import dask
    from distributed import Client, LocalCluster

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    # it dies with the workers if a signal ends the command, and would say so
    warnings.filterwarnings("ignore", message="resource_tracker")
    settings = {
        "distributed.worker.multiprocessing-method": "spawn",  # a fork of Dr.Jit's threads hangs
        "distributed.scheduler.worker-ttl": SILENCE,
        "distributed.scheduler.allowed-failures": 3,
        "distributed.comm.timeouts.connect": f"{ANSWER}s",
        "distributed.worker.profile.enabled": False,  # it looks at all threads, again and again
        "logging.distributed": "critical",
    }
    with dask.config.set(settings):
        if args.scheduler:
            try:
                client = Client(args.scheduler, timeout=ANSWER)
            except (OSError, TimeoutError, ValueError) as error:
                raise BezierError.expected(
                    "--scheduler",
                    "the address of a dask scheduler that answers",
                    f"{args.scheduler}: {error}",
                ) from None
            try:
                yield _awaited(client, 1)
            finally:
                client.close(timeout=5)
            return
        with temporary_folder() as folder:
            cluster = LocalCluster(
                n_workers=args.workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                local_directory=folder,
                silence_logs=logging.CRITICAL,
                memory_limit=0,  # Mitsuba's memory is not dask's to judge
            )
            client = Client(cluster)
            try:
                yield _awaited(client, args.workers)
            finally:
                client.close(timeout=5)
                cluster.close(timeout=5)


def _awaited(client: Any, count: int) -> Any:
    try:
        client.wait_for_workers(count, timeout=FIRST_WORKER)
    except TimeoutError:
        raise BezierError.expected("--scheduler", "a worker within two minutes", "none") from None
    return client


def reachable(client: Any) -> bool:
    """Tell whether this process can talk to all workers, which clouds and firewalls may forbid."""
    for address in client.scheduler_info(n_workers=-1)["workers"]:
        place = urlsplit(address)
        if place.scheme not in ("tcp", "tls") or place.port is None:
            return False
        try:
            socket.create_connection((place.hostname, place.port), timeout=REACH).close()
        except OSError:
            return False
    return True


def job_of(shot: Any) -> tuple[_worker.Job, Any]:
    """Return what workers are told, and the files that they are sent, for a `_passes.Shot`."""
    args = shot.args
    named = [args.scene, *args.more, *_model.surroundings(args)]
    bundle = make_bundle(shot.loaded.files, named, args.append)
    threads = args.threads
    if threads is None and args.workers:
        threads = max(1, (os.cpu_count() or 1) // args.workers)
    plain = argparse.Namespace(**{**vars(args), "argv": []})
    return (
        _worker.Job(
            bundle.digest, plain, shot.variant, shot.plan, shot.identity, threads, shot.frame
        ),
        bundle,
    )


def prepare(client: Any, shot: Any, note: Callable[[str], None]) -> _worker.Job:
    """Make sure that all workers are alike, and send them the files.

    Raises
    ------
    BezierError
        If one lacks the package, has other versions, or no room for the files; it is named.
    """
    from distributed import WorkerPlugin

    job, bundle = job_of(shot)

    class Files(WorkerPlugin):
        """Gives the files to every worker, also to those that come later."""

        name = f"mitsuba-bezier-{bundle.digest}"

        def setup(self, worker: Any) -> None:
            try:
                _worker.receive(bundle, worker.local_directory)
            except (BezierError, OSError) as error:
                raise BezierError(f"{error}, at worker {worker.address}") from None

    answers = client.run(_worker.probe, shot.variant, on_error="return")
    ours = machine()
    for address, found in sorted(answers.items()):
        if isinstance(found, Exception):
            raise BezierError.expected(
                f"worker {address}", f"mitsuba_bezier {ours['version_mitsuba_bezier']}", found
            )
        for key, value in ours.items():
            if found.get(key) == value:
                continue
            if key == "processor":
                note(
                    f"note: worker {address} has another processor ({found.get(key)}, not {value}):"
                    " last bits may differ from those of one machine"
                )
                continue
            name = key.removeprefix("version_")
            raise BezierError.expected(f"worker {address}: {name}", value, found.get(key))
    try:
        client.register_plugin(Files())
    except (BezierError, OSError) as error:
        raise BezierError.expected("workers", "room for the scene's files", error) from None
    return job
