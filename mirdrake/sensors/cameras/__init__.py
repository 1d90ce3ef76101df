"""Cameras: colour, depth, stereo; labels; lenses that distort. Drawn by Drake's VTK renderer, without a display."""

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
