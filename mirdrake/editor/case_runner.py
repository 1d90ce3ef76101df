"""Tests of the saved world, run by the command line's own verb in a separate process."""

import subprocess
import sys
import threading
from pathlib import Path

from mirdrake.core.json_io import Json


class CaseRunner:
    """Runs the tests of a world file, one run at a time.

    Args:
        path: the world file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._process: subprocess.Popen[str] | None = None
        self._name, self._lines = "", list[str]()
        self._code: int | None = None
        self._thread: threading.Thread | None = None

    def run(self, name: str = "") -> None:
        """Run one test, or all without a name; a run that has not ended is stopped."""
        self.stop()
        command = [sys.executable, "-P", "-m", "mirdrake.cli", "world", "test", str(self._path), "--quiet"]
        if name:
            command += ["--case", name]
        self._name, self._lines, self._code = name or "all tests", [], None
        self._process = process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            cwd=self._path.parent,
        )  # fmt: skip
        self._thread = threading.Thread(target=self._read, args=(process,), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the run, if there is one; the results so far stay in its folder."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()

    close = stop

    def state(self) -> Json:
        """Return name, output and exit code of the last run; its code is None while it runs."""
        return {"name": self._name, "lines": self._lines[-60:], "code": self._code}

    def _read(self, process: "subprocess.Popen[str]") -> None:
        assert process.stdout is not None
        lines = self._lines
        for line in process.stdout:
            lines.append(line.rstrip())
        code = process.wait()
        if process is self._process:
            self._code = code
