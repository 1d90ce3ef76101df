"""Gazebo plugins that are sensors without a ``<sensor>`` tag, such as those of hector_gazebo_plugins."""

import re
from math import isfinite

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Code
from mirdrake.importing.values import make_pose, to_number
from mirdrake.importing.vehicles.model import Plugin, SensorTag, SourceModel

_KINDS = (("imu", "imu"), ("gps|gnss|navsat", "gps"), ("sonar|ultraso|gazebo_ros_range", "sonar"))
_NONE = {
    "p3d|ground_truth": "ground truth is not a sensor; use the state of the vehicle (ego.state)",
    "magnet|baro|altimeter|pressure": "mirdrake has no such sensor",
}
_BODIES = ("bodyName", "linkName", "link_name", "body_name", "link")
_FRAMES = ("frameName", "frame_name", "frameId", "frame_id")  # often a label of the messages only
_RATES = ("updateRate", "update_rate", "rate", "pubRate")


def take_plugin(plugin: Plugin, reference: str, model: SourceModel) -> None:
    """Add a plugin to a model: as a sensor if it is one, else as a plugin.

    Args:
        plugin: plugin of the model or of a ``<gazebo>`` tag.
        reference: link of that tag; "" for none.
        model: all its links are known already.
    """
    file = plugin.filename or plugin.name
    for words, why in _NONE.items():
        if re.search(words, file, re.IGNORECASE):
            part = f"plugin '{plugin.name or plugin.filename}'"
            model.changes.add(Code.PLUGIN, plugin.where, part, plugin.filename, None, why)
            return
    # The file name of the plugin decides, since names of plugins are free text.
    kind = next((kind for words, kind in _KINDS if re.search(words, file, re.IGNORECASE)), None)
    link, named = _link_of(plugin, reference, model)
    # A system of gz-sim, as gz::sim::systems::Imu, serves all sensors of a world and has no link.
    system = "system" in f"{plugin.filename} {plugin.name}"
    if kind is None or (not link and not named and system):
        model.plugins.append(plugin)
        return
    if not link and not named:
        link = next(iter(model.links), "")
        why = "the plugin names no link; Gazebo uses the root link"
        model.changes.add(Code.SENSOR, plugin.where, f"sensor '{plugin.name}': link", "none", link, why)
    X_LS = RigidTransform(make_pose(_triple(plugin, "xyzOffset"), _triple(plugin, "rpyOffset")))
    rate = next((to_number(plugin.values[key]) for key in _RATES if key in plugin.values), None)
    name = plugin.name or plugin.filename
    model.sensors.append(SensorTag(name, kind, link or named, X_LS, rate, dict(plugin.values), (file,), plugin.where))


def _link_of(plugin: Plugin, reference: str, model: SourceModel) -> tuple[str, str]:
    """Return the link that carries a plugin, and the link name of the plugin if no such link exists."""
    named = next((plugin.values[key] for key in _BODIES if plugin.values.get(key)), "")
    for text in (named,) if named else (*(plugin.values.get(key, "") for key in _FRAMES), reference):
        for word in (text, text.rpartition("::")[2], text.rpartition("/")[2]):
            if word and word in model.links:
                return word, word
    return "", named


def _triple(plugin: Plugin, key: str) -> np.ndarray:
    """Return three finite numbers of a plugin; zeros if it has none."""
    numbers = [to_number(word) for word in plugin.values.get(key, "").split()]
    good = [value for value in numbers if value is not None and isfinite(value)]
    return np.array(good if len(good) == 3 else [0.0, 0.0, 0.0])
