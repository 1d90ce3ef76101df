"""Presets of commercial sensors by product name: ``front_lidar: {preset: sick_lms291, frame: front_lidar}``.

Presets are data: every ``sensors/*.yaml`` in a models folder (see :mod:`mirdrake.core.paths`); the first of a name
wins.
"""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from mirdrake.core.errors import did_you_mean
from mirdrake.core.json_io import Json
from mirdrake.core.paths import search_folders
from mirdrake.core.yaml_io import Schema, load_yaml

_PLACE = {"frame", "preset"}  # keys that a preset does not have


class PresetSpec(Schema):
    """Parameters of one product."""

    name: str = Field(min_length=1, description="maker and product")
    grade: Literal["A", "B", "C"] = Field(description="A: measured; B: data sheet or publication; C: mostly assumed")
    sources: dict[str, str] = Field(description="dotted path of a number in `mount` -> its source, or assumed")
    mount: Json = Field(description="as in sensors.yaml, without a frame")

    @model_validator(mode="after")
    def _a_kind_and_no_place(self) -> Self:
        if "kind" not in self.mount or _PLACE & self.mount.keys():
            raise ValueError("mount needs a kind, and neither frame nor preset")
        return self

    def numbers_without_source(self) -> list[str]:
        """Return the dotted paths of the numbers in `mount` without an entry in `sources`."""
        return [path for path in _paths(self.mount) if path not in self.sources]

    def sources_without_number(self) -> list[str]:
        """Return the entries of `sources` that do not match a number in `mount`."""
        return [path for path in self.sources if path not in set(_paths(self.mount))]


class PresetsSpec(Schema):
    """A file of presets."""

    presets: dict[str, PresetSpec]


def presets() -> dict[str, PresetSpec]:
    """Return all presets by name.

    Raises:
        ConfigError: a file of presets is invalid.
    """
    files = [path for folder in search_folders("models") for path in sorted(folder.glob("sensors/*.yaml"))]
    known: dict[str, PresetSpec] = {}
    for path in files:
        for name, preset in _load(path, path.stat().st_mtime_ns).items():
            # The first folder of the search path has priority.
            known.setdefault(name, preset)
    return known


def with_preset(mount: Any) -> Any:
    """Return a mount merged over the preset that it names; its keys replace those of the preset.

    Raises:
        ConfigError: a file of presets is invalid.
        ValueError: the preset does not exist, or is of another kind.
    """
    if not isinstance(mount, dict) or "preset" not in mount:
        return mount
    name, known = mount["preset"], presets()
    if not isinstance(name, str) or name not in known:
        raise ValueError(f"unknown preset '{str(name)[:40]}'; {did_you_mean(name, known)}")
    below = known[name].mount
    if mount.get("kind", below["kind"]) != below["kind"]:
        raise ValueError(f"preset '{name}' is a {below['kind']}; leave `kind` out, or the preset")
    return {**below, **mount}


@lru_cache(maxsize=64)
def _load(path: Path, _changed: int) -> dict[str, PresetSpec]:
    """Return the presets of a file, read again when it has changed."""
    return load_yaml(path, PresetsSpec).presets


def _paths(data: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the dotted paths of all quantities: all keys except kinds and switches."""
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _paths(value, f"{prefix}{key}.")
        elif key not in {"kind", "fix", "of"} and not isinstance(value, bool):
            yield f"{prefix}{key}"
