"""Checks of a suspension, and the static load of each spring.

A suspended wheel is at the end of a chain of joints: base_link, prismatic joint along z, at the front the steering
joint, wheel joint. Travel is positive in bump, when the wheel moves up into the body, and 0 in the loaded vehicle at
rest.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from xml.etree import ElementTree

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, MirdrakeError, ModelError
from mirdrake.core.yaml_io import where as where_in
from mirdrake.vehicles.geometry import TOLERANCE, VehicleGeometry
from mirdrake.vehicles.spec import WHEELS, VehicleSpec
from mirdrake.vehicles.xacro_render import Urdf

_STEERED = {"front_left": "left", "front_right": "right"}


def find_suspension_faults(
    urdf: Urdf, spec: VehicleSpec, joints: Mapping[str, ElementTree.Element]
) -> Iterator[MirdrakeError]:
    """Yield joints without springs, springs without joints, and wheels on other joints than vehicle.yaml names.

    Args:
        urdf: the expanded model.
        spec: joint roles and springs.
        joints: joints of the model, by name.
    """
    # Joints and springs belong together: either alone would collapse or do nothing.
    names = spec.joints.suspension
    if names is not None and spec.suspension is None:
        yield ConfigError(
            "the joints have no springs; add the section suspension", where=where_in(spec, "joints", "suspension")
        )
    if names is None and spec.suspension is not None:
        yield ConfigError(
            "the springs have no joints; name them under joints.suspension", where=where_in(spec, "suspension")
        )
    # A movable joint without a role in the chain of a wheel would swing freely in the plant.
    above = {child: joint for joint in joints.values() if (child := _end(joint, "child"))}
    for wheel in WHEELS:
        roles = [getattr(spec.joints.wheels, wheel)]
        roles += [getattr(spec.joints.steering, _STEERED[wheel])] if wheel in _STEERED else []
        spring = getattr(names, wheel) if names is not None else None
        if roles[0] not in joints:
            continue  # reported by the check of roles
        chain, link = [], _end(joints[roles[0]], "child")
        # From the wheel up to base_link; the last condition ends at a loop of joints.
        while link in above and link != spec.base_link and above[link] not in chain:
            chain.append(above[link])
            link = _end(above[link], "parent")
        for joint in chain:
            name, kind = joint.get("name", ""), joint.get("type", "")
            if name != spring and name not in roles and kind != "fixed":
                yield ModelError(
                    f"joint '{name}' is {kind} and carries the {wheel} wheel, but has no role; "
                    f"name it in vehicle.yaml under joints.suspension.{wheel}, or make it fixed",
                    where=urdf.where(joint),
                )
        if spring is not None and spring in joints and joints[spring] not in chain:
            location = where_in(spec, "joints", "suspension", wheel)
            yield ConfigError(
                f"joint '{spring}' does not carry the {wheel} wheel; name the one above '{roles[0]}'", where=location
            )


def _end(joint: ElementTree.Element, tag: str) -> str:
    """Return the link at one end of a joint."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def measure_spring_loads(
    plant: MultibodyPlant, *, spec: VehicleSpec, geometry: VehicleGeometry, where: Callable[[str], str]
) -> tuple[float, ...]:
    """Return the static load of each spring in the design position [N] (4); empty without springs.

    It is the wheel load less the unsprung weight below the joint, in the order of WHEELS. The loads of axles and
    sides follow from moment balances, so that a vehicle with a lateral offset of its centre of mass
    is level at rest.

    Args:
        plant: holds the vehicle and nothing else, finalised.
        spec: joint roles.
        geometry: geometry of the vehicle.
        where: ``file:line`` of a joint in its source.

    Raises:
        ModelError: an axis that is not vertical, limits that are not on both sides of zero, a spring without load.
    """
    if spec.joints.suspension is None:
        return ()
    context = plant.CreateDefaultContext()
    base = plant.GetBodyByName(spec.base_link)
    # With the base at the origin the centre of mass is directly that ahead of the rear axle.
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, base, RigidTransform())
    x, y, _ = plant.CalcCenterOfMassPositionInWorld(context).tolist()
    # Moment balances about the axles and about the middle give the four wheel loads.
    weight, share = plant.CalcTotalMass(context) * GRAVITY, x / geometry.wheelbase
    mean_track = share * geometry.front_track + (1.0 - share) * geometry.rear_track
    loads = []
    for i, name in enumerate(spec.joints.suspension.names()):
        joint, location = plant.GetJointByName(name), where(name)
        X_BJ = plant.CalcRelativeTransform(context, base.body_frame(), joint.frame_on_parent())
        axis = X_BJ.rotation().multiply(joint.translation_axis())
        if abs(axis[2] - 1.0) > TOLERANCE:
            shown = " ".join(f"{value:.4g}" for value in np.where(np.abs(axis) < 1e-9, 0.0, axis))
            raise ModelError(
                f"suspension joint '{name}' moves along {shown} of '{spec.base_link}'; "
                "it should be 0 0 1, so that a positive travel lifts the wheel",
                where=location,
            )
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        # The design position is travel zero, which has to be within the limits.
        if not -math.inf < low < 0.0 < high < math.inf:
            raise ModelError(
                f"suspension joint '{name}' is limited to {low:g} … {high:g} m; "
                "it needs the rebound travel below zero and the bump travel above",
                where=location,
            )
        # A spring carries neither its wheel nor its knuckle: their weight is subtracted from the load of the wheel.
        below = plant.GetBodiesKinematicallyAffectedBy([joint.index()])
        unsprung = sum(float(plant.get_body(body).default_mass()) for body in below) * GRAVITY
        axle = weight * (share if i < 2 else 1.0 - share)
        # Left wheels carry more if the centre of mass is to the left (y > 0).
        side = 0.5 + (1.0 if i % 2 == 0 else -1.0) * y / mean_track
        load = axle * side - unsprung
        if load <= 0.0:
            raise ModelError(
                f"the spring of '{name}' carries {load:.4g} N: {axle * side:.4g} N on the wheel less "
                f"{unsprung:.4g} N of unsprung weight; move the centre of mass, or make the wheel lighter",
                where=location,
            )
        loads.append(load)
    return tuple(loads)
