"""Robots that an environment drives, by the same five calls: a batch, robots of one simulation, a connected robot.

Inches, radians and seconds; arrays have one row per robot.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from math import pi
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from nclient import connect
from nclient.errors import BumperHit, ConnectionLost, StartError
from nserver_emu.simulation.batch import BatchSimulation
from nserver_emu.simulation.models import RobotModel
from nserver_emu.simulation.noise import RobotSetup
from nserver_emu.simulation.simulation import Simulation
from worlds.geometry import FloatArray
from worlds.robots import BODIES
from worlds.world import StartPose, World

BoolArray = npt.NDArray[np.bool_]

TIMEOUT_S: Final = 1.0
"""A connected robot stops if no command arrives for so long."""
MIN_WAIT_S: Final = 0.001
MAX_TURRET_RAD: Final = pi / 16
"""Half the angle between two sonars: a turret turned by more against the steering has other sonars ahead."""


class Sensed(NamedTuple):
    """Measurements and poses of n robots.

    Attributes
    ----------
    time_s
        Time of each robot's clock since it was reset (n,).
    encoder, actual
        Poses (n, 4): x, y, steering and turret angle; of a connected robot both are those of the encoders.
    ranges_in
        Last reading of each sonar (n, s).
    is_touching
        True where a bumper is pressed (n,).
    """

    time_s: FloatArray
    encoder: FloatArray
    actual: FloatArray
    ranges_in: FloatArray
    is_touching: BoolArray


def axis_velocities(model: RobotModel, speed_in_s: FloatArray,
                    turn_rad_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the velocities of a model's axes: translation, steering, turret; or right and left wheel, and none."""
    if model.track_in is None:
        return speed_in_s, turn_rad_s, turn_rad_s
    beside = 0.5 * model.track_in * turn_rad_s
    return speed_in_s + beside, speed_in_s - beside, np.zeros_like(speed_in_s)


class BatchRobots:
    """Independent robots, of the batch simulation."""

    def __init__(self, world: World, count: int, model: RobotModel, setup: RobotSetup, threads: int | None) -> None:
        self.body, self._model = model.body, model
        self._batch = BatchSimulation(world, count, model=model, setup=setup, threads=threads)

    def reset(self, mask: BoolArray, starts: FloatArray, seed: int | None) -> None:
        """Reset some robots."""
        self._batch.reset(mask, starts=starts, seed=seed)

    def drive(self, speed_in_s: FloatArray, turn_rad_s: FloatArray) -> None:
        """Command velocities."""
        self._batch.set_velocities(*axis_velocities(self._model, speed_in_s, turn_rad_s))

    def step(self, dt_s: float) -> None:
        """Let time pass."""
        self._batch.step(dt_s)

    def sense(self) -> Sensed:
        """Return the state of all robots."""
        batch = self._batch
        return Sensed(batch.time_s, batch.encoder, batch.actual, batch.ranges_in, batch.bumpers != 0)

    def close(self) -> None:
        """Do nothing."""


class SimulatedRobots:
    """Robots of one simulation, which see and touch each other; every setup and model."""

    def __init__(self, world: World, count: int, model: RobotModel, setup: RobotSetup) -> None:
        self.body, self._model, self._setup = model.body, model, setup
        self._world, self._count, self._seed = world, count, 0
        self._simulation = Simulation(world)

    def reset(self, mask: BoolArray, starts: FloatArray, seed: int | None) -> None:
        """Make a new simulation; robots of one world are reset together."""
        if not mask.all():
            raise ValueError("expected a mask with all robots: they share a world; use an environment for each")
        self._seed = self._seed + 1 if seed is None else seed
        self._simulation = Simulation(self._world, self._seed)
        for number, start in enumerate(starts.tolist(), 1):
            self._simulation.add_robot(number, StartPose(*start), self._model, self._setup, powered=False)
        self._simulation.power_on()

    def drive(self, speed_in_s: FloatArray, turn_rad_s: FloatArray) -> None:
        """Command velocities."""
        rows = np.column_stack(axis_velocities(self._model, speed_in_s, turn_rad_s)).tolist()
        for robot, row in zip(self._simulation.robots.values(), rows, strict=True):
            robot.set_velocities(*row)

    def step(self, dt_s: float) -> None:
        """Let time pass."""
        self._simulation.step(dt_s)

    def sense(self) -> Sensed:
        """Return the state of all robots."""
        robots = self._simulation.robots.values()
        return Sensed(
            np.full(self._count, self._simulation.time_s),
            np.array([robot.encoder for robot in robots]),
            np.array([robot.actual for robot in robots]),
            np.array([robot.sonar.readings_in for robot in robots]),
            np.array([robot.bumpers != 0 for robot in robots]),
        )

    def close(self) -> None:
        """Do nothing."""


class ConnectedRobot:
    """The robot at an address (docs/addresses.md): `sim:`, `nserver://`, `serial://`.

    It is never moved to a start: an episode begins where the robot stands, at time 0 of a restarted ring.

    Parameters
    ----------
    address
        Of the robot.
    wait
        Lets time of the robot pass; None: `Robot.sleep`.
    """

    def __init__(self, address: str, wait: Callable[[float], None] | None = None) -> None:
        self._robot = connect(address)
        self._wait = wait or self._robot.sleep
        self._turns = self._robot.model.has_turret
        self.body = BODIES[self._robot.model.name]
        self._state = self._robot.refresh()
        self._start_s = self._now_s

    @property
    def _now_s(self) -> float:
        assert self._state.clock_s is not None
        return self._state.clock_s

    def reset(self, mask: BoolArray, starts: FloatArray, seed: int | None) -> None:
        """Stop the robot and restart its ring. Raises StartError if the turret does not look ahead."""
        del mask, starts, seed
        self._robot.stop()
        self._robot.set_timeout(TIMEOUT_S)
        self._state = self._robot.configure_sonars()
        turned = (self._state.turret_rad - self._state.steering_rad + pi) % (2.0 * pi) - pi
        if self._turns and abs(turned) > MAX_TURRET_RAD:
            raise StartError(f"the turret looks {np.degrees(turned):.0f} degrees beside the steering, and policies "
                             "expect sonar 0 ahead: turn it, for example with `nomad shell` and `turret`")
        self._start_s = self._now_s

    def drive(self, speed_in_s: FloatArray, turn_rad_s: FloatArray) -> None:
        """Command velocities; a contact is no error here, since the state reports it."""
        turn = float(turn_rad_s[0])
        turret = turn if self._turns else None
        with suppress(BumperHit):
            self._robot.drive(translation_in_s=float(speed_in_s[0]), steering_rad_s=turn, turret_rad_s=turret)

    def step(self, dt_s: float) -> None:
        """Wait until the robot's clock has advanced. Raises ConnectionLost if it was set back."""
        begin_s = self._now_s
        end_s = begin_s + dt_s
        while True:
            self._state = self._robot.refresh()
            if self._now_s < begin_s:
                raise ConnectionLost("the robot's clock went back, as after a restart: make the environment again")
            remaining_s = end_s - self._now_s
            if remaining_s < MIN_WAIT_S:
                return
            self._wait(remaining_s)

    def sense(self) -> Sensed:
        """Return the last state."""
        state = self._state
        pose = np.array([[state.x_in, state.y_in, state.steering_rad, state.turret_rad]])
        ranges_in = np.array([state.sonars_in], dtype=np.float64)
        return Sensed(np.array([self._now_s - self._start_s]), pose, pose, ranges_in, np.array([state.touching]))

    def close(self) -> None:
        """Stop the robot and disconnect."""
        if not self._robot.closed:
            self._robot.stop()
            self._robot.disconnect()


Robots = BatchRobots | SimulatedRobots | ConnectedRobot
"""Robots that are driven together. `reset` takes a mask (n,) and starts (n, 4), and None continues their random
streams; `drive` takes speeds and turn rates (n,), and turrets turn with the steering; `body` is that of all."""
