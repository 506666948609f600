"""Learn a map of walls from a drive without a map: the procedure.

    for every 16 nodes (8 s of driving)
        extend by odometry --> headings after turns --> associate --> optimize
        --> births from the unexplained echoes of the last 30 s --> associate --> optimize --> merge, prune
    at the end
        births from all echoes, merge, prune, tie points to walls, optimize
"""

from __future__ import annotations

from typing import Final

from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate, align_heading
from localization.mapping.births import find_births
from localization.mapping.measurements import DriveLog, build_trajectory
from localization.mapping.problem import MapProblem
from localization.mapping.revision import merge, prune, tie_points

NODES_PER_ROUND: Final = 16
WINDOW_NODES: Final = 60
"""Nodes whose echoes may give birth to features: beyond 30 s the odometry has drifted too far for a Hough cell."""
LAST_ROUNDS: Final = 3
POSITION_STD_IN: Final = 0.15


class MapLearner:
    """The estimator of one drive: `advance` takes the next nodes into account, `finish` revises the whole map."""

    def __init__(self, log: DriveLog, noise: OdometryNoise, sonar: ConeSonar, *, rays: bool = False) -> None:
        self.noise = noise
        self.trajectory = build_trajectory(log, noise, sonar, POSITION_STD_IN)
        self.estimate = MapEstimate.start(MapProblem(self.trajectory, len(log.angles_rad), rays=rays))

    @property
    def is_complete(self) -> bool:
        """Return True once all nodes are in the map."""
        return len(self.estimate.state.poses) == len(self.trajectory)

    def advance(self) -> None:
        """Add the next nodes."""
        estimate = self.estimate
        before = len(estimate.state.poses)
        count = min(before + NODES_PER_ROUND, len(self.trajectory))
        window = max(count - WINDOW_NODES, 0)
        # 1. Where the robot is, by the features so far.
        estimate.extend(count)
        align_heading(estimate, before - NODES_PER_ROUND // 2, self.noise)
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
            born = find_births(estimate, 0)
            estimate.associate()
            estimate.optimize()
            changed = merge(estimate) + prune(estimate)
            tie_points(estimate)
            estimate.optimize()
            estimate.associate()
            if not born + changed:
                break
        tie_points(estimate)
        estimate.optimize(10)


def learn_map(log: DriveLog, noise: OdometryNoise, sonar: ConeSonar, *, rays: bool = False) -> MapEstimate:
    """Return the map of a drive."""
    learner = MapLearner(log, noise, sonar, rays=rays)
    while not learner.is_complete:
        learner.advance()
    learner.finish()
    return learner.estimate
