"""Sensors that measure distances, by casting rays: laser scanner, lidar, radar, sonar.

::

    faces      triangles that know the exact surface they stand for
    shapes     Drake's shapes and meshes as faces
    scene      rays against things that do not move against one another (Embree, then formulas)
    world      the fixed scene, the moving bodies, the ground
    motion     where bodies were between two samples
    beams      where rays point, and when they leave
    caster     what the sensors have in common
    laser_scanner, lidar, radar, sonar
"""

from mirdrake.sensors.ranging.laser_scanner import LaserScanner
from mirdrake.sensors.ranging.lidar import Lidar, LidarScan
from mirdrake.sensors.ranging.radar import Radar
from mirdrake.sensors.ranging.sonar import Sonar
from mirdrake.sensors.ranging.world import RayWorld, ray_world

__all__ = [
    "LaserScanner",
    "Lidar",
    "LidarScan",
    "Radar",
    "RayWorld",
    "Sonar",
    "ray_world",
]
