"""The map of a real corridor (docs/real-data.md), from its sonars and degraded odometry."""

from pathlib import Path

import numpy as np
import pytest

from localization.experiments.corridor import Corridor, degraded, read_corridor
from localization.filters.base import THESIS_ODOMETRY
from localization.filters.sonar_cone import building_sonar
from localization.live.log import new_echoes
from localization.mapping.learn import learn_map
from localization.mapping.measurements import DriveLog
from localization.mapping.output import LearnedMap, describe

DATA = Path(__file__).parents[4] / "shared" / "data" / "udacity_corridor"
pytestmark = pytest.mark.skipif(not DATA.exists(), reason="needs the data of docs/real-data.md")
METRES = 0.0254
WIDTH_M = 2.09 + 2 * 0.23
"""2.09 m between the sonars at both sides, plus the radius of the ring twice."""
ROUGHNESS_IN = 0.8
"""Pieces of the walls differ by 40 mm."""


def drive_of(corridor: Corridor, seed: int) -> DriveLog:
    """Return the drive with odometry that has random errors of `--odometry-noise` 0.1,0.1,0.005."""
    rows = degraded(corridor, (0.0, 0.0, 0.0), np.random.default_rng(seed))
    ring = corridor.body.ring
    new = new_echoes([row.sonars_in for row in rows], [row.clock_s for row in rows], ring.round_s)
    firings = [(rows[k].clock_s, sonar, rows[k].sonars_in[sonar]) for k, sonars in enumerate(new) for sonar in sonars]
    instants, sonars, readings = (np.array(column) for column in zip(*firings, strict=True))
    encoders = np.array([(row.clock_s, *row.odometry, row.turret_rad) for row in rows])
    encoders[:, 3:] = np.unwrap(encoders[:, 3:], axis=0)
    return DriveLog(encoders, instants, sonars, readings, np.array(ring.angles_rad), corridor.body.sonar_ring_radius_in)


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


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_corridor_has_two_parallel_walls_at_its_width(seed: int) -> None:
    corridor = read_corridor(DATA)
    sonar = building_sonar(corridor.body.ring)
    found = describe(learn_map(drive_of(corridor, seed), THESIS_ODOMETRY, sonar, roughness_in=ROUGHNESS_IN))
    turn_deg, width_m = parallel_walls(found)
    assert turn_deg < 1.0
    assert width_m == pytest.approx(WIDTH_M, abs=0.05)
    # Door posts.
    assert len(found.points) >= 3
    assert found.reason_to_refuse() == ""
