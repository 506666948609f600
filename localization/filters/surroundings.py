"""What a filter knows beforehand: the map, the robot's ring, and how motion and sonars err. Values, nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy.typing as npt

from localization.estimation.hearing import Sense
from localization.estimation.motion import OdometryNoise
from localization.sonar.cone import ConeModel
from localization.sonar.cone_sense import ConeSense
from localization.sonar.gating import STRICT, Gate
from localization.sonar.measurement import WIRE_SONAR, SonarModel, SonarRing
from localization.sonar.ray_sense import RaySense
from worlds.calibration import FAULTLESS, Calibration

THESIS_ODOMETRY: Final = OdometryNoise()
"""What the experiments take the encoders to miss."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Walls (m, 4) in inches, the robot's ring, and how motion and sonars err.

    `clearance_in`: no wall is nearer to the robot's axis than this: its radius, or a little less.
    `errs`: what this very robot gets wrong every time; its sonars are corrected by that, its wheels are the belief's.
    The kind of `sonar` says how readings are taken in (filters.hearing); the gate is for rays alone.
    """

    walls: npt.ArrayLike
    body: SonarRing
    odometry: OdometryNoise = THESIS_ODOMETRY
    sonar: SonarModel | ConeModel = WIRE_SONAR
    gate: Gate = STRICT
    clearance_in: float = 9.0
    errs: Calibration = FAULTLESS


def sense_of(walls: npt.ArrayLike, body: SonarRing, sonar: SonarModel | ConeModel, gate: Gate = STRICT) -> Sense:
    """How sonars of this model are understood."""
    if isinstance(sonar, ConeModel):
        return ConeSense(walls, body, sonar)
    return RaySense(walls, body, sonar, gate)
