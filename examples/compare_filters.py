"""Drive the same room with several filters and compare them; with the extra `plot` a picture is drawn.

    python examples/compare_filters.py [PICTURE.png]
"""

import sys

from localization import plot
from localization.filters.base import LocalizationConfig
from localization.navigation.waypoints import record_run
from nclient import connect
from worlds.io import load_world
from worlds.robots import BODIES

room = load_world("thesis_room")
config = LocalizationConfig(room.walls, BODIES["n150"])
for method in ("ekf", "iekf", "ukf"):
    with connect("sim:thesis_room?noisy=1&seed=3") as robot:
        run = record_run(robot, config, [(0, 0), (40, 20)], method)
    result = run.summary()
    print(f"{method:4}  RMSE {result['rmse_position_in']:.2f} in, odometry {result['odometry_end_error_in']:.2f} in, "
          f"NEES {plot.nees_values(run).mean():.1f} (3 is right)")
    if len(sys.argv) > 1:
        plot.errors(run).savefig(sys.argv[1])
