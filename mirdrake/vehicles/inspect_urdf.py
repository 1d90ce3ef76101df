"""Checks of an expanded URDF that Drake's parser does not make, or only warns about.

Drake replaces an impossible inertia by a plausible one, skips actuators without effort, and does not know roles.
Here these are errors that name the link or joint, the numbers, and the line in the xacro source.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from mirdrake.core.errors import ConfigError, MirdrakeError, ModelError, did_you_mean
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_io import where as where_in
from mirdrake.vehicles.gltf_check import check_gltf
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.numbers_in_urdf import check_numbers, number
from mirdrake.vehicles.spec import WHEELS, VehicleSpec
from mirdrake.vehicles.suspension import find_suspension_faults
from mirdrake.vehicles.xacro_render import Urdf

COLLISION_FORMATS = (".obj", ".vtk", ".gltf")
VISUAL_FORMATS = (".obj", ".gltf")


def check_urdf(urdf: Urdf, *, spec: VehicleSpec, sensors: SensorsSpec) -> None:
    """Check links, joints, actuators and frames of a vehicle.

    Raises:
        ModelError: masses, inertias, joint types, limits or transmissions are wrong.
        ConfigError: vehicle.yaml or sensors.yaml names something that the URDF does not have.
    """
    for fault in find_faults(urdf, spec=spec, sensors=sensors):
        raise fault


def find_faults(urdf: Urdf, *, spec: VehicleSpec | None, sensors: SensorsSpec | None) -> Iterator[MirdrakeError]:
    """Yield all faults of links, joints, actuators and frames; checks that need a spec that is None are left out."""
    links = {link.get("name", ""): link for link in urdf.root.findall("link")}
    joints = {joint.get("name", ""): joint for joint in urdf.root.findall("joint")}
    # Element by element, so that each one can report a fault.
    for element in urdf.root:
        yield from _raised(check_numbers, replace(urdf, root=element))
    # Names first: the following checks look elements up by name, where the last of equals wins.
    yield from _twice(urdf)
    for link in links.values():
        yield from _raised(_check_inertia, urdf, link)
    yield from _massless(urdf, links, joints)
    # Without a valid vehicle.yaml the roles of joints are unknown, but the URDF alone is still checked.
    if spec is not None:
        if spec.base_link in links:
            yield from _unconnected(urdf, spec, links, joints)
        else:
            hint = did_you_mean(spec.base_link, links)
            yield ConfigError(f"no link '{spec.base_link}'; {hint}", where=where_in(spec, "base_link"))
        yield from _wrong_roles(urdf, spec, joints)
        yield from find_suspension_faults(urdf, spec, joints)
        yield from _weak_joints(urdf, spec, joints)
    frames = [*links, *(frame.get("name", "") for frame in urdf.root.findall("frame"))]
    for name, mount in (sensors.mounts if sensors is not None else {}).items():
        if mount.frame not in frames:
            location = where_in(sensors, "mounts", name, "frame") if sensors is not None else ""
            yield ConfigError(f"no link '{mount.frame}'; {did_you_mean(mount.frame, frames)}", where=location)


def _raised(check: Callable[..., None], *arguments: Any) -> Iterator[MirdrakeError]:
    """Yield the fault that a check raises."""
    try:
        check(*arguments)
    except MirdrakeError as fault:
        yield fault


def _twice(urdf: Urdf) -> Iterator[MirdrakeError]:
    """Yield links or joints of the same name."""
    for kind in ("link", "joint"):
        first: dict[str, ElementTree.Element] = {}
        for element in urdf.root.findall(kind):
            name = element.get("name", "")
            if name in first:
                yield ModelError(
                    f"{kind} '{name}' exists already, at {urdf.where(first[name])}", where=urdf.where(element)
                )
            first.setdefault(name, element)


def resolve_meshes(urdf: Urdf, folder: Path) -> tuple[str, dict[str, str], tuple[str, ...]]:
    """Give every mesh a ``package://`` address, and check that its file exists.

    Relative addresses count from the vehicle's folder, whose name is also a package name.

    Args:
        urdf: the expanded model.
        folder: the vehicle's folder.

    Returns:
        URDF text, the package map (name -> folder), warnings.

    Raises:
        ModelError: unknown packages, missing files, collision meshes in a format that Drake does not read: a line each.
    """
    # The name `mirdrake` is taken by the package of the data folder.
    name = folder.name if folder.name != "mirdrake" else "mirdrake_vehicle"
    packages = {name: str(folder), "mirdrake": str(data_root())}
    text = urdf.text.split("\n")
    # All faults and warnings are collected, since a folder usually has several meshes of the same kind.
    warnings: list[str] = []
    faults: list[ModelError] = []
    seen: set[Path] = set()
    for role, formats in (("visual", VISUAL_FORMATS), ("collision", COLLISION_FORMATS)):
        for mesh in urdf.root.findall(f"link/{role}/geometry/mesh"):
            address = mesh.get("filename", "")
            location = urdf.where(mesh, f"{role} mesh '{address}'")
            try:
                package, path = _mesh_file(address, folder, packages, location)
                if not path.is_file():
                    raise ModelError(f"no such file: {path}", where=location)
                # VTK may crash on a broken file; each file is read once.
                if path.suffix == ".gltf" and path not in seen:
                    seen.add(path)
                    check_gltf(path, location)
                if path.suffix.lower() not in formats:
                    if role == "collision":
                        raise ModelError(f"Drake reads {', '.join(formats)}; convert it", where=location)
                    warnings.append(f"{location}: cameras see {' and '.join(formats)} only; convert it")
            except ModelError as fault:
                faults.append(fault)
                continue
            # The text is edited instead of the tree, so that the lines of messages stay those of the source.
            if package:
                number = urdf.lines[mesh] - 1
                text[number] = text[number].replace(
                    f'filename="{_escaped(address)}"', f'filename="{_escaped(package)}"'
                )
    if faults:
        raise ModelError(faults=faults)
    return "\n".join(text), packages, tuple(warnings)


def _mesh_file(address: str, folder: Path, packages: Mapping[str, str], at: str) -> tuple[str, Path]:
    """Return the new address of a mesh, "" to keep the old one, and its file."""
    for scheme in ("package://", "model://"):
        if address.startswith(scheme):
            package, _, rest = address.removeprefix(scheme).partition("/")
            if package not in packages:
                raise ModelError(f"unknown package '{package}'; {did_you_mean(package, packages)}", where=at)
            return "", Path(packages[package]) / rest
    if address.startswith("file://"):
        return "", Path(address.removeprefix("file://"))
    if "://" in address:
        raise ModelError("give a path below the vehicle's folder, or package://<package>/<path>", where=at)
    if Path(address).is_absolute():
        return "", Path(address)
    # The first package is the vehicle's own.
    name = next(iter(packages))
    return f"package://{name}/{address}", folder / address


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;").replace(">", "&gt;")


# --- links -------------------------------------------------------------------------------------------------------


def _mass(link: ElementTree.Element) -> float | None:
    """Return the mass [kg] of a link; None without `<inertial>`."""
    mass = link.find("inertial/mass")
    return None if mass is None else number(mass.get("value"))


def _check_inertia(urdf: Urdf, link: ElementTree.Element) -> None:
    """Check that mass and inertia about the centre of mass [kg, kg m²] are physically possible."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    location = urdf.where(link, f"link '{link.get('name')}'")
    mass = _mass(link)
    if mass is None or not 0.0 < mass < math.inf:
        given = "no mass" if mass is None else f"mass {mass:g} kg"
        raise ModelError(
            f"{given}; it should be above zero (leave <inertial> out for a frame on a fixed joint)", where=location
        )
    # Products of inertia default to 0 in URDF, moments have to be stated.
    inertia = inertial.find("inertia")
    values = {key: number(None if inertia is None else inertia.get(key)) for key in ("ixx", "iyy", "izz")}
    products = {key: number("0" if inertia is None else inertia.get(key, "0")) for key in ("ixy", "ixz", "iyz")}
    for key, value in (values | products).items():
        if not math.isfinite(value):
            raise ModelError(f"{key} is not a number", where=location)
    tensor = np.array(
        [
            [values["ixx"], products["ixy"], products["ixz"]],
            [products["ixy"], values["iyy"], products["iyz"]],
            [products["ixz"], products["iyz"], values["izz"]],
        ]
    )
    # Drake would replace an impossible tensor by a plausible one with a warning.
    small, middle, large = np.linalg.eigvalsh(tensor)
    shown = f"{small:.6g}, {middle:.6g}, {large:.6g} kg m²"
    if small <= 0.0:
        raise ModelError(f"principal moments of inertia {shown}; all should be above zero", where=location)
    # For a thin plate the largest moment is exactly the sum of the others; the tolerance is for its rounding errors.
    if small + middle < large * (1.0 - 1e-9):
        raise ModelError(
            f"principal moments of inertia {shown} break the triangle inequality "
            f"({small:.6g} + {middle:.6g} < {large:.6g}); no body has them",
            where=location,
        )


def _massless(
    urdf: Urdf, links: Mapping[str, ElementTree.Element], joints: Mapping[str, ElementTree.Element]
) -> Iterator[MirdrakeError]:
    """Yield moving links that have no mass, even with the links fixed to them: Drake fails at the first step."""
    parent_of = {}
    for joint in joints.values():
        parent, child = joint.find("parent"), joint.find("child")
        if joint.get("type") == "fixed" and parent is not None and child is not None:
            parent_of[child.get("link", "")] = parent.get("link", "")
    mass = dict.fromkeys(links, 0.0)

    # Links on fixed joints count to the first link above that moves.
    for name, link in links.items():
        root, seen = name, {name}
        while parent_of.get(root) in links and parent_of[root] not in seen:
            root = parent_of[root]
            seen.add(root)
        mass[root] += _mass(link) or 0.0
    for name, link in links.items():
        if name not in parent_of and name != "world" and mass[name] == 0.0:
            yield ModelError(
                f"link '{name}' moves but has no mass; give it an <inertial> or a fixed joint", where=urdf.where(link)
            )


def _unconnected(
    urdf: Urdf, spec: VehicleSpec, links: Mapping[str, ElementTree.Element], joints: Mapping[str, ElementTree.Element]
) -> Iterator[MirdrakeError]:
    """Yield links that no joint connects to base_link: Drake would let them fall beside the vehicle."""
    children: dict[str, list[str]] = {}
    for joint in joints.values():
        ends = [end.get("link", "") if (end := joint.find(tag)) is not None else "" for tag in ("parent", "child")]
        children.setdefault(ends[0], []).append(ends[1])
    # Search from base_link along the joints; `world` may exist without one.
    reached, waiting = {"world"}, [spec.base_link]
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += children.get(name, [])
    for name, link in links.items():
        if name not in reached:
            yield ModelError(
                f"link '{name}' is not connected; add a joint that leads to it from '{spec.base_link}'",
                where=urdf.where(link),
            )


# --- joints ------------------------------------------------------------------------------------------------------


def _wrong_roles(urdf: Urdf, spec: VehicleSpec, joints: Mapping[str, ElementTree.Element]) -> Iterator[MirdrakeError]:
    """Yield joints of roles that are missing, have two roles, the wrong type, or no actuator."""
    roles = [(("joints", "wheels", name), getattr(spec.joints.wheels, name), "continuous") for name in WHEELS]
    roles += [
        (("joints", "steering", name), getattr(spec.joints.steering, name), "revolute") for name in ("left", "right")
    ]
    if spec.joints.suspension is not None:
        springs = zip(WHEELS, spec.joints.suspension.names(), strict=True)
        roles += [(("joints", "suspension", wheel), name, "prismatic") for wheel, name in springs]
    # One joint in two roles would be driven by two controllers.
    used: dict[str, str] = {}
    for path, name, kind in roles:
        location = where_in(spec, *path)
        if name not in joints:
            movable = [other for other, joint in joints.items() if joint.get("type") != "fixed"]
            given = name if len(name) <= 60 else f"{name[:59]}…"
            yield ConfigError(f"no joint '{given}'; {did_you_mean(name, movable)}", where=location)
        elif name in used:
            yield ConfigError(f"joint '{name}' is already {used[name]}", where=location)
        else:
            used[name] = ".".join(path)
            joint = joints[name]
            if (given := joint.get("type")) != kind:
                yield ModelError(
                    f"joint '{name}' is {given}; as {used[name]} it should be {kind}", where=urdf.where(joint)
                )
    # Suspension joints have springs instead of actuators.
    actuated = {joint.get("name") for joint in urdf.root.findall("transmission/joint")}
    for name in (name for name in used if not used[name].startswith("joints.suspension")):
        location, effort = urdf.where(joints[name]), _effort(joints[name])
        if name not in actuated:
            yield ModelError(f"joint '{name}' has no <transmission>, so nothing can move it; add one", where=location)
        if effort is not None and not effort > 0.0:
            yield ModelError(f"joint '{name}' has effort limit {effort:g} N m; it should be above zero", where=location)


def check_actuators(
    plant: MultibodyPlant, *, spec: VehicleSpec, where: Callable[[str], str], warnings: Sequence[str]
) -> None:
    """Check that Drake made one actuator for each joint with a role.

    Args:
        plant: holds the vehicle, finalised.
        spec: joint roles.
        where: ``file:line`` of a joint in its source.
        warnings: warnings of Drake's parser, which may give the reason.

    Raises:
        ModelError: a joint has none or several.
    """
    actuated = [plant.get_joint_actuator(index).joint().name() for index in plant.GetJointActuatorIndices()]
    for name in (*spec.joints.wheels.names(), *spec.joints.steering.names()):
        if actuated.count(name) != 1:
            reason = f" ({'; '.join(warnings)})" if warnings else ""
            raise ModelError(
                f"joint '{name}' has {actuated.count(name)} actuators; it needs one{reason}", where=where(name)
            )


def _effort(joint: ElementTree.Element) -> float | None:
    """Return the effort limit [N m] of a joint; None without one."""
    limit = joint.find("limit")
    if limit is None or limit.get("effort") is None:
        return None
    return number(limit.get("effort"))


def _weak_joints(urdf: Urdf, spec: VehicleSpec, joints: Mapping[str, ElementTree.Element]) -> Iterator[MirdrakeError]:
    """Yield wheel joints whose effort limit is below the torque of the brakes plus, at driven wheels, of the motor."""
    driven = spec.driven_wheels()
    share = spec.brakes.front_share
    for wheel in WHEELS:
        name = getattr(spec.joints.wheels, wheel)
        effort = _effort(joints[name]) if name in joints else None
        if effort is None or not effort > 0.0:
            continue
        drive = spec.powertrain.max_torque / len(driven) if wheel in driven else 0.0
        # The brakes act through the wheel joint, so its limit must allow drive and brake together.
        brake = spec.brakes.max_torque * (share if wheel.startswith("front") else 1.0 - share) / 2.0
        if effort < (drive + brake) * (1.0 - 1e-6):
            yield ModelError(
                f"joint '{name}' is limited to {effort:.6g} N m; vehicle.yaml asks for "
                f"{drive + brake:.6g} N m at the {wheel} wheel (drive {spec.drive}: {drive:.6g}, brake {brake:.6g})",
                where=urdf.where(joints[name]),
            )
