"""`python -m localization.experiments corridor`: the filter on a real corridor, with odometry made of its poses.

The data (docs/real-data.md) has the readings of eight sonars and poses, no odometry. Odometry is the poses with the
random walk of the motion noise, and with systematic errors; the map is two walls fitted to the echoes. So the readings
are real, and odometry and reference are as good as the poses.

Residuals of the echoes are compared with those of a simulation: a residual is a reading less the perpendicular distance
of the wall that explains it, which is met at a right angle within the cone, at most MAX_RESIDUAL_IN off. Correlation:
of each residual with that of the next echo of the same wall (lag 1).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from math import cos, degrees, pi, radians, sin, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from localization.cli.arguments import make_folder
from localization.experiments.execution import parser_of, text_table
from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import HEADING, Floats, add, difference, independent
from localization.filters.health import HealthStatus
from localization.filters.odometry import process_variance, relative_step, with_parameters
from localization.filters.registry import DEFAULT_METHOD, METHODS, make
from localization.filters.sonar_cone import ConeSonar, building_sonar
from localization.live.run import Run, run_log
from localization.live.sensor_input import LogRow, new_echoes
from localization.plot import check_picture, save
from nclient.common.arguments import add_value
from nclient.errors import LogFileError
from worlds.drawing import ESTIMATE, FAINT, TRUTH, blank
from worlds.robots import N150, Body, read_model_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODEL: Final = """# The robot of the corridor: eight sonars, steps of 10 mm, 5110 mm: no echo; each fires every 0.4 s.
[[model]]
name = "corridor8"
like = "n150"
sonar_ring_radius_cm = 23.0

[model.ring]
angles_deg = [-90.0, -37.5, -22.5, -7.5, 7.5, 22.5, 37.5, 90.0]
order = [[0, 2, 4, 6], [1, 3, 5, 7]]
interval_s = 0.2
min_range_cm = 10.0
max_range_m = 5.1
no_echo_m = 5.11
resolution_cm = 1.0
"""
SIDES: Final = (0, 7)
"""Sonars that look at the two walls."""
WALL_RANGE_IN: Final = 100.0
"""An echo of them from farther away is of an open door."""
MM: Final = 25.4
FIRST_ROW, LAST_ROW = 56, 177
START_STD: Final = (2.0, 2.0, radians(1.1))
SKIPPED: Final = 10
"""Rows after the start that are not evaluated."""
RIGHT_IN: Final = 3.0
"""An estimate is right within this: the standard deviation at which the health is no longer OK."""
SYSTEMATIC: Final = (0.05, 0.02, radians(2.0) / (1000.0 / MM))
"""Distance scale, turn scale, and drift in rad/in: 5 %, 2 %, 2 degrees a metre."""


class Corridor(NamedTuple):
    """A part of the data: clocks (k,), poses (k, 3) and readings (k, 8), inches and radians, and the robot."""

    clocks_s: Floats
    poses: Floats
    readings_in: Floats
    body: Body

    def echoes(self) -> Echoes:
        """Return the new readings that are ranges, with their poses."""
        ring = self.body.ring
        new = new_echoes(self.readings_in.tolist(), self.clocks_s.tolist(), ring.round_s)
        pairs = [(row, sonar) for row, sonars in enumerate(new) for sonar in sonars]
        rows, sonars = np.array(pairs).reshape(-1, 2).T
        ranges_in = self.readings_in[rows, sonars]
        used = (ranges_in > ring.min_range_in) & (ranges_in < ring.max_range_in)
        return Echoes(self.poses[rows[used]], sonars[used], ranges_in[used])


def read_corridor(folder: Path, first: int = FIRST_ROW, last: int = LAST_ROW) -> Corridor:
    """Return rows `first` to `last` of the data in a folder. Raises LogFileError."""
    try:
        poses, readings = (np.loadtxt(folder / name, ndmin=2) for name in ("poses.txt", "measurement.txt"))
    except (OSError, ValueError) as error:
        raise LogFileError(f"{folder}: expected measurement.txt and poses.txt of the corridor: {error}") from error
    if poses.shape[1] != 4 or readings.shape[1] != 9 or len(poses) != len(readings):
        raise LogFileError(f"{folder}: expected 4 columns of poses.txt, 9 of measurement.txt, as many rows in both")
    if not 0 <= first < last - SKIPPED or last >= len(poses):
        complaint = f"--rows {first},{last} are not {SKIPPED + 2} of them"
        raise LogFileError(f"{folder}: has rows 0 to {len(poses) - 1}; {complaint}")
    part = slice(first, last + 1)
    heading = np.radians(poses[part, 3] / 10.0)
    in_inches = np.column_stack((poses[part, 1:3] / MM, (heading + pi) % (2.0 * pi) - pi))
    body = read_model_file(MODEL, "corridor8")[0].body(N150, "")
    return Corridor((poses[part, 0] - poses[first, 0]) / 1000.0, in_inches, readings[part, 1:] / MM, body)


def degraded(corridor: Corridor, systematic: Sequence[float], rng: np.random.Generator) -> list[LogRow]:
    """Return the rows of a log with odometry made of the poses: random walk, and systematic errors."""
    scale, turn_scale, drift = systematic
    odometry, rows = corridor.poses[0], list[LogRow]()
    for row, (clock_s, pose, readings) in enumerate(zip(*corridor[:3], strict=True)):
        if row:
            # 1. The true step, less noise; what the encoders must have counted for it.
            distance, turn = relative_step(*corridor.poses[row - 1].tolist(), *pose.tolist())
            q_distance, q_turn = process_variance(distance, turn, THESIS_ODOMETRY)
            along, around = rng.standard_normal(2).tolist()
            counted = (distance - sqrt(q_distance) * along) / (1.0 + scale)
            turned = (turn - drift * counted - sqrt(q_turn) * around) / (1.0 + turn_scale)
            # 2. Dead reckoning.
            middle = odometry[HEADING] + 0.5 * turned
            odometry = add(odometry, np.array([counted * cos(middle), counted * sin(middle), turned]))
        x, y, heading = odometry.tolist()
        rows.append(LogRow(float(clock_s), (x, y, heading), heading, tuple(readings.tolist()), tuple(pose.tolist())))
    return rows


class CorridorScore(NamedTuple):
    """Results over all seeds.

    Attributes
    ----------
    across_mm, odometry_across_mm
        RMS error across the corridor, of the estimate and of odometry alone.
    nees_across
        Mean squared error across over its stated variance: 1 if consistent.
    along_mm, heading_deg
        RMS errors.
    mean_heading_deg
        Mean absolute error of the heading.
    degraded, lost
        Fractions of the time.
    degraded_right
        Fraction of the time at which the position is right within RIGHT_IN that the health is DEGRADED.
    """

    across_mm: float
    odometry_across_mm: float
    nees_across: float
    along_mm: float
    heading_deg: float
    mean_heading_deg: float
    degraded: float
    degraded_right: float
    lost: float


def run_seed(corridor: Corridor, walls: Floats, systematic: Sequence[float], seed: int, method: str) -> Run:
    """Return the run of a filter over the corridor; its odometry and its start are drawn by the seed."""
    rng = np.random.default_rng(seed)
    rows = degraded(corridor, systematic, rng)
    belief = independent(add(corridor.poses[0], rng.standard_normal(3) * START_STD), START_STD)
    if any(systematic):
        belief = with_parameters(belief, tuple(map(abs, systematic)))
    config = LocalizationConfig(walls, corridor.body, THESIS_ODOMETRY, building_sonar(corridor.body.ring))
    return run_log(rows, corridor.body.ring.round_s, make(method, config, belief, seed))


def score(runs: Sequence[Run], walls: Floats) -> CorridorScore:
    """Return the results of runs, the first SKIPPED rows of each left out."""
    # 1. The direction across: the normal of the first wall.
    along = np.array([walls[0, 2] - walls[0, 0], walls[0, 3] - walls[0, 1]])
    along /= np.hypot(*along)
    across = np.array([-along[1], along[0]])
    # 2. Errors, variances and health of all periods.
    moments = [moment for run in runs for moment in run.moments[SKIPPED:]]
    truth = np.array([moment.truth for moment in moments])
    errors = difference(np.array([moment.estimate.pose for moment in moments]), truth)
    odometry = difference(np.array([moment.odometry for moment in moments]), truth)[:, :2] @ across
    cov = np.array([moment.estimate.belief.cov[:2, :2] for moment in moments])
    status = [moment.estimate.health.status for moment in moments]
    is_degraded = np.array([each is HealthStatus.DEGRADED for each in status])
    is_right = np.hypot(errors[:, 0], errors[:, 1]) <= RIGHT_IN
    off = errors[:, :2] @ across

    def rms(values: Floats) -> float:
        return float(np.sqrt((values**2).mean()))

    return CorridorScore(MM * rms(off), MM * rms(odometry),
                         float((off**2 / np.einsum("i,kij,j->k", across, cov, across)).mean()),
                         MM * rms(errors[:, :2] @ along), degrees(rms(errors[:, HEADING])),
                         degrees(float(np.abs(errors[:, HEADING]).mean())), float(is_degraded.mean()),
                         float(is_degraded[is_right].mean()) if is_right.any() else 0.0,
                         sum(each is HealthStatus.LOST for each in status) / len(status))  # fmt: skip


CASES: Final = {"random walk": (0.0, 0.0, 0.0), "with scale, turn and drift": SYSTEMATIC}
"""The two kinds of odometry: systematic errors, stated as standard deviations."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = _parser().parse_args(arguments)
    check_picture(options.picture)
    corridor = read_corridor(options.data, *options.rows)
    echoes = corridor.echoes()
    walls = fit_walls(echoes, SIDES, corridor.body, WALL_RANGE_IN)
    statistics = residual_statistics(echoes, walls, corridor.body)
    scores = {}
    for name, systematic in CASES.items():
        runs = [run_seed(corridor, walls, systematic, seed, options.method) for seed in range(options.seeds)]
        scores[name] = score(runs, walls)
        if options.picture and not any(systematic):
            save(_picture(corridor, echoes, walls, runs[0]), options.picture)
    if options.export:
        _export(corridor, walls, options.export)
    residuals = {"walls": [wall._asdict() for wall in statistics.walls], "echoes": statistics.echoes,
                 "explained_fraction": statistics.explained_fraction}  # fmt: skip
    summary = {"rows": options.rows, "seeds": options.seeds, "walls_in": walls.tolist(),
               "residuals": residuals, "scores": {name: s._asdict() for name, s in scores.items()}}
    print(json.dumps(summary) if options.json else _text(statistics, scores), flush=True)


def _rows(text: str) -> tuple[int, int]:
    first, _, last = text.partition(",")
    if not (first.isdecimal() and last.isdecimal()):
        raise argparse.ArgumentTypeError(f"expected two row numbers such as {FIRST_ROW},{LAST_ROW}, not {text!r}")
    return int(first), int(last)


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("corridor", "--data udacity_corridor",
                       "Run a filter on the sonar readings of a real corridor. Odometry is made of the poses of the "
                       "data, with the noise of the experiments; the map is two walls fitted to the echoes.")
    parser.add_argument("--data", type=Path, required=True, metavar="FOLDER",
                        help="folder with measurement.txt and poses.txt (docs/real-data.md)")  # fmt: skip
    parser.add_argument("--rows", type=_rows, default=(FIRST_ROW, LAST_ROW), metavar="FIRST,LAST",
                        help=f"part of the data (default: {FIRST_ROW},{LAST_ROW})")  # fmt: skip
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="runs per kind of odometry (default: 20)")
    parser.add_argument("--method", choices=METHODS, default=DEFAULT_METHOD, help="filter (default: %(default)s)")
    add_value(parser, "--picture", "PNG", Path,
              "draw echoes, walls, residuals and the first run (needs the extra `plot`)")
    add_value(parser, "--export", "FOLDER", Path, "write log.csv, robot.toml and map.toml for `nomad localize --from`")
    parser.add_argument("--json", action="store_true", help="print only the numbers, as JSON")
    return parser


def _text(statistics: ResidualStatistics, scores: dict[str, CorridorScore]) -> str:
    walls = ", ".join(
        f"{MM * wall.std_in:.0f} mm (lag-1 correlation {wall.correlation:.2f})" for wall in statistics.walls
    )
    rows = [
        (name, f"{s.odometry_across_mm:.0f}", f"{s.across_mm:.1f}", f"{s.nees_across:.2f}", f"{s.heading_deg:.2f}",
         f"{s.mean_heading_deg:.2f}", f"{s.along_mm:.0f}", f"{s.degraded:.1%}", f"{s.degraded_right:.1%}",
         f"{s.lost:.1%}")
        for name, s in scores.items()
    ]  # fmt: skip
    head = ("odometry", "alone, mm", "across, mm", "NEES", "heading, deg", "mean |heading|", "along, mm", "DEGRADED",
            "while right", "LOST")  # fmt: skip
    return (
        f"residuals at the walls: {walls}\n"
        f"echoes that the walls explain: {statistics.explained_fraction:.0%} of {statistics.echoes}\n"
        + text_table([head, *rows])
    )


def _picture(corridor: Corridor, echoes: Echoes, walls: Floats, run: Run) -> Figure:
    """Return the map with all echoes and one run, above the residuals of each wall."""
    picture = blank(11.0, 7.5)
    top, bottom = picture.subplots(2, 1, height_ratios=[3, 2], sharex=True)
    # 1. Echoes on the axes of their sonars, walls and paths; metres.
    axes = echoes.poses[:, HEADING] + np.array(corridor.body.ring.angles_rad)[echoes.sonars]
    reach = corridor.body.ring.radius_in + echoes.ranges_in
    points = echoes.poses[:, :2] + reach[:, None] * np.column_stack((np.cos(axes), np.sin(axes)))
    top.plot(*(points.T * MM / 1000.0), ".", markersize=3, color=FAINT, label="echoes")
    for x1, y1, x2, y2 in walls * MM / 1000.0:
        top.plot([x1, x2], [y1, y2], color="black", linewidth=1.2)
    estimates = np.array([moment.estimate.pose for moment in run.moments])
    odometry = np.array([moment.odometry for moment in run.moments])
    for path, style in ((corridor.poses, {"color": TRUTH, "label": "reference"}),
                        (odometry, {"color": "grey", "linestyle": "--", "label": "odometry, made of it"}),
                        (estimates, {"color": ESTIMATE, "label": "estimate"})):  # fmt: skip
        top.plot(path[:, 0] * MM / 1000.0, path[:, 1] * MM / 1000.0, **style)
    top.set(ylabel="y (m)", ylim=(-2.0, 2.5), title="Sonar echoes of a real corridor")
    top.legend(loc="upper right", ncols=4, frameon=False)
    # 2. Residuals where the robot was.
    for wall, name in zip(walls, ("right wall", "left wall"), strict=True):
        of_wall, residuals = residuals_at(echoes, wall, corridor.body)
        bottom.plot(echoes.poses[of_wall, 0] * MM / 1000.0, MM * residuals, ".-", linewidth=0.8, label=name)
    bottom.axhline(0.0, color="black", linewidth=0.5)
    bottom.set(xlabel="x (m)", ylabel="residual (mm)")
    bottom.legend(loc="upper right", ncols=2, frameon=False)
    return picture


def _export(corridor: Corridor, walls: Floats, folder: Path) -> None:
    make_folder(folder)
    rows = degraded(corridor, CASES["random walk"], np.random.default_rng(0))
    count = corridor.body.ring.count
    head = ["time_s", "x_in", "y_in", "heading_rad", *(f"sonar_{sonar}_in" for sonar in range(count)),
            "truth_x_in", "truth_y_in", "truth_heading_rad"]  # fmt: skip
    lines = [",".join(head)]
    for row in rows:
        numbers = (row.clock_s, *row.odometry, *row.sonars_in, *(row.truth or ()))
        lines.append(",".join(f"{number:.6g}" for number in numbers))
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "robot.toml").write_text(MODEL, encoding="utf-8")
    polylines = [f"[[wall]]\npoints_in = [[{x1:.2f}, {y1:.2f}], [{x2:.2f}, {y2:.2f}]]\n" for x1, y1, x2, y2 in walls]
    (folder / "map.toml").write_text("\n".join(['name = "corridor"\n', *polylines]), encoding="utf-8")


MAX_RESIDUAL_IN: Final = 4.0
"""An echo farther from a wall than this is not of it: doors stand back by up to three and a half inches."""
HALF_CONE_RAD: Final = 0.5 * ConeSonar().cone_rad
HUBER: Final = 1.345
"""Threshold of Huber's weights in standard deviations: 95 % efficient for normal errors."""
MAD_STD: Final = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""
FIT_ITERATIONS: Final = 50
BEYOND_IN: Final = 40.0
"""A fitted wall extends this far beyond its first and its last echo: a metre."""


class Echoes(NamedTuple):
    """Echoes of a run, in order of time; limits left out.

    Attributes
    ----------
    poses
        True pose at each (k, 3), inches and radians; the ring's direction is the heading.
    sonars
        Number of the sonar (k,).
    ranges_in
        Readings (k,), inches from the ring.
    """

    poses: Floats
    sonars: Any
    ranges_in: Floats


class WallStatistics(NamedTuple):
    """Residuals of one wall: their number, mean and standard deviation in inches, and correlation at lag 1."""

    echoes: int
    mean_in: float
    std_in: float
    correlation: float


class ResidualStatistics(NamedTuple):
    """Residuals of each wall, and how many of all echoes the walls explain."""

    walls: tuple[WallStatistics, ...]
    echoes: int
    explained: int

    @property
    def explained_fraction(self) -> float:
        """Fraction of the echoes that the walls explain; 0 without echoes."""
        return self.explained / self.echoes if self.echoes else 0.0


def residual_statistics(echoes: Echoes, walls: Floats, ring: Body) -> ResidualStatistics:
    """Return the statistics of the echoes of a run at walls (m, 4), rows x1 y1 x2 y2 in inches."""
    explained, found = np.zeros(len(echoes.sonars), dtype=bool), []
    for wall in walls:
        of_wall, residuals = residuals_at(echoes, wall, ring)
        explained |= of_wall
        found.append(_statistics(residuals))
    return ResidualStatistics(tuple(found), len(explained), int(explained.sum()))


def residuals_at(echoes: Echoes, wall: Floats, ring: Body) -> tuple[Any, Floats]:
    """Return True for the echoes that a wall (4,) explains (k,), and their residuals in inches."""
    # 1. Faces and axes of the sonars, and the foot of the perpendicular from each.
    axes = echoes.poses[:, HEADING] + np.array(ring.sonar_angles_rad)[echoes.sonars]
    faces = echoes.poses[:, :2] + ring.sonar_ring_radius_in * np.column_stack((np.cos(axes), np.sin(axes)))
    first, span = wall[:2], wall[2:] - wall[:2]
    length = float(np.hypot(*span))
    from_end = faces - first
    foot = from_end @ (span / length)
    to_wall = foot[:, None] * (span / length) - from_end
    # 2. On the wall, in the cone, near enough.
    off_axis = np.arctan2(to_wall[:, 1], to_wall[:, 0]) - axes
    in_cone = np.abs(np.arctan2(np.sin(off_axis), np.cos(off_axis))) <= HALF_CONE_RAD
    residuals = echoes.ranges_in - np.hypot(to_wall[:, 0], to_wall[:, 1])
    of_wall = in_cone & (foot >= 0.0) & (foot <= length) & (np.abs(residuals) <= MAX_RESIDUAL_IN)
    return of_wall, residuals[of_wall]


def _statistics(residuals: Floats) -> WallStatistics:
    if len(residuals) < 2:
        return WallStatistics(len(residuals), 0.0, 0.0, 0.0)
    deviation = residuals - residuals.mean()
    variance = float((deviation**2).mean())
    correlation = float((deviation[1:] * deviation[:-1]).mean() / variance) if variance else 0.0
    return WallStatistics(len(residuals), float(residuals.mean()), variance**0.5, correlation)


def fit_walls(echoes: Echoes, sonars: Sequence[int], ring: Body, max_range_in: float) -> Floats:
    """Return a straight wall (k, 4) for each of these sonars, fitted to where its echoes lie on its axis.

    Least squares with Huber's weights, across the direction of the drive; echoes beyond `max_range_in` are left out.

    References
    ----------
    Huber, Robust Statistics (1981), section 7.8.
    """
    # 1. The direction of the drive: x of the frame in which walls are y = slope x + offset.
    ahead = echoes.poses[-1, :2] - echoes.poses[0, :2]
    ahead = ahead / np.hypot(*ahead)
    frame = np.array([ahead, [-ahead[1], ahead[0]]])
    walls = []
    for sonar in sonars:
        # 2. Points of the echoes on the axis of this sonar.
        mine = (echoes.sonars == sonar) & (echoes.ranges_in <= max_range_in)
        axes = echoes.poses[mine, HEADING] + ring.sonar_angles_rad[sonar]
        reach = ring.sonar_ring_radius_in + echoes.ranges_in[mine]
        points = echoes.poses[mine, :2] + reach[:, None] * np.column_stack((np.cos(axes), np.sin(axes)))
        x, y = (points @ frame.T).T
        # 3. Iteratively reweighted least squares.
        weights = np.ones(len(x))
        for _ in range(FIT_ITERATIONS):
            slope, offset = np.polyfit(x, y, 1, w=np.sqrt(weights))
            residuals = np.abs(y - slope * x - offset)
            limit = HUBER * MAD_STD * float(np.median(residuals))
            weights = np.minimum(1.0, limit / np.maximum(residuals, 1e-12))
        ends = np.array([x.min() - BEYOND_IN, x.max() + BEYOND_IN])
        walls.append((np.column_stack((ends, slope * ends + offset)) @ frame).ravel())
    return np.array(walls)
