"""Worlds: the world language, tracks, props, starts, friction, and what they look like."""

from mirdrake.worlds.loading import load_world, make_world
from mirdrake.worlds.props import PlacedProp, Prop, Solid
from mirdrake.worlds.regions import Patch
from mirdrake.worlds.spec import WorldSpec
from mirdrake.worlds.track_layout import make_track
from mirdrake.worlds.tracks import Piece, Track
from mirdrake.worlds.world import Goal, Ground, Start, World

__all__ = [
    "Goal",
    "Ground",
    "Patch",
    "Piece",
    "PlacedProp",
    "Prop",
    "Solid",
    "Start",
    "Track",
    "World",
    "WorldSpec",
    "load_world",
    "make_track",
    "make_world",
]
