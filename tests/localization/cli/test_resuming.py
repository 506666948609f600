"""Complete runs that resume a saved estimate, on a robot that stays in place between them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from localization.cli import arguments as options
from localization.filters.belief import independent
from localization.filters.health import FilterHealth, HealthStatus
from localization.live import estimate
from localization.live.estimate import Estimate
from localization.live.run import Run, RunMoment
from nclient import Robot, connect
from nclient.cli import main
from nclient.errors import EstimateFileError
from worlds.io import load_world

ADDRESS = "sim:several_walls?seed=2&start=5,5,0,0&setup=noisy"
Localize = Callable[..., tuple[int, str]]


class Lasting:
    """A robot that outlives the programs that drive it: leaving it stops it."""

    def __init__(self) -> None:
        self.robot = connect(ADDRESS)

    def __enter__(self) -> Robot:
        return self.robot

    def __exit__(self, *_: object) -> None:
        self.robot.stop()

    def __getattr__(self, name: str) -> object:
        return getattr(self.robot, name)


@pytest.fixture
def lasting(monkeypatch: pytest.MonkeyPatch) -> Lasting:
    made = Lasting()
    monkeypatch.setattr("localization.cli.arguments.connect", lambda _: made)
    return made


@pytest.fixture
def localize(lasting: Lasting, capsys: pytest.CaptureFixture[str]) -> Localize:
    assert lasting.robot.is_simulated()

    def run(*words: str, world: str = "several_walls") -> tuple[int, str]:
        code = main.main(["localize", "sim:", "--map", world, "--json", *words])
        out = capsys.readouterr()
        return code, out.out or out.err

    return run


@pytest.mark.long
def test_resumed_run_starts_from_saved_belief(localize: Localize, lasting: Lasting, tmp_path: Path) -> None:
    file = str(tmp_path / "here.json")
    assert localize("--waypoints", "20,30", "--save", file)[0] == 0
    saved = estimate.load(Path(file))
    assert saved.belief.std[:2].max() < 0.5
    code, out = localize("--waypoints", "35,55", "--resume", file, "--save", file)
    assert code == 0
    result = json.loads(out)
    assert result["end_error_in"] < 1.0
    after = estimate.load(Path(file))
    truth = lasting.robot.truth()
    error = after.belief.mean[:3] - [truth.x_in, truth.y_in, truth.steering_rad]
    # The saved estimate is compared with the true position of the robot that stayed.
    assert np.hypot(*error[:2]) < 1.0
    assert after.encoders.clock_s > saved.encoders.clock_s


@pytest.mark.long
def test_resumed_run_includes_motion_in_between(
    localize: Localize, lasting: Lasting, tmp_path: Path
) -> None:
    file = str(tmp_path / "here.json")
    localize("--waypoints", "20,30", "--save", file)
    # 12 in between the two programs: the encoders show them, and the second program adds them.
    lasting.robot.move(translation_in=12.0)
    lasting.robot.wait_until_still(20)
    code, out = localize("--waypoints", "35,55", "--resume", file)
    assert code == 0
    assert json.loads(out)["end_error_in"] < 1.0


@pytest.mark.long
def test_reset_encoders_need_displacement_std(
    localize: Localize, lasting: Lasting, tmp_path: Path
) -> None:
    file = str(tmp_path / "here.json")
    localize("--waypoints", "20,30", "--save", file, "--scale-std", "0.01")
    lasting.robot.set_position(x_in=0.0, y_in=0.0)
    # The encoders were set to 0, so that their difference to the saved ones is no motion.
    state = lasting.robot.refresh()
    lasting.robot.set_angles(steering_rad=0.0, turret_rad=state.turret_rad - state.steering_rad)
    code, out = localize("--waypoints", "35,55", "--resume", file)
    assert code == 1
    assert "set meanwhile" in out
    assert "--displacement-std" in out
    code, out = localize(
        "--waypoints",
        "35,55",
        "--resume",
        file,
        "--displacement-std",
        "0,0,0",
        "--scale-std",
        "0.01,0.01",
        "--save",
        file,
    )
    assert code == 0
    assert json.loads(out)["end_error_in"] < 1.0
    # Three numbers of the pose, and two scales by --scale-std.
    assert len(estimate.load(Path(file)).belief.mean) == 5


@pytest.mark.long
def test_another_world_is_refused(localize: Localize, tmp_path: Path) -> None:
    file = str(tmp_path / "here.json")
    localize("--waypoints", "20,30", "--save", file)
    code, out = localize("--waypoints", "35,55", "--resume", file, world="thesis_room")
    assert code == 1
    assert "'several_walls'" in out
    assert "original --map several_walls" in out


def test_lost_estimate_is_not_saved(tmp_path: Path) -> None:
    file = tmp_path / "here.json"
    lost = Estimate(1.0, independent(np.zeros(3), np.ones(3)), (), FilterHealth(HealthStatus.LOST, "searching"))
    done = Run([], [RunMoment(lost, (0.0, 0.0, 0.0), None, 0)])
    with pytest.raises(EstimateFileError, match="is lost: searching"):
        options.save_run(argparse.Namespace(save=file, body="n150"), load_world("thesis_room"), done)
    assert not file.exists()


def test_options_that_do_not_go_together(localize: Localize, tmp_path: Path) -> None:
    code, out = localize("--waypoints", "1,1", "--displacement-std", "1,1,1")
    assert (code, "--resume FILE" in out) == (1, True)
    code, out = localize("--waypoints", "1,1", "--start", "1,1,1", "--resume", str(tmp_path / "x"))
    assert (code, "give one of them" in out) == (1, True)


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "1,-1,0", "inf,0,0"])
def test_invalid_displacement_std_is_wrong_usage(localize: Localize, text: str) -> None:
    with pytest.raises(SystemExit) as stop:
        localize("--waypoints", "1,1", "--displacement-std", text)
    assert stop.value.code == 2
