"""Common fixtures: the process state is restored after each test, plots are headless, data files can be damaged.

``--times FILE`` records the processor time of the tests. A test that took more than :data:`LONGEST` there is slow,
unless it is marked as essential; ``--quick`` runs only the files that took at most :data:`QUICK_FILE`.
"""

import gc
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import pytest

from mirdrake.cli import GARBAGE
from mirdrake.core import paths

# As in the command `mirdrake`: tests make many objects that stay, which need not be looked at again and again.
gc.set_threshold(GARBAGE, *gc.get_threshold()[1:])

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# A shell that starts the tests in the background has them ignore Ctrl-C, and so would all that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples in each run; a hang is a failure, a busy machine is not.
hypothesis.settings.register_profile(
    "mirdrake", derandomize=True, deadline=5000, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("mirdrake")


LONGEST = 1.5
"""Recorded processor time of a test up to which it is one of the fast tests [s]."""

QUICK_FILE = 0.4
"""Processor time of a test file up to which ``--quick`` runs it [s]."""

TIMES = Path(__file__).with_name("times.json")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--times", metavar="FILE", help="record the processor time of files and of slow tests [s]")
    parser.addoption("--quick", action="store_true", help=f"run only files that took at most {QUICK_FILE:g} s")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files that take long, with --quick; a file that is not recorded yet is run."""
    if not config.getoption("--quick") or collection_path.suffix != ".py":
        return None
    recorded = json.loads(TIMES.read_text(encoding="utf-8"))["files"]
    return True if recorded.get(collection_path.name, 0.0) > QUICK_FILE else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests as slow by their recorded times, before pytest chooses by marks; none while times are recorded.

    Files that take longest come first, so that all workers end at about the same time.
    """
    recorded = json.loads(TIMES.read_text(encoding="utf-8"))
    left = dict(recorded["files"])
    for item in items if not config.getoption("--times") else ():
        seconds = recorded["tests over 1 s"].get(item.nodeid, 0.0)
        if seconds > LONGEST and "essential" not in item.keywords:
            item.add_marker(pytest.mark.slow)
            left[item.path.name] -= seconds
    items.sort(key=lambda item: (-left.get(item.path.name, 0.0), item.path.name))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Attach the processor time of this process and of its children to the last report of a test."""
    if call.when == "setup":
        item.stash[_BEGAN] = getattr(item.config, "_processor_time", 0.0)
    outcome = yield
    if call.when == "teardown":
        now = sum(os.times()[:4])
        outcome.get_result().user_properties.append(("processor_s", now - item.stash[_BEGAN]))  # type: ignore[attr-defined]
        item.config._processor_time = now  # type: ignore[attr-defined]


_BEGAN = pytest.StashKey[float]()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Start the clock of the first test after all imports, which belong to no test.

    What imports and collection have made stays to the end, so no collection of garbage looks at it again.
    """
    gc.freeze()
    session.config._processor_time = sum(os.times()[:4])  # type: ignore[attr-defined]


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    for name, value in report.user_properties:
        if report.when == "teardown" and name == "processor_s":
            _RECORDED[report.nodeid] = float(str(value))


_RECORDED: dict[str, float] = {}


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the times, unless this is a worker of pytest-xdist."""
    target = session.config.getoption("--times")
    if target is None or hasattr(session.config, "workerinput"):
        return
    files: dict[str, float] = {}
    for name, seconds in _RECORDED.items():
        file = Path(name.partition("::")[0]).name
        files[file] = files.get(file, 0.0) + seconds
    slow = {name: round(seconds, 1) for name, seconds in sorted(_RECORDED.items()) if seconds > 1.0}
    data = {"files": {name: round(seconds, 1) for name, seconds in sorted(files.items())}, "tests over 1 s": slow}
    Path(target).write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@pytest.fixture(scope="session", autouse=True)
def _private_caches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Use private caches, as the home folder may be read-only; machine code is compiled once for all workers."""
    folder = tmp_path_factory.getbasetemp()
    common = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MPLCONFIGDIR", str(tmp_path_factory.mktemp("matplotlib")))
        patch.setenv("XDG_CACHE_HOME", str(common / "cache"))
        yield


@pytest.fixture(autouse=True)
def _process_as_found() -> Iterator[None]:
    """Check that each test restores environment, working directory and sys.path.

    This fixture is set up first and torn down last, so what `monkeypatch` changes is undone before the check.
    """
    environment, folder, path = _environment(), Path.cwd(), list(sys.path)
    yield
    assert _environment() == environment, "the test changed os.environ; use monkeypatch.setenv"
    assert Path.cwd() == folder, "the test changed the working directory; use monkeypatch.chdir"
    assert sys.path == path, "the test changed sys.path; use monkeypatch.syspath_prepend"


def _environment() -> dict[str, str]:
    return {key: value for key, value in os.environ.items() if key != "PYTEST_CURRENT_TEST"}


@pytest.fixture
def corrupted_copy(tmp_path: Path) -> Callable[[str, str, str], Path]:
    """A function (file below data_root(), old text, new text) -> copy of that file with the one change, in tmp_path."""

    def copy(name: str, old: str, new: str) -> Path:
        source = paths.data_root() / name
        text = source.read_text(encoding="utf-8")
        assert text.count(old) == 1, f"'{old}' is {text.count(old)} times in {name}; once is needed"
        target = tmp_path / source.name
        target.write_text(text.replace(old, new), encoding="utf-8")
        return target

    return copy
