"""Constants of nature."""

GRAVITY = 9.80665
"""Standard gravity [m/s²] (CGPM, 1901)."""
