"""Drive two feet, read the sonars, compare the encoders with the truth.

    python examples/first.py [ADDRESS]
"""

import sys

from nclient import connect

with connect(sys.argv[1] if len(sys.argv) > 1 else "sim:thesis_room?noisy=1&seed=1") as robot:
    robot.move(translation_in=24)
    state = robot.wait_until_still(timeout_s=20)
    print(f"encoders: {state.x_in:.1f}, {state.y_in:.1f} in; wall ahead: {state.sonars_in[0]} in")
    if robot.is_simulated():
        truth = robot.truth()
        print(f"truth:    {truth.x_in:.1f}, {truth.y_in:.1f} in")
