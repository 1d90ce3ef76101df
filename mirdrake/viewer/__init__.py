"""Meshcat: live view, recordings that open offline, and a look at a vehicle or a world.

A name loads its module when it is first used: the server of pages needs no diagram and no plant.
"""

from typing import TYPE_CHECKING

from mirdrake.core.deferred import defer

if TYPE_CHECKING:
    from mirdrake.viewer.follow import FollowCamera as FollowCamera
    from mirdrake.viewer.meshcat import make_meshcat as make_meshcat
    from mirdrake.viewer.meshcat import place_camera as place_camera
    from mirdrake.viewer.recording import write_recording as write_recording
    from mirdrake.viewer.show import show_diagram as show_diagram
    from mirdrake.viewer.show import show_vehicle as show_vehicle
    from mirdrake.viewer.show import show_world as show_world

__all__ = [
    "FollowCamera",
    "make_meshcat",
    "place_camera",
    "show_diagram",
    "show_vehicle",
    "show_world",
    "write_recording",
]

__getattr__ = defer(
    __name__,
    {
        "FollowCamera": "follow",
        "make_meshcat": "meshcat",
        "place_camera": "meshcat",
        "show_diagram": "show",
        "show_vehicle": "show",
        "show_world": "show",
        "write_recording": "recording",
    },
)
