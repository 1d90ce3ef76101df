"""Shapes of the entries of `props`: a prop by name, a primitive, or a file.

A new kind is a class derived from :class:`PropShape` and a field of :class:`mirdrake.worlds.props_spec.PropEntry`.
"""

# ruff: noqa: ARG002  # all kinds share one signature

from abc import abstractmethod
from pathlib import Path
from typing import ClassVar

from pydantic import RootModel

from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_io import Schema, where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.props import Prop, load_prop, make_mesh_prop, make_primitive
from mirdrake.worlds.schema_types import Pair, Triple, Value
from mirdrake.worlds.solids import Size
from mirdrake.worlds.values import Number

MESH_SUFFIXES = {".gltf", ".glb", ".obj"}
"""Suffixes of mesh files."""


class PropShape:
    """Kind of shape of a placed prop."""

    resizable: ClassVar[bool] = False
    """whether `size` is allowed"""

    @abstractmethod
    def make(self, entry: Schema, draw: Draw, folder: Path, size: Size | None, scale: float) -> Prop:
        """Return the prop.

        Args:
            entry: entry of the file, for messages.
            draw: evaluates values.
            folder: folder of the world file.
            size: requested size along x, y, z [m], of a resizable kind.
            scale: factor of all lengths.

        Raises:
            ConfigError: the prop does not exist, or a value is invalid.
        """

    @property
    @abstractmethod
    def label(self) -> str:
        """Name of an entry without `name`."""

    @property
    def values(self) -> list[Number | str]:
        """Values that may be random."""
        return []


class LibraryShape(RootModel[Value], PropShape):
    """A prop of models/props/, by name."""

    resizable: ClassVar[bool] = True

    def make(self, entry: Schema, draw: Draw, folder: Path, size: Size | None, scale: float) -> Prop:
        """Return the prop."""
        name = draw.word(self.root, "prop", entry)
        return load_prop(name, size=size, scale=scale, where=where(entry, "prop"))

    @property
    def label(self) -> str:
        """Its name, if it is one."""
        text = str(self.root)
        return text if text.isidentifier() else "prop"

    @property
    def values(self) -> list[Number | str]:
        """The name, which may be a choice."""
        return [self.root]


class _Primitive(PropShape):
    """A primitive on the ground."""

    kind: ClassVar[str]

    def make(self, entry: Schema, draw: Draw, folder: Path, size: Size | None, scale: float) -> Prop:
        """Return the prop."""
        sides = draw.numbers(self.values, "m", self.kind, entry)
        return make_primitive(self.kind, tuple(sides), scale=scale, where=where(entry, self.kind))

    @property
    def label(self) -> str:
        """Name of the kind."""
        return self.kind


class BoxShape(RootModel[Triple], _Primitive):
    """A box: along x, y, z."""

    kind: ClassVar[str] = "box"

    @property
    def values(self) -> list[Number | str]:
        """Its sides."""
        return self.root


class CylinderShape(RootModel[Pair], _Primitive):
    """An upright cylinder: radius, height."""

    kind: ClassVar[str] = "cylinder"

    @property
    def values(self) -> list[Number | str]:
        """Its radius and height."""
        return self.root


class SphereShape(RootModel[Value], _Primitive):
    """A sphere: radius."""

    kind: ClassVar[str] = "sphere"

    @property
    def values(self) -> list[Number | str]:
        """Its radius."""
        return [self.root]


class FileShape(RootModel[str], PropShape):
    """A folder with a prop.yaml, or a mesh whose convex hull collides, beside the world file."""

    def make(self, entry: Schema, draw: Draw, folder: Path, size: Size | None, scale: float) -> Prop:
        """Return the prop."""
        path, location = folder / self.root, where(entry, "file")
        if (path / "prop.yaml").is_file():
            return load_prop(f"{resolved(path)}/", scale=scale, where=location)
        if path.suffix.lower() not in MESH_SUFFIXES or not path.is_file():
            raise ConfigError(
                f"no prop at '{self.root}'; give a folder with a prop.yaml, or a .gltf, .glb or .obj file, "
                "relative to the world file",
                where=location,
            )
        return make_mesh_prop(resolved(path), scale=scale, where=location)

    @property
    def label(self) -> str:
        """Name of the file as an identifier."""
        return "".join(letter if letter.isalnum() else "_" for letter in self.root.rsplit("/", 1)[-1].split(".")[0])
