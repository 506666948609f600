"""Generate the tables of docs/from-c.md: every call of Nclient.h next to its equivalent in Python.

Rows come from the command table, the methods of `Robot` and the signatures of `capi`. Calls that send no command of
their own are in `_EXAMPLES`; a test evaluates each of them.
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
_EXAMPLES: Final[dict[str, str]] = {
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
def blocks() -> dict[str, Iterator[str]]:
    """Return the tables of the page."""
    return {"commands": _commands(), "others": _others()}


def examples() -> dict[str, str]:
    """Return C name and Python expression (of `robot` and `address`) of calls that are not in the command table."""
    return dict(_EXAMPLES)


def _commands() -> Iterator[str]:
    yield "| C and `nclient.capi` | `Robot` | effect |"
    yield "|---|---|---|"
    for row in COMMANDS:
        yield f"| `{_c(row.name)}` | `robot.{row.method}({_robot_arguments(row.method)})` | {row.summary} |"


def _others() -> Iterator[str]:
    yield "| C and `nclient.capi` | example | effect |"
    yield "|---|---|---|"
    for name, python in _EXAMPLES.items():
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
