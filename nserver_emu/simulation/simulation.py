"""A world with its robots, and time that moves when it is told to. No clock, no socket, no thread.

Order of a step: commands (between steps), motion, contact, sensors. All state is plain: a pickled or deep-copied
simulation goes on bit for bit.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from nclient.errors import StartError
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.multi_robot import Company, touch
from nserver_emu.simulation.noise import IDEAL, Identity, RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import to_ps, to_s
from nserver_emu.simulation.spatial_hash import Standing
from worlds.raycast import load_compiled
from worlds.world import StartPose, World


class Simulation:
    """`robots` by their ids, in that order. `seed` >= 0: the same seed and the same commands between the same steps
    give the same results."""

    def __init__(self, world: World, seed: int = 0) -> None:
        self.seed = seed
        self.robots: dict[int, SimulatedRobot] = {}
        self._world = world
        self._time_ps = 0
        self._company = Company()
        self._standing: Standing | None = None
        self._strangers = False

    @property
    def world(self) -> World:
        """The ground they all drive on."""
        return self._world

    @property
    def time_s(self) -> float:
        """Simulated time since the beginning."""
        return to_s(self._time_ps)

    def add_robot(
        self,
        robot_id: int,
        start: StartPose | None = None,
        model: RobotModel = N150,
        setup: RobotSetup = IDEAL,
        *,
        awake: bool = True,
    ) -> SimulatedRobot:
        """Put a robot into the world, at its first start if none is given; not `awake` it looks around from `wake` on.

        Raises StartError where it does not fit beside walls and other robots, ValueError if the id is taken.
        """
        if robot_id in self.robots:
            raise ValueError(f"robot {robot_id} is here already")
        place = self._world.starts[0] if start is None else start
        self.require_free(place.x_in, place.y_in, model.body.radius_in)
        identity = Identity(robot_id, self.seed)
        robot = SimulatedRobot(identity, place, self._world.walls, model, setup, self._time_ps, awake=False)
        in_order = not self.robots or robot_id > next(reversed(self.robots))
        self.robots[robot_id] = robot
        if not in_order:
            self.robots = dict(sorted(self.robots.items()))
        self.standing.add(robot_id, robot.disc)
        self._strangers = True
        if awake:
            self._meet()
            robot.wake()
        return robot

    def wake(self) -> None:
        """Power on all robots that came asleep, at the same instant: each sees all others, whoever came first."""
        self._meet()
        for robot in self.robots.values():
            if not robot.awake:
                robot.wake()

    @property
    def standing(self) -> Standing:
        """Where the robots stand; kept until time passes or one is set down elsewhere."""
        if self._standing is None:
            self._standing = Standing()
            for number, robot in self.robots.items():
                self._standing.add(number, robot.disc)
        return self._standing

    def _meet(self) -> None:
        """Let those who came since the last time see the others, and be seen."""
        if self._strangers:
            load_compiled(len(self.robots))
            if len(self.robots) > 1:
                self._company.look_around(self.robots, self._time_ps)
        self._strangers = False

    def require_free(self, x_in: float, y_in: float, radius_in: float, robot_id: int | None = None) -> None:
        """Refuse a place where a robot of this radius, number `robot_id` if it is here already, touches anything.

        Raises StartError, which says what is in the way.
        """
        self._world.require_free(x_in, y_in, radius_in)
        for number, (x, y, radius) in self.standing.touched(x_in, y_in, radius_in):
            if number != robot_id:
                raise StartError(
                    f"the start ({x_in:g}, {y_in:g}) in touches robot {number}, which stands at ({x:.1f}, {y:.1f}) in; "
                    f"{radius_in + radius:g} in from there there is room"
                )

    def place(self, robot_id: int, x_in: float, y_in: float, steering_rad: float, turret_rad: float) -> None:
        """Set a robot down somewhere, as `SimulatedRobot.place` does; the others see and feel it there at once."""
        self.robots[robot_id].place(x_in, y_in, steering_rad, turret_rad)
        self._standing = None
        if len(self.robots) > 1:
            self._company.look_around(self.robots, self._time_ps)
            touch(list(self.robots.values()))

    def change_world(self, world: World) -> None:
        """Change what stands here, now; what was seen before was seen before."""
        self._world = world
        for robot in self.robots.values():
            robot.enter(world.walls)
        if len(self.robots) > 1:
            touch(list(self.robots.values()))

    def step(self, dt_s: float) -> None:
        """Let dt_s >= 0 seconds pass; raises ValueError for other numbers. How time is cut changes no result
        without noise (with it another draw of the same spread), but for
        where robots meet that both move: there by what they drive within a tick."""
        begin_ps, self._time_ps = self._time_ps, self._time_ps + to_ps(dt_s)
        self._standing = None
        self._meet()
        if len(self.robots) > 1:
            self._company.run(self.robots, begin_ps, self._time_ps)
        for robot in self.robots.values():
            robot.advance_to(self._time_ps)

    def __getstate__(self) -> dict[str, Any]:
        """The world as what it is built from: its read-only views can neither be pickled nor copied."""
        built_from = {part.name: getattr(self._world, part.name) for part in fields(World) if part.init}
        return self.__dict__ | {"_world": built_from | {"paths": dict(self._world.paths)}, "_standing": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_world": World(**state["_world"])})
