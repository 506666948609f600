"""Go to a point on a map: localize, plan the shortest path, drive it around obstacles.

    python examples/map_and_go.py [ADDRESS]

`nomad go` does the same from the command line; docs/missions.md has more steps than go_to.
"""

import sys

from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.navigation.mission import Mission
from localization.navigation.pilot import RobotController
from nclient import connect
from worlds.io import load_world
from worlds.robots import BODIES

room, body = load_world("several_walls"), BODIES["n150"]
with connect(sys.argv[1] if len(sys.argv) > 1 else "sim:several_walls?noisy=1&seed=1&start=5,5") as robot:
    state = robot.refresh()
    start = independent([state.x_in, state.y_in, state.steering_rad], [0.5, 0.5, 0.03])
    with RobotController(robot, LocalizationConfig(room.walls, body), body, start, robot.sleep) as controller:
        mission = Mission(controller)
        seen = mission.go_to(35, 55, limit_s=60)
        seen = mission.go_to(90, 55, heading_deg=0, limit_s=60)
    print(f"arrived at {seen.x_in:.1f}, {seen.y_in:.1f} in ± {seen.std_in:.2f} in, {seen.trust}")
