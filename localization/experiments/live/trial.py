"""One live trial: a robot by its address, driven along a path on its estimate, and what came of it at every period.

Rules: speaks to the robot through nclient; the truth is asked for beside and never reaches the filter. Simulated time
passes with the exchanges alone: two a period, the question and the command, so a trial takes no time to wait.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from localization.driving.navigation import PERIOD_S, Navigator, Speeds
from localization.experiments.live.bad_readings import BadReadings
from localization.experiments.live.scenario import BAD, COURSES, START_STD, Scenario
from localization.filters.base import LocalizationConfig
from localization.filters.belief import Floats, add, difference, independent
from localization.filters.odometry import with_parameters
from localization.live.localizer import Estimate, Localizer, Smoothed
from localization.live.sensor_input import FiringSchedule
from nclient import connect
from nclient.protocol.models import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.robot import Robot
from worlds.bodies import N150
from worlds.files import load_world
from worlds.world import World

Timer = Callable[[], float]

EXCHANGES_A_PERIOD: Final = 2
MOST_PERIODS: Final = 3000
"""Five minutes: longer than any path takes three times over."""
START: Final = 0
"""Stream of a seed's chance from which the error of the first estimate is drawn."""


class Period(NamedTuple):
    """A period: the estimate, truth and encoders (3,) at its clock, and the seconds of the timer spent on it."""

    estimate: Estimate
    truth: Floats
    encoders: Floats
    spent_s: float


@dataclass(frozen=True, slots=True)
class Record:
    """A trial of T estimates: `clock_s` (T,), the instant each is of; `way_in` (T,) gone by then, `truth`, `encoders`
    and `mean` (T, 3), `cov` (T, 3, 3). `spent_s` (periods,): what each state took to be worked in, of the timer's time.

    A method that looks back has its estimates of a while ago here (filters.smoother); the robot is driven on those of
    the present whatever the method.
    """

    seed: int
    reached: bool
    clock_s: Floats
    way_in: Floats
    truth: Floats
    encoders: Floats
    mean: Floats
    cov: Floats
    spent_s: Floats

    @property
    def error(self) -> Floats:
        """Estimate less truth (T, 3)."""
        return difference(self.mean, self.truth)


def drive(
    scenario: Scenario, figure: str, seed: int, periods: int = MOST_PERIODS, timer: Timer = lambda: 0.0
) -> Record:
    """Run one trial of so many periods at most in a simulation of its own; `timer` tells seconds."""
    world = load_world(COURSES[figure])
    start = world.paths[figure].start
    pose = f"{start.x_in},{start.y_in},{np.degrees(start.steering_rad)},{np.degrees(start.turret_rad)}"
    with tempfile.TemporaryDirectory() as folder:
        setup = Path(folder) / "setup.toml"
        setup.write_text(scenario.setup(seed), encoding="utf-8")
        step_s = PERIOD_S / EXCHANGES_A_PERIOD
        options = f"setup={setup}&seed={seed}&start={pose}&step_s={step_s}&line={int(scenario.line)}"
        with connect(f"sim:{world.name}?{options}") as robot:
            localizer, shown = _listening(robot, scenario, world, figure, seed)
            navigator = Navigator(world.paths[figure].goals_in, Speeds(translation_in_s=scenario.speed_in_s))
            followed = _follow(robot, localizer, shown, navigator, periods, timer)
    return _record(seed, navigator.finished, followed)


def _listening(
    robot: Robot, scenario: Scenario, world: World, figure: str, seed: int
) -> tuple[Localizer, BadReadings]:
    """The filter at the start, a little off, and what spoils its readings."""
    start = world.paths[figure].start
    state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
    assert state.clock_s is not None
    schedule = FiringSchedule(state.clock_s)
    off = np.array(START_STD) * np.random.default_rng([seed, START]).standard_normal(3)
    guess = add(np.array([start.x_in, start.y_in, start.steering_rad]), off)
    belief = with_parameters(independent(guess, START_STD), scenario.constants)
    known = LocalizationConfig(world.walls, N150, scenario.odometry, scenario.sonar)
    localizer = Localizer(known, belief, schedule, scenario.method, seed)
    return localizer, BadReadings(scenario.bad_share, schedule, np.random.default_rng([seed, BAD]))


def _follow(
    robot: Robot, localizer: Localizer, shown: BadReadings, navigator: Navigator, periods: int, timer: Timer
) -> list[Period]:
    """Drive on the estimate until the last goal, or until the periods are over."""
    followed: list[Period] = []
    for _ in range(periods):
        state, actual = robot.refresh(), robot.truth()
        report = shown.of(state)
        before_s = timer()
        estimate = localizer.update(report)
        spent_s = timer() - before_s
        truth = np.array([actual.x_in, actual.y_in, actual.steering_rad])
        followed.append(Period(estimate, truth, np.array([state.x_in, state.y_in, state.steering_rad]), spent_s))
        command = navigator.command(estimate.pose)
        if command is None:
            break
        robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
    return followed


def _record(seed: int, reached: bool, periods: Sequence[Period]) -> Record:
    """The trial in columns; of estimates that look back, each instant once, as told last."""
    polled_s = np.array([period.estimate.clock_s for period in periods])
    truth = np.stack([period.truth for period in periods])
    encoders = np.stack([period.encoders for period in periods])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    spent = np.array([period.spent_s for period in periods])
    told = [_told(period.estimate) for period in periods]
    fresh = [k for k in range(len(told)) if k == len(told) - 1 or told[k + 1].clock_s > told[k].clock_s]
    clock = np.array([told[k].clock_s for k in fresh])
    means = np.stack([told[k].belief.mean[:3] for k in fresh])
    covs = np.stack([told[k].belief.cov[:3, :3] for k in fresh])
    way = np.interp(clock, polled_s, way)
    return Record(
        seed, reached, clock, way, _at(clock, polled_s, truth), _at(clock, polled_s, encoders), means, covs, spent
    )


def _told(estimate: Estimate) -> Smoothed:
    """What the method stands for: the past of one that looks back, else the present."""
    return estimate.smoothed or Smoothed(estimate.clock_s, estimate.belief)


def _at(clock_s: Floats, polled_s: Floats, poses: Floats) -> Floats:
    """Poses (n, 3) at instants (n,) between those of poses (T, 3) at (T,), the robot going evenly between them."""
    turned = np.unwrap(poses[:, 2])
    columns = [np.interp(clock_s, polled_s, column) for column in (poses[:, 0], poses[:, 1], turned)]
    between = np.stack(columns, axis=-1)
    return add(between, np.zeros_like(between))
