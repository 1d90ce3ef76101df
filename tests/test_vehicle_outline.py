"""The box around a vehicle's collision shapes, against boxes computed by hand."""

import math
from typing import Any

import pytest

from mirdrake.controllers.behaviours.outline import outline_of
from mirdrake.core.errors import ModelError
from mirdrake.requirements import outline
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.outline import Outline, measure_outline

INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'  # of no interest
)


def urdf(*, base: str = "", arm: str = "", tip: str = "") -> str:
    joint = '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/>{}<axis xyz="0 0 1"/>{}</joint>'
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    return "".join(
        [
            '<robot name="thing">',
            *(
                f'<link name="{name}">{INERTIAL}{shapes}</link>'
                for name, shapes in (("base", base), ("arm", arm), ("tip", tip))
            ),
            joint.format("one", "base", "arm", '<origin xyz="2 0 0" rpy="0 0 1.5707963267948966"/>', limit),
            joint.format("two", "arm", "tip", '<origin xyz="1 0 0"/>', limit),
            "</robot>",
        ]
    )


def shape(tag: str, xyz: str = "0 0 0", turn: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{xyz}" rpy="{turn}"/><geometry>{tag}</geometry></collision>'


def measured(base_link: str = "base", **shapes: str) -> Any:
    return measure_outline(urdf(**shapes), packages={}, base_link=base_link)


def test_the_outline_has_the_sides_of_a_box() -> None:
    box = measured(base=shape('<box size="4 2 1"/>', "1 0.25 0.5"))
    assert box == pytest.approx(Outline(rear=-1.0, front=3.0, right=-0.75, left=1.25, bottom=0.0, top=1.0))


def test_shapes_count_where_the_joints_put_them() -> None:
    base = shape('<box size="1 1 1"/>')
    box = measured(base=base, tip=shape('<box size="0.4 0.2 0.6"/>', "0.5 0 1"))
    # The arm is 2 m ahead and looks to the left; the tip is 1 m along it, the box 0.5 m further.
    assert box == pytest.approx(Outline(-0.5, 2.1, -0.5, 1.7, -0.5, 1.3))


def test_a_wheel_is_as_high_as_its_diameter_and_a_tilted_box_as_its_corners() -> None:
    wheel = measured(base=shape('<cylinder radius="0.3" length="0.2"/>', "0 0 0.3", f"{math.pi / 2} 0 0"))
    assert wheel == pytest.approx(Outline(-0.3, 0.3, -0.1, 0.1, 0.0, 0.6))
    leaning = measured(base=shape('<box size="1 1 1"/>', turn=f"0 {math.pi / 4} 0"))
    half = math.sqrt(0.5)
    assert leaning == pytest.approx(Outline(-half, half, -0.5, 0.5, -half, half))


def test_the_frame_is_that_of_the_base_link() -> None:
    box = measured("tip", base=shape('<box size="1 1 1"/>'))
    # Seen from the tip, which is at (2, 1) and looks to the left, the base is 1 m behind and 2 m to the left.
    assert box == pytest.approx(Outline(-1.5, -0.5, 1.5, 2.5, -0.5, 0.5))


def test_a_vehicle_without_collision_geometry_has_no_outline() -> None:
    assert measured() is None
    assert measured(base='<visual><geometry><box size="1 1 1"/></geometry></visual>') is None


def test_a_text_that_is_not_urdf_is_rejected() -> None:
    with pytest.raises(ModelError):
        measure_outline("<robot", packages={}, base_link="base")


@pytest.mark.parametrize("name", ["bolt", "unior"])
def test_behaviours_and_requirements_see_the_same_box(name: str) -> None:
    vehicle = load_vehicle(name)
    box, measured_box = outline(vehicle), outline_of(vehicle)
    assert (box.rear, box.front, max(-box.right, box.left), box.top) == tuple(measured_box)
