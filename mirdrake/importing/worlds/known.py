"""Well-known models of Gazebo's model database, and the props that replace them if their files are missing.

Sizes are those of the models, measured on their meshes and collision shapes; or else
typical sizes of such objects (`sure` is False). A model without a prop becomes a box of its size.
"""

import re
from dataclasses import dataclass
from math import pi

from mirdrake.core.errors import ConfigError
from mirdrake.importing.sdf.colours import colour_of
from mirdrake.worlds.props import load_prop, prop_names

Size = tuple[float, float, float]


@dataclass(frozen=True)
class Known:
    """A well-known model.

    Attributes:
        props: names of props that may replace it, best one first.
        size: size of the model along x, y, z of the prop [m].
        yaw: heading of the prop's x in the model [rad].
        middle: middle of its box in the model [m].
        sure: size and heading were measured.
    """

    props: tuple[str, ...]
    size: Size
    yaw: float = 0.0
    middle: tuple[float, float] = (0.0, 0.0)
    sure: bool = False


_FIT = 2.0 / 3.0  # smallest part of a side of the model that its prop may have, and the other way round
_CARS = ("sedan", "car", "hatchback")
_HOUSES = ("house", "building")
_SHOPS = ("thrift_store", "thrift_shop", "shop", "building")

_TABLE: dict[str, Known] = {
    "jersey_barrier": Known(("jersey_barrier", "barrier"), (4.065, 0.811, 1.143), sure=True),
    "construction_cone": Known(("cone", "construction_cone"), (0.503, 0.503, 1.089), sure=True),
    "construction_barrel": Known(("barrel", "construction_barrel"), (1.02, 1.02, 1.315), sure=True),
    "drc_practice_orange_jersey_barrier": Known(("jersey_barrier", "barrier"), (1.8, 0.5, 1.0)),
    "drc_practice_white_jersey_barrier": Known(("jersey_barrier", "barrier"), (1.8, 0.5, 1.0)),
    "stop_sign": Known(("stop_sign",), (0.05, 0.6, 1.82), yaw=-pi / 2.0, sure=True),
    "hatchback": Known(_CARS, (4.0, 1.88, 1.557), middle=(0.344, 0.0), sure=True),
    "suv": Known(("suv", "van", *_CARS), (4.7, 1.9, 1.8)),
    "pickup": Known(("pickup", "van", *_CARS), (5.67, 2.17, 1.86), yaw=pi / 2.0, middle=(0.0, -0.121), sure=True),
    "prius_hybrid": Known(_CARS, (4.5, 1.76, 1.5), yaw=-pi / 2.0),
    "ambulance": Known(("van",), (6.0, 2.2, 2.6)),
    "fire_truck": Known(("truck", "van"), (8.5, 2.5, 3.2)),
    "bus": Known(("bus",), (12.0, 2.6, 3.2)),
    "person_standing": Known(("pedestrian", "person"), (0.5, 0.5, 1.75)),
    "person_walking": Known(("pedestrian", "person"), (0.6, 0.8, 1.75)),
    "lamp_post": Known(("lamp_post", "street_lamp"), (0.3, 0.3, 4.0)),
    "house_1": Known(_HOUSES, (14.0, 13.0, 7.5)),
    "house_2": Known(_HOUSES, (11.0, 9.0, 7.5)),
    "house_3": Known(_HOUSES, (13.0, 10.0, 7.5)),
    "thrift_shop": Known(_SHOPS, (7.213, 5.432, 11.389), sure=True),
    "cafe": Known(("cafe", *_SHOPS), (9.5, 22.6, 2.9), middle=(-0.4, -0.75), sure=True),
    "gas_station": Known(("gas_station", "building"), (17.0, 14.0, 5.0)),
    "post_office": Known(_SHOPS, (8.0, 6.0, 10.0)),
    "salon": Known(_SHOPS, (8.0, 6.0, 10.0)),
    "law_office": Known(_SHOPS, (8.0, 6.0, 10.0)),
    "fast_food": Known(_SHOPS, (15.0, 11.0, 6.0)),
    "grocery_store": Known(_SHOPS, (20.0, 15.0, 7.0)),
    "school": Known(("building",), (30.0, 20.0, 9.0)),
    "apartment": Known(("building",), (22.0, 20.0, 15.0)),
    "office_building": Known(("building",), (20.0, 15.0, 15.0)),
    "police_station": Known(("building",), (20.0, 20.0, 8.0)),
    "fire_station": Known(("building",), (20.0, 16.0, 9.0)),
    "hospital": Known(("building",), (30.0, 20.0, 12.0)),
    "dumpster": Known(("dumpster",), (3.2, 1.7, 1.5)),
    "fire_hydrant": Known(("fire_hydrant", "hydrant", "bollard"), (0.35, 0.35, 0.75)),
    "mailbox": Known(("mailbox",), (0.6, 0.6, 1.3)),
    "speed_limit_sign": Known(("speed_limit", "stop_sign"), (0.1, 0.6, 2.1), yaw=-pi / 2.0),
    "oak_tree": Known(("tree",), (5.0, 5.0, 8.0)),
    "pine_tree": Known(("tree",), (3.5, 3.5, 9.0)),
    "telephone_pole": Known(("telephone_pole", "lamp_post"), (1.5, 0.4, 9.0)),
    "cardboard_box": Known(("cardboard_box",), (0.5, 0.4, 0.3), sure=True),
    "brick_box_3x1x3": Known((), (3.0, 1.0, 3.0), sure=True),
    "nist_simple_ramp_120": Known((), (1.2, 1.2, 0.3)),
    "grey_wall": Known((), (7.5, 0.2, 2.8), sure=True),
    "table": Known(("table",), (1.5, 0.8, 1.03), sure=True),
    "bookshelf": Known(("bookshelf",), (0.9, 0.4, 1.2), sure=True),
    "cabinet": Known((), (0.45, 0.45, 1.02)),
    "cafe_table": Known(("cafe_table",), (0.913, 0.913, 0.775)),
    "cinder_block": Known((), (0.4, 0.2, 0.2)),
    "cinder_block_2": Known((), (0.4, 0.2, 0.2)),
    "cinder_block_wide": Known((), (0.4, 0.3, 0.14)),
}
_STARTS = ("jersey_barrier", "construction_cone", "construction_barrel", "hatchback", "suv", "pickup", "stop_sign",
           "house_1", "house_2", "house_3", "lamp_post", "person_standing", "person_walking", "oak_tree",
           "pine_tree")  # fmt: skip
_OTHERS = {"speed_limit": "speed_limit_sign", "cone": "construction_cone", "barrel": "construction_barrel",
           "traffic_cone": "construction_cone", "house": "house_1"}  # fmt: skip


def find_known(name: str) -> Known | None:
    """Return the known model of a name in any spelling such as ``Construction Cone_clone_0``; None if unknown."""
    # Exact names first, then other spellings, then the start of a name such as hatchback_blue.
    plain = plain_name(name)
    if plain in _TABLE:
        return _TABLE[plain]
    if plain in _OTHERS:
        return _TABLE[_OTHERS[plain]]
    start = next((start for start in _STARTS if plain.startswith(f"{start}_")), None)
    if start is None and plain in prop_names():
        return Known((plain,), load_prop(plain).size)
    return _TABLE[start] if start else None


def colour_in(name: str) -> tuple[float, float, float] | None:
    """Return the colour at the end of a name such as ``hatchback_blue``; None without one."""
    rgba = colour_of(plain_name(name).rpartition("_")[2].capitalize())
    return None if rgba is None else (rgba[0], rgba[1], rgba[2])


def plain_name(name: str) -> str:
    """Return a name in lower case without the suffixes that Gazebo adds to copies."""
    plain = re.sub(r"[^a-z0-9]+", "_", name.rpartition("::")[2].lower()).strip("_")
    shorter = re.sub(r"(_clone|_copy)(_\d+|_clone|_copy)*$", "", plain)
    return shorter or plain


@dataclass(frozen=True)
class StandIn:
    """A prop for a model.

    Attributes:
        name: name of the prop.
        asked: the requested size [m]; None if it has one size only.
        scale: times as large.
        size: size that it has then [m].
    """

    name: str
    asked: Size | None
    scale: float
    size: Size


def stand_in(known: Known) -> StandIn | None:
    """Return the first prop that can have about the size of a model.

    A prop of one size is scaled by the model's longest side, and must then be within a third of each of the others.
    Where the size of the model is not known for certain, the first prop is taken as it is.
    """
    existing = prop_names()
    for name in known.props:
        if name not in existing:
            continue
        try:
            size = load_prop(name).size
        except ConfigError:
            continue
        # Where the size of the model is not known for sure, that of the prop is as good.
        if not known.sure:
            return StandIn(name, None, 1.0, size)
        try:
            return StandIn(name, known.size, 1.0, load_prop(name, size=known.size).size)
        except ConfigError:
            pass  # it has one size only
        longest = max(range(3), key=lambda axis: known.size[axis])
        scale = round(known.size[longest] / size[longest], 3)
        scaled = (scale * size[0], scale * size[1], scale * size[2])
        # Scaled along its longest side, the prop has to fit the other two as well.
        if all(_FIT * want <= have <= want / _FIT for have, want in zip(scaled, known.size, strict=True)):
            return StandIn(name, None, scale, scaled)
    return None
