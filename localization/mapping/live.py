"""A map that grows while the robot drives, and the pose of the robot in it.

    each state           readings --> groups of half a second
    each group           poses of the last 10 s, in the map as it is       (fixed-lag smoother, some milliseconds)
    every 16 nodes       the whole map, from the poses so far              (warm start; see learn.py)
    in between           last pose --> encoders --> pose now

The result of a drive is not this map: that is learned again from the recording, so that the same recording always gives
the same map.

References
----------
Kaess et al., Concurrent Filtering and Smoothing (2012): a short smoother for the present beside a full one for the map.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from localization.filters.belief import HEADING, POSE, Floats, compose, relative_pose, wrap_angle
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.live.sensor_input import FiringTime
from localization.mapping.association import MapEstimate
from localization.mapping.consistency import is_consistent
from localization.mapping.headings import LAG_NODES, align_heading, track
from localization.mapping.learn import NODES_PER_ROUND, WINDOW_NODES, MapLearner, reflection_of, revise, update_features
from localization.mapping.measurements import (
    READINGS_PER_NODE,
    DriveCollector,
    DriveLog,
    Indices,
    Steps,
    build_trajectory,
)
from localization.mapping.problem import NO_FEATURE, Assignment, MapProblem
from localization.mapping.reflectors import segments_of, sides_of
from localization.mapping.walls import Piece, extract_walls
from nclient.state import RobotState

WHOLE_ROUNDS, WHOLE_NODES = 4, 600
"""Of so many solutions one takes the echoes of so many nodes for births: in 30 s too little is seen of a wall that the
robot passes now and then. Rooms are explored in 300 s."""
NODES_PER_FRACTION: Final = 25
"""The longer the drive, the rarer the whole map is solved: the effort grows with its nodes."""
ALWAYS_CHALLENGED: Final = 80
"""Nodes up to which each map is compared with one learned from the beginning: the first 40 s decide."""
CHALLENGE_GROWTH, MAX_CHALLENGED = 1.5, 600
"""Where the ranges misfit, again after so much more driving, up to so many nodes: later learning takes too long."""
CHALLENGE_ROUNDS: Final = (17, 24, 13)
"""Nodes per round of those, in turn: other choices at the same places."""
MAX_MISFIT: Final = 0.8
"""Misfit of a sound map: 0.6 is usual with smooth walls, 1 and more with a wrong wall or a wrong turn."""
POST_IN: Final = 0.5
"""Half length of the segment that stands for a point."""


class LiveMapper:
    """The map and the pose of a robot that drives.

    Parameters
    ----------
    collector
        The drive, which gets the states.
    noise
        Random errors of the odometry.
    sonar
        Noise and limits of the readings.
    rays
        True if sonars measure along exact rays.
    roughness_in
        Standard deviation of the walls' surfaces from straight lines; None: see `reflection_of` in learn.py.
    """

    def __init__(
        self, collector: DriveCollector, noise: OdometryNoise, sonar: ConeSonar, *, rays: bool,
        roughness_in: float | None,
    ) -> None:
        self._collector, self._noise, self._sonar = collector, noise, sonar
        self._surface_in, self._reflection = reflection_of(sonar, roughness_in)
        self.rays, self._roughness_in = rays, roughness_in
        """True if sonars measure along exact rays."""
        self.estimate: MapEstimate | None = None
        """The last solution of the whole map; None before the first one."""
        self.recent: MapEstimate | None = None
        """The last poses in that map, with the features of their echoes; None where it has all of them."""
        self.rounds = 0
        """Number of those solutions."""
        self._poses, self._groups = np.zeros((0, POSE)), np.zeros(0, dtype=np.intp)
        self._encoders, self._steps = np.zeros(POSE), Steps()
        self._tracked = self._challenged_nodes = 0
        self._judged: MapEstimate | None = None
        # The estimate whose walls were extracted, these, and the map with the openings between them.
        self._extracted: MapEstimate | None = None
        self._pieces: list[Piece] = []
        self._with_openings: MapEstimate | None = None
        self._is_sound = False
        if collector.has_drive:
            self._go_on()

    def _go_on(self) -> None:
        """Learn the map of the drive so far, of a robot that goes on."""
        log = self._collector.log()
        learner = MapLearner(log, self._noise, self._sonar, rays=self.rays, roughness_in=self._roughness_in)
        while not learner.is_complete:
            learner.advance()
        self.estimate = learner.estimate
        self._poses, self._groups = learner.estimate.state.poses, learner.trajectory.group
        self._encoders, self._tracked = learner.trajectory.odometry[-1], len(self._collector) // READINGS_PER_NODE
        self.rounds += 1

    @property
    def poses(self) -> Floats:
        """Poses (n, 3) of the nodes so far, in the frame of the first."""
        return self._poses

    @property
    def is_ready(self) -> bool:
        """True once there is a pose."""
        return len(self._poses) > 0

    def add(self, state: RobotState) -> list[FiringTime]:
        """Take a state into account and return the readings that it shows for the first time."""
        firings = self._collector.add(state)
        groups = len(self._collector) // READINGS_PER_NODE
        if groups > self._tracked:
            self._tracked = groups
            self._track()
        return firings

    def pose(self, encoders: Floats) -> Floats:
        """Return the pose (3,) at encoders (3,) that are later than the last node's."""
        pose = compose(self._poses[-1], relative_pose(self._encoders, encoders))
        pose[HEADING] = wrap_angle(pose[HEADING])
        return pose

    @property
    def pieces(self) -> list[Piece]:
        """The walls of the last solution, with their ends, without their accuracy."""
        self._extract()
        return self._pieces

    def _extract(self) -> MapEstimate | None:
        """Extract the walls of the last solution, unless that was done; return it with the openings between them."""
        if self._extracted is not self.estimate and self.estimate is not None:
            self._pieces = extract_walls(self.estimate, with_accuracy=False)
            self._with_openings = with_openings(self.estimate, self._pieces)
            self._extracted = self.estimate
        return self._with_openings

    @property
    def walls(self) -> Floats:
        """Measured parts (w, 4) of walls, and points as short ones."""
        estimate = self._extract()
        return np.zeros((0, 4)) if estimate is None else walls_and_posts(estimate)

    def walls_facing(self, place: Floats) -> Floats:
        """Return those (n, 4) of `walls` that were measured from the side on which a place (2,) is, and points.

        Others may be the far faces of thick walls.
        """
        estimate = self._extract()
        return np.zeros((0, 4)) if estimate is None else walls_and_posts(estimate, place)

    @property
    def is_sound(self) -> bool:
        """True if the robot may rely on the map to pass a gap: its readings and the odometry do not contradict it."""
        if self._judged is not self.estimate:
            self._judged = self.estimate
            self._is_sound = self.estimate is not None and is_consistent(self.estimate)
        return self._is_sound

    # The pose.

    def _track(self) -> None:
        """Add the last group, and optimize the last poses in the map as it is."""
        # 1. The last nodes. The first of them is fixed.
        first = max(len(self._groups) - LAG_NODES, 0)
        first_group = int(self._groups[first]) if len(self._groups) else 0
        log = self._collector.log(first_group * READINGS_PER_NODE)
        trajectory = build_trajectory(
            log, self._noise, self._sonar, self._surface_in, self._steps, rays=self.rays
        )
        groups = trajectory.group + first_group
        old, old_groups = self._poses[first:], self._groups[first:]
        same = _common(groups, old_groups)
        poses = old[:same] if same else np.zeros((1, POSE))
        # 2. Their poses, in the map without its echoes.
        whole = self.estimate or MapEstimate.start(
            MapProblem(trajectory, len(log.angles_rad), rays=self.rays, reflection=self._reflection)
        )
        window = track(whole, trajectory, poses, self._noise)
        self.recent = window
        self._poses = np.concatenate((self._poses[:first], window.state.poses))
        self._groups = np.concatenate((self._groups[:first], groups))
        self._encoders = trajectory.odometry[-1]

    # The map.

    @property
    def is_due(self) -> bool:
        """True if the whole map should be solved again."""
        mapped = 0 if self.estimate is None else len(self.estimate.state.poses)
        return len(self._poses) >= mapped + max(NODES_PER_ROUND, mapped // NODES_PER_FRACTION)

    def solve(self) -> None:
        """Solve the whole map, from the poses so far."""
        log = self._collector.log()
        trajectory = build_trajectory(
            log, self._noise, self._sonar, self._surface_in, self._steps, rays=self.rays
        )
        problem = MapProblem(trajectory, len(log.angles_rad), rays=self.rays, reflection=self._reflection)
        before = self.estimate or MapEstimate.start(problem)
        # 1. The echoes of the nodes that both have keep their features.
        feature = np.full(len(trajectory.node), NO_FEATURE, dtype=np.intp)
        same = 0
        if self.estimate is not None:
            old = before.problem.trajectory
            same = _common(trajectory.group, old.group)
            kept = int(np.searchsorted(old.node, same))
            feature[:kept] = before.assignment.feature[:kept]
        # 2. From the smoother's poses; if that is poor, also from the odometry with its headings compared anew.
        is_whole = self.rounds % WHOLE_ROUNDS == WHOLE_ROUNDS - 1
        window = max(len(trajectory) - (WHOLE_NODES if is_whole else WINDOW_NODES), 0)
        mapped = len(before.state.poses)
        candidates: list[MapEstimate] = []
        for poses in (self._poses[: _common(trajectory.group, self._groups)], before.state.poses[:same]):
            if candidates and candidates[0].misfit < MAX_MISFIT:
                break
            state = replace(before.state, poses=poses if len(poses) else np.zeros((1, POSE)))
            assignment = Assignment(feature, before.assignment.ties)
            candidate = MapEstimate(problem, state, assignment, before.extents, before.runs, before.sides)
            candidate.extend(len(trajectory))
            if candidates:
                align_heading(candidate, mapped - NODES_PER_ROUND // 2, self._noise)
            candidate.associate(window)
            candidate.optimize(2)
            candidates.append(candidate)
        estimate = min(candidates, key=lambda candidate: candidate.cost)
        # 3. Features.
        update_features(estimate, window)
        estimate = self._challenged(estimate, log)
        self.estimate, self._poses, self._groups = estimate, estimate.state.poses, trajectory.group
        self.recent = None
        self._encoders = trajectory.odometry[-1]
        self.rounds += 1

    def revise(self) -> None:
        """Revise the whole map once as at the end of a drive: points become walls, and false ones go."""
        self.solve()
        assert self.estimate is not None
        revise(self.estimate)
        self._judged = self._extracted = None
        self._poses = self.estimate.state.poses

    def _challenged(self, estimate: MapEstimate, log: DriveLog) -> MapEstimate:
        """Return a map, or one that is learned from the beginning if that is cheaper.

        A wrong wall among the first ones stays, since all that follows is explained by it. It shows in the misfit.
        """
        nodes = len(estimate.state.poses)
        is_poor = estimate.misfit >= MAX_MISFIT
        is_due = is_poor and CHALLENGE_GROWTH * self._challenged_nodes < nodes < MAX_CHALLENGED
        if nodes > ALWAYS_CHALLENGED and not is_due:
            return estimate
        self._challenged_nodes = nodes
        learner = MapLearner(
            log, self._noise, self._sonar, rays=self.rays, roughness_in=self._roughness_in,
            nodes_per_round=CHALLENGE_ROUNDS[self.rounds % len(CHALLENGE_ROUNDS)],
        )  # fmt: skip
        while not learner.is_complete:
            learner.advance()
        return min(estimate, learner.estimate, key=lambda candidate: candidate.cost)


def walls_and_posts(estimate: MapEstimate, place: Floats | None = None) -> Floats:
    """Return the parts (w, 4) of walls without wide gaps, and points as short ones.

    The line of a wall may go on beyond a door, which stays open. A wall of which no part is known is returned whole.
    With a place (2,) only walls that were measured from its side.
    """
    walls, points = estimate.state.walls, estimate.state.points
    of_wall, half = estimate.runs[:, 0].astype(np.intp), np.array((POST_IN, 0.0))
    whole, runs = ~np.isin(np.arange(len(walls)), of_wall), estimate.runs
    if place is not None and len(walls):
        is_facing = sides_of(place[None], walls)[0] * estimate.sides >= 0.0
        of_wall, runs, whole = of_wall[is_facing[of_wall]], runs[is_facing[of_wall]], whole & is_facing
    return np.concatenate((
        segments_of(walls[of_wall], runs[:, 1:]),
        segments_of(walls[whole], estimate.extents[whole]),
        np.concatenate((points - half, points + half), axis=1).reshape(-1, 4),
    ))  # fmt: skip


def with_openings(estimate: MapEstimate, pieces: Sequence[Piece]) -> MapEstimate:
    """Return a map without what was measured of walls between two closed ends that face each other.

    Echoes of the posts of an opening seem to come from the wall beside it, up to 20 in beyond its end: a robot would
    not fit through an opening of 40 in. What was measured beyond the last end of a wall stays: if that end is wrong by
    an inch, the robot would touch the wall.
    """
    parts = list[tuple[float, float, float]]()
    for wall in np.unique(estimate.runs[:, 0]).tolist():
        angle, runs = float(estimate.state.walls[int(wall), 0]), estimate.runs[estimate.runs[:, 0] == wall, 1:].tolist()
        along = np.array((-np.sin(angle), np.cos(angle)))
        own = sorted((piece for piece in pieces if piece.wall == wall), key=lambda piece: piece.low)
        openings = [
            (float(one.ends[1] @ along), float(other.ends[0] @ along))
            for one, other in pairwise(own) if one.closed[1] and other.closed[0]
        ]  # fmt: skip
        kept = [(wall, *part) for first, last in runs for part in _outside(first, last, openings)]
        # A wall without any part would be known all along its line.
        parts += kept or [(wall, first, last) for first, last in runs]
    found = estimate.copy()
    found.runs = np.array(parts, dtype=np.float64).reshape(-1, 3)
    return found


def _outside(first: float, last: float, gaps: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the parts of an interval outside of gaps (low, high), which are in order along it."""
    parts = list[tuple[float, float]]()
    for low, high in gaps:
        if first < min(low, last):
            parts.append((first, min(low, last)))
        first = max(first, high)
    return [*parts, (first, last)] if first < last else parts


def passed(walls: Floats, path: Floats, radius_in: float) -> Floats:
    """Return the parts (n, 4) of walls (w, 4) that are not nearer than a radius to any point (p, 2) of a path."""
    parts = []
    for wall in walls:
        length = max(float(np.hypot(*(wall[2:] - wall[:2]))), 1e-9)
        along = (wall[2:] - wall[:2]) / length
        off = path - wall[:2]
        across = off[:, 0] * along[1] - off[:, 1] * along[0]
        near = np.abs(across) < radius_in
        middle, half = off[near] @ along, np.sqrt(radius_in**2 - across[near] ** 2)
        begin = 0.0
        for low, high in sorted(zip(middle - half, middle + half, strict=True)):
            if high < begin:
                continue
            if low > length:
                break
            if low > begin:
                parts.append((*(wall[:2] + begin * along), *(wall[:2] + low * along)))
            begin = high
        if begin < length:
            parts.append((*(wall[:2] + begin * along), *wall[2:]))
    return np.array(parts).reshape(-1, 4)


def _common(one: Indices, other: Indices) -> int:
    """Return the number of equal values at the start of two arrays."""
    count = min(len(one), len(other))
    differs = one[:count] != other[:count]
    return int(differs.argmax()) if differs.any() else count
