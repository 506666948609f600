"""A world with its robots, and simulated time that advances in steps. No clock, no socket, no thread.

Commands come between steps. In a step each body moves, stops where it touches something, and measures.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from nclient.errors import StartError
from nserver_emu.simulation import multi_robot
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.multi_robot import Disc, GroupState, MovingBody, RobotGroup, SimulatedWalker, SpatialHash
from nserver_emu.simulation.noise import IDEAL, RngFactory, RobotSetup
from nserver_emu.simulation.robot import RobotState, SimulatedRobot
from nserver_emu.simulation.segments import TIME_MAX_PS, to_ps, to_s
from nserver_emu.simulation.visibility import load_compiled
from worlds.world import StartPose, Walker, World, WorldState


@dataclass(frozen=True, slots=True)
class SimulationState:
    """The state of a simulation in a snapshot. Without walkers, `walkers` is None and left out of the file."""

    seed: int
    time_ps: int
    world: WorldState
    robots: dict[int, RobotState]
    group: GroupState
    walkers: tuple[multi_robot.WalkerState, ...] | None = None


class Simulation:
    """A world and the bodies in it: robots, and walkers (people who walk along routes).

    The same seed and the same commands between the same steps give the same results, and a simulation that is restored
    from its state continues with the same bits.

    A robot goes through these states:

        add_robot   it has a place, which no other may take; its sensors are off
        connected   sensors of all robots detect it, and its own detect them. Done for all new robots at once, before
                    the first of them measures and before the next step
        power_on    its sensors measure

    What bodies know of one another is stored in three places, besides the bodies themselves:

        _group          where sensors find the others: set where bodies come, go or are placed (`_set_positions`), and
                        advanced by `step`
        obstacles       what a body touches, stored in each body: set where it is placed (`_set_obstacles`), and by the
                        group in each span of a step
        _spatial_hash   where there is room for a start: built when it is needed, dropped when a robot may have moved

    Attributes
    ----------
    robots
        Robots by number, in ascending order.
    seed
        0 or more.
    time_ps
        Simulated time since the beginning.
    walkers
        In the order of `World.walkers`.
    """

    def __init__(self, world: World, seed: int = 0, time_ps: int = 0) -> None:
        self.seed = seed
        self.robots: dict[int, SimulatedRobot] = {}
        self.world = world
        self.time_ps = time_ps
        # Empty while there is only one body.
        self._group = RobotGroup()
        self.walkers = [SimulatedWalker(walker, world.walls, time_ps) for walker in world.walkers]
        self._spatial_hash: SpatialHash | None = None
        # True if robots were added that are not connected yet.
        self._has_new_robots = False

    def to_state(self) -> SimulationState:
        """Return the world and all that changes in it."""
        # A snapshot has no form for a robot that is not connected.
        self._connect_new_robots()
        robots = {number: robot.to_state() for number, robot in self.robots.items()}
        walkers = tuple(walker.to_state() for walker in self.walkers) or None
        group = self._group.to_state()
        return SimulationState(self.seed, self.time_ps, WorldState.of(self.world), robots, group, walkers)

    @classmethod
    def from_state(cls, state: SimulationState) -> Simulation:
        """Return the simulation that continues from a state; raise ValueError if a value in it is impossible."""
        # 1. Check what the parts below do not check themselves.
        if not 0 <= state.time_ps < TIME_MAX_PS or state.seed < 0:
            raise ValueError(f"time_ps {state.time_ps} or seed {state.seed} is out of range")
        if list(state.robots) != sorted(state.robots):
            raise ValueError(f"robots are not in the order of their numbers: {list(state.robots)}")
        # 2. World and robots.
        simulation = cls(state.world.world(), state.seed, state.time_ps)
        walls = simulation.world.walls
        simulation.robots = {
            number: SimulatedRobot.from_state(robot, RngFactory(number, state.seed), walls, state.time_ps)
            for number, robot in state.robots.items()
        }
        states, walkers = state.walkers or (), simulation.walkers
        if len(states) != len(walkers):
            raise ValueError(f"{len(states)} states of walkers for the {len(walkers)} walkers of the world")
        for walker, walker_state in zip(walkers, states, strict=True):
            walker.set_state(walker_state)
        # 3. Connect the bodies; with many robots it pays to compile the ray caster.
        load_compiled(len(simulation.robots))
        simulation._group.set_state(state.group, simulation.bodies)
        return simulation

    @property
    def bodies(self) -> list[MovingBody]:
        """All that moves and can be touched: the robots, then the walkers."""
        return [*self.robots.values(), *self.walkers]

    @property
    def time_s(self) -> float:
        """Simulated time since the beginning."""
        return to_s(self.time_ps)

    def add_robot(self, robot_id: int, start: StartPose | None = None, model: RobotModel = N150,
                  setup: RobotSetup = IDEAL, *, powered: bool = True) -> SimulatedRobot:
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
        pose = self.world.starts[0] if start is None else start
        self.require_free(pose.x_in, pose.y_in, model.body.radius_in)
        # 2. The robot, without power: its sensors must not measure before it is connected.
        rng_factory = RngFactory(robot_id, self.seed)
        robot = SimulatedRobot(rng_factory, pose, self.world.walls, model, setup, self.time_ps, powered=False)
        # 3. Robots stay in the order of their numbers, which is that of their rows in `RobotGroup`.
        is_in_order = not self.robots or robot_id > next(reversed(self.robots))
        self.robots[robot_id] = robot
        if not is_in_order:
            self.robots = dict(sorted(self.robots.items()))
        if self._spatial_hash is not None:  # not dropped: a thousand robots are added one after another
            self._spatial_hash.add(robot_id, robot.disc)
        self._has_new_robots = True
        # 4. Power.
        if powered:
            self._connect_new_robots()
            robot.power_on()
        return robot

    def power_on(self) -> None:
        """Switch on all robots that are off, at one instant: each detects all others, whatever their order."""
        self._connect_new_robots()
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

    def _connect_new_robots(self) -> None:
        """Let new robots and all other bodies detect one another."""
        if self._has_new_robots:
            load_compiled(len(self.robots))  # with many robots it pays to compile the ray caster
            self._set_positions()
        self._has_new_robots = False

    def _set_positions(self) -> None:
        """Let sensors find all bodies where they are now, if there are several."""
        if len(bodies := self.bodies) > 1:
            self._group.set_bodies(bodies, self.time_ps)

    def _set_obstacles(self) -> None:
        """Let bodies touch one another where they are now, if there are several."""
        if len(bodies := self.bodies) > 1:
            multi_robot.update_obstacles(bodies)

    def require_free(self, x_in: float, y_in: float, radius_in: float, robot_id: int | None = None) -> None:
        """Raise StartError where a robot of this radius touches anything; the message says what.

        Parameters
        ----------
        robot_id
            Number of the robot, if it is in the world already.
        """
        self.world.require_free(x_in, y_in, radius_in)
        for number, (x, y, radius) in self.spatial_hash.touched(x_in, y_in, radius_in):
            if number != robot_id:
                raise StartError(f"the start ({x_in:g}, {y_in:g}) in touches robot {number}, which stands at ({x:.1f}, "
                                 f"{y:.1f}) in; {radius_in + radius:g} in from there there is room")
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
        self._set_positions()
        self._set_obstacles()

    def change_world(self, world: World) -> None:
        """Replace the world now; earlier readings do not change. Walkers that the new world has as well walk on."""
        # 1. Walls.
        self.world = world
        for robot in self.robots.values():
            robot.set_walls(world.walls)
        # 2. Walkers: those that stay, and new ones at the beginning of their routes.
        before = self.walkers
        self.walkers = [self._continued(walker) for walker in world.walkers]
        for walker in self.walkers:
            walker.set_walls(world.walls)
        # 3. If there are other walkers now, their positions.
        if self.walkers != before:
            if len(self.bodies) > 1:
                self._set_positions()
            else:
                # The one robot that is left, if any, is without other bodies.
                self._group = RobotGroup()
                for robot in self.robots.values():
                    robot.stand_alone()
        self._set_obstacles()

    def _continued(self, walker: Walker) -> SimulatedWalker:
        """Return the body of a walker that goes on, or that of a new one, which starts now."""
        before = next((body for body in self.walkers if body.walker is walker), None)
        return before or SimulatedWalker(walker, self.world.walls, self.time_ps)

    def step(self, dt_s: float) -> None:
        """Advance by dt_s >= 0 seconds; raise ValueError for other numbers.

        Without noise, results do not depend on the size of the steps, with one exception: where two moving robots meet,
        by the distance that they drive in a tick of 10 ms (multi_robot.py). With noise, other numbers are drawn.
        """
        begin_ps, self.time_ps = self.time_ps, self.time_ps + to_ps(dt_s)
        self._spatial_hash = None
        self._connect_new_robots()
        # 1. Several bodies advance together, so that they can stop at one another; a walker
        #    does so even when it is alone, which bounds the recording of its path.
        bodies = self.bodies
        if len(bodies) > 1 or self.walkers:
            self._group.advance(bodies, begin_ps, self.time_ps)
        # 2. A single robot; all others are at the end of the step already.
        for body in bodies:
            body.advance_to(self.time_ps)
