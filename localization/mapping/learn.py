"""Learn a map of walls from a drive without a map: the procedure.

for every 16 nodes (8 s of driving)
extend by odometry --> headings after turns --> associate --> optimize
--> births from the unexplained echoes of the last 30 s --> associate --> optimize --> merge, prune
at the end
births from all echoes; merge, swallow, absorb, prune; tie points to walls; optimize
"""

from __future__ import annotations

from typing import Final

from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate, align_heading
from localization.mapping.births import find_births
from localization.mapping.measurements import DriveLog, build_trajectory
from localization.mapping.problem import MapProblem
from localization.mapping.revision import absorb_points, merge, prune, swallow, tie_points

NODES_PER_ROUND: Final = 16
WINDOW_NODES: Final = 60
"""Nodes whose echoes may give birth to features: beyond 30 s the odometry has drifted too far for a Hough cell."""
LAST_ROUNDS: Final = 3
LAST_STEPS: Final = 10
POSITION_STD_IN: Final = 0.15
"""Random motion within a node, and roughness of walls."""


class MapLearner:
    """The estimator of one drive: `advance` takes the next nodes into account, `finish` revises the whole map.

    Parameters
    ----------
    log
        The drive.
    noise
        Random errors of the odometry.
    sonar
        Noise and limits of the readings.
    rays
        True if sonars measure along exact rays.
    """

    def __init__(self, log: DriveLog, noise: OdometryNoise, sonar: ConeSonar, *, rays: bool = False) -> None:
        self._noise = noise
        self.trajectory = build_trajectory(log, noise, sonar, POSITION_STD_IN)
        self.estimate = MapEstimate.start(MapProblem(self.trajectory, len(log.angles_rad), rays=rays))
        self.turret_rad = float(log.encoders[-1, 4] - log.encoders[-1, 3])
        """Angle of the turret from the heading at the end."""

    @property
    def is_complete(self) -> bool:
        """True once all nodes are in the map."""
        return len(self.estimate.state.poses) == len(self.trajectory)

    def advance(self) -> None:
        """Add the next nodes."""
        estimate = self.estimate
        before = len(estimate.state.poses)
        count = min(before + NODES_PER_ROUND, len(self.trajectory))
        window = max(count - WINDOW_NODES, 0)
        # 1. Where the robot is, by the features so far.
        estimate.extend(count)
        align_heading(estimate, before - NODES_PER_ROUND // 2, self._noise)
        estimate.associate(window)
        estimate.optimize()
        # 2. New features.
        estimate.associate(window)
        if find_births(estimate, window):
            estimate.associate(window)
            estimate.optimize()
        # 3. Revision.
        if merge(estimate) + prune(estimate):
            estimate.optimize()

    def finish(self) -> None:
        """Revise the map with all echoes."""
        estimate = self.estimate
        for _ in range(LAST_ROUNDS):
            changed = find_births(estimate, 0)
            estimate.associate()
            estimate.optimize()
            for revise in (merge, swallow, absorb_points, prune):
                changed += revise(estimate)
            tie_points(estimate)
            estimate.optimize()
            estimate.associate()
            if not changed:
                break
        tie_points(estimate)
        estimate.optimize(LAST_STEPS)


def learn_map(log: DriveLog, noise: OdometryNoise, sonar: ConeSonar, *, rays: bool = False) -> MapEstimate:
    """Return the map of a drive; see `MapLearner` for the parameters."""
    learner = MapLearner(log, noise, sonar, rays=rays)
    while not learner.is_complete:
        learner.advance()
    learner.finish()
    return learner.estimate
