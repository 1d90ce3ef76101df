"""Figures of handling as pure functions of logged signals."""
