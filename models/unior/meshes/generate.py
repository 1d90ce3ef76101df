"""Generates the visual meshes of the Avrora Unior: an open car-like robot of its outer dimensions (README.md, 1).

Usage: ``python generate.py``; deterministic, writes next to itself.
"""

from pathlib import Path

from mirdrake.vehicles.bodywork.generic import write_car

if __name__ == "__main__":
    write_car(
        Path(__file__).resolve().parents[1],
        style="buggy",
        wheelbase=0.74,
        track=0.54,
        length=1.112,
        width=0.65,
        height=0.57,
        wheel_radius=0.13,
        wheel_width=0.11,
        ground_clearance=0.0585,
        front_overhang=0.186,
    )
