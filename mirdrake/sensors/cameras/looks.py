"""Visibility of geometries in renderers: perception properties, which Drake does not allow to replace."""

from collections.abc import Iterable

from pydrake.geometry import GeometryId, PerceptionProperties, Role, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder


def add_to_look(
    plant: MultibodyPlant, scene_graph: SceneGraph, geometry: GeometryId, base: PerceptionProperties
) -> None:
    """Add perception properties to those of a geometry, if it has any; Drake cannot replace this role."""
    old = scene_graph.model_inspector().GetPerceptionProperties(geometry)
    if old is None:
        return
    new = PerceptionProperties(base)
    for group in old.GetGroupNames() - {"renderer"}:
        for name in old.GetPropertiesInGroup(group):
            new.UpdateProperty(group, name, old.GetProperty(group, name))
    scene_graph.RemoveRole(plant.get_source_id(), geometry, Role.kPerception)
    scene_graph.AssignRole(plant.get_source_id(), geometry, new)


def seen_by(renderers: Iterable[str]) -> PerceptionProperties:
    """Return properties with the names of the renderers that show a geometry.

    Drake expects a C++ set, which cannot be made in Python; it is taken from a parsed URDF.
    """
    # "none" keeps the set non-empty: Drake shows a geometry with an empty set in all renderers.
    tags = "".join(f'<drake:accepting_renderer name="{name}"/>' for name in (*renderers, "none"))
    visual = f'<visual><geometry><box size="1 1 1"/></geometry>{tags}</visual>'
    urdf = f'<robot name="m" xmlns:drake="http://drake.mit.edu"><link name="l">{visual}</link></robot>'
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.01)
    Parser(plant).AddModelsFromString(urdf, "urdf")
    (geometry,) = plant.GetVisualGeometriesForBody(plant.GetBodyByName("l"))
    return PerceptionProperties(scene_graph.model_inspector().GetPerceptionProperties(geometry))
