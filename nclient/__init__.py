"""The client: `from nclient import connect`, then `with connect("nserver://localhost:7019/1") as robot:`.

What a program needs stands here; the C names are in nclient.capi, the wire in nclient.protocol. A name's module is
imported when the name is first used (PEP 562), so that commands start without the parts that they do not need.
"""

from __future__ import annotations

from importlib import import_module

# As in typing, whose import takes longer than all others before a command handles signals (common/__init__.py).
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from nclient.aio import AsyncRobot
    from nclient.backends.base import LinkStatistics
    from nclient.connector import connect, connect_async
    from nclient.errors import (
        AddressError,
        BumperHit,
        ConnectionLost,
        NomadError,
        RecordingError,
        ReplyTimeout,
        RobotHeld,
        RobotRefused,
        StartError,
        WireError,
        WorldFileError,
    )
    from nclient.robot import Robot
    from nclient.state import AxisCommand, AxisMode, Battery, Pose, RobotState, Truth

__all__ = [
    "AddressError", "AsyncRobot", "AxisCommand", "AxisMode", "Battery", "BumperHit", "ConnectionLost", "LinkStatistics",
    "NomadError", "Pose", "RecordingError", "ReplyTimeout", "Robot", "RobotHeld", "RobotRefused", "RobotState",
    "StartError", "Truth", "WireError", "WorldFileError", "connect", "connect_async",
]  # fmt: skip
_MODULES = {
    "aio": ("AsyncRobot",),
    "backends.base": ("LinkStatistics",),
    "connector": ("connect", "connect_async"),
    "robot": ("Robot",),
    "state": ("AxisCommand", "AxisMode", "Battery", "Pose", "RobotState", "Truth"),
}
"""Where the names are defined; those that are in no row are in `errors`."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = next((module for module, names in _MODULES.items() if name in names), "errors")
    value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
