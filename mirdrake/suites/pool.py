"""Worker processes that run cases, and outlive whatever a case does to them."""

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import connection, get_context
from pathlib import Path
from typing import Any, Self

from mirdrake.core.errors import RunError
from mirdrake.execution.processes import WorkerProcess
from mirdrake.execution.worker_server import worker_start
from mirdrake.suites.cases import Case, Result
from mirdrake.suites.worker import run_folder, serve


def time_limit(case: Case) -> float:
    """Wall time that a case may take if nothing else is said [s]."""
    return 60.0 + 10.0 * case.duration


@dataclass
class _Worker(WorkerProcess):
    ready: bool = False
    case: int | None = None


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
            worker.kill()
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
        with worker_start():
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
            worker.kill()
            self._workers.remove(worker)
            return 0
        limit = self._timeout if self._timeout is not None else time_limit(cases[index])
        worker.case = index
        worker.begin(limit)
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
        reason = worker.why_lost()
        worker.kill()
        self._workers.remove(worker)
        if worker.case is None:
            raise RunError(f"the worker processes of the suite cannot start: {reason}")
        case = cases[worker.case]
        wall = round(time.monotonic() - worker.since, 3)
        folder = run_folder(case, self._folder)
        return worker.case, Result(case.name, "error", reason, wall=wall, folder=folder, digest=case.digest())
