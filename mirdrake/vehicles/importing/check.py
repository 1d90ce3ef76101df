"""Loads a vehicle folder in a process of its own, which may crash in the caller's place."""

import os
import subprocess
import sys
from pathlib import Path

from mirdrake.errors import MirdrakeError, ModelError
from mirdrake.yaml_io import shown

SLOWEST = 600.0
"""Seconds after which loading is given up."""


def check_loads(folder: Path) -> None:
    """Load a vehicle folder in another process.

    Raises:
        ModelError: it cannot be loaded, or Drake crashed on it.
    """
    command = [sys.executable, "-m", __name__, str(folder)]
    package = str(Path(__file__).resolve().parents[3])
    paths = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
    try:
        done = subprocess.run(
            command,
            env=os.environ | {"PYTHONPATH": paths},
            capture_output=True,
            text=True,
            timeout=SLOWEST,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ModelError(f"{folder.name}: the imported vehicle does not load within {SLOWEST:g} s") from None
    if done.returncode == 0:
        return
    lines = done.stderr.strip().splitlines()
    if done.returncode == 2 and lines:
        reason = lines[-1].replace(f"{shown(folder)}{os.sep}", "").replace(f"{folder}{os.sep}", "")
        raise ModelError(f"the imported vehicle does not load: {reason}")
    last = f": {lines[-1]}" if lines else ""
    raise ModelError(f"the imported vehicle crashes Drake (exit {done.returncode}){last}")


def main() -> int:
    """Load the folder that the command line names."""
    from mirdrake.vehicles.vehicle import load_vehicle, variants

    folder = Path(sys.argv[1])
    try:
        load_vehicle(str(folder))
        for variant in variants(folder):
            load_vehicle(f"{folder}@{variant}")
    except MirdrakeError as error:
        sys.stderr.write(f"{str(error).splitlines()[0]}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
