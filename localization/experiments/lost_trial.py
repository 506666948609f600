"""Driving about for a long time: to place after place while the estimate is believed, groping while it is not.

    believed    a shortest way (planning.roadmap) to a place drawn by chance, turned to on the spot, then by the thesis'
                law
    lost        groping: a look around, and then on wherever the sonars ahead hear room

Rules: estimate and readings in, a command out; no robot, no truth. All chance is handed in.

One long run with the filter that knows when it is lost (filters.finding.finder): what was said, and what was so.

    calm        told its place at the start, it drives about; every time it says LOST is a false alarm
    kidnapped   the same, and then set down elsewhere while its encoders are told nothing; how long until it says LOST,
                until it has found itself again, and is that so
    nowhere     told nothing at the start; how long until it has found itself, and is that so

Found is: one place is believed and no LOST is said for CERTAIN_S. Rules: speaks to the robot through nclient, on
simulated time; the truth is asked for beside and never reaches the filter.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from enum import Enum
from math import atan2, degrees, hypot, tau
from pathlib import Path
from typing import Any, Final

import numpy as np

from localization.experiments.live_trial import BAD, START_STD, BadReadings, Scenario
from localization.filters.base import LocalizationConfig
from localization.filters.belief import HEADING, Floats, difference, independent
from localization.filters.health import HealthStatus
from localization.filters.odometry import with_parameters
from localization.filters.registry import finder
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule
from localization.navigation.control_law import bearing_error
from localization.navigation.limits import (
    VelocityCommand,
)
from localization.navigation.path import sample_waypoints
from localization.navigation.recovery import TURN_RAD_S, RecoveryBehavior, SonarState
from localization.navigation.roadmap import NoPathError, Roadmap
from localization.navigation.waypoints import (
    PERIOD_S,
    Navigator,
    Speeds,
)
from nclient import connect
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.robot import Robot
from nclient.state import Pose, RobotState
from worlds.geometry import nearest_points
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import World

STAND: Final = VelocityCommand(0.0, 0.0)
TURN_FIRST_RAD: Final = 1.0
"""Farther off the bearing than this the robot turns on the spot: the law alone would drive a circle."""


class RandomExplorer:
    """Goes about on a roadmap. `places` (n, 2) are where it may go."""

    def __init__(self, roadmap: Roadmap, places: Floats, speeds: Speeds, chance: np.random.Generator) -> None:
        self._roadmap, self._places, self._speeds, self._chance = roadmap, places, speeds, chance
        self._navigator: Navigator | None = None
        self._groping = RecoveryBehavior(PERIOD_S)

    def command(self, pose: Floats) -> VelocityCommand:
        """What to do at a pose (3,) that is believed."""
        self._groping.reset()
        if self._navigator is None or (command := self._navigator.command(pose)) is None:
            self._navigator = self._somewhere(pose)
            return STAND
        goal = self._navigator.goal
        assert goal is not None
        error = float(bearing_error(pose, goal))
        if abs(error) > TURN_FIRST_RAD:
            return VelocityCommand(0.0, float(np.copysign(TURN_RAD_S, error)))
        return command

    def grope(self, state: SonarState) -> VelocityCommand:
        """What to do when nothing is believed."""
        self._navigator = None
        return VelocityCommand(*self._groping.command(state))

    def _somewhere(self, pose: Floats) -> Navigator | None:
        goal = self._places[self._chance.integers(len(self._places))]
        try:
            path = self._roadmap.path((float(pose[0]), float(pose[1])), (float(goal[0]), float(goal[1])))
        except NoPathError:
            return None
        return Navigator(sample_waypoints(path), self._speeds)


EXCHANGES_A_PERIOD: Final = 2
MARGIN_IN: Final = 3.0
"""How far the robot keeps from walls besides its radius."""
KIDNAPPED_S: Final = (20.0, 40.0)
"""When a robot is kidnapped: anywhere between."""
FAR_IN, FAR_RAD = 24.0, 1.0
"""Set down at least so far away, or turned so much."""
STILL_S: Final = 10
CERTAIN_S: Final = 3.0
PATIENCE_S: Final = 90.0
"""How long a lost robot may look for itself."""
RIGHT_IN, RIGHT_RAD = 6.0, 0.25
"""Found within this of the truth is found."""
GOALS, PLACES, START = 11, 12, 13
"""Which stream of a seed's chance each is drawn from."""


class Kind(Enum):
    """What happens in a run."""

    TRACKING = "calm"
    KIDNAPPED = "kidnapped"
    UNKNOWN_START = "nowhere"


@dataclass(frozen=True, slots=True)
class Case:
    """A run to be made; all that decides its outcome. `seconds` is how long a calm one lasts."""

    kind: Kind
    world: str
    scenario: Scenario
    seed: int
    seconds: float = 600.0

    @property
    def name(self) -> str:
        """For files and tables."""
        return f"{self.kind.value}_{self.world}_{self.scenario.name}_{self.seed:04d}"


@dataclass(frozen=True, slots=True)
class LostResult:
    """What came of a run of `seconds`; times in seconds, None for what never was.

    alarms          how often LOST was said before the robot was kidnapped, or at all in a calm run
    degraded        share of the time in which DEGRADED was said
    rmse_in         of the position, while a place was believed and none had been kidnapped
    lost_after_s    from the kidnapping to the first LOST
    found_after_s   from then, or from the start where nothing was told, until it had found itself
    right           whether what it found was so
    """

    seconds: float
    alarms: int
    degraded: float
    rmse_in: float | None
    lost_after_s: float | None = None
    found_after_s: float | None = None
    right: bool = False

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


def drive(case: Case) -> LostResult:
    """Make one run in a simulation of its own."""
    world = load_world(case.world)
    places = _places(world)
    pose = _drawn(places, np.random.default_rng([case.seed, PLACES]))
    where = f"{pose.x_in},{pose.y_in},{degrees(pose.steering_rad)},{degrees(pose.turret_rad)}"
    with tempfile.TemporaryDirectory() as folder:
        setup = Path(folder) / "setup.toml"
        setup.write_text(case.scenario.setup(case.seed), encoding="utf-8")
        step_s = PERIOD_S / EXCHANGES_A_PERIOD
        with connect(f"sim:{world.name}?setup={setup}&seed={case.seed}&start={where}&step_s={step_s}") as robot:
            return _Run(robot, case, world, places, pose).drive()


class _Run:
    """A run under way."""

    def __init__(self, robot: Robot, case: Case, world: World, places: Floats, pose: Pose) -> None:
        self._robot, self._case, self._places = robot, case, places
        state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
        assert state.clock_s is not None
        self._start_s = state.clock_s
        schedule = FiringSchedule(state.clock_s)
        chance = np.random.default_rng([case.seed, START])
        told = None
        if case.kind is not Kind.UNKNOWN_START:
            guess = _pose(pose) + np.array(START_STD) * chance.standard_normal(3)
            told = with_parameters(independent(guess, START_STD), case.scenario.constants)
        clearance = N150.radius_in
        known = LocalizationConfig(
            world.walls, N150, case.scenario.odometry, case.scenario.sonar, clearance_in=clearance
        )
        self._filter = finder(known, told, case.scenario.constants)
        self._localizer = Localizer(known, self._filter.belief, schedule, self._filter)
        self._shown = BadReadings(case.scenario.bad_share, schedule, np.random.default_rng([case.seed, BAD]))
        speeds = Speeds(translation_in_s=case.scenario.speed_in_s)
        roadmap = Roadmap(world.walls, clearance + MARGIN_IN)
        self._wanderer = RandomExplorer(roadmap, places, speeds, np.random.default_rng([case.seed, GOALS]))
        self._chance = chance
        self._alarms = self._polls = self._degraded = 0
        self._squares: list[float] = []
        self._truth = _pose(pose)
        self._now_s = 0.0

    def drive(self) -> LostResult:
        """All of it."""
        match self._case.kind:
            case Kind.TRACKING:
                self._until(self._case.seconds)
                return self._outcome()
            case Kind.KIDNAPPED:
                self._until(float(self._chance.uniform(*KIDNAPPED_S)))
                self._kidnap()
                return self._find(*self._until_lost())
            case Kind.UNKNOWN_START:
                return self._find(None, 0.0)

    def _until(self, end_s: float) -> None:
        """Drive about, and count what is said."""
        before = HealthStatus.OK
        while self._now_s < end_s:
            estimate = self._period()
            trust = estimate.health.status
            self._alarms += trust is HealthStatus.LOST and before is not HealthStatus.LOST
            self._degraded += trust is HealthStatus.DEGRADED
            self._polls += 1
            before = trust
            if trust is not HealthStatus.LOST:
                self._squares.append(hypot(*(estimate.pose - self._truth)[:2]) ** 2)

    def _kidnap(self) -> None:
        """Stop the robot and set it down elsewhere, its turret as it is on the body; its encoders go on as if nothing
        had been. Moving wheels would turn on meanwhile, and the ring stand otherwise than the encoders say."""
        self._robot.stop()
        state = self._robot.wait_until_still(timeout_s=STILL_S)
        truth = self._robot.truth()
        here = _pose(truth)
        while True:
            there = _drawn(self._places, self._chance)
            off = difference(_pose(there), here)
            if hypot(off[0], off[1]) >= FAR_IN or abs(off[HEADING]) >= FAR_RAD:
                break
        turned = truth.turret_rad - truth.steering_rad
        self._robot.place(Pose(there.x_in, there.y_in, there.steering_rad, there.steering_rad + turned))
        self._robot.set_position(x_in=state.x_in, y_in=state.y_in)
        self._robot.set_angles(steering_rad=state.steering_rad, turret_rad=state.turret_rad)

    def _until_lost(self) -> tuple[float | None, float]:
        """After how many seconds LOST is said, and when."""
        since_s = self._now_s
        while self._now_s < since_s + PATIENCE_S:
            if self._period().health.status is HealthStatus.LOST:
                return self._now_s - since_s, self._now_s
        return None, self._now_s

    def _find(self, lost_after_s: float | None, since_s: float) -> LostResult:
        """Until it has found itself, for so long as there is patience, and whether that is so."""
        sure_s: float | None = None
        while self._now_s < since_s + PATIENCE_S:
            estimate = self._period()
            if estimate.health.status is HealthStatus.LOST:
                sure_s = None
                continue
            sure_s = self._now_s if sure_s is None else sure_s
            if self._now_s - sure_s >= CERTAIN_S:
                off = difference(estimate.pose, self._truth)
                right = hypot(off[0], off[1]) <= RIGHT_IN and bool(abs(off[HEADING]) <= RIGHT_RAD)
                return self._outcome(lost_after_s, sure_s - since_s, right)
        return self._outcome(lost_after_s)

    def _period(self) -> Estimate:
        """Ask, estimate, command."""
        state = self._robot.refresh()
        assert state.clock_s is not None
        self._now_s = state.clock_s - self._start_s
        self._truth = _pose(self._robot.truth())
        estimate = self._localizer.update(self._shown.of(state))
        command = self._command(state, estimate)
        self._robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
        return estimate

    def _command(self, state: RobotState, estimate: Estimate) -> VelocityCommand:
        if estimate.health.status is HealthStatus.LOST:
            return self._wanderer.grope(state)
        return self._wanderer.command(estimate.pose)

    def _outcome(
        self, lost_after_s: float | None = None, found_after_s: float | None = None, right: bool = False
    ) -> LostResult:
        rmse = float(np.sqrt(np.mean(self._squares))) if self._squares else None
        degraded = self._degraded / self._polls if self._polls else 0.0
        return LostResult(self._now_s, self._alarms, degraded, rmse, lost_after_s, found_after_s, right)


def _places(world: World) -> Floats:
    """A grid (n, 2) of where the robot has room, inside the world."""
    low, high = world.walls.reshape(-1, 2).min(axis=0), world.walls.reshape(-1, 2).max(axis=0)
    x, y = np.meshgrid(np.arange(low[0], high[0], 2.0), np.arange(low[1], high[1], 2.0))
    points = np.stack((x.ravel(), y.ravel()), axis=-1)
    _, far = nearest_points(points, world.walls)
    free: Floats = points[far.min(axis=1) >= N150.radius_in + MARGIN_IN]
    return free


def _drawn(places: Floats, chance: np.random.Generator) -> Pose:
    x, y = places[chance.integers(len(places))]
    turn = float(chance.uniform(0.0, tau))
    return Pose(float(x), float(y), turn, turn)


def _pose(pose: Pose) -> Floats:
    return np.array([pose.x_in, pose.y_in, atan2(np.sin(pose.steering_rad), np.cos(pose.steering_rad))])
