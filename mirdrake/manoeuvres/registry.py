"""Registry of the manoeuvres, their settings, and the function that drives one of them."""

import time
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from pydantic import Field, create_model

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Schema, parse_yaml
from mirdrake.manoeuvres.base import MARGIN_CONDITIONS, Diverged, ManoeuvreSpec, NotFeasible, Outcome, scaled
from mirdrake.manoeuvres.dwell import SineWithDwellSpec
from mirdrake.manoeuvres.lanes import DoubleLaneChangeSpec, ObstacleAvoidanceSpec, SlalomSpec
from mirdrake.manoeuvres.open_loop import FrequencyResponseSpec, SlowlyIncreasingSteerSpec, StepSteerSpec
from mirdrake.manoeuvres.park import ParkSpec
from mirdrake.manoeuvres.ride import RoughRoadSpec, SingleBumpSpec
from mirdrake.manoeuvres.rig import Rig
from mirdrake.manoeuvres.skidpad import SkidpadSpec
from mirdrake.manoeuvres.steady_circle import SteadyStateCircleSpec
from mirdrake.manoeuvres.straight import AccelerationSpec, BrakingSpec, CoastDownSpec, SplitFrictionSpec
from mirdrake.plant.plant import PlantSpec

MANOEUVRES: dict[str, type[ManoeuvreSpec]] = {
    "steady_state_circle": SteadyStateCircleSpec,
    "step_steer": StepSteerSpec,
    "frequency_response": FrequencyResponseSpec,
    "slowly_increasing_steer": SlowlyIncreasingSteerSpec,
    "sine_with_dwell": SineWithDwellSpec,
    "double_lane_change": DoubleLaneChangeSpec,
    "obstacle_avoidance": ObstacleAvoidanceSpec,
    "slalom": SlalomSpec,
    "skidpad": SkidpadSpec,
    "acceleration": AccelerationSpec,
    "braking": BrakingSpec,
    "split_friction_braking": SplitFrictionSpec,
    "coast_down": CoastDownSpec,
    "park": ParkSpec,
    "rough_road": RoughRoadSpec,
    "single_bump": SingleBumpSpec,
}
"""Class of each manoeuvre; a new one is one class and one line here."""


class _Common(Schema):
    """Settings of all manoeuvres of a command."""

    plant: PlantSpec = Field(default_factory=PlantSpec, description="step and contact of the full plant [-]")
    friction: float = Field(0.85, gt=0.0, le=2.0, description="friction of the road; 0.85 is dry asphalt [-]")
    seed: int = Field(0, ge=0, description="seed of random steering [-]")
    single_track: dict[str, float] = Field(
        default_factory=dict,
        description="parameters of the single-track model, in place of the vehicle's, by name [SI]",
    )
    gains: dict[str, dict[str, float]] = Field(
        default_factory=dict,
        description="gains of its control unit: speed.kp, wheel_speed.kp, ... [as in control.yaml]",
    )

    def flat_gains(self) -> dict[str, float]:
        """Return the gains by dotted name."""
        return {f"{loop}.{name}": value for loop, gains in self.gains.items() for name, value in gains.items()}


ManoeuvreSettings: Any = create_model(
    "ManoeuvreSettings",
    __base__=_Common,
    __doc__="Settings.",
    **{  # type: ignore[call-overload]
        name: (spec, Field(default_factory=spec, description=f"{spec.title} [-]")) for name, spec in MANOEUVRES.items()
    },
)
"""``plant``, ``friction``, ``seed`` and a mapping for each manoeuvre."""


def read_settings(overrides: Iterable[str] = ()) -> Any:
    """Return the settings of all manoeuvres, with ``"dotted.path=value"`` texts merged over the defaults.

    Raises:
        ConfigError: a setting is unknown, or a value is out of range.
    """
    return parse_yaml("", ManoeuvreSettings, name="manoeuvre", overrides=overrides)


def find_names(text: str) -> list[str]:
    """Return names of manoeuvres from ``"braking,slalom"`` or ``"all"``.

    Raises:
        ConfigError: a manoeuvre is unknown, or none is named.
    """
    if text.strip() == "all":
        return list(MANOEUVRES)
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in MANOEUVRES:
            raise ConfigError(f"unknown manoeuvre '{name}'; {did_you_mean(name, [*MANOEUVRES, 'all'])}")
    if not names:
        raise ConfigError("no manoeuvre is named; mirdrake manoeuvre --list shows all of them")
    return list(dict.fromkeys(names))


def run_manoeuvre(name: str, rig: Rig, spec: ManoeuvreSpec | None = None) -> Outcome:
    """Drive one manoeuvre.

    Args:
        name: name of the manoeuvre.
        rig: vehicle and conditions; the runs are written into a folder of the manoeuvre's name.
        spec: settings; those that the user has not set are scaled to the size of the vehicle.

    Raises:
        ConfigError: a setting is out of range.
    """
    kind = MANOEUVRES[name]
    spec = scaled(spec or kind(), rig.facts.scale)
    outcome = Outcome(name, kind.title, kind.standard, used=list(spec.used()))
    if rig.facts.scale != 1.0:
        outcome.notes.append(
            f"small vehicle: lengths are scaled by {rig.facts.scale:.3g}, speeds and times by "
            f"{rig.facts.scale**0.5:.3g} (equal Froude number), except settings of the user"
        )
    if rig.changes or rig.gains:
        changed = ", ".join(f"{name} {value:.4g}" for name, value in (*rig.changes.items(), *rig.gains.items()))
        outcome.notes.append(f"single-track model with changed {changed} (SI units)")
    # Runs of this manoeuvre are those that are added to the rig from here on.
    start, before = time.perf_counter(), len(rig.records)
    # A folder for each manoeuvre, as names of runs repeat; always restored, since the rig is shared.
    base = rig.folder
    rig.folder = base / name if base is not None else None
    try:
        # An outcome in all cases: a set of manoeuvres continues after one that is not possible or diverges.
        spec.drive(rig, outcome)
    except NotFeasible as error:
        outcome.verdict, outcome.reason = "not possible", str(error)
    except Diverged as error:
        outcome.verdict, outcome.reason = "diverged", str(error)
    finally:
        rig.folder = base
    if rig.kind == "single_track" and kind.margins and outcome.metrics:
        margins = kind.margins
        outcome.metrics = [
            replace(metric, margin=margins[metric.key]) if metric.key in margins else metric
            for metric in outcome.metrics
        ]
        outcome.notes.append(
            f"margins against the full plant: measured with {MARGIN_CONDITIONS}; other vehicles and settings "
            "may differ more"
        )
    outcome.runs = [record.label for record in rig.records[before:]]
    outcome.simulated = float(sum(record.time[-1] for record in rig.records[before:]))
    outcome.wall = time.perf_counter() - start
    return outcome
