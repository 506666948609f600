"""Drive a square by the encoders alone, and see how far off they are at its end.

    python examples/square.py [ADDRESS]
"""

import math
import sys

from nclient import connect

with connect(sys.argv[1] if len(sys.argv) > 1 else "sim:thesis_room?setup=worn&seed=8&start=20,20") as robot:
    start = robot.truth() if robot.is_simulated() else None
    for _ in range(4):
        robot.move(translation_in=48)
        robot.wait_until_still(timeout_s=30)
        robot.move(steering_deg=90, turret_deg=90)
        state = robot.wait_until_still(timeout_s=30)
    if start is not None:
        end = robot.truth()
        off_in = math.hypot(end.x_in - start.x_in, end.y_in - start.y_in)
        print(f"after 4 x 48 in the robot is {off_in:.1f} in from its start; the encoders say "
              f"{math.hypot(state.x_in - start.x_in, state.y_in - start.y_in):.1f} in")
