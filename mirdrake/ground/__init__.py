"""Uneven ground: its height, slope and roughness as one function of the position.

:class:`Terrain` is a stack of layers, evaluated by :func:`mirdrake.ground.layers.ground_at`, which
:mod:`mirdrake.core.compiled` compiles. Tyres, meshes, rays and rest poses use this one function.
"""

from mirdrake.ground.terrain import FLAT, GroundPoint, Terrain

__all__ = ["FLAT", "GroundPoint", "Terrain"]
