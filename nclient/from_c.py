"""docs/from-c.md: every call of Nclient.h beside what it is in Python, read off THE table, `Robot` and the mirror.

    python -m nclient.from_c > docs/from-c.md          (scripts/from-c-page does that)

Rules: calls of the table have no row by hand. Those that send nothing of their own (position data from memory, volts)
are in _BESIDE; a test evaluates each of them.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Final

from nclient import capi
from nclient.protocol.commands import BY_NAME, COMMANDS
from nclient.robot import Robot

_METRIC: Final = re.compile(r"_(m|rad)(_s2?)?$")
_BESIDE: Final[dict[str, str]] = {
    "server_is_running": "connect(address)",
    "scout_vm": "robot.drive_wheels(right_in_s=10, left_in_s=10)",
    "scout_pr": "robot.move_wheels(right_in=10, left_in=10)",
    "RIGHT": "robot.drive_wheels(right_in_s=10, left_in_s=5)",
    "LEFT": "robot.drive_wheels(right_in_s=5, left_in_s=10)",
    "posDataRequest": "robot.position_data(infrareds=True, sonars=True)",
    "posDataCheck": "robot.state.stamps.keys()",
    "posInfraredRingGet": "[robot.state.stamps.get(f'ir_{k}') for k in range(16)]",
    "posInfraredGet": "robot.state.stamps.get('ir_0')",
    "posSonarRingGet": "[robot.state.stamps.get(f'sonar_{k}') for k in range(16)]",
    "posSonarGet": "robot.state.stamps.get('sonar_0')",
    "posBumperGet": "robot.state.stamps.get('bumper')",
    "posLaserGet": "robot.state.stamps.get('laser')",
    "posCompassGet": "robot.state.stamps.get('compass')",
    "posTimeGet": "robot.state.clock_s",
    "voltCpuGet": "robot.state.battery.cpu_v",
    "voltMotorGet": "robot.state.battery.motor_v",
}
_HEAD: Final = """\
# From C to Python

Two ways. `nclient.capi` is Nclient.h in Python: same names, same argument orders, same `State`, and a program is
translated line by line. `Robot` is for new programs: plain verbs, units in the names, errors that are raised.
Made by `scripts/from-c-page` from the one table of commands.

```python
from nclient import capi
from nclient.capi import *

capi.SERVER_MACHINE_NAME = "sim:thesis_room"     # strcpy(SERVER_MACHINE_NAME, "localhost");
if connect_robot(1):                             # if (connect_robot(1)) {
    pr(240, 0, 0)                                #     pr(240, 0, 0);
    ws(1, 1, 1, 20)                              #     ws(1, 1, 1, 20);
    gs()                                         #     gs();
    print(State[34], State[35])                  #     printf("%ld %ld\\n", State[34], State[35]);
    disconnect_robot(1)                          #     disconnect_robot(1); }
```

```python
from nclient import connect

with connect("sim:thesis_room") as robot:        # nserver://localhost:7019/1, serial:///dev/ttyUSB0?model=n150
    robot.move(translation_in=24)
    state = robot.wait_until_still(timeout_s=20)
    print(state.x_in, state.y_in)
```

`SERVER_MACHINE_NAME` is a host in C, and in `nclient.capi` an [address](addresses.md) besides. Where it is empty,
`NOMAD_ROBOT` is the address in both, and this machine where that is not set either. A number in the address and that of
`connect_robot` have to be the same, or the address has none (`nserver://lab`).

What changes on the way from C to `Robot`:

- 1/10 inch and 1/10 degree become `_in` and `_deg`, or `_m` and `_rad` where the name says so: `translation_m=0.6`.
- TRUE and FALSE become a `RobotState`, or an exception with the reason: `ReplyTimeout`, `ConnectionLost`,
  `RobotRefused`.
- `State[17]` becomes `state.sonars_in[0]`; a state is a value and does not change under your hands. `state.raw` has the
  old numbers.
- Leaving the `with` stops the robot, and on a real one the time-out is set from the beginning ([safety](safety.md)).

## Every call

In `nclient.capi` each has its C name and arguments. `Robot` takes arguments by name; those in metres and radians exist
beside those shown.

"""


def markdown() -> str:
    """The whole page."""
    return _HEAD + "".join(f"{line}\n" for line in _rows())


def beside() -> dict[str, str]:
    """C name to Python, of the calls that are no command of the table, for `robot` and its `address`."""
    return dict(_BESIDE)


def _rows() -> Iterator[str]:
    yield "| C, and `nclient.capi` | `Robot` | what it does |"
    yield "|---|---|---|"
    for row in COMMANDS:
        yield f"| `{_c(row.name)}` | `robot.{row.method}({_robot_arguments(row.method)})` | {row.summary} |"
    yield ""
    yield "Calls that say nothing of their own, or say a call of above in other words:"
    yield ""
    yield "| C, and `nclient.capi` | such as | what it does |"
    yield "|---|---|---|"
    for name, python in _BESIDE.items():
        yield f"| `{_c(name)}` | `{python}` | {_summary(name)} |"


def _c(name: str) -> str:
    call = getattr(capi, name)
    return f"{name}({', '.join(inspect.signature(call).parameters)})"


def _robot_arguments(method: str) -> str:
    signature = inspect.signature(getattr(Robot, method))
    return ", ".join(name for name in list(signature.parameters)[1:] if not _METRIC.search(name))


def _summary(name: str) -> str:
    assert name not in BY_NAME
    return (inspect.getdoc(getattr(capi, name)) or "").split("\n")[0].rstrip(".")


if __name__ == "__main__":
    print(markdown(), end="")
