"""Checks of an expanded URDF that Drake's parser does not make, or only warns about.

Drake replaces an impossible inertia by a plausible one, skips actuators without effort, and never looks at roles.
Here all of these are errors that name the link or joint, the numbers, and the line in the xacro source.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from mirdrake.errors import ConfigError, ModelError, did_you_mean
from mirdrake.paths import data_root
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.numbers_in_urdf import check_numbers, number
from mirdrake.vehicles.spec import WHEELS, VehicleSpec
from mirdrake.vehicles.xacro_render import Urdf
from mirdrake.yaml_io import where as where_in

COLLISION_FORMATS = (".obj", ".vtk", ".gltf")
VISUAL_FORMATS = (".obj", ".gltf")


def check_urdf(urdf: Urdf, *, spec: VehicleSpec, sensors: SensorsSpec) -> None:
    """Check links, joints, actuators and frames of a vehicle.

    Raises:
        ModelError: masses, inertias, joint types, limits or transmissions are wrong.
        ConfigError: vehicle.yaml or sensors.yaml names something that the URDF does not have.
    """
    links = {link.get("name", ""): link for link in urdf.root.findall("link")}
    joints = {joint.get("name", ""): joint for joint in urdf.root.findall("joint")}
    check_numbers(urdf)
    for link in links.values():
        _check_inertia(urdf, link)
    _check_massless(urdf, links, joints)
    if spec.base_link not in links:
        raise ConfigError(
            f"{where_in(spec, 'base_link')}: no link '{spec.base_link}'; {did_you_mean(spec.base_link, links)}"
        )
    _check_connected(urdf, spec, links, joints)
    _check_roles(urdf, spec, joints)
    _check_drive(urdf, spec, joints)
    frames = [*links, *(frame.get("name", "") for frame in urdf.root.findall("frame"))]
    for name, mount in sensors.mounts.items():
        if mount.frame not in frames:
            at = where_in(sensors, "mounts", name, "frame")
            raise ConfigError(f"{at}: no link '{mount.frame}'; {did_you_mean(mount.frame, frames)}")


def resolve_meshes(urdf: Urdf, folder: Path) -> tuple[str, dict[str, str], tuple[str, ...]]:
    """Give every mesh a ``package://`` address, and check that its file is there.

    Relative addresses count from the vehicle's folder, whose name is also a package name.

    Args:
        urdf: the expanded model.
        folder: the vehicle's folder.

    Returns:
        URDF text, the package map (name -> folder), warnings.

    Raises:
        ModelError: an unknown package, a missing file, or a collision mesh in a format that Drake does not read.
    """
    own = folder.name if folder.name != "mirdrake" else "mirdrake_vehicle"
    packages = {own: str(folder), "mirdrake": str(data_root())}
    text = urdf.text.split("\n")
    warnings = []
    seen: set[Path] = set()
    for role, formats in (("visual", VISUAL_FORMATS), ("collision", COLLISION_FORMATS)):
        for mesh in urdf.root.findall(f"link/{role}/geometry/mesh"):
            address = mesh.get("filename", "")
            at = f"{urdf.where(mesh)}: {role} mesh '{address}'"
            package, path = _mesh_file(address, folder, packages, at)
            if not path.is_file():
                raise ModelError(f"{at}: no such file: {path}")
            if path.suffix == ".gltf" and path not in seen:
                seen.add(path)
                _check_gltf(path, at)
            if path.suffix.lower() not in formats:
                if role == "collision":
                    raise ModelError(f"{at}: Drake reads {', '.join(formats)}; convert it")
                warnings.append(f"{at}: cameras see {' and '.join(formats)} only; convert it")
            if package:
                number = urdf.lines[mesh] - 1
                text[number] = text[number].replace(
                    f'filename="{_escaped(address)}"', f'filename="{_escaped(package)}"'
                )
    return "\n".join(text), packages, tuple(warnings)


def _mesh_file(address: str, folder: Path, packages: Mapping[str, str], at: str) -> tuple[str, Path]:
    """(new address, or "" to keep the old one; file) of a mesh."""
    for scheme in ("package://", "model://"):
        if address.startswith(scheme):
            package, _, rest = address.removeprefix(scheme).partition("/")
            if package not in packages:
                raise ModelError(f"{at}: unknown package '{package}'; {did_you_mean(package, packages)}")
            return "", Path(packages[package]) / rest
    if address.startswith("file://"):
        return "", Path(address.removeprefix("file://"))
    if "://" in address:
        raise ModelError(f"{at}: give a path below the vehicle's folder, or package://<package>/<path>")
    if Path(address).is_absolute():
        return "", Path(address)
    own = next(iter(packages))
    return f"package://{own}/{address}", folder / address


def _check_gltf(path: Path, at: str) -> None:
    """The buffers and textures that a glTF file names are there."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        addresses = [entry.get("uri", "") for key in ("buffers", "images") for entry in content.get(key, [])]
    except (ValueError, AttributeError) as error:
        raise ModelError(f"{at}: not a glTF file: {error}") from None
    for address in addresses:
        if address and not address.startswith("data:") and not (path.parent / unquote(address)).is_file():
            raise ModelError(f"{at}: it needs '{address}'; no such file: {path.parent / unquote(address)}")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;").replace(">", "&gt;")


# --- links -------------------------------------------------------------------------------------------------------


def _mass(link: ElementTree.Element) -> float | None:
    """Mass [kg] of a link, None without `<inertial>`."""
    mass = link.find("inertial/mass")
    return None if mass is None else number(mass.get("value"))


def _check_inertia(urdf: Urdf, link: ElementTree.Element) -> None:
    """Mass and inertia about the centre of mass [kg, kg m²] belong to a body that can exist."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    at = f"{urdf.where(link)}: link '{link.get('name')}'"
    mass = _mass(link)
    if mass is None or not 0.0 < mass < math.inf:
        given = "no mass" if mass is None else f"mass {mass:g} kg"
        raise ModelError(f"{at}: {given}; it should be above zero (leave <inertial> out for a frame on a fixed joint)")
    inertia = inertial.find("inertia")
    values = {key: number(None if inertia is None else inertia.get(key)) for key in ("ixx", "iyy", "izz")}
    products = {key: number("0" if inertia is None else inertia.get(key, "0")) for key in ("ixy", "ixz", "iyz")}
    for key, value in (values | products).items():
        if not math.isfinite(value):
            raise ModelError(f"{at}: {key} is not a number")
    tensor = np.array(
        [
            [values["ixx"], products["ixy"], products["ixz"]],
            [products["ixy"], values["iyy"], products["iyz"]],
            [products["ixz"], products["iyz"], values["izz"]],
        ]
    )
    small, middle, large = np.linalg.eigvalsh(tensor)
    shown = f"{small:.6g}, {middle:.6g}, {large:.6g} kg m²"
    if small <= 0.0:
        raise ModelError(f"{at}: principal moments of inertia {shown}; all should be above zero")
    if small + middle < large * (1.0 - 1e-9):
        raise ModelError(
            f"{at}: principal moments of inertia {shown} break the triangle inequality "
            f"({small:.6g} + {middle:.6g} < {large:.6g}); no body has them"
        )


def _check_massless(
    urdf: Urdf, links: Mapping[str, ElementTree.Element], joints: Mapping[str, ElementTree.Element]
) -> None:
    """Links that move together have mass together: Drake fails at the first step otherwise."""
    parent_of = {}
    for joint in joints.values():
        parent, child = joint.find("parent"), joint.find("child")
        if joint.get("type") == "fixed" and parent is not None and child is not None:
            parent_of[child.get("link", "")] = parent.get("link", "")
    mass = dict.fromkeys(links, 0.0)
    for name, link in links.items():
        root, seen = name, {name}
        while parent_of.get(root) in links and parent_of[root] not in seen:
            root = parent_of[root]
            seen.add(root)
        mass[root] += _mass(link) or 0.0
    for name, link in links.items():
        if name not in parent_of and name != "world" and mass[name] == 0.0:
            raise ModelError(
                f"{urdf.where(link)}: link '{name}' moves but has no mass; give it an <inertial> or a fixed joint"
            )


def _check_connected(
    urdf: Urdf,
    spec: VehicleSpec,
    links: Mapping[str, ElementTree.Element],
    joints: Mapping[str, ElementTree.Element],
) -> None:
    """All links hang on base_link: Drake would let the others fall beside the car."""
    children: dict[str, list[str]] = {}
    for joint in joints.values():
        ends = [end.get("link", "") if (end := joint.find(tag)) is not None else "" for tag in ("parent", "child")]
        children.setdefault(ends[0], []).append(ends[1])
    reached, waiting = {"world"}, [spec.base_link]
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += children.get(name, [])
    for name, link in links.items():
        if name not in reached:
            raise ModelError(
                f"{urdf.where(link)}: link '{name}' hangs on nothing; add a joint that leads to it from "
                f"'{spec.base_link}'"
            )


# --- joints ------------------------------------------------------------------------------------------------------


def _check_roles(urdf: Urdf, spec: VehicleSpec, joints: Mapping[str, ElementTree.Element]) -> None:
    """The joints with roles exist, once each, with the right type, and have actuators."""
    roles = [(("joints", "wheels", name), getattr(spec.joints.wheels, name), "continuous") for name in WHEELS]
    roles += [
        (("joints", "steering", name), getattr(spec.joints.steering, name), "revolute") for name in ("left", "right")
    ]
    used: dict[str, str] = {}
    for path, name, kind in roles:
        at = where_in(spec, *path)
        if name not in joints:
            movable = [other for other, joint in joints.items() if joint.get("type") != "fixed"]
            raise ConfigError(f"{at}: no joint '{name}'; {did_you_mean(name, movable)}")
        if name in used:
            raise ConfigError(f"{at}: joint '{name}' is already {used[name]}")
        used[name] = ".".join(path)
        joint = joints[name]
        if joint.get("type") != kind:
            raise ModelError(
                f"{urdf.where(joint)}: joint '{name}' is {joint.get('type')}; as {'.'.join(path)} it should be {kind}"
            )
    actuated = {joint.get("name") for joint in urdf.root.findall("transmission/joint")}
    for name in used:
        if name not in actuated:
            raise ModelError(
                f"{urdf.where(joints[name])}: joint '{name}' has no <transmission>, so nothing can move it; add one"
            )
        effort = _effort(joints[name])
        if effort is not None and not effort > 0.0:
            at = urdf.where(joints[name])
            raise ModelError(f"{at}: joint '{name}' has effort limit {effort:g} N m; it should be above zero")


def check_actuators(
    plant: MultibodyPlant, *, spec: VehicleSpec, where: Callable[[str], str], warnings: Sequence[str]
) -> None:
    """Drake made one actuator for each joint with a role.

    Args:
        plant: holds the vehicle, finalised.
        spec: joint roles.
        where: ``file:line`` of a joint in its source.
        warnings: what Drake's parser said, which may tell the reason.

    Raises:
        ModelError: none, or several.
    """
    actuated = [plant.get_joint_actuator(index).joint().name() for index in plant.GetJointActuatorIndices()]
    for name in (*spec.joints.wheels.names(), *spec.joints.steering.names()):
        if actuated.count(name) != 1:
            reason = f" ({'; '.join(warnings)})" if warnings else ""
            raise ModelError(
                f"{where(name)}: joint '{name}' has {actuated.count(name)} actuators; it needs one{reason}"
            )


def _effort(joint: ElementTree.Element) -> float | None:
    """Effort limit [N m] of a joint, None without one."""
    limit = joint.find("limit")
    if limit is None or limit.get("effort") is None:
        return None
    return number(limit.get("effort"))


def _check_drive(urdf: Urdf, spec: VehicleSpec, joints: Mapping[str, ElementTree.Element]) -> None:
    """The effort limits let through the brakes' torque, and at driven wheels the motor's on top of it."""
    driven = spec.driven_wheels()
    share = spec.brakes.front_share
    for wheel in WHEELS:
        name = getattr(spec.joints.wheels, wheel)
        effort = _effort(joints[name])
        if effort is None:
            continue
        drive = spec.powertrain.max_torque / len(driven) if wheel in driven else 0.0
        brake = spec.brakes.max_torque * (share if wheel.startswith("front") else 1.0 - share) / 2.0
        if effort < (drive + brake) * (1.0 - 1e-6):
            raise ModelError(
                f"{urdf.where(joints[name])}: joint '{name}' is limited to {effort:.6g} N m; vehicle.yaml asks for "
                f"{drive + brake:.6g} N m at the {wheel} wheel (drive {spec.drive}: {drive:.6g}, brake {brake:.6g})"
            )
