"""One thread for matrices: those of a build are many and small, and more threads only wait.

OpenBLAS shares a product of some tens of thousands of entries among threads, which wait for each
other by going round and round: on a machine that is busy they take many times the processor time
that the product itself does.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["one_thread"]

_held = threading.Lock()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let NumPy's products of matrices have one thread each; as a decorator, too.

    Their number is one of the process. Who comes first sets it, and restores it at the end; others
    meanwhile change nothing, as they could not tell who is last.
    """
    if not _held.acquire(blocking=False):
        yield
        return
    from threadpoolctl import threadpool_limits

    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        _held.release()
