"""Progress: a bar in a terminal, a line every ten seconds elsewhere."""

import io
import threading

import pytest

from mirdrake.core.progress import Progress, still_working


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The monotonic time that Progress sees, as the only element of a list."""
    time = [0.0]
    monkeypatch.setattr("mirdrake.core.progress.time.monotonic", lambda: time[0])
    return time


def test_redirected_output_gets_a_line_every_ten_seconds(clock: list[float]) -> None:
    stream = io.StringIO()
    with Progress("sweep", 40, "runs", stream=stream) as bar:
        for done in range(1, 41):
            clock[0] += 0.75
            bar.update(done, text="1 failed" if done >= 20 else "")
    assert stream.getvalue().splitlines() == [
        "sweep: 14 of 40 runs",
        "sweep: 28 of 40 runs, 1 failed",
    ]


def test_short_work_and_quiet_work_print_nothing(clock: list[float]) -> None:
    stream = io.StringIO()
    with Progress("sweep", 40, "runs", stream=stream) as bar:
        bar.update(20)
    with Progress("sweep", 40, "runs", quiet=True, stream=stream) as bar:
        clock[0] += 100.0
        bar.update(20)
    assert stream.getvalue() == ""


def test_a_terminal_gets_a_bar_that_is_removed_at_the_end() -> None:
    stream = Terminal()
    with Progress("drive", 20.0, "s", stream=stream) as bar:
        bar.update(5.0, text="3.2 x real time")
        bar.write("warning: a line above the bar")
    text = stream.getvalue()
    assert "drive:  25% |" in text
    assert "5/20 s" in text
    assert "3.2 x real time" in text
    assert "warning: a line above the bar\n" in text
    assert text.rstrip(" ").endswith("\r")


def test_work_of_unknown_length_shows_its_text() -> None:
    stream = Terminal()
    with Progress("fit", stream=stream) as bar:
        bar.update(text="checking the data")
        bar.update(title="2/5 fit", text="stage tyres")
    assert "fit, checking the data" in stream.getvalue()
    assert "2/5 fit, stage tyres" in stream.getvalue()


def test_work_without_a_measure_prints_its_time_where_output_is_redirected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mirdrake.core.progress.LINE_INTERVAL", 0.01)
    printed = threading.Event()

    class Stream(io.StringIO):
        def write(self, text: str) -> int:
            printed.set()
            return super().write(text)

    stream = Stream()
    with still_working("export", stream=stream):
        assert printed.wait(5.0)
    assert stream.getvalue().startswith("export: 0 s\n")
    with still_working("export", stream=Terminal()):
        assert not any(thread.name == "still working" for thread in threading.enumerate())
