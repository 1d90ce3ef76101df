"""The complete workflow in one call: simulate, then write the recording and the report."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat

from mirdrake.assembly.diagram import DiagramSpec, assemble
from mirdrake.assembly.drawing import draw_svg, write_dot
from mirdrake.assembly.scene import Scene
from mirdrake.core.errors import MissingDependencyError
from mirdrake.core.files import write_file
from mirdrake.runs.logs import Run
from mirdrake.runs.simulation import Progress, Report, Simulation, default_folder
from mirdrake.viewer import FollowCamera, write_recording


def run_diagram(
    spec: DiagramSpec | Mapping[str, Any] | str,
    *,
    scene: Scene | None = None,
    folder: Path | None = None,
    duration: float | None = None,
    meshcat: Meshcat | None = None,
    realtime_rate: float = 0.0,
    progress: Progress | None = None,
    print_line: Callable[[str], None] | None = None,
    report: Report | None = None,
) -> Run:
    """Run a diagram into a run folder with all its files.

    Args:
        spec: a diagram spec, its data or its name.
        scene: scene of the spec, if it is made already.
        folder: run folder; ``runs/<name>-<UTC time>`` if left out.
        duration: simulated time [s]; the spec's if left out.
        meshcat: Meshcat instance that shows the run.
        realtime_rate: 1 for real time, 0 for as fast as possible.
        progress: see :func:`mirdrake.runs.simulation.simulate`.
        print_line: prints a progress message of one line.
        report: see :meth:`mirdrake.runs.simulation.Simulation.run`.

    Raises:
        MirdrakeError: the diagram is invalid or the run failed; the message has one line.
    """
    print_message = print_line or (lambda _: None)
    assembly = assemble(spec, meshcat=meshcat, scene=scene)
    folder = folder or default_folder(assembly.spec.name)
    monitor = FollowCamera(meshcat, assembly) if meshcat is not None else None
    run = Simulation(assembly).run(
        duration=duration,
        folder=folder,
        realtime_rate=realtime_rate,
        progress=progress,
        monitor=monitor,
        report=report,
    )
    # Two files for the drawing: the DOT text needs no package, the picture does.
    record = assembly.spec.record
    svg = None
    write_file(folder / "diagram.dot", write_dot(assembly))
    try:
        svg = draw_svg(assembly)
        write_file(folder / "diagram.svg", svg)
    except MissingDependencyError as error:
        print_message(str(error))
    if record.meshcat and not run.signals.empty:
        print_message("writing the recording")
        write_recording(run, frames_per_second=record.frames)
    if record.report:
        print_message("writing the report")
        from mirdrake.report import write_report  # Matplotlib takes half a second: not before the first step

        write_report(run, diagram_svg=svg)
    return run
