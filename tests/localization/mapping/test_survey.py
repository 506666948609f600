"""Driving while the map grows: the speed guard, legs, and whole drives by `nomad map learn ADDRESS`."""

from __future__ import annotations

import json
from math import pi
from pathlib import Path

import numpy as np
import pytest

from localization.mapping.measurements import DriveCollector, read_drive
from localization.mapping.survey import Geofence, SpeedGuard
from nclient import connect
from nclient.cli import main
from nclient.recording.format import read_recording
from tests.programs.forked import Forked
from worlds.io import load_world
from worlds.robots import N150

STAND = np.zeros(4)
FOUR = ["35,15", "60,60", "10,60", "10,15"]


def guard(*readings: tuple[float, float, float]) -> SpeedGuard:
    """Return a guard with readings of time, axis and range at the origin."""
    made = SpeedGuard(N150)
    for clock_s, axis, reading in readings:
        made.add(clock_s, STAND, axis, reading)
    return made


def test_free_way_ends_at_the_wall_ahead() -> None:
    # Face of the sonar at 9.06 in, body of 9.72 in, margin of 1.5 in.
    assert guard((0.0, 0.0, 30.0)).free_in(STAND, 0.0) == pytest.approx(30.0 + 9.06 - 9.72 - 1.5)
    moved = np.array((10.0, 0.0, 0.0, 0.0))
    assert guard((0.0, 0.0, 30.0)).free_in(moved, 0.0) == pytest.approx(17.84)


def test_what_lies_behind_or_aside_leaves_the_way_free() -> None:
    assert guard((0.0, pi, 7.0), (0.1, 1.7, 7.0)).free_in(STAND, 0.0) == np.inf
    assert guard((0.0, 0.0, 7.0), (3.0, pi, 30.0)).free_in(STAND, 0.0) == np.inf


def test_dead_zone_blocks_ahead_but_not_beside() -> None:
    assert guard((0.0, 0.3, 6.0)).free_in(STAND, 0.0) == 0.0
    assert guard((0.0, pi / 2.0, 6.0)).free_in(STAND, 0.0) == np.inf


def test_geofence_contains_its_inside() -> None:
    fence = Geofence((-5.0, -5.0), (5.0, 10.0))
    assert fence.contains(0.0, 9.0)
    assert not fence.contains(0.0, 11.0)


# Whole drives.


def learn(*words: str) -> int:
    return main.main(["map", "learn", *words])


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("survey")
    address = "sim:thesis_room?setup=measured&seed=4"
    assert learn(address, "--waypoints", *FOUR, "--out", str(folder / "room.toml")) in (0, 4)
    return folder


def test_live_drive_and_its_recording_give_the_same_map(
    driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "room.toml"
    assert learn("--from", str(driven / "room.log"), "--out", str(out), "--json") == 0
    assert out.read_text() == (driven / "room.toml").read_text()
    world = load_world(out)
    assert np.ptp(world.walls.reshape(-1, 2), axis=0) == pytest.approx(114.17, abs=2.0)
    assert json.loads(capsys.readouterr().out)["refused"] is None


def test_drive_goes_on_where_it_stopped(driven: Path) -> None:
    before = read_drive(driven / "room.log")
    both = read_drive(driven / "room.log", driven / "room.log")
    assert len(both.readings_in) == 2 * len(before.readings_in)
    assert (np.diff(both.encoders[:, 0]) > 0.0).all()
    np.testing.assert_allclose(both.encoders[len(before.encoders), 1:4], before.encoders[-1, 1:4])
    # The second part is the first one, moved.
    again = both.encoders[len(before.encoders) :, 1:3]
    np.testing.assert_allclose(
        np.hypot(*np.diff(again, axis=0).T), np.hypot(*np.diff(before.encoders[:, 1:3], axis=0).T), atol=1e-9
    )


def test_collector_ignores_states_that_are_old(driven: Path) -> None:
    collector = DriveCollector("n150", read_drive(driven / "room.log"))
    count = len(collector)
    with connect("sim:thesis_room") as robot:
        assert collector.add(robot.refresh()) == []
    assert len(collector) == count


def test_blocked_way_point_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    address = "sim:thesis_room?setup=measured&seed=4&start=80,80,0"
    code = learn(address, "--waypoints", "40,0", "--out", str(tmp_path / "room.toml"), "--speed", "9")
    text = capsys.readouterr().out
    assert code == 4
    assert "blocked" in text
    assert "waypoint (40, 0) left out" in text
    assert "contact" not in text


@pytest.mark.parametrize(("words", "reason"), [
    (["--waypoints", "90,0", "--geofence", "0,0,50,50"], "geofence"),
    (["--drive", "manual", "--waypoints", "9,0"], "manual"),
    (["--from", "drive.log", "--waypoints", "9,0"], "--from"),
])  # fmt: skip
def test_contradicting_options_are_refused(
    words: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        learn("sim:thesis_room", *words, "--out", str(tmp_path / "room.toml"))
    assert reason in capsys.readouterr().err


def test_a_person_drives_over_a_socket(tmp_path: Path) -> None:
    record = tmp_path / "room.log"
    with Forked("nserver", "thesis_room", "--port", "0", "--setup", "measured", "--speed", "4") as server:
        address = f"nserver://{server.stdout.readline().split()[-1]}/1"
        words = (address, "--drive", "manual", "--time-limit", "16", "--out", str(tmp_path / "room.toml"))
        with Forked("nomad", "map", "learn", *words) as learner:
            first = learner.stdout.readline()
            with connect(address) as robot:
                robot.drive(translation_in_s=5.0, steering_deg_s=4.0)
                text = first + learner.stdout.read()
            assert learner.wait(60) == 4
        server.terminate()
        server.wait(20)
    assert "time limit" in text
    assert not {"\r", "\x1b"} & set(text)
    # It only observes: no motion command.
    calls = {frame["call"] for e in read_recording(record).entries for frame in e.decoded if "call" in frame}
    assert calls.isdisjoint({"vm", "pr", "pa", "ws", "st"})
    drive = read_drive(record)
    assert len(drive.readings_in) > 150
    assert np.ptp(drive.encoders[:, 1]) > 10.0
