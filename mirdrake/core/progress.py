"""Progress of long work on standard error: a bar in a terminal, a line every ten seconds elsewhere."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self, TextIO

LINE_INTERVAL = 10.0
"""Time between two lines where standard error is not a terminal [s]."""

_BAR = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f}/{total:.0f} {unit}, {remaining} left{postfix}"
_TEXT = "{desc}{postfix}"


@contextmanager
def still_working(title: str, *, stream: TextIO | None = None) -> Iterator[None]:
    """Print a line every :data:`LINE_INTERVAL` during work that cannot state how far it is, where output is redirected.

    Args:
        title: what is being done.
        stream: where to print; standard error by default.
    """
    stream, over, begin = stream or sys.stderr, threading.Event(), time.monotonic()

    def print_lines() -> None:
        while not over.wait(LINE_INTERVAL):
            print(f"{title}: {time.monotonic() - begin:.0f} s", file=stream, flush=True)

    # A terminal has a progress bar of the command itself.
    if stream.isatty():
        yield
        return
    thread = threading.Thread(target=print_lines, name="still working", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


class Progress:
    """Progress of one piece of work; use it in a ``with`` statement.

    In a terminal it is a bar (a line without a bar where the total is not known) that is removed at the end. Where
    standard error is redirected it is a plain line every :data:`LINE_INTERVAL`, so that short work prints nothing.

    Args:
        title: what is being done.
        total: amount of work in ``unit``; None if it is not known.
        unit: unit of the amount, such as "s" or "runs".
        quiet: print nothing.
        stream: where to print; standard error by default.
    """

    def __init__(
        self,
        title: str,
        total: float | None = None,
        unit: str = "",
        *,
        quiet: bool = False,
        stream: TextIO | None = None,
    ) -> None:
        self._stream = stream if stream is not None else sys.stderr
        self._quiet = quiet
        self._terminal = not quiet and self._stream.isatty()
        self._title, self._unit = title, unit
        self._done, self._total, self._text = 0.0, total, ""
        # Monotonic, as the wall clock may be set back during long work.
        self._last_line = time.monotonic()
        self._bar = self._make_bar() if self._terminal else None

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the bar."""
        self.close()

    def update(
        self,
        done: float | None = None,
        *,
        total: float | None = None,
        title: str | None = None,
        text: str | None = None,
    ) -> None:
        """Show the progress of the work.

        Args:
            done: amount of work that is done, from 0 to the total.
            total: a new total; a change of it starts a new bar.
            title: a new title.
            text: remark behind the bar, such as counts of failures.
        """
        # A bar of tqdm keeps its total and start time, so a new total needs a new bar.
        restarted = total is not None and total != self._total
        self._done = self._done if done is None else done
        self._total = self._total if total is None else total
        self._title = self._title if title is None else title
        self._text = self._text if text is None else text
        if self._bar is not None:
            if restarted:
                self._bar.close()
                self._bar = self._make_bar()
            # Without refresh: one redraw per update instead of three.
            self._bar.set_description_str(self._title, refresh=False)
            self._bar.set_postfix_str(self._text, refresh=False)
            # A count above the total would break the bar.
            self._bar.n = min(self._done, self._total) if self._total is not None else self._done
            self._bar.refresh()
        elif not self._quiet and time.monotonic() - self._last_line >= LINE_INTERVAL:
            self._last_line = time.monotonic()
            print(self._line(), file=self._stream, flush=True)

    def write(self, line: str) -> None:
        """Print a line above the bar; it is printed also if the progress is quiet."""
        if self._bar is not None:
            self._bar.write(line, file=self._stream)
        else:
            print(line, file=self._stream, flush=True)

    def write_out(self, text: str) -> None:
        """Print text on standard output, above the bar if there is one."""
        if self._bar is not None:
            self._bar.clear()
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()
        if self._bar is not None:
            self._bar.refresh()

    def close(self) -> None:
        """Remove the bar; nothing more is shown."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        # Later messages of threads that still run must not appear behind the result.
        self._quiet = True

    def _make_bar(self) -> Any:
        from tqdm import tqdm  # its import takes 30 ms, which delays short commands

        return tqdm(
            total=self._total,
            unit=self._unit,
            desc=self._title,
            initial=0,
            leave=False,
            file=self._stream,
            bar_format=_BAR if self._total else _TEXT,
        )

    def _line(self) -> str:
        amount = f": {self._done:.0f} of {self._total:.0f} {self._unit}".rstrip() if self._total else ""
        return f"{self._title}{amount}{f', {self._text}' if self._text else ''}"
