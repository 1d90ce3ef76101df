"""Jobs memory and start-up: growth of the memory, import time and time to the first step."""

import gc
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from pydrake.systems.analysis import Simulator

from benchmarks.timing import resident_mb
from benchmarks.w1 import make_spec
from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.parts.taps import clear_logs
from mirdrake.runs.simulation import Simulation

WARM_UP = 5
"""Runs, or simulated seconds, before memory is read for the first time: caches and allocators fill up."""


FIRST_FOLDER = 60.0
"""Simulated time of the run into a folder that comes before the long one [s]."""


def run_memory(*, runs: int, run_duration: float, hour: float) -> dict[str, Any]:
    """Return the growth of the memory in RAM over many runs of one Simulation, and over one long drive.

    The long drive goes into a run folder. A short one into a folder comes before it and is given by itself, because the
    libraries that write are loaded there once. The same drive of the diagram alone shows what the simulation leaks.

    Args:
        runs: number of repeated runs.
        run_duration: of each [s].
        hour: simulated time of the long drive [s].
    """
    simulation = Simulation(assemble(make_spec("point", 0.010)))
    for _ in range(WARM_UP):
        simulation.run(duration=run_duration)
    gc.collect()
    before = resident_mb()
    for _ in range(runs):
        simulation.run(duration=run_duration)
    gc.collect()
    repeated = resident_mb() - before

    with tempfile.TemporaryDirectory() as folder:
        before = resident_mb()
        simulation.run(duration=min(FIRST_FOLDER, hour), folder=Path(folder) / "first")
        gc.collect()
        first = resident_mb() - before
        before = resident_mb()
        simulation.run(duration=hour, folder=Path(folder) / "run")
        gc.collect()
        whole = resident_mb() - before
        files = (Path(folder) / "run").rglob("*")
        written = sum(file.stat().st_size for file in files if file.is_file()) / 1e6
    return {
        "runs": runs,
        "growth_repeated_runs_mb": repeated,
        "long_drive_s": hour,
        "growth_first_run_folder_mb": first,
        "growth_long_drive_mb": whole,
        "growth_long_drive_bare_mb": _drive_without_run(hour),
        "run_folder_mb": written,
        "resident_mb": resident_mb(),
    }


def _drive_without_run(seconds: float) -> float:
    """Return the growth over a long drive of the diagram alone, its logs emptied as they fill [MB]."""
    assembly = assemble(make_spec("point", 0.010))
    context = assembly.make_context()
    simulator = Simulator(assembly.diagram, context)
    simulator.Initialize()
    now, before = 0.0, 0.0
    while now < WARM_UP + seconds:
        now += 1.0
        simulator.AdvanceTo(now)
        clear_logs(assembly.taps.values(), context)
        if now <= WARM_UP:
            gc.collect()
            before = resident_mb()
    gc.collect()
    return resident_mb() - before


def run_startup(*, repeat: int = 5) -> dict[str, Any]:
    """Return the time to import, and from the start of ``mirdrake run`` to its first step; fresh processes each time.

    The first step: a process runs the command's own code for a diagram whose duration is one step of the plant, into a
    run folder, without recording and report, and prints the clock when the simulation reports that step as done. The
    clock started in this process before that one was made.

    Args:
        repeat: number of processes for each figure.
    """
    empty = [_process("pass") for _ in range(repeat)]
    imports = [_process("import mirdrake") for _ in range(repeat)]
    steps = {contact: [_first_step(contact) for _ in range(repeat)] for contact in ("point", "hydroelastic")}
    return {
        "python_s": median(empty),
        "import_mirdrake_s": median(imports) - median(empty),
        "first_step_s": {contact: median(times) for contact, times in steps.items()},
    }


def _process(code: str) -> float:
    """Return the wall time of a Python process [s]."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ)
    return time.perf_counter() - began


_FIRST_STEP = """
import sys, time
import mirdrake.cli
import mirdrake.workflow as workflow
whole = workflow.run_diagram
def until_first_step(spec, **more):
    more["progress"] = lambda *_: print("step", time.time(), flush=True)
    return whole(spec, **more)
workflow.run_diagram = until_first_step
sys.exit(mirdrake.cli.main(sys.argv[1:]))
"""


def _first_step(contact: str) -> float:
    """From the start of the process to the end of its first step [s]."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["run", "w1", "--quiet", "--no-view", "--no-recording", "--no-report", "--duration", "0.005"]
        command += ["--out", f"{folder}/run", "--set", f"plant.contact={contact}"]
        began = time.time()
        done = subprocess.run(
            [sys.executable, "-c", _FIRST_STEP, *command], check=True, capture_output=True, text=True, env=os.environ
        )
    line = next(line for line in done.stdout.splitlines() if line.startswith("step "))
    return float(line.split()[1]) - began
