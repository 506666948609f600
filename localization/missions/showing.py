"""What is believed on the way, shown on the page of an nserver (`nomad go|mission --publish URL`).

    helm ──> every period: estimate, verdict, places ──> publishing

Rules: it looks on; way-points that are set at the page are not gone to, for the mission knows its own. A page that
cannot be reached at the beginning is an error, before anything moves.
"""

from __future__ import annotations

from collections.abc import Sequence

from localization.command_line.publishing import Publisher, message
from localization.missions.helm import Sight
from localization.missions.settings import Point
from localization.runs.run import RunMoment
from localization.runs.witness import Witness


class Showing:
    """A watcher of a helm. `goals`: what is shown as way-points, whenever it changes; the truth beside the estimate is
    the witness's."""

    def __init__(self, publisher: Publisher, witness: Witness, goals: Sequence[Point]) -> None:
        self._publisher, self._witness, self._goals = publisher, witness, goals

    def __call__(self, sight: Sight) -> None:
        estimate, state = sight
        odometry = (state.x_in, state.y_in, state.steering_rad)
        moment = RunMoment(estimate, odometry, self._witness.at(estimate.clock_s), 0, state.turret_rad)
        turned = state.turret_rad - state.steering_rad
        self._publisher.tell(message(self._witness.robot_id, moment, turned, self._goals))
