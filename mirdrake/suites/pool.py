"""Worker processes that run cases, and outlive whatever a case does to them."""

import os
import re
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import connection, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType
from typing import Any, Self

from mirdrake.errors import RunError
from mirdrake.suites.cases import Case, Result
from mirdrake.suites.worker import run_folder, serve
from mirdrake.yaml_io import shown

STARTING = 120.0
"""Wall time that a worker may take to start [s]."""

_LAST_WORDS = re.compile(r"Failure at |Fatal Python error|terminate called|what\(\):|Assertion .* failed|Error: ")
_FRAME = re.compile(r'\s*File "(?P<file>.*)", line (?P<line>\d+) in (?P<name>.*)')


def time_limit(case: Case) -> float:
    """Wall time that a case may take if nothing else is said [s]."""
    return 60.0 + 10.0 * case.duration


@dataclass
class _Worker:
    process: BaseProcess
    pipe: connection.Connection
    log: Path
    ready: bool = False
    case: int | None = None
    since: float = field(default_factory=time.monotonic)
    deadline: float = field(default_factory=lambda: time.monotonic() + STARTING)
    offset: int = 0


class Pool:
    """Worker processes; use it in a ``with``.

    A case that hangs or takes its process down is told as an error, and a new process goes on with the next one. A
    worker has no memory of the cases it ran, so that no result depends on how they are dealt out.

    Args:
        workers: number of processes.
        folder: of a suite, for the runs of failures; None writes nothing.
        timeout: wall time a case may take [s]; see :func:`time_limit` if left out.
        keep_all: keep the run folders of cases that passed, too.
    """

    def __init__(
        self, workers: int, *, folder: Path | None = None, timeout: float | None = None, keep_all: bool = False
    ) -> None:
        self._count, self._folder, self._timeout, self._keep_all = max(1, workers), folder, timeout, keep_all
        self._workers: list[_Worker] = []
        self._logs: Any = None
        self._started = 0

    def __enter__(self) -> Self:
        self._logs = tempfile.TemporaryDirectory(prefix="mirdrake-suite-")
        return self

    def __exit__(self, *details: object) -> None:
        for worker in self._workers:
            _kill(worker)
        self._workers.clear()
        self._logs.cleanup()

    def run(self, cases: Sequence[Case]) -> Iterator[tuple[int, Result]]:
        """Run cases; yields the index and the result of each as soon as it is there.

        Raises:
            RunError: worker processes cannot start.
        """
        waiting = list(range(len(cases)))[::-1]
        running = 0
        while waiting or running:
            while len(self._workers) < min(self._count, len(waiting) + running):
                self._workers.append(self._start())
            for worker in self._workers:
                if worker.ready and worker.case is None and waiting:
                    running += self._give(worker, waiting, cases)
            for worker in self._wait():
                done = self._look(worker, cases)
                if done is not None:
                    running -= 1
                    yield done

    def _start(self) -> _Worker:
        context = get_context("spawn")
        mine, theirs = context.Pipe()
        self._started += 1
        log = Path(self._logs.name) / f"{self._started}.log"
        arguments = (theirs, str(log), self._folder, self._keep_all)
        process = context.Process(target=serve, args=arguments, daemon=True, name=f"mirdrake worker {self._started}")
        with _without_main(), _one_thread(), _without_interrupts():
            process.start()
        theirs.close()
        return _Worker(process, mine, log)

    def _give(self, worker: _Worker, waiting: list[int], cases: Sequence[Case]) -> int:
        """Send a worker its next case; 1 if it took it."""
        index = waiting.pop()
        try:
            worker.pipe.send(cases[index])
        except OSError:  # it died while it had nothing to do
            waiting.append(index)
            _kill(worker)
            self._workers.remove(worker)
            return 0
        limit = self._timeout if self._timeout is not None else time_limit(cases[index])
        worker.case, worker.since = index, time.monotonic()
        worker.deadline = worker.since + limit
        worker.offset = worker.log.stat().st_size if worker.log.exists() else 0
        return 1

    def _wait(self) -> list[_Worker]:
        """The workers that have something to say, that died, or whose time is over."""
        busy = [worker for worker in self._workers if worker.case is not None or not worker.ready]
        soonest = min((worker.deadline for worker in busy), default=time.monotonic())
        things: dict[Any, _Worker] = {}
        for worker in busy:
            things |= {worker.pipe: worker, worker.process.sentinel: worker}
        said = connection.wait(list(things), timeout=max(0.0, soonest - time.monotonic()))
        late = [worker for worker in busy if time.monotonic() >= worker.deadline]
        return list({id(worker): worker for worker in [*(things[thing] for thing in said), *late]}.values())

    def _look(self, worker: _Worker, cases: Sequence[Case]) -> tuple[int, Result] | None:
        """What a worker has to say: the result of its case, if that has ended one way or the other."""
        message: Any = None
        try:
            if worker.pipe.poll():
                message = worker.pipe.recv()
        except (EOFError, OSError):  # it died with its pipe
            message = None
        except Exception as error:  # a result that cannot be read
            message = Result(cases[worker.case or 0].name, "error", f"{type(error).__name__}: {error}")
        if isinstance(message, Result) and worker.case is not None:
            index, worker.case = worker.case, None
            return index, message
        if message is not None:
            worker.ready = True
            return None
        late = time.monotonic() >= worker.deadline
        if not late:
            worker.process.join(timeout=5.0)
        reason = _hung(worker) if late and worker.process.is_alive() else _died(worker)
        _kill(worker)
        self._workers.remove(worker)
        if worker.case is None:
            raise RunError(f"the worker processes of the suite cannot start: {reason}")
        case = cases[worker.case]
        wall = round(time.monotonic() - worker.since, 3)
        folder = run_folder(case, self._folder)
        return worker.case, Result(case.name, "error", reason, wall=wall, folder=folder, digest=case.digest())


def _kill(worker: _Worker) -> None:
    worker.pipe.close()
    if worker.process.is_alive():
        worker.process.kill()
    worker.process.join()
    worker.process.close()


def _hung(worker: _Worker) -> str:
    """Why a worker that does not answer is given up: how long it took, and where it is."""
    waited = f"no end after {worker.deadline - worker.since:g} s of wall time"
    if worker.process.pid is not None and hasattr(signal, "SIGUSR1"):
        os.kill(worker.process.pid, signal.SIGUSR1)
        time.sleep(0.2)
    frames = [match for match in map(_FRAME.match, _said(worker)) if match]
    if not frames:
        return waited
    return f"{waited}; it was in {frames[0]['name']} of {shown(Path(frames[0]['file']))}:{frames[0]['line']}"


def _died(worker: _Worker) -> str:
    """Why a worker process ended: its signal or exit code, and its last words."""
    code = worker.process.exitcode
    name = signal.Signals(-code).name if code is not None and code < 0 else ""
    ended = f"the process was ended by {name}" if name else f"the process ended with exit code {code}"
    words = [line.strip() for line in _said(worker) if line.strip()]
    told = next((line for line in words if _LAST_WORDS.search(line)), "")
    return f"{ended}: {told[:300]}" if told else ended


def _said(worker: _Worker) -> list[str]:
    """The lines that a worker printed since its case began."""
    try:
        with worker.log.open("rb") as file:
            file.seek(worker.offset)
            return file.read(200_000).decode(errors="replace").splitlines()
    except OSError:
        return []


@contextmanager
def _without_main() -> Iterator[None]:
    """Start a process that does not import the program again: a user's script needs no ``if __name__ == ...``."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Start a process that does not know Ctrl-C, which is for the suite: it ends its workers."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Start a process whose linear algebra keeps to one thread: there are as many processes as cores already."""
    before = {name: os.environ.get(name) for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}
    os.environ |= {name: "1" for name, value in before.items() if value is None}
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
