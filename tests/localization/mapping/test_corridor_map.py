"""The map of a real corridor (docs/real-data.md), from its sonars and degraded odometry."""

from pathlib import Path

import numpy as np
import pytest

from localization.experiments import __main__ as experiments
from localization.experiments.corridor import degraded, read_corridor
from localization.filters.base import THESIS_ODOMETRY
from localization.filters.sonar_cone import building_sonar
from localization.mapping.learn import learn_map
from localization.mapping.measurements import drive_of_rows
from localization.mapping.output import LearnedMap, describe
from nclient.cli.main import main as nomad
from worlds.io import load_world

DATA = Path(__file__).parents[4] / "shared" / "data" / "udacity_corridor"
pytestmark = pytest.mark.skipif(not DATA.exists(), reason="needs the data of docs/real-data.md")
METRES = 0.0254
ROUGHNESS_IN = 0.8
"""Pieces of a real wall differ by 40 mm, doors stand back."""
WIDTH_M = 2.09 + 2 * 0.23
"""2.09 m between the sonars at both sides, plus the radius of the ring twice."""


def parallel_walls(found: LearnedMap) -> tuple[float, float]:
    """Return the angle (deg) between the longest walls of both sides, and their distance (m)."""
    # Positive left of the path's first direction; pieces of one wall are on one side.
    left = [wall for wall in found.walls if wall.ends[:, 1].mean() > 0.0]
    right = [wall for wall in found.walls if wall.ends[:, 1].mean() < 0.0]
    one, other = left[0], right[0]
    along, across = one.ends[1] - one.ends[0], other.ends[1] - other.ends[0]
    turn = np.degrees(np.arctan2(along[1], along[0]) - np.arctan2(across[1], across[0]))
    unit = along / np.hypot(*along)
    off = other.ends.mean(axis=0) - one.ends.mean(axis=0)
    return float(abs((turn + 90.0) % 180.0 - 90.0)), METRES * float(abs(off[0] * unit[1] - off[1] * unit[0]))


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3, 6, 8])
def test_corridor_has_two_parallel_walls_at_its_width(seed: int) -> None:
    corridor = read_corridor(DATA)
    sonar = building_sonar(corridor.body.ring)
    # Odometry with random errors of `--odometry-noise` 0.1,0.1,0.005.
    rows = degraded(corridor, (0.0, 0.0, 0.0), np.random.default_rng(seed))
    log = drive_of_rows(rows, corridor.body)
    found = describe(learn_map(log, THESIS_ODOMETRY, sonar, roughness_in=ROUGHNESS_IN))
    turn_deg, width_m = parallel_walls(found)
    assert turn_deg < 1.0
    assert width_m == pytest.approx(WIDTH_M, abs=0.05)
    # Door posts.
    assert len(found.points) >= 3
    assert found.reason_to_refuse() == ""


@pytest.mark.long
@pytest.mark.parametrize("roughness", [(), ("--roughness", "0.8")])
def test_walls_whose_levels_make_no_map_are_planes(tmp_path: Path, roughness: tuple[str, ...]) -> None:
    assert experiments.main(["corridor", "--data", str(DATA), "--seeds", "1", "--export", str(tmp_path)]) == 0
    source = ["--from", str(tmp_path / "log.csv"), "--model-file", str(tmp_path / "robot.toml")]
    out = tmp_path / f"{len(roughness)}.toml"
    assert nomad(["map", "learn", *source, "--sonars", "building", *roughness, "--out", str(out)]) == 0
    assert len(load_world(out).inner_walls) >= 2
