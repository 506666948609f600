"""The models that can be simulated: body, drive, limits of the axes. Data; what the wire says of a model is protocol's.

Top speeds and the accelerations at power-on are the users' numbers (20 in/s, 45 deg/s; 30 in/s2, 50 deg/s2). Decisions
of ours, for no source gives them: robots wake at their top speeds, accelerations go up to twice those numbers, and the
encoders tell velocities in tenths (0.1 in/s, 0.1 deg/s), as State does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from types import MappingProxyType
from typing import Final

from nserver_emu.simulation.axis import AxisLimits
from nserver_emu.simulation.drive import SynchroDrive
from worlds.bodies import N150 as N150_BODY
from worlds.bodies import Body

ROLLING: Final = AxisLimits(
    top_speed=20.0,
    top_acceleration=60.0,
    least_acceleration=0.1,
    speed=20.0,
    acceleration=30.0,
    resolution=0.1,
)
"""Translation of the synchro drives: inches and seconds."""

TURNING: Final = AxisLimits(
    top_speed=radians(45.0),
    top_acceleration=radians(100.0),
    least_acceleration=radians(0.1),
    speed=radians(45.0),
    acceleration=radians(50.0),
    resolution=radians(0.1),
)
"""Steering and turret of the synchro drives: radians and seconds."""


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A model as physics sees it: its body, the class of its drive, and the limits of its axes in their order."""

    name: str
    body: Body
    drive: type[SynchroDrive]
    axes: tuple[AxisLimits, AxisLimits, AxisLimits]


N150: Final = RobotModel("n150", N150_BODY, SynchroDrive, (ROLLING, TURNING, TURNING))

MODELS: Final[Mapping[str, RobotModel]] = MappingProxyType({model.name: model for model in (N150,)})
"""Every model that can be simulated by its name."""
