"""Sensors that measure distances, by casting rays: laser scanner, lidar, radar, sonar.

::

    faces      triangles that refer to the exact surface they approximate
    shapes     Drake's shapes and meshes as faces
    scene      rays against a rigid scene (Embree, then formulas)
    world      the fixed scene, the moving bodies, the ground
    motion     poses of bodies between two samples
    beams      directions and times of rays
    caster     readings of hits: limits, noise, resolution
    mount      keys that all of them have
    laser_scanner, lidar, radar, sonar: the kinds
"""
