"""Worker processes with the interface of ``concurrent.futures`` that survive calls which hang or crash."""

import gc
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from importlib import import_module
from multiprocessing import connection, get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mirdrake.core.compiled import announce_compilation, watch_compilation
from mirdrake.core.errors import RunError
from mirdrake.execution.processes import STARTING, WorkerProcess, initialise_worker, resident_memory
from mirdrake.execution.worker_server import CASE, LOOP, METHOD, STUDY, start_server, worker_start

MEMORY_GROWTH = 400 * 2**20
"""Resident memory that a worker process may gain before a new one replaces it [bytes].

A user block that is derived from pydrake's LeafSystem is never freed, nor is the diagram that it is part of. The memory
of a worker without such blocks was measured to level out after a gain of about 50 MB.
"""

COMPILATION = 600.0
"""Wall time that a compilation may take, besides the time limit of the call in which it happens [s]."""

COMPILING, COMPILED = "compiling", "compiled"
"""Messages of a worker: a compilation begins, or ends."""


class WorkerLostError(Exception):
    """A call did not end in time, or ended its process; the message states which, and where.

    Attributes:
        seconds: wall time since the call began [s].
    """

    def __init__(self, reason: str, seconds: float = 0.0) -> None:
        super().__init__(reason)
        self.seconds = seconds


class InProcess(Executor):
    """Executor that makes calls immediately, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Make a call, and return its finished future."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Workers(Executor):
    """Executor whose processes take calls one by one.

    The future of a call that hangs or ends its process raises :class:`WorkerLostError`; a new process continues with
    the next call.

    Args:
        count: number of processes, which start immediately.
        limit: wall time that a call may take [s], infinite for any; or a function of its arguments that returns it.
    """

    def __init__(self, count: int, *, limit: float | Callable[..., float]) -> None:
        self._limit = limit
        self._calls: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._logs = TemporaryDirectory(prefix="mirdrake-workers-")
        self._started = 0
        self._closing = False
        self._workers: dict[int, WorkerProcess] = {}
        # One thread for each process: it waits for its call with a time limit, which a pool of futures cannot.
        self._threads = [threading.Thread(target=self._serve, args=(slot,), daemon=True) for slot in range(count)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call; the function and its arguments must be picklable."""
        future: Future[Any] = Future()
        self._calls.put((future, (fn, args, kwargs)))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes after the submitted calls, or immediately if these are to be cancelled."""
        self._closing = self._closing or cancel_futures
        if cancel_futures:
            with suppress(queue.Empty):
                while True:
                    call = self._calls.get_nowait()
                    if call is not None:
                        # No process will take these calls, so that their futures would never finish.
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
        """Pass calls to the process of a slot, and replace the process when it is lost; the body of a thread."""
        while not self._closing:
            # Started before a call is taken, so that the start is not part of its time limit.
            fault = self._ready(slot)
            call = self._calls.get()
            if call is None:
                break
            future, work = call
            if not future.set_running_or_notify_cancel():
                continue
            result = None
            # The process may have ended while the slot waited for a call.
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
        """Ensure that a slot has a live process; return the error if one cannot be started."""
        worker = self._workers.get(slot)
        if worker is not None and worker.process.is_alive():
            return None
        if worker is not None:  # it ended between two calls
            self._workers.pop(slot).kill()
        try:
            self._workers[slot] = self._start()
        except Exception as error:
            return RunError(f"the worker processes cannot start: {error}")
        return None

    def _call(self, slot: int, work: tuple[Any, Any, Any]) -> tuple[Exception | None, Any]:
        """Make a call in the process of a slot; return its result, or the error that prevented one."""
        worker = self._workers[slot]
        fault: Exception | None
        replace, result = True, None
        try:
            limit = self._limit(*work[1], **work[2]) if callable(self._limit) else self._limit
            worker.begin(limit)
            worker.pipe.send(work)
            while True:
                # The sentinel is ready when the process ends, so that a crash is noticed without a timeout.
                connection.wait([worker.pipe, worker.process.sentinel], timeout=worker.patience())
                # No message after the wait: the limit has passed, or the process is dead.
                message = worker.pipe.recv() if worker.pipe.poll() else (_lost(worker), None, True)
                # A compilation is not part of the time limit: it happens once, in whichever call comes first.
                if message == COMPILING:
                    announce_compilation()
                    worker.pause(COMPILATION)
                elif message == COMPILED:
                    worker.resume()
                else:
                    fault, result, replace = message
                    break
        except (EOFError, OSError):
            fault = _lost(worker)
        except Exception as error:  # the call cannot be pickled, or its result cannot be read
            fault = error
        # After a fault the state of the process is unknown; a new one takes over.
        if replace:
            self._workers.pop(slot).kill()
        return fault, result

    def _start(self) -> WorkerProcess:
        # Fork from a server that has imported what the work of this program needs.
        modules = [name for name in (LOOP, CASE, STUDY) if name in sys.modules] or [STUDY]
        start_server(modules[0])
        context: Any = get_context(METHOD)
        mine, theirs = context.Pipe()
        with worker_start():
            # Numbered logs: the output of a worker that crashed is quoted in its result.
            self._started += 1
            log = Path(self._logs.name) / f"{self._started}.log"
            name = f"mirdrake worker {self._started}"
            arguments = (theirs, str(log), dict(os.environ), modules)
            process = context.Process(target=serve, args=arguments, daemon=True, name=name)
            process.start()
        # This end is closed here, or the pipe would stay open when the worker dies.
        theirs.close()
        worker = WorkerProcess(process, mine, log)
        # The start includes the imports; a hanging import must not block the program.
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


def _lost(worker: WorkerProcess) -> WorkerLostError:
    reason = worker.why_lost()
    return WorkerLostError(reason, time.monotonic() - worker.since)


def serve(pipe: connection.Connection, log: str, environment: dict[str, str], modules: Sequence[str]) -> None:
    """Make the calls that come through a pipe until it closes; the body of a worker process.

    Args:
        pipe: takes calls; returns for each its exception, its result, and whether this process is to be replaced;
            before that, :data:`COMPILING` and :data:`COMPILED` around compilations.
        log: file for everything that is printed, so that the last messages before a crash can be read.
        environment: environment variables of the main process; the server that workers fork from may have older ones.
        modules: imported before the first call, so that its time limit does not include them.
    """
    os.environ.clear()
    os.environ.update(environment)
    initialise_worker(log)
    for module in modules:
        import_module(module)
    # Imported objects stay; garbage collection need not visit them again and again. The server has switched it off.
    gc.freeze()
    gc.enable()
    # From whichever thread compiles, so that messages must not mix.
    sending = threading.Lock()

    def send(message: Any) -> None:
        with sending:
            pipe.send(message)

    watch_compilation(lambda begins: send(COMPILING if begins else COMPILED))
    send("ready")
    initial = resident_memory()
    while True:
        try:
            function, arguments, named = pipe.recv()
        except (EOFError, OSError):
            return
        fault, result = None, None
        try:
            result = function(*arguments, **named)
        except BaseException as error:
            # As a RuntimeError with a text: an exception of a user's class may not be picklable.
            fault = RuntimeError(f"{type(error).__name__}: {error}")
        # Flushed now: after a crash in the next call, the log must have the messages of this one.
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        # Replaced by the growth, not the size: imported modules are the same for all workers.
        send((fault, result, resident_memory() - initial > MEMORY_GROWTH))
