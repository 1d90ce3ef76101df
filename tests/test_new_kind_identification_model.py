"""A user adds an identification model: one class, and one line that registers it."""

import numpy as np
import pytest
from pydantic import Field

from mirdrake.core.errors import ConfigError
from mirdrake.identification.identify import identify
from mirdrake.identification.models import MODELS, EquationModel, ModelOptions
from mirdrake.identification.models.base import find_channel, select_outputs
from mirdrake.identification.parameters import Parameter
from mirdrake.identification.study import load_identification

STUDY = """\
mirdrake: identification/1
data:
  channels:
    throttle: {column: throttle}
    speed: {column: v, unit: m/s}
  logs: [{file: a.csv}, {file: b.csv, use: validation}]
model: {kind: cart, input: throttle}
parameters:
  gain: {low: 1, high: 20}
"""


class CartOptions(ModelOptions):
    """Options of the cart."""

    input: str = Field(default="throttle", description="channel of the set-point [-]")


class CartModel(EquationModel):
    """Speed of a cart as a first-order lag: τ v̇ = K u - v."""

    kind = "cart"
    Options = CartOptions
    states, state_scales = ("speed",), (1.0,)

    def __init__(self, channels, known, wheelbase, options):
        self.title = f"cart, {options.input} to speed"
        self.inputs = (find_channel(channels, (options.input,), "the set-point", self.kind),)
        self.outputs = select_outputs(channels, ["speed"], None, self.kind)
        self.parameters = (
            Parameter("gain", "m/s", "speed at full throttle", known.get("gain", 5.0), 0.1, 100.0, True),
            Parameter("time_constant", "s", "time constant", 1.0, 0.05, 10.0, True),
        )

    def input_signals(self, p, drive, times):
        return drive.at(self.inputs[0], times)[None]

    def rates(self, x, u, p):
        return (p["gain"] * u - x) / p["time_constant"]

    def observe(self, x, u, p):
        return x

    def initial_states(self, p, drive, rows):
        return np.nan_to_num(drive.outputs["speed"][rows])[None]

    @classmethod
    def vehicle_values(cls, vehicle, options, *, measured):
        return {"gain": vehicle.geometry.wheelbase}


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(MODELS, "cart", CartModel)


def write(folder, text=STUDY):
    """Return two logs of a cart with a gain of 8 m/s and a time constant of 0.7 s, and their study."""
    for name, seed in (("a", 1), ("b", 2)):
        random, time = np.random.default_rng(seed), 0.05 * np.arange(400)
        throttle = np.repeat(random.uniform(0.0, 1.0, 20), 20)
        speed = np.zeros(len(time))
        for k in range(len(time) - 1):  # the exact response to a held input
            speed[k + 1] = 8.0 * throttle[k] + (speed[k] - 8.0 * throttle[k]) * np.exp(-0.05 / 0.7)
        speed += random.normal(0.0, 0.02, len(time))
        rows = np.stack((time, throttle, speed), axis=1)
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header="time,throttle,v", comments="")
    (folder / "study.yaml").write_text(text, encoding="utf-8")
    return folder / "study.yaml"


def test_a_registered_model_is_identified_from_a_study(tmp_path):
    path = write(tmp_path)
    result = identify(load_identification(path), tmp_path)
    # The input is interpolated between samples, which delays the steps by half a sample.
    assert result.fit["gain"].value == pytest.approx(8.0, rel=0.02)
    assert result.fit["time_constant"].value == pytest.approx(0.7, abs=0.05)
    assert result.fit.channel("speed").nrmse_percent > 90.0
    assert {parameter.verdict for parameter in result.fit.free} == {"identified"}


def test_its_options_and_values_of_a_vehicle_are_its_own(tmp_path):
    path = write(tmp_path, STUDY.replace("input: throttle}", "inptu: throttle}"))
    with pytest.raises(ConfigError, match=r"study.yaml:7: model.inptu: unknown field; did you mean 'input'"):
        identify(load_identification(path), tmp_path)
    path = write(tmp_path, STUDY + "vehicle: unior\n")
    result = identify(load_identification(path), tmp_path)
    assert (result.vehicle, set(result.given)) == ("unior", {"gain"})
    assert result.fit["gain"].verdict == "contradicts the given value"
