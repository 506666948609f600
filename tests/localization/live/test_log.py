"""Logs of recorded drives: reading, new echoes, and the filter over a log."""

from math import inf, pi
from pathlib import Path

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.registry import make
from localization.filters.sonar_cone import building_sonar
from localization.live.run import run_log
from localization.live.sensor_input import LogRow, new_echoes, read_log, without_echo
from nclient.errors import LogFileError
from worlds.rings import Ring
from worlds.robots import Body

HEAD = "time_ms,x_mm,y_m,heading_deg,sonar_0_mm,sonar_1_m"
RING = Ring(0.0, (pi / 2, -pi / 2), ((0,), (1,)), 0.25, 4.0, 200.0, 0.4, 201.0)


def log_file(folder: Path, text: str) -> Path:
    file = folder / "log.csv"
    file.write_text(text, encoding="utf-8")
    return file


def test_columns_are_converted_by_their_units(tmp_path: Path) -> None:
    # 254 mm = 10 in, 508 mm = 20 in, 2.54 m = 100 in; an empty cell is no echo.
    rows = read_log(log_file(tmp_path, f"# a comment\n{HEAD}\n0,254,1,180,508,2.54\n\n500,0,0,-90,,0.254\n"))
    assert [row.clock_s for row in rows] == [0.0, 0.5]
    assert rows[0].odometry == pytest.approx((10.0, 1000.0 / 25.4, pi))
    assert rows[0].sonars_in == pytest.approx((20.0, 100.0))
    assert rows[1].sonars_in == pytest.approx((inf, 10.0))
    assert rows[1].turret_rad == rows[1].odometry[2]
    assert rows[0].truth is None


def test_turret_and_truth_are_optional(tmp_path: Path) -> None:
    head = "time_s,x_in,y_in,heading_rad,turret_rad,sonar_0_in,truth_x_in,truth_y_in,truth_heading_rad"
    row = read_log(log_file(tmp_path, f"{head}\n0,1,2,3,0.5,9,1.5,2.5,3\n1,1,2,3,0.5,9,1.5,2.5,3\n"))[0]
    assert (row.turret_rad, row.truth) == (0.5, (1.5, 2.5, 3.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no column time"),
        ("time_s,x_in,y_in,heading_deg\n", "no column sonar_0"),
        ("time_s,x_in,y_in,heading_deg,sonar_0_in,sonar_2_in\n", "no column sonar_1"),
        ("time,x_in\n", "unknown column 'time'"),
        ("time_s,x_furlong\n", "no unit"),
        ("time_s,time_ms\n", "2 times"),
        ("time_s,x_in,y_in,heading_deg,sonar_0_in,truth_x_in\n", "no column truth_y"),
        ("time_s,x_in,y_in,heading_deg,sonar_0_in\n0,0,0,0,0\n", "1 rows"),
        ("time_s,x_in,y_in,heading_deg,sonar_0_in\n0,0,0,0,9\n0,0,0,0,9\n", "row 3.*increase"),
        ("time_s,x_in,y_in,heading_deg,sonar_0_in\n0,a,0,0,9\n", "row 2.*x is 'a'"),
        ("time_s,x_in,y_in,heading_deg,sonar_0_in\n0\n", "row 2.*x is ''"),
    ],
)
def test_errors_name_the_place(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(LogFileError, match=words):
        read_log(log_file(tmp_path, text))


def test_a_missing_or_binary_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(LogFileError, match="cannot be read"):
        read_log(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(LogFileError, match="cannot be read"):
        read_log(tmp_path / "binary.csv")


def test_a_reading_is_new_if_it_changes_or_is_due() -> None:
    readings = [[5.0], [5.0], [6.0], [6.0], [6.0], [7.0]]
    clocks_s = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    # Changed readings, and an unchanged one when a whole ring of 0.4 s has passed.
    assert new_echoes(readings, clocks_s, 0.4) == [[], [], [0], [], [0], [0]]


def test_the_reading_without_an_echo_is_no_range() -> None:
    rows = [LogRow(0.0, (0.0, 0.0, 0.0), 0.0, (201.0, 50.0))]
    assert without_echo(rows, RING)[0].sonars_in == (inf, 50.0)
    with pytest.raises(LogFileError, match="the ring 2"):
        without_echo([rows[0]._replace(sonars_in=(1.0,))], RING)


@pytest.mark.parametrize("method", ["ekf", "smoother"])
def test_a_log_is_localized(method: str) -> None:
    """Along two walls: the estimate finds the middle of the corridor from a start beside it."""

    rows = [LogRow(0.5 * k, (3.0 * k, 0.0, 0.0), 0.0, (40.0, 40.0), (3.0 * k, 0.0, 0.0)) for k in range(60)]
    walls = [[-100.0, 40.0, 400.0, 40.0], [-100.0, -40.0, 400.0, -40.0]]
    config = LocalizationConfig(walls, Body("two", 9.0, RING, ()), sonar=building_sonar(RING))
    localizer = make(method, config, independent([0.0, 2.0, 0.0], [0.5, 2.0, 0.02]))
    run = run_log(rows, RING.round_s, localizer)
    assert len(run.moments) == len(rows)
    assert abs(run.moments[-1].estimate.pose[1]) < 0.5
    assert np.all(run.errors_in()[10:] < 1.5)
    assert run.summary()["echoes_used"] > 100
