"""Drivers as objects; any other kind of driver is named: ``d.drive(ego, "constant", speed=3)``."""

from typing import Any, Literal

from mirdrake.controllers.path_tracking import PathTrackingSpec
from mirdrake.core.yaml_io import Source, validate


class PathTracking(PathTrackingSpec):
    """Driver that follows a track of the world; the arguments are the keys of ``kind: path_tracking``.

    Raises:
        ConfigError: unknown argument, or a value out of range.
    """

    kind: Literal["path_tracking"] = "path_tracking"

    def __init__(self, **settings: Any) -> None:
        settings = {"kind": "path_tracking"} | settings
        validate(settings, PathTrackingSpec, Source("PathTracking", {}))  # faults on one line
        super().__init__(**settings)
