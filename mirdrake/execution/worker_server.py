"""Where worker processes come from: a server that imports once, and from which they fork.

It takes as long to import as the program itself. What will need workers calls :func:`start_server` first and imports
then, so that both go on at the same time.
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
"""How a process starts: from a server that has imported everything, which takes half the time of a fresh one."""

STUDY, LOOP = "mirdrake.execution.job", "mirdrake.tuning.loops.evaluate"
"""What a server imports for runs of diagrams, and for trials of gains."""

ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "GLIBC_TUNABLES": "glibc.malloc.tcache_count=127:glibc.malloc.hugetlb=1",
}
"""Of a worker, unless the user has set it: linear algebra keeps to one thread, as there are as many processes as cores
already. A step of a plant takes and frees hundreds of small blocks of memory: with more than seven of a size at hand,
and all of them on large pages, it takes a seventh less time. Only glibc reads that."""

_starting = threading.Lock()  # what is set while a process starts is the whole program's


def start_server(module: str) -> None:
    """Start the server unless it runs, and do not wait for it. It ends with this program.

    Args:
        module: what it imports.
    """
    if METHOD == "forkserver":
        with worker_start():
            context: Any = get_context(METHOD)
            context.set_forkserver_preload([module])
            forkserver.ensure_running()


@contextmanager
def worker_start() -> Iterator[None]:
    """Inside, a process may start as a worker.

    It does not import the program again, so that a user's script needs no ``if __name__ == ...``; does not know Ctrl-C;
    and has :data:`ENVIRONMENT`.
    """
    with ExitStack() as stack:
        for entry in (_starting, _without_main(), _environment(), _without_interrupts()):
            stack.enter_context(entry)
        yield


@contextmanager
def _without_main() -> Iterator[None]:
    main = sys.modules["__main__"]
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
    """A Ctrl-C comes behind it: what starts has the mask of this thread, and other threads may take the signal."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    late: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    mine = threading.current_thread() is threading.main_thread() and handler is not None
    if mine:
        signal.signal(signal.SIGINT, lambda number, _: late.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if mine:
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if late:
            signal.raise_signal(signal.SIGINT)
