"""ros_control: transmissions in the URDF, controllers and gains in YAML files."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from math import isfinite
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from mirdrake.core.yaml_io import display_path
from mirdrake.importing.values import to_number
from mirdrake.importing.vehicles.model import Controller, SourceModel, Transmission

_LARGEST = 1_000_000  # bytes of a YAML file that is still read
_INTERFACES = ("effort", "velocity", "position")


def read_transmission(
    element: ElementTree.Element, model: SourceModel, where: Callable[[ElementTree.Element], str]
) -> None:
    """Read a ``<transmission>`` in any of its dialects."""
    reduction = element.find(".//mechanicalReduction")
    try:
        ratio = float(reduction.text or "1") if reduction is not None else 1.0
    except ValueError:
        ratio = 1.0
    texts = [interface.text or "" for interface in element.iter("hardwareInterface")]
    for joint in element.findall("joint"):
        kinds = tuple(kind for kind in _INTERFACES if any(kind in text.lower() for text in texts))
        model.transmissions.append(Transmission(joint.get("name", ""), kinds, ratio, where(element)))


def read_ros2_control(
    element: ElementTree.Element, model: SourceModel, where: Callable[[ElementTree.Element], str]
) -> None:
    """Read the joints and command interfaces of a ``<ros2_control>`` system."""
    for joint in element.findall("joint"):
        kinds = tuple(interface.get("name", "") for interface in joint.findall("command_interface"))
        if kinds:
            known = tuple(kind for kind in _INTERFACES if kind in kinds)
            ranges = {
                interface.get("name", ""): largest
                for interface in joint.findall("command_interface")
                if (largest := _largest_command(interface)) is not None
            }
            model.transmissions.append(Transmission(joint.get("name", ""), known, 1.0, where(joint), ranges))


def _largest_command(interface: ElementTree.Element) -> float | None:
    """Return the largest command that an interface allows in both directions, if it states one."""
    values = {param.get("name"): to_number(param.text or "") for param in interface.findall("param")}
    sizes = [abs(value) for name in ("min", "max") if (value := values.get(name)) is not None and isfinite(value)]
    return min((size for size in sizes if size > 0.0), default=None)


def read_controllers(folders: Iterable[Path], model: SourceModel, *, only: Set[str] | None = None) -> None:
    """Read controllers from the YAML files of packages; with `only`, those of these joints."""
    for folder in folders:
        for below in ("config", "param", "params", "cfg", "yaml", "control"):
            for path in sorted((folder / below).rglob("*.y*ml")) if (folder / below).is_dir() else ():
                controllers = _read_file(path)
                model.controllers += (
                    controllers if only is None else [item for item in controllers if only & set(item.joints)]
                )


def _read_file(path: Path) -> list[Controller]:
    try:
        if path.stat().st_size > _LARGEST:
            return []
        data = yaml.safe_load(path.read_text(encoding="utf-8", errors="replace"))
    except (OSError, yaml.YAMLError, ValueError, RecursionError):
        return []
    return list(_controllers(data, (), display_path(path)))


def _controllers(data: Any, path: tuple[str, ...], where: str) -> Iterator[Controller]:
    if not isinstance(data, Mapping) or len(path) > 8:
        return
    # A controller is a mapping with a type such as package/Class, or with gains; others are searched inside.
    kind = data.get("type")
    gains = {
        str(name): pid
        for key in ("pid_gains", "gains")
        if isinstance(data.get(key), Mapping)
        for name, entry in data[key].items()
        if (pid := _gains(entry))
    }
    if pid := _gains(data.get("pid")):
        gains[str(data.get("joint", ""))] = pid
    if (isinstance(kind, str) and "/" in kind) or gains:
        joints = data.get("joints", data.get("joint", ()))
        names = tuple(map(str, joints)) if isinstance(joints, list) else (str(joints),) if joints else tuple(gains)
        values = {str(key): str(value) for key, value in data.items() if not isinstance(value, Mapping | list)}
        yield Controller(".".join(path), str(kind or ""), names, gains, values, where)
    for key, value in data.items():
        yield from _controllers(value, (*path, str(key)), where)


def _gains(entry: Any) -> dict[str, float]:
    """Return p, i, d and limits of a mapping; empty if it has none."""
    if not isinstance(entry, Mapping) or "p" not in entry:
        return {}
    return {str(key): float(value) for key, value in entry.items() if isinstance(value, int | float)}
