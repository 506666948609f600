"""A program for `nomad challenge`: drive to the goal on the estimate of the extended Kalman filter.

    nomad challenge corridor examples/corridor_challenge.py
"""

import os
import sys

from localization.filters.base import LocalizationConfig
from localization.navigation.waypoints import record_run
from nclient import connect
from worlds.io import load_world
from worlds.robots import BODIES

goal = tuple(map(float, os.environ.get("NOMAD_GOAL", "80,80").split(",")))
world = load_world(os.environ.get("NOMAD_WORLD", "thesis_room"))
with connect(sys.argv[1] if len(sys.argv) > 1 else "sim:thesis_room?noisy=1&seed=1") as robot:
    run = record_run(robot, LocalizationConfig(world.walls, BODIES["n150"]), [goal])
    x, y, _ = run.moments[-1].estimate.pose
    print(f"the filter says {x:.1f}, {y:.1f} in; the goal is {goal[0]:.1f}, {goal[1]:.1f} in")
