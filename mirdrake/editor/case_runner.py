"""Tests of the saved world, run by the command line's own verb in a separate process.

What reads their results is imported when a test is run: it brings the whole simulation, which the page does not need.
"""

import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.json_io import Json

if TYPE_CHECKING:
    from mirdrake.suites.cases import Case, Result

RECORDING = "recording.html"
"""Recording in the folder of a case; the command line writes those of the worst cases, and of a case run alone."""


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
        self._folder: Path | None = None
        self._recordings: dict[str, Path] = {}
        self._final: list[Json] | None = None

    def run(self, name: str = "") -> None:
        """Run one test or case, or all without a name; a run that has not ended is stopped."""
        from mirdrake.runs.simulation import default_folder

        self.stop()
        self._folder = default_folder(self._path.stem, base=self._path.parent)
        command = [sys.executable, "-P", "-m", "mirdrake.cli", "world", "test", str(self._path), "--quiet"]
        command += ["--out", str(self._folder), *(["--case", name] if name else [])]
        self._name, self._lines, self._code, self._final = name or "all tests", [], None, None
        self._process = process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            cwd=self._path.parent,
        )  # fmt: skip
        threading.Thread(target=self._read, args=(process, self._lines), daemon=True).start()

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
        """Return name, output, exit code and results of the last run; its code is None while it runs."""
        return {"name": self._name, "lines": self._lines[-60:], "code": self._code, "cases": self._cases()}

    def recording(self, name: str) -> Path | None:
        """Return the recording of a case of the last run; None if there is none."""
        return self._recordings.get(name)

    def _cases(self) -> list[Json]:
        """Return the results so far, the worst first."""
        if self._folder is None or self._final is not None:
            return self._final or []
        from mirdrake.suites.run import load_suite

        ended = self._code is not None
        try:
            suite = load_suite(self._folder)
        except MirdrakeError:  # the suite has not written its folder yet
            return []
        folders = {result.name: self._folder / result.folder for result in suite.results if result.folder is not None}
        self._recordings = {
            name: folder / RECORDING for name, folder in folders.items() if (folder / RECORDING).is_file()
        }
        rows = [_row(case, result, recorded=result.name in self._recordings) for case, result in suite.ranked()]
        # The page asks repeatedly; the results after the end are kept for its next requests.
        self._final = rows if ended else None
        return rows

    def _read(self, process: "subprocess.Popen[str]", lines: list[str]) -> None:
        assert process.stdout is not None
        with process.stdout as output:
            lines.extend(line.rstrip() for line in output)  # as they come
        code = process.wait()
        if process is self._process:
            self._code = code


def _row(case: "Case", result: "Result", *, recorded: bool) -> Json:
    worst = result.worst
    # The reason of a failure has the margin.
    margin = ""
    if worst is not None and worst.margin is not None and not result.reason:
        margin = f"{worst.margin:+.3g} {worst.unit}".rstrip()
    return {
        "name": result.name, "verdict": result.verdict, "margin": margin, "recorded": recorded,
        "values": ", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                            for key, value in case.values.items()),
        "reason": result.reason or ("" if worst is None else worst.text),
    }  # fmt: skip
