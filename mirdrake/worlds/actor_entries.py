"""Evaluation of the entries of `actors`: one entry for each actor, every random value from a stream of its name."""

import re
from collections.abc import Mapping
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import Source, validate
from mirdrake.core.yaml_tree import Key
from mirdrake.worlds.actors_spec import AlongSpec
from mirdrake.worlds.draw import Draw, evaluate_tree
from mirdrake.worlds.values import is_random

LARGEST_COUNT = 2000
"""Largest number of actors in a world."""

_CONDITION = re.compile(r"(.*(?:within|@|[<>])\s*)(.+)", re.DOTALL)  # the number at the end of a condition


def split_condition(text: str) -> tuple[str, str] | None:
    """Return the words of a condition, and the number at its end as it is written; None if it has no number."""
    match = _CONDITION.fullmatch(text)
    return None if match is None else (match.group(1), match.group(2))


def evaluate_actors(entries: Any, draw: Draw, source: Source) -> tuple[Any, Source, tuple[int, ...]]:
    """Return an entry without expressions for each actor, the source with its lines, and the index of its origin.

    An entry with `along` becomes several actors: ``name_0``, ``name_1``, ... Actors without a name have that of their
    prop and their number among these.

    Args:
        entries: data of `actors` in a world file.
        draw: evaluates values of the world.
        source: locations of the whole file.

    Raises:
        ConfigError: a value is not a valid expression, or there are too many actors.
    """
    # Entries that are not lists or mappings pass unchanged: the validation that follows names their line and type.
    if not isinstance(entries, list):
        return entries, source, ()
    result: list[Any] = []
    origins: list[int] = []
    taken: dict[str, int] = {}
    for index, entry in enumerate(entries):
        if not isinstance(entry, dict):
            result.append(entry)
            origins.append(index)
            continue
        for actor in _actors_of(entry, index, draw, source, taken):
            result.append(actor)
            origins.append(index)
        # Checked inside the loop, since one `count` can ask for more actors than memory holds.
        if len(result) > LARGEST_COUNT:
            raise ConfigError(f"more than {LARGEST_COUNT} actors", where=source.where("actors", index))
    # Each actor has the lines of the entry it was made from, so that messages name the right line.
    # Only the keys below an entry move to other indices; the key of the whole list stays.
    lines = {key: line for key, line in source.lines.items() if key[:1] != ("actors",) or len(key) == 1}
    below: dict[int, list[tuple[Key, int | None]]] = {}
    for key, line in source.lines.items():
        if key[:1] == ("actors",) and len(key) > 1 and isinstance(key[1], int):
            below.setdefault(key[1], []).append((key[2:], line))
    for number, index in enumerate(origins):
        lines |= {("actors", number, *key): line for key, line in below.get(index, [])}
    return result, source._replace(lines=lines), tuple(origins)


def _actors_of(entry: Json, index: int, draw: Draw, source: Source, taken: dict[str, int]) -> list[Json]:
    """Return the actors of one entry."""
    kind = str(entry.get("actor", "actor"))
    # A random choice is named by its first alternative, so that names do not depend on the draw.
    base = str(entry["name"]) if "name" in entry else kind.split("|")[0].strip().lstrip("$") or "actor"
    along = entry.get("along")
    if not isinstance(along, Mapping):
        if "name" not in entry:
            taken[base] = taken.get(base, -1) + 1
            base = f"{base}_{taken[base]}"
        return [_evaluate(entry, base, index, draw, source)]
    row = validate(dict(along), AlongSpec, source._replace(prefix=("actors", index, "along")))
    # Several entries without a name count on; each has a stream of its own, the first one that of the name.
    begin = 0 if "name" in entry else taken.get(base, -1) + 1
    own = draw.below("actors").below(f"{base}_{begin}" if begin else base)
    count, first = own.count(row.count, "count", row, largest=LARGEST_COUNT), own.number(row.s, "m", "s", row)
    actors = []
    for number in range(count):
        name = f"{base}_{begin + number}"
        # The stream of each spacing has the name of its actor: one more actor does not change those before it.
        gap = draw.below("actors").below(name).number(row.spacing, "m", "spacing", row) if number else 0.0
        first += gap
        place = {"track": row.track, "s": first, "offset": row.offset}
        place |= {} if row.lane is None else {"lane": row.lane}
        # From here on it is an actor like any other on a track.
        rest = {key: value for key, value in entry.items() if key != "along"}
        actors.append(_evaluate({**rest, "on_track": place}, name, index, draw, source))
    if "name" not in entry:
        taken[base] = begin + count - 1
    return actors


def _evaluate(entry: Json, name: str, index: int, draw: Draw, source: Source) -> Json:
    """Return an entry with the values of one actor."""
    own = Draw(draw.seed, f"/actors/{name}", draw.parameters)
    here = source._replace(prefix=("actors", index))
    result: Json = {}
    for key, value in entry.items():
        if key == "name":
            continue
        result[key] = (
            evaluate_trigger(value, own, here, (key,)) if key == "starts" else evaluate_tree(value, own, here, (key,))
        )
    return result | {"name": name}


def evaluate_trigger(entry: Any, draw: Draw, source: Source, path: tuple[Any, ...]) -> Any:
    """Return a trigger, or a step of a scenario, with its values; in the text of `when` only the number is a value."""
    if not isinstance(entry, dict):
        return entry
    rest = evaluate_tree({key: value for key, value in entry.items() if key != "when"}, draw, source, path)
    when = entry.get("when")
    if isinstance(when, str) and (parts := split_condition(when)) is not None:
        words, number = parts
        if "$" in number or is_random(number):
            number = evaluate_tree(number, draw, source, (*path, "when"))
        when = f"{words}{number}"
    return rest | ({} if when is None else {"when": when})


def evaluate_scenario(data: Any, draw: Draw, source: Source) -> Any:
    """Return `scenario` with its values; streams are named by the actor and the number of the step.

    Raises:
        ConfigError: a value is not a valid expression.
    """
    if not isinstance(data, dict):
        return data
    result: Json = {}
    for name, steps in data.items():
        own = Draw(draw.seed, f"/scenario/{name}", draw.parameters)
        here = source._replace(prefix=("scenario", name))
        result[name] = (
            [evaluate_trigger(step, own, here, (number,)) for number, step in enumerate(steps)]
            if isinstance(steps, list)
            else steps
        )
    return result
