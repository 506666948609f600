"""Walls left out among many: against rays, and against the acoustics with all walls."""

from __future__ import annotations

from math import cos, sin, tan

import numpy as np
import pytest

from nserver_emu.simulation import acoustics, visibility
from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap
from nserver_emu.simulation.noise import BUILDING, MEASURED
from nserver_emu.simulation.visibility import Beam, walls_in_cone
from worlds.geometry import FloatArray
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150

assert isinstance(MEASURED.sonar, Polaroid)
assert isinstance(BUILDING.sonar, Polaroid)
HALF_RAD = MEASURED.sonar.cone_rad / 2.0


def crowd(count: int, rng: np.random.Generator) -> FloatArray:
    """Return the walls of that many small squares around the origin, and of a long wall behind some of them."""
    centres = rng.uniform(-120.0, 120.0, (4 * count, 2))
    centres = centres[np.hypot(*centres.T) > 15.0][:count]
    corners = centres[:, None] + np.array(((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)))
    squares = np.concatenate((corners, np.roll(corners, -1, axis=1)), axis=2).reshape(-1, 4)
    return np.vstack((squares, [(-150.0, 60.0, 150.0, 90.0), (70.0, -5.0, -10.0, -5.0)]))


@pytest.mark.parametrize("count", [10, 40, 600])
def test_every_wall_that_a_ray_of_the_cone_meets_is_found(count: int) -> None:
    rng, most = np.random.default_rng(count), 0
    for direction in rng.uniform(-np.pi, np.pi, 10).tolist():
        reflectors = ReflectorMap(crowd(count, rng)).lists
        x, y = rng.uniform(-5.0, 5.0, 2).tolist()
        beam = Beam(x, y, cos(direction), sin(direction))
        found, walls = walls_in_cone(beam, tan(HALF_RAD), 300.0, reflectors)
        assert walls == [tuple(column[row] for column in reflectors.walls) for row in found]
        most = max(most, len(found))
        # The range of each of many rays is the same among the walls found as among all.
        rays = direction + np.linspace(-HALF_RAD + 1e-6, HALF_RAD - 1e-6, 100)
        directions = np.stack((np.cos(rays), np.sin(rays)), axis=1)
        all_in = cast_rays((x, y), directions, np.array(reflectors.walls).T)[0]
        found_in = cast_rays((x, y), directions, np.array(walls).reshape(-1, 4))[0]
        near = all_in < 300.0
        np.testing.assert_allclose(found_in[near], all_in[near], rtol=1e-12)
    assert most <= 70, "of 2,400 walls, 170 of them in the cone"


@pytest.mark.long
@pytest.mark.parametrize("model", [MEASURED.sonar, BUILDING.sonar])
def test_ranges_among_many_are_those_with_all_walls(monkeypatch: pytest.MonkeyPatch, model: Polaroid) -> None:
    rng = np.random.default_rng(3)
    walls = crowd(150, rng)
    places = rng.uniform((-5.0, -5.0, -np.pi), (5.0, 5.0, np.pi), (30, 3)).tolist()
    pings = [Ping(x, y, angle, (250 + n) * 4 * 10**9, (0.0, 0.0)) for n, (x, y, angle) in enumerate(places)]

    def ranges_in() -> list[float]:
        reflectors = ReflectorMap(walls, model.surfaces(5))
        return [
            model.first_echo_in(ping, pings[max(number - 3, 0) : number], reflectors, N150)
            for number, ping in enumerate(pings)
        ]

    left_out = ranges_in()
    # One block: nothing is left out.
    monkeypatch.setattr(visibility, "BLOCK", 10**6)
    monkeypatch.setattr(acoustics, "BLOCK", 10**6)
    assert left_out == ranges_in()
    assert np.isfinite(left_out).sum() >= 10
