"""The client: `from nclient import connect`, then `with connect("nserver://localhost:7019/1") as robot:`.

What a program needs stands here; the C names are in nclient.capi, the wire in nclient.protocol.
"""

from __future__ import annotations

from nclient.aio import AsyncRobot
from nclient.backends.base import LinkStatistics
from nclient.connect import connect, connect_async
from nclient.errors import (
    AddressError,
    BumperHit,
    ConnectionLost,
    NomadError,
    RecordingError,
    ReplyTimeout,
    RobotRefused,
    StartError,
    WireError,
    WorldFileError,
)
from nclient.robot import Robot
from nclient.state import Battery, Pose, RobotState, Truth
from nclient.units import AxisCommand, AxisMode

__all__ = [
    "AddressError",
    "AsyncRobot",
    "AxisCommand",
    "AxisMode",
    "Battery",
    "BumperHit",
    "ConnectionLost",
    "LinkStatistics",
    "NomadError",
    "Pose",
    "RecordingError",
    "ReplyTimeout",
    "Robot",
    "RobotRefused",
    "RobotState",
    "StartError",
    "Truth",
    "WireError",
    "WorldFileError",
    "connect",
    "connect_async",
]
