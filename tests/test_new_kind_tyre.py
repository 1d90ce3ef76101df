"""A user adds a tyre law: one class, and one line that registers it."""

import shutil
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import pytest
from pydantic import Field
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.identification.apply import find_entry
from mirdrake.single_track import estimate_parameters
from mirdrake.tyres import TYRES, SlipTyres, SteadyLaw, TyreAtLoad
from mirdrake.tyres.base import FittedEntry
from mirdrake.tyres.relaxation import Contact
from mirdrake.vehicles import load_vehicle

# --- the new file ------------------------------------------------------------------------------------------------


class TanhCurve(NamedTuple):
    """Stiffness and friction force at a load."""

    stiffness: float
    limit: float


def tanh_forces(curve, kappa, tan_alpha, vx):
    """Forces that saturate with the slip by a hyperbolic tangent, without an aligning moment."""
    slip = np.sqrt(kappa * kappa + tan_alpha * tan_alpha) + 1e-12
    force = curve.limit * np.tanh(curve.stiffness * slip / curve.limit) if curve.limit > 0.0 else 0.0
    return force * kappa / slip, -force * tan_alpha / slip, 0.0


class TanhTyres(SlipTyres):
    """Tyres with one stiffness over load and one friction."""

    law: ClassVar = SteadyLaw(TanhCurve, tanh_forces)
    fitted: ClassVar = {"friction_front": FittedEntry("friction", "1")}

    kind: Literal["tanh"]
    stiffness: float = Field(gt=0, description="[1/rad] slip stiffness over load")
    friction: float = Field(gt=0, description="[-] on dry asphalt")

    def axle_laws(self, folder):
        def law(load, inclination, friction):
            curve = TanhCurve(self.stiffness * load, self.friction * friction * load)
            contact = Contact(curve.stiffness, curve.stiffness, 0.3, 0.5, curve.limit, curve.limit)
            return TyreAtLoad(contact, curve, self.law)

        return law, law


# --- what it can do then -----------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setitem(TYRES, "tanh", TanhTyres)
        yield


def bolt(folder: Path, tyres: str) -> str:
    model = folder / "bolt"
    shutil.copytree(data_root() / "models" / "bolt", model)
    text = f"description: new tyres\nvehicle: {{tyres: {tyres}}}\n"
    (model / "variants" / "new.yaml").write_text(text, encoding="utf-8")
    return f"{model}@new"


def test_a_vehicle_drives_on_a_registered_tyre_law(tmp_path):
    model = bolt(tmp_path, "{kind: tanh, rolling_resistance: 0.01, stiffness: 14, friction: 0.9}")
    assembly = assemble(
        {
            "world": "empty",
            "vehicles": {"ego": {"model": model, "speed": 10.0}},
            "control": {"ego": {"kind": "constant", "speed": 10.0, "steering": 0.05}},
            "plant": {"contact": "point"},
        }
    )
    simulator = Simulator(assembly.diagram, assembly.make_context())
    simulator.AdvanceTo(2.0)
    tyres = assembly.tyres["ego"]
    forces = np.array(tyres.tyre_forces.Eval(tyres.GetMyContextFromRoot(simulator.get_context()))).reshape(4, 5)
    assert (forces[:, 1] > 300.0).all()  # to the left, as the car turns
    assert (forces[:, 4] < 0.0).all()
    load = forces[0, 1] / (0.9 * np.tanh(14.0 / 0.9 * np.hypot(forces[0, 3], np.tan(forces[0, 4]))))
    assert load == pytest.approx(4000.0, rel=0.2)


def test_the_reduced_model_and_identification_know_it(tmp_path):
    model = bolt(tmp_path, "{kind: tanh, rolling_resistance: 0.01, stiffness: 14, friction: 0.9}")
    vehicle = load_vehicle(model)
    p = estimate_parameters(vehicle)
    assert p.front_friction == pytest.approx(0.9)
    assert p.rear_relaxation == 0.5
    entries = [find_entry("friction_front", kind) for kind in ("tanh", "brush")]
    assert [entry and entry.path for entry in entries] == ["tyres.friction", "tyres.front.friction"]


def test_its_fields_are_checked_and_an_unknown_kind_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match=r"tyres.friktion: unknown field; did you mean 'friction'"):
        load_vehicle(bolt(tmp_path / "a", "{kind: tanh, rolling_resistance: 0, stiffness: 14, friktion: 0.9}"))
    with pytest.raises(ConfigError, match=r"tyres.kind: unknown kind 'tahn'; did you mean 'tanh'"):
        load_vehicle(bolt(tmp_path / "b", "{kind: tahn, rolling_resistance: 0, stiffness: 14, friction: 0.9}"))
