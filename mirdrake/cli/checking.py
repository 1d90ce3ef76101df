"""Check of a vehicle folder: all its faults, and whether the vehicle stays at rest."""

import contextlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.core.errors import ConfigError, MirdrakeError, ModelError, closest
from mirdrake.core.paths import resolved
from mirdrake.core.xml_reader import parse_xml
from mirdrake.core.yaml_io import display_path, where
from mirdrake.manoeuvres.published import FILE as PUBLISHED
from mirdrake.manoeuvres.published import read_published
from mirdrake.plant.plant import make_plant, set_start
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.inspect_urdf import find_faults, resolve_meshes
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.spec import ControlSpec, VehicleSpec
from mirdrake.vehicles.vehicle import (
    FILES,
    MAIN_FILE,
    VARIANT_MARK,
    find_vehicle,
    load_part,
    load_variant,
    variants,
    with_drive,
)
from mirdrake.vehicles.xacro_render import render_xacro
from mirdrake.worlds import load_world

STANDING = 1.0
"""Duration of the test at rest [s]."""

MOST_TRAVEL, MOST_TILT = 0.02, math.radians(3.0)
"""Largest displacement during that test, in wheelbases, and largest tilt [rad]; springs may settle."""


@dataclass
class Findings:
    """Findings of a check.

    Attributes:
        faults: invalid input, with file and line.
        failures: defects of a vehicle whose files are valid, for example that it does not stay at rest; a line each.
        remarks: warnings, which are not faults; a line each.
    """

    faults: list[MirdrakeError] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Collect the faults that the block raises, and continue after it."""
        try:
            yield
        except MirdrakeError as error:
            self.note(error.faults)

    def note(self, faults: Iterable[MirdrakeError]) -> None:
        """Store faults without duplicates.

        Macros repeat the fault of a line with other names, variants that of a key with other allowed values; the first
        is kept.
        """
        known = {_identity(fault) for fault in self.faults}
        for fault in faults:
            if (identity := _identity(fault)) not in known:
                known.add(identity)
                self.faults.append(fault)


def _identity(fault: MirdrakeError) -> tuple[object, ...]:
    """Return what two faults share if one is a repetition."""
    if fault.line is None:
        return fault.where, fault.text
    return (fault.file, fault.line, fault.code, () if isinstance(fault, ModelError) else fault.path)


def check_vehicle(name: str) -> Findings:
    """Check the files of a vehicle, and that it stays at rest; without ``@<variant>`` all of its variants as well.

    Raises:
        ConfigError: no such vehicle.
    """
    path = Path(name).parent if Path(name).name in FILES else Path(name)
    folder, only = (resolved(path), None) if any(map(Path.is_file, map(path.joinpath, FILES))) else find_vehicle(name)
    faults = Findings()
    faults.note([*_layout(folder), *_not_xml(folder)])
    if (figures := folder / PUBLISHED).is_file():
        with faults.caught():
            read_published(figures)
    for variant in [only] if only is not None else [None, *variants(folder)]:
        own = Findings()
        with own.caught():
            _check_files(folder, variant, own)
        faults.note(own.faults)
        # The faults of the vehicle itself would be repeated by each of its variants.
        if not own.faults and not faults.failures and next(_not_xml(folder), None) is None:
            with faults.caught():
                vehicle = load_vehicle(str(folder) if variant is None else f"{folder}{VARIANT_MARK}{variant}")
                faults.remarks += [line for line in vehicle.warnings if line not in faults.remarks]
                faults.failures += [f"{vehicle.name}: {line}" for line in _restless(vehicle)]
    return faults


def _layout(folder: Path) -> Iterator[MirdrakeError]:
    """Return the faults of missing files, each with the most similar name that exists."""
    entries = sorted(path.name for path in folder.iterdir() if path.name not in FILES)
    for name in FILES:
        if not (folder / name).exists():
            near = closest(name, entries)
            hint = f"; is it '{near}'?" if near else ""
            yield ConfigError(f"no such file{hint}", file=display_path(folder / name), code="no_such_file")


def _not_xml(folder: Path) -> Iterator[MirdrakeError]:
    """Return the faults of files that are not XML; xacro would stop at the first of them."""
    for path in sorted(folder.glob("*.xacro")):
        if path.is_file():
            try:
                parse_xml(path.read_bytes(), display_path(path), error=ModelError)
            except ModelError as error:
                yield error


def _check_files(folder: Path, variant: str | None, missing: Findings) -> None:
    """Store the faults of the YAML files, of the xacro files, and of the URDF compared with the YAML files."""
    # Each part is loaded by itself, so that a fault of one does not hide those of the others.
    change = load_variant(folder, variant)
    spec = sensors = urdf = None
    with missing.caught():
        spec = load_part(folder, "vehicle", VehicleSpec, change)
    with missing.caught():
        load_part(folder, "control", ControlSpec, change)
    with missing.caught():
        sensors = load_part(folder, "sensors", SensorsSpec, change)
    location = where(change, "arguments") if variant is not None else ""
    if spec is not None and "drive" in change.arguments:
        with missing.caught():
            spec = with_drive(spec, change.arguments["drive"], location)
    # The renderer could not name the place of a fault in a file that is not XML.
    if next(_not_xml(folder), None) is not None:
        return
    with missing.caught():
        defaults = {"drive": spec.drive} if spec is not None else {}
        urdf = render_xacro(folder / MAIN_FILE, arguments=change.arguments, defaults=defaults, where=location)
    if urdf is not None:
        missing.note(find_faults(urdf, spec=spec, sensors=sensors))
        with missing.caught():
            resolve_meshes(urdf, folder)


def _restless(vehicle: Vehicle) -> Iterator[str]:
    """Return how a vehicle without input moves on level ground with its wheels free; None if it stays at rest."""
    # The plant as in a simulation, on level ground, without controllers.
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {"ego": vehicle})
    plant, part = parts.plant, parts.vehicles["ego"]
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    ahead = float(plant.CalcCenterOfMassPositionInWorld(context, [part.instance])[0])
    # Free wheels do not prevent this fall, which would otherwise be reported as a divergence.
    if not 0.0 < ahead < vehicle.geometry.wheelbase:
        yield f"tips over: its centre of mass is {ahead:.3g} m ahead of the rear axle, not between the axles"
        return
    ports = plant.get_actuation_input_port(part.instance), plant.get_desired_state_input_port(part.instance)
    try:
        set_start(plant, context, part, x=0.0, y=0.0, yaw=0.0)
        for port in ports:
            port.FixValue(context, np.zeros(port.size()))
        simulator.AdvanceTo(STANDING)
    except (RuntimeError, SystemExit) as error:  # a failed assertion in Drake arrives as SystemExit
        yield f"cannot be simulated: {' '.join(str(error).split())}"
        return
    X_WB = part.base.EvalPoseInWorld(context)
    travel = float(np.linalg.norm(X_WB.translation()))
    tilt = math.acos(min(max(float(X_WB.rotation().matrix()[2, 2]), -1.0), 1.0))
    if not travel <= MOST_TRAVEL * vehicle.geometry.wheelbase:
        yield f"does not stay at rest: it moves by {travel:.3g} m in {STANDING:g} s"
    if not tilt <= MOST_TILT:
        yield f"does not stay upright: it tilts by {math.degrees(tilt):.3g} degrees in {STANDING:g} s"
