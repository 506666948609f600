"""The seam between the live localizer and its method: what each method must have.

    move(step)      the encoders told of a step          hear(sonar, turret, reading)    an echo, at this very instant
    belief          what is held to be true              ahead(step)                     the same a step on, not taken

Rules: a method is made from what is known beforehand and a first belief (table.make); one with chance in it is handed
a seed. No robot, no clock, no map file. Echoes come in order of time, each with the filter at its instant.

What a filter knows beforehand: the map, the robot's ring, and how motion and sonars err. Values, nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, runtime_checkable

import numpy.typing as npt

from localization.filters.belief import Belief, Floats
from localization.filters.health import FilterHealth
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeModel, ConeSonar
from localization.filters.sonar_ray import STRICT, WIRE_SONAR, Gate, RayModel, RaySonar, SonarRing
from localization.filters.update import MeasurementModel, UpdateResult
from worlds.robots import IDEAL_CALIBRATION, Calibration


class Filter(Protocol):
    """A belief about a robot, kept up to date."""

    @property
    def belief(self) -> Belief:
        """Mean (n,) and covariance (n, n), n >= 3: a pose and what else is found out (systematic)."""
        ...

    @property
    def health(self) -> FilterHealth:
        """How far it can be believed."""
        ...

    def move(self, step: Floats) -> None:
        """The encoders told of a step (2,): inches rolled, radians turned."""
        ...

    def ahead(self, step: Floats) -> Belief:
        """The belief after such a step, which is not taken."""
        ...

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """A reading of sonar number `sonar`, the turret being turned by so much against the heading."""
        ...


class Place(NamedTuple):
    """Where the robot may be, and the share of all that is believed."""

    belief: Belief
    share: float


@runtime_checkable
class Searching(Protocol):
    """What a method has besides that may hold several places for possible."""

    @property
    def places(self) -> tuple[Place, ...]:
        """The likeliest first; none while it has no idea."""
        ...


@runtime_checkable
class Smoothing(Protocol):
    """What a method has besides that looks back: readings since then have their say about where the robot was."""

    @property
    def lag(self) -> int:
        """How many moves back it looks."""
        ...

    def smoothed(self) -> Belief:
        """The belief over the state `lag` moves ago (at the first, where there were fewer), its readings included."""
        ...


THESIS_ODOMETRY: Final = OdometryNoise()
"""What the experiments take the encoders to miss."""


@dataclass(frozen=True, slots=True)
class LocalizationConfig:
    """Walls (m, 4) in inches, the robot's ring, and how motion and sonars err.

    `clearance_in`: no wall is nearer to the robot's axis than this: its radius, or a little less.
    `errs`: what this very robot gets wrong every time; its sonars are corrected by that, its wheels are the belief's.
    The kind of `sonar` says how readings are taken in (filters.hearing); the gate is for rays alone.
    """

    walls: npt.ArrayLike
    body: SonarRing
    odometry: OdometryNoise = THESIS_ODOMETRY
    sonar: RaySonar | ConeSonar = WIRE_SONAR
    gate: Gate = STRICT
    clearance_in: float = 9.0
    errs: Calibration = IDEAL_CALIBRATION


def measurement_model(
    walls: npt.ArrayLike, body: SonarRing, sonar: RaySonar | ConeSonar, gate: Gate = STRICT
) -> MeasurementModel:
    """How sonars of this model are understood."""
    if isinstance(sonar, ConeSonar):
        return ConeModel(walls, body, sonar)
    return RayModel(walls, body, sonar, gate)
