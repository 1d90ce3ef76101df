"""Cameras: colour, depth, stereo, labels and lens distortion; rendered by Drake's VTK engine without a display."""

from mirdrake.sensors.cameras.camera import X_SC, Camera, Shot, make_camera
from mirdrake.sensors.cameras.merging import merge_still_things
from mirdrake.sensors.cameras.rendering import add_renderer, camera_params, use_plain_textures

__all__ = [
    "X_SC",
    "Camera",
    "Shot",
    "add_renderer",
    "camera_params",
    "make_camera",
    "merge_still_things",
    "use_plain_textures",
]
