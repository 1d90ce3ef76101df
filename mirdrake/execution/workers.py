"""Worker processes behind the interface of ``concurrent.futures``, which a call may hang or take down with it."""

import gc
import queue
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from multiprocessing import connection, get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mirdrake.core.errors import RunError
from mirdrake.execution.job import builds
from mirdrake.execution.processes import STARTING, WorkerProcess, settle_in
from mirdrake.execution.worker_server import LOOP, METHOD, STUDY, start_server, worker_start

MOST_BUILDS = 64
"""Diagrams that a process builds before another takes its place: Drake leaves some 0.4 MB of each behind."""


class WorkerLostError(Exception):
    """A call hung or ended its process; the message says which, and where."""


class InProcess(Executor):
    """Calls at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call it; the future is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Workers(Executor):
    """Processes that take calls one by one.

    A call that hangs or takes its process down gives its future a :class:`WorkerLostError`; a new process goes on with
    the next call.

    Args:
        count: number of processes; they start at once.
        limit: wall time a call may take [s].
    """

    def __init__(self, count: int, *, limit: float) -> None:
        self.limit = limit
        self._calls: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._logs = TemporaryDirectory(prefix="mirdrake-study-")
        self._started = 0
        self._closing = False
        self._workers: dict[int, WorkerProcess] = {}
        self._threads = [threading.Thread(target=self._serve, args=(slot,), daemon=True) for slot in range(count)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand in a call; it and its arguments can be pickled."""
        future: Future[Any] = Future()
        self._calls.put((future, (fn, args, kwargs)))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after the calls that were handed in, or at once if these shall be cancelled."""
        self._closing = self._closing or cancel_futures
        if cancel_futures:
            with suppress(queue.Empty):
                while True:
                    call = self._calls.get_nowait()
                    if call is not None:
                        call[0].cancel()
            for worker in list(self._workers.values()):
                with suppress(ValueError, OSError):  # it has just ended
                    worker.process.kill()
        for _ in self._threads:
            self._calls.put(None)
        if wait:
            for thread in self._threads:
                thread.join()
            self._logs.cleanup()

    def _serve(self, slot: int) -> None:
        """Hand calls to the process of a slot, and replace it when it is lost; the body of a thread."""
        while not self._closing:
            fault = self._ready(slot)
            call = self._calls.get()
            if call is None:
                break
            future, work = call
            if not future.set_running_or_notify_cancel():
                continue
            result = None
            fault = fault or self._ready(slot)
            if fault is None:
                fault, result = self._call(slot, work)
            if fault is None:
                future.set_result(result)
            else:
                future.set_exception(fault)
        if slot in self._workers:
            self._workers.pop(slot).kill()

    def _ready(self, slot: int) -> Exception | None:
        """See to it that a slot has a process that lives; what prevents it."""
        worker = self._workers.get(slot)
        if worker is not None and worker.process.is_alive():
            return None
        if worker is not None:  # it died while it had nothing to do
            self._workers.pop(slot).kill()
        try:
            self._workers[slot] = self._start()
        except Exception as error:
            return RunError(f"the worker processes of the study cannot start: {error}")
        return None

    def _call(self, slot: int, work: Any) -> tuple[Exception | None, Any]:
        """What a call gives, or why it gives nothing."""
        worker = self._workers[slot]
        worker.begin(self.limit)
        fault: Exception | None
        spent, result = True, None
        try:
            worker.pipe.send(work)
            connection.wait([worker.pipe, worker.process.sentinel], timeout=self.limit)
            fault, result, spent = (
                worker.pipe.recv() if worker.pipe.poll() else (WorkerLostError(worker.why_lost()), None, True)
            )
        except (EOFError, OSError):
            fault = WorkerLostError(worker.why_lost())
        except Exception as error:  # it cannot be pickled, or its result cannot be read
            fault = error
        if spent:
            self._workers.pop(slot).kill()
        return fault, result

    def _start(self) -> WorkerProcess:
        start_server(LOOP if LOOP in sys.modules else STUDY)
        context: Any = get_context(METHOD)
        mine, theirs = context.Pipe()
        with worker_start():
            self._started += 1
            log = Path(self._logs.name) / f"{self._started}.log"
            name = f"mirdrake worker {self._started}"
            process = context.Process(target=serve, args=(theirs, str(log)), daemon=True, name=name)
            process.start()
        theirs.close()
        worker = WorkerProcess(process, mine, log)
        connection.wait([mine, process.sentinel], timeout=STARTING)
        try:
            if mine.poll():
                mine.recv()
                return worker
            reason = f"no answer after {STARTING:g} s" if process.is_alive() else worker.why_ended()
        except (EOFError, OSError):
            process.join(timeout=5.0)
            reason = worker.why_ended()
        worker.kill()
        raise RunError(reason)


def serve(pipe: connection.Connection, log: str) -> None:
    """Make the calls that come through a pipe until it closes; the body of a worker process.

    Args:
        pipe: calls in; exception, result and whether this process has done enough out.
        log: file that takes everything that is printed, so that the last words of a crash can be read.
    """
    settle_in(log)
    gc.freeze()  # what is imported stays; no need to look through it again and again
    pipe.send("ready")
    while True:
        try:
            function, arguments, named = pipe.recv()
        except (EOFError, OSError):
            return
        fault, result = None, None
        try:
            result = function(*arguments, **named)
        except BaseException as error:
            fault = RuntimeError(f"{type(error).__name__}: {error}")
        pipe.send((fault, result, builds() >= MOST_BUILDS))
