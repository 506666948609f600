"""A world with its robots, and time that moves when it is told to. No clock, no socket, no thread.

Order of a step: commands (between steps), motion, contact, sensors. All state is plain: a pickled or deep-copied
simulation goes on bit for bit.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from nserver_emu.simulation.instants import to_ps, to_s
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.noise import Identity
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.setup import IDEAL, RobotSetup
from worlds.world import StartPose, World


class Simulation:
    """`robots` by their ids. `seed` >= 0: the same seed and the same commands between the same steps give the same
    results."""

    def __init__(self, world: World, seed: int = 0) -> None:
        self.seed = seed
        self.robots: dict[int, SimulatedRobot] = {}
        self._world = world
        self._time_ps = 0

    @property
    def world(self) -> World:
        """The ground they all drive on."""
        return self._world

    @property
    def time_s(self) -> float:
        """Simulated time since the beginning."""
        return to_s(self._time_ps)

    def add_robot(
        self, robot_id: int, start: StartPose | None = None, model: RobotModel = N150, setup: RobotSetup = IDEAL
    ) -> SimulatedRobot:
        """Put a robot into the world, at its first start if none is given.

        Raises StartError where it does not fit, ValueError if the id is taken.
        """
        if robot_id in self.robots:
            raise ValueError(f"robot {robot_id} is here already")
        place = self._world.starts[0] if start is None else start
        self._world.require_free(place.x_in, place.y_in, model.body.radius_in)
        identity = Identity(robot_id, self.seed)
        robot = SimulatedRobot(identity, place, self._world.walls, model, setup, self._time_ps)
        self.robots[robot_id] = robot
        return robot

    def change_world(self, world: World) -> None:
        """Change what stands here, now; what was seen before was seen before."""
        self._world = world
        for robot in self.robots.values():
            robot.enter(world.walls)

    def step(self, dt_s: float) -> None:
        """Let dt_s >= 0 seconds pass; raises ValueError for other numbers. How time is cut changes no result."""
        self._time_ps += to_ps(dt_s)
        for robot in self.robots.values():
            robot.advance_to(self._time_ps)

    def __getstate__(self) -> dict[str, Any]:
        """The world as what it is built from: its read-only views can neither be pickled nor copied."""
        built_from = {part.name: getattr(self._world, part.name) for part in fields(World) if part.init}
        return self.__dict__ | {"_world": built_from | {"paths": dict(self._world.paths)}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_world": World(**state["_world"])})
