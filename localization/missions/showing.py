"""What is believed on the way, shown on the page of an nserver (`nomad go|mission --publish URL`).

    helm ──> every period: estimate, verdict, places ──> publishing

Rules: it looks on; way-points that are set at the page are not gone to, for the mission knows its own. A page that
cannot be reached at the beginning is an error, before anything moves.
"""

from __future__ import annotations

from collections.abc import Sequence

from localization.cli import sighting
from localization.missions.helm import Sight
from localization.missions.settings import Point
from localization.publishing import Publisher, message
from localization.run import Moment
from nclient.robot import Robot


class Showing:
    """A watcher of a helm. `goals`: what is shown as way-points, whenever it changes; `simulated`: it is asked for the
    truth, to be shown beside the estimate."""

    def __init__(self, publisher: Publisher, robot: Robot, simulated: bool, goals: Sequence[Point]) -> None:
        self._publisher, self._robot, self._goals = publisher, robot, goals
        self._seen = sighting(robot) if simulated else None
        self._number = robot.truth().robot_id if simulated else 1

    def __call__(self, sight: Sight) -> None:
        estimate, state = sight
        truth = None
        if self._seen:
            before, self._seen = self._seen, sighting(self._robot)
            truth = before.towards(self._seen, estimate.clock_s)
        moment = Moment(estimate, (state.x_in, state.y_in, state.steering_rad), truth, 0, state.turret_rad)
        self._publisher.tell(message(self._number, moment, state.turret_rad - state.steering_rad, self._goals))
