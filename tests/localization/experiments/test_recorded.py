"""Recordings of other robots: made ones, and the real data where it is present."""

import json
from pathlib import Path

import numpy as np
import pytest

from localization.experiments import __main__ as experiments
from localization.experiments.recorded import (
    DELAYS_S,
    M_PER_IN,
    MODEL,
    ORDER,
    SETTINGS,
    best_orders,
    crispness,
    learn_flight,
    rate_flight,
    read_flight,
    read_ring,
    return_distance,
    runs_of,
    statistics_of,
)
from localization.filters.belief import Floats
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.learn import learn_map
from localization.mapping.output import describe
from nclient.errors import LogFileError
from tests.localization.mapping.drives import LAP, drive, ray, true_path

SHARED = Path(__file__).parents[3].parent / "shared" / "data"
DATA = SHARED / "scitos_ring24" / "scitos_ring24.csv"
FLIGHTS = SHARED / "sparse_gslam_flights"


def row_of(*walls: tuple[int, float], sonars: int = 24) -> Floats:
    """Return a row in which each wall (direction in steps, distance) is measured by three sonars, and nothing else."""
    row = np.full(sonars, np.inf)
    for direction, distance in walls:
        row[np.arange(direction - 1, direction + 2) % sonars] = distance
    return row


def test_a_run_has_the_direction_and_the_distance_of_its_wall() -> None:
    # The first wall lies across the first sonar.
    found = sorted(runs_of(row_of((0, 1.2), (8, 0.7))))
    assert [run[:2] for run in found] == [(0.0, 3), (8.0, 3)]
    assert [run.range_m for run in found] == pytest.approx([1.2, 0.7])
    assert runs_of(np.full(24, np.inf)) == []
    assert runs_of(np.arange(24.0)) == []


def test_widths_are_those_of_opposite_walls_alone() -> None:
    rows = np.array([row_of((2, 1.2), (14, 0.7)), row_of((2, 1.2), (9, 0.7)), row_of((5, 1.0)), row_of()])
    found = statistics_of(rows)
    assert found.opposite_m == pytest.approx((1.9,))
    # Opposite walls determine one direction; the second row has walls 105 degrees apart.
    assert found.rows_with_position == 0.25
    assert found.runs_per_row == 1.25
    assert found.in_runs == pytest.approx(15 / 96)
    assert found.no_echo == pytest.approx(81 / 96)


def test_widths_that_occur_often_are_grouped() -> None:
    rng = np.random.default_rng(1)
    widths = np.concatenate((rng.uniform(2.02, 2.18, 300), rng.uniform(3.01, 3.04, 100), rng.uniform(0.5, 4.5, 5)))
    found = statistics_of(np.full((2, 24), np.inf))._replace(opposite_m=tuple(widths.tolist())).widths
    assert [width.median_m for width in found] == pytest.approx([2.1, 3.025], abs=0.02)
    assert [width.std_m for width in found] == pytest.approx([0.16 / 12**0.5, 0.03 / 12**0.5], abs=0.005)
    assert statistics_of(np.full((2, 24), np.inf)).widths == []


def test_a_damaged_row_is_an_error(tmp_path: Path) -> None:
    for text in ("a,b,label\n1,2,x\n1,y,x\n", "a,b,label\n1,2,x\n1,x\n"):
        (tmp_path / "ring.csv").write_text(text)
        with pytest.raises(LogFileError, match="ring"):
            read_ring(tmp_path / "ring.csv")


@pytest.mark.skipif(not DATA.exists(), reason="needs the data of docs/real-data.md")
def test_the_ring_sees_walls_in_two_directions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "ring.png"
    assert experiments.main(["ring", "--data", str(DATA), "--picture", str(picture), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rows"] == 5456
    assert found["rows_with_position"] > 0.9
    assert 2.5 < found["runs_per_row"] < 3.2
    assert np.percentile(found["opposite_m"], (10, 90)) == pytest.approx((2.14, 3.72), abs=0.01)
    assert picture.stat().st_size > 1000


def four_rays(delay_s: float = 0.0) -> tuple[Floats, Floats]:
    """Return poses (n, 4) of a lap, and the ranges (n, 4) to the right, front, left and back of some time before."""
    poses = true_path(LAP)
    then = np.stack([np.interp(poses[:, 0] - delay_s, poses[:, 0], column) for column in poses[:, 1:].T], axis=-1)
    ranges = [[ray(x, y, heading + turn) for turn in np.radians((-90.0, 0.0, 90.0, 180.0))] for x, y, heading in then]
    poses[:, 1:3] *= M_PER_IN
    return poses, M_PER_IN * np.array(ranges)


def test_the_order_of_ranges_is_the_one_of_the_thinnest_walls() -> None:
    best, second = best_orders(*four_rays())[:2]
    assert best.value == (1, 2, 3, 0)
    assert best.cells < 0.9 * second.cells


def test_the_delay_of_ranges_is_the_one_of_the_thinnest_walls() -> None:
    poses, ranges = four_rays(0.4)
    cells = {delay_s: crispness(poses, ranges, (1, 2, 3, 0), delay_s) for delay_s in (0.0, 0.2, 0.4, 0.6)}
    assert min(cells, key=cells.__getitem__) == 0.4


def test_the_distance_of_a_return_is_that_across_the_line() -> None:
    along, normal = np.array((0.6, 0.8)), np.array((-0.8, 0.6))
    steps = np.linspace(-3.0, 5.0, 40)[:, None]
    # A single wrong spot does not matter.
    late = np.concatenate((steps * along + 0.25 * normal, [[90.0, 9.0]]))
    assert return_distance(steps * along, late) == pytest.approx(0.25)
    assert return_distance(steps * along, steps * along - 0.1 * normal) == pytest.approx(0.1)


def test_the_rating_of_a_room_of_exact_rays() -> None:
    estimate = learn_map(drive(4, points=LAP + LAP[1:], rays=True), OdometryNoise(), ConeSonar(), rays=True)
    poses, ranges = four_rays()
    found = rate_flight("room", poses, ranges, estimate, describe(estimate))
    assert found.walls == 4
    # Readings in whole inches, 1 % of up to 115 in: 1.2 cm about the walls in the mean of all.
    assert max(found.straightness_m) < 0.025
    assert max(map(abs, found.angles_deg)) < 0.5
    assert len(found.returns_m) == len(found.odometry_returns_m)
    assert found.refused == ""


@pytest.mark.skipif(not FLIGHTS.exists(), reason="../shared/data is not here")
@pytest.mark.parametrize("name", SETTINGS)
def test_order_and_delay_of_the_flights(name: str, tmp_path: Path) -> None:
    _, poses, ranges = read_flight(FLIGHTS / f"{name}.bag", tmp_path)
    best, second = best_orders(poses, ranges)[:2]
    assert best.value == ORDER
    assert best.cells < 0.96 * second.cells
    cells = {delay_s: crispness(poses, ranges, ORDER, delay_s) for delay_s in DELAYS_S}
    assert min(cells, key=cells.__getitem__) == SETTINGS[name].delay_s


@pytest.mark.skipif(not FLIGHTS.exists(), reason="../shared/data is not here")
def test_the_walls_of_a_flight_are_straight_and_square(tmp_path: Path) -> None:
    name = "olsson-demo"
    log, poses, ranges = read_flight(FLIGHTS / f"{name}.bag", tmp_path)
    # The first minute, 30 m along three sides of the hall: the whole flight takes minutes.
    log.write_text("\n".join(log.read_text().split("\n")[:601]) + "\n")
    model = tmp_path / "drone.toml"
    model.write_text(MODEL)
    estimate, learned = learn_flight(log, model, SETTINGS[name])
    found = rate_flight(name, poses, ranges, estimate, learned)
    assert found.explained > 0.7
    assert np.median(found.straightness_m) < 0.03
    assert np.median(np.abs(found.angles_deg)) < 2.0
