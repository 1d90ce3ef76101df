"""Meshcat: live view, recordings that open offline, and a look at a vehicle or a world."""

from mirdrake.viewer.follow import FollowCamera
from mirdrake.viewer.meshcat import make_meshcat, place_camera
from mirdrake.viewer.recording import write_recording
from mirdrake.viewer.show import show_diagram, show_vehicle, show_world

__all__ = [
    "FollowCamera",
    "make_meshcat",
    "place_camera",
    "show_diagram",
    "show_vehicle",
    "show_world",
    "write_recording",
]
