"""Diagrams built in Python: a face of the diagram file, with the same names, defaults and errors."""

from mirdrake.builder.diagram import Diagram
from mirdrake.builder.drivers import PathTracking
from mirdrake.builder.names import Name

__all__ = ["Diagram", "Name", "PathTracking"]
