"""``<gazebo>`` tags of a URDF: surfaces, colours, sensors and plugins, which URDF parsers ignore."""

from collections.abc import Callable
from xml.etree import ElementTree

import numpy as np

from mirdrake.core.errors import ModelError
from mirdrake.importing.changes import Code
from mirdrake.importing.sdf.colours import colour_of
from mirdrake.importing.shape import Shape
from mirdrake.importing.values import leaves, make_pose, read_number, read_numbers
from mirdrake.importing.vehicles.model import Plugin, SensorTag, SourceModel, Surface
from mirdrake.importing.vehicles.plugin_sensors import take_plugin

Where = Callable[[ElementTree.Element], str]

SCRIPT = "material scripts of Gazebo are not read; the colours of the mesh are used, or grey"

_SURFACE = {"mu1": "mu", "mu": "mu", "mu2": "mu2", "kp": "stiffness", "kd": "damping"}
_WITHOUT_EFFECT = {
    "turnGravityOff", "selfCollide", "gravity", "self_collide", "provideFeedback", "implicitSpringDamper", "static",
    "disableFixedJointLumping", "preserveFixedJoint", "dampingFactor", "maxContacts", "fdir1",
}  # fmt: skip
_SPRING_KEYS = {"body_A", "body_B", "stiffness", "damping"}


def read_gazebo_tag(element: ElementTree.Element, model: SourceModel, where: Where) -> None:
    """Read a ``<gazebo>`` tag; elements without counterpart become changes.

    Raises:
        ModelError: a value is not a number.
    """
    name = element.get("reference", "")
    link, joint = model.links.get(name), model.joints.get(name)
    location = where(element)
    for child in element:
        tag, text = child.tag, (child.get("value") or child.text or "").strip()  # Gazebo takes either
        # Tags without effect on a vehicle are ignored; all others are read or reported.
        if tag == "sensor":
            model.sensors.append(read_sensor(child, name, where, model))
        elif tag == "plugin":
            plugin = Plugin(child.get("name", ""), child.get("filename", ""), leaves(child), where(child))
            take_plugin(plugin, name, model)
        elif link is not None and tag in _SURFACE:
            # Surface values of several tags of one link accumulate; the first one creates the surface.
            link.surface = link.surface or Surface(where=location)
            setattr(link.surface, _SURFACE[tag], read_number(text, where=where(child), what=f"<{tag}>"))
        elif link is not None and tag in {"minDepth", "maxVel", "min_depth", "max_vel"}:
            link.surface = link.surface or Surface(where=location)
            link.surface.others[tag] = text
        elif link is not None and tag == "material":
            # A script of OGRE is named, not included: names of Gazebo's own colours are known.
            named = text or _script_name(child)
            if not _paint(link.visuals, named):
                model.changes.add(Code.MATERIAL, where(child), f"link '{name}': material", named, None, SCRIPT)
        elif joint is not None and tag in {"springStiffness", "stiffness"}:
            joint.stiffness = read_number(text, where=where(child), what=f"<{tag}>")
        elif link is not None and tag in {"visual", "collision"} and child.find("material") is not None:
            _paint(link.visuals, _script_name(child.find("material")))
        elif tag not in _WITHOUT_EFFECT or (name and link is None and joint is None):
            about = f"<gazebo{f' reference={name!r}' if name else ''}>: <{tag}>"
            why = "it has no counterpart in mirdrake" if not name or link is not None or joint is not None else (
                f"the link or joint '{name}' does not exist"
            )  # fmt: skip
            model.changes.add(Code.ELEMENT, where(child), about, text[:80] or "…", None, why)


def read_spring_damper(element: ElementTree.Element, model: SourceModel, where: Where) -> None:
    """Read a ``<drake:linear_spring_damper>`` into the prismatic joint between its links."""
    # Tags are named like linear_spring_damper_body_A; the part after the common prefix is the key.
    values = {
        child.tag.rpartition("_spring_damper_")[2]: (
            child.get("name") or child.get("value") or child.text or ""
        ).strip()
        for child in element
    }
    ends = {values.get("body_A", ""), values.get("body_B", "")}
    stiffness, damping = (
        read_number(values.get(key), where=where(element), what=f"spring {key}") for key in ("stiffness", "damping")
    )
    # A spring between two points acts like a joint spring only along a prismatic joint.
    for joint in model.joints.values():
        if joint.kind == "prismatic" and {joint.parent, joint.child} == ends and stiffness is not None:
            joint.stiffness, joint.damping = stiffness, joint.damping + (damping or 0.0)
            for key in sorted(values.keys() - _SPRING_KEYS):
                part, why = (
                    f"spring of joint '{joint.name}': {key}",
                    "a spring acts along its joint and carries the car",
                )
                model.changes.add(Code.ELEMENT, where(element), part, values[key], None, why)
            return
    was = " and ".join(sorted(ends))
    why = "no prismatic joint connects its links"
    model.changes.add(Code.ELEMENT, where(element), "spring between links", was, None, why)


def read_sensor(element: ElementTree.Element, link: str, where: Where, model: SourceModel) -> SensorTag:
    """Return the ``<sensor>`` of a link; numbers that cannot be read become changes."""
    name = element.get("name", "") or element.get("type", "sensor")
    values = leaves(element)

    pose, rate = np.zeros(6), None
    rates = (values.get(key) for key in ("update_rate", "updateRate", "plugin.updateRate"))
    # A sensor without a readable pose or rate is kept, at its link and with the usual rate.
    try:
        pose = read_numbers(values.get("pose"), count=6, default=[0.0] * 6, where=where(element), what="<pose>")
        if values.get("pose.degrees") in ("1", "true"):
            pose[3:] = np.radians(pose[3:])
    except ModelError as error:
        model.changes.add(Code.SENSOR, where(element), f"sensor '{name}': place", error.text, "at the link", "no pose")
    try:
        rate = read_number(next(filter(None, rates), None), where=where(element), what="<update_rate>")
    except ModelError as error:
        model.changes.add(Code.SENSOR, where(element), f"sensor '{name}': rate", error.text, "usual", "no rate")
    return SensorTag(
        name=name,
        kind=element.get("type", "").lower(),
        link=link,
        X_LS=make_pose(pose[:3], pose[3:]),
        rate=rate,
        values=values,
        plugins=tuple(plugin.get("filename", "") for plugin in element.iter("plugin")),
        where=where(element),
    )


def _paint(visuals: list[Shape], name: str) -> bool:
    """Give visuals the colour of a material; return whether the material is known."""
    colour = colour_of(name)
    for shape in visuals:
        if colour is not None and shape.texture is None:
            shape.rgba = colour
    return colour is not None or not name


def _script_name(material: ElementTree.Element | None) -> str:
    name = material.find("script/name") if material is not None else None
    return (name.text or "").strip() if name is not None else ""
