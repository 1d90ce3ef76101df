"""First steps of a simulation with a car, in a separate process because some worlds end the process.

As a program it reads a JSON text as its argument, ``{"world": path, "overrides": [text, ...], "vehicle": name, "start":
name}``, and writes a line of JSON: ``{"fault": ""}``, or the reason of the failure.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from mirdrake.core.drake_errors import is_solver_failure
from mirdrake.world_checks import sentences
from mirdrake.world_checks.faults import Fault
from mirdrake.worlds import World

STEPS = 20
TIME_LIMIT = 120.0
"""Wall time limit of the first steps [s]."""

COMMAND: tuple[str, ...] = (sys.executable, "-m", "mirdrake.world_checks.first_steps")
"""Command of the process."""

_FASTEST = 30.0  # [m/s] of a body at rest, or in free fall for a tenth of a second
_ROOT = str(Path(__file__).resolve().parents[2])
_LIGHT, _HEAVY, _SMALL, _LARGE = 1e-3, 1e5, 5e-3, 200.0  # [kg], [m] usual masses and sizes of bodies for Drake's solver


def find_first_step_fault(world: World, overrides: tuple[str, ...], vehicle: str) -> list[Fault]:
    """Return the fault of the first steps with a car at the first start, if they fail.

    Args:
        world: the world, from a file.
        overrides: overrides of the file.
        vehicle: name of the car.
    """
    if world.path is None:
        return []
    job = {"world": str(world.path.resolve()), "overrides": overrides, "vehicle": vehicle,
           "start": next(iter(world.starts))}  # fmt: skip
    # The process imports mirdrake from the same place, also if it is not installed.
    paths = os.pathsep.join(filter(None, [_ROOT, os.environ.get("PYTHONPATH", "")]))
    command = [*COMMAND, json.dumps(job)]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=TIME_LIMIT, check=False, env={**os.environ, "PYTHONPATH": paths}
        )
    except subprocess.TimeoutExpired:
        reason = f"{STEPS} steps take longer than {TIME_LIMIT:.0f} s"
    except OSError as error:
        reason = f"no process can be started: {error.strerror or error}"
    else:
        reason = _reason(done.stdout.decode(errors="replace"), done.returncode)
    if not reason:
        return []
    message = sentences.first_steps(vehicle, next(iter(world.starts)), reason, _advice(world))
    return [Fault("first_steps", message, world.path.name)]


def _reason(out: str, code: int) -> str:
    # Libraries may print lines of their own before the answer.
    for line in reversed(out.splitlines()):
        try:
            message = json.loads(line)
        except ValueError:
            continue
        if isinstance(message, dict) and isinstance(message.get("fault"), str):
            return str(message["fault"])
    # A negative return code is the number of a signal (POSIX).
    return f"the process ended with {f'signal {-code}' if code < 0 else f'exit code {code}'}"


def _advice(world: World) -> str:
    """Return advice: bodies of extreme size or mass, else all bodies."""
    # Extreme mass ratios and tiny bodies are what the contact solver cannot resolve.
    unusual = []
    for placed in world.props:
        sides = [*np.ptp(np.concatenate([solid.corners for solid in placed.prop.solids]), axis=0)]
        extreme = not _LIGHT <= placed.prop.mass <= _HEAVY or min(sides) < _SMALL or max(sides) > _LARGE
        if not placed.static and extreme:
            unusual.append(
                f"'{placed.name}' ({placed.prop.mass:.3g} kg, {' x '.join(f'{side:.3g}' for side in sides)} m)"
            )
    if unusual:
        names = f"{', '.join(unusual[:4])}{' …' * (len(unusual) > 4)}"
        return f"make these props static, or give them a usual size and mass: {names}"
    loose = [placed.name for placed in world.props if not placed.static]
    if loose:
        return f"make props static that overlap or touch others, among: {', '.join(loose[:4])}{' …' * (len(loose) > 4)}"
    return "check for props of extreme size, or without a volume"


# --- the program --------------------------------------------------------------------------------------------------


def main() -> None:
    """Simulate the steps of the job in the argument."""
    job = json.loads(sys.argv[1])
    try:
        fault = _step(job["world"], job["overrides"], job["vehicle"], job["start"])
    except (RuntimeError, ValueError) as error:  # texts of Drake do not name the prop
        fault = "Drake's solver does not converge" if is_solver_failure(str(error)) else "Drake cannot step the plant"
    sys.stdout.write(json.dumps({"fault": fault}) + "\n")


def _step(path: str, overrides: list[str], vehicle: str, start_name: str) -> str:
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    from mirdrake.plant.plant import make_plant, set_start
    from mirdrake.vehicles import load_vehicle
    from mirdrake.worlds import load_world

    world = load_world(path, overrides=overrides)
    builder = DiagramBuilder()
    parts = make_plant(builder, world, {"car": load_vehicle(vehicle)}, parked=("car",))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = parts.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = world.starts[start_name]
    set_start(parts.plant, context, parts.vehicles["car"], x=start.x, y=start.y, yaw=start.yaw)
    parts.props.reset(parts.plant, context)
    simulator.AdvanceTo(STEPS * parts.plant.time_step())
    for name, body in {"the car": parts.vehicles["car"].base, **parts.props.bodies}.items():
        speed = float(np.linalg.norm(parts.plant.EvalBodySpatialVelocityInWorld(context, body).translational()))
        # The comparison is false for NaN, too.
        if not speed <= _FASTEST:
            shown = f"{speed:.3g} m/s" if np.isfinite(speed) else "no finite speed"
            return f"{name if name == 'the car' else f'prop {name!r}'} has {shown} after {STEPS} steps"
    return ""


if __name__ == "__main__":
    main()
