"""Diagrams: file format, blocks, wiring, assembly into a Drake Diagram, and drawing."""
