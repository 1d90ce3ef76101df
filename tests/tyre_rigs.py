"""A Bolt on brush and Magic Formula tyres, for the tests of tyre forces in the plant."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.core.paths import data_root
from mirdrake.plant.wheels import WheelTyres
from mirdrake.plant.wheels.motion import WheelMotion, base_motion, wheel_motion, wheel_places

BRUSH = """{kind: brush, rolling_resistance: 0, front: {nominal_load: 4000, longitudinal_stiffness: 88000,
    cornering_stiffness: 54400, friction: 1.0, friction_by_load: -0.1, peak_load: 8000, half_length: 0.06,
    relaxation_x: 0.22, relaxation_y: 0.39}}"""
MAGIC_FORMULA = "{kind: magic_formula, rolling_resistance: 0, file: 215_50R17.tir}"
COULOMB = "{kind: coulomb, rolling_resistance: 0}"
FREE = "control: {wheel_speed: {kind: pid, kp: 0}}"
"""Of a car whose wheels nothing drives or brakes but what the test connects."""

VARIANTS = {
    "brush": (BRUSH, ""),
    "magic_formula": (MAGIC_FORMULA, ""),
    "coulomb": (COULOMB, ""),
    "brush_free": (BRUSH, FREE),
    "magic_formula_free": (MAGIC_FORMULA, FREE),
}


def make_bolts(folder: Path) -> Path:
    """Return a copy of the Bolt with :data:`VARIANTS`; rolling resistance zero. Beside it a plane of dry asphalt."""
    model = folder / "bolt"
    shutil.copytree(data_root() / "models" / "bolt", model)
    for name, (tyres, rest) in VARIANTS.items():
        text = f"description: for tests\nvehicle: {{tyres: {tyres}}}\n{rest}\n"
        (model / "variants" / f"{name}.yaml").write_text(text, encoding="utf-8")
    (folder / "asphalt.yaml").write_text("mirdrake: world/1\nground: {surface: asphalt}\n", encoding="utf-8")
    return model


def make_slope(folder: Path, grade: float) -> Path:
    """Return an asphalt plane that rises ahead."""
    path = folder / "slope.yaml"
    path.write_text(f"mirdrake: world/1\nground: {{slope: {{grade: {grade}, heading: 0 deg}}}}\n", encoding="utf-8")
    return path


def on_tyres(
    model: str,
    *,
    speed: float = 0.0,
    command: float | None = None,
    steering: float = 0.0,
    torque: Sequence[float] | None = None,
    world: str | None = None,
    parked: bool = False,
    rate: float = 50.0,
    **plant: Any,
) -> Assembly:
    """Return a diagram with one car.

    Args:
        model: the vehicle.
        speed: at the start [m/s].
        command: commanded speed [m/s]; that of the start if left out.
        steering: commanded angle [rad].
        torque: drive torques, then brake torques of the wheels [N m].
        world: where; on the asphalt of :func:`make_bolts` if left out.
        parked: whether parking brakes hold it.
        rate: of the log [Hz].
        plant: plant settings; no air unless `air_density` is given.
    """
    vehicle = {"model": model, "speed": speed, "parked": parked, "start": {"x": 0, "y": 0}}
    spec: dict[str, Any] = {
        "world": world or str(Path(model).parent / "asphalt.yaml"),
        "vehicles": {"ego": vehicle},
        "control": {"ego": {"kind": "constant", "speed": speed if command is None else command, "steering": steering}},
        "plant": {"air_density": 0.0, **plant},
        "record": {"rate": rate},
    }
    if torque is not None:
        spec["systems"] = {"torque": {"kind": "constant", "value": list(torque)}}
        spec["connect"] = [["torque.y", "ego.wheel_torque"]]
    return assemble(spec)


class Watch:
    """A monitor that notes state and tyre forces of every step."""

    def __init__(self, assembly: Assembly) -> None:
        self._plant, self._tyres = assembly.parts.plant, assembly.tyres["ego"]
        self._places = wheel_places(assembly.parts.vehicles["ego"])
        self._period = assembly.parts.vehicles["ego"].period
        self.times: list[float] = []
        self.states: list[list[float]] = []
        self.forces: list[np.ndarray] = []

    def __call__(self, context: Context) -> None:
        self.times.append(context.get_time())
        plant_context = self._plant.GetMyContextFromRoot(context)
        self.states.append(self._plant.GetPositionsAndVelocities(plant_context).tolist())
        own = self._tyres.GetMyContextFromRoot(context)
        self.forces.append(np.array(self._tyres.tyre_forces.Eval(own)).reshape(4, 5))

    def motions(self, index: int) -> list[WheelMotion]:
        """Return the wheels' motions after a step."""
        return motions(self._plant.num_positions(), self.states[index], self._places, self._period)


def motions(positions: int, state: Sequence[float], places: Sequence[Any], period: float = 0.0) -> list[WheelMotion]:
    """Return motions of the wheels of one vehicle in a state of the plant with a time step [s]."""
    base = base_motion(state, places[0].base, positions, period)
    return [wheel_motion(state, wheel_place, base, positions) for wheel_place in places]


def steady_forces(tyres: WheelTyres, state: Sequence[float], *, steps: int = 4000) -> np.ndarray:
    """Return tyre forces (4, 5) of a car held in one state."""
    context = tyres.CreateDefaultContext()
    tyres.plant_state.FixValue(context, np.array(state))
    for _ in range(steps):
        updated = tyres.EvalUniquePeriodicDiscreteUpdate(context)
        context.get_mutable_discrete_state().SetFrom(updated)
    return np.array(tyres.tyre_forces.Eval(context)).reshape(4, 5)
