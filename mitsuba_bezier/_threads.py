"""Numbers of threads that libraries have for the process, set for as long as anyone needs it.

Matrices of a build are many and small: one thread is best. OpenBLAS shares a product of some tens
of thousands of entries among threads, which wait for each other by going round and round: on a
machine that is busy they take many times the processor time that the product itself does.

Mitsuba's OpenEXR hands the rows of a file to Dr.Jit's pool of threads, and waits for them. Where
that has one thread, the one that waits, it waits for ever: so there are two.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib import import_module
from typing import Any

__all__ = ["give_thread", "one_thread", "thread_for_files"]


def _shared(make: Callable[[], AbstractContextManager[Any]]) -> Callable[[], Any]:
    """Return a context manager that may be entered again, within itself or in several threads.

    The first who enters makes the change, the last who leaves takes it back.
    """
    lock, change, within = threading.Lock(), ExitStack(), 0

    @contextmanager
    def enter() -> Iterator[None]:
        nonlocal within
        with lock:
            if within == 0:
                change.enter_context(make())
            within += 1
        try:
            yield
        finally:
            with lock:
                within -= 1
                if within == 0:
                    change.close()

    return enter


def _one_thread() -> AbstractContextManager[Any]:
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[Any] = threadpool_limits(1, user_api="blas")
    return limits


@contextmanager
def _thread_for_files() -> Iterator[None]:
    dr: Any = import_module("drjit")
    if dr.thread_count() != 1:
        yield
        return
    dr.set_thread_count(2)
    try:
        yield
    finally:
        dr.set_thread_count(1)


#: Let NumPy's products of matrices have one thread each; as a decorator, too.
one_thread = _shared(_one_thread)

#: Let Dr.Jit have a second thread, if it is to have one only, while files are read.
thread_for_files = _shared(_thread_for_files)


def give_thread() -> None:
    """Let Dr.Jit have a second thread on a machine of one core, for files of EXR."""
    allowed = getattr(os, "sched_getaffinity", None)
    cores = len(allowed(0)) if allowed else os.cpu_count()
    dr: Any = import_module("drjit")
    if cores == 1 and dr.thread_count() == 1:
        dr.set_thread_count(2)
