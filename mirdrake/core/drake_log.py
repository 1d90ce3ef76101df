"""Filter of Drake's log: warnings that do not apply to the diagrams of mirdrake are suppressed."""

import logging

IRRELEVANT = (
    "half spaces are not currently supported for deformable",  # there are no deformable bodies
    "materials have been assigned to a glTF file",  # the colour beside a glTF mesh is not used
    "Meshcat does not display HalfSpace",  # the world's own meshes draw the ground
)
"""Parts of the warnings that are suppressed."""


def _is_relevant(record: logging.LogRecord) -> bool:
    message = record.getMessage()
    return not any(text in message for text in IRRELEVANT)


def filter_drake_log() -> None:
    """Suppress the irrelevant warnings from now on; called where a plant is made, further calls have no effect."""
    logging.getLogger("drake").addFilter(_is_relevant)
