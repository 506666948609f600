"""Starts and goals drawn at random in a world's free room, and what a drive from one to the other is run with. Data.

Both have ROOM_IN between body and walls and are APART_IN apart or more; the heading at the start is any. A pair is
drawn by its world and number alone. What errs is a live scenario's, all but its bad readings.

One drive from start to goal as `nomad go` does it, in a simulation of its own, and what came of it in truth.

Contact is the truth's: a bumper that touched in any state, or a true place nearer to a wall than the body is wide. The
shortest way is the shortest for the bare body, without any margin.
Rules: speaks to the robot through nclient; the truth is asked for beside and never reaches whoever drives.

`python -m localization.experiments plan`: random ways through the shipped worlds, driven with noise on, as a table.

Rules: words and files only; drives are drive's, who runs them is crew's. With --json the rows are alone on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from math import hypot, inf
from pathlib import Path
from statistics import mean
from typing import Any, Final

import numpy as np

from localization.cli.options import make_folder
from localization.experiments.execution import ResultCache, Tally, code_hash, progress
from localization.experiments.live_trial import SCENARIOS, START_STD, Scenario
from localization.experiments.output import add_work, executor_for, positive
from localization.filters.base import LocalizationConfig
from localization.filters.belief import add, independent
from localization.filters.odometry import with_parameters
from localization.missions.controller import Observation, RobotController
from localization.missions.mission import Mission, run_mission
from localization.missions.settings import Settings
from localization.navigation.path import total_length_in, wall_distances
from localization.navigation.roadmap import Roadmap
from localization.navigation.waypoints import PERIOD_S
from nclient import connect
from nclient.robot import Robot
from nclient.state import Truth
from worlds.geometry import inside, polygon_segments
from worlds.io import load_world, world_names
from worlds.robots import N150
from worlds.world import World

ROOM_IN: Final = 1.5
APART_IN: Final = 12.0
WORLDS: Final = world_names()
SPEED_IN_S: Final = 5.0
METHOD: Final = "finder"


@dataclass(frozen=True, slots=True)
class DrivePair:
    """A drive: the world, the number of the pair in it, and the name of what errs (live.scenario)."""

    world: str
    number: int
    scenario: str

    @property
    def errs(self) -> Scenario:
        """What errs and how."""
        return SCENARIOS[self.scenario]


@dataclass(frozen=True, slots=True)
class DriveEnds:
    """Where a drive begins, and where it is to end: inches, degrees."""

    start: tuple[float, float]
    heading_deg: float
    goal: tuple[float, float]


def ends_of(pair: DrivePair) -> DriveEnds:
    """The ends of a pair."""
    world = load_world(pair.world)
    chance = np.random.default_rng([WORLDS.index(pair.world), pair.number])
    low, high = world.walls[:, :2].min(axis=0), world.walls[:, :2].max(axis=0)
    outline = polygon_segments(world.rooms[0].corners_in)
    walls = np.asarray(world.walls)
    while True:
        start, goal = (np.round(chance.uniform(low, high), 1) for _ in range(2))
        heading = float(np.round(chance.uniform(0.0, 360.0), 1))
        free = wall_distances(np.stack((start, goal)), walls).min() >= N150.radius_in + ROOM_IN
        within = bool(np.all(inside(np.stack((start, goal)), outline)))
        if free and within and hypot(*(goal - start)) >= APART_IN:
            return DriveEnds((float(start[0]), float(start[1])), heading, (float(goal[0]), float(goal[1])))


EXCHANGES_A_PERIOD: Final = 2
LIMIT_S: Final = 300.0
START: Final = 3
"""Stream of a pair's chance from which the error of the first estimate is drawn."""


@dataclass(frozen=True, slots=True)
class DriveResult:
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


class TruthRecorder:
    """Asks for the truth in every period."""

    def __init__(self, robot: Robot, world: World) -> None:
        self._robot, self._world = robot, world
        self.touched, self.least_in, self.way_in = False, inf, 0.0
        self.last: Truth = robot.truth()

    def __call__(self, sight: Observation) -> None:
        truth = self._robot.truth()
        self.way_in += hypot(truth.x_in - self.last.x_in, truth.y_in - self.last.y_in)
        self.last = truth
        self.touched |= sight.state.touching
        self.least_in = min(self.least_in, self._world.clearance(truth.x_in, truth.y_in) - N150.radius_in)


def drive(pair: DrivePair) -> tuple[DrivePair, DriveResult]:
    """Drive a pair here and now."""
    world, ends = load_world(pair.world), ends_of(pair)
    start = f"{ends.start[0]},{ends.start[1]},{ends.heading_deg},{ends.heading_deg}"
    with tempfile.TemporaryDirectory() as folder:
        setup = Path(folder) / "setup.toml"
        setup.write_text(pair.errs.setup(pair.number), encoding="utf-8")
        step_s = PERIOD_S / EXCHANGES_A_PERIOD
        address = f"sim:{pair.world}?setup={setup}&seed={pair.number}&start={start}&step_s={step_s}"
        with connect(address) as robot, _helm(robot, world, pair) as controller:
            recorder = TruthRecorder(robot, world)
            controller.observers.append(recorder)
            mission = Mission(controller, Settings(time_limit_s=LIMIT_S))
            run_mission(mission, lambda driver: driver.go_to(*ends.goal))
    return pair, _driven(pair, world, ends, mission, recorder)


def _helm(robot: Robot, world: World, pair: DrivePair) -> RobotController:
    """The helm of a robot that stands a little beside where it believes to be; time passes with exchanges alone."""
    errs, state = pair.errs, robot.refresh()
    off = np.array(START_STD) * np.random.default_rng([pair.number, START]).standard_normal(3)
    guess = add(np.array([state.x_in, state.y_in, state.steering_rad]), off)
    belief = with_parameters(independent(guess, START_STD), errs.constants)
    known = LocalizationConfig(world.walls, N150, errs.odometry, errs.sonar)
    return RobotController(robot, known, N150, belief, lambda _: None, METHOD, SPEED_IN_S)


def _driven(pair: DrivePair, world: World, ends: DriveEnds, mission: Mission, recorder: TruthRecorder) -> DriveResult:
    walls = np.asarray(world.walls)
    shortest = total_length_in(Roadmap(walls, N150.radius_in).path(ends.start, ends.goal))
    report, truth = mission.report, recorder.last
    return DriveResult(
        world=pair.world,
        number=pair.number,
        ending=report.ending,
        reason=report.reason,
        touched=recorder.touched,
        least_in=recorder.least_in,
        off_in=hypot(truth.x_in - ends.goal[0], truth.y_in - ends.goal[1]),
        shortest_in=shortest,
        planned_in=report.steps[0].planned_in,
        driven_in=recorder.way_in,
        plans=report.steps[0].plans,
        duration_s=report.duration_s,
    )


NEAR: Final = 1.05
"""A way is as good as the shortest up to this many times as long."""
Executor = Callable[[Sequence[DrivePair]], Iterator[tuple[DrivePair, DriveResult]]]


def main(arguments: Sequence[str]) -> None:
    """Run the command. Raises what the crew and the files raise."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    wanted = [DrivePair(world, number, options.scenario) for number in range(options.pairs) for world in options.worlds]
    kept = ResultCache(options.out / "drives", code_hash())
    with progress(len(wanted), "plan", "drives") as tally:
        results = collect(wanted, kept, executor_for(drive, options), tally)
    rows = [row(world, [results[pair] for pair in wanted if pair.world == world]) for world in options.worlds]
    written = options.out / f"plan_{options.scenario}.json"
    drives = [asdict(results[pair]) for pair in wanted]
    written.write_text(json.dumps({"worlds": rows, "drives": drives}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(rows) if options.json else table(rows, list(results.values())), flush=True)
    print(f"written: {written}", file=sys.stderr if options.json else sys.stdout, flush=True)


def collect(
    wanted: Sequence[DrivePair], kept: ResultCache, work: Executor, tally: Tally
) -> dict[DrivePair, DriveResult]:
    """All results: from disk, and what is not there by work, kept as it is done."""
    paths = {pair: kept.path(f"{pair.world}_{pair.scenario}_{pair.number:04d}", (asdict(pair),)) for pair in wanted}
    found = {pair: kept.get(path) for pair, path in paths.items()}
    results = {pair: DriveResult(**values) for pair, values in found.items() if values is not None}
    left = [pair for pair in wanted if pair not in results]
    tally(len(results))
    for pair, driven in work(left):
        kept.put(paths[pair], asdict(driven))
        results[pair] = driven
        tally(len(results))
    return results


def row(world: str, drives: Sequence[DriveResult]) -> dict[str, Any]:
    """The numbers of a world; ways as multiples of the shortest."""
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
        "driven_near": sum(share <= NEAR for share in driven),
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
    """For people; the drives that did not arrive, or touched, below."""
    lines = [["world", *(title for title, _, _ in _COLUMNS)]]
    lines += [[row["world"], *(format(row[key], form) for _, key, form in _COLUMNS)] for row in rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    told = ["  ".join(text.rjust(width) for text, width in zip(line, widths, strict=True)) for line in lines]
    told += [
        f"{drive.world} {drive.number}: {drive.ending}{', CONTACT' if drive.contact else ''}: {drive.reason}"
        for drive in drives
        if drive.ending != "done" or drive.contact
    ]
    return "\n".join(told)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments plan",
        description="Drive a simulated N150 between random places of the shipped worlds by the shortest way, on the "
        "estimate, as `nomad go` does, and say whether it arrived, touched anything, and how long its way was "
        "against the shortest there is. Drives that are on disk are not driven again.",
        epilog="example: python -m localization.experiments plan --pairs 10 --worlds several_walls",
    )
    parser.add_argument("--pairs", "--seeds", type=positive, default=100, metavar="N", help="in each world (100)")
    parser.add_argument(
        "--worlds",
        nargs="+",
        choices=WORLDS,
        default=list(WORLDS),
        metavar="WORLD",
        help=f"of {', '.join(WORLDS)} (all)",
    )
    parser.add_argument(
        "--scenario",
        choices=list(SCENARIOS),
        default="noisy",
        help="what errs, without its bad readings (default %(default)s)",
    )
    add_work(parser)
    parser.add_argument(
        "--out", type=Path, default=Path("out/experiments"), metavar="DIR", help="for the numbers (%(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON, alone on stdout")
    return parser
