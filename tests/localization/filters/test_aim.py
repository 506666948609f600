"""Where a sonar looks by what it hears: against the posterior of very many drawn axes, by the array model of cones."""

from __future__ import annotations

from math import degrees, radians

import numpy as np
import pytest

from localization.filters.calibration import EDGE_STD_RAD, AimReading, ConeAim
from localization.filters.reflectors import reflectors
from localization.filters.sonar_cone import ConeSonar, SonarMount, expected_echoes
from localization.filters.sonar_ray import wall_map
from worlds.robots import N150

WALL = [[100.0, -1000.0, 100.0, 1000.0]]
MODEL = ConeSonar()
HALF_DEG = 12.5


def look(offset_deg: float, std_deg: float, reading_in: float) -> AimReading:
    """The foremost sonar, 100 in before a wall that faces it."""
    return AimReading((0.0, 0.0, 0.0), 0, radians(offset_deg), radians(std_deg), reading_in, 0.04)


def by_chance(one: AimReading) -> tuple[float, float]:
    """Mean and share of the variance by importance sampling."""
    edge = max(EDGE_STD_RAD, 0.5 * one.std_rad)
    offs = one.std_rad * np.random.default_rng(5).standard_normal(40_000)
    poses = np.zeros((len(offs), 3))
    around = reflectors(wall_map(WALL).segments)
    ear = SonarMount(one.offset_rad, N150.sonar_ring_radius_in)
    poses[:, 2] = offs
    heard = expected_echoes(poses, np.full(len(offs), edge), ear, around, MODEL)
    variance = one.variance_in2 + MODEL.variance(heard.ranges_in[len(offs) // 2])
    middle_in = heard.ranges_in[np.argmin(np.abs(offs))]
    density = np.exp(-0.5 * (one.reading_in - middle_in) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
    good = 1.0 - MODEL.outlier_probability
    any_of = good * heard.probability.sum(axis=1)
    likelihood = good * (heard.probability * density).sum(axis=1) + MODEL.outlier_density * (1.0 - any_of)
    if one.reading_in >= MODEL.highest_in:
        likelihood = 1.0 - any_of
    likelihood /= likelihood.sum()
    mean = float(likelihood @ offs)
    return mean, float(likelihood @ (offs - mean) ** 2) / float(np.var(offs))


@pytest.mark.parametrize("one", [
    look(HALF_DEG, 2.0, 91.0), look(HALF_DEG, 2.0, 255.0), look(-HALF_DEG, 2.0, 91.0), look(HALF_DEG + 1.5, 2.0, 91.0),
    look(HALF_DEG - 0.5, 0.6, 255.0), look(10.0, 4.0, 91.0), look(10.0, 4.0, 40.0),
])  # fmt: skip
def test_mean_and_variance_are_those_of_drawn_axes(one: AimReading) -> None:
    off, share = ConeAim(WALL, N150, MODEL).posterior(one)
    drawn, drawn_share = by_chance(one)
    assert off / one.std_rad == pytest.approx(drawn / one.std_rad, abs=0.05)
    assert share == pytest.approx(drawn_share, abs=0.05)


def test_head_on_a_wall_tells_nothing_of_the_angle() -> None:
    off, share = ConeAim(WALL, N150, MODEL).posterior(look(0.0, 1.0, 91.0))
    assert off == pytest.approx(0.0, abs=1e-6)
    assert share == pytest.approx(1.0, abs=1e-3)


def test_turns_about_leave_little_doubt() -> None:
    """A ring that is mounted 3 degrees off, heard all round before one wall: its middle is found, either way round."""
    for turned_deg in (3.0, -3.0):
        aiming, mean, std = ConeAim(WALL, N150, MODEL), 0.0, radians(5.0)
        for angle_deg in np.concatenate([np.arange(phase - 30.0, 30.0, 1.37) for phase in (0.0, 0.4, 0.8, 1.2)]):
            heard = abs(angle_deg + turned_deg) < HALF_DEG
            one = look(float(angle_deg) + degrees(mean), degrees(std), 91.0 if heard else 255.0)
            off, share = aiming.posterior(one)
            mean, std = mean + off, std * share**0.5
        assert degrees(mean) == pytest.approx(turned_deg, abs=0.4)
        assert degrees(std) < 0.5
