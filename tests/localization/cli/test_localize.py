"""`nomad localize`, complete runs against the emulator in this process."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from localization.cli import localize as localization_cli
from localization.live.run import Run
from nclient import ReplyTimeout, Robot
from nclient.cli import main
from nclient.common.process import TerminatedBySignal
from worlds.robots import Calibration, Spread, format_calibration

NOISY = "sim:thesis_room?noisy=1&seed=1"
TO_GOAL = ["--map", "thesis_room", "--waypoints", "0,0", "60,40"]


def localize(*words: str) -> int:
    return main.main(["localize", *words])


def test_estimate_and_truth_are_printed_and_run_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "deep" / "run.png"
    assert localize(NOISY, *TO_GOAL, "--picture", str(picture)) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert sum("estimate" in line and "truth" in line and "off" in line for line in lines) >= 10
    assert "2 of 2 waypoints reached" in out
    assert "odometry alone is" in out
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_the_result_is_json_alone_when_asked(capsys: pytest.CaptureFixture[str]) -> None:
    assert localize(NOISY, *TO_GOAL, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["reached"] == 2
    assert result["rmse_position_in"] < 0.5
    # The estimate is better than odometry alone: without that a filter that ignores all echoes would pass.
    assert result["end_error_in"] < 1.0 < result["odometry_end_error_in"]


@pytest.mark.long
@pytest.mark.parametrize("setup", ["measured", "worn"])
def test_noisy_sonars_and_wheels_still_reach_goal(setup: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert localize(f"sim:thesis_room?setup={setup}&seed=1", *TO_GOAL, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["reached"] == 2
    assert result["end_error_in"] < 2.0 < result["odometry_end_error_in"]


@pytest.mark.long
@pytest.mark.parametrize("method", ["iekf", "ukf", "mcl"])
def test_other_filters_drive_as_well(method: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert localize(NOISY, *TO_GOAL, "--method", method, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["reached"] == 2
    assert result["end_error_in"] < 1.0 < result["odometry_end_error_in"]


@pytest.mark.long
def test_a_path_of_the_map_by_its_figure(capsys: pytest.CaptureFixture[str]) -> None:
    assert localize("sim:centre_vertex?start=10,10", "--map", "centre_vertex", "--path", "5.9", "--json") == 0
    assert json.loads(capsys.readouterr().out)["reached"] == 3


@pytest.mark.long
# The encoders start where the start pose says, and not at the origin of the simulation.
def test_a_start_is_given_to_the_encoders_too(capsys: pytest.CaptureFixture[str]) -> None:
    address = "sim:thesis_room?start=20,30,90,45"
    words = ["--map", "thesis_room", "--waypoints", "21,40", "--start", "20.2,29.9,91", "--start-std", "0.3,0.3,2"]
    assert localize(address, *words, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["end_error_in"] < 0.5
    assert 0 < result["odometry_end_error_in"] < 1.0


IN_ROOM = "sim:several_walls?noisy=1&seed=1&start=5,5,0"


@pytest.mark.parametrize("start", [
    ("--start", "0,0,92"), ("--start", "0,0,90", "--start-std", "20,20,25"), ("--start", "unknown"),
])  # fmt: skip
def test_errors_on_a_learned_map_are_those_of_the_fitted_path(
    learned: str, start: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert localize(IN_ROOM, "--map", learned, "--waypoints=-20,30", *start, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["truth_frame"] == "fitted"
    assert result["rmse_position_in"] < 0.6
    assert result["truth"][:2] == pytest.approx(result["estimate"][:2], abs=1.0)


def test_no_error_is_shown_on_a_learned_map_before_the_end(learned: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert localize(IN_ROOM, "--map", learned, "--waypoints=-20,30", "--start", "0,0,90") == 0
    *_, last, _, _, note = lines = capsys.readouterr().out.splitlines()
    assert note == "these errors are from the true path as it fits best: the map has a frame of its own"
    assert ["truth" in line for line in lines if "estimate (" in line][-2:] == [False, True]
    assert "off" in last


@pytest.mark.parametrize("has_map", [False, True])
def test_learned_map_that_is_the_simulated_world_has_its_frame(
    learned: str, has_map: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A start that is given 1 in wrong, with a deviation that says so, is an error."""
    start = ("--start", "1,0,0", "--start-std", "1,1,2", *(("--map", learned) if has_map else ()))
    assert localize(f"sim:{learned}?noisy=1&seed=1", *start, "--waypoints", "1,1", "--json") == 0
    assert json.loads(capsys.readouterr().out)["truth_frame"] == "world"


@pytest.mark.long
def test_path_points_may_begin_with_a_minus(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--map", "thesis_room", "--waypoints", "-1,0", "-2,-0.5", "--start-std=0.1,0.1,1", "--json"]
    assert localize("sim:", *words) == 0
    assert json.loads(capsys.readouterr().out)["reached"] == 2


@pytest.mark.long
def test_giving_up_at_the_time_limit_exits_3(capsys: pytest.CaptureFixture[str]) -> None:
    # One of the two waypoints is the start itself.
    assert localize(NOISY, *TO_GOAL, "--time-limit", "2") == 3
    assert "1 of 2 waypoints reached in 2" in capsys.readouterr().out


@pytest.mark.long
def test_cone_model_and_distance_scale_on_measured_ring(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = [*TO_GOAL, "--sonars", "cones", "--scale-std", "0.05", "--smooth", "0.5", "--json"]
    assert localize("sim:thesis_room?setup=measured&seed=1", *words) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["end_error_in"] < 1.0 < result["odometry_end_error_in"]
    assert result["echoes_used"] > 50


@pytest.mark.parametrize(
    "words",
    [
        ["--map", "thesis_room"],
        ["--map", "thesis_room", "--waypoints", "0;0"],
        ["--map", "thesis_room", "--waypoints", "0,inf"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--speed", "0"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--start-std", "0.1,0.1,-1"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--odometry-noise", "0.1"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--odometry-noise", "0.1,-1,0"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--odometry-noise", "1e300,0,0"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--scale-std", "0.1,-0.1"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--scale-std", "0.1,0.1,0.1,0.1"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--smooth", "-1"],
        ["--map", "thesis_room", "--waypoints", "0,0", "--sonars", "lines"],
    ],
)
def test_wrong_usage_exits_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        localize("sim:", *words)
    assert stop.value.code == 2
    assert capsys.readouterr().err.splitlines()[1:] == ["nomad localize --help lists all options"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["sim:", "--map", "thesis_rom", "--waypoints", "0,0"], "thesis_room"),
        (["sim:", "--map", "several_walls", "--path", "5.7"], "it has 5.8"),
        (["nserver://127.0.0.1:1/1", "--map", "thesis_room", "--waypoints", "0,0"], "127.0.0.1:1"),
    ],
)
def test_failures_are_explained_and_exit_1(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert localize(*words) == 1
    assert expected in capsys.readouterr().err


def test_unanswered_truth_request_drives_without_truth(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Robot] = []

    def silent(robot: Robot) -> bool:
        asked.append(robot)
        # A server that leaves sim_truth without a reply: the client closes the connection.
        robot.disconnect()
        raise ReplyTimeout("sim_truth, with 5 s to answer: silence; the connection was closed")

    monkeypatch.setattr(Robot, "is_simulated", silent)
    assert localize("sim:", "--map", "thesis_room", "--waypoints", "1,0", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["reached"], result["truth"], result["end_error_in"]) == (1, None, None)
    # One request, and none for each state of the drive.
    assert len(asked) == 1


def test_a_calibrated_robot_errs_no_more(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "mine.toml"
    # Errors of 5 percent in distance and turn, a drift, 1.5 in in each sonar and a turned ring.
    errs = Calibration(1.05, 0.95, 0.002, (1.5,) * 16, 0.05, Spread(0.001, 0.001, 1e-5))
    mine.write_text(format_calibration("n150", errs))
    words = [*TO_GOAL, "--odometry-noise", "0.01,0.01,0.0003", "--json"]
    ends = []
    for calibration in ([], ["--calibration", str(mine)]):
        localize(f"sim:thesis_room?model_file={mine}&step_s=0.1", *words, *calibration, "--time-limit", "40")
        ends.append(json.loads(capsys.readouterr().out)["rmse_position_in"])
    # With the right calibration the error is less than a third of that without it.
    assert ends[1] < 0.15 < 3.0 * ends[1] < ends[0]


@pytest.mark.long
def test_sonar_offsets_are_estimated_while_driving(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine, saved = tmp_path / "mine.toml", tmp_path / "saved.json"
    # Not the same for all sonars: a common offset is estimated by every method.
    mine.write_text(format_calibration("n150", Calibration(offsets_in=(2.0, -2.0) * 8)))
    ends = []
    for method in ("ekf", "offsets"):
        words = [*TO_GOAL, "--method", method, "--save", str(saved), "--json"]
        localize(f"sim:thesis_room?setup=noisy&seed=2&model_file={mine}", *words, "--time-limit", "60")
        ends.append(json.loads(capsys.readouterr().out)["rmse_position_in"])
    assert ends[1] < 0.5 * ends[0]
    # Three numbers of the pose and three odometry parameters: the offsets are not saved.
    assert len(json.loads(saved.read_text())["mean"]) == 6


@pytest.mark.long
def test_unknown_start_is_found_and_goal_reached(capsys: pytest.CaptureFixture[str]) -> None:
    robot = "sim:several_walls?noisy=1&seed=3&start=30,60,20,20"
    assert localize(robot, "--map", "several_walls", "--start", "unknown", "--waypoints", "45,65", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["reached"], result["trust"], len(result["places"])) == (1, "OK", 1)
    # The start was searched for a part of the time.
    assert 0.0 < result["lost_share"] < 0.9
    assert result["rmse_position_in"] < 0.5


def test_places_like_the_start_are_listed_beside_its_status(capsys: pytest.CaptureFixture[str]) -> None:
    """Between equal doors on either side of a corridor, with a deviation that covers no other."""
    robot = "sim:corridor?setup=measured&seed=1&start=787.4,39.4,0,0"
    start = ["--start", "787.4,39.4,0", "--start-std", "2,2,3", "--waypoints", "860,39", "--time-limit", "1"]
    assert localize(robot, "--method", "finder", *start, "--json") == 3
    result = json.loads(capsys.readouterr().out)
    assert result["trust"] == "OK"
    own, *others = result["places"]
    assert own["share"] > 0.9
    assert own["pose"][0] == pytest.approx(787.4, abs=10.0)
    # Doors are 156 in apart.
    # All other places are a whole number of door distances away.
    apart = [(other["pose"][0] - own["pose"][0]) / 156.0 for other in others]
    assert len(apart) >= 2
    np.testing.assert_allclose(apart, np.round(apart), atol=0.05)
    assert localize(robot, "--method", "finder", *start) == 3
    assert "looks like (" in capsys.readouterr().out


@pytest.mark.long
def test_ambiguous_places_are_reported_without_driving(capsys: pytest.CaptureFixture[str]) -> None:
    robot = "sim:thesis_room?noisy=1&seed=3&start=20,35,20,20"
    asked = [robot, "--map", "thesis_room", "--start", "unknown", "--waypoints", "60,40", "--time-limit", "8"]
    assert localize(*asked) == 3
    out = capsys.readouterr().out
    assert "LOST: searching: the start is unknown" in out
    # A square room looks the same from four places.
    assert "LOST: 4 places look alike, the likeliest with " in out
    assert out.splitlines()[-2].startswith("0 of 1 waypoints reached")
    assert localize(*asked, "--json") == 3
    result = json.loads(capsys.readouterr().out)
    assert result["trust"] == "LOST"
    assert len(result["places"]) == 4
    assert sum(place["share"] for place in result["places"]) == pytest.approx(1.0)
    assert result["rmse_position_in"] is None


@pytest.mark.parametrize(("words", "method"), [
    # A wide start has a deviation of more than about 12 in or 28 degrees.
    (["--start-std", "13,1,1"], "finder"),
    (["--start-std", "1,1,29"], "finder"),
    (["--start-std", "11,11,28"], "ekf"),
    (["--start-std", "13,1,1", "--method", "ekf"], "ekf"),
    # A resumed estimate has a deviation of its own.
    (["--start-std", "13,1,1", "--resume", "there.json"], "ekf"),
    (["--start", "unknown"], "finder"),
])  # fmt: skip
def test_a_wide_start_selects_the_finder(
    words: list[str], method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen: list[str] = []
    monkeypatch.setattr(localization_cli, "_drive", lambda *run: chosen.append(run[3].method))
    monkeypatch.setattr(localization_cli, "_write_results", lambda *_: True)
    localize(NOISY, *TO_GOAL, *words)
    assert chosen == [method]


@pytest.mark.parametrize(("words", "remedy"), [
    (["--method", "mcl"], "by --method finder alone: leave --method mcl out"),
    (["--method", "ekf"], "by --method finder alone: leave --method ekf out"),
    (["--resume", "there.json"], "--resume exclude each other"),
])  # fmt: skip
def test_an_unknown_start_is_for_the_finder_alone(
    words: list[str], remedy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        localize(NOISY, *TO_GOAL, "--start", "unknown", *words)
    assert remedy in capsys.readouterr().err


def test_lost_estimate_is_not_saved_and_result_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The path-point was not reached: that is what it ends with."""
    words = ["--start", "unknown", "--waypoints", "20,20", "--time-limit", "5", "--json"]
    assert localize("sim:thesis_room", *words, "--save", str(tmp_path / "x.json")) == 3
    output = capsys.readouterr()
    assert json.loads(output.out)["trust"] == "LOST"
    assert "x.json: not written, the estimate is lost" in output.err


@pytest.mark.long
def test_time_limit_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    assert localize(NOISY, "--map", "thesis_room", "--waypoints", "60,40", "--time-limit", "1") == 3
    assert capsys.readouterr().out.endswith("stopped: time limit exceeded: 1 s (--time-limit)\n")


@pytest.mark.parametrize("name", ["", ".", "run.xyz", "run"])
def test_wrong_picture_suffix_is_reported_before_the_drive(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("localization.cli.arguments.open_robot", lambda _: pytest.fail("it drives"))
    assert localize(NOISY, *TO_GOAL, "--picture", name) == 1
    assert "pictures are written as PNG: name a file that ends in .png" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "expected"), [
    (["--start", "unknwon"], "3 numbers separated by commas, inches, inches and degrees, or unknown, not 'unkn"),
    (["--waypoints", "0cm,0"], "2 numbers separated by commas, inches, such as 20,40, not '0cm,0'"),
    (["--waypoints", "1,1", "--speed", "5in"], "argument --speed: expected a number above 0, not '5in'"),
    (["--waypoints", "1,1", "--scale-std", "5%"], "argument --scale-std: expected a number, not '5%'"),
])  # fmt: skip
def test_invalid_options_name_the_expected_form(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        localize(NOISY, *words)
    assert expected in capsys.readouterr().err


@pytest.mark.long
# Ctrl-C and SIGTERM: both must save and report what there is.
@pytest.mark.parametrize("ending", [KeyboardInterrupt, lambda: TerminatedBySignal("SIGTERM")])
def test_an_interrupted_run_is_saved_and_reported(
    ending: Callable[[], BaseException], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    # The run is complete when the exception comes, so that there is an estimate to save.
    def interrupted(robot: Robot, _: object, done: Run, *others: object) -> None:
        drive(robot, _, done, *others)
        raise ending()

    drive: Callable[..., None] = localization_cli._drive
    monkeypatch.setattr(localization_cli, "_drive", interrupted)
    saved = tmp_path / "saved"
    words = [NOISY, *TO_GOAL, "--time-limit", "1"]
    # 128 + 2 for SIGINT, 128 + 15 for SIGTERM.
    assert localize(*words, "--save", str(saved)) in (130, 143)
    assert "1 of 2 waypoints reached" in capsys.readouterr().out
    assert saved.exists()
    (tmp_path / "gone").mkdir()
    # The folder of the file disappears after the check at the start: saving fails at the end.
    monkeypatch.setattr("localization.cli.arguments.check_writable", lambda *_: (tmp_path / "gone").rmdir())
    file = tmp_path / "gone" / "saved"
    assert localize(*words, "--save", str(file)) in (130, 143), "the ending stays what it was"
    assert str(file) in capsys.readouterr().err


def test_unwritable_file_is_reported_before_the_drive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("localization.cli.arguments.open_robot", lambda _: pytest.fail("it drives"))
    (tmp_path / "file").touch()
    blocking_file = tmp_path / "file"
    for file, expected in (
        (tmp_path, f"{str(tmp_path)!r}: cannot be written"),
        (blocking_file / "x", f"{blocking_file}: cannot be written: File exists"),
    ):
        assert localize(NOISY, *TO_GOAL, "--save", str(file)) == 1
        assert expected in capsys.readouterr().err


def test_interrupt_before_first_state_prints_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def at_once(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(localization_cli, "_drive", at_once)
    assert localize(NOISY, *TO_GOAL) == 130
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(("words", "part"), [
    (["thesis_room", "--waypoints", "20,20", "300,0"], "waypoint 300,0"),
    # A wall of several_walls stands between the two points.
    (["several_walls", "--waypoints", "40,20", "60,20"], "from 40,20 to 60,20"),
    (["several_walls", "--start", "40,20,0", "--waypoints", "60,20"], "from 40,20 to 60,20"),
])  # fmt: skip
def test_unreachable_waypoints_are_refused(
    words: list[str], part: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def connected(_: object) -> None:
        raise AssertionError("nothing may move")

    monkeypatch.setattr("localization.cli.arguments.open_robot", connected)
    assert localize("sim:", "--map", *words) == 1
    assert part in capsys.readouterr().err


def test_a_wall_before_the_first_waypoint_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert localize("sim:several_walls?start=5,5", "--waypoints", "70,20") == 1
    captured = capsys.readouterr()
    assert "leg from 5,5 to 70,20" in captured.err
    # No line of a drive was printed.
    assert not re.search(r"^ +\d", captured.out, re.MULTILINE)


@pytest.mark.long
def test_a_bumper_that_closes_ends_the_run_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert localize(NOISY, "--map", "thesis_room", "--waypoints", "100,0") == 3
    assert "stopped: contact of bumpers " in capsys.readouterr().out
    assert localize(NOISY, "--map", "thesis_room", "--waypoints", "100,0", "--json") == 3
    result = json.loads(capsys.readouterr().out)
    assert result["stopped"].startswith("contact of bumpers ")
    # The wall is 105 in from the start's axis and the robot 9.4 in wide to a side: some 90 in at 5 in/s.
    assert result["duration_s"] < 25.0


@pytest.mark.long
@pytest.mark.parametrize(("words", "source", "line"), [
    ([], "encoders", "start (0.0, 0.0) in 0.0 deg ± 0.1 in 0.57 deg, from the encoders"),
    (["--start", "0.1,0,1", "--start-std", "1,2,3"], "start", "start (0.1, 0.0) in 1.0 deg ± 2 in 3 deg, given by"),
    (["--start", "unknown"], "unknown", "start unknown"),
])  # fmt: skip
def test_the_origin_of_the_start_pose_is_stated(
    words: list[str], source: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = [NOISY, "--map", "thesis_room", "--waypoints", "5,0", "--time-limit", "0.2", *words]
    localize(*run)
    assert any(printed.startswith(line) for printed in capsys.readouterr().out.splitlines())
    localize(*run, "--json")
    assert json.loads(capsys.readouterr().out)["start"] == source


@pytest.mark.long
def test_encoders_of_a_robot_that_drove_before_are_doubted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # As of a robot that was not started by this command: its encoders may have drifted since.
    monkeypatch.setattr("localization.cli.arguments.is_lockstep", lambda _: False)
    localize(NOISY, "--map", "thesis_room", "--waypoints", "5,0", "--time-limit", "0.2")
    assert "encoders drift" in capsys.readouterr().out


@pytest.mark.long
def test_assumed_rays_are_reported_and_refused_on_misfit(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a server, which does not report its setup, where the readings do not decide."""
    # Neither the address nor the readings show which sonars these are.
    monkeypatch.setattr("localization.live.assumptions.sonar_model_of_address", lambda _: None)
    monkeypatch.setattr("localization.cli.arguments.decide_by_readings", lambda sonars, *_: sonars)
    assert localize(NOISY, *TO_GOAL) == 0
    output = capsys.readouterr().out
    assert output.startswith("assuming that sonars measure exact rays, as this is a simulation")
    assert "do not believe this" not in output
    measured = "sim:thesis_room?setup=measured&seed=1"
    assert localize(measured, *TO_GOAL) == 0
    output = capsys.readouterr().out
    assert "refused: do not believe this" in output
    assert "a real ring's cones are taken for rays (--sonars cones)" in output
    assert localize(measured, *TO_GOAL, "--sonars", "cones") == 0
    output = capsys.readouterr().out
    assert "taken for" not in output
    # In the first second there are too few readings for a hint.
    assert localize(measured, *TO_GOAL, "--time-limit", "1", "--json") == 3
    assert json.loads(capsys.readouterr().out)["hint"] is None, "no hint from few readings"


@pytest.mark.parametrize(("query", "words", "expected"), [
    ("noisy=1&seed=1", [], "exact rays: 100% of the first readings"),
    ("setup=measured&seed=1", [], "have cones: "),
    ("setup=measured&seed=1", ["--start", "unknown"], "have cones: "),
])  # fmt: skip
def test_the_first_readings_decide_the_sonar_model(
    query: str, words: list[str], expected: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a server, which does not report its setup."""
    monkeypatch.setattr("localization.live.assumptions.sonar_model_of_address", lambda _: None)
    address = f"sim:several_walls?{query}"
    localize(address, "--map", "several_walls", "--waypoints", "5,0", "--time-limit", "0.2", *words)
    assert expected in capsys.readouterr().out.splitlines()[0]


def test_encoders_of_a_driven_robot_are_wide_and_searched(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a server's robot: it stands 30 in from the start of the map, on encoders that nobody has set."""
    monkeypatch.setattr("localization.cli.arguments.is_lockstep", lambda _: False)
    address = "sim:thesis_room?noisy=1&seed=1&start=30,0,0,0"
    run = [address, "--map", "thesis_room", "--waypoints", "35,0", "--time-limit", "0.2"]
    localize(*run)
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("start ("))
    assert "30 in or more since" in line
    # Encoders that drove 30 in may have drifted; the search covers it.
    assert "method finder" in line
    std_in = float(line.split("±")[1].split()[0])
    assert 4.0 < std_in < 40.0
    # A stated deviation is taken as it is.
    localize(*run, "--start-std", "0.1,0.1,0.57")
    assert "± 0.1 in 0.57 deg, from the encoders;" in capsys.readouterr().out


def test_a_start_that_nothing_fits_ends_the_run_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    # The robot is not at the stated start: its ranges do not fit there.
    run = ["sim:several_walls?noisy=1&seed=1", "--map", "several_walls", "--start", "30,60,20", "--waypoints", "45,65"]
    assert localize(*run, "--json") == 3
    result = json.loads(capsys.readouterr().out)
    assert "ranges fit the map at the start; check --map and --start" in result["stopped"]
    assert result["duration_s"] < 4.0


@pytest.mark.long
def test_a_measured_ring_has_cones_without_being_reported(capsys: pytest.CaptureFixture[str]) -> None:
    results = []
    for words in ([], ["--sonars", "cones"]):
        assert localize("sim:thesis_room?setup=measured&seed=1", *TO_GOAL, "--json", *words) == 0
        results.append(json.loads(capsys.readouterr().out))
    assert results[0] == results[1]
    assert results[0]["hint"] is None
