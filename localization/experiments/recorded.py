"""Recordings of other robots: `python -m localization.experiments ring` and `flights`.

`ring` counts what a ring of sonars without odometry shows of a room. A plane wall reflects into all sonars within half
a cone of its normal at the same range, its perpendicular distance: a run of neighbouring sonars of nearly equal
readings, in the direction of the wall. Such runs, the distances of opposite ones, and what changes from one row to the
next are counted; nothing is estimated.

`flights` learns a map from the flights of a drone with four range sensors, whose order and delay it finds first: with
the right ones the spots of 20 s are on thin walls and occupy the fewest cells of a grid. The map is rated by the
spread of the spots about each wall, by the angles of the walls, and by the distance of what was measured of a wall when
the drone came back from what was measured of it before.

References
----------
Leonard, Durrant-Whyte, Directed Sonar Sensing for Mobile Robot Navigation (1992): regions of constant depth. Zhou, Hu,
Liu, Khan, Efficient 2D Graph SLAM for Sparse Sensing (2022): the flights.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from localization.cli.arguments import make_folder
from localization.experiments.execution import parser_of
from localization.filters.belief import HEADING, Floats, rotate
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import cone_sonar
from localization.live.sensor_input import read_log, without_echo
from localization.mapping.association import MapEstimate
from localization.mapping.consistency import LOOP_NODES, MIN_RETURN_ECHOES
from localization.mapping.learn import learn_log
from localization.mapping.measurements import Indices, drive_of_rows
from localization.mapping.output import LearnedMap, describe, draw_learned
from localization.mapping.problem import COMMON_OFFSET
from localization.plot import check_picture, save
from nclient.common.arguments import add_value
from nclient.common.process import show_seconds
from nclient.errors import LogFileError
from nclient.recording import convert
from worlds.drawing import ESTIMATE, FAINT, TRUTH, blank
from worlds.robots import load_bodies

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NO_ECHO_M: Final = 5.0
RATE_HZ: Final = 9.0
SAME_M: Final = 0.05
"""Neighbouring readings of one wall differ by less."""
MIN_SONARS: Final = 3
"""Sonars of a run: 30 degrees between the axes of the outer ones, two halves of a cone and more."""
JUMP_M: Final = 0.5
"""A reading that changes by more in one row changes by more than the robot can move."""
APART: Final = (3, 9)
"""Directions of two walls that determine a position, in steps of the ring: 45 to 135 degrees."""
OPPOSITE: Final = 1.0
"""Two walls are opposite within so many steps."""
BIN_M, MIN_FRACTION = 0.05, 0.02
"""Bins of the distances of opposite walls; those with a smaller fraction of the pairs are between two widths."""


class Run(NamedTuple):
    """Neighbouring sonars of equal readings: direction of their middle in steps of the ring, number, mean range (m)."""

    direction: float
    sonars: int
    range_m: float


class Width(NamedTuple):
    """A distance of opposite walls that occurs often: number of pairs, their median and standard deviation in m."""

    pairs: int
    median_m: float
    std_m: float


class RingStatistics(NamedTuple):
    """Counts over all rows; fractions are of 1. The field's names are those of the JSON."""

    rows: int
    no_echo: float
    jumps: float
    in_runs: float
    runs_per_row: float
    rows_with_position: float
    median_change_m: float
    opposite_m: tuple[float, ...]
    """Distances of opposite runs, from sonar to sonar."""

    @property
    def widths(self) -> list[Width]:
        """The distances of opposite walls that occur often, in order."""
        distances = np.sort(self.opposite_m)
        bins = np.floor(distances / BIN_M).astype(np.intp)
        often = np.bincount(bins)[bins] >= MIN_FRACTION * len(distances)
        distances, bins = distances[often], bins[often]
        parts = np.split(distances, np.flatnonzero(np.diff(bins) > 1) + 1) if len(distances) else []
        return [Width(len(part), float(np.median(part)), float(part.std())) for part in parts]


def read_ring(path: Path) -> Floats:
    """Return the readings (n, s) of a CSV of ranges in m, whose last column is a label; no echo is inf.

    Raises
    ------
    LogFileError
        If a row has no numbers, or another number of them than the first.
    """
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    try:
        readings = np.array([[float(field) for field in row[:-1]] for row in rows])
    except ValueError as error:
        raise LogFileError(f"{path}: expected ranges in m and a label in each row ({error})") from None
    return np.where(readings >= NO_ECHO_M, np.inf, readings)


def runs_of(row: Floats) -> list[Run]:
    """Return the runs of at least MIN_SONARS neighbouring sonars (s,) whose successive readings differ by < SAME_M."""
    count = len(row)
    following = np.roll(row, -1)
    known = np.isfinite(row) & np.isfinite(following)
    same = np.zeros(count, dtype=np.bool_)
    same[known] = np.abs(row[known] - following[known]) < SAME_M
    if same.all():
        return []
    # The ring is cut where two neighbours differ.
    first = int(np.flatnonzero(~same)[0]) + 1
    parts = np.split(np.arange(first, first + count), np.flatnonzero(~np.roll(same, -first)[:-1]) + 1)
    return [
        Run(float((part[0] + part[-1]) / 2.0 % count), len(part), float(row[part % count].mean()))
        for part in parts if len(part) >= MIN_SONARS
    ]  # fmt: skip


def statistics_of(readings: Floats) -> RingStatistics:
    """Return the statistics of the readings (n, s) of a ring of equal angles."""
    count = readings.shape[1]
    per_row = [runs_of(row) for row in readings]
    position, opposite = 0, list[float]()
    for runs in per_row:
        apart = [
            (abs((one.direction - other.direction + count / 2) % count - count / 2), one.range_m + other.range_m)
            for number, one in enumerate(runs) for other in runs[:number]
        ]  # fmt: skip
        position += any(APART[0] <= steps <= APART[1] for steps, _ in apart)
        opposite += [width for steps, width in apart if steps >= count / 2 - OPPOSITE]
    both = np.isfinite(readings[1:]) & np.isfinite(readings[:-1])
    change = np.abs(readings[1:][both] - readings[:-1][both]) if both.any() else np.zeros(1)
    return RingStatistics(len(readings), float(np.isinf(readings).mean()), float((change > JUMP_M).mean()),
                          sum(run.sonars for runs in per_row for run in runs) / readings.size,
                          sum(map(len, per_row)) / len(readings), position / len(readings), float(np.median(change)),
                          tuple(opposite))  # fmt: skip


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    parser = parser_of("ring", "--data scitos_ring24/scitos_ring24.csv",
                       "Count what a ring of 24 sonars without odometry shows of a room: walls, distances of opposite "
                       "ones, readings without echo.")
    parser.add_argument("--data", type=Path, required=True, metavar="CSV",
                        help="ranges in m and a label in each row (docs/real-data.md)")  # fmt: skip
    parser.add_argument("--row", type=int, default=0, metavar="N", help="row that --picture shows (default: 0)")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw a row and the distances of opposite walls")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    check_picture(options.picture)
    readings = read_ring(options.data)
    found = statistics_of(readings)
    if options.picture:
        save(_picture(readings[options.row], found), options.picture)
    print(json.dumps(found._asdict()) if options.json else _text(found), flush=True)


def _text(found: RingStatistics) -> str:
    widths = ", ".join(f"{width.median_m:.2f} m ({width.pairs}, ± {width.std_m:.2f} m)" for width in found.widths)
    return "\n".join((
        f"{found.rows} rows, {found.rows / RATE_HZ:.0f} s",
        f"readings without echo: {found.no_echo:.1%}",
        f"readings that change by more than {JUMP_M:g} m in one row: {found.jumps:.1%}; "
        f"median change {found.median_change_m:g} m",
        f"readings in runs, which walls give: {found.in_runs:.0%}",
        f"runs in a row: {found.runs_per_row:.2f}",
        f"rows with walls in two directions: {found.rows_with_position:.0%}",
        f"pairs of opposite walls: {len(found.opposite_m)}; distances from sonar to sonar that occur often: {widths}",
    ))  # fmt: skip


def _picture(row: Floats, found: RingStatistics) -> Figure:
    """Draw one row with its runs, and the distances of opposite walls."""
    figure: Any = blank(9.0, 4.0)
    ring, widths = figure.subplots(1, 2)
    step = 2.0 * np.pi / len(row)
    angles = step * np.arange(len(row))
    for angle, range_m in zip(angles, np.minimum(row, NO_ECHO_M), strict=True):
        ring.plot((0.0, range_m * np.cos(angle)), (0.0, range_m * np.sin(angle)), color=FAINT, linewidth=1.0)
    is_measured = np.isfinite(row)
    x, y = row * np.cos(angles), row * np.sin(angles)
    ring.plot(x[is_measured], y[is_measured], "o", color=ESTIMATE, markersize=3)
    for run in runs_of(row):
        # The wall: as long as what the sonars of the run reach, at a right angle to the direction of its middle.
        half = run.range_m * np.tan(min(0.5 * (run.sonars - 1) * step, 1.0))
        c, s = np.cos(run.direction * step), np.sin(run.direction * step)
        ring.plot((run.range_m * c - half * s, run.range_m * c + half * s),
                  (run.range_m * s + half * c, run.range_m * s - half * c), color=TRUTH, linewidth=2.0)  # fmt: skip
    ring.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    widths.hist(found.opposite_m, bins=np.arange(1.0, 5.0, 0.1).tolist(), color=FAINT)
    widths.set(xlabel="distance of opposite walls (m)", ylabel="pairs")
    return figure  # type: ignore[no-any-return]


# Flights.

M_PER_IN: Final = 0.0254
POSES, RANGES = "/crazyflie2/state_xyzv", "/crazyflie2/state_ranger_qxyzw"
"""Topics of the flights: x, y first; four ranges first, and a quaternion at 5 to 8."""
ORDER: Final = (1, 2, 3, 0)
"""Places in the topic of the ranges to the front, the left, the back and the right."""
DELAYS_S: Final = (-0.05, 0.0, 0.05, 0.1, 0.15)
MODEL: Final = """[[model]]
name = "drone"
like = "n150"
sonar_ring_radius_cm = 0.1

[model.ring]
angles_deg = [0, 90, 180, 270]
order = [[0, 1, 2, 3]]
interval_s = 0.1
min_range_cm = 5
max_range_m = 2.0
no_echo_m = 10.0
resolution_cm = 0.1
"""
"""Beyond 2 m the ranges do not change as the drone moves: they are of the floor, which the beams meet there."""
CELL_M, CELL_S = 0.1, 20.0
"""Cells of the grid, and duration within which the odometry does not drift by one."""
USED_M: Final = (0.05, 2.0)
LONG_IN: Final = 80.0
"""Walls whose angles are compared: 2 m, over which the surface does not turn a wall."""
SQUARE_RAD: Final = np.radians(15.0)
"""Walls that are farther from both axes are aslant by design, and not by error."""


class FlightSettings(NamedTuple):
    """Settings of `nomad map learn` for a flight: delay of the ranges, noise and scales of the odometry, roughness."""

    delay_s: float
    noise: tuple[float, float, float]
    scale_stds: tuple[float, ...]
    roughness_in: float

    def words(self) -> str:
        """Return the options of the command line."""
        noise, stds = (",".join(f"{one:g}" for one in ones) for ones in (self.noise, self.scale_stds))
        return (f"--sonar-delay {self.delay_s:g} --odometry-noise {noise} --scale-std {stds} "
                f"--roughness {self.roughness_in:g}")  # fmt: skip


SETTINGS: Final[Mapping[str, FlightSettings]] = MappingProxyType({
    "rice": FlightSettings(0.05, (0.6, 0.01, 0.0004), (0.1, 0.003, 3e-6), 1.2),
    "olsson-demo": FlightSettings(0.1, (0.6, 0.005, 0.0002), (0.03, 0.002, 1e-6), 1.2),
})
"""By the flight: with these delays the spots occupy the fewest cells; the gyro of the first wanders more, and its walls
are rougher."""


class Agreement(NamedTuple):
    """An order of the ranges or a delay, and the occupied cells for each spot: fewer are better."""

    value: tuple[int, ...] | float
    cells: float


class Flight(NamedTuple):
    """Rating of a map; lengths in m, angles in degrees. The fields' names are those of the JSON."""

    name: str
    orders: list[Agreement]
    delays: list[Agreement]
    walls: int
    explained: float
    explained_of_repeated: float
    chi_square: float
    distance_scale: float
    straightness_m: list[float]
    """Standard deviation of the spots about each wall."""
    angles_deg: list[float]
    """Of walls longer than 2 m: deviation from the nearer axis of the building, in the mean of which there is none."""
    returns_m: list[float]
    """Of walls that were measured again: distance of late spots from the early ones, in the map."""
    odometry_returns_m: list[float]
    """The same walls by the odometry, with the scale of the map."""
    start_returns_m: list[float]
    odometry_start_returns_m: list[float]
    """Both of the walls that were measured in the first 20 s: the error from the end to the start."""
    stds_m: list[float]
    """Stated standard deviation of each wall's offset."""
    refused: str


def crispness(poses: Floats, ranges_m: Floats, order: Sequence[int], delay_s: float) -> float:
    """Return the number of occupied cells for each spot, over stretches of CELL_S.

    Parameters
    ----------
    poses
        (n, 4) time, x, y, heading; s, m, rad.
    ranges_m
        (n, k) ranges.
    order
        (k,) places of the ranges to the front, and counter-clockwise.
    delay_s
        By how much the ranges are older than the poses of their rows.
    """
    time = poses[:, 0]
    x, y, heading = (np.interp(time - delay_s, time, column) for column in poses[:, 1:].T)
    cells, spots = 0, 0
    for half in ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)):
        rows = []
        for number, place in enumerate(order):
            z, axis = ranges_m[:, place], heading + number * 2.0 * np.pi / len(order)
            used = (z > USED_M[0]) & (z < USED_M[1])
            spot = np.column_stack((x + z * np.cos(axis), y + z * np.sin(axis)))
            cell = np.floor(spot / CELL_M + half)
            rows.append(np.column_stack((time // CELL_S, cell))[used])
        every = np.concatenate(rows)
        cells, spots = cells + len(np.unique(every, axis=0)), spots + len(every)
    return cells / max(spots, 1)


def best_orders(poses: Floats, ranges_m: Floats) -> list[Agreement]:
    """Return all orders of the ranges (n, k), those first with which they agree best with the poses (n, 4)."""
    orders = permutations(range(ranges_m.shape[1]))
    return sorted((Agreement(order, crispness(poses, ranges_m, order, 0.0)) for order in orders),
                  key=lambda agreement: agreement.cells)  # fmt: skip


def read_flight(bag: Path, out: Path) -> tuple[Path, Floats, Floats]:
    """Write a flight as CSV and return its path, poses (n, 4) and ranges (n, 4) in the order of the topic."""
    fields = [f"x_m={POSES}:raw.0", f"y_m={POSES}:raw.1", f"qz={RANGES}:raw.7", f"qw={RANGES}:raw.8"]
    fields += [f"sonar_{number}_m={RANGES}:raw.{place}" for number, place in enumerate(ORDER)]
    drive = convert.read_drive(bag, fields)
    path = out / f"{bag.stem}.csv"
    path.unlink(missing_ok=True)
    convert.write_drive(drive, path)
    poses = np.array([(each.time_s, each.x_m, each.y_m, each.heading_rad) for each in drive.samples])
    poses[:, 3] = np.unwrap(poses[:, 3])
    ranges = np.empty((len(poses), len(ORDER)))
    ranges[:, ORDER] = [each.ranges_m for each in drive.samples]
    return path, poses, ranges


def learn_flight(log: Path, model: Path, settings: FlightSettings) -> tuple[MapEstimate, LearnedMap]:
    """Return the map of a flight, as `nomad map learn` makes it."""
    body = list(load_bodies(model).values())[-1]
    rows = without_echo(read_log(log), body.ring)
    drive = drive_of_rows(rows, body, is_omnidirectional=True, delay_s=settings.delay_s)
    learner = learn_log(drive, OdometryNoise(*settings.noise), cone_sonar(body.ring), rays=True,
                        roughness_in=settings.roughness_in, scale_stds=settings.scale_stds)  # fmt: skip
    return learner.estimate, describe(learner.estimate, learner.turret_rad, learner.rest)


def spots_at(estimate: MapEstimate, poses: Floats, echoes: Indices) -> Floats:
    """Return the spots (e, 2) of some echoes along their rays, from other poses (n, 3) of the nodes."""
    trajectory, parameters = estimate.problem.trajectory, estimate.state.parameters
    node = trajectory.node[echoes]
    heading = poses[node, HEADING]
    axis = heading + trajectory.axes_rad[echoes]
    offset = parameters[COMMON_OFFSET] + parameters[COMMON_OFFSET + 1 + trajectory.sonar[echoes]]
    along = np.stack((np.cos(axis), np.sin(axis)), axis=-1)
    face = poses[node, :2] + rotate(trajectory.mounts[echoes], heading)
    spots: Floats = face + (trajectory.readings_in[echoes] - offset)[:, None] * along
    return spots


def return_distance(early: Floats, late: Floats) -> float:
    """Return the median distance of late spots (m, 2) from the line of early ones (n, 2), without its sign."""
    middle = early.mean(axis=0)
    normal = np.linalg.svd(early - middle)[2][-1]
    return abs(float(np.median((late - middle) @ normal)))


def rate_flight(name: str, poses: Floats, ranges_m: Floats, estimate: MapEstimate, found: LearnedMap) -> Flight:
    """Return the rating of a map and of its flight."""
    state, trajectory = estimate.state, estimate.problem.trajectory
    odometry = trajectory.odometry.copy()
    odometry[:, :2] *= found.calibration.distance_scale
    straightness, returns, by_odometry, at_start = list[float](), list[float](), list[float](), list[bool]()
    for number, (angle, offset) in enumerate(state.walls):
        echoes = estimate.echoes_of(number)
        # 1. Spots about the wall.
        across = spots_at(estimate, state.poses, echoes) @ (np.cos(angle), np.sin(angle)) - offset
        straightness.append(M_PER_IN * float(np.sqrt(np.square(across).mean())) if len(across) else 0.0)
        # 2. The first return, after 20 s or more.
        node = trajectory.node[echoes]
        for cut in (np.flatnonzero(np.diff(node) > LOOP_NODES) + 1)[:1]:
            early, late = echoes[:cut], echoes[cut:]
            if min(len(early), len(late)) < MIN_RETURN_ECHOES:
                continue
            at_start.append(bool(node[0] < LOOP_NODES))
            for distances, path in ((returns, state.poses), (by_odometry, odometry)):
                distances.append(M_PER_IN * return_distance(*(spots_at(estimate, path, one) for one in (early, late))))
    walls = (*found.walls, *found.uncertain)
    ends = np.array([wall.ends for wall in walls if wall.length_in > LONG_IN]).reshape(-1, 2, 2)
    along = (ends[:, 1] - ends[:, 0]) @ (1.0, 1j)
    # Walls along both axes point the same way four times their angle: the sum is the direction of the building.
    fourfold = np.abs(along) * np.exp(4j * np.angle(along))
    aslant = np.angle(fourfold * np.conj(fourfold.sum())) / 4.0
    orders = best_orders(poses, ranges_m)
    delays = [Agreement(delay_s, crispness(poses, ranges_m, ORDER, delay_s)) for delay_s in DELAYS_S]
    return Flight(name, orders[:3], delays, len(walls), found.quality.explained, found.quality.repeated,
                  found.quality.chi_square, found.calibration.distance_scale, straightness, np.degrees(aslant).tolist(),
                  returns, by_odometry, [off for off, is_early in zip(returns, at_start, strict=True) if is_early],
                  [off for off, is_early in zip(by_odometry, at_start, strict=True) if is_early],
                  [M_PER_IN * wall.std_in for wall in walls], found.reason_to_refuse())  # fmt: skip


def fly(arguments: Sequence[str]) -> None:
    """Run the command `flights`."""
    parser = parser_of("flights", "--data sparse_gslam_flights",
                       "Learn maps from two flights of a drone with four range sensors, and rate them.")
    parser.add_argument("--data", type=Path, required=True, metavar="DIR",
                        help="folder of the bags (docs/real-data.md)")  # fmt: skip
    parser.add_argument("--flights", nargs="+", choices=SETTINGS, default=list(SETTINGS), help="default: both")
    add_value(parser, "--out", "DIR", Path, "write logs, model and pictures to this folder", Path("out/flights"))
    parser.add_argument("--json", action="store_true", help="print JSON, an object for each flight")
    options = parser.parse_args(arguments)
    make_folder(options.out)
    model = options.out / "drone.toml"
    model.write_text(MODEL, encoding="utf-8")
    for name in options.flights:
        log, poses, ranges_m = read_flight(options.data / f"{name}.bag", options.out)
        with show_seconds(f"learning the map of {name}"):
            estimate, found = learn_flight(log, model, SETTINGS[name])
        draw_learned(options.out / f"{name}.png", found, estimate)
        rating = rate_flight(name, poses, ranges_m, estimate, found)
        print(json.dumps(rating._asdict()) if options.json else _flight_text(rating), flush=True)
        print(f"  the same by: nomad map learn --from {log} --model-file {model} --omnidirectional --sonars rays "
              f"{SETTINGS[name].words()} --out {options.out / name}.toml")  # fmt: skip


def _flight_text(found: Flight) -> str:
    """Return a rating as text."""
    def spread(values: Sequence[float], factor: float, unit: str) -> str:
        """Return median, ninth tenth and worst."""
        if not values:
            return "none"
        middle, most, worst = factor * np.quantile(np.abs(values), (0.5, 0.9, 1.0))
        return f"{middle:.1f}, {most:.1f}, {worst:.1f} {unit} ({len(values)})"

    square = [angle for angle in found.angles_deg if abs(np.radians(angle)) < SQUARE_RAD]
    return "\n".join((
        found.name,
        "  orders of front, left, back, right: " + "; ".join(f"{one.value} {one.cells:.3f}" for one in found.orders),
        "  delays: " + "; ".join(f"{one.value:g} s {one.cells:.3f}" for one in found.delays),
        f"  {found.walls} walls explain {found.explained:.0%} of the ranges, {found.explained_of_repeated:.0%} of "
        f"those that repeat; chi-square {found.chi_square:.2f}; distance scale {found.distance_scale:.3f}",
        "  median, ninth tenth, worst (number):",
        f"  spots about their wall:    {spread(found.straightness_m, 100.0, 'cm')}",
        f"  angles to the nearer axis: {spread(square, 1.0, 'deg')}, {len(found.angles_deg) - len(square)} aslant",
        f"  walls measured again, off: {spread(found.returns_m, 100.0, 'cm')}",
        f"  the same by odometry:      {spread(found.odometry_returns_m, 100.0, 'cm')}",
        f"  those of the first 20 s:   {spread(found.start_returns_m, 100.0, 'cm')}",
        f"  the same by odometry:      {spread(found.odometry_start_returns_m, 100.0, 'cm')}",
        f"  stated standard deviation: {spread(found.stds_m, 100.0, 'cm')}",
        f"  refused: {found.refused or 'no'}",
    ))  # fmt: skip
