"""`python -m localization.experiments plan`: simulated drives between random positions, on the estimate, with noise.

Contacts are judged by the ground truth: a bumper that touched, or a true position nearer to a wall than the radius.
The shortest path is that of the bare body, without any margin.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import hypot, inf, radians
from pathlib import Path
from statistics import mean
from typing import Any, Final

import numpy as np

from localization.cli.arguments import make_folder
from localization.experiments import execution
from localization.experiments.execution import ResultCache, code_hash, progress, run_cached
from localization.experiments.live_trial import SCENARIOS, START_STD, simulated_robot
from localization.filters.base import LocalizationConfig
from localization.filters.belief import add, independent
from localization.filters.odometry import with_parameters
from localization.navigation.mission import Mission, run_mission
from localization.navigation.path import total_length_in, wall_distances
from localization.navigation.pilot import Observation, RobotController, Settings
from localization.navigation.roadmap import Roadmap
from nclient.common.arguments import add_value
from nclient.robot import Robot
from nclient.state import Pose, Truth
from worlds.geometry import inside, polygon_segments
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import World

# Space between the body and all walls at both ends of a drive, inches.
SPACE_IN: Final = 1.5
# Minimum distance of start and goal, inches: a shorter drive says nothing about planning.
APART_IN: Final = 12.0
WORLDS: Final = ("centre_vertex", "several_walls", "thesis_room")
"""Worlds of the published results; the seeds of a drive are those of a world's place in this list."""
# Speed limit of all drives, inches per second: that of the live trials, so that results compare.
SPEED_IN_S: Final = 5.0
# The filter that can also recover from a wrong estimate.
METHOD: Final = "finder"


@dataclass(frozen=True, slots=True)
class DrivePair:
    """A drive to make.

    Attributes
    ----------
    world
        Name of a shipped world.
    number
        Number of the pair of start and goal in this world, and seed of the simulation.
    scenario
        Name of the error scenario; its outliers are not used.
    """

    world: str
    number: int
    scenario: str


@dataclass(frozen=True, slots=True)
class DriveEnds:
    """Start pose and goal of a drive: inches, degrees."""

    start: tuple[float, float]
    heading_deg: float
    goal: tuple[float, float]


def ends_of(pair: DrivePair) -> DriveEnds:
    """Return random ends with SPACE_IN of space and at least APART_IN apart, decided by world and number."""
    world = load_world(pair.world)
    # The seed is the world's index and the pair's number, so that all scenarios drive the same pairs.
    rng = np.random.default_rng([WORLDS.index(pair.world), pair.number])
    low, high = world.walls[:, :2].min(axis=0), world.walls[:, :2].max(axis=0)
    outline = polygon_segments(world.rooms[0].corners_in)
    walls = np.asarray(world.walls)
    # Rejection sampling: uniform points in the bounding box until both are free, inside and apart.
    while True:
        start, goal = (np.round(rng.uniform(low, high), 1) for _ in range(2))
        heading = float(np.round(rng.uniform(0.0, 360.0), 1))
        free = wall_distances(np.stack((start, goal)), walls).min() >= N150.radius_in + SPACE_IN
        within = bool(np.all(inside(np.stack((start, goal)), outline)))
        if free and within and hypot(*(goal - start)) >= APART_IN:
            return DriveEnds((float(start[0]), float(start[1])), heading, (float(goal[0]), float(goal[1])))


# Several times the duration of the longest drive, simulated seconds.
LIMIT_S: Final = 300.0
START: Final = 3
"""Random stream of the initial estimate's error."""


@dataclass(frozen=True, slots=True)
class DriveResult:
    """Result of a drive.

    Attributes
    ----------
    ending
        "done" if the goal was reached.
    touched
        True after a bumper contact.
    least_in
        Smallest true distance between body and walls.
    off_in
        True distance from the goal at the end.
    shortest_in, planned_in, driven_in
        Length of the shortest path for the bare body, of the first plan, and of the true path.
    plans
        Number of plans.
    duration_s
        Duration of the mission in simulated seconds.
    """

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
        """True if anything was touched, by a bumper or by geometry."""
        return self.touched or self.least_in <= 0.0


class TruthRecorder:
    """Observer that records the ground truth in every period."""

    def __init__(self, robot: Robot, world: World) -> None:
        self._robot, self._world = robot, world
        self.touched, self.least_in, self.distance_in = False, inf, 0.0
        self.last: Truth = robot.truth()

    def __call__(self, observation: Observation) -> None:
        """Record the true distance, contact and clearance of this period."""
        # True path length as a sum of chords, one per period of 0.1 s.
        truth = self._robot.truth()
        self.distance_in += hypot(truth.x_in - self.last.x_in, truth.y_in - self.last.y_in)
        self.last = truth
        # Contact by two independent measures: the bumper, and the distance of the true body from the walls.
        self.touched |= observation.state.touching
        self.least_in = min(self.least_in, self._world.clearance(truth.x_in, truth.y_in) - N150.radius_in)


def drive(pair: DrivePair) -> tuple[DrivePair, DriveResult]:
    """Simulate one drive."""
    world, ends = load_world(pair.world), ends_of(pair)
    heading = radians(ends.heading_deg)
    start = Pose(*ends.start, heading, heading)
    # The same mission code as `nomad go`, observed in every period.
    with (
        simulated_robot(pair.world, SCENARIOS[pair.scenario], pair.number, start) as robot,
        _controller(robot, world, pair) as controller,
    ):
        recorder = TruthRecorder(robot, world)
        controller.observers.append(recorder)
        mission = Mission(controller, Settings(time_limit_s=LIMIT_S))
        run_mission(mission, lambda driver: driver.go_to(*ends.goal))
    return pair, _driven(pair, world, ends, mission, recorder)


def _controller(robot: Robot, world: World, pair: DrivePair) -> RobotController:
    """Return the controller of a robot whose initial estimate has an error drawn from START_STD."""
    errors, state = SCENARIOS[pair.scenario], robot.refresh()
    # The initial error has its own random stream: it is the same in all scenarios.
    off = np.array(START_STD) * np.random.default_rng([pair.number, START]).standard_normal(3)
    guess = add(np.array([state.x_in, state.y_in, state.steering_rad]), off)
    belief = with_parameters(independent(guess, START_STD), errors.constants)
    config = LocalizationConfig(world.walls, N150, errors.odometry, errors.sonar)
    return RobotController(robot, config, N150, belief, lambda _: None, METHOD, SPEED_IN_S)


def _driven(pair: DrivePair, world: World, ends: DriveEnds, mission: Mission, recorder: TruthRecorder) -> DriveResult:
    walls = np.asarray(world.walls)
    # The reference path is planned without margin, so no drivable path is shorter.
    shortest = total_length_in(Roadmap(walls, N150.radius_in).path(ends.start, ends.goal))
    report, truth = mission.report, recorder.last
    return DriveResult(world=pair.world, number=pair.number, ending=report.ending, reason=report.reason,
                       touched=recorder.touched, least_in=recorder.least_in,
                       off_in=hypot(truth.x_in - ends.goal[0], truth.y_in - ends.goal[1]), shortest_in=shortest,
                       planned_in=report.steps[0].planned_in, driven_in=recorder.distance_in,
                       plans=report.steps[0].plans, duration_s=report.duration_s)


NEAR: Final = 1.05
"""Longest acceptable path, relative to the shortest."""


def main(arguments: Sequence[str]) -> None:
    """Run the command; errors of execution and files are propagated."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    # 1. All drives, interleaved by world, so that an interrupted run has some of each.
    requested = [
        DrivePair(world, number, options.scenario) for number in range(options.pairs) for world in options.worlds
    ]
    # 2. Simulate what the cache does not have.
    cache = drive_cache(options.out / "drives", code_hash())
    with progress(len(requested), "plan", "drives") as tally:
        results = run_cached(requested, cache, execution.executor_for(drive, options), tally)
    # 3. Summary per world, as JSON file and as table.
    rows = [row(world, [results[pair] for pair in requested if pair.world == world]) for world in options.worlds]
    content = {"worlds": rows, "drives": [asdict(results[pair]) for pair in requested]}
    text = table(rows, list(results.values()))
    execution.write_results(options, f"plan_{options.scenario}.json", rows, text, content)


def drive_cache(folder: Path, code: str) -> ResultCache[DrivePair, DriveResult]:
    """Return the cache of drives simulated by code with this hash."""
    return ResultCache(folder, code, DriveResult,
                       lambda pair: (f"{pair.world}_{pair.scenario}_{pair.number:04d}", asdict(pair)))


def row(world: str, drives: Sequence[DriveResult]) -> dict[str, Any]:
    """Return the results of a world; path lengths relative to the shortest."""
    # Ratios of 1 mean the shortest path; the driven one includes corrections of the estimate.
    planned = [drive.planned_in / drive.shortest_in for drive in drives]
    driven = [drive.driven_in / drive.shortest_in for drive in drives]
    return {
        "world": world,
        "pairs": len(drives),
        "reached": sum(drive.ending == "done" for drive in drives),
        "contacts": sum(drive.contact for drive in drives),
        "least_room_in": min(drive.least_in for drive in drives),
        "worst_off_in": max(drive.off_in for drive in drives),
        "planned_mean": mean(planned),
        "planned_worst": max(planned),
        "driven_mean": mean(driven),
        "driven_worst": max(driven),
        "driven_near": sum(ratio <= NEAR for ratio in driven),
        "duration_mean_s": mean(drive.duration_s for drive in drives),
    }


_COLUMNS: Final = (
    ("pairs", "pairs", "d"), ("reached", "reached", "d"), ("contacts", "contacts", "d"),
    ("least room (in)", "least_room_in", ".2f"), ("worst off (in)", "worst_off_in", ".2f"),
    ("planned/shortest", "planned_mean", ".4f"), ("worst", "planned_worst", ".4f"),
    ("driven/shortest", "driven_mean", ".4f"), ("worst", "driven_worst", ".4f"), ("within 5 %", "driven_near", "d"),
    ("mean time (s)", "duration_mean_s", ".1f"),
)  # fmt: skip


def table(rows: Sequence[dict[str, Any]], drives: Sequence[DriveResult]) -> str:
    """Return a text table, followed by the drives that failed or touched something."""
    text = [execution.table_of({"world": "world"}, _COLUMNS, rows)]
    text += [
        f"{drive.world} {drive.number}: {drive.ending}{', CONTACT' if drive.contact else ''}: {drive.reason}"
        for drive in drives
        if drive.ending != "done" or drive.contact
    ]
    return "\n".join(text)


def _parser() -> argparse.ArgumentParser:
    parser = execution.parser_of("plan", "--pairs 10 --worlds several_walls",
                                 "Drive a simulated N150 between random positions of the shipped worlds on the "
                                 "estimate, as `nomad go` does, and report arrivals, contacts, and path lengths "
                                 "relative to the shortest path. Results are cached.")
    add_value(parser, "--pairs --seeds", "N", execution.positive, "number of drives in each world", 100)
    execution.add_choice(parser, "--worlds", WORLDS, list(WORLDS), "worlds")
    execution.add_choice(parser, "--scenario", SCENARIOS, "noisy", "error scenario, without its outliers")
    execution.add_execution_options(parser)
    execution.add_output(parser, Path("out/experiments"), "world")
    return parser
