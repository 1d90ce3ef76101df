"""Provenance of a run in spec.yaml, and its figures in summary.json."""

import math
import platform
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydrake.systems.framework import System

from mirdrake.assembly.diagram import Assembly
from mirdrake.assembly.scene import Scene
from mirdrake.controllers.schedule import ScheduleSpec
from mirdrake.core.digest import digest_data
from mirdrake.core.json_io import Json
from mirdrake.core.paths import installed_version
from mirdrake.core.vectors import WHEELS
from mirdrake.runs.incidents import Incident
from mirdrake.runs.stop import Stop
from mirdrake.runs.telemetry import Array
from mirdrake.runs.wheel_oscillation import find_wheel_oscillation

VEHICLE_FIGURES = (
    "laps", "max_abs_lateral_error_m", "mean_speed_error_percent", "off_road_s", "distance_m", "max_speed_mps",
)  # fmt: skip
"""Figures of each vehicle in summary.json."""

STRAIGHT = 1e-4
"""Curvature below which a track counts as straight [1/m]."""

MISSED_SHARE, MISSED_LEAST, MISSED_TIME = 0.1, 0.1, 5.0
"""A speed set-point is missed if the error exceeds this share of it [1] and this speed [m/s] for this time [s]."""

STEADY = 2.0
"""Time for which a command must have been constant to count as steady [s]."""


def resolved_spec(assembly: Assembly, *, duration: float) -> Json:
    """Return the spec with all defaults, digests of its models and worlds, and versions: enough to repeat a run."""
    data = assembly.spec.model_dump(mode="json")
    data["duration"] = duration
    # The provenance of a replayed spec.yaml is that of an older run and must not enter the new digest.
    data.pop("provenance", None)
    folder = data.pop("folder", None)  # the digest is that of the contents, in whatever folder
    vehicles = {name: part.vehicle for name, part in assembly.parts.vehicles.items()}
    content = scene_hashes(Scene(assembly.parts.world, vehicles))
    # Content outside the spec that changes the result: command files, source of user systems, weights of networks.
    for name, driver in assembly.spec.control.items():
        if isinstance(driver, ScheduleSpec) and driver.file is not None:
            content[f"{name}.commands"] = digest_data({"rows": driver.schedule().rows})
    for name, system in assembly.user_systems().items():
        content[name] = digest_data({"source": _source_text(system)})
    for name, entry in assembly.spec.systems.items():
        if entry.kind == "network":
            content[name] = assembly.diagram.GetSubsystemByName(name).sha256
    digest = digest_data({"spec": data, "content": content})
    # The folder is needed to find relative paths again, so it returns after the digest was computed.
    if folder is not None:
        data["folder"] = folder
    data["provenance"] = {"spec_sha256": digest, "content_sha256": content, "versions": dict(_versions())}
    return data


@cache
def _versions() -> Mapping[str, str]:
    """Return the versions of the packages that compute a run; reading them takes a millisecond."""
    packages = {name: installed_version(name) or "not installed" for name in ("mirdrake", "drake", "numpy")}
    return packages | {"python": platform.python_version()}


def scene_hashes(scene: Scene) -> dict[str, str]:
    """Return the hashes of the contents of the files of vehicles and world, by the vehicles' names and ``world``."""
    hashes = {
        name: digest_data(
            {
                "urdf": vehicle.urdf,
                "spec": vehicle.spec.model_dump(mode="json"),
                "control": vehicle.control.model_dump(mode="json"),
                "sensors": vehicle.sensors.model_dump(mode="json"),
            }
        )
        for name, vehicle in scene.vehicles.items()
    }
    return hashes | {"world": digest_data(scene.world.spec.model_dump(mode="json"))}


def changed_since(scene: Scene, provenance: Mapping[str, Any] | None) -> list[str]:
    """Return the vehicles whose files have changed, and ``world``, since the run whose provenance is given.

    Args:
        scene: present scene.
        provenance: provenance of the spec.yaml of that run; None if the spec is not of a run.
    """
    before = (provenance or {}).get("content_sha256") or {}
    now = scene_hashes(scene)
    return [name for name in now if name in before and before[name] != now[name]]


def _source_text(system: System) -> str:
    """Return the source of the file that defines a user's class; empty for a class without a file."""
    module = sys.modules.get(type(system).__module__)
    file = getattr(module, "__file__", None)
    return Path(file).read_text(encoding="utf-8", errors="replace") if file and file.endswith(".py") else ""


def make_summary(
    assembly: Assembly,
    data: Mapping[str, Any],
    signals: pd.DataFrame,
    *,
    simulated: float,
    wall: float,
    stop: Stop,
    incidents: Sequence[Incident] = (),
) -> dict[str, object]:
    """Return the content of summary.json."""
    vehicles = {}
    for name, part in assembly.parts.vehicles.items():
        # Rounded, since the last digits of a time of impact mean nothing.
        collisions = [
            {"time": round(incident.time, 6), "with": incident.other, "speed_mps": round(incident.speed, 3)}
            | ({} if incident.difference is None else {"difference_mps": round(incident.difference, 3)})
            for incident in incidents
            if incident.kind == "collision" and incident.vehicle == name
        ]
        found = {"speed_missed": _missed_speed(signals, name), "wheel_oscillation": _wheel_oscillation(signals, name)}
        findings = {key: finding for key, finding in found.items() if finding is not None}
        figures = _vehicle_figures(signals, name)
        vehicles[name] = {"model": part.vehicle.name, **figures, **findings, "collisions": collisions}
    return {
        "diagram": data["name"],
        "world": data["world"]["name"],
        "simulated_s": round(simulated, 9),
        "wall_s": round(wall, 3),
        "real_time_factor": round(simulated / wall, 2) if wall > 0.0 else None,
        "stop_reason": stop.reason,
        "stop_detail": stop.detail,
        "seed": data["seed"],
        "spec_sha256": data["provenance"]["spec_sha256"],
        "versions": data["provenance"]["versions"],
        "vehicles": vehicles,
    }


_FIGURES = ("vx", "speed_command", "wheels_on_road", "lap", "lateral_error", "curvature")


def figure_columns(assembly: Assembly) -> list[str]:
    """Return the signals from which the figures of a summary are computed."""
    wheels = [f"wheel_speed.{wheel}" for wheel in WHEELS]
    return [f"{name}.{signal}" for name in assembly.parts.vehicles for signal in (*_FIGURES, "speed_setpoint", *wheels)]


def _vehicle_figures(signals: pd.DataFrame, name: str) -> dict[str, float | None]:
    """Return the figures of one vehicle; None for those that the world or the run does not have."""

    def column(suffix: str) -> Array | None:
        key = f"{name}.{suffix}"
        return signals[key].to_numpy() if key in signals and len(signals) else None

    given = {suffix: values for suffix in _FIGURES if (values := column(suffix)) is not None}
    return drive_figures(signals.index.to_numpy(), given)


def drive_figures(times: Array, signals: Mapping[str, Array]) -> dict[str, float | None]:
    """Return the figures of a drive by name; None for those whose signals are not there, or not finite throughout.

    Args:
        times: evenly spaced, with both ends of the drive [s] (n).
        signals: signals of a vehicle (n each): vx, speed_command, wheels_on_road, lap, lateral_error, curvature.
    """
    figures: dict[str, float | None] = dict.fromkeys(VEHICLE_FIGURES)
    vx, command, wheels, lap, lateral, curvature = (signals.get(name) for name in _FIGURES)
    if vx is None or len(times) < 2:
        return figures
    step = float(times[1] - times[0])
    # abs: distance travelled also counts in reverse.
    figures["distance_m"] = round(_integral(np.abs(vx), step), 3)
    figures["max_speed_mps"] = round(float(np.max(np.abs(vx))), 4)
    if wheels is not None:
        # Off the road as soon as one of the four wheels is.
        figures["off_road_s"] = round(_integral((wheels < 4).astype(float), step), 3)
    if lap is not None:
        figures["laps"] = round(float(lap[-1]), 4)
    if lateral is not None:
        figures["max_abs_lateral_error_m"] = round(float(np.max(np.abs(lateral))), 4)
    # Relative to the command of the driver: a limit of the control unit that keeps the vehicle from it counts as an
    # error. Only in steady state and on straight sections; near zero, a relative error is meaningless.
    if command is not None:
        steady = _steady(command, samples=max(1, round(STEADY / step))) & (np.abs(command) > 0.1)
        if curvature is not None:
            steady &= np.abs(curvature) < STRAIGHT
        if steady.any():
            error = np.mean((vx[steady] - command[steady]) / command[steady])
            figures["mean_speed_error_percent"] = round(100.0 * float(error), 4)
    # JSON has no NaN: the signals of a diverged run are not finite.
    return {name: value if value is not None and math.isfinite(value) else None for name, value in figures.items()}


def _missed_speed(signals: pd.DataFrame, name: str) -> dict[str, float] | None:
    """Return what :func:`missed_speed` finds in the signals of a vehicle; None without its signals."""
    columns = [f"{name}.speed_setpoint", f"{name}.vx"]
    if not set(columns) <= set(signals) or len(signals) < 2:
        return None
    setpoint, vx = (signals[column].to_numpy() for column in columns)
    return missed_speed(signals.index.to_numpy(), setpoint, vx)


def _wheel_oscillation(signals: pd.DataFrame, name: str) -> dict[str, float | str] | None:
    """Return what :func:`find_wheel_oscillation` finds in the signals of a vehicle; None without its signals."""
    wheels = {wheel: f"{name}.wheel_speed.{wheel}" for wheel in WHEELS}
    if not {f"{name}.vx", *wheels.values()} <= set(signals):
        return None
    spins = {wheel.replace("_", " "): signals[column].to_numpy() for wheel, column in wheels.items()}
    return find_wheel_oscillation(signals.index.to_numpy(), spins, signals[f"{name}.vx"].to_numpy())


def missed_speed(times: Array, setpoint: Array, vx: Array) -> dict[str, float] | None:
    """Return the longest time for which a vehicle has missed its speed set-point, and its mean error in that time.

    Args:
        times: evenly spaced [s] (n).
        setpoint: of the speed, after the limits of its slope [m/s] (n).
        vx: longitudinal velocity [m/s] (n).

    Returns:
        ``from_s``, ``duration_s`` and ``error_mps``; None if no time is longer than :data:`MISSED_TIME`.
    """
    error = np.abs(vx - setpoint)
    missed = error > np.maximum(MISSED_LEAST, MISSED_SHARE * np.abs(setpoint))
    # First samples of the spans, and those behind their ends.
    edges = np.flatnonzero(np.diff(missed.astype(int), prepend=0, append=0)).reshape(-1, 2)
    if not len(edges):
        return None
    first, end = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    duration = float(times[end - 1] - times[first])
    if duration < MISSED_TIME:
        return None
    mean = float(np.mean(error[first:end]))
    return {"from_s": round(float(times[first]), 3), "duration_s": round(duration, 3), "error_mps": round(mean, 4)}


def _integral(values: Array, step: float) -> float:
    """Return the integral of evenly spaced values (n) over their n - 1 steps by the trapezoidal rule."""
    return step * float(np.sum(values) - 0.5 * (values[0] + values[-1]))


def _steady(values: Array, *, samples: int) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return at which samples a signal has been constant for a number of samples."""
    # Index of the last change up to each sample; the run starts with a change, as the command before it is unknown.
    changed = np.abs(np.diff(values, prepend=values[0])) > 1e-9
    changed[0] = True
    last = np.maximum.accumulate(np.where(changed, np.arange(values.size), 0))
    result: np.ndarray[Any, np.dtype[np.bool_]] = np.arange(values.size) - last >= samples
    return result
