"""Worlds: the world language, tracks, props, starts, friction, and their appearance.

::

    world.yaml ── load_world ──► World                 loading.py, world.py; language: *_spec.py, spec.py
    expressions ──► values                             values.py, draw.py
    tracks: ── make_track ──► Track                    track_layout.py
        Piece ──► Curve ──► Track                      pieces.py, curve.py, tracks.py
        points ──► pieces                              csv_tracks.py, centre_lines.py, clothoids.py
        .xodr ──► pieces, edges                        opendrive.py, opendrive_lanes.py, opendrive_parts.py
    network: ──► Network: lanes, signals, routes       networks/
    patches: ──► Patch                                 regions.py
    props: ──► Prop, PlacedProp                        props.py, solids.py, arrange.py; kinds: shapes.py, layouts.py
    props ──► outlines between heights                 outlines.py
    vehicle, props, vehicles ──► distances             clearance.py
    actors: ──► Actor, Lane                            actors_spec.py, actor_entries.py, actors.py, track_lanes.py
    rules: ──► allowed overlaps, distances             rules.py
    World ──► visual geometry                          scenery.py, meshes.py
    World ──► areas and lines seen from above          drawing.py
    World ──► lock file, SDF world with meshes         lock.py, sdf_export.py, obj_files.py
    World ◄─► data of a run folder                     stored.py
"""

from mirdrake.worlds.actors import Actor
from mirdrake.worlds.loading import load_world, make_world
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.props import PlacedProp, Prop, Solid
from mirdrake.worlds.regions import Patch
from mirdrake.worlds.spec import WorldSpec
from mirdrake.worlds.track_layout import make_track
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import Goal, Ground, Start, World

__all__ = [
    "Actor",
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
