"""Load a vehicle folder in a separate process, which may crash without ending this one."""

import os
import subprocess
import sys
from pathlib import Path

from mirdrake.core.errors import ModelError
from mirdrake.importing.places import without_folder

SLOWEST = 600.0
"""Seconds after which loading is given up."""


def check_loads(folder: Path) -> None:
    """Load a vehicle folder in another process.

    Raises:
        ModelError: the vehicle cannot be loaded, or Drake crashed on it.
    """
    code, words = run_module("mirdrake.vehicles.loads", folder, seconds=SLOWEST)
    if code is None:
        raise ModelError(f"the imported vehicle does not load within {SLOWEST:g} s", where=folder.name)
    if code == 2 and words:
        raise ModelError(f"the imported vehicle does not load: {words}")
    if code != 0:
        raise ModelError(f"the imported vehicle crashes Drake (exit {code}){f': {words}' if words else ''}")


def run_module(module: str, folder: Path, *, seconds: float) -> tuple[int | None, str]:
    """Run a module with a vehicle folder as its argument in a separate process, which may crash or hang.

    Returns:
        the exit code, None if it was killed after so many seconds, and the last line of its errors, with files named
        from the folder on.
    """
    command = [sys.executable, "-m", module, str(folder)]
    package = str(Path(__file__).resolve().parents[3])
    paths = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPATH": paths}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return None, ""
    last = (done.stderr.strip().splitlines() or [""])[-1]
    return done.returncode, without_folder(last, folder)
