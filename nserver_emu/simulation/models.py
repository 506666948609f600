"""The models that can be simulated: body, drive, limits of the axes. Data; what the wire says of a model is protocol's.

Top speeds and the accelerations at power-on are the users' numbers (20 in/s, 45 deg/s; 30 in/s2, 50 deg/s2; Scout
39 in/s a wheel, 30 in/s2). Decisions of ours, for no source gives them: robots wake at their top speeds, accelerations
go up to twice those numbers, and the encoders tell velocities in tenths (0.1 in/s, 0.1 deg/s), as State does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, radians
from types import MappingProxyType
from typing import Final

from nserver_emu.simulation.axis import AxisLimits
from nserver_emu.simulation.drive import NO_AXIS, DifferentialDrive, Drive, SynchroDrive
from worlds.bodies import N150 as N150_BODY
from worlds.bodies import N200 as N200_BODY
from worlds.bodies import SCOUT as SCOUT_BODY
from worlds.bodies import Body
from worlds.calibration import Calibration

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

WHEEL: Final = AxisLimits(
    top_speed=39.0,
    top_acceleration=60.0,
    least_acceleration=0.1,
    speed=39.0,
    acceleration=30.0,
    resolution=0.1,
)
"""A wheel of the Scout: inches and seconds."""

SCOUT_WHEEL_IN_PER_DEGREE: Final = 0.118597
"""Way of each wheel of a Scout for a turn of one degree on the spot, the users' rate constant."""

SCOUT_TRACK_IN: Final = 2.0 * degrees(SCOUT_WHEEL_IN_PER_DEGREE)
"""Distance between the wheels of a Scout that this constant means: 13.590 in."""


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A model as physics sees it.

    name        what users call it
    body        radii, sonars, bumpers
    axes        limits of the axes in the order of the commands
    track_in    distance between the wheels of a differential drive, inches; None: a synchro drive
    family      the model that it is to a client, which knows three: n150, n200, scout
    sees        whether it has infrareds and a laser
    compass     whether it has a compass
    errs        what this very robot gets wrong every time, whatever its setup says of that; None: nothing is known
    """

    name: str
    body: Body
    axes: tuple[AxisLimits, AxisLimits, AxisLimits]
    track_in: float | None = None
    family: str = ""
    sees: bool = False
    compass: bool = True
    errs: Calibration | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "family", self.family or self.name)

    @property
    def rolls(self) -> tuple[bool, bool, bool]:
        """Which axes count inches; the others count radians."""
        return SynchroDrive.rolls if self.track_in is None else DifferentialDrive.rolls

    def drive(self, ramps: bool) -> Drive:
        """A new drive of this model; `ramps` False: its axes jump to their speeds."""
        if self.track_in is None:
            return SynchroDrive(self.axes, ramps)
        return DifferentialDrive(self.axes, ramps, self.track_in)


N150: Final = RobotModel("n150", N150_BODY, (ROLLING, TURNING, TURNING))
N200: Final = RobotModel("n200", N200_BODY, (ROLLING, TURNING, TURNING), sees=True)
SCOUT: Final = RobotModel("scout", SCOUT_BODY, (WHEEL, WHEEL, NO_AXIS), SCOUT_TRACK_IN, compass=False)

MODELS: Final[Mapping[str, RobotModel]] = MappingProxyType({model.name: model for model in (N150, N200, SCOUT)})
"""Every model that can be simulated by its name."""
