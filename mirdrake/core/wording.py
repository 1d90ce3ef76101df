"""Words of messages and pages."""


def plural(count: float, noun: str) -> str:
    """Return a count with its noun, such as "1 run", "2 runs" or "0 stretches"."""
    ending = "es" if noun.endswith(("s", "x", "ch", "sh")) else "s"
    return f"{count} {noun}{ending * (count != 1)}"
