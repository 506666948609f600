"""Record the traffic of a drive, and run the same program on the recording instead of the robot.

    python examples/record_and_replay.py [FILE]
"""

import sys

from nclient import connect

file = sys.argv[1] if len(sys.argv) > 1 else "out/drive.log"


def drive(address: str) -> str:
    with connect(address) as robot:
        robot.move(translation_in=24)
        state = robot.wait_until_still(timeout_s=20)
        return f"x {state.x_in:.1f} in, ahead {state.sonars_in[0]} in"


live = drive(f"sim:thesis_room?noisy=1&seed=1&record={file}")
again = drive(f"replay:{file}")
print(f"live:     {live}\nreplayed: {again}")
