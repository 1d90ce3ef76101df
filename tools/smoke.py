"""Smoke test of an installation: a vehicle is checked, a diagram is run twice with equal signals, a drawing is made.

python tools/smoke.py
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

RUN = ("run", "bolt_test_track", "--set", "duration=2", "--quiet", "--no-report", "--no-recording", "--out")


def main() -> int:
    """Run the commands; 1 if one of them fails or the runs differ."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for words in (
            ("--version",),
            ("check", "bolt", "bolt_test_track"),
            ("inspect", "unior"),
            (*RUN, str(folder / "one")),
            (*RUN, str(folder / "two")),
            ("export", str(folder / "one"), "--to", "csv"),
        ):
            command = [sys.executable, "-m", "mirdrake.cli", *words]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            print(f"{'ok' if done.returncode == 0 else 'FAILED'}: mirdrake {' '.join(words)}")
            if done.returncode != 0:
                print(done.stdout + done.stderr)
                return 1
        first_run, second_run = (pd.read_parquet(folder / run / "signals.parquet") for run in ("one", "two"))
        if not first_run.equals(second_run):
            print("FAILED: the signals of two runs of one diagram differ")
            return 1
    print(f"ok: Python {sys.version.split()[0]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
