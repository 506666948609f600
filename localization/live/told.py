"""What a robot tells the filter: its clock, where its encoders are, and the last reading of each sonar. Values, pure.

    RobotState ──> retold: a calibration's, without some sonars, with bad readings ──> Localizer.update
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


class Told(Protocol):
    """What the filter wants of a robot's state; nclient's RobotState has it. Seconds, inches, radians."""

    @property
    def clock_s(self) -> float | None: ...
    @property
    def x_in(self) -> float: ...
    @property
    def y_in(self) -> float: ...
    @property
    def steering_rad(self) -> float: ...
    @property
    def turret_rad(self) -> float: ...
    @property
    def sonars_in(self) -> tuple[float, ...]: ...


@dataclass(frozen=True, slots=True)
class Retold:
    """The same, no longer as the robot said it."""

    clock_s: float | None
    x_in: float
    y_in: float
    steering_rad: float
    turret_rad: float
    sonars_in: tuple[float, ...]


def retold(told: Told, sonars_in: tuple[float, ...], turret_rad: float | None = None) -> Retold:
    """It with other readings of the sonars, and with the ring turned to `turret_rad` where that is given."""
    turret = told.turret_rad if turret_rad is None else turret_rad
    return Retold(told.clock_s, told.x_in, told.y_in, told.steering_rad, turret, sonars_in)
