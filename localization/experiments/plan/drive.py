"""One drive from start to goal as `nomad go` does it, in a simulation of its own, and what came of it in truth.

Contact is the truth's: a bumper that touched in any state, or a true place nearer to a wall than the body is wide. The
shortest way is the shortest for the bare body, without any margin.
Rules: speaks to the robot through nclient; the truth is asked for beside and never reaches whoever drives.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from math import hypot, inf
from pathlib import Path
from typing import Final

import numpy as np

from localization.driving.navigation import PERIOD_S
from localization.experiments.live.scenario import START_STD
from localization.experiments.plan.pairs import METHOD, SPEED_IN_S, Ends, Pair, ends_of
from localization.filters.base import LocalizationConfig
from localization.filters.belief import add, independent
from localization.filters.odometry import with_parameters
from localization.missions.helm import Helm, Sight
from localization.missions.mission import Mission
from localization.missions.running import run_mission
from localization.missions.settings import Settings
from localization.planning.roadmap import Roadmap, length_in
from nclient import connect
from nclient.robot import Robot
from nclient.robot_state import Truth
from worlds.bodies import N150
from worlds.files import load_world
from worlds.world import World

EXCHANGES_A_PERIOD: Final = 2
LIMIT_S: Final = 300.0
START: Final = 3
"""Stream of a pair's chance from which the error of the first estimate is drawn."""


@dataclass(frozen=True, slots=True)
class Driven:
    """What is kept of a drive. `ending`: "done" where it arrived; `least_in`: the least true room between body and
    walls; `off_in`: from the goal, in truth; lengths in inches, `driven_in` in truth."""

    world: str
    number: int
    ending: str
    reason: str
    touched: bool
    least_in: float
    off_in: float
    shortest_in: float
    planned_in: float
    driven_in: float
    plans: int
    duration_s: float

    @property
    def contact(self) -> bool:
        """Whether anything was touched."""
        return self.touched or self.least_in <= 0.0


class _Onlooker:
    """Asks for the truth in every period."""

    def __init__(self, robot: Robot, world: World) -> None:
        self._robot, self._world = robot, world
        self.touched, self.least_in, self.way_in = False, inf, 0.0
        self.last: Truth = robot.truth()

    def __call__(self, sight: Sight) -> None:
        truth = self._robot.truth()
        self.way_in += hypot(truth.x_in - self.last.x_in, truth.y_in - self.last.y_in)
        self.last = truth
        self.touched |= sight.state.touching
        self.least_in = min(self.least_in, self._world.clearance(truth.x_in, truth.y_in) - N150.radius_in)


def drive(pair: Pair) -> tuple[Pair, Driven]:
    """Drive a pair here and now."""
    world, ends = load_world(pair.world), ends_of(pair)
    start = f"{ends.start[0]},{ends.start[1]},{ends.heading_deg},{ends.heading_deg}"
    with tempfile.TemporaryDirectory() as folder:
        setup = Path(folder) / "setup.toml"
        setup.write_text(pair.errs.setup(pair.number), encoding="utf-8")
        step_s = PERIOD_S / EXCHANGES_A_PERIOD
        address = f"sim:{pair.world}?setup={setup}&seed={pair.number}&start={start}&step_s={step_s}"
        with connect(address) as robot, _helm(robot, world, pair) as helm:
            onlooker = _Onlooker(robot, world)
            helm.watchers.append(onlooker)
            mission = Mission(helm, Settings(time_limit_s=LIMIT_S))
            run_mission(mission, lambda driver: driver.go_to(*ends.goal))
    return pair, _driven(pair, world, ends, mission, onlooker)


def _helm(robot: Robot, world: World, pair: Pair) -> Helm:
    """The helm of a robot that stands a little beside where it believes to be; time passes with exchanges alone."""
    errs, state = pair.errs, robot.refresh()
    off = np.array(START_STD) * np.random.default_rng([pair.number, START]).standard_normal(3)
    guess = add(np.array([state.x_in, state.y_in, state.steering_rad]), off)
    belief = with_parameters(independent(guess, START_STD), errs.constants)
    known = LocalizationConfig(world.walls, N150, errs.odometry, errs.sonar)
    return Helm(robot, known, N150, belief, lambda _: None, METHOD, SPEED_IN_S)


def _driven(pair: Pair, world: World, ends: Ends, mission: Mission, onlooker: _Onlooker) -> Driven:
    walls = np.asarray(world.walls)
    shortest = length_in(Roadmap(walls, N150.radius_in).path(ends.start, ends.goal))
    report, truth = mission.report, onlooker.last
    return Driven(
        world=pair.world,
        number=pair.number,
        ending=report.ending,
        reason=report.reason,
        touched=onlooker.touched,
        least_in=onlooker.least_in,
        off_in=hypot(truth.x_in - ends.goal[0], truth.y_in - ends.goal[1]),
        shortest_in=shortest,
        planned_in=report.steps[0].planned_in,
        driven_in=onlooker.way_in,
        plans=report.steps[0].plans,
        duration_s=report.duration_s,
    )
