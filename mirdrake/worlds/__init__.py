"""Worlds: the world language, tracks, starts, friction, and what they look like."""

from mirdrake.worlds.spec import WorldSpec
from mirdrake.worlds.tracks import Piece, Track
from mirdrake.worlds.world import Ground, Start, World, load_world, make_track, make_world

__all__ = ["Ground", "Piece", "Start", "Track", "World", "WorldSpec", "load_world", "make_track", "make_world"]
