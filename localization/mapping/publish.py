"""Show a map that is being learned on the page of an nserver (`nomad map learn ADDRESS --publish URL`).

    survey ──> MapPublisher ──> POST URL/publish ──> all pages: walls, uncertain ones dashed

A map has its own frame. On the page it lies so that its path fits the true one of a simulated robot best; that of a
real robot begins where the encoders began.
"""

from __future__ import annotations

from collections.abc import Callable
from math import radians
from typing import Any, Final

import numpy as np

from localization.filters.belief import HEADING, POSE, Floats
from localization.live.run import GroundTruth, Publisher
from localization.mapping.association import MapEstimate
from localization.mapping.live import LiveMapper
from localization.mapping.measurements import compose, relative_pose, rigid_fit, rotate
from localization.mapping.survey import SurveyStep
from localization.mapping.walls import MAX_STD_IN, Piece, extract_walls

PERIOD_S: Final = 0.25
"""Real seconds between two messages."""
MAX_STD_RAD: Final = radians(1.0)
"""Of a certain wall: it is within 2 degrees by two standard deviations, and within 1 in by MAX_STD_IN."""
MIN_MEASURED: Final = 0.5
"""Least fraction of a certain wall on which something was measured."""


def is_uncertain(wall: Piece) -> bool:
    """Return True for a wall whose place is uncertain, or that was measured on less than half of its length."""
    is_short = wall.measured_in < MIN_MEASURED * wall.length_in
    return is_short or wall.std_in > MAX_STD_IN or wall.std_rad > MAX_STD_RAD


class MapPublisher:
    """Observer of a drive that shows its map on a page; waypoints set there are ignored.

    Parameters
    ----------
    publisher
        Connection to the page.
    clock
        Monotonic clock in seconds.
    """

    def __init__(self, publisher: Publisher, clock: Callable[[], float]) -> None:
        self._publisher, self._clock = publisher, clock
        self.ground_truth: GroundTruth | None = None
        """Of the robot, set before the drive: it only places the map on the page."""
        self._due_s = -np.inf
        self._rounds = -1
        self._truth: list[tuple[float, float, float]] = []
        self._frame: Floats | None = None
        """Pose (3,) of the map's frame on the page."""
        self._drawn: dict[str, Any] = {"walls": [], "points": []}
        self._last: dict[str, Any] | None = None

    def add(self, step: SurveyStep, mapper: LiveMapper) -> None:
        """Publish the map and the pose of this period, if the last message is old enough."""
        truths = self.ground_truth
        if truths is None or step.pose is None or step.state is None:
            return
        # 1. Where the map's frame is on the page. Every period counts: the path has corners between two messages.
        clock_s = step.state.clock_s or 0.0
        truth = truths.at(clock_s)
        if truth is not None:
            self._truth.append((clock_s, *truth[:2]))
        if self._frame is None:
            state = step.state
            outside = truth or (state.x_in, state.y_in, state.steering_rad)
            self._frame = _frame_at(step.pose, np.array(outside))
        if self._clock() < self._due_s:
            return
        self._due_s = self._clock() + PERIOD_S
        # 2. Walls and points of a new solution.
        if mapper.rounds != self._rounds and mapper.estimate is not None:
            self._rounds = mapper.rounds
            self._draw(mapper.estimate)
        pose = compose(self._frame, step.pose)
        self._send({"robot": truths.robot_id, "elapsed_s": step.elapsed_s, "pose": pose.tolist(), "outcome": ""})

    def finish(self, estimate: MapEstimate, outcome: str) -> None:
        """Publish the final map, and what has become of it."""
        if self._last is not None and self._frame is not None:
            self._draw(estimate)
            pose = compose(self._frame, estimate.state.poses[-1])
            self._send(self._last | {"pose": pose.tolist(), "outcome": outcome})

    def close(self) -> None:
        """Close the connection."""
        self._publisher.close()

    def _draw(self, estimate: MapEstimate) -> None:
        """Bring the walls and points of an estimate into the frame of the page."""
        path = estimate.state.poses[:, :2]
        instants_s = estimate.problem.trajectory.instants_s[: len(path)]
        if len(self._truth) > 1:
            times, *columns = np.array(self._truth).T
            is_timed = (instants_s >= times[0]) & (instants_s <= times[-1])
            if is_timed.sum() > 1:
                targets = np.stack([np.interp(instants_s[is_timed], times, column) for column in columns], -1)
                turn, shift = rigid_fit(path[is_timed], targets)
                self._frame = np.array((*shift, turn))
        frame = np.zeros(POSE) if self._frame is None else self._frame
        walls = extract_walls(estimate)
        self._drawn = {
            "walls": [
                {"ends": _placed(frame, wall.ends).round(2).tolist(), "is_uncertain": is_uncertain(wall)}
                for wall in walls
            ],
            "points": _placed(frame, estimate.state.points).round(2).tolist(),
        }

    def _send(self, message: dict[str, Any]) -> None:
        self._last = message | self._drawn
        self._publisher.publish(self._last)


def _placed(frame: Floats, places: Floats) -> Floats:
    """Return places (n, 2) of a frame at a pose (3,)."""
    return rotate(places, np.full(len(places), frame[HEADING])) + frame[:2]


def _frame_at(inside: Floats, outside: Floats) -> Floats:
    """Return the pose of a frame from the pose of one thing, given inside and outside the frame."""
    return compose(outside, relative_pose(inside, np.zeros(POSE)))
