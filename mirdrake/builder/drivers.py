"""Drivers as objects; any other kind of driver is named: ``d.drive(ego, "constant", speed=3)``."""

from typing import Any, Literal

from mirdrake.controllers.path_tracking import PathTrackingSpec
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import validate
from mirdrake.core.yaml_tree import source_of_data


class PathTracking(PathTrackingSpec):
    """Driver that follows a track of the world; the arguments are the keys of ``kind: path_tracking``.

    Raises:
        ConfigError: unknown argument, or a value out of range.
    """

    kind: Literal["path_tracking"] = "path_tracking"

    def __init__(self, *positional: Any, **settings: Any) -> None:
        if positional:
            raise ConfigError("PathTracking: name the arguments, as in PathTracking(track='main', speed=5.0)")
        settings = {"kind": "path_tracking"} | settings
        validate(settings, PathTrackingSpec, source_of_data("PathTracking", settings))  # faults on one line
        super().__init__(**settings)
