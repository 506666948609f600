"""The cone model for one pose in numbers, against many in arrays."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.sonar_cone import ConeModel, ConeSonar, expected_echoes, first_echoes, reflectors
from worlds.io import load_world
from worlds.rings import SonarMount
from worlds.robots import N150

MODELS = [
    ConeSonar(), ConeSonar(cone_rad=1.2, margin_db=60.0), ConeSonar(cone_rad=7.0),
    # Reflectors across the room are too faint; none is by its distance.
    ConeSonar(cone_rad=1.2, margin_db=60.0, absorption_db_in=1.2), ConeSonar(absorption_db_in=0.0),
]


@pytest.mark.long
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("world", ["several_walls", "centre_vertex"])
def test_scalar_candidates_equal_array_candidates(world: str, model: ConeSonar) -> None:
    walls, rng = load_world(world).walls, np.random.default_rng(4)
    around, sensor = reflectors(walls), ConeModel(walls, N150, model)
    several = 0
    # Random poses in the inner part of the room, with headings known exactly, well and poorly.
    for _ in range(300):
        pose = np.array([*rng.uniform(10.0, 80.0, size=2), rng.uniform(-np.pi, np.pi)])
        mount, std = SonarMount(rng.uniform(-np.pi, np.pi), N150.sonar_ring_radius_in), rng.choice([0.0, 0.01, 0.2])
        plain = expected_echoes(pose, np.array(std), mount, around, model)
        x, y, heading = pose.tolist()
        mine = sorted(first_echoes(x, y, heading, std, mount, sensor))
        # The same reflectors, in the same order.
        assert [found.reflector for found in mine] == np.flatnonzero(plain.probability).tolist()
        several += len(mine) > 1
        # Range, derivative and probability of each agree.
        for found in mine:
            assert found.range_in == pytest.approx(plain.ranges_in[found.reflector], abs=1e-9)
            assert pytest.approx(plain.H[found.reflector], abs=1e-9) == found.H
            assert found.probability == pytest.approx(plain.probability[found.reflector], rel=1e-9, abs=1e-15)
    # Cones with more than one reflector must have occurred.
    assert several > 20
