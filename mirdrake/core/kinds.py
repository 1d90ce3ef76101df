"""Entries of YAML files whose key ``kind`` selects one of several classes from a registry."""

from collections.abc import Mapping
from typing import Annotated, Any, Union

from pydantic import Discriminator, GetCoreSchemaHandler, Tag
from pydantic_core import CoreSchema

from mirdrake.core.yaml_io import Schema


class SelectedByKind:
    """Annotation of a field: its ``kind`` selects the class of a registry that validates it.

    Use it as ``Annotated[Base, SelectedByKind(REGISTRY)]``. The registry is read when the class with the field is
    built; after a change at run time, call ``model_rebuild(force=True)`` on that class.

    Args:
        registry: classes by kind; each has a field ``kind`` with that value.
        default: kind of an entry without the key; by default the key is required.
    """

    def __init__(self, registry: Mapping[str, type[Schema]], *, default: str | None = None) -> None:
        self._registry, self._default = registry, default

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a union that is discriminated by ``kind``."""
        members = tuple(Annotated[model, Tag(kind)] for kind, model in self._registry.items())
        return handler.generate_schema(Annotated[Union[members], Discriminator(self._kind)])  # noqa: UP007

    def _kind(self, value: Any) -> Any:
        return value.get("kind", self._default) if isinstance(value, Mapping) else getattr(value, "kind", None)
