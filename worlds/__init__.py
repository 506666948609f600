"""The ground a robot drives on: bodies, walls, rays, world files. Code and data that filter, physics and page share.

Knows nothing of robots' languages, of physics, of filters. Inches, radians, counter-clockwise positive.
"""

from worlds.io import load_world, world_names
from worlds.raycast import cast_discs, cast_rays
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
