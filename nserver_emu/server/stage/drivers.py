"""Who drives which axis of which robot, so that an axis stops when the one who set it going leaves.

Rules: a driver counts as long as the axis still moves by his command; who comes later takes the axis over. Nobody's
leaving touches what others have set going. Connections are told apart by what they are, not by number.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from nserver_emu.server.conversation.session import Visit
from nserver_emu.simulation.axis import Command
from nserver_emu.simulation.robot import SimulatedRobot

ALL_AXES: Final = (0, 1, 2)


class Drivers:
    """See the head of this file."""

    def __init__(self) -> None:
        self._drivers: dict[int, list[Visit | None]] = {}
        self._of_arm: dict[int, Visit] = {}
        self._orphans: set[int] = set()

    def take(self, visit: Visit, robot_id: int, axes: Iterable[int]) -> None:
        """These axes of a robot obey this connection from now on."""
        drivers = self._drivers.setdefault(robot_id, [None] * len(ALL_AXES))
        for axis in axes:
            drivers[axis] = visit

    def take_arm(self, visit: Visit, robot_id: int) -> None:
        """The arm of a robot obeys this connection from now on."""
        self._of_arm[robot_id] = visit

    def leave_arms(self, visit: Visit) -> list[int]:
        """This connection is gone: the robots whose arms obeyed it."""
        robot_ids = [robot_id for robot_id, driver in self._of_arm.items() if driver is visit]
        for robot_id in robot_ids:
            del self._of_arm[robot_id]
        return robot_ids

    def orphan(self, robot_ids: Iterable[int]) -> None:
        """These robots come from elsewhere, and whoever set them going is not here: nobody drives them."""
        self._drivers.clear()
        self._of_arm.clear()
        self._orphans = set(robot_ids)

    def adopt(self, visit: Visit, robot_id: int, robot: SimulatedRobot) -> None:
        """The first to connect to such a robot answers for what still moves on its own."""
        if robot_id not in self._orphans:
            return
        self._orphans.discard(robot_id)
        self._of_arm.setdefault(robot_id, visit)
        drivers = self._drivers.get(robot_id, [None] * len(ALL_AXES))
        self.take(visit, robot_id, [axis for axis in ALL_AXES if robot.moving[axis] and drivers[axis] is None])

    def may_feed(self, visit: Visit, robot_id: int, robot: SimulatedRobot) -> bool:
        """Whether the time-out of a robot begins anew at what this connection asks: it drives it, or nobody does."""
        drivers = self._drivers.get(robot_id, ())
        driving = [driver for driver, moves in zip(drivers, robot.moving, strict=False) if moves and driver is not None]
        if robot_id in self._of_arm:
            driving.append(self._of_arm[robot_id])
        return not driving or any(driver is visit for driver in driving)

    def leave(self, visit: Visit, robots: Mapping[int, SimulatedRobot]) -> None:
        """This connection is gone: what still moves because of it brakes and holds."""
        for robot_id, drivers in self._drivers.items():
            robot = robots[robot_id]
            for axis in (axis for axis in ALL_AXES if drivers[axis] is visit):
                drivers[axis] = None
                if robot.moving[axis]:
                    robot.command_axis(axis, Command.VELOCITY, 0.0)
