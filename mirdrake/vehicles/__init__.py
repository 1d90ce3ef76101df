"""Vehicles: a folder of xacro and YAML files into a checked :class:`Vehicle`.

::

    vehicle.yaml  control.yaml  variants/*.yaml       spec.py
    sensors.yaml                                      mounts.py, mount.py, presets.py
    main.urdf.xacro ── render_xacro ──► Urdf          xacro_render.py
    Urdf ── check_urdf, resolve_meshes ──► text       inspect_urdf.py, numbers_in_urdf.py
    text ── parse_urdf ──► throw-away plant           parse.py
    plant ── measure_geometry ──► VehicleGeometry     geometry.py
    plant ── measure_spring_loads                     suspension.py, chassis_spec.py
    text ── measure_outline ──► Outline               outline.py
    all of it: load_vehicle ──► Vehicle               vehicle.py
"""

from mirdrake.vehicles.geometry import VehicleGeometry
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.parse import make_package_map
from mirdrake.vehicles.spec import WHEELS, ControlSpec, VehicleSpec
from mirdrake.vehicles.vehicle import Vehicle, find_vehicle, load_vehicle, make_vehicle, variants
from mirdrake.vehicles.xacro_render import Urdf, render_xacro

__all__ = [
    "WHEELS",
    "ControlSpec",
    "SensorsSpec",
    "Urdf",
    "Vehicle",
    "VehicleGeometry",
    "VehicleSpec",
    "find_vehicle",
    "load_vehicle",
    "make_package_map",
    "make_vehicle",
    "render_xacro",
    "variants",
]
