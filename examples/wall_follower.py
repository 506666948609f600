"""Follow a wall on the right at 20 inches: steer by the sonars to the right and ahead.

    python examples/wall_follower.py [ADDRESS]
"""

import sys

from nclient import connect

DISTANCE_IN = 20
RIGHT, RIGHT_AHEAD, AHEAD = 12, 14, 0  # numbers count counter-clockwise from ahead, 22.5 degrees each

with connect(sys.argv[1] if len(sys.argv) > 1 else "sim:several_walls?noisy=1&seed=1&start=20,20,0,0") as robot:
    state, distances = robot.refresh(), []
    end_s = state.clock_s + 40
    while state.clock_s < end_s:
        robot.sleep(0.1)  # of the robot's time: ten decisions a second, on any robot
        state = robot.refresh()
        right, ahead = min(state.sonars_in[11:15]), min(state.sonars_in[0], state.sonars_in[1], state.sonars_in[15])
        if ahead < DISTANCE_IN + 5:  # a corner: turn left on the spot
            robot.drive(steering_deg_s=30, turret_deg_s=30)
            continue
        turn = max(-25, min(25, 3 * (DISTANCE_IN - right)))  # too near: to the left
        robot.drive(translation_in_s=6, steering_deg_s=turn, turret_deg_s=turn)
        distances.append(right)
    print(f"{len(distances)} steps along walls, {sum(distances) / len(distances):.1f} in away on average")
