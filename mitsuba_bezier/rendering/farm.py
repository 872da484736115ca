"""Passes of one render on many workers of dask: parts go out, sums come back.

Dask sends the parts to whoever is free, and those of a worker that died to another. What it cannot
see is done here: a part that takes far longer than others do is rendered once more elsewhere, and
one that comes back damaged too. Sums are exact, so that it does not matter which of two arrives,
in which order, and from whom.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from ..errors import BezierError
from .parts import COST, Rendered, check, part_size
from .picture import Picture

__all__ = ["Farm"]

#: A part is late after so many times what it should take, and so many seconds at the least.
LATE, LATE_SECONDS = 4.0, 20.0
#: How often a part may fail before the render does.
ATTEMPTS = 5
#: How often a worker may send what does not fit before it gets no more.
TRUST = 2
#: Parts that are out, for each worker: one that is rendered, and one that waits there.
AHEAD = 2
#: The most of its time that this process may take for merging: parts get larger.
BUSY = 0.5
#: Results that are fetched or merged at a time: more would fill the memory.
FETCHED = 4
#: Seconds between two looks at who does what.
LOOK = 1.0


@dataclass
class _Part:
    """A part that is out."""

    indices: tuple[int, ...]
    begun: dict[str, float] = field(default_factory=dict)  #: by the keys of its futures
    failed: int = 0
    doubled: float = 0.0  #: when it was last sent to a second worker
    ready: set[str] = field(default_factory=set)  #: keys of futures that wait to be fetched


class Farm:
    """Renders what a picture lacks by the workers of a dask client.

    Parameters
    ----------
    client : distributed.Client
        Connected.
    function : callable
        What workers call: ``function(job, indices)`` gives a `Rendered`.
    job : object
        The first argument.
    picture : Picture
        What is there; what comes is added.
    seed : int
        Of the render.
    identity : dict
        Which render it is.
    size : (int, int)
        Height and width.
    note : callable
        Tells the user something.
    direct : bool
        Whether sums come from the workers; else they come through the scheduler, which is twice
        the way, but is there where workers cannot be reached.
    """

    def __init__(
        self,
        client: Any,
        function: Callable[[Any, Sequence[int]], Rendered],
        job: Any,
        picture: Picture,
        seed: int,
        identity: dict[str, Any],
        size: tuple[int, int],
        note: Callable[[str], None],
        direct: bool = False,
    ) -> None:
        self._client, self._function, self._job = client, function, job
        self.picture, self._seed, self._identity, self._size = picture, seed, identity, size
        self._note, self._direct = note, direct
        self._out: dict[Any, _Part] = {}
        self._arrived: queue.Queue[tuple[Any, Any, bool]] = queue.Queue()
        self._slots = threading.BoundedSemaphore(FETCHED)
        self._known: tuple[float, list[str]] = 0.0, []
        self._doubts: Counter[str] = Counter()
        self._silent: set[str] = set()
        self._seconds = self._cost = self._merging = 0.0
        self._measured = self._parts = 0
        self._looked = 0.0
        #: Passes that each worker has rendered.
        self.shares: Counter[str] = Counter()

    @property
    def seconds_a_pass(self) -> float | None:
        """Mean time that a worker takes for a pass, once one is measured."""
        return self._seconds / self._measured if self._measured else None

    def cost(self, workers: int) -> float | None:
        """Return what a part costs besides its passes, once that is measured, in seconds.

        That is what its sums take at the worker, or its share of the time that this process
        merges: with many workers that is what they wait for.
        """
        if not self._parts:
            return None
        return max(self._cost, workers * self._merging * COST / BUSY) / self._parts

    def run(
        self, indices: Iterable[int], stop: Callable[[int], bool], progress: Callable[[], None]
    ) -> None:
        """Render passes.

        Parameters
        ----------
        indices : iterable of int
            Their numbers; those that are there are left out.
        stop : callable
            Tells whether to end, given the number of the pass that would be next.
        progress : callable
            Called after each part that has come.

        Raises
        ------
        BezierError
            If a part fails on several workers, or none is left.
        """
        waiting = [i for i in indices if i not in self.picture.done]
        at, ended = 0, False
        try:
            while self._out or (at < len(waiting) and not ended):
                workers = self._trusted()
                while at < len(waiting) and not ended and self._open() < AHEAD * len(workers):
                    number = len(workers)
                    left = len(waiting) - at
                    count = part_size(self.seconds_a_pass, left, number, self.cost(number))
                    chosen = self._whole(waiting[at : at + count])
                    self._send(_Part(tuple(chosen)), workers)
                    at += len(chosen)
                if not self._out:
                    raise BezierError.expected("workers", "one that can be trusted", "none")
                for future, answer, slot in self._answers():
                    began = time.perf_counter()
                    taken = future in self._out and self._take(future, answer, workers)
                    del answer
                    if slot:
                        self._slots.release()
                    self._merging += time.perf_counter() - began
                    if taken:
                        progress()
                        if not ended and at < len(waiting) and stop(waiting[at]):
                            ended = True
                            self._cancel()
                self._look_for_late(workers)
        finally:
            self._cancel()

    def _answers(self) -> Iterator[tuple[Any, Any, bool]]:
        """Give what has come, with the futures; wait for the first for a while."""
        with suppress(queue.Empty):
            yield self._arrived.get(timeout=LOOK)
            while True:
                yield self._arrived.get_nowait()

    def _whole(self, indices: list[int]) -> list[int]:
        """Let a pass that is cut short be a part of its own."""
        for at, index in enumerate(indices):
            if self.picture.plan.is_cut(index):
                return indices[: max(1, at)]
        return indices

    def _open(self) -> int:
        return len({part.indices for part in self._out.values()})

    def _trusted(self) -> list[str]:
        """Return the addresses of the workers that may have parts."""
        looked, every = self._known
        if time.perf_counter() - looked > LOOK or not every:
            every = list(self._client.scheduler_info(n_workers=-1)["workers"])
            self._known = time.perf_counter(), every
        good = [address for address in every if self._doubts[address] < TRUST]
        # who does not answer gets no more until it does, unless there is nobody else
        return [address for address in good if address not in self._silent] or good

    def _send(self, part: _Part, workers: Sequence[str]) -> None:
        doubted = any(count >= TRUST for count in self._doubts.values())
        restricted = doubted or self._silent or part.begun
        future = self._client.submit(
            _guarded,
            self._function,
            self._job,
            part.indices,
            pure=False,
            retries=0,
            workers=list(workers) if restricted and workers else None,
            allow_other_workers=bool(restricted and workers),
            # the first passes come first: there is a picture soon
            priority=-part.indices[0],
        )
        self._out[future] = part
        part.begun.setdefault(future.key, 0.0)
        # a thread for each, since a result may lie with a worker that does not give it away
        threading.Thread(target=self._fetch, args=(future, part), daemon=True).start()

    def _fetch(self, future: Any, part: _Part) -> None:
        """Wait for what comes, however long that takes; take it when there is room."""
        from distributed import wait

        answer: Any
        slot = False
        try:
            wait(future)
            part.ready.add(future.key)
            # those of workers that hang must not keep the others out
            slot = self._slots.acquire(timeout=LATE_SECONDS)
            part.begun[future.key] = time.perf_counter()
            part.ready.discard(future.key)
            answer = self._client.gather(future, direct=self._direct)
        except (Exception, CancelledError) as error:  # of dask: a worker died too often
            answer = "a worker", error
        self._arrived.put((future, answer, slot))

    def _take(self, future: Any, answer: Any, workers: Sequence[str]) -> bool:
        """Take what came; send it out again if it cannot be used; tell whether it can."""
        part = self._out.pop(future)
        if part.indices[0] in self.picture.done:
            return False
        source, rendered = answer
        self._silent.discard(source)
        reason = self._judged(rendered, part)
        if reason is None:
            self._add(part, source, rendered)
            return True
        self._doubts[source] += 1
        part.failed += 1
        words = " ".join(str(reason).split()) or type(reason).__name__
        if part.failed >= ATTEMPTS:
            raise BezierError.expected(
                "workers", "one that can render a part", f"{ATTEMPTS} failures, the last: {words}"
            )
        self._note(f"note: a part failed at {source} and is rendered again: {words}")
        others = [address for address in workers if address != source] or list(workers)
        if not any(p.indices == part.indices for p in self._out.values()):
            self._send(part, others)
        return False

    def _judged(self, rendered: Any, part: _Part) -> BaseException | None:
        """Return why what came cannot be used, or None; raise what is an error of the scene."""
        if isinstance(rendered, BezierError) and not getattr(rendered, "of_machine", False):
            raise rendered  # it would be the same everywhere
        if isinstance(rendered, (Exception, CancelledError)):
            return rendered
        try:
            check(rendered, part.indices, self._seed, self._identity, self._size)
        except BezierError as error:
            return error
        return None

    def _add(self, part: _Part, source: str, rendered: Rendered) -> None:
        self.picture.add_sums(part.indices, rendered.sums, rendered.spp, rendered.seeds)
        self.shares[source] += len(part.indices)
        self._seconds += rendered.seconds
        self._measured += len(part.indices)
        self._cost += rendered.cost
        self._parts += 1
        for other in [f for f, p in self._out.items() if p.indices == part.indices]:
            del self._out[other]
            other.cancel()

    def _look_for_late(self, workers: Sequence[str]) -> None:
        """Send parts that take too long to other workers, too."""
        now = time.perf_counter()
        if now - self._looked < LOOK or not self._out:
            return
        self._looked = now
        try:
            asked = self._client.processing().items()
            held = self._client.who_has(list(self._out)).items()
        except (OSError, TimeoutError):
            return
        places = {key: address for address, keys in asked for key in keys}
        places |= {key: next(iter(addresses)) for key, addresses in held if addresses}
        for future, part in list(self._out.items()):
            address = places.get(future.key)
            if address is None or future.key in part.ready:
                continue
            begun = part.begun[future.key] = part.begun[future.key] or now
            # what waits at a worker waits for one part before it
            should = AHEAD * len(part.indices) * (self.seconds_a_pass or 0.0)
            patience = max(LATE_SECONDS, LATE * should) if self._measured else 10 * LATE_SECONDS
            others = [other for other in workers if other != address]
            if now - max(begun, part.doubled) > patience and others:
                part.doubled = now
                self._silent.add(address)
                self._note(
                    f"note: {address} has not answered for {now - begun:.0f} s: its part is "
                    "rendered again elsewhere"
                )
                self._send(part, others)

    def _cancel(self) -> None:
        for future in self._out:
            future.cancel()
        self._out.clear()


def _guarded(
    function: Callable[[Any, Sequence[int]], Rendered], job: Any, indices: Sequence[int]
) -> tuple[str, Rendered | Exception]:
    """Return who rendered a part, and its sums or what went wrong."""
    from distributed import get_worker

    address = str(get_worker().address)
    try:
        return address, function(job, indices)
    except Exception as error:  # whatever a worker's system throws
        return address, error
