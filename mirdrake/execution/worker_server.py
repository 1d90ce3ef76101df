"""The server that worker processes fork from, and which imports everything once.

The server takes as long to import as the program itself. Code that will need workers calls :func:`start_server` before
its own imports, so that both import at the same time.
"""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import forkserver, get_context
from types import ModuleType
from typing import Any

METHOD = "forkserver" if sys.platform != "win32" else "spawn"
"""Start method: forking from a server that has imported everything takes half the time of a fresh process."""

STUDY, LOOP, CASE = "mirdrake.execution.job", "mirdrake.tuning.loops.evaluate", "mirdrake.suites.worker"
"""Modules that workers import for runs of diagrams, trials of gains, and cases of suites."""

PRELOADED = "mirdrake.execution.preloaded"
"""Module that the server imports first."""

ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "GLIBC_TUNABLES": "glibc.malloc.tcache_count=127:glibc.malloc.hugetlb=1",
}
"""Environment variables of a worker, unless the user has set them.

Linear algebra uses one thread, as there are as many processes as cores. A step of a plant allocates and frees hundreds
of small blocks of memory; a larger cache per thread and huge pages save a seventh of its time (glibc only)."""

_starting = threading.Lock()  # the settings at the start of a process are those of the whole program


def start_server(module: str) -> None:
    """Start the server unless it is running, without waiting for it; it ends with this program.

    Args:
        module: module that the server imports.
    """
    # A worker is forked from a server that has imported the module already.
    if METHOD == "forkserver":
        with worker_start():
            context: Any = get_context(METHOD)
            context.set_forkserver_preload([PRELOADED, module])
            forkserver.ensure_running()


@contextmanager
def worker_start() -> Iterator[None]:
    """Prepare the program for starting a worker process within the block.

    The worker does not import the main script again, so that this needs no ``if __name__ == "__main__"``; it ignores
    Ctrl-C; and it has :data:`ENVIRONMENT`.
    """
    with ExitStack() as stack:
        # In this order: the lock first, as the other three change state of the whole process.
        for entry in (_starting, _without_main(), _environment(), _without_interrupts()):
            stack.enter_context(entry)
        yield


@contextmanager
def _without_main() -> Iterator[None]:
    main = sys.modules["__main__"]
    # An empty module: otherwise multiprocessing would import the user's script again in each worker.
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _environment() -> Iterator[None]:
    new = {name: value for name, value in ENVIRONMENT.items() if name not in os.environ}
    os.environ |= new
    try:
        yield
    finally:
        for name in new:
            os.environ.pop(name, None)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Defer Ctrl-C until after the block: a new process inherits the signal mask of this thread."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    late: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    # Handlers of signals can be changed in the main thread only, and only if they are Python's.
    mine = threading.current_thread() is threading.main_thread() and handler is not None
    # The mask is that of this thread only: another one may get the signal, which the main thread then handles.
    if mine:
        signal.signal(signal.SIGINT, lambda number, _: late.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if mine:
            signal.signal(signal.SIGINT, handler)
        # After the handler, so that a signal that was pending meets the right one.
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if late:
            signal.raise_signal(signal.SIGINT)
