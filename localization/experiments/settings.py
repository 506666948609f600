"""What each figure of the thesis is run with. Data, and the one function that lays a figure out in its world.

Rules: numbers only, each with its source; nothing is computed from results, and no noise is tuned to reach one. What
the text leaves open (noise, start, way-point radius) is fixed here once for all figures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from localization.driving.control import Gains
from localization.filters.base import THESIS_ODOMETRY
from localization.filters.belief import Floats
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_ray import IDEAL_SONAR, Beams, RaySonar, WallMap, ring, wall_map
from worlds.bodies import N150
from worlds.files import load_world

WAYPOINT_RADIUS_IN: Final = 0.25
"""A way-point counts as reached when the estimate is this near to it."""

START_STD: Final = (0.1, 0.1, 0.01)
"""What the filter starts with: in, in, rad; its first estimate is drawn from that."""

NOISE: Final = THESIS_ODOMETRY
"""How the true motion strays; the filter knows these numbers."""

PATIENCE: Final = 3
"""A run longer than this many times the way it had to go, at full steps, is lost and ends."""

_SLOW: Final = Gains(drho_max_in=0.05, dtheta_max_rad=0.05, alpha_rho=0.1, alpha_theta=0.1)
_BADLY_CHOSEN: Final = Gains(drho_max_in=0.5, dtheta_max_rad=0.5, alpha_rho=0.08, alpha_theta=0.8)


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of the thesis: its world and control law, whether the filter runs, and what the text counts.

    `errors_figure` is the number of the figure that shows the errors of the same run, "" where there is none.
    """

    name: str
    title: str
    world: str
    errors_figure: str = ""
    gains: Gains = _SLOW
    filtered: bool = True
    steps_thesis: int | None = None


FIGURES: Final[Mapping[str, Figure]] = MappingProxyType(
    {
        figure.name: figure
        for figure in (
            Figure("5.2", "Without the filter", "thesis_room", "5.3", filtered=False),
            Figure("5.4", "With the filter", "thesis_room", "5.5", steps_thesis=1199),
            Figure("5.6", "Badly chosen limits", "thesis_room", "5.7", gains=_BADLY_CHOSEN, steps_thesis=150),
            Figure("5.8", "Guided path between several walls", "several_walls"),
            Figure("5.9", "Guided path around a vertex", "centre_vertex"),
        )
    }
)


@dataclass(frozen=True, slots=True)
class Course:
    """All that a trial needs: where the robot starts (3,), where it must go (k, 2), what it sees, and how it errs."""

    start: Floats
    goals_in: Floats
    walls: WallMap
    beams: Beams
    gains: Gains
    filtered: bool = True
    start_std: tuple[float, float, float] = START_STD
    noise: OdometryNoise = NOISE
    sonar: RaySonar = IDEAL_SONAR
    waypoint_radius_in: float = WAYPOINT_RADIUS_IN

    @property
    def length_in(self) -> float:
        """The length of the polyline from the start through all goals."""
        corners = np.vstack([self.start[:2], self.goals_in])
        return float(np.hypot(*np.diff(corners, axis=0).T).sum())

    @property
    def least_steps(self) -> int:
        """How many whole steps of full length the way takes at least."""
        return math.floor(self.length_in / self.gains.drho_max_in)

    @property
    def most_steps(self) -> int:
        """The length at which a run is given up."""
        return PATIENCE * self.least_steps + 1


def course_of(figure: Figure) -> Course:
    """The figure laid out in its world: the N150's ring, its turret turning with the steering as in the thesis."""
    world = load_world(figure.world)
    path = world.paths[figure.name]
    return Course(
        start=np.array([path.start.x_in, path.start.y_in, path.start.steering_rad]),
        goals_in=np.array(path.goals_in, dtype=np.float64),
        walls=wall_map(world.walls),
        beams=ring(N150),
        gains=figure.gains,
        filtered=figure.filtered,
    )
