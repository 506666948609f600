"""A world with its robots, and simulated time that advances in steps. No clock, no socket, no thread.

Order of a step: commands (between steps), motion, contact, sensors. A simulation that is restored from its state
continues with the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np

from nclient.errors import StartError
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.multi_robot import GroupState, MovingBody, RobotGroup, update_obstacles
from nserver_emu.simulation.noise import IDEAL, RngFactory, RobotSetup
from nserver_emu.simulation.robot import RobotState, SimulatedRobot
from nserver_emu.simulation.segments import TIME_MAX_PS, to_ps, to_s
from nserver_emu.simulation.spatial_hash import Disc, SpatialHash
from nserver_emu.simulation.walkers import SimulatedWalker, WalkerState
from worlds.raycast import load_compiled
from worlds.schema import MAX_COORDINATE_IN
from worlds.world import (
    MAX_CORNERS,
    MAX_DOORS,
    MAX_ROUTE_POINTS,
    MAX_STARTS,
    MAX_WALKERS,
    Door,
    Path,
    Polygon,
    StartPose,
    Walker,
    WallAccuracy,
    World,
)

MAX_OUTLINE_CORNERS: Final = 1_000_000
"""Corners of rooms and obstacles in a restored world; clients may add more obstacles than a file may have."""


@dataclass(frozen=True, slots=True)
class WorldState:
    """The values that a world is built from."""

    name: str
    title: str
    rooms: tuple[Polygon, ...]
    inner_walls: tuple[tuple[float, float, float, float], ...]
    obstacles: tuple[Polygon, ...]
    starts: tuple[StartPose, ...]
    paths: tuple[Path, ...]
    doors: tuple[Door, ...] | None = None
    walkers: tuple[Walker, ...] | None = None
    accuracies: dict[int, WallAccuracy] | None = None
    wall_names: dict[int, str] | None = None

    @classmethod
    def of(cls, world: World) -> WorldState:
        """Return the state of a world."""
        # Rooms and obstacles are stored as outlines; only inner walls are segments.
        inner_walls = tuple((x1, y1, x2, y2) for x1, y1, x2, y2 in world.inner_walls.tolist())
        return cls(
            world.name, world.title, world.rooms, inner_walls, world.obstacles, world.starts,
            tuple(world.paths.values()), world.doors or None, world.walkers or None, dict(world.accuracies) or None,
            dict(world.wall_names) or None,
        )  # fmt: skip

    def world(self) -> World:
        """Return the world; raise ValueError if there can be none."""
        self._check_size()
        doors, walkers, accuracies = self.doors or (), self.walkers or (), self.accuracies or {}
        if not all(len(walker.points_in) > 1 and walker.speed_in_s > 0.0 < walker.radius_in for walker in walkers):
            raise ValueError("a walker that cannot walk")
        if not all(0 <= row < len(self.inner_walls) and min(each) >= 0.0 for row, each in accuracies.items()):
            raise ValueError("the accuracy of a wall that does not exist, or below 0")
        names = self.wall_names or {}
        if not all(0 <= row < len(self.inner_walls) for row in names):
            raise ValueError("the name of a wall that does not exist")
        outlines = [corner for outline in (*self.rooms, *self.obstacles) for corner in outline.corners_in]
        routes = [point for walker in walkers for point in walker.points_in]
        places = (*outlines, *self.inner_walls, *routes, *(end for door in doors for end in door.ends_in))
        if not all(abs(number) <= MAX_COORDINATE_IN for place in places for number in place):
            raise ValueError(f"a world with coordinates beyond {MAX_COORDINATE_IN:g} in")
        return World(
            self.name, self.title, self.rooms, np.array(self.inner_walls).reshape(-1, 4), self.obstacles, self.starts,
            {path.name: path for path in self.paths}, accuracies=accuracies, doors=doors, walkers=walkers,
            wall_names=names,
        )  # fmt: skip

    def _check_size(self) -> None:
        """Raise ValueError if there is too little or too much of something."""
        outlines = (*self.rooms, *self.obstacles)
        if not self.starts or not all(len(outline.corners_in) > 2 for outline in outlines):
            raise ValueError("a world without starts or outlines")
        corners = sum(len(outline.corners_in) for outline in outlines)
        fixed = len(self.inner_walls) + sum(len(room.corners_in) for room in self.rooms)
        if fixed > 2 * MAX_CORNERS or corners > MAX_OUTLINE_CORNERS or len(self.starts) > MAX_STARTS:
            raise ValueError("a world that is too large")
        walkers = self.walkers or ()
        route_points = sum(len(walker.points_in) for walker in walkers)
        if (
            len(self.doors or ()) > MAX_DOORS
            or len(walkers) > MAX_WALKERS
            or route_points > MAX_WALKERS * MAX_ROUTE_POINTS
        ):
            raise ValueError("a world with too many doors or walkers")


@dataclass(frozen=True, slots=True)
class SimulationState:
    """The state of a simulation in a snapshot."""

    seed: int
    time_ps: int
    world: WorldState
    robots: dict[int, RobotState]
    group: GroupState
    walkers: tuple[WalkerState, ...] | None = None


class Simulation:
    """A world and its robots.

    The same seed and the same commands between the same steps give the same results.

    Attributes
    ----------
    robots
        By their numbers, sorted.
    seed
        0 or more.
    time_ps
        Simulated time since the beginning.
    walkers
        Those of the world, in its order.
    """

    def __init__(self, world: World, seed: int = 0) -> None:
        self.seed = seed
        self.robots: dict[int, SimulatedRobot] = {}
        self._world = world
        self.time_ps = 0
        self._group = RobotGroup()
        self.walkers = [SimulatedWalker(walker, world.walls) for walker in world.walkers]
        self._spatial_hash: SpatialHash | None = None
        self._has_new_robots = False

    def to_state(self) -> SimulationState:
        """Return all that changes, and the world."""
        # New robots join the others first: their state has no form of its own.
        self._join_new_robots()
        robots = {number: robot.to_state() for number, robot in self.robots.items()}
        walkers = tuple(walker.to_state() for walker in self.walkers) or None
        group = self._group.to_state()
        return SimulationState(self.seed, self.time_ps, WorldState.of(self._world), robots, group, walkers)

    @classmethod
    def from_state(cls, state: SimulationState) -> Simulation:
        """Return the simulation of a state; raise ValueError if there can be none."""
        # 1. Values that no simulation has.
        if not 0 <= state.time_ps < TIME_MAX_PS or state.seed < 0:
            raise ValueError(f"time_ps {state.time_ps} or seed {state.seed} is out of range")
        if list(state.robots) != sorted(state.robots):
            raise ValueError(f"robots are not in the order of their numbers: {list(state.robots)}")
        # 2. World and robots.
        simulation = cls(state.world.world(), state.seed)
        simulation.time_ps = state.time_ps
        walls = simulation.world.walls
        simulation.robots = {
            number: SimulatedRobot.from_state(robot, RngFactory(number, state.seed), walls, state.time_ps)
            for number, robot in state.robots.items()
        }
        if len(state.walkers or ()) != len(simulation.walkers):
            raise ValueError("the state of other walkers")
        simulation.walkers = [SimulatedWalker(each.walker, walls, state.time_ps) for each in simulation.walkers]
        for walker, walker_state in zip(simulation.walkers, state.walkers or (), strict=True):
            walker.set_state(walker_state)
        # 3. The compiled ray caster, if there are enough robots for it; positions for one another's sensors.
        load_compiled(len(simulation.robots))
        simulation._group.set_state(state.group, simulation.bodies)
        return simulation

    @property
    def bodies(self) -> list[MovingBody]:
        """The robots, then the walkers: what moves and can be touched."""
        return [*self.robots.values(), *self.walkers]

    @property
    def world(self) -> World:
        """The world of all robots."""
        return self._world

    @property
    def time_s(self) -> float:
        """Simulated time since the beginning."""
        return to_s(self.time_ps)

    def add_robot(
        self,
        robot_id: int,
        start: StartPose | None = None,
        model: RobotModel = N150,
        setup: RobotSetup = IDEAL,
        *,
        powered: bool = True,
    ) -> SimulatedRobot:
        """Put a robot into the world.

        Parameters
        ----------
        start
            None: the first start of the world.
        powered
            False: its sensors start at `power_on`.

        Raises
        ------
        StartError
            If it does not fit beside walls and other robots.
        ValueError
            If the number is taken.
        """
        if robot_id in self.robots:
            raise ValueError(f"robot {robot_id} is here already")
        # 1. The position must be free.
        pose = self._world.starts[0] if start is None else start
        self.require_free(pose.x_in, pose.y_in, model.body.radius_in)
        # 2. The robot, without power: its sensors must not measure before it is known to the others.
        rng_factory = RngFactory(robot_id, self.seed)
        robot = SimulatedRobot(rng_factory, pose, self._world.walls, model, setup, self.time_ps, powered=False)
        # 3. Robots stay sorted by number, which is the order of their rows.
        is_in_order = not self.robots or robot_id > next(reversed(self.robots))
        self.robots[robot_id] = robot
        if not is_in_order:
            self.robots = dict(sorted(self.robots.items()))
        self.spatial_hash.add(robot_id, robot.disc)
        self._has_new_robots = True
        # 4. Power.
        if powered:
            self._join_new_robots()
            robot.power_on()
        return robot

    def power_on(self) -> None:
        """Switch on all robots that are off, at one instant: each detects all others, whatever their order."""
        self._join_new_robots()
        for robot in self.robots.values():
            if not robot.powered:
                robot.power_on()

    @property
    def spatial_hash(self) -> SpatialHash:
        """The positions of the robots; cached until time advances or a robot is placed elsewhere."""
        if self._spatial_hash is None:
            self._spatial_hash = SpatialHash()
            for number, robot in self.robots.items():
                self._spatial_hash.add(number, robot.disc)
        return self._spatial_hash

    def _join_new_robots(self) -> None:
        """Make robots that were added visible to the others, and the others to them."""
        if self._has_new_robots:
            load_compiled(len(self.robots))
            if len(bodies := self.bodies) > 1:
                self._group.set_robots(bodies, self.time_ps)
        self._has_new_robots = False

    def require_free(self, x_in: float, y_in: float, radius_in: float, robot_id: int | None = None) -> None:
        """Raise StartError where a robot of this radius touches anything; the message says what.

        Parameters
        ----------
        robot_id
            Number of the robot, if it is in the world already.
        """
        self._world.require_free(x_in, y_in, radius_in)
        for number, (x, y, radius) in self.spatial_hash.touched(x_in, y_in, radius_in):
            if number != robot_id:
                raise StartError(
                    f"the start ({x_in:g}, {y_in:g}) in touches robot {number}, which stands at ({x:.1f}, {y:.1f}) in; "
                    f"{radius_in + radius:g} in from there there is room"
                )
        if walker := self.touched_walker(x_in, y_in, radius_in):
            x, y, _ = walker
            raise StartError(f"the start ({x_in:g}, {y_in:g}) in touches a walker, who is at ({x:.1f}, {y:.1f}) in")

    def touched_walker(self, x_in: float, y_in: float, radius_in: float) -> Disc | None:
        """Return the first walker that a disc touches, None if it touches none."""
        for walker in self.walkers:
            x, y, radius = walker.disc
            if hypot(x - x_in, y - y_in) <= radius + radius_in:
                return x, y, radius
        return None

    def place(self, robot_id: int, x_in: float, y_in: float, steering_rad: float, turret_rad: float) -> None:
        """Set a robot down at a pose, as `SimulatedRobot.place` does; the others detect it there at once."""
        self.robots[robot_id].place(x_in, y_in, steering_rad, turret_rad)
        self._spatial_hash = None
        self._update_group()

    def _update_group(self) -> None:
        """Make the present positions those that sensors and bumpers detect."""
        if len(bodies := self.bodies) > 1:
            self._group.set_robots(bodies, self.time_ps)
            update_obstacles(bodies)

    def change_world(self, world: World) -> None:
        """Replace the world now; earlier readings do not change. Walkers that it has as well walk on."""
        self._world = world
        for robot in self.robots.values():
            robot.set_walls(world.walls)
        before = self.walkers
        if before or world.walkers:
            here = {id(each.walker): each for each in before}
            self.walkers = [
                here.get(id(walker)) or SimulatedWalker(walker, world.walls, self.time_ps) for walker in world.walkers
            ]
            for walker in self.walkers:
                walker.set_walls(world.walls)
        if self.walkers != before:
            if len(self.bodies) > 1:
                self._update_group()
            else:
                # A snapshot has positions of several bodies, or none.
                self._group = RobotGroup()
                for robot in self.robots.values():
                    robot.stand_alone()
        elif len(self.bodies) > 1:
            update_obstacles(self.bodies)

    def step(self, dt_s: float) -> None:
        """Advance by dt_s >= 0 seconds; raise ValueError for other numbers.

        Without noise the size of the steps changes no result (with it, only which numbers are drawn), except where two
        moving robots meet: there by the distance driven within a tick.
        """
        begin_ps, self.time_ps = self.time_ps, self.time_ps + to_ps(dt_s)
        self._spatial_hash = None
        self._join_new_robots()
        # Several bodies advance together, so that they can stop at one another; a walker also when alone, so that its
        # path is recorded for one span at a time.
        bodies = self.bodies
        if len(bodies) > 1 or self.walkers:
            self._group.advance(bodies, begin_ps, self.time_ps)
        for body in bodies:
            body.advance_to(self.time_ps)
