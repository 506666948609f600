"""Learn a map of walls from a drive without a map: the procedure.

    for every 16 nodes (8 s of driving)
        extend by odometry --> headings after turns --> associate --> optimize
        --> births from the unexplained echoes of the last 30 s --> associate --> optimize --> merge, prune
    at the end
        join what was not recognized; births from all echoes; open, part, join, merge, split, swallow, absorb, posts,
        release, square, prune; tie points to walls; optimize; drop what is hidden; weigh the ranges; turn walls and
        square them; drop slanted walls that explain hardly anything; trim surfaces
    once more in rounds of another size, if the map is poor or walls have levels; try walls of the other map in the
    cheaper one (`alternatives.py`), and bring its walls to right angles (`learn_log`)

Revision makes the map as simple as its echoes allow (`revision.py`, and `merging.py` for walls that are one or two).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from localization.filters.belief import relative_pose
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.filters.surface import SPOT_STD_IN
from localization.mapping.alternatives import adopt_walls
from localization.mapping.association import MapEstimate
from localization.mapping.features import close_loops, find_births
from localization.mapping.headings import LAG_NODES, align_heading, track
from localization.mapping.measurements import DriveLog, build_trajectory
from localization.mapping.merging import merge, open_faces, split, split_surfaces
from localization.mapping.problem import PARAMETER_STDS, PLANES, MapProblem, Reflection
from localization.mapping.revision import (
    LAST_STEPS,
    absorb_points,
    add_posts,
    close_wall_ends,
    drop_corner_cuts,
    drop_hidden,
    drop_slanted,
    drop_spurious_walls,
    drop_unmeasured,
    join_points,
    part_late_points,
    part_points,
    prune,
    release_stretches,
    square,
    square_together,
    swallow,
    tie_points,
    trim_surfaces,
    turn_walls,
)
from localization.mapping.weights import weigh_ranges

NODES_PER_ROUND: Final = 16
OTHER_NODES, LEVEL_NODES = 12, 24
"""Nodes of a round that are tried as well where the map is poor, or where walls have levels: an early mistake of one is
none of the other."""
POOR_MISFIT: Final = 0.68
"""Misfit of a finished map that is learned once more. Sound ones of flats have 0.50 to 0.66, one of 26 had 0.71, and
one whose rooms were folded by the thickness of a wall 0.72."""
TRACKED_NODES: Final = 2
WINDOW_NODES: Final = 60
"""Nodes whose echoes may give birth to features: beyond 30 s the odometry has drifted too far for a Hough cell."""
LOOP_WINDOW_NODES: Final = 60
"""Features that are older by this are tried as new ones of a loop as well: several are needed."""
LAST_ROUNDS: Final = 3
ROUGHNESS_IN: Final = 0.15
"""Deviation of smooth walls from a straight line, and random motion within a node."""
LEVEL_ROUGHNESS_IN: Final = SPOT_STD_IN
"""Deviation of the surface of a real wall from its levels."""


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
    roughness_in
        Standard deviation of the walls' surfaces from straight lines; None: see `reflection_of`.
    nodes_per_round
        Nodes that `advance` adds.
    scale_stds
        Prior standard deviations of the first of distance scale, turn scale and drift; the others have PARAMETER_STDS.
    """

    def __init__(
        self,
        log: DriveLog,
        noise: OdometryNoise,
        sonar: ConeSonar,
        *,
        rays: bool = False,
        roughness_in: float | None = None,
        nodes_per_round: int = NODES_PER_ROUND,
        scale_stds: tuple[float, ...] = (),
    ) -> None:
        self._noise, self._sonar, self._nodes_per_round = noise, sonar, nodes_per_round
        roughness_in, reflection = reflection_of(sonar, roughness_in)
        self.trajectory = build_trajectory(log, noise, sonar, roughness_in, rays=rays)
        stds = (*scale_stds, *PARAMETER_STDS[len(scale_stds) :])
        problem = MapProblem(
            self.trajectory, len(log.angles_rad), rays=rays, parameter_stds=stds, reflection=reflection
        )
        self.estimate = MapEstimate.start(problem)
        self.turret_rad = float(log.encoders[-1, 4] - log.encoders[-1, 3])
        """Angle of the turret from the heading at the end."""
        self.rest = relative_pose(self.trajectory.odometry[-1], log.encoders[-1, 1:4])
        """Motion after the last node, by the encoders."""

    @property
    def is_complete(self) -> bool:
        """True once all nodes are in the map."""
        return len(self.estimate.state.poses) == len(self.trajectory)

    def advance(self) -> None:
        """Add the next nodes."""
        estimate = self.estimate
        before = len(estimate.state.poses)
        count = min(before + self._nodes_per_round, len(self.trajectory))
        window = max(count - WINDOW_NODES, 0)
        # 1. Where the robot is, by the features so far, in small steps: the odometry of 8 s may lead to another wall.
        for known in range(before, count, TRACKED_NODES):
            first, last = max(known - LAG_NODES, 0), min(known + TRACKED_NODES, count)
            stretch = track(estimate, self.trajectory.part(first, last), estimate.state.poses[first:], self._noise)
            poses = np.concatenate((estimate.state.poses[:first], stretch.state.poses))
            estimate.state = replace(estimate.state, poses=poses)
        align_heading(estimate, before - self._nodes_per_round // 2, self._noise)
        update_features(estimate, window)

    def finish(self) -> None:
        """Revise the map with all echoes."""
        close_loops(self.estimate)
        for _ in range(LAST_ROUNDS):
            if not revise(self.estimate):
                break
        if find_births(self.estimate, 0, with_doubtful=True):
            self.estimate.associate()
            self.estimate.optimize()
            merge(self.estimate)
            prune(self.estimate)
        # Posts that were found last may be the ends of a wall.
        if self.estimate.surface_in:
            join_points(self.estimate)
        square(self.estimate)
        drop_hidden(self.estimate)
        drop_corner_cuts(self.estimate)
        tie_points(self.estimate)
        # With the weights of its ranges and first echoes, and without those that the map then explains no more.
        self.estimate.expects_first_echoes = True
        for _ in range(2):
            weigh_ranges(self.estimate, self._sonar)
            self.estimate.optimize(LAST_STEPS)
            self.estimate.associate()
        turn_walls(self.estimate)
        square(self.estimate)
        drop_slanted(self.estimate)
        drop_spurious_walls(self.estimate)
        # Walls that were two by the weights of before.
        if merge(self.estimate):
            tie_points(self.estimate)
            self.estimate.optimize(LAST_STEPS)
            self.estimate.associate()
        if drop_unmeasured(self.estimate):
            tie_points(self.estimate)
        self._complete()

    def adopt(self, other: MapLearner) -> None:
        """Take walls of another map of the drive where this one costs less with them; both of walls with levels."""
        for estimate in (self.estimate, other.estimate):
            # With the echoes that `trim_surfaces` has left out of either.
            estimate.associate()
        # A wall of the other map may be one with a wall of this one.
        if adopt_walls(self.estimate, other.estimate) + merge(self.estimate) + square(self.estimate):
            tie_points(self.estimate)
            self.estimate.optimize(LAST_STEPS)
            self.estimate.associate()
        self._complete()

    def _complete(self) -> None:
        """Divide walls with levels at gaps, close the ends of walls, and leave out what is beyond them."""
        split_surfaces(self.estimate)
        close_wall_ends(self.estimate)
        trim_surfaces(self.estimate)


def reflection_of(sonar: ConeSonar, roughness_in: float | None) -> tuple[float, Reflection]:
    """Return the roughness of walls, and how they reflect.

    With a given roughness walls are planes that are so rough everywhere. By default those of sonars in a building have
    levels, and LEVEL_ROUGHNESS_IN on each; others have ROUGHNESS_IN.
    """
    if roughness_in is None and sonar.surface_std_in:
        return LEVEL_ROUGHNESS_IN, Reflection.of(sonar)
    return ROUGHNESS_IN if roughness_in is None else roughness_in, PLANES


def revise(estimate: MapEstimate) -> int:
    """Add, join, merge and remove features by all echoes, optimize, and return the number of changes."""
    changed = find_births(estimate, 0)
    estimate.associate()
    estimate.optimize()
    for change in (
        open_faces, part_points, part_late_points, join_points, merge, split, swallow, absorb_points, add_posts,
        release_stretches, square, prune,
    ):  # fmt: skip
        changed += change(estimate)
    tie_points(estimate)
    estimate.optimize()
    estimate.associate()
    return changed


def update_features(estimate: MapEstimate, first_node: int) -> None:
    """Optimize everything, and add, merge and remove features by the echoes of the nodes since one."""
    estimate.associate(first_node)
    estimate.optimize()
    # 1. New features.
    estimate.associate(first_node)
    if find_births(estimate, first_node):
        estimate.associate(first_node)
        estimate.optimize()
    # 2. Revision.
    if merge(estimate, with_faces=False) + prune(estimate, first_node):
        estimate.optimize()
    # 3. Places that were not recognized.
    if close_loops(estimate, first_node - LOOP_WINDOW_NODES) and merge(estimate, with_faces=False) + prune(estimate):
        estimate.optimize()


def learn_log(
    log: DriveLog,
    noise: OdometryNoise,
    sonar: ConeSonar,
    *,
    rays: bool = False,
    roughness_in: float | None = None,
    scale_stds: tuple[float, ...] = (),
) -> MapLearner:
    """Return the learner of a drive after its end; see `MapLearner` for the parameters.

    Where walls have levels, or the map is poor, the drive is learned once more, in rounds of another size: early
    mistakes are others then. The cheaper map is taken.
    """
    has_levels = reflection_of(sonar, roughness_in)[1] is not PLANES

    def learned(nodes: int) -> MapLearner:
        learner = MapLearner(
            log, noise, sonar, rays=rays, roughness_in=roughness_in, scale_stds=scale_stds, nodes_per_round=nodes
        )
        while not learner.is_complete:
            learner.advance()
        learner.finish()
        return learner

    first = learned(NODES_PER_ROUND)
    # What is poor is known of smooth walls alone.
    is_poor = roughness_in is None and first.estimate.misfit > POOR_MISFIT
    if not has_levels and not is_poor:
        return first
    second = learned(LEVEL_NODES if has_levels else OTHER_NODES)
    best, other = sorted((first, second), key=_cost_by_readings)
    if has_levels:
        best.adopt(other)
    square_together(best.estimate)
    return best


def _cost_by_readings(learner: MapLearner) -> float:
    """Return the cost of a map with the weights that ranges have before there is one: the same for all maps."""
    estimate = learner.estimate.copy()
    estimate.problem = estimate.problem.with_trajectory(learner.trajectory)
    if estimate.surface_in:
        # With those that `trim_surfaces` has left out.
        estimate.associate()
    return estimate.cost


def learn_map(
    log: DriveLog, noise: OdometryNoise, sonar: ConeSonar, *, rays: bool = False, roughness_in: float | None = None
) -> MapEstimate:
    """Return the map of a drive; see `MapLearner` for the parameters."""
    return learn_log(log, noise, sonar, rays=rays, roughness_in=roughness_in).estimate
