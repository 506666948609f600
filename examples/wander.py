"""Wander for a minute: drive ahead, and turn away from what is near.

    python examples/wander.py [ADDRESS]
"""

import sys

from nclient import connect

with connect(sys.argv[1] if len(sys.argv) > 1 else "sim:flat?noisy=1&seed=4") as robot:
    state, turns, turn_deg_s = robot.refresh(), 0, 0
    end_s = state.clock_s + 60
    while state.clock_s < end_s:
        robot.sleep(0.1)  # of the robot's time: ten decisions a second, on any robot
        state = robot.refresh()
        ahead = min(state.sonars_in[number] for number in (14, 15, 0, 1, 2))  # 45 degrees to each side
        if ahead > (24 if turn_deg_s else 16):
            turn_deg_s = 0
            robot.drive(translation_in_s=8)
            continue
        # Turn on the spot to the side with more room, until the way is free.
        if turn_deg_s == 0:
            turns += 1
            turn_deg_s = 40 if sum(state.sonars_in[1:6]) > sum(state.sonars_in[11:16]) else -40
        robot.drive(steering_deg_s=turn_deg_s, turret_deg_s=turn_deg_s)
    print(f"{turns} turns, now at {state.x_in:.0f}, {state.y_in:.0f} in; bumpers {state.bumpers or 'free'}")
