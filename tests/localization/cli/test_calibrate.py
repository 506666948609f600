"""`nomad calibrate`, complete runs: the simulated errors are found within 10 %."""

from __future__ import annotations

import json
from math import degrees, radians
from pathlib import Path

import pytest

from localization.live.assumptions import Consistency
from nclient.cli import main
from worlds.robots import Calibration, format_calibration, load_calibration

pytestmark = pytest.mark.long

# Less odometry noise than by default: the runs are short, and the simulated wheels are good.
SMOOTH = "0.01,0.01,0.0003"
# Random errors of the wheels, small enough that one round determines each systematic error to a tenth.
SETUP = """
base = "{base}"
ramps = true
[motion]
alpha1 = 1e-4
alpha2 = 9e-8
alpha3 = 1e-4
"""


# From 1.5 to 1.7 in: each sonar must get its own offset.
OFFSETS_IN = tuple(1.5 + 0.05 * (number % 5) for number in range(16))
ERRING = Calibration(1.05, 0.95, 0.0015, OFFSETS_IN, radians(4.0))
OPPOSITE = Calibration(
    0.95, 1.05, -0.0015, tuple(-offset if number % 2 else offset for number, offset in enumerate(OFFSETS_IN)),
    radians(-4.0),
)  # fmt: skip
"""Each error has the other sign, and the offsets have both."""


def files(folder: Path, errs: Calibration, base: str) -> tuple[Path, Path]:
    """A robot that errs so, and a setup."""
    model, setup = folder / "erring.toml", folder / "setup.toml"
    model.write_text(format_calibration("n150", errs))
    setup.write_text(SETUP.format(base=base))
    return model, setup


def test_calibration_errors_are_found_within_a_tenth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = OPPOSITE
    model, setup = files(tmp_path, true, "ideal")
    out = tmp_path / "found.toml"
    address = f"sim:thesis_room?seed=2&setup={setup}&model_file={model}&start=1,-1,2,2"
    # The stated start is wrong by 0.2 in, 0.3 in and 1 degree: it must not become part of the result.
    words = ["--world", "thesis_room", "--out", str(out), "--start", "0.8,-0.7,1", "--odometry-noise", SMOOTH]
    assert main.main(["calibrate", address, *words, "--speed", "15", "--turn-speed", "45", "--laps", "1"]) == 0
    text = capsys.readouterr().out
    assert " of 17 done" in text
    assert "sonar 15 reads more, in" in text
    found = load_calibration(out, "n150")
    assert found.distance_scale - 1.0 == pytest.approx(true.distance_scale - 1.0, rel=0.1)
    assert found.turn_scale - 1.0 == pytest.approx(true.turn_scale - 1.0, rel=0.1)
    assert found.drift_rad_in == pytest.approx(true.drift_rad_in, rel=0.1)
    assert found.turned_rad == pytest.approx(true.turned_rad, rel=0.1)
    assert found.offsets_in == pytest.approx(true.offsets_in, rel=0.1)


def test_a_real_rings_offsets_and_the_wheels_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = ERRING
    model, setup = files(tmp_path, true, "measured")
    address = f"sim:thesis_room?seed=4&setup={setup}&model_file={model}"
    words = ["--world", "thesis_room", "--sonars", "cones", "--odometry-noise", SMOOTH, "--laps", "1", "--json"]
    assert main.main(["calibrate", address, *words, "--square", "5,5,80"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["way_scale"] - 1.0 == pytest.approx(0.05, rel=0.1)
    # With a real ring the turn scale is less certain: four of its own standard deviations.
    assert found["turn_scale"] - 1.0 == pytest.approx(-0.05, abs=4.0 * found["spread"]["turn_scale"])
    assert found["drift_rad_in"] == pytest.approx(0.0015, rel=0.1)
    assert found["offsets_in"] == pytest.approx(true.offsets_in, abs=0.25)
    assert degrees(found["turned_rad"]) == pytest.approx(4.0, rel=0.1)
    assert degrees(found["spread"]["turned_rad"]) < 0.2
    assert "ring" not in found["within_noise_of_zero"]


def test_a_scout_has_no_turret_and_is_calibrated_as_well(tmp_path: Path) -> None:
    model = tmp_path / "scout.toml"
    model.write_text(format_calibration("scout", Calibration(1.04, 0.95, 0.001)))
    out = tmp_path / "found.toml"
    address = f"sim:thesis_room?robot=scout&seed=1&model_file={model}"
    words = ["--world", "thesis_room", "--body", "scout", "--laps", "1", "--odometry-noise", "0.005,0.005,0.0001",
             "--speed", "15", "--turn-speed", "45"]  # fmt: skip
    assert main.main(["calibrate", address, *words, "--out", str(out)]) == 0
    found = load_calibration(out, "scout")
    assert found.distance_scale - 1.0 == pytest.approx(0.04, rel=0.1)
    assert found.turn_scale - 1.0 == pytest.approx(-0.05, rel=0.1)
    assert found.drift_rad_in == pytest.approx(0.001, rel=0.1)


def test_default_laps_drive_until_precision_is_reached(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A round is enough where little is wanted; else there are more, but not for ever."""
    monkeypatch.setattr("localization.cli.calibrate.MAX_LAPS", 2)
    _, setup = files(tmp_path, ERRING, "ideal")
    out = tmp_path / "found.toml"
    words = ["--world", "thesis_room", "--spins", "0", "--speed", "15", "--turn-speed", "90", "--square", "5,5,30"]
    address = f"sim:thesis_room?seed=3&setup={setup}"
    assert main.main(["calibrate", address, *words, "--out", str(out)]) == 0
    output = capsys.readouterr().out
    prefix = "after 2 laps in each direction still inaccurate: "
    (line,) = [line for line in output.splitlines() if line.startswith(prefix)]
    assert "drift" in line
    assert "use more --laps" in line
    assert ": 2 laps in each direction" in out.read_text()
    # With a requirement that anything fulfils, one round is enough.
    monkeypatch.setattr("localization.cli.calibrate.REQUIRED_PRECISION", 10.0)
    assert main.main(["calibrate", address, *words, "--json"]) == 0
    text = json.loads(capsys.readouterr().out)
    assert (text["laps"], text["known_too_little"]) == (1, [])
    assert "within noise of zero" in output


def test_time_limit_ends_run_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.toml"
    words = ["--world", "thesis_room", "--time-limit", "3", "--out", str(out), "--json"]
    assert main.main(["calibrate", "sim:thesis_room", *words]) == 3
    text = capsys.readouterr()
    assert ("given up after 3 s" in text.err, text.out) == (True, "")
    assert not out.exists()


def test_wrong_start_pose_stops_at_wall_with_hint(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # The robot is at (0, 0): from (40, 40) the square would lead elsewhere, and the robot meets a wall.
    assert main.main(["calibrate", "sim:thesis_room", "--start", "40,40,0", "--laps", "1"]) == 3
    text = capsys.readouterr().out
    assert "the robot presses against something for 5 s" in text
    assert "check --start" in text


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_result_is_printed_if_file_cannot_be_written(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--laps", "1", "--spins", "0", "--speed", "15", "--turn-speed", "90", "--square", "5,5,20", "--json"]
    address = ["sim:thesis_room", "--world", "thesis_room"]
    assert main.main(["calibrate", *address, *words, "--out", "/dev/full"]) == 1
    text = capsys.readouterr()
    assert json.loads(text.out)["laps"] == 1
    assert "nomad: /dev/full: cannot be written: No space left on device; make room" in text.err


def calibrated_as_rays(out: Path, side_in: int, *words: str) -> int:
    """Drive around a square with a real ring's cones, taken for rays; return the exit code."""
    # Cones measure shorter ranges than rays at slanted walls: no calibration explains them.
    quick = ["--laps", "1", "--square", f"5,5,{side_in}", "--spins", "0", "--speed", "15", "--turn-speed", "90"]
    address = "sim:thesis_room?setup=measured&seed=1"
    return main.main(["calibrate", address, "--sonars", "rays", "--out", str(out), *quick, *words])


def test_misfit_is_reported_and_nothing_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "found.toml"
    assert calibrated_as_rays(out, 60) == 4
    assert "do not believe this" in capsys.readouterr().out
    assert not out.exists()


def test_misfit_is_no_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # A drive too short to show it.
    monkeypatch.setattr(Consistency, "is_good", False)
    out = tmp_path / "found.toml"
    assert calibrated_as_rays(out, 10, "--json") == 4
    text = capsys.readouterr()
    assert ("do not believe this" in text.err, text.out) == (True, "")
    assert not out.exists()


def test_a_square_among_walls_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    # The square of 100 in comes nearer to the walls of the 114 in room than the robot's radius.
    assert main.main(["calibrate", "sim:thesis_room", "--world", "thesis_room", "--square", "0,0,100"]) == 1
    assert "too near to walls" in capsys.readouterr().err


@pytest.mark.parametrize("words", [
    ["--square", "0,0"], ["--square", "0,0,-1"], ["--laps", "x"], ["--laps", "0"], ["--spins", "-1"],
])  # fmt: skip
def test_wrong_usage_exits_2(words: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main.main(["calibrate", "sim:", "--world", "thesis_room", *words])
    assert stop.value.code == 2
