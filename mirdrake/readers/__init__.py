"""Readers of recorded data: every file format becomes a table of columns with units.

::

    file ── read_table ──► Table: columns, units, lines, notes

A new format is one function and one line of :data:`FORMATS`.
"""

from mirdrake.readers.formats import FORMATS, read_table
from mirdrake.readers.tables import CsvLayout, Request, Table

__all__ = ["FORMATS", "CsvLayout", "Request", "Table", "read_table"]
