"""Maps, geometry, ray casting, robot bodies and world files, shared by simulation, filters and viewer.

Inches and radians, counter-clockwise positive. No protocol, no simulation, no filters.
"""

from worlds.io import load_world, world_names
from worlds.raycast_arrays import cast_discs, cast_rays
from worlds.robots import BODIES, N150, N200, SCOUT, Body
from worlds.world import Path, Polygon, StartPose, World

__all__ = [
    "BODIES",
    "N150",
    "N200",
    "SCOUT",
    "Body",
    "Path",
    "Polygon",
    "StartPose",
    "World",
    "cast_discs",
    "cast_rays",
    "load_world",
    "world_names",
]
