"""Worker process as managed by the main process: start, end, and the reason of a loss."""

import faulthandler
import math
import os
import re
import signal
import sys
import threading
import time
from dataclasses import dataclass, field
from multiprocessing import connection, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path

from mirdrake.core.yaml_io import display_path

STARTING = 120.0
"""Wall time that a worker may take to start [s]."""

_LAST_MESSAGE = re.compile(r"Failure at |Fatal Python error|terminate called|what\(\):|Assertion .* failed|Error: ")
_FRAME = re.compile(r'\s*File "(?P<file>.*)", line (?P<line>\d+) in (?P<name>.*)')


@dataclass
class WorkerProcess:
    """A process that receives calls through a pipe.

    Attributes:
        process: the process.
        pipe: sends calls, receives results.
        log: file of everything that the process prints.
        since: start of the present call, by ``time.monotonic``.
        deadline: time at which the call is given up.
        offset: length of the log at the start of the call.
        paused: since when the clock of the call is stopped, and the deadline without that; None: it runs.
    """

    process: BaseProcess
    pipe: connection.Connection
    log: Path
    since: float = field(default_factory=time.monotonic)
    deadline: float = field(default_factory=lambda: time.monotonic() + STARTING)
    offset: int = 0
    paused: tuple[float, float] | None = None

    def begin(self, limit: float) -> None:
        """Begin a call that may take so long [s]."""
        self.since = time.monotonic()
        self.deadline, self.paused = self.since + limit, None
        self.offset = self.log.stat().st_size if self.log.exists() else 0

    def patience(self) -> float | None:
        """Return the time until the deadline [s]; None without one."""
        # The system's timers know no infinity.
        return max(self.deadline - time.monotonic(), 0.0) if math.isfinite(self.deadline) else None

    def pause(self, most: float) -> None:
        """Stop the clock of the call, for a time that is limited itself [s]."""
        if self.paused is None:
            self.paused = time.monotonic(), self.deadline
            self.deadline = self.paused[0] + most

    def resume(self) -> None:
        """Let the clock of the call go on."""
        if self.paused is not None:
            begin, deadline = self.paused
            pause = time.monotonic() - begin
            self.since, self.deadline, self.paused = self.since + pause, deadline + pause, None

    def kill(self) -> None:
        """End the process."""
        self.pipe.close()
        # SIGKILL, because a process that hangs in C++ does not handle other signals.
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.process.close()

    def why_lost(self) -> str:
        """Return the reason why the process does not answer, in one line: where it hangs, or how it ended."""
        late = time.monotonic() >= self.deadline
        # The pipe may break a moment before the process can be waited for.
        if not late:
            self.process.join(timeout=5.0)
        return self._hung() if late and self.process.is_alive() else self.why_ended()

    def why_ended(self) -> str:
        """Return why the process ended: its signal or exit code, and its last message."""
        code = self.process.exitcode
        name = signal.Signals(-code).name if code is not None and code < 0 else ""
        ended = f"the process was ended by {name}" if name else f"the process ended with exit code {code}"
        # Only what was printed since the call began can explain its loss.
        lines = [line.strip() for line in self._printed() if line.strip()]
        message = next((line for line in lines if _LAST_MESSAGE.search(line)), "")
        return f"{ended}: {message[:300]}" if message else ended

    def _hung(self) -> str:
        waited = f"no end after {self.deadline - self.since:g} s of wall time"
        # The worker's faulthandler prints the stack of its main thread on SIGUSR1, even inside of C++.
        if self.process.pid is not None and hasattr(signal, "SIGUSR1"):
            os.kill(self.process.pid, signal.SIGUSR1)
            time.sleep(0.2)
        frames = [match for match in map(_FRAME.match, self._printed()) if match]
        if not frames:
            return waited
        return f"{waited}; it was in {frames[0]['name']} of {display_path(Path(frames[0]['file']))}:{frames[0]['line']}"

    def _printed(self) -> list[str]:
        """Return the lines that the process has printed since the call began."""
        try:
            with self.log.open("rb") as file:
                file.seek(self.offset)
                return file.read(200_000).decode(errors="replace").splitlines()
        except OSError:
            return []


def initialise_worker(log: str) -> None:
    """Make this process a worker: it prints to a file, reports where it hangs on SIGUSR1, and ends with its parent.

    Args:
        log: file for everything that is printed, so that the last message before a crash can be read.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C concerns the parent, which ends its workers
    stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    # At the level of file descriptors, so that C++ messages of Drake are caught too.
    for number in (1, 2):
        os.dup2(stream, number)
    os.close(stream)
    # Prints the Python stack on a crash (SIGSEGV, SIGABRT), which the main process then reports.
    faulthandler.enable(all_threads=False)
    if hasattr(signal, "SIGUSR1"):
        faulthandler.register(signal.SIGUSR1, all_threads=False)
    # A worker whose parent was killed would otherwise wait on its pipe without end.
    threading.Thread(target=_end_with_parent, daemon=True).start()


def resident_memory() -> int:
    """Return the resident memory of this process [bytes]; its maximum where the system does not report the present one.

    Zero where neither is known.
    """
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        pass
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        # _exit: no cleanup of a process whose main thread is in the middle of a call.
        os._exit(1)
