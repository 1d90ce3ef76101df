"""Label pictures: a number for each object, and a table of their names."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pydrake.geometry import GeometryId, PerceptionProperties, RenderLabel, Role
from pydrake.multibody.tree import BodyIndex

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts

SKY = 0
"""Label of a pixel that shows no object."""


def label_names(parts: "PlantParts") -> dict[int, str]:
    """Return the names by label: ``sky`` (0), ``ground``, ``road``, ``line``, ``patch/<name>``, others.

    Roads share a label, and so do painted lines. The numbers follow from the world and the vehicles alone.
    """
    return {SKY: "sky"} | {number: name for name, number in _numbers(parts).items()}


def assign_labels(parts: "PlantParts") -> None:
    """Assign to every visual geometry the label of its object, before a renderer is added."""
    numbers, plant, scene_graph = _numbers(parts), parts.plant, parts.scene_graph
    actors = {geometry for geometries in parts.actors.geometries.values() for geometry in geometries}
    for geometry, name in _owners(parts):
        # Drake cannot change the label of a geometry; the role must be removed and assigned again.
        look = PerceptionProperties(scene_graph.model_inspector().GetPerceptionProperties(geometry))
        look.UpdateProperty("label", "id", RenderLabel(numbers[name]))
        source = parts.actors.source if geometry in actors else plant.get_source_id()
        scene_graph.RemoveRole(source, geometry, Role.kPerception)
        scene_graph.AssignRole(source, geometry, look)


def _numbers(parts: "PlantParts") -> dict[str, int]:
    return {name: number for number, name in enumerate(dict.fromkeys(name for _, name in _owners(parts)), start=1)}


def _owners(parts: "PlantParts") -> Iterator[tuple[GeometryId, str]]:
    """Yield visual geometries and the object that each belongs to."""
    plant, inspector = parts.plant, parts.scene_graph.model_inspector()
    vehicles = {part.instance: f"vehicle/{name}" for name, part in parts.vehicles.items()}
    props = {body.index(): f"prop/{name}" for name, body in parts.props.bodies.items()}
    for index in range(plant.num_bodies()):
        body = plant.get_body(BodyIndex(index))
        for geometry in plant.GetVisualGeometriesForBody(body):
            if inspector.GetPerceptionProperties(geometry) is None:
                continue
            # Drake prefixes names with the model instance.
            name = inspector.GetName(geometry).rpartition("::")[2]
            owner = vehicles.get(body.model_instance()) or props.get(body.index())
            yield geometry, owner or _fixed(name) or body.name()
    for actor, geometries in parts.actors.geometries.items():
        yield from ((geometry, f"actor/{actor}") for geometry in geometries)


def _fixed(name: str) -> str | None:
    """Return the object that a geometry fixed in the world belongs to, by its name."""
    kind, _, rest = name.partition("/")
    if kind == "prop":
        return f"prop/{rest.rpartition('/')[0]}"
    if kind != "scenery":
        return None
    surface_name = rest.removeprefix("world/")
    if surface_name.startswith("patch."):
        return f"patch/{surface_name.removeprefix('patch.')}"
    return {"ground": "ground", "road": "road", "lines": "line"}.get(surface_name.rpartition("/")[2])
