"""One robot of a class: thirty robots in one arena, each student drives the one with their number.

    nserver --class students.csv --noisy                 on the teacher's machine (docs/class.md)
    python examples/class_client.py nserver://HOST:7019/7

It drives until something is near, turns away, and prints what it measured; after the time limit the robot stops.
While a person holds the robot (Stop on the page), it waits.
"""

import sys

from nclient import RobotHeld, connect

address = sys.argv[1] if len(sys.argv) > 1 else "sim:arena?robots=30&noisy=1"
limit_s = float(sys.argv[2]) if len(sys.argv) > 2 else 30.0
with connect(address) as robot:
    state, nearest_in = robot.refresh(), 255
    end_s = state.clock_s + limit_s
    while state.clock_s < end_s:
        robot.sleep(0.1)
        state = robot.refresh()
        near = min(state.sonars_in[number] for number in (15, 0, 1))
        nearest_in = min(nearest_in, near)
        turning = near < 20
        try:
            robot.drive(translation_in_s=0 if turning else 6, steering_deg_s=30 if turning else 0,
                        turret_deg_s=30 if turning else 0)
        except RobotHeld as error:
            print(error)
            state = robot.wait_until_released()
    print(f"{address}: at {state.x_in:.0f}, {state.y_in:.0f} in by the encoders, nearest thing ahead {nearest_in} in")
