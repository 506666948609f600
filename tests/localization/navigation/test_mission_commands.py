"""`nomad go` and `nomad mission` on simulations in this process: output, files and exit codes."""

from __future__ import annotations

import argparse
import json
import re
from importlib.metadata import entry_points
from math import radians
from pathlib import Path
from typing import Any

import pytest

from localization.cli import mission
from localization.cli.arguments import (
    MAX_NOISE,
    parse_numbers,
    parse_odometry_noise,
    parse_point,
    parse_pose,
    parse_pose_std,
    parse_positive,
    parse_scale_std,
    parse_seconds,
)
from localization.live import estimate
from localization.navigation.mission import Mission, Report, Step, StepFailed, run_mission
from localization.navigation.waypoints import stop_on_exit
from nclient.cli.main import main
from nclient.common.process import TerminatedBySignal
from nclient.errors import ConnectionLost, MissionFileError
from worlds.robots import Calibration, format_calibration

ROOT = Path(__file__).parents[3]
GUESS = "assuming that sonars measure exact rays, as this is a simulation (with setup measured use --sonars cones)"
SIM = "sim:thesis_room?noisy=1&seed=1"


@pytest.mark.long
def test_go_arrives_reports_of_each_second_and_reports(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["go", SIM, "--to", "20,12", "--speed", "8", "--within", "2", "--time-limit", "60"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[1:3] == ["s", "("]
    assert lines[0].endswith("OK")
    assert sum(line.endswith("OK") for line in lines) >= 4
    assert lines[-3].lstrip().startswith("0.0 s  done    go_to (20, 12)")
    assert " s  done at (" in lines[-2]
    assert lines[-1].lstrip().startswith("true pose (")


def test_failed_go_is_explained_and_json_is_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["go", SIM, "--to", "-11,0,90", "--json"]) == 3
    report = json.loads(capsys.readouterr().out)
    assert (report["ending"], report["steps"][0]["ending"]) == ("blocked", "blocked")
    assert report["reason"].startswith("no space at (-11, 0)")
    assert report["truth"]["x_in"] == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["--within", "0.01"], "a number from 0.1 to 100, not '0.01'"),
     (["--time-limit", "1e6"], "a number from 0.1 to 86400, not '1e6'")],
)  # fmt: skip
def test_go_refuses_invalid_options_like_a_mission(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["go", SIM, "--to", "20,12", *words])
    assert expected in capsys.readouterr().err


@pytest.mark.long
def test_start_option_and_robot_of_address(capsys: pytest.CaptureFixture[str]) -> None:
    address = "sim:thesis_room?robot=scout&start=40,40,90"
    assert main(["go", address, "--to", "40,46", "--start", "40,40,90", "--sonars", "cones", "--method", "ekf"]) == 0
    assert "done at (40." in capsys.readouterr().out.replace("(39.", "(40.")


def test_a_mission_is_checked_run_and_its_report_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, report = tmp_path / "m.toml", tmp_path / "r.json"
    file.write_text('title = "T"\nmap = "thesis_room"\n[[step]]\ndo = "turn"\nby_deg = 30\n')
    # Only checked: no robot is needed.
    assert main(["mission", str(file), "--check"]) == 0
    assert capsys.readouterr().out == f"{file}: a mission, T\n"
    # Run, with a report.
    assert main(["mission", str(file), SIM, "--report", str(report)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == "T"
    written = json.loads(report.read_text())
    assert (written["title"], written["ending"], written["steps"][0]["do"]) == ("T", "done", "turn")
    # A report below a file cannot be written, which is found before the drive.
    describe_write_error = report / "r.json"
    assert main(["mission", str(file), SIM, "--report", str(describe_write_error)]) == 1
    output = capsys.readouterr()
    assert f"nomad: {report}: cannot be written: File exists" in output.err
    assert output.out == "", "before the drive"


def test_unwritable_report_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = argparse.Namespace(report=tmp_path / "no" / "r.json", json=False)
    with pytest.raises(MissionFileError, match="cannot be written"):
        mission.write_report(Report("T", ending="done"), options)
    assert "done" in capsys.readouterr().out


@pytest.mark.long
def test_go_resumes_saved_estimate_with_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, saved = tmp_path / "model.toml", tmp_path / "saved.json"
    # A robot with 4 % longer distances and sonar offsets of 1.5 in.
    offsets = tuple(1.5 for _ in range(16))
    model.write_text(format_calibration("n150", Calibration(1.04, 1.0, 0.0, offsets)))
    address = f"sim:thesis_room?noisy=1&seed=2&model_file={model}"
    words = ["go", address, "--calibration", str(model), "--json"]
    # Save at the end of the first drive.
    assert main([*words, "--to", "40,10", "--save", str(saved)]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["pose"]["x_in"] == pytest.approx(report["truth"]["x_in"], abs=0.5)
    # Three elements of the pose, three of odometry.
    assert len(estimate.load(saved).belief.mean) == 6
    # --start contradicts --resume.
    assert main([*words, "--to", "40,10", "--resume", str(saved), "--start", "0,0,0"]) == 1
    assert "--start and --resume" in capsys.readouterr().err
    # A new simulation starts at the true pose: its encoders were reset.
    there = "{x_in},{y_in},{heading_deg},{heading_deg}".format(**report["truth"])
    on = [words[0], f"{address}&start={there}", *words[2:], "--to", "40,20", "--resume", str(saved)]
    # The displacement must be given for encoders that were reset.
    assert main(on) == 1
    assert "--displacement-std" in capsys.readouterr().err
    assert main([*on, "--displacement-std", "0.2,0.2,1"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["truth"]["y_in"] == pytest.approx(20.0, abs=1.5)
    assert main([*words, "--to", "5,0", "--calibration", str(tmp_path / "none.toml")]) == 1


def test_failed_save_is_reported_after_the_ending(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    # The folder disappears after the check.
    monkeypatch.setattr("localization.cli.arguments.check_writable", lambda *_: folder.rmdir())
    assert main(["go", SIM, "--to", "5,0", "--save", str(folder / "saved")]) == 1
    output = capsys.readouterr()
    assert "done at (" in output.out
    assert "cannot be written" in output.err


def test_headings_in_report_use_one_range() -> None:
    report = Report("", ending="done", pose=(1.0, 2.0, radians(-9.0)), truth=(1.0, 2.0, radians(351.0)))
    assert report.text().count("-9 deg") == 2
    output = report.as_json()
    assert output["pose"] == output["truth"] == {"x_in": 1.0, "y_in": 2.0, "heading_deg": -9.0}


def test_failed_stop_does_not_hide_the_cause() -> None:
    class Gone:
        stopped = 0

        def stop(self) -> None:
            self.stopped += 1
            raise ConnectionLost("not back yet")

    robot: Any = Gone()
    # The error of the body is raised, not that of the stop.
    with pytest.raises(ConnectionLost, match="the cause"), stop_on_exit(robot):
        raise ConnectionLost("the cause")
    # Without an error in the body, that of the stop is.
    with pytest.raises(ConnectionLost, match="not back"), stop_on_exit(robot):
        pass
    assert robot.stopped == 2


@pytest.mark.long
def test_failing_program_stops_robot_and_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, report = tmp_path / "m.py", tmp_path / "r.json"
    file.write_text("def mission(robot):\n    robot.look(0.2)\n    1 / 0\n")
    assert main(["mission", str(file), SIM, "--report", str(report)]) == 1
    assert f"nomad: {file}: line 3: ZeroDivisionError: division by zero" in capsys.readouterr().err
    assert json.loads(report.read_text())["ending"] == "error"


@pytest.mark.parametrize("exit_words", ["sys.exit(0)", "sys.exit(5)"])
def test_a_program_that_exits_has_failed(exit_words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "m.py"
    # An exit during the mission, in line 4.
    file.write_text(f"import sys\ndef mission(robot):\n    robot.look(0.2)\n    {exit_words}\n")
    assert main(["mission", str(file), SIM]) == 1
    output = capsys.readouterr()
    assert f"nomad: {file}: line 4: calls sys.exit (" in output.err
    assert "  error at (" in output.out
    # An exit while the file is loaded, in line 2.
    file.write_text(f"import sys\n{exit_words}\n")
    assert main(["mission", str(file), "--check"]) == 1
    assert f"nomad: {file}: line 2: calls sys.exit (" in capsys.readouterr().err


def test_missing_map_is_reported_unless_map_option_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "m.toml"
    file.write_text('map = "thesis_rom"\n[[step]]\ndo = "look"\n')
    # Checked or run, the name is reported with its line.
    for words in ([str(file), "--check"], [str(file), SIM]):
        assert main(["mission", *words]) == 1
        output = capsys.readouterr()
        assert output.err.startswith(f"nomad: {file}: line 1: map: thesis_rom: no such file")
        assert "did you mean thesis_room?" in output.err
        assert output.out == ""
    # --map replaces the map of the file, and is checked as well.
    assert main(["mission", str(file), SIM, "--map", "thesis_room"]) == 0
    assert main(["mission", str(file), "--check", "--map", "thesis_rom"]) == 1
    assert "nomad: thesis_rom: no such file" in capsys.readouterr().err


def mission_of(act: Any) -> Report:
    report = Report("T")
    try:
        run_mission(_Seen(report), act)
    except (KeyboardInterrupt, MissionFileError, SystemExit) as error:
        report.reason += f" ({type(error).__name__})"
    return report


class _Seen(Mission):
    """A mission without a robot, after 5 s."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.ended = None

    @property
    def seen(self) -> Any:
        return argparse.Namespace(clock_s=5.0)


def fail(error: BaseException) -> Any:
    def act(_: Mission) -> None:
        raise error

    return act


@pytest.mark.parametrize(
    ("error", "ending", "reason"),
    [
        (StepFailed("blocked", "no path"), "blocked", "no path"),
        (KeyboardInterrupt(), "interrupted", "Ctrl-C (KeyboardInterrupt)"),
        (TerminatedBySignal("SIGHUP"), "interrupted", "SIGHUP (TerminatedBySignal)"),
        (MissionFileError("line 3"), "error", "line 3 (MissionFileError)"),
        (SystemExit(), "error", "SystemExit (SystemExit)"),
    ],
)
def test_report_has_ending_and_reason(error: BaseException, ending: str, reason: str) -> None:
    report = mission_of(fail(error))
    assert (report.ending, report.reason, report.duration_s) == (ending, reason, 5.0)
    assert mission_of(lambda _: None).done


def test_a_report_in_words_and_as_data() -> None:
    step = Step("go_to", "(1, 2)", 0.0, 4.0, "blocked", "no path", 2, 30.0, 1, 3, 28.0, [(1.0, "touched")])
    report = Report("T", [step, Step("look", "1 s", 4.0, 5.0, "done")], "blocked", "no path", 5.0)
    assert report.text().splitlines() == [
        "T",
        "    0.0 s  FAILED  go_to (1, 2)  (4.0 s, 30 in, 2 tries, 1 touches, planned 3 times): no path",
        "    1.0 s          touched",
        "    4.0 s  done    look 1 s  (1.0 s, 0 in)",
        "    5.0 s  blocked: no path",
    ]
    # The same as JSON, with None for what is not known.
    data = json.loads(json.dumps(report.as_json()))
    assert (data["pose"], data["truth"], data["touches"], data["way_in"]) == (None, None, 1, 30.0)
    assert data["steps"][0]["notes"] == [{"at_s": 1.0, "words": "touched"}]


def test_option_values_are_parsed() -> None:
    # Valid values of each option, in radians.
    assert parse_point("1,-2") == (1.0, -2.0)
    assert parse_pose("1,2,180") == pytest.approx((1.0, 2.0, 3.141592653589793))
    assert parse_seconds("0") == 0.0
    assert parse_scale_std("0.05,0.01") == (0.05, 0.01)
    # Invalid: missing, not finite, negative, too large, too many.
    for reader, text in ((numbers_of_two, "1"), (parse_point, "1,nan"), (parse_pose_std, "1,-1,1"),
                         (parse_odometry_noise, f"0,0,{MAX_NOISE + 1}"), (parse_scale_std, "-1"),
                         (parse_scale_std, "1,1,1,1"), (parse_seconds, "-1"), (parse_positive, "0")):  # fmt: skip
        with pytest.raises(argparse.ArgumentTypeError):
            reader(text)


def numbers_of_two(text: str) -> list[float]:
    return parse_numbers(text, 2)


def test_the_commands_have_help(capsys: pytest.CaptureFixture[str]) -> None:
    for name, command in (("go", mission.GoCommand), ("mission", mission.MissionCommand)):
        with pytest.raises(SystemExit):
            main([name, "--help"])
        assert (command.__doc__ or "").splitlines()[0] in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(parse_point.name for parse_point in entry_points(group="nomad.commands")))
def test_help_has_no_rules_and_names_existing_files(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        main([name, "--help"])
    output = capsys.readouterr().out
    assert "Rules:" not in output
    assert all((ROOT / path).exists() for path in re.findall(r"docs/[\w/.]+\w", output))


@pytest.mark.long
def test_a_guess_of_rays_that_does_not_fit_is_doubted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a server, which does not report its setup, where the readings do not decide."""
    # The setup of a server is not known to its clients: rays are assumed.
    monkeypatch.setattr("localization.live.assumptions.sonar_model_of_address", lambda _: None)
    monkeypatch.setattr("localization.cli.arguments.decide_by_readings", lambda sonars, *_: sonars)
    words = ["go", "sim:thesis_room?setup=measured&seed=1", "--to", "60,40", "--method", "ekf", "--speed", "8"]
    main([*words, "--json"])
    output = capsys.readouterr()
    # The assumption is printed, and doubted in the result.
    assert output.err == f"{GUESS}\n"
    assert "--sonars cones" in json.loads(output.out)["hint"]
    main(words)
    assert "do not believe this" in capsys.readouterr().out.splitlines()[-1]
    # Given as an option, it is no assumption.
    main([*words, "--sonars", "rays"])
    printed = capsys.readouterr().out
    assert GUESS not in printed
    assert "do not believe this" not in printed
