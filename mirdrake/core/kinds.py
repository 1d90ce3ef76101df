"""Entries of YAML files whose key ``kind`` selects one of several classes from a registry.

A registry maps kinds to classes, or to texts ``module:Class`` that are imported when an entry of that kind is read. A
text lets a module name classes of later packages that derive from one of its own base classes.
"""

from collections.abc import Mapping
from functools import cache
from pkgutil import resolve_name
from typing import Any, Generic

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, SchemaValidator, core_schema

from mirdrake.core.yaml_io import Schema, SchemaT


class SelectedByKind(Generic[SchemaT]):
    """Annotation of a field: its ``kind`` selects the class of a registry that validates it.

    Use it as ``Annotated[Base, SelectedByKind(REGISTRY)]``. The registry is read at every validation.

    Args:
        registry: classes by kind, or where to import them; each has a field ``kind`` with that value.
        default: kind of an entry without the key; by default the key is required.
        by_name: whether the bare name of a kind is an entry with its defaults.
    """

    def __init__(
        self, registry: Mapping[str, type[SchemaT] | str], *, default: str | None = None, by_name: bool = False
    ) -> None:
        self._registry, self._default, self._by_name = registry, default, by_name

    def __getitem__(self, kind: str) -> type[SchemaT]:
        """Return the class of a kind."""
        entry = self._registry[kind]
        if not isinstance(entry, str):
            return entry
        model: type[SchemaT] = resolve_name(entry)
        return model

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return a schema that looks the class up when it validates."""
        return core_schema.no_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the JSON Schema of the union of all classes."""
        members = {kind: self[kind].__pydantic_core_schema__ for kind in self._registry}
        union = handler(core_schema.tagged_union_schema(members, discriminator=str))
        return {"anyOf": [{"enum": list(self._registry)}, union]} if self._by_name else union

    def _validate(self, value: Any) -> Any:
        if isinstance(value, Schema):
            return value
        if self._by_name and isinstance(value, str):
            value = {"kind": value}
        # The kind may be left out where there is a default.
        kind = value.get("kind", self._default) if isinstance(value, Mapping) else None
        if kind is None:
            raise PydanticKnownError("union_tag_not_found", {"discriminator": "'kind'"})
        if not isinstance(kind, str) or kind not in self._registry:
            expected = ", ".join(f"'{known}'" for known in self._registry)
            raise PydanticKnownError(
                "union_tag_invalid", {"discriminator": "'kind'", "tag": str(kind), "expected_tags": expected}
            )
        return _validator(self[kind], kind).validate_python(value)


@cache
def _validator(model: type[Schema], kind: str) -> SchemaValidator:
    """Return a validator whose errors have the kind in their location, as those of a union."""
    members = {kind: model.__pydantic_core_schema__}
    return SchemaValidator(core_schema.tagged_union_schema(members, discriminator=lambda _: kind))
