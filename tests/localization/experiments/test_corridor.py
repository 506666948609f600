"""The corridor experiment on made data, and on the real data where it is present; statistics of residuals."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from localization.experiments import __main__ as experiments
from localization.experiments import corridor
from localization.experiments.corridor import Echoes, fit_walls, residual_statistics
from localization.filters.odometry import OdometryNoise, relative_step
from localization.live.sensor_input import new_echoes
from nclient.cli.main import main as nomad
from nclient.errors import LogFileError
from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap
from nserver_emu.simulation.noise import BUILDING
from worlds.robots import N150, read_model_file

DATA = Path(__file__).parents[3].parent / "shared" / "data" / "udacity_corridor"
real_data = pytest.mark.skipif(not DATA.is_dir(), reason="the data of the corridor is not part of the project")
BODY = read_model_file(corridor.MODEL, "corridor8")[0].body(N150, "")
assert isinstance(BUILDING.sonar, Polaroid)
MODEL = BUILDING.sonar
WALLS = np.array([[-100.0, 45.0, 500.0, 45.0], [-100.0, -45.0, 500.0, -45.0]])


def made_data(folder: Path, rows: int = 60) -> Path:
    """Write a drive along two plane walls, 2290 mm apart, in the format of the data."""
    poses, readings = [], []
    for row in range(rows):
        clock, x, wave = 1000 + 215 * row, 65 * row, 10 * (row // 6 % 2)
        poses.append(f"{clock} {x} 0 {(3600 + row % 3 - 1) % 3600}")
        readings.append(f"{clock} {915 + wave} 5110 5110 5110 5110 5110 5110 {915 - wave}")
    (folder / "poses.txt").write_text("\n".join(poses), encoding="utf-8")
    (folder / "measurement.txt").write_text("\n".join(readings), encoding="utf-8")
    return folder


def test_residuals_of_known_errors() -> None:
    """Oracle: the errors that were added, their standard deviation and their correlation by numpy."""
    rng = np.random.default_rng(4)
    errors = np.repeat(rng.standard_normal(50), 4)
    x = np.linspace(0.0, 300.0, len(errors))
    poses = np.column_stack((x, np.full_like(x, 5.0), np.zeros_like(x)))
    ring_in = BODY.ring.radius_in
    left = Echoes(poses, np.full(len(x), 7), 40.0 - ring_in + errors)
    ahead = Echoes(poses, np.full(len(x), 3), np.full(len(x), 100.0))
    both = Echoes(*(np.concatenate(parts) for parts in zip(left, ahead, strict=True)))
    found = residual_statistics(both, WALLS, BODY)
    assert (found.echoes, found.explained, found.explained_fraction) == (400, 200, 0.5)
    assert found.walls[0].std_in == pytest.approx(errors.std())
    assert found.walls[0].mean_in == pytest.approx(errors.mean())
    assert found.walls[0].correlation == pytest.approx(np.corrcoef(errors[1:], errors[:-1])[0, 1], abs=0.02)
    assert found.walls[1].echoes == 0


def test_walls_are_found_in_spite_of_recesses() -> None:
    x = np.linspace(0.0, 300.0, 100)
    poses = np.column_stack((x, np.zeros_like(x), np.zeros_like(x)))
    recess = np.where((x > 100.0) & (x < 140.0), 8.0, 0.0)
    found = fit_walls(Echoes(poses, np.full(100, 7), 45.0 - BODY.ring.radius_in + recess + 0.01 * x), (7,), BODY, 100.0)
    (x1, y1, x2, y2) = found[0]
    assert (y2 - y1) / (x2 - x1) == pytest.approx(0.01, abs=0.003)
    assert y1 + (150.0 - x1) * (y2 - y1) / (x2 - x1) == pytest.approx(46.5, abs=0.5)


def test_degraded_odometry_has_the_stated_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: without noise the encoders count what scale and drift make of the true step."""
    made = corridor.read_corridor(made_data(tmp_path), 0, 59)
    monkeypatch.setattr(corridor, "THESIS_ODOMETRY", OdometryNoise(0.0, 0.0, 0.0))
    rows = corridor.degraded(made, (0.05, 0.02, 0.001), np.random.default_rng(0))
    for k in (1, 30):
        distance, turn = relative_step(*made.poses[k - 1].tolist(), *made.poses[k].tolist())
        counted, turned = relative_step(*rows[k - 1].odometry, *rows[k].odometry)
        assert distance == pytest.approx(1.05 * counted)
        assert turn == pytest.approx(1.02 * turned + 0.001 * counted)
    assert rows[-1].truth == pytest.approx(tuple(made.poses[-1]))


@pytest.mark.long
def test_the_command_prints_a_table_and_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made_data(tmp_path)
    arguments = ["corridor", "--data", str(tmp_path), "--rows", "0,59", "--seeds", "2"]
    assert experiments.main(arguments) == 0
    assert "while right" in capsys.readouterr().out
    assert experiments.main([*arguments, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert set(summary["scores"]) == set(corridor.CASES)
    assert summary["residuals"]["explained_fraction"] == 1.0


def test_an_exported_log_is_localized(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made_data(tmp_path)
    out = tmp_path / "out"
    arguments = ["corridor", "--data", str(tmp_path), "--rows", "0,59", "--seeds", "1", "--export", str(out)]
    assert experiments.main(arguments) == 0
    capsys.readouterr()
    arguments = ["localize", "--from", str(out / "log.csv"), "--model-file", str(out / "robot.toml"),
                 "--map", str(out / "map.toml"), "--start-std", "1,1,1", "--json"]  # fmt: skip
    assert nomad([*arguments, "--estimates", str(out / "estimates.csv")]) == 0
    assert json.loads(capsys.readouterr().out)["rmse_position_in"] < 2.0
    lines = (out / "estimates.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 61
    assert lines[-1].endswith(",OK")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["sim:thesis_room"], "leave ADDRESS out"),
        (["--waypoints", "1,2"], "leave --waypoints out"),
        (["--start", "unknown", "--map", "thesis_room"], "needs a robot"),
        ([], "map is required"),
    ],
)
def test_wrong_use_is_refused(more: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        nomad(["localize", *more, "--from", "log.csv"])
    assert words in capsys.readouterr().err


def test_wrong_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogFileError, match="measurement"):
        corridor.read_corridor(tmp_path)
    with pytest.raises(LogFileError, match="rows 0 to 59"):
        corridor.read_corridor(made_data(tmp_path))
    assert experiments.main(["corridor", "--data", str(tmp_path / "none")]) == 2


@pytest.mark.long
def test_pictures_are_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    made_data(tmp_path)
    arguments = ["corridor", "--data", str(tmp_path), "--rows", "0,59", "--seeds", "1", "--export", str(tmp_path)]
    assert experiments.main([*arguments, "--picture", str(tmp_path / "echoes.png")]) == 0
    files = ["--from", str(tmp_path / "log.csv"), "--map", str(tmp_path / "map.toml")]
    robot = ["--model-file", str(tmp_path / "robot.toml"), "--body", "corridor8", "--sonars", "cones"]
    assert nomad(["localize", *files, *robot, "--picture", str(tmp_path / "run.png")]) == 0
    assert "odometry alone" in capsys.readouterr().out
    for name in ("echoes.png", "run.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert nomad(["localize", *files]) == 2, "an N150 has 16 sonars"
    assert "16" in capsys.readouterr().err


# The real corridor.


@pytest.fixture(scope="module")
def real() -> tuple[corridor.Corridor, np.ndarray]:
    part = corridor.read_corridor(DATA)
    return part, fit_walls(part.echoes(), corridor.SIDES, part.body, corridor.WALL_RANGE_IN)


@real_data
@pytest.mark.long
@pytest.mark.parametrize("name", corridor.CASES)
def test_the_filter_is_right_and_knows_it(real: tuple[corridor.Corridor, np.ndarray], name: str) -> None:
    part, walls = real
    runs = [corridor.run_seed(part, walls, corridor.CASES[name], seed, "ekf") for seed in range(10)]
    found = corridor.score(runs, walls)
    assert found.across_mm <= 40.0
    assert found.nees_across <= 2.0
    assert found.heading_deg <= 1.5
    assert found.degraded_right <= 0.2
    assert found.lost == 0.0


def simulated(part: corridor.Corridor, walls: np.ndarray, model: Polaroid, seed: int) -> Echoes:
    """Return the echoes of a simulated ring from the real poses, by the same sonars at the same rows."""
    rng, body = np.random.default_rng(seed), part.body
    new = new_echoes(part.readings_in.tolist(), part.clocks_s.tolist(), body.ring.round_s)
    fired = [(row, sonar) for row, sonars in enumerate(new) for sonar in sonars]
    pings = []
    for row, sonar in fired:
        x, y, heading = part.poses[row].tolist()
        pings.append(Ping(x, y, heading + body.ring.angles_rad[sonar], 0, model.draw(rng)))
    reflectors = ReflectorMap(walls, model.surfaces(seed))
    readings = np.array([body.ring.reading(model.measured_range(ping, (), reflectors, body)) for ping in pings])
    is_echo = readings < body.ring.max_range_in
    rows, sonars = np.array(fired).T
    return Echoes(part.poses[rows[is_echo]], sonars[is_echo], readings[is_echo])


@real_data
@pytest.mark.long
def test_the_setup_building_has_the_residuals_of_the_corridor(real: tuple[corridor.Corridor, np.ndarray]) -> None:
    part, walls = real
    measured = residual_statistics(part.echoes(), walls, part.body)
    found = []
    for seed in range(8):
        echoes = simulated(part, walls, MODEL, seed)
        fitted = fit_walls(echoes, corridor.SIDES, part.body, corridor.WALL_RANGE_IN)
        found.append(residual_statistics(echoes, fitted, part.body))
    std, correlation = (
        [np.mean([getattr(wall, name) for each in runs for wall in each.walls]) for runs in ([measured], found)]
        for name in ("std_in", "correlation")
    )
    assert std[1] == pytest.approx(std[0], rel=0.2)
    assert correlation[1] == pytest.approx(correlation[0], rel=0.2)
    explained = np.mean([each.explained_fraction for each in found])
    assert explained == pytest.approx(measured.explained_fraction, abs=0.05)


@real_data
def test_plane_walls_do_not_have_them(real: tuple[corridor.Corridor, np.ndarray]) -> None:
    part, walls = real
    plane = replace(MODEL, surface_std_in=0.0, post_spacing_in=0.0)
    found = residual_statistics(simulated(part, walls, plane, 0), walls, part.body)
    assert all(abs(wall.correlation) < 0.4 for wall in found.walls)
    assert found.explained_fraction > 0.7
