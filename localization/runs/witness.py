"""Where a simulated robot is in truth, at the instants of the estimates that are shown beside it.

Rules: asks the robot once a call; of a real robot nothing is known. No filter ever asks here.
"""

from __future__ import annotations

from localization.runs.run import Sighting
from nclient.robot import Robot


class Witness:
    """Of one robot; `robot_id` is 1 where nobody tells."""

    def __init__(self, robot: Robot, simulated: bool) -> None:
        self._robot = robot
        self._seen: Sighting | None = None
        self.robot_id = 1
        if simulated:
            self.robot_id, self._seen = self._look()

    def at(self, clock_s: float) -> tuple[float, float, float] | None:
        """Truth (x in, y in, heading rad) at an instant since the last call; None of a real robot."""
        if self._seen is None:
            return None
        before, (_, self._seen) = self._seen, self._look()
        return before.towards(self._seen, clock_s)

    def _look(self) -> tuple[int, Sighting]:
        truth = self._robot.truth()
        return truth.robot_id, Sighting(truth.time_s, (truth.x_in, truth.y_in, truth.steering_rad))
