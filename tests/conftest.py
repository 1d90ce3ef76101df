"""What all tests share: each leaves the process as it found it, plots stay headless, data files can be damaged."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import pytest

from mirdrake.core import paths

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


@pytest.fixture(scope="session", autouse=True)
def _private_caches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Caches of its own: the home folder may be read-only, and several processes may write there at once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MPLCONFIGDIR", str(tmp_path_factory.mktemp("matplotlib")))
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def _process_as_found() -> Iterator[None]:
    """Environment, working directory and sys.path are after each test what they were before it.

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
        assert text.count(old) == 1, f"'{old}' stands {text.count(old)} times in {name}; once is needed"
        target = tmp_path / source.name
        target.write_text(text.replace(old, new), encoding="utf-8")
        return target

    return copy
