"""Vehicles: a folder of xacro and YAML files into a checked :class:`Vehicle`.

::

    vehicle.yaml  control.yaml  sensors.yaml          spec.py
    main.urdf.xacro ── render_xacro ──► Urdf          xacro_render.py
    Urdf ── check_urdf, resolve_meshes ──► text       inspect_urdf.py, numbers_in_urdf.py
    text ── parse_urdf ──► throw-away plant           parse.py
    plant ── measure_geometry ──► VehicleGeometry     geometry.py
    all of it: load_vehicle ──► Vehicle               vehicle.py
"""

from mirdrake.vehicles.geometry import VehicleGeometry
from mirdrake.vehicles.parse import make_package_map
from mirdrake.vehicles.spec import WHEELS, ControlSpec, SensorsSpec, VehicleSpec
from mirdrake.vehicles.vehicle import Vehicle, load_vehicle, make_vehicle
from mirdrake.vehicles.xacro_render import Urdf, render_xacro

__all__ = [
    "WHEELS",
    "ControlSpec",
    "SensorsSpec",
    "Urdf",
    "Vehicle",
    "VehicleGeometry",
    "VehicleSpec",
    "load_vehicle",
    "make_package_map",
    "make_vehicle",
    "render_xacro",
]
