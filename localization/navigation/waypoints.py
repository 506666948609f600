"""Point-to-point navigation on an estimate: the control law of the thesis as velocities for a real robot's axes.

    refresh ──> localizer ──> navigator ──> drive ──> wait for the rest of the period, and again

The limits of the control law are per step; with one step every PERIOD_S they are speeds. Waiting is a parameter, so
the loop has no clock of its own.
"""

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import Belief, Floats, hypot, independent
from localization.filters.registry import DEFAULT_METHOD
from localization.live.localizer import Estimate, Localizer
from localization.live.run import GroundTruth, Run
from localization.live.sensor_input import restart_ring
from localization.navigation import control_law
from localization.navigation.control_law import STAND, VelocityCommand
from nclient.errors import NomadError, RobotHeld
from nclient.robot import Robot
from nclient.state import RobotState

PERIOD_S = 0.1
"""Control period (ROBOTS.md)."""
STOP_RADIUS_IN = 1.0
"""Distance at which a waypoint of a live run counts as reached."""
MIN_WAIT_S = 0.001
"""Resolution of the finest robot clock, 1 ms."""
COMMAND_TIMEOUT_S = 2
"""The robot stops by itself after this time without a command."""


@dataclass(frozen=True, slots=True)
class Speeds:
    """Speed limits of a live run; the gains (fraction of the error corrected per period) are those of the thesis."""

    translation_in_s: float = 5.0
    steering_rad_s: float = 0.5

    @property
    def gains(self) -> control_law.ControlGains:
        """The same limits per step of PERIOD_S."""
        return control_law.ControlGains(self.translation_in_s * PERIOD_S, self.steering_rad_s * PERIOD_S)


class Controller(Protocol):
    """Decides once per period how to drive: a Navigator, or the tasks of a calibration run (cli/calibrate.py)."""

    passed: int
    """Number of waypoints reached, or of tasks done."""

    @property
    def finished(self) -> bool:
        """True if nothing is left to do."""

    def command(self, pose: Floats) -> VelocityCommand | None:
        """Return the velocities at a pose (3,); None at the end."""


class Navigator:
    """Controller from waypoint to waypoint.

    Parameters
    ----------
    waypoints : sequence of (x, y)
        Inches, visited in order.
    speeds : Speeds, optional
    radius_in : float
        Distance at which a waypoint counts as reached.
    stays : bool
        Stand after the last waypoint and wait for new ones instead of ending.
    """

    def __init__(self, waypoints: Sequence[tuple[float, float]], speeds: Speeds | None = None,
                 radius_in: float = STOP_RADIUS_IN, *, stays: bool = False) -> None:  # fmt: skip
        self._stays = stays
        self._goals = [np.array(point, dtype=np.float64) for point in waypoints]
        self._gains = (speeds or Speeds()).gains
        self._radius_in = radius_in
        self.passed = 0
        """Number of waypoints reached."""

    @property
    def finished(self) -> bool:
        """True once the last waypoint is reached."""
        return self.passed == len(self._goals)

    @property
    def goal(self) -> Floats | None:
        """Current waypoint (2,); None after the last."""
        return None if self.finished else self._goals[self.passed]

    def set_waypoints(self, waypoints: Sequence[tuple[float, float]]) -> None:
        """Replace the remaining waypoints."""
        self._goals = [np.array(point, dtype=np.float64) for point in waypoints]
        self.passed = 0

    def command(self, pose: Floats) -> VelocityCommand | None:
        """Return the velocities at a pose (3,); None at the end."""
        # In floats: arrays of two or three numbers take five times as long.
        x, y, heading = pose.tolist()
        while not self.finished:
            goal_x, goal_y = self._goals[self.passed].tolist()
            if hypot(goal_x - x, goal_y - y) > self._radius_in:
                break
            self.passed += 1
        if self.finished:
            return STAND if self._stays else None
        drho, dtheta = control_law.step_to(x, y, heading, goal_x, goal_y, self._gains)
        drho = control_law.slow_for_turn(drho, x, y, heading, goal_x, goal_y, self._gains)
        return VelocityCommand(drho / PERIOD_S, dtheta / PERIOD_S)


class NavigationStep(NamedTuple):
    """One period of a run: estimate, state, number of waypoints reached or tasks done."""

    estimate: Estimate
    state: RobotState
    passed: int


def start_localizer(robot: Robot, config: LocalizationConfig, belief: Belief,
                    method: str | Filter = DEFAULT_METHOD) -> Localizer:
    """Restart the robot's sonar ring, so that its firing times are known, and start a filter.

    Parameters
    ----------
    robot : Robot
    config : LocalizationConfig
        Map, robot, sensor and noise models.
    belief : Belief
        Initial belief.
    method : str or Filter
        Name of a filter (see localization.filters.registry), or a filter.
    """
    schedule, state = restart_ring(robot, config.body.ring)
    localizer = Localizer(config, belief, schedule, method)
    localizer.update(state)
    return localizer


def follow_waypoints(robot: Robot, localizer: Localizer, navigator: Controller, wait: Callable[[float], None],
                     smoother: control_law.PoseSmoother | None = None, *,
                     turns_turret: bool = False) -> Generator[NavigationStep, None, None]:  # fmt: skip
    """Drive until the navigator is finished and yield each period; the robot is stopped at the end in any case.

    Without a waypoint left, a navigator that stays gives no commands: the robot may be driven by other clients.
    While the estimate is LOST the robot searches (RecoveryBehavior). Where states arrive far apart it drives slower
    (StateGapLimiter).

    Parameters
    ----------
    robot : Robot
    localizer : Localizer
    navigator : Controller
    wait : callable
        `wait(seconds)` lets time of the robot pass, as `Robot.sleep`; called only for what its clock has not
        advanced by itself.
    smoother : PoseSmoother, optional
        Smooths the pose to steer by. Default: steer by the estimates.
    turns_turret : bool
        Turn the turret with the steering, so that every sonar measures every wall.
    """
    smoother, gap_limiter = smoother or control_law.PoseSmoother(0.0), control_law.StateGapLimiter()
    stands = navigator.finished
    recovery = control_law.RecoveryBehavior(PERIOD_S, ring=localizer.ring)
    robot.set_timeout(COMMAND_TIMEOUT_S)
    state = robot.refresh()
    with stop_on_exit(robot):
        while True:
            # 1. Estimate.
            estimate = localizer.update(state)
            # 2. Control, or recovery if the estimate is lost.
            encoders = np.array([state.x_in, state.y_in, state.steering_rad])
            command: VelocityCommand | None
            if estimate.health.is_lost:
                smoother.reset()
                command = VelocityCommand(*recovery.command(state, estimate.informative_turn_rad))
            else:
                recovery.reset()
                command = navigator.command(smoother.update(estimate.clock_s, estimate.pose, encoders))
            yield NavigationStep(estimate, state, navigator.passed)
            if command is None:
                return
            # 3. Drive for the rest of the period. A robot that stands is not commanded again: others may drive it.
            after = state
            if command != STAND or not stands:
                fraction = gap_limiter.speed_fraction(estimate.clock_s)
                translation_in_s, steering_rad_s = (fraction * speed for speed in command)
                turret = {"turret_rad_s": steering_rad_s} if turns_turret else {}
                after = drive_unless_held(robot, translation_in_s=translation_in_s, steering_rad_s=steering_rad_s,
                                          **turret)
            stands = command == STAND
            state = wait_for_next_state(robot, state, after, wait)


def record_run(robot: Robot, config: LocalizationConfig, waypoints: Sequence[tuple[float, float]],
               method: str | Filter = DEFAULT_METHOD, *, start_std: tuple[float, float, float] = (0.1, 0.1, 0.01),
               wait: Callable[[float], None] | None = None) -> Run:  # fmt: skip
    """Drive to waypoints on the estimate of a filter, and return the record of the run, for `localization.plot`.

    Parameters
    ----------
    robot : Robot
        It begins at the pose of its encoders. Of a simulated one the ground truth is recorded as well.
    config : LocalizationConfig
    waypoints : sequence of (x, y)
        Inches.
    method : str or Filter
        Name of a filter, `module:Class`, or a filter.
    start_std : tuple
        Standard deviation of the start: inches, inches, radians.
    wait : callable, optional
        Lets time of the robot pass; default: `Robot.sleep`.
    """
    state = robot.refresh()
    belief = independent([state.x_in, state.y_in, state.steering_rad], start_std)
    run, truth = Run([*waypoints]), GroundTruth(robot, robot.is_simulated())
    localizer = start_localizer(robot, config, belief, method)
    for step in follow_waypoints(robot, localizer, Navigator(run.waypoints), wait or robot.sleep):
        run.add(truth.moment(*step))
    return run


@contextlib.contextmanager
def stop_on_exit(robot: Robot) -> Iterator[None]:
    """Stop the robot at the end of the block; an error of the block takes precedence over one of stopping."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(NomadError):
            robot.stop()
        raise
    robot.stop()


def drive_unless_held(robot: Robot, **velocities: float) -> RobotState:
    """Drive and return the state; while a person holds the robot, only query it: it goes on when it is released."""
    try:
        return robot.drive(**velocities)
    except RobotHeld:
        return robot.refresh()


def wait_for_next_state(robot: Robot, before: RobotState, after: RobotState,
                        wait: Callable[[float], None]) -> RobotState:
    """Return the state one period after `before`; `wait` is `Robot.sleep`, or a stand-in of it."""
    remaining_s = PERIOD_S - ((after.clock_s or 0.0) - (before.clock_s or 0.0))
    if remaining_s >= MIN_WAIT_S:
        wait(remaining_s)
    return robot.refresh()
