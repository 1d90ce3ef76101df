"""The complete check of a text in a separate process, so that the page answers meanwhile.

As a program, this module reads a JSON object with ``text`` and ``path`` and writes the faults as JSON.
"""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.json_io import Json
from mirdrake.editor.document import revision_of

WAIT = 1.0
"""Time without a change after which a text is checked [s]."""

TIME_LIMIT = 60.0
"""Time limit of a check [s]."""


class Checker:
    """Checks the latest text when it has not changed for :data:`WAIT`.

    Attributes:
        result: revision and faults of the last text that was checked; None before the first.
    """

    def __init__(self, path: Path) -> None:
        self.result: tuple[str, list[Json]] | None = None
        self._path, self._text, self._due = path, "", 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._changed, self._closed = threading.Event(), False
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="world check", daemon=True)
        self._thread.start()

    def check(self, text: str) -> None:
        """Check a text soon; a check of an earlier text is stopped."""
        with self._lock:
            self._text, self._due = text, time.monotonic() + WAIT
            # The result of an earlier text is of no use, and two checks at a time would slow each other down.
            self._stop()
        self._changed.set()

    def close(self) -> None:
        """Stop."""
        with self._lock:
            self._closed = True
            self._stop()
        self._changed.set()
        self._thread.join(timeout=5.0)

    def _stop(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.kill()

    def _work(self) -> None:
        while True:
            self._changed.wait()
            self._changed.clear()
            # Each change moves the time of the check, so a text is checked only when the typing pauses.
            while (wait := self._due - time.monotonic()) > 0.0 and not self._closed:
                time.sleep(min(wait, 0.1))
            # The lock keeps `check` from missing the process that is being started.
            with self._lock:
                if self._closed:
                    return
                text = self._text
                # -P: no module of the working directory may replace one of the standard library.
                command = [sys.executable, "-P", "-m", "mirdrake.editor.checker"]
                pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
                self._process = process = subprocess.Popen(command, **pipes)  # type: ignore[call-overload]
            job = json.dumps({"text": text, "path": str(self._path)}).encode()
            try:
                out, _ = process.communicate(job, timeout=TIME_LIMIT)
            except subprocess.TimeoutExpired:
                process.kill()
                out, _ = process.communicate()
                out = json.dumps([_unfinished()]).encode()
            # A process that was stopped has written nothing, and the text may have changed meanwhile.
            if text == self._text and out.strip():
                self.result = (revision_of(text), json.loads(out.splitlines()[-1]))


def _unfinished() -> Json:
    text = f"the check of goals and paths was not finished within {TIME_LIMIT:.0f} s; run `mirdrake world check`"
    return {"kind": "unchecked", "text": text, "names": [], "depth": None}


def _faults(job: Mapping[str, Any]) -> list[Json]:
    from mirdrake.editor.picture import error_json, fault_json
    from mirdrake.world_checks import examine
    from mirdrake.worlds.loading import parse_world

    path = Path(job["path"])
    try:
        return [fault_json(fault, path) for fault in examine(parse_world(str(job["text"]), path)).faults]
    except MirdrakeError as error:
        return error_json(error, path)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_faults(json.load(sys.stdin))) + "\n")
