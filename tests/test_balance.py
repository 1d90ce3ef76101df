"""A vehicle that would tip over is rejected before the simulation, with the line of the link that causes it."""

from dataclasses import replace

import pytest
from pydrake.systems.framework import DiagramBuilder

from mirdrake.core.errors import ConfigError
from mirdrake.plant.plant import make_plant
from mirdrake.plant.wheels.tyre_forces import make_spinning_wheels
from mirdrake.single_track import estimate_parameters
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.worlds import load_world

BODY = '<origin xyz="0.36146153846153845 0 0.2202346153846154"/>'


def unior(x: float, z: float) -> Vehicle:
    """Return the Unior with the centre of mass of its body elsewhere [m]."""
    vehicle = load_vehicle("unior@handling")
    assert vehicle.urdf.count(BODY) == 1
    return replace(vehicle, urdf=vehicle.urdf.replace(BODY, f'<origin xyz="{x} 0 {z}"/>'))


def on_the_road(vehicle: Vehicle) -> object:
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle})
    return make_spinning_wheels(parts.plant, parts.vehicles["ego"])


@pytest.mark.parametrize(
    ("x", "expected"),
    [(-0.3, r"behind the rear axle: it tips over backwards"), (1.2, r"ahead of the front axle: it tips over forwards")],
)
@pytest.mark.parametrize("check", [estimate_parameters, on_the_road])
def test_a_centre_of_mass_that_is_not_between_the_axles(check, x, expected):
    with pytest.raises(ConfigError) as caught:
        check(unior(x, 0.22))
    location, message = str(caught.value).split(": ", maxsplit=1)
    assert location == load_vehicle("unior").link_places["base_link"]
    assert location.startswith("models/unior/structure.xacro:")
    assert message.startswith("the centre of mass of 'unior@handling' is 0.")
    assert expected in message
    assert message.endswith("check mass and origin of link 'base_link', which contributes most")


def test_a_centre_of_mass_below_the_road_has_no_single_track():
    car = unior(0.36, -0.5)
    assert on_the_road(car)
    with pytest.raises(
        ConfigError, match=r"structure\.xacro:\d+: the centre of mass .* is 0\.\d+ m below the road; check"
    ):
        estimate_parameters(car)
