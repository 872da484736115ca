"""End a command by signal: Ctrl-C, SIGTERM and SIGHUP end it at any moment, in one line.

An exception would not do. Python raises it between two steps of its own, so seconds late while
the main thread is in a kernel, and inside of imports, where C++ libraries end in an aborted
process. So nothing is raised: what was begun is undone, and the process just ends, with the code
that shells know, 128 and the number of the signal. If the main thread is busy in a library, a
second thread does that, which the operating system wakes at once.

Only the program ``mitsuba-bezier`` does so, from the first import on; whoever imports the package
keeps the signals.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

__all__ = ["always_at_end", "at_end", "begin", "begin_if_command", "end", "end_children"]

_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "terminal closed"}
#: Seconds that the main thread has to answer by itself, and that all undoing may take.
_MAIN, _UNDO = 0.1, 5.0

_at_end: list[Callable[[], str | None]] = []
_longer: list[float] = []  # seconds that undoing may take now
_begun = False
_ending = threading.Lock()
_by: int | None = None


def begin_if_command() -> None:
    """Begin if this process is the program, which has only just begun to import the package."""
    started = sys.modules.get("multiprocessing.process")
    if started is not None and started.parent_process() is not None:
        return  # a worker of the program, which has its arguments
    name = os.path.basename(sys.argv[0]) if sys.argv else ""
    program = name.removesuffix(".exe").removesuffix("-script.py") == "mitsuba-bezier"
    # as long as Python looks for the module, "-m" stands there
    module = any(word.endswith("mitsuba_bezier.cli.main") for word in sys.orig_argv)
    if program or (name == "-m" and module):
        begin()


def begin() -> None:
    """Let signals end this process; later calls, and those of other threads, do nothing."""
    global _begun
    if _begun or threading.current_thread() is not threading.main_thread():
        return
    _begun = True
    _open_streams()
    for name in _WORDS:
        number = getattr(signal, name, None)
        # nohup lets its program live on
        if number and not (name == "SIGHUP" and signal.getsignal(number) == signal.SIG_IGN):
            signal.signal(number, lambda number, _frame: end(number))
    if os.name != "nt":
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        # the number of a signal is written here at once, whatever the main thread is doing
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        threading.Thread(target=_watch, args=(reading,), daemon=True).start()


@contextmanager
def at_end(undo: Callable[[], str | None], seconds: float = 0.0) -> Iterator[None]:
    """Call `undo` if a signal ends the process within the block, before what was begun before.

    What it returns stands in the line that tells of the end. It may take `seconds`, if those are
    more than usual.
    """
    _at_end.append(undo)
    _longer.append(seconds)
    try:
        yield
    finally:
        _longer.remove(seconds)
        _at_end.remove(undo)


def always_at_end(undo: Callable[[], str | None]) -> None:
    """Call `undo` if a signal ends the process, whenever it does."""
    _at_end.append(undo)


def end(number: int) -> None:
    """Undo what was begun, and end the process."""
    global _by
    own = threading.get_ident()
    if not _ending.acquire(blocking=False):
        while _by != own:  # another thread is at it, and nothing may be begun any more
            time.sleep(1)
        return  # a second signal, while this thread undoes things
    _by = own
    code = 128 + number
    # a terminal that is stopped, or a disk that is gone, must not hold us
    seconds = max([_UNDO, *_longer])
    threading.Thread(target=_end_late, args=(code, seconds), daemon=True).start()
    words = _WORDS[signal.Signals(number).name]
    for undo in (end_children, *reversed(_at_end)):
        with suppress(BaseException):
            words += undo() or ""
    with suppress(OSError):
        os.write(2, f"mitsuba-bezier: {words}\n".encode("ascii", "backslashreplace"))
    os._exit(code)


def end_children() -> None:
    """End the processes that this one has started."""
    with suppress(OSError):  # Linux alone tells them
        for thread in os.listdir("/proc/self/task"):
            with suppress(OSError), open(f"/proc/self/task/{thread}/children") as file:
                for child in file.read().split():
                    with suppress(OSError):
                        os.kill(int(child), signal.SIGKILL)


def _end_late(code: int, seconds: float) -> None:
    time.sleep(seconds)
    os._exit(code)


def _watch(reading: int) -> None:
    handled = {int(getattr(signal, name, 0)) for name in _WORDS}
    while number := os.read(reading, 1):
        if number[0] in handled:
            # the main thread knows best what it has just begun
            time.sleep(_MAIN)
            end(number[0])


def _open_streams() -> None:
    """Put something in the place of standard streams that are closed.

    The next file that is opened would be taken for them. What is printed to a closed standard
    output fails, as it should; what is said on a closed standard error is lost.
    """
    for descriptor, mode in ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(descriptor)
        except OSError:
            new = os.open(os.devnull, mode)
            if new != descriptor:
                os.dup2(new, descriptor)
                os.close(new)
