"""Format of `network:` in a world file."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Schema, where
from mirdrake.worlds.networks.commonroad import read_commonroad
from mirdrake.worlds.networks.network import Network
from mirdrake.worlds.networks.opendrive_network import read_network
from mirdrake.worlds.schema_types import SurfaceName, exactly_one, given_one

READERS = {"xodr": read_network, "commonroad": read_commonroad}
"""Sources of a network: key in the world file, and the function that reads its file."""


class NetworkSpec(Schema):
    """A road network from a file: all its roads and junctions."""

    xodr: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="OpenDRIVE file, relative to the world file [-]"
    )
    commonroad: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="CommonRoad scenario, relative to the world file; its lanelets are the lanes [-]"
    )
    surface: SurfaceName = Field(default="asphalt", description="appearance of its lanes [-]")
    mu: Annotated[float, Field(gt=0.0, le=2.0)] | None = Field(
        default=None, description="friction coefficient; default: that of the surface [-]"
    )
    markings: bool = Field(default=True, description="paint the road marks and stop lines of the file [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, tuple(READERS))
        return self

    @property
    def file(self) -> str:
        """Path of its file, relative to the world file."""
        return str(given_one(self, tuple(READERS)))


def make_network(spec: NetworkSpec, folder: Path) -> Network:
    """Return the network of a specification.

    Args:
        spec: the specification.
        folder: folder to which its file is relative.

    Raises:
        ConfigError: the file does not exist or has faults.
    """
    key = next(key for key in READERS if getattr(spec, key) is not None)
    path, location = folder / spec.file, where(spec, key)
    if not path.is_file():
        beside = [file.name for file in path.parent.glob(f"*{path.suffix}")] if path.parent.is_dir() else []
        hint = did_you_mean(path.name, beside) if beside else "give its path relative to the world file"
        raise ConfigError(f"no such file: {spec.file[:200]!r}; {hint}", where=location)
    try:
        return READERS[key](path)
    except ConfigError as error:
        raise error.under(location) from None
