"""OpenSCENARIO 1.x files: parameters, entities with their catalogues, and positions on the road network.

After ASAM OpenSCENARIO XML 1.0 to 1.3, chapters "Parameters", "Expressions", "Catalogs" and "Positions". Expressions
are arithmetic on parameters; functions are reported as faults.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.xml_reader import XmlDocument, parse_xml, read_xml_bytes
from mirdrake.core.yaml_io import display_path
from mirdrake.worlds.networks import Lane, Network
from mirdrake.worlds.pieces import Placement
from mirdrake.worlds.props import prop_names
from mirdrake.worlds.values import Number, Stream, evaluate, is_random

_LARGEST = 20_000_000  # bytes
_PARAMETER = re.compile(r"\$\{?\s*\$?(\w+)\s*\}?$")
_NAME = re.compile(r"\$(\w+)")
_NESTED = 10  # parameters that refer to one another
_CATALOGUES = 50  # files of catalogues that are searched

_PROPS = {
    "car": "sedan", "van": "van", "truck": "van", "bus": "van", "semitrailer": "van", "trailer": "van",
    "bicycle": "cyclist", "motorbike": "cyclist", "pedestrian": "pedestrian",
}  # fmt: skip


@dataclass(frozen=True)
class Entity:
    """A vehicle, pedestrian or object of a scenario."""

    name: str
    kind: str
    """category, for example car; pedestrian; or that of an object"""
    size: tuple[float, float, float]
    """length, width and height [m]"""
    middle: float
    """middle of its box in front of its reference point [m]"""

    @property
    def prop(self) -> str | None:
        """Prop of its kind; None: a box."""
        prop = _PROPS.get(self.kind)
        return prop if prop in prop_names() else None


class Scenario:
    """A scenario file.

    Args:
        path: the file.

    Raises:
        ConfigError: the file cannot be read or is not OpenSCENARIO 1.x.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_xml_bytes(path, largest=_LARGEST, error=ConfigError, advice="remove what is not needed")
        self.document: XmlDocument = parse_xml(data, display_path(path), error=ConfigError, prefixes=False)
        self.root = self.document.root
        if self.root.tag != "OpenSCENARIO":
            raise ConfigError(f"<{self.root.tag}> is not OpenSCENARIO", where=self.where(self.root))
        if self.root.find("Storyboard") is None:
            raise ConfigError(
                "no <Storyboard>; catalogues and variations are not scenarios", where=self.where(self.root)
            )
        self.parameters = {
            element.get("name", ""): element.get("value", "")
            for element in self.root.iterfind("ParameterDeclarations/ParameterDeclaration")
        }

    def where(self, element: Element) -> str:
        """Return ``file:line`` of an element."""
        return self.document.where(element) if element in self.document.lines else display_path(self.path)

    def text(self, element: Element, key: str, default: str = "") -> str:
        """Return an attribute with its parameter, or its expression, replaced.

        Raises:
            ConfigError: a parameter does not exist, or the expression is invalid.
        """
        return self._resolved(element.get(key, default).strip(), element, key, 0)

    def _resolved(self, value: str, element: Element, key: str, depth: int) -> str:
        """Return the value of a parameter or of an expression, which may contain others; else the text itself."""
        match = _PARAMETER.match(value)
        is_expression = value.startswith("${") and value.endswith("}")
        # The limit ends a circle of references.
        if depth == _NESTED or not (match or is_expression):
            return value
        names = [match[1]] if match else _NAME.findall(value)
        for name in names:
            if name not in self.parameters:
                hint = did_you_mean(name, self.parameters)
                raise ConfigError(f"unknown parameter '{name}' in {key}; {hint}", where=self.where(element))
        values = {name: self._resolved(self.parameters[name].strip(), element, key, depth + 1) for name in names}
        if match:
            return values[match[1]]
        # The expressions of world files are the same arithmetic, but a few forms are random there.
        text, where = value[2:-1], f"{self.where(element)}: {key}"
        if is_random(text):
            raise ConfigError(f"'{value[:60]}' is not arithmetic on parameters (+ - * / and brackets)", where=where)
        numbers = {name: _number_or_text(text) for name, text in values.items()}
        return str(evaluate(text, parameters=numbers, stream=Stream(0, ""), where=where))

    def number(self, element: Element, key: str, default: float | None = None) -> float:
        """Return an attribute as a number.

        Raises:
            ConfigError: it is missing or not a number.
        """
        value = self.text(element, key)
        if not value and default is not None:
            return default
        try:
            result = float(value)
        except ValueError:
            result = math.nan
        # The comparison is false for NaN, too.
        if not abs(result) <= 1e9:
            raise ConfigError(f"{key} '{value[:40]}' of <{element.tag}> should be a number", where=self.where(element))
        return result

    def map_file(self) -> Path | None:
        """Return the file of the road network; None without one."""
        logic = self.root.find("RoadNetwork/LogicFile")
        name = "" if logic is None else self.text(logic, "filepath")
        return self.path.parent / name.replace("\\", "/") if name else None

    def entities(self) -> Iterator[Entity]:
        """Yield the entities, from the file and from its catalogues."""
        for element in self.root.iterfind("Entities/ScenarioObject"):
            reference = element.find("CatalogReference")
            inner = next((e for e in element if e.tag in {"Vehicle", "Pedestrian", "MiscObject"}), None)
            entry = self.text(reference, "entryName") if reference is not None else ""
            catalogue = self.text(reference, "catalogName") if reference is not None else ""
            if inner is None and reference is not None:
                inner = self._from_catalogue(entry)
            # An entity has parameters of its own, to which the reference to a catalogue assigns values.
            known = self.parameters
            for holder, tag, key in ((inner, "Declaration", "name"), (reference, "Assignment", "parameterRef")):
                if holder is not None:
                    rows = holder.iterfind(f"Parameter{tag}s/Parameter{tag}")
                    self.parameters = self.parameters | {
                        row.get(key, "").lstrip("$"): self.text(row, "value") for row in rows
                    }
            entity = self._entity(element.get("name", ""), inner, entry, catalogue)
            self.parameters = known
            yield entity

    def _from_catalogue(self, entry: str) -> Element | None:
        """Return an entry of the catalogues below the folders of the file."""
        folders = [
            self.path.parent / self.text(directory, "path").replace("\\", "/")
            for directory in self.root.iterfind("CatalogLocations/*/Directory")
        ]
        files = [file for folder in folders if folder.is_dir() for file in sorted(folder.glob("*.xosc"))]
        for file in files[:_CATALOGUES]:
            data = read_xml_bytes(file, largest=_LARGEST, error=ConfigError, advice="remove what is not needed")
            root = parse_xml(data, display_path(file), error=ConfigError, prefixes=False).root
            for element in root.iterfind("Catalog/*"):
                if element.get("name") == entry:
                    return element
        return None

    def _entity(self, name: str, element: Element | None, entry: str, catalogue: str) -> Entity:
        """Return an entity; if no catalogue has its entry, kind and size are guessed from the names."""
        words = f"{catalogue} {entry}".lower()
        guess = next((kind for kind in _PROPS if kind in words), "object" if "misc" in words else "car")
        # A usual car, whose reference point is at the rear axle.
        kind, size, middle = guess, (4.5, 1.8, 1.5), 1.35
        if guess == "pedestrian":
            size, middle = (0.5, 0.6, 1.75), 0.0
        if element is not None:
            given = (self.text(element, f"{tag}Category") for tag in ("vehicle", "pedestrian", "miscObject"))
            kind = "pedestrian" if element.tag == "Pedestrian" else next(filter(None, given), guess)
            sides, centre = element.find("BoundingBox/Dimensions"), element.find("BoundingBox/Center")
            try:
                if sides is not None:
                    size = tuple(float(self.text(sides, key)) for key in ("length", "width", "height"))  # type: ignore[assignment]
                middle = float("" if centre is None else self.text(centre, "x"))
            except ValueError:
                middle = 0.0 if kind == "pedestrian" else 1.35
        return Entity(name, kind, size, middle)


def _number_or_text(text: str) -> Number | str:
    try:
        return float(text)
    except ValueError:
        return text


# --- positions ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spot:
    """A position of an entity: pose, and its lane with s and offset [m] if it is on the network."""

    pose: Placement
    lane: str | None = None
    s: float = 0.0
    offset: float = 0.0


def find_spot(scenario: Scenario, position: Element, network: Network | None, spots: Mapping[str, Spot]) -> Spot | None:
    """Return the spot of a <Position>; None for a kind that is not known, or a place that is not on the network.

    Args:
        scenario: the scenario.
        position: the element.
        network: the road network, if there is one.
        spots: those of other entities, for relative positions.
    """
    element = next(iter(position), None)
    if element is None:
        return None
    number, other = scenario.number, spots.get(scenario.text(element, "entityRef"))
    turn = element.find("Orientation")
    turned = turn is not None and "h" in turn.attrib
    heading = number(turn, "h") if turn is not None and turned else 0.0
    # Orientation.type: relative to the lane or to the other entity; a missing one means absolute.
    absolute = turn is not None and turned and scenario.text(turn, "type", "absolute") != "relative"
    if element.tag == "WorldPosition":
        pose = number(element, "x"), number(element, "y"), number(element, "h", 0.0)
        return _located(pose, network)
    if element.tag == "LanePosition" and network is not None:
        found = _on_road(
            network, scenario.text(element, "roadId"), scenario.text(element, "laneId"), number(element, "s")
        )
        return None if found is None else on_lane(*found, number(element, "offset", 0.0), heading, absolute=absolute)
    # All other positions are relative to an entity, which has to have a position already.
    if other is None:
        return None
    x, y, yaw = other.pose
    if element.tag == "RelativeLanePosition" and network is not None and other.lane is not None:
        found = _relative(network, other, round(number(element, "dLane")), number(element, "ds", 0.0))
        return None if found is None else on_lane(*found, number(element, "offset", 0.0), heading, absolute=absolute)
    if element.tag in {"RelativeObjectPosition", "RelativeWorldPosition"}:
        dx, dy = number(element, "dx"), number(element, "dy")
        # Offsets are along the axes of the other entity, or along those of the world.
        c, s = (math.cos(yaw), math.sin(yaw)) if element.tag == "RelativeObjectPosition" else (1.0, 0.0)
        return _located((x + c * dx - s * dy, y + s * dx + c * dy, heading if absolute else yaw + heading), network)
    return None


def on_lane(lane: Lane, s: float, offset: float, heading: float, *, absolute: bool = False) -> Spot:
    """Return a spot on a lane.

    Args:
        lane: the lane.
        s: station on it [m].
        offset: from its middle [m], + left of the reference line, also on lanes against it.
        heading: against the lane, or that in the world if it is absolute [rad].
        absolute: whether it is.
    """
    aside = offset * lane.direction
    x, y, yaw = (float(value) for value in lane.pose(s, aside))
    return Spot((x, y, heading if absolute else yaw + heading), lane.id, s, aside)


def lane_beside(number: int, lanes: int) -> int:
    """Return the number of the lane that is some lanes to the left in the direction of the reference line."""
    # There is no lane 0: lane 1 follows lane -1.
    place = (number if number < 0 else number - 1) + lanes
    return place if place < 0 else place + 1


def lanes_between(number: int, other: int) -> int:
    """Return how many lanes another one is to the left of a lane in the direction of the reference line."""
    return (other if other < 0 else other - 1) - (number if number < 0 else number - 1)


def _on_road(network: Network, road: str, number: str, s: float) -> tuple[Lane, float] | None:
    """Return the lane of a road, with its number, at a station of the road, and the station on the lane."""
    rows = [
        lane for lane in network.lanes.values() if lane.road == road and str(lane.number) == number and len(lane.road_s)
    ]
    for lane in rows:
        low, high = float(lane.road_s.min()), float(lane.road_s.max())
        if low - 1e-6 <= s <= high + 1e-6:
            # np.interp needs increasing stations, so that lanes against the reference line are reversed.
            order = slice(None, None, lane.direction)
            return lane, float(np.interp(s, lane.road_s[order], lane.s[order]))
    return None


def _relative(network: Network, other: Spot, lanes: int, ahead: float) -> tuple[Lane, float] | None:
    """Return the lane a number of lanes (+ left) beside a spot, and the station a distance ahead along it [m]."""
    assert other.lane is not None
    lane = network.lanes[other.lane]
    # Lanes beside each other belong to the same section of the same road.
    beside = [
        row
        for row in network.lanes.values()
        if row.road == lane.road and row.id.split(".")[1:2] == lane.id.split(".")[1:2]
    ]
    number = lane_beside(lane.number, lanes * lane.direction)
    target = next((row for row in beside if row.number == number), None)
    if target is None:
        return None
    x, y, _ = lane.pose(other.s)
    s, _ = target.project(x, y)
    # Beyond the end of the lane the position continues on its successor.
    at = float(s) + ahead * (1.0 if target.direction == lane.direction else -1.0)
    while at > target.length and target.successors:
        at -= target.length
        target = network.lanes[target.successors[0]]
    return (target, at) if 0.0 <= at <= target.length else None


def _located(pose: Placement, network: Network | None) -> Spot:
    if network is None:
        return Spot(pose)
    lane, s, offset = network.locate(*pose)
    return Spot(pose, lane.id, s, offset) if abs(offset) < float(lane.width_at(s)) else Spot(pose)
