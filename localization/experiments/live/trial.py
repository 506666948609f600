"""One live trial: a robot by its address, driven along a path on its estimate, and what came of it at every period.

Rules: speaks to the robot through nclient; the truth is asked for beside and never reaches the filter. Simulated time
passes with the exchanges alone: two a period, the question and the command, so a trial takes no time to wait.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from localization.belief import Floats, add, difference, independent
from localization.echoes import FiringSchedule
from localization.experiments.live.bad_readings import BadReadings
from localization.experiments.live.scenario import BAD, COURSES, START_STD, Scenario
from localization.localizer import Localizer
from localization.navigation import PERIOD_S, Navigator, Speeds
from localization.surroundings import Surroundings
from localization.systematic import with_constants
from nclient import connect
from nclient.protocol.models import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.robot import Robot
from worlds.bodies import N150
from worlds.files import load_world
from worlds.world import World

EXCHANGES_A_PERIOD: Final = 2
MOST_PERIODS: Final = 3000
"""Five minutes: longer than any path takes three times over."""
START: Final = 0
"""Stream of a seed's chance from which the error of the first estimate is drawn."""


@dataclass(frozen=True, slots=True)
class Record:
    """A trial of T periods: `way_in` (T,) gone so far, `truth`, `encoders` and `mean` (T, 3), `cov` (T, 3, 3)."""

    seed: int
    reached: bool
    way_in: Floats
    truth: Floats
    encoders: Floats
    mean: Floats
    cov: Floats

    @property
    def error(self) -> Floats:
        """Estimate less truth (T, 3)."""
        return difference(self.mean, self.truth)


def drive(scenario: Scenario, figure: str, seed: int) -> Record:
    """Run one trial in a simulation of its own."""
    world = load_world(COURSES[figure])
    start = world.paths[figure].start
    pose = f"{start.x_in},{start.y_in},{np.degrees(start.steering_rad)},{np.degrees(start.turret_rad)}"
    with tempfile.TemporaryDirectory() as folder:
        setup = Path(folder) / "setup.toml"
        setup.write_text(scenario.setup(seed), encoding="utf-8")
        step_s = PERIOD_S / EXCHANGES_A_PERIOD
        with connect(f"sim:{world.name}?setup={setup}&seed={seed}&start={pose}&step_s={step_s}") as robot:
            return _follow(robot, scenario, world, figure, seed)


def _follow(robot: Robot, scenario: Scenario, world: World, figure: str, seed: int) -> Record:
    start = world.paths[figure].start
    state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
    assert state.clock_s is not None
    schedule = FiringSchedule(state.clock_s)
    off = np.array(START_STD) * np.random.default_rng([seed, START]).standard_normal(3)
    guess = add(np.array([start.x_in, start.y_in, start.steering_rad]), off)
    belief = with_constants(independent(guess, START_STD), scenario.constants)
    known = Surroundings(world.walls, N150, scenario.odometry, scenario.sonar)
    localizer = Localizer(known, belief, schedule, scenario.method, seed)
    shown = BadReadings(scenario.bad_share, schedule, np.random.default_rng([seed, BAD]))
    navigator = Navigator(world.paths[figure].goals_in, Speeds(translation_in_s=scenario.speed_in_s))
    rows: list[tuple[Floats, Floats, Floats, Floats]] = []
    for _ in range(MOST_PERIODS):
        state, actual = robot.refresh(), robot.truth()
        estimate = localizer.update(shown.of(state))
        truth = np.array([actual.x_in, actual.y_in, actual.steering_rad])
        encoders = np.array([state.x_in, state.y_in, state.steering_rad])
        rows.append((truth, encoders, estimate.pose, estimate.belief.cov[:3, :3]))
        command = navigator.command(estimate.pose)
        if command is None:
            break
        robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
    truths, told, means, covs = (np.stack(column) for column in zip(*rows, strict=True))
    ways = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truths[:, :2], axis=0).T))])
    return Record(seed, navigator.finished, ways, truths, told, means, covs)
