"""Start of workers: effect of Ctrl-C at that moment, and what the server has loaded."""

import gc
import signal
import subprocess
import sys
import threading

import pytest

from mirdrake.execution.worker_server import METHOD, worker_start
from mirdrake.execution.workers import Workers


def test_a_ctrl_c_comes_behind_the_start_of_a_worker():
    """Whichever thread takes it; a worker whose parent is interrupted half way ends with a traceback."""
    go, done = threading.Event(), threading.Event()

    def take_it() -> None:
        go.wait()
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        done.set()

    threading.Thread(target=take_it, daemon=True).start()
    handler = signal.getsignal(signal.SIGINT)
    steps: list[int] = []

    def start() -> None:
        with worker_start():
            go.set()
            done.wait()
            steps.extend(range(1000))

    with pytest.raises(KeyboardInterrupt):
        start()
    assert len(steps) == 1000
    assert signal.getsignal(signal.SIGINT) is handler


def test_a_worker_does_not_know_ctrl_c():
    script = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))"
    with worker_start():
        output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "True"
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_a_worker_begins_with_the_runtime_of_machine_code_without_its_compiler_and_collects_garbage():
    workers = Workers(1, limit=60.0)
    try:
        # Loaded by the server, with the modules of the work; `eval` and `isenabled` can be sent to any process.
        modules = "[name in __import__('sys').modules for name in ('numba.core.runtime.nrt', 'numba.np.arraymath')]"
        loaded = workers.submit(eval, modules).result()
        collects = workers.submit(gc.isenabled).result()
        frozen = workers.submit(gc.get_freeze_count).result()
    finally:
        workers.shutdown()
    assert loaded == [METHOD == "forkserver", False]
    assert collects
    assert frozen > 100_000
