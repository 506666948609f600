"""get_robot_conf: who waits for a pose to be clicked in the window of a robot, and the pose once it is. Pure.

Rules: one click answers all who wait at that robot then. While no page is open that may click, nobody waits: they
are told where the robot is. Who asked and is gone is forgotten.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from nserver_emu.server.conversation.session import Visit

ClickedPose = tuple[int, int, int, int]
"""x, y, steering and turret in tenths."""


@dataclass(eq=False, slots=True)
class Wish:
    """One who waits."""

    robot_id: int
    visit: Visit
    pose: ClickedPose | None = None


class Clicks:
    """See the head of this file. `open`: whether a page is there to click at."""

    def __init__(self) -> None:
        self.open = False
        self._wishes: list[Wish] = []

    def ask(
        self, robot_id: int, visit: Visit, otherwise: Callable[[], ClickedPose]
    ) -> Callable[[], ClickedPose | None]:
        """Wait for a pose of this robot: what to ask again until it gives one. `otherwise`: without a page."""
        wish = Wish(robot_id, visit)
        self._wishes.append(wish)

        def clicked() -> ClickedPose | None:
            if wish.pose is None and not self.open:
                self._wishes = [other for other in self._wishes if other is not wish]
                wish.pose = otherwise()
            return wish.pose

        return clicked

    def asked(self) -> dict[int, int]:
        """How many wait, at each robot where somebody does."""
        counts: dict[int, int] = {}
        for wish in self._wishes:
            counts[wish.robot_id] = counts.get(wish.robot_id, 0) + 1
        return counts

    def answer(self, robot_id: int, pose: ClickedPose) -> bool:
        """A pose was clicked; whether anybody waited for it."""
        waiting = [wish for wish in self._wishes if wish.robot_id == robot_id]
        for wish in waiting:
            wish.pose = pose
        self._wishes = [wish for wish in self._wishes if wish.pose is None]
        return bool(waiting)

    def forget(self, visit: Visit) -> None:
        """This connection is gone."""
        self._wishes = [wish for wish in self._wishes if wish.visit is not visit]
