"""Helpers of the notebooks besides the client: recorded drives, expected ranges, pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.own import OwnFactory, OwnFilterAdapter
from localization.live.run import Run
from localization.navigation.waypoints import record_run
from nclient import connect
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.drawing import draw_walls
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150
from worlds.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = npt.NDArray[np.float64]
Steer = Callable[[RobotState], tuple[float, float]]
Legs = Sequence[tuple[float, float, float]]

PERIOD_S: Final = 0.1
RING_IN: Final = N150.sonar_ring_radius_in
SONAR_RAD: Final = np.array(N150.sonar_angles_rad)
"""Directions of the sonars against the turret."""


@dataclass(frozen=True, slots=True)
class Drive:
    """A recorded drive of n states, some 0.1 s apart.

    Attributes
    ----------
    clock_s
        Seconds since the first state (n,).
    encoders
        x and y in inches, heading in radians (n, 3).
    turret_rad
        Direction of the turret, and of sonar 0 (n,).
    sonars_in
        Readings (n, 16), 255 where there was no echo.
    truth
        True poses (n, 3); NaN of a robot that is not simulated.
    """

    clock_s: Floats
    encoders: Floats
    turret_rad: Floats
    sonars_in: Floats
    truth: Floats

    @property
    def has_truth(self) -> bool:
        """True if the robot is simulated."""
        return bool(np.isfinite(self.truth).all())


def record(address: str, motion: Legs | Steer, seconds: float = 0.0, sonars: Sequence[int] = range(16)) -> Drive:
    """Drive a robot and return what it measured. The turret turns with the steering, so that sonar 0 looks ahead.

    Parameters
    ----------
    address
        Of the robot.
    motion
        Legs (in/s, deg/s, seconds), or a function that returns in/s and deg/s for a state.
    seconds
        Duration, if `motion` is a function.
    sonars
        Numbers in firing order: few sonars fire more often, one every 60 ms.
    """
    legs: Sequence[tuple[Any, Any, float]] = [(motion, None, seconds)] if callable(motion) else motion
    states, truths = [], []
    with connect(address) as robot:
        is_simulated = robot.is_simulated()
        state = robot.configure_sonars(order=sonars)
        for translation_in_s, turn_deg_s, duration_s in legs:
            # The count of periods, not the clock, ends a leg: a replayed one has the same requests.
            for _ in range(round(duration_s / PERIOD_S)):
                speed, turn = translation_in_s(state) if callable(motion) else (translation_in_s, turn_deg_s)
                state = _drive(robot, state, speed, turn)
                states.append(state)
                truth = robot.truth() if is_simulated else None
                truths.append((truth.x_in, truth.y_in, truth.steering_rad) if truth else (np.nan,) * 3)
    clock_s = np.array([state.clock_s or 0.0 for state in states])
    return Drive(clock_s - clock_s[0], np.array([(state.x_in, state.y_in, state.steering_rad) for state in states]),
                 np.array([state.turret_rad for state in states]),
                 np.array([state.sonars_in for state in states], dtype=np.float64), np.array(truths))


def _drive(robot: Robot, before: RobotState, translation_in_s: float, turn_deg_s: float) -> RobotState:
    """Drive for a period, and return the state after it."""
    state = robot.drive(translation_in_s=translation_in_s, steering_deg_s=turn_deg_s, turret_deg_s=turn_deg_s)
    remaining_s = PERIOD_S - ((state.clock_s or 0.0) - (before.clock_s or 0.0))
    if remaining_s > PERIOD_S / 2:
        robot.sleep(remaining_s)
        state = robot.refresh()
    return state


def expected_ranges(poses: npt.ArrayLike, directions_rad: npt.ArrayLike, world: World) -> Floats:
    """Return the ranges (n, k) that exact sonars measure at poses (n, 3), at most 255 in.

    Parameters
    ----------
    poses
        x and y in inches, heading in radians.
    directions_rad
        Of k sonars against the heading.
    """
    poses = np.atleast_2d(np.asarray(poses, dtype=np.float64))
    angles = poses[:, 2:] + np.asarray(directions_rad)
    u = np.stack((np.cos(angles), np.sin(angles)), axis=-1).reshape(-1, 2)
    origins = np.repeat(poses[:, :2], angles.shape[1], axis=0)
    ranges, _ = cast_rays(origins, u, world.walls)
    return np.minimum(ranges.reshape(angles.shape) - RING_IN, 255.0)


def run_filter(address: str, own: OwnFactory, world: World, waypoints: Sequence[tuple[float, float]],
               start_std: tuple[float, float, float] = (0.1, 0.1, 0.01)) -> Run:  # fmt: skip
    """Drive to waypoints on the estimate of a filter class (docs/own-filter.md), from the pose of the encoders."""
    config = LocalizationConfig(world.walls, N150)
    with connect(address) as robot:
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], start_std)
        return record_run(robot, config, waypoints, OwnFilterAdapter(own(config, belief), config), start_std=start_std)


def draw_map(axes: Axes, world: World) -> None:
    """Draw the walls of a world, with equal scales."""
    draw_walls(axes, world.walls)
    axes.set(xlabel="x (in)", ylabel="y (in)", aspect="equal")
