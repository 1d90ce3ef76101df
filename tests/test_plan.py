"""The plan of a world: positions of all elements, legible names, overlaps in red."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from PIL import ImageFont

from mirdrake.report.plan import draw_plan, find_overlaps
from mirdrake.report.svg import embed_svg
from mirdrake.worlds import World, load_world, make_world

SVG = "{http://www.w3.org/2000/svg}"

LOT: dict[str, Any] = {
    "mirdrake": "world/1",
    "name": "lot",
    "seed": 3,
    "params": {"mu": 0.3},
    "ground": {"size": [60, 40], "patches": [{"name": "ice", "rect": {"center": [6, 0], "size": [8, 4]}, "mu": "$mu"}]},
    "start": {"gate": {"at": [-22, 0], "yaw": "90 deg"}},
    "goals": {"exit": {"at": [22, 0], "radius": 1.5}},
    "props": [
        {
            "prop": "sedan | van",
            "name": "car",
            "grid": {"origin": [-14, -7], "step": [5.5, 14], "count": [6, 2]},
            "yaw": ["90 deg", "-90 deg"],
        },
        {"prop": "pedestrian", "at": [10, 1.5]},
        {"prop": "cone", "line": {"from": [-20, 3], "to": [-14, 3], "spacing": 1.5}},
        {"box": [3, 2, 1], "name": "kiosk", "at": [22, -8], "color": [0.1, 0.2, 1.0]},
    ],
}
CITY: dict[str, Any] = {
    "mirdrake": "world/1",
    "name": "city",
    "props": [
        {"box": [20, 20, 15], "name": "tower", "grid": {"origin": [-35, -35], "step": [35, 35], "count": [3, 3]}}
    ],
}
CRATES: dict[str, Any] = {
    "mirdrake": "world/1",
    "name": "crates",
    "props": [
        {"box": [4, 4, 2], "name": "a", "at": [10, 20]},
        {"box": [4, 4, 2], "name": "b", "at": [13, 21]},
        {"box": [40, 4, 1], "name": "bridge", "at": [10, 20, 2]},
        {"cylinder": [0.3, 2], "name": "post", "at": [30, 30]},
        {"cylinder": [0.3, 2], "name": "pole", "at": [30.2, 30]},
    ],
}


class Plan:
    """Content of a plan."""

    def __init__(self, world: World, **options: Any) -> None:
        self.text = draw_plan(world, **options)
        self.root = ElementTree.fromstring(self.text)
        (self.map,) = [e for e in self.root.iter(f"{SVG}g") if e.get("class") == "map"]

    def texts(self) -> list[str]:
        return ["".join(element.itertext()) for element in self.root.iter(f"{SVG}text")]

    def names(self) -> list[str]:
        """Return the texts on the map."""
        return ["".join(element.itertext()) for element in self.map.iter(f"{SVG}text")]

    def shapes(self, kind: str) -> list[ElementTree.Element]:
        return [element for element in self.map if element.get("class") == kind]

    def in_world(self, element: ElementTree.Element) -> shapely.Polygon:
        """Return the polygon of a path in W [m]."""
        x, y, scale, left, bottom = (
            float(str(self.map.get(f"data-{key}"))) for key in ("x", "y", "scale", "left", "bottom")
        )
        points = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", str(element.get("d"))), dtype=float)
        return shapely.Polygon(
            np.column_stack((x + (points[:, 0] - left) / scale, y + (bottom - points[:, 1]) / scale))
        )


def _title(element: ElementTree.Element) -> str:
    return str(element.findtext(f"{SVG}title"))


def test_a_car_park_shows_its_cars_by_name() -> None:
    world = make_world(LOT)
    plan = Plan(world)
    for name in ("gate", "exit", "pedestrian", "kiosk", "cone × 5", "ice: μ 0.3", *(f"car[{i}]" for i in range(12))):
        assert plan.names().count(name) == 1, name
    for text in ("lot", "ground: μ 0.85, asphalt", "start gate", "goal exit", "5 × cone", "1 × pedestrian"):
        assert text in plan.texts()
    assert "seed 3  ·  mu = 0.3  ·  19 props  ·  ground 60 m × 40 m" in plan.texts()
    assert "Overlaps" not in plan.text


def test_a_city_shows_its_towers_by_name() -> None:
    assert [name for name in Plan(make_world(CITY)).names() if "tower" in name] == [f"tower[{i}]" for i in range(9)]


def test_props_patches_and_the_start_are_where_they_are() -> None:
    world = make_world(LOT)
    plan = Plan(world)
    shown = {_title(element).partition(":")[0]: element for element in plan.shapes("prop")}
    for placed in world.props:
        if placed.prop.name in {"sedan", "van", "box"}:
            drawn = plan.in_world(shown[placed.name])
            assert drawn.symmetric_difference(placed.footprint).area < 0.02 * placed.footprint.area
    assert shown["kiosk"].get("fill") == "#1a33ff"
    assert plan.in_world(plan.shapes("patch")[0]).symmetric_difference(world.patches[0].area).area < 0.1
    arrow = plan.in_world(plan.shapes("start")[0])  # looks along y
    assert arrow.bounds[1] == pytest.approx(0.0, abs=0.01)
    assert arrow.centroid.x == pytest.approx(-22.0, abs=0.01)
    assert arrow.bounds[3] > 1.0


def test_small_props_are_dots_in_the_middle_of_their_place() -> None:
    plan = Plan(make_world(LOT | {"props": [{"prop": "cone", "at": [0, 0]}, {"prop": "cone", "at": [500, 0]}]}))
    assert [element.tag for element in plan.shapes("prop")] == [f"{SVG}circle"] * 2
    a, b = (float(str(element.get("cx"))) for element in plan.shapes("prop"))
    assert b - a == pytest.approx(500.0 * float(str(plan.map.get("data-scale"))), abs=0.05)


def test_people_are_symbols_where_their_outline_would_be_too_small() -> None:
    people = [{"prop": "pedestrian", "name": "far", "at": [90, 0]}, {"prop": "cyclist", "name": "rider", "at": [0, 0]}]
    plan = Plan(make_world(LOT | {"props": people}))
    assert {_title(element).partition(":")[0]: element.tag for element in plan.shapes("prop")} == dict.fromkeys(
        ("far", "rider"), f"{SVG}g"
    )
    # Names begin beside the symbol, 7 px high and 3.5 px wide from its middle.
    (symbol,) = [element for element in plan.shapes("prop") if _title(element).startswith("far")]
    x, y = map(float, re.findall(r"[\d.]+", str(symbol.get("transform"))))
    (name,) = [element for element in plan.map.iter(f"{SVG}text") if element.text == "far"]
    assert (float(str(name.get("x"))), float(str(name.get("y")))) == pytest.approx((x + 3.5 + 4.0, y), abs=0.02)


def test_a_name_above_a_prop_is_centred_on_it() -> None:
    # Boxes at both sides leave room above only.
    row = [{"box": [1, 1, 1], "name": name, "at": [x, 0]} for name, x in (("a", -1.2), ("middle", 0), ("b", 1.2))]
    plan = Plan(make_world(CITY | {"props": row, "start": {"s": {"at": [60, 60]}}}))
    (name,) = [element for element in plan.map.iter(f"{SVG}text") if element.text == "middle"]
    assert name.get("text-anchor") == "middle"
    x, left, scale = (float(str(plan.map.get(f"data-{key}"))) for key in ("x", "left", "scale"))
    assert x + (float(str(name.get("x"))) - left) / scale == pytest.approx(0.0, abs=0.01)


def test_actors_are_drawn_at_their_starts() -> None:
    world = load_world("pedestrian_crossing")
    plan = Plan(world)
    (actor,) = plan.shapes("prop")
    x, y, _ = world.actor_start(world.actors[0])
    assert _title(actor) == f"walker: pedestrian, starts at ({x:.2f}, {y:.2f}) m"
    assert {"walker", "1 × pedestrian", "Actors"} <= set(plan.texts())


def test_overlaps_are_red_where_they_are() -> None:
    world = make_world(CRATES)
    overlaps = find_overlaps(world)
    assert [(a, b) for a, b, _ in overlaps] == [("a", "b"), ("post", "pole")]  # the bridge is above
    assert overlaps[0][2].equals(shapely.box(11.0, 19.0, 12.0, 22.0))
    plan = Plan(world, overlaps=overlaps)
    shown = plan.shapes("overlap")
    assert [_title(element) for element in shown] == ["a and b overlap", "post and pole overlap"]
    assert {element.get("fill") for element in shown} == {"#dc2626"}
    for element, (_, _, area) in zip(shown, overlaps, strict=True):
        assert plan.in_world(element).symmetric_difference(area).area < 0.03
    assert {"Overlaps: 2", "a, b", "post, pole"} <= set(plan.texts())
    assert not Plan(world).shapes("overlap")


def test_an_overlap_that_a_rule_allows_and_a_touch_are_not_reported() -> None:
    assert (
        find_overlaps(
            make_world(CRATES | {"rules": [{"allow_overlap": ["a", "b"]}, {"allow_overlap": ["po*", "po*"]}]})
        )
        == []
    )
    touching = [{"box": [1, 1, 1], "name": "a", "at": [0, 0]}, {"box": [1, 1, 1], "name": "b", "at": [1, 0]}]
    assert find_overlaps(make_world(CRATES | {"props": touching})) == []
    assert find_overlaps(make_world({"mirdrake": "world/1"})) == []


@pytest.mark.parametrize("which", ["lot", "city", "crates", "crowd", "test_track", "skidpad"])
def test_no_name_overlaps_another_or_leaves_the_map(which: str) -> None:
    crowd: list[dict[str, Any]] = [{"prop": "tree", "scatter": {"region": {"disc": {"radius": 30}}, "count": 60}}]
    crowd += [{"box": [0.5, 0.5, 1], "name": f"thing_{i}", "at": [40 + 2 * (i % 5), 2 * (i // 5)]} for i in range(25)]
    worlds = {"lot": LOT, "city": CITY, "crates": CRATES, "crowd": CITY | {"props": crowd}}
    world = make_world(worlds[which]) if which in worlds else load_world(which)
    plan = Plan(world, overlaps=find_overlaps(world))
    font = ImageFont.load_default(size=12)
    boxes = []
    for element in plan.map.iter(f"{SVG}text"):
        x, y = float(str(element.get("x"))), float(str(element.get("y")))
        long = font.getlength("".join(element.itertext())) / 2.0
        middle = {"middle": 0.0, "end": -long}.get(element.get("text-anchor", ""), long)
        dy = 4.0 if element.get("dy") is None else 0.0  # on the base line
        box = shapely.box(x + middle - long, y - dy - 5.0, x + middle + long, y - dy + 5.0)
        boxes.append(shapely.affinity.rotate(box, 90, origin=(x, y)) if "transform" in element.keys() else box)  # noqa: SIM118
    assert len(boxes) >= 4
    tree = shapely.STRtree(boxes)
    pairs = [(i, j) for i, j in tree.query(boxes, predicate="intersects").T.tolist() if i < j]
    assert [(plan.names()[i], plan.names()[j]) for i, j in pairs] == []
    (frame,) = list(plan.root.iter(f"{SVG}clipPath"))
    left, top, width, height = (float(str(frame[0].get(key))) for key in ("x", "y", "width", "height"))
    assert shapely.box(left, top, left + width, top + height).contains(shapely.union_all(boxes))


def test_a_group_and_a_series_are_named_once() -> None:
    block = {
        "props": [
            {"prop": "building", "at": [0, 0]},
            {"prop": "tree", "name": "oak", "ring": {"radius": 18, "count": 5}},
        ]
    }
    entries = [{"group": "block", "grid": {"origin": [0, -25], "step": [60, 1], "count": [3, 1]}},
               {"prop": "tree", "line": {"from": [0, 40], "to": [120, 40], "count": 12}}]  # fmt: skip
    names = Plan(make_world(CITY | {"groups": {"block": block}, "props": entries})).names()
    for name in ("block[0]", "block[1]", "block[2]", "tree × 12"):
        assert names.count(name) == 1, name
    assert names.count("building") == 3


def test_roads_goals_and_friction_of_a_track_are_shown() -> None:
    world = load_world("test_track")
    plan = Plan(world)
    assert {"line", "main (965 m)"} <= set(plan.names())
    assert {"main: μ 0.9, asphalt", "ground: μ 0.5, grass", "goal lap: 1 lap"} <= set(plan.texts())
    assert _title(plan.shapes("road")[0]) == "track main: 965.0 m, 3 m wide, asphalt, μ 0.9"
    dashes = [element.get("stroke-dasharray") for element in plan.map if element.get("stroke") == "#ffffff"]
    assert sum(dash is not None for dash in dashes) == 1


def test_a_gate_is_a_line_across_the_road() -> None:
    track = {"segments": [{"line": 80}], "width": 6}
    world = make_world(
        CITY | {"tracks": {"t": track}, "goals": {"end": {"gate": {"track": "t", "s": 60}}}, "props": []}
    )
    plan = Plan(world)
    (gate,) = plan.shapes("goal")
    points = re.findall(r"([\d.]+) ([\d.]+)", str(gate.get("d")))
    scale, left, x = (float(str(plan.map.get(f"data-{key}"))) for key in ("scale", "left", "x"))
    assert {round(x + (float(px) - left) / scale, 2) for px, _ in points} == {60.0}
    assert "end" in plan.names()


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"props": [{"sphere": 0.01, "name": "bead", "at": [0, 0]}]},
        {"props": [{"box": [1, 1, 1], "line": {"from": [-150, 0], "to": [150, 0], "count": 400}}]},
        {"ground": {"slope": {"grade": 0.05, "heading": "90 deg"}, "patches": [{"disc": {"radius": 90}, "mu": 0.4}]}},
        {"params": {"a": "x", "b": 1.5}, "name": "<b> & {braces} {0}"},
    ],
)
def test_every_world_can_be_drawn_and_embedded(keys: dict[str, Any]) -> None:
    world = make_world({"mirdrake": "world/1", "name": "w"} | keys)
    plan = Plan(world)
    assert world.name in plan.texts()
    size = [float(x) for x in str(plan.root.get("viewBox")).split()]
    assert 400.0 < size[2] <= 1200.0
    assert 400.0 < size[3] < 1000.0
    assert "origin" in plan.names()
    page = embed_svg(plan.text, "w-", decimals=2)
    assert "url(#w-frame)" in page
    assert page.count("<text") == plan.text.count("<text")


def test_the_same_world_gives_the_same_picture(tmp_path: Path) -> None:
    path = tmp_path / "city.yaml"
    path.write_text(
        "mirdrake: world/1\nprops: [{prop: tree, scatter: {region: {disc: {radius: 20}}, count: 9}}]\n",
        encoding="utf-8",
    )
    first, second = (draw_plan(load_world(str(path), overrides=["seed=5"])) for _ in range(2))
    assert first == second
    assert str(tmp_path) not in first
