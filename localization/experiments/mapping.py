"""`python -m localization.experiments mapping`: maps learned from drives in simulated rooms, against the true ones.

A trial drives a robot along waypoints of a world, as a person would who sees the room, and records the connection as
`record=` does. The map is learned from the recording alone; the ground truth is used to drive and to compare.

    found     a wall of the world, of which half of the visible length has a learned wall within 1 in and 2 degrees
    false     a learned wall, of which less than half is within 1 in of a wall of the world
    offset    distance between both at the middle of the learned one, after the best rigid fit of the walls (no scale)
    path      root mean square distance of the path from the true one, after the best rigid fit of the path

With the setup *building* a wall of the world is a plane that nothing reflects at: its surface has levels, half an inch
from it in the median, and up to 3 in. There the true wall is that plane, shifted to the mean of its surface beside the
measured parts of the learned line; its ends are where two such lines meet. The best rigid fit is that of the measured
spots to the surfaces.

The frame of a map is free, and so is the path in it: while the turret keeps its direction, a shift of the path is the
same as offsets of the sonars by the cosine of their angles.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from math import hypot, radians
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from localization.experiments.execution import add_choice, add_shared, executor_for, parser_of, progress, text_table
from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig, sonar_of
from localization.filters.belief import (
    HEADING,
    Floats,
    compose,
    independent,
    relative_pose,
    rigid_fit,
    rotate,
    wrap_angle,
)
from localization.filters.sonar_cone import ConeSonar, building_sonar
from localization.live.assumptions import BUILDING_SETUP, RING_SETUPS
from localization.live.localizer import Localizer
from localization.live.sensor_input import FiringSchedule, SensorData
from localization.mapping import measurements
from localization.mapping.explore import Explorer
from localization.mapping.learn import learn_map
from localization.mapping.live import LiveMapper
from localization.mapping.measurements import DriveLog
from localization.mapping.output import LearnedMap, describe
from localization.mapping.survey import survey
from localization.navigation.control_law import MODEL_LIMITS
from localization.navigation.waypoints import COMMAND_TIMEOUT_S, Navigator, stop_on_exit, wait_for_next_state
from nclient import connect
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.state import Truth
from nserver_emu.simulation.acoustics import Polaroid, Surfaces
from nserver_emu.simulation.noise import SETUPS as SIMULATIONS
from worlds.geometry import lengths, nearest_points, polygon_segments
from worlds.io import format_world, load_world
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150
from worlds.world import Polygon, StartPose, World

Point = tuple[float, float]

TOURS: Final[dict[str, tuple[Point, ...]]] = {
    "thesis_room": ((60, 40), (84, 84), (6, 84), (6, 6), (84, 6), (84, 84), (45, 45), (6, 45), (60, 10), (84, 45),
                    (20, 84), (0, 0), (45, 20), (84, 20), (84, 70), (30, 70)),
    "several_walls": ((30, 20), (35, 6), (32, 22), (-1, 24), (32, 24), (35, 56), (-1, 56), (4, 84), (44, 86), (44, 60),
                      (76, 58), (76, 86), (86, 42), (64, 42), (63, 6), (86, 6), (63, 8), (63, 42), (40, 55), (0, 57),
                      (20, 70)),
    "centre_vertex": ((10, 60), (84, 60), (80, 6), (70, 20), (84, 84), (45, 45), (6, 84), (24, 30), (14, 4), (6, 45),
                      (60, 60), (84, 70), (84, 20), (50, 45), (30, 50), (20, 20)),
}  # fmt: skip
"""Waypoints along all walls and past all vertices; at most 300 s of driving."""
LONG_TOURS: Final[dict[str, tuple[Point, ...]]] = {
    "corridor": ((200, 39), (1530, 39), (1530, 45), (39, 39)),
    "hall": ((100, 50), (394, 50), (394, 370), (50, 370), (50, 50), (236, 50)),
}
"""Waypoints there and back, and around four pillars by 34 m and on along the first leg, for `--time-limit 900`."""
LOOPS: Final = {"corridor": "40 m there and back", "hall": "34 m around four pillars"}
LONG_STARTS: Final = {"corridor": 2, "hall": 1}
"""Number of the start of those drives; of others the first."""
FRESH_TOURS: Final[dict[str, tuple[Point, ...]]] = {
    "thesis_room": ((60, 40), (80, 80), (0, 60), (0, 0)),
    "several_walls": ((35, 20), (35, 55), (75, 55), (35, 60), (20, 20)),
    "centre_vertex": ((10, 60), (60, 60), (80, 20), (60, 70)),
}
"""Waypoints of the drive that compares localization on the learned and on the true map."""
TIME_LIMIT_S: Final = 300.0
FLAT, EMPTY_FLAT, BOXES = "flat", "empty_flat", "boxes"
"""Worlds that are explored only."""
BOX_ROOM: Final = World(
    BOXES, "A room with two boxes and a post",
    rooms=(Polygon(((0.0, 0.0), (142.0, 0.0), (142.0, 114.0), (0.0, 114.0))),),
    obstacles=(
        Polygon(((40.0, 64.0), (52.0, 64.0), (52.0, 76.0), (40.0, 76.0)), "box"),
        Polygon(((92.348, 35.641), (109.568, 43.671), (103.652, 56.359), (86.432, 48.329)), "box askew"),
        Polygon(((103.0, 85.0), (105.0, 85.0), (105.0, 87.0), (103.0, 87.0)), "post"),
    ),
    starts=(StartPose(22.0, 24.0),),
)  # fmt: skip
"""142 by 114 in; boxes of 12 by 12 and, askew, of 19 by 14 in; a post of 2 by 2 in."""
EMPTY_FLAT_WORLD: Final = World(
    EMPTY_FLAT, "A corridor and four rooms",
    rooms=(Polygon(((0.0, 0.0), (472.0, 0.0), (472.0, 354.0), (0.0, 354.0))),),
    obstacles=(
        Polygon(((0.0, 146.0), (157.0, 146.0), (157.0, 151.0), (0.0, 151.0)), "wall"),
        Polygon(((195.0, 146.0), (232.0, 146.0), (232.0, 85.0), (237.0, 85.0), (237.0, 146.0), (315.0, 146.0),
                 (315.0, 151.0), (195.0, 151.0)), "wall"),
        Polygon(((232.0, 0.0), (237.0, 0.0), (237.0, 47.0), (232.0, 47.0)), "wall"),
        Polygon(((352.0, 146.0), (472.0, 146.0), (472.0, 151.0), (352.0, 151.0)), "wall"),
        Polygon(((0.0, 203.0), (79.0, 203.0), (79.0, 208.0), (0.0, 208.0)), "wall"),
        Polygon(((116.0, 203.0), (374.0, 203.0), (374.0, 208.0), (276.0, 208.0), (276.0, 354.0), (271.0, 354.0),
                 (271.0, 208.0), (116.0, 208.0)), "wall"),
        Polygon(((411.0, 203.0), (472.0, 203.0), (472.0, 208.0), (411.0, 208.0)), "wall"),
        Polygon(((181.0, 284.0), (228.4, 268.0), (234.4, 286.0), (187.0, 302.0)), "cabinet"),
    ),
    starts=(StartPose(63.0, 79.0),),
)  # fmt: skip
"""12 by 9 m without furniture but a cabinet askew; walls 5 in thick, doors of 37 and 38 in, two rooms on a loop."""
OWN_WORLDS: Final = {BOXES: BOX_ROOM, EMPTY_FLAT: EMPTY_FLAT_WORLD}
MIN_BOX_IN: Final = 6.0
"""Shortest side of an obstacle whose outline a map should have; others are posts."""
EXPLORE_IN_S, EXPLORE_RAD_S = 9.0, 0.8
"""Top speeds of `nomad map learn`."""
RADIUS_IN: Final = 2.0
MAX_BEARING_RAD: Final = 0.5
FOUND_IN, FOUND_RAD, FOUND_FRACTION = 1.0, radians(2.0), 0.5
FIT_STEPS: Final = 5
FIT_SPOT_IN: Final = 0.5
"""Learned spots that are farther from a surface count for less in the fit."""
FIT_IN, FIT_RAD = 3.0, radians(10.0)
"""A learned wall is fitted to a true one this near to it."""
SAMPLE_IN: Final = 1.0
MIN_ECHO_IN, NO_ECHO_IN = 6.0, 255.0
CLOSED_IN: Final = 2.0
"""A loop is closed if the last position is so near to where the first one puts it."""
MEETING_IN, MIN_SLOPE = 0.1, 0.1
"""Walls meet if they are nearer than the one, and the sine of the angle between them is larger than the other."""
OTHER_SEED: Final = 10_000
"""Added to the seed of the drive that compares localization, unless surfaces depend on it."""
SETUPS: Final = ("measured", "noisy", "worn", BUILDING_SETUP)
MIN_BESIDE_IN: Final = 4.0
"""Of a wall that is beside a learned one over less, all of the surface counts."""
OFFSETS, WHEELS, READINGS = "offsets", "wheels", "readings"
DISTURBANCES: Final = (OFFSETS, WHEELS, READINGS)
OFFSET_STD_IN, DISTANCE_SCALE, TURN_SCALE, BAD_FRACTION = 1.0, 1.03, 1.02, 0.2
"""Sonars off by a constant each; encoders; fraction of the readings that are random."""


class Trial(NamedTuple):
    """A world, a setup of the simulation, and a seed."""

    world: str
    setup: str
    seed: int
    time_limit_s: float = 300.0
    explores: bool = False
    disturbance: str = ""

    @property
    def rays(self) -> bool:
        """True if the sonars of this setup measure along exact rays."""
        return self.setup not in RING_SETUPS

    @property
    def sonar(self) -> ConeSonar:
        """The sonars, as `--sonars` gives them."""
        return building_sonar(N150.ring) if self.setup == BUILDING_SETUP else ConeSonar()

    @property
    def surfaces(self) -> Surfaces | None:
        """The surfaces of the walls; None if they are planes."""
        sonar = SIMULATIONS[self.setup].sonar
        return sonar.surfaces(self.seed) if isinstance(sonar, Polaroid) else None


@dataclass(frozen=True, slots=True)
class Score:
    """A learned map against the true one, inches and degrees.

    Attributes
    ----------
    walls, found, false
        Number of walls of the world that were visible, of those found, and of learned walls that are none.
    missing
        Middles of the walls not found.
    precision
        Fraction of the learned length within 1 in of a wall of the world.
    offsets_in, angles_deg, ends_in, z
        Errors of the learned walls, of their closed ends, and of the offsets over the stated standard deviations.
    seen
        Fraction of the visible length of the world's walls that is near a learned wall.
    contacts
        Number of times that the robot touched something.
    live_seconds
        Processor time of the map and the choice of the way while driving; 0 for waypoints.
    path_in, odometry_in
        RMSE of the learned path and of the encoders, after the best rigid fit each.
    true_map_in, own_map_in
        RMSE of a localization on another drive with the true map and with the learned one.
    boxes, closed, false_outlines
        Number of boxes in the world, of those whose outline the map has closed, all corners within 1 in, and of learned
        outlines that are none.
    closing_in, odometry_closing_in
        Error of the last position in the frame of the first pose, of the learned path and of the encoders.
    """

    trial: Trial
    duration_s: float
    walls: int
    found: int
    false: int
    missing: list[list[float]]
    precision: float
    offsets_in: list[float]
    angles_deg: list[float]
    ends_in: list[float]
    z: list[float]
    seen: float
    path_in: float
    odometry_in: float
    refused: str
    seconds: float
    true_map_in: float
    own_map_in: float
    contacts: int = 0
    live_seconds: float = 0.0
    closing_in: float = 0.0
    odometry_closing_in: float = 0.0
    boxes: int = 0
    closed: int = 0
    false_outlines: int = 0


# A drive.


def world_of(name: str) -> World:
    """Return the world of a trial."""
    return OWN_WORLDS[name] if name in OWN_WORLDS else load_world(name)


def _source_of(name: str, folder: Path) -> str:
    """Return the world of a trial as an address names it: by its name, or a file in a folder."""
    if name not in OWN_WORLDS:
        return name
    path = folder / f"{name}.toml"
    path.write_text(format_world(OWN_WORLDS[name]), encoding="utf-8")
    return str(path)


@dataclass(frozen=True, slots=True)
class Drive:
    """A recorded drive, and the true poses (t, 4): time, x, y, heading."""

    log: DriveLog
    truth: Floats
    contacts: int = 0
    live_seconds: float = 0.0

    def truth_at(self, instants_s: Floats) -> Floats:
        """Return the true poses (k, 3) at instants."""
        columns = [self.truth[:, 1], self.truth[:, 2], np.unwrap(self.truth[:, 3])]
        return np.stack([np.interp(instants_s, self.truth[:, 0], column) for column in columns], axis=-1)


def drive(trial: Trial, points: Sequence[Point], folder: Path) -> Drive:
    """Return a drive along waypoints, steered by the true pose."""
    path = folder / f"{trial.world}_{trial.setup}_{trial.seed}.log"
    start = world_of(trial.world).starts[LONG_STARTS.get(trial.world, 0)]
    navigator = Navigator(points, radius_in=RADIUS_IN)
    truth = []
    source = _source_of(trial.world, folder)
    address = f"sim:{source}?setup={trial.setup}&seed={trial.seed}&start={start.x_in:g},{start.y_in:g}"
    with connect(f"{address}&step_s=0.1&record={path}") as robot, stop_on_exit(robot):
        state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
        robot.set_timeout(COMMAND_TIMEOUT_S)
        while (state.clock_s or 0.0) < trial.time_limit_s:
            seen = robot.truth()
            truth.append((seen.time_s, seen.x_in, seen.y_in, seen.steering_rad))
            command = navigator.command(np.array(truth[-1][1:]))
            if command is None:
                break
            after = robot.drive(translation_in_s=_slowed(command[0], navigator, seen), steering_rad_s=command[1])
            state = wait_for_next_state(robot, state, after, lambda _: None)
    return Drive(measurements.read_drive(path), np.array(truth))


def _timed(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method that adds its processor time to the `seconds` of its object."""

    def run(self: Any, *arguments: Any) -> Any:
        began = time.process_time()
        found = method(self, *arguments)
        self.seconds += time.process_time() - began
        return found

    return run


class _TimedMapper(LiveMapper):
    """A mapper that measures its processor time."""

    seconds = 0.0
    add, solve = _timed(LiveMapper.add), _timed(LiveMapper.solve)


class _TimedExplorer(Explorer):
    """An explorer that measures its processor time."""

    seconds = 0.0
    leg = _timed(Explorer.leg)


def explore(trial: Trial, folder: Path) -> Drive:
    """Return a drive of a robot that explores a world by itself; the truth only compares."""
    path = folder / f"{trial.world}_{trial.setup}_{trial.seed}.log"
    truth, contacts = [], 0
    explorer = _TimedExplorer(N150.radius_in, EXPLORE_IN_S, trial.time_limit_s)
    limits = MODEL_LIMITS["n150"].capped(EXPLORE_IN_S, EXPLORE_RAD_S)

    mappers: list[_TimedMapper] = []

    def mapper_of(collector: measurements.DriveCollector) -> LiveMapper:
        mappers.append(_TimedMapper(collector, THESIS_ODOMETRY, trial.sonar, rays=trial.rays, roughness_in=None))
        return mappers[-1]

    source = _source_of(trial.world, folder)
    address = f"sim:{source}?setup={trial.setup}&seed={trial.seed}&step_s=0.1&record={path}"
    with connect(address) as robot:
        for step, _, log in survey(robot, N150, mapper_of, explorer, limits, lambda _: None):
            seen = robot.truth()
            truth.append((seen.time_s, seen.x_in, seen.y_in, seen.steering_rad))
            contacts = len(log.contacts)
            if step.elapsed_s > trial.time_limit_s:
                break
    return Drive(measurements.read_drive(path), np.array(truth), contacts, explorer.seconds + mappers[-1].seconds)


def disturbed(log: DriveLog, disturbance: str, seed: int) -> DriveLog:
    """Return a drive with systematic errors of its sonars or wheels, or with random readings; the same without one."""
    rng, readings, encoders = np.random.default_rng(seed), log.readings_in.copy(), log.encoders.copy()
    measured = readings < NO_ECHO_IN
    if disturbance == OFFSETS:
        readings += np.where(measured, rng.normal(0.0, OFFSET_STD_IN, len(log.angles_rad))[log.sonars], 0.0)
    elif disturbance == READINGS:
        is_bad = rng.random(len(readings)) < BAD_FRACTION
        readings[is_bad] = rng.uniform(MIN_ECHO_IN, NO_ECHO_IN, int(is_bad.sum()))
    elif disturbance == WHEELS:
        turret = wrap_angle(encoders[:, 4] - encoders[:, 3])
        scales = np.array((DISTANCE_SCALE, DISTANCE_SCALE, TURN_SCALE))
        for row, (one, other) in enumerate(pairwise(log.encoders[:, 1:4])):
            step = relative_pose(one, other)
            step[HEADING] = wrap_angle(step[HEADING])
            encoders[row + 1, 1:4] = compose(encoders[row, 1:4], scales * step)
        encoders[:, 4] = encoders[:, 3] + turret
    return replace(log, encoders=encoders, readings_in=np.clip(np.round(readings), MIN_ECHO_IN, NO_ECHO_IN))


def _slowed(speed_in_s: float, navigator: Navigator, seen: Truth) -> float:
    """Return 0 while the waypoint lies to the side: a robot that rolls meanwhile may circle around it."""
    goal = navigator.goal
    if goal is None:
        return 0.0
    bearing = float(np.arctan2(goal[1] - seen.y_in, goal[0] - seen.x_in))
    return 0.0 if abs(wrap_angle(bearing - seen.steering_rad)) > MAX_BEARING_RAD else speed_in_s


# Comparison.


def fit_error(points: Floats, targets: Floats) -> float:
    """Return the root mean square distance (in) of points from targets after the best rigid fit."""
    turn, shift = rigid_fit(points, targets)
    fitted = rotate(points, np.full(len(points), turn)) + shift
    return float(np.sqrt(np.square(fitted - targets).sum(axis=-1).mean()))


def closing_error(path: Floats, targets: Floats) -> float:
    """Return the error (in) of the last position of a path (n, 3) in the frame of its first pose."""
    ends = [rotate(poses[-1, :2] - poses[0, :2], np.array(-poses[0, 2])) for poses in (path, targets)]
    return float(np.hypot(*(ends[0] - ends[1])))


def map_fit(ends: Floats, walls: Floats, turn: float, shift: Floats) -> tuple[float, Floats]:
    """Return the turn and the shift (2,) that bring learned walls nearest to true ones, across these.

    Parameters
    ----------
    ends
        (n, 2, 2) ends of the learned walls.
    walls
        (m, 4) true walls, or (n, m, 4), those for each learned one.
    turn, shift
        Where to begin: the fit of the path.
    """
    of_each = np.broadcast_to(walls, (len(ends), *walls.shape[-2:]))
    for _ in range(FIT_STEPS):
        # 1. The true wall at each learned one, if there is one.
        placed = rotate(ends.reshape(-1, 2), np.full(2 * len(ends), turn)) + shift
        rows, targets, sizes = [], [], []
        for learned, near in zip(placed.reshape(-1, 2, 2), of_each, strict=True):
            turned = np.array([_turn_between(wall, learned) for wall in near])
            away = np.where(turned < FIT_RAD, nearest_points(learned.mean(axis=0)[None], near)[1][0], np.inf)
            if away.min() < FIT_IN:
                wall = near[away.argmin()]
                normal = np.array((wall[1] - wall[3], wall[2] - wall[0])) / lengths(wall)
                # 2. Distances of both ends from its line, and their derivatives by the turn and the shift.
                for end in learned:
                    rows.append((normal[1] * (end - shift)[0] - normal[0] * (end - shift)[1], *normal))
                    targets.append(normal @ (wall[:2] - end))
                    sizes.append(float(np.hypot(*(learned[1] - learned[0]))) ** 0.5)
        weights = np.array(sizes)
        # Walls in one direction alone leave the shift along it free: it stays.
        jacobian = np.array(rows).reshape(-1, 3) * weights[:, None]
        change = np.linalg.lstsq(jacobian, np.array(targets) * weights, rcond=1e-3)[0]
        turn, shift = turn + float(change[0]), shift + change[1:]
    return turn, shift


def surface_fit(spots: Floats, walls: Floats, surfaces: Surfaces, turn: float, shift: Floats) -> tuple[float, Floats]:
    """Return the turn and the shift (2,) that bring learned spots nearest to the surfaces of the walls, across these.

    By iteratively reweighted least squares, since some spots are of no wall: with the weights of residuals that have a
    Cauchy distribution of FIT_SPOT_IN.

    Parameters
    ----------
    spots
        (k, 2) in the frame of the map.
    walls, surfaces
        (m, 4) true walls, and their surfaces.
    turn, shift
        Where to begin: the fit of the path.
    """
    along = (walls[:, 2:] - walls[:, :2]) / lengths(walls)[:, None]
    left = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    for _ in range(FIT_STEPS):
        # 1. How far each spot is from the surface of the nearest wall that it is beside, and the normal there.
        placed = rotate(spots, np.full(len(spots), turn)) + shift
        off = placed[:, None] - walls[:, :2]
        at, beside = (off * along).sum(axis=-1), (off * left).sum(axis=-1)
        levels = np.stack([
            surfaces.of(wall).level_in(np.clip(of_wall, 0.0, lengths(wall)))
            for wall, of_wall in zip(walls, at.T, strict=True)
        ], axis=-1)  # fmt: skip
        residual = np.where((at > 0.0) & (at < lengths(walls)), beside - levels, np.inf)
        row = np.abs(residual).argmin(axis=1)
        distance, normal = residual[np.arange(len(spots)), row], left[row]
        is_beside = np.isfinite(distance)
        # 2. Their derivatives by the turn about the origin of the map, and by the shift.
        turned = placed - shift
        by_turn = normal[:, 1] * turned[:, 0] - normal[:, 0] * turned[:, 1]
        weight = 1.0 / np.sqrt(1.0 + np.square(distance[is_beside] / FIT_SPOT_IN))
        jacobian = np.column_stack((by_turn, normal))[is_beside] * weight[:, None]
        change = np.linalg.lstsq(jacobian, -distance[is_beside] * weight, rcond=1e-3)[0]
        turn, shift = turn + float(change[0]), shift + change[1:]
    return turn, shift


def visible_samples(walls: Floats, path: Floats) -> list[Floats]:
    """Return points (k, 2) on each wall, SAMPLE_IN apart, that are in sight from some position of a path (n, 2)."""
    found = []
    for x1, y1, x2, y2 in walls:
        count = max(int(np.hypot(x2 - x1, y2 - y1) / SAMPLE_IN), 2)
        samples = np.linspace((x1, y1), (x2, y2), count + 1)
        samples = 0.5 * (samples[1:] + samples[:-1])
        seen = np.zeros(len(samples), dtype=np.bool_)
        for position in path:
            span = samples - position
            away = np.hypot(span[:, 0], span[:, 1])
            distance, _ = cast_rays(np.broadcast_to(position, samples.shape), span / away[:, None], walls)
            seen |= distance > away - 0.01
        found.append(samples[seen])
    return found


def lines_beside(walls: Floats, surfaces: Surfaces | None, part: Floats | None = None) -> Floats:
    """Return walls (m, 4), each shifted to the mean level of its surface, beside a learned part (2, 2) if given."""
    if surfaces is None:
        return walls
    found = []
    for wall in walls:
        length = float(np.hypot(*(wall[2:] - wall[:2])))
        along = (wall[2:] - wall[:2]) / length
        at: Floats = (np.arange(max(int(length / SAMPLE_IN), 2), dtype=np.float64) + 0.5) * SAMPLE_IN
        if part is not None:
            low, high = np.sort((part - wall[:2]) @ along)
            beside = at[(at > low) & (at < high)]
            at = beside if len(beside) * SAMPLE_IN >= MIN_BESIDE_IN else at
        left = np.array((-along[1], along[0]))
        found.append(wall + np.tile(float(surfaces.of(wall).level_in(at).mean()) * left, 2))
    return np.array(found)


def score(trial: Trial, driven: Drive, found: LearnedMap, instants_s: Floats, odometry: Floats) -> dict[str, Any]:
    """Return the numbers of a learned map against the world's walls."""
    walls = world_of(trial.world).walls
    true_path = driven.truth_at(instants_s)[:, :2]
    # 1. The learned walls in the frame of the world.
    turn, shift = _fit_of(found, walls, trial.surfaces, true_path)
    ends = [rotate(wall.ends, np.full(2, turn)) + shift for wall in found.walls]
    beside = _lines_of(found, walls, trial.surfaces, turn, shift)
    sides = [
        (rotate(side.reshape(2, 2), np.full(2, turn)) + shift, walls)
        for outline in found.outlines for side in polygon_segments(outline.corners)
    ]  # fmt: skip
    # 2. Walls of the world: the fraction of the visible samples near a learned wall of the same direction.
    covered, missing, near_samples = 0, [], 0
    samples = visible_samples(walls, true_path[:: max(len(true_path) // 60, 1)])
    visible = [k for k, points in enumerate(samples) if len(points) >= 4]
    for k in visible:
        near = np.zeros(len(samples[k]), dtype=np.bool_)
        for learned, lines in (*zip(ends, beside, strict=True), *sides):
            if _turn_between(lines[k], learned) <= FOUND_RAD:
                places = _moved_onto(samples[k], walls[k], lines[k])
                near |= nearest_points(places, learned.reshape(1, 4))[1][:, 0] <= FOUND_IN
        near_samples += int(near.sum())
        if near.mean() >= FOUND_FRACTION:
            covered += 1
        else:
            missing.append(samples[k].mean(axis=0).round(1).tolist())
    # 3. Learned walls: how much of each is at a wall of the world, and how far off.
    near_length, false = 0.0, 0
    offsets, angles, z, closed = [], [], [], []
    placed: list[tuple[int, Floats, Floats]] = []
    for piece, learned, lines in zip(found.walls, ends, beside, strict=True):
        count = max(int(piece.length_in / SAMPLE_IN), 2)
        points = np.linspace(learned[0], learned[1], count)
        is_near = nearest_points(points, lines)[1].min(axis=1) <= FOUND_IN
        near_length += float(is_near.mean()) * piece.length_in
        if is_near.mean() < FOUND_FRACTION:
            false += 1
            continue
        measured = rotate(piece.measured_ends, np.full(2, turn)) + shift
        number, offset, angle = _error(learned, measured.mean(axis=0), lines)
        placed.append((number, lines[number], learned))
        offsets.append(abs(offset))
        angles.append(abs(angle))
        z.append(offset / max(piece.std_in, 1e-6))
        is_closed = np.array(piece.closed)
        closed += [(number, lines[number], end) for end in learned[is_closed]]
    others = lines_beside(walls, trial.surfaces)
    to_corners = [distance_to_corner(walls, others, placed, *end) for end in closed]
    total = sum(piece.length_in for piece in found.walls)
    return {
        "walls": len(visible), "found": covered, "false": false, "missing": missing,
        "seen": near_samples / max(sum(len(samples[k]) for k in visible), 1),
        "precision": near_length / total if total else 0.0, "offsets_in": offsets, "angles_deg": angles,
        "ends_in": to_corners, "z": z, "path_in": fit_error(found.path[:, :2], true_path),
        "odometry_in": fit_error(odometry, true_path), **_outline_score(world_of(trial.world), found, turn, shift),
    }  # fmt: skip


def distance_to_corner(
    walls: Floats, others: Floats, placed: list[tuple[int, Floats, Floats]], number: int, line: Floats, end: Floats
) -> float:
    """Return how far an end (2,) of a learned wall is from the nearest true corner.

    A wall whose surface stands out by inches in one part is learned as two. Each part ends where the line beside it
    meets that beside the nearest part of the other wall.

    Parameters
    ----------
    walls, others
        (m, 4) true walls, and their lines where nothing was learned.
    placed
        Number of the true wall, its line (4,) and the learned ends (2, 2) of each learned wall.
    number, line
        The true wall of the end, and its line beside the learned one.
    """
    lines = others.copy()
    away = nearest_points(end[None], np.array([learned for _, _, learned in placed]).reshape(-1, 4))[1][0]
    for part in np.argsort(away)[::-1]:
        lines[placed[part][0]] = placed[part][1]
    lines[number] = line
    return float(np.hypot(*(corners_of(walls, lines) - end).T).min())


def _outline_score(world: World, found: LearnedMap, turn: float, shift: Floats) -> dict[str, int]:
    """Return the numbers of boxes, of those whose outline is closed, and of false outlines."""
    boxes = [np.array(solid.corners_in) for solid in world.obstacles if lengths(solid.segments()).min() >= MIN_BOX_IN]
    outlines = [rotate(outline.corners, np.full(4, turn)) + shift for outline in found.outlines]

    def is_of(outline: Floats, box: Floats) -> bool:
        away = np.hypot(*(outline[:, None] - box).transpose(2, 0, 1))
        return bool(max(away.min(axis=0).max(), away.min(axis=1).max()) <= FOUND_IN)

    return {
        "boxes": len(boxes),
        "closed": sum(any(is_of(outline, box) for outline in outlines) for box in boxes),
        "false_outlines": sum(not any(is_of(outline, box) for box in boxes) for outline in outlines),
    }


def _moved_onto(samples: Floats, wall: Floats, line: Floats) -> Floats:
    """Return points (k, 2) on a wall (4,) at the same fractions of the length of a line (4,)."""
    along = wall[2:] - wall[:2]
    fractions = (samples - wall[:2]) @ along / float(along @ along)
    moved: Floats = samples + (1.0 - fractions)[:, None] * (line - wall)[:2] + fractions[:, None] * (line - wall)[2:]
    return moved


def _fit_of(found: LearnedMap, walls: Floats, surfaces: Surfaces | None, true_path: Floats) -> tuple[float, Floats]:
    """Return the turn and the shift (2,) of a learned map into the frame of the world."""
    turn, shift = rigid_fit(found.path[:, :2], true_path)
    if surfaces is not None:
        spots = np.concatenate([np.empty((0, 3)), *(wall.surface for wall in found.walls)])[:, :2]
        return surface_fit(spots, walls, surfaces, turn, shift)
    return map_fit(np.array([wall.ends for wall in found.walls]).reshape(-1, 2, 2), walls, turn, shift)


def _lines_of(found: LearnedMap, walls: Floats, surfaces: Surfaces | None, turn: float, shift: Floats) -> Floats:
    """Return the true walls (n, m, 4) beside the line of each learned wall, which a turn and a shift (2,) place."""
    measured = np.array([wall.measured_ends for wall in found.walls]).reshape(-1, 2)
    placed = (rotate(measured, np.full(len(measured), turn)) + shift).reshape(-1, 2, 2)
    beside = [lines_beside(walls, surfaces, part) for part in placed]
    return np.array(beside).reshape(len(placed), len(walls), 4)


def _turn_between(wall: Floats, learned: Floats) -> float:
    """Return the angle between the directions of two walls, at most a quarter turn."""
    along, other = wall[2:] - wall[:2], learned[1] - learned[0]
    turn = float(np.arctan2(along[1], along[0]) - np.arctan2(other[1], other[0]))
    return abs(wrap_angle(2.0 * turn)) / 2.0


def corners_of(walls: Floats, lines: Floats) -> Floats:
    """Return the ends (c, 2) of walls (m, 4) that are shifted to lines (m, 4): where these meet others."""
    along = (lines[:, 2:] - lines[:, :2]) / lengths(lines)[:, None]
    left = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    found = []
    for row, (place, end) in enumerate(zip(walls.reshape(-1, 2), lines.reshape(-1, 2), strict=True)):
        slope = left @ along[row // 2]
        meeting = np.flatnonzero((nearest_points(place[None], walls)[1][0] < MEETING_IN) & (np.abs(slope) > MIN_SLOPE))
        # So far along the own line the other one is met.
        steps = ((lines[meeting, :2] - end) * left[meeting]).sum(axis=1) / slope[meeting]
        found += [end + step * along[row // 2] for step in steps] or [end]
    return np.array(found).reshape(-1, 2)


def _error(learned: Floats, middle: Floats, walls: Floats) -> tuple[int, float, float]:
    """Return the number of the nearest wall of about the direction of a learned one (2, 2), offset (in), angle (deg).

    The offset is that at the middle (2,) of the part that was measured, of which the stated deviation is.
    """
    parallel = np.array([_turn_between(wall, learned) < radians(20.0) for wall in walls])
    away = nearest_points(middle[None], walls)[1][0]
    number = int((np.where(parallel, away, np.inf) if parallel.any() else away).argmin())
    near = walls[number]
    along = (near[2:] - near[:2]) / lengths(near)
    off = middle - near[:2]
    across = float(off[1] * along[0] - off[0] * along[1])
    return number, across, float(np.degrees(_turn_between(near, learned)))


def localization_error(driven: Drive, world: World, turn: float, shift: Floats, setup: str) -> float:
    """Return the RMSE of a localization on a drive, in a map that a turn and a shift bring into the world's frame."""
    clock = driven.log.encoders[:, 0]
    true = driven.truth_at(clock)
    # 1. The true start in the frame of the map.
    begin = rotate(true[0, :2] - shift, np.array(-turn))
    start = independent(np.array((*begin, true[0, 2] - turn)), np.array((0.5, 0.5, radians(2.0))))
    ring = building_sonar(N150.ring) if setup == BUILDING_SETUP else sonar_of(N150.ring, rays=setup not in RING_SETUPS)
    config = LocalizationConfig.in_world(world, N150, THESIS_ODOMETRY, ring)
    localizer = Localizer(config, start, FiringSchedule(float(clock[0])))
    # 2. The states of the recording again. Each shows the last reading of each sonar.
    readings = [255.0] * len(driven.log.angles_rad)
    found, echo = [], 0
    for clock_s, x, y, heading, turret in driven.log.encoders.tolist():
        while echo < len(driven.log.instants_s) and driven.log.instants_s[echo] <= clock_s:
            readings[int(driven.log.sonars[echo])] = float(driven.log.readings_in[echo])
            echo += 1
        found.append(localizer.update(SensorData(clock_s, x, y, heading, turret, tuple(readings))).pose[:2])
    estimate = rotate(np.array(found), np.full(len(found), turn)) + shift
    return float(np.sqrt(np.square(estimate - true[:, :2]).sum(axis=-1).mean()))


def run(trial: Trial) -> tuple[Trial, Score]:
    """Run a trial."""
    with tempfile.TemporaryDirectory() as folder:
        tours = TOURS | LONG_TOURS
        driven = explore(trial, Path(folder)) if trial.explores else drive(trial, tours[trial.world], Path(folder))
        fresh = None
        if trial.world in FRESH_TOURS:
            # Another seed would be another building.
            seed = trial.seed if trial.surfaces is not None else trial.seed + OTHER_SEED
            fresh = drive(trial._replace(seed=seed), FRESH_TOURS[trial.world], Path(folder))
    # 1. The map, from the recording alone.
    began = time.process_time()
    log = disturbed(driven.log, trial.disturbance, trial.seed)
    estimate = learn_map(log, THESIS_ODOMETRY, trial.sonar, rays=trial.rays)
    found = describe(estimate)
    seconds = time.process_time() - began
    # 2. Against the truth.
    trajectory = estimate.problem.trajectory
    numbers = score(trial, driven, found, trajectory.instants_s, trajectory.odometry[:, :2])
    true_path = driven.truth_at(trajectory.instants_s)
    closing = (closing_error(found.path, true_path), closing_error(trajectory.odometry, true_path))
    turn, shift = _fit_of(found, world_of(trial.world).walls, trial.surfaces, true_path[:, :2])
    own = true = math.nan
    if fresh is not None:
        if found.walls:
            own = localization_error(fresh, found.world("own"), turn, shift, trial.setup)
        true = localization_error(fresh, load_world(trial.world), 0.0, np.zeros(2), trial.setup)
    duration = float(driven.log.encoders[-1, 0] - driven.log.encoders[0, 0])
    return trial, Score(trial, duration, **numbers, refused=found.reason_to_refuse(), seconds=seconds,
                        true_map_in=true, own_map_in=own,
                        contacts=driven.contacts, live_seconds=driven.live_seconds, closing_in=closing[0],
                        odometry_closing_in=closing[1])  # fmt: skip


# The table.


def table(scores: Sequence[Score]) -> list[list[str]]:
    """Return rows of requirement, required, and what was measured in each setup."""
    columns: dict[str, list[Score]] = {}
    for score in scores:
        columns.setdefault(f"{score.trial.setup} {score.trial.disturbance}".strip(), []).append(score)
    parts = {name: summarize(part, name) for name, part in columns.items()}
    # A row that one of them lacks, since it drove in other worlds, stays empty there.
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for name, part in parts.items():
        for requirement, required, measured in part:
            rows.setdefault((requirement, required), {})[name] = measured
    return [[*row, *(values.get(name, "") for name in parts)] for row, values in rows.items()]


def summarize(scores: Sequence[Score], name: str = "measured") -> list[list[str]]:
    """Return rows of requirement, required, and what was measured, under a name."""
    offsets, angles, ends, z = (
        np.concatenate([getattr(score, name) for score in scores])
        for name in ("offsets_in", "angles_deg", "ends_in", "z")
    )
    path = np.array([score.path_in for score in scores])
    worse = np.array([score.own_map_in - score.true_map_in for score in scores])
    worse = worse[np.isfinite(worse)]
    localized = f"{np.median(worse):.3f}, {worse.max():.2f}" if len(worse) else "no run"
    return [
        ["requirement", "required", name],
        ["runs", "100", str(len(scores))],
        *_rows_of_walls(scores),
        ["visible length found: mean, worst", "90 % of a flat", _shares([score.seen for score in scores])],
        *_rows_of_boxes(scores),
        *_rows_of_exploration([score for score in scores if score.trial.explores]),
        ["false walls", "1 in 50 runs", f"{sum(score.false for score in scores)} in {len(scores)} runs"],
        ["precision: mean, worst", "99 %, 90 %", _shares([score.precision for score in scores])],
        ["offset: median, worst (in)", "0.1, 0.5", f"{np.median(offsets):.3f}, {offsets.max():.2f}"],
        ["angle: median, worst (deg)", "0.2, 2", f"{np.median(angles):.3f}, {angles.max():.2f}"],
        ["ends: median (in)", "0.15", f"{np.median(ends):.3f}"],
        ["path RMSE: median, worst (in)", "0.3, 0.5", f"{np.median(path):.3f}, {path.max():.2f}"],
        ["runs with a path RMSE above 3 in", "0", str(int((path > 3.0).sum()))],
        ["odometry RMSE: median, worst (in)", "", _range([score.odometry_in for score in scores])],
        *_rows_of_loops([score for score in scores if score.trial.world in LONG_TOURS]),
        ["localization, own less true map (in)", "0.05, 0.15", localized],
        ["stated standard deviations: rms z", "0.8 to 1.5", f"{np.sqrt(np.square(z).mean()):.2f}"],
        ["maps refused", "", str(sum(bool(score.refused) for score in scores))],
        ["duration: median, worst (s)", "300", _range([score.duration_s for score in scores])],
        ["processor: median, worst (s)", "10 % of the drive", _range([score.seconds for score in scores])],
    ]


def _rows_of_walls(scores: Sequence[Score]) -> list[list[str]]:
    """Return the rows about the walls that were found, for the worlds that were driven in."""
    rows = list[list[str]]()
    if small := [score for score in scores if score.trial.world in ("thesis_room", "centre_vertex")]:
        complete = sum(score.found == score.walls for score in small)
        rows.append(["thesis_room, centre_vertex: runs with all walls", "99 %", f"{complete} of {len(small)}"])
    if several := [score for score in scores if score.trial.world == "several_walls"]:
        found, walls = sum(score.found for score in several), sum(score.walls for score in several)
        rows.append(["several_walls: walls found", "95 %", f"{found} of {walls}"])
        inner = sum(all(hypot(x + 1.0, y - 40.0) > 8.0 for x, y in score.missing) for score in several)
        rows.append(["several_walls: the wall at y = 40", "90 % of the runs", f"{inner} of {len(several)}"])
    return rows


def _rows_of_boxes(scores: Sequence[Score]) -> list[list[str]]:
    """Return the rows of closed outlines; none without boxes or outlines."""
    boxes, false = sum(score.boxes for score in scores), sum(score.false_outlines for score in scores)
    if not boxes + false:
        return []
    return [["outlines of boxes closed", "90 %", f"{sum(score.closed for score in scores)} of {boxes}"],
            ["false outlines", "0", str(false)]]


def _rows_of_loops(scores: Sequence[Score]) -> list[list[str]]:
    """Return the rows of long drives that come back, for each world; none without any."""
    rows = list[list[str]]()
    for world in dict.fromkeys(score.trial.world for score in scores):
        own = [score for score in scores if score.trial.world == world]
        written = [score for score in own if not score.refused]
        closed = sum(score.closing_in < CLOSED_IN for score in written)
        rows += [
            [f"loops of {LOOPS[world]} closed", "8 of 10", f"{closed} of {len(own)}"],
            [f"{world}: the others written", "0", f"{len(written) - closed}"],
            [f"{world}: closing error, median, worst (in)", "", _middle_and_worst([each.closing_in for each in own])],
            [f"{world}: that of the odometry (in)", "",
             _middle_and_worst([each.odometry_closing_in for each in own])],
        ]  # fmt: skip
    return rows


def _middle_and_worst(values: Sequence[float]) -> str:
    return f"{np.median(values):.2f}, {max(values):.2f}"


def _rows_of_exploration(explored: Sequence[Score]) -> list[list[str]]:
    """Return the rows about runs that explored by themselves."""
    if not explored:
        return []
    live = [score.live_seconds / score.duration_s for score in explored]
    return [["contacts", "0 in 100 runs", f"{sum(score.contacts for score in explored)} in {len(explored)} runs"],
            ["processor while driving: mean, worst", "10 %", f"{np.mean(live):.1%}, {max(live):.1%}"]]


def _shares(values: Sequence[float]) -> str:
    return f"{np.mean(values):.1%}, {min(values):.1%}"


def _range(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f}, {max(values):.1f}"


def main(arguments: Sequence[str]) -> None:
    """Run the command; errors of files are propagated."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if unguided := [name for name in options.worlds if name not in TOURS | LONG_TOURS and not options.explore]:
        parser.error(f"{' and '.join(unguided)} have no waypoints: add --explore")
    trials = [
        Trial(world, setup, seed, options.time_limit, options.explore, options.disturb or "")
        for world in options.worlds
        for setup in options.setups
        for seed in range(options.first, options.first + options.seeds)
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "mapping.json"
    scores = [score for earlier in options.add for score in read_scores(earlier)]
    done = {score.trial for score in scores}
    trials = [trial for trial in trials if trial not in done]
    with progress(len(trials), "mapping", "trials") as tally:
        for _, result in executor_for(run, options)(trials):
            scores.append(result)
            # After each, so that a run that is ended has those so far.
            file.write_text(json.dumps([asdict(found) for found in scores], indent=1) + "\n", encoding="utf-8")
            tally(1)
    found = [asdict(score) for score in scores]
    print(json.dumps(found) if options.json else text_table(table(scores)), flush=True)
    print(f"written: {file}", file=sys.stderr if options.json else sys.stdout, flush=True)


def read_scores(file: Path) -> list[Score]:
    """Return the scores in a file of this command."""
    rows: list[dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))
    return [Score(**{**row, "trial": Trial(*row["trial"])}) for row in rows]


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("mapping", "--seeds 10 --worlds thesis_room",
                       "Learn maps from drives along waypoints in simulated rooms and compare them with the true ones.")
    add_choice(parser, "--worlds", (*TOURS, *LONG_TOURS, FLAT, *OWN_WORLDS), list(TOURS),
               f"worlds; {FLAT}, {BOXES} and {EMPTY_FLAT} with --explore alone")
    parser.add_argument("--explore", action="store_true", help="explore instead of driving along waypoints")
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, metavar="S",
                        help="end a drive after this time in s (default: %(default)s)")  # fmt: skip
    add_choice(parser, "--setups", SETUPS, ["measured"], "setups of the simulation")
    add_choice(parser, "--disturb", DISTURBANCES, None, "make recordings worse before the map is learned: sonars off "
               "by 1 in (rms), wheels 3 %% off, or a fifth of the readings random")
    parser.add_argument("--add", type=Path, nargs="+", default=[], metavar="FILE",
                        help="add the runs in these files of earlier results, and do not repeat them")  # fmt: skip
    parser.add_argument("--first", type=int, default=100, metavar="N", help="first seed (default: %(default)s)")
    add_shared(parser, Path("out/experiments"), "trial")
    return parser


