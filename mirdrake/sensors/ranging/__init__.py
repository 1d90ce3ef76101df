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
