"""The manoeuvres by name, their settings, and one call that drives one of them."""

import time
from collections.abc import Iterable
from typing import Any

from pydantic import Field, create_model

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Schema, parse_yaml
from mirdrake.manoeuvres.base import Diverged, ManoeuvreSpec, NotFeasible, Outcome, scaled
from mirdrake.manoeuvres.dwell import SineWithDwellSpec
from mirdrake.manoeuvres.lanes import DoubleLaneChangeSpec, ObstacleAvoidanceSpec, SlalomSpec
from mirdrake.manoeuvres.open_loop import FrequencyResponseSpec, SlowlyIncreasingSteerSpec, StepSteerSpec
from mirdrake.manoeuvres.park import ParkSpec
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
}
"""Settings and run of each; a new one is one class and one line here."""


class _Common(Schema):
    """What holds for all manoeuvres of a command."""

    plant: PlantSpec = Field(default_factory=PlantSpec, description="step and contact of the full plant [-]")
    friction: float = Field(0.85, gt=0.0, le=2.0, description="of the road; 0.85 is dry asphalt [-]")
    seed: int = Field(0, ge=0, description="of random steering [-]")


_FIELDS: dict[str, Any] = {
    name: (spec, Field(default_factory=spec, description=f"{spec.title} [-]")) for name, spec in MANOEUVRES.items()
}
ManoeuvreSettings: Any = create_model("ManoeuvreSettings", __base__=_Common, __doc__="Settings.", **_FIELDS)
"""``plant``, ``friction``, ``seed`` and one mapping a manoeuvre."""


def read_settings(overrides: Iterable[str] = ()) -> Any:
    """The settings of all manoeuvres, with ``"dotted.path=value"`` texts laid over them.

    Raises:
        ConfigError: no such setting, or a value out of range.
    """
    return parse_yaml("", ManoeuvreSettings, name="manoeuvre", overrides=overrides)


def find_names(text: str) -> list[str]:
    """Names of manoeuvres from ``"braking,slalom"`` or ``"all"``.

    Raises:
        ConfigError: no such manoeuvre.
    """
    if text.strip() == "all":
        return list(MANOEUVRES)
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in MANOEUVRES:
            raise ConfigError(f"no manoeuvre '{name}'; {did_you_mean(name, [*MANOEUVRES, 'all'])}")
    if not names:
        raise ConfigError("say which manoeuvre; mirdrake manoeuvre --list shows them")
    return list(dict.fromkeys(names))


def run_manoeuvre(name: str, rig: Rig, spec: ManoeuvreSpec | None = None) -> Outcome:
    """Drive one manoeuvre.

    Args:
        name: of the manoeuvre.
        rig: where; its runs go into a folder of this name.
        spec: settings; the defaults if left out. What the user has not set is scaled to the vehicle's size.

    Raises:
        ConfigError: a setting makes no sense.
    """
    kind = MANOEUVRES[name]
    spec = scaled(spec or kind(), rig.facts.scale)
    outcome = Outcome(name, kind.title, kind.standard, used=list(spec.used()))
    if rig.facts.scale != 1.0:
        outcome.notes.append(
            f"a small vehicle: lengths are scaled by {rig.facts.scale:.3g}, speeds and times by "
            f"{rig.facts.scale**0.5:.3g} (equal Froude number), unless they were set"
        )
    began, before = time.perf_counter(), len(rig.records)
    base = rig.folder
    rig.folder = base / name if base is not None else None
    try:
        spec.drive(rig, outcome)
    except NotFeasible as error:
        outcome.verdict, outcome.reason = "not possible", str(error)
    except Diverged as error:
        outcome.verdict, outcome.reason = "diverged", str(error)
    finally:
        rig.folder = base
    outcome.runs = [record.label for record in rig.records[before:]]
    outcome.wall = time.perf_counter() - began
    return outcome
