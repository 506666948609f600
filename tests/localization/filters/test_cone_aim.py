"""The direction of a sonar from what it detects, against the posterior of many drawn axes."""

from __future__ import annotations

from math import degrees, radians

import numpy as np
import pytest

from localization.filters.calibration import EDGE_STD_RAD, AimReading, ConeAim
from localization.filters.sonar_cone import ConeSonar, expected_echoes, reflectors
from localization.filters.sonar_ray import wall_map
from worlds.rings import SonarMount
from worlds.robots import N150

WALL = [[100.0, -1000.0, 100.0, 1000.0]]
MODEL = ConeSonar()
HALF_DEG = 12.5


def reading_at(offset_deg: float, std_deg: float, reading_in: float) -> AimReading:
    """The foremost sonar, 100 in before a wall that faces it."""
    return AimReading((0.0, 0.0, 0.0), 0, radians(offset_deg), radians(std_deg), reading_in, 0.04)


def by_sampling(one: AimReading) -> tuple[float, float]:
    """Return mean and remaining fraction of the variance by importance sampling."""
    # Headings are drawn from the prior; the weight of each is its likelihood.
    edge = max(EDGE_STD_RAD, 0.5 * one.std_rad)
    offs = one.std_rad * np.random.default_rng(5).standard_normal(40_000)
    poses = np.zeros((len(offs), 3))
    around = reflectors(wall_map(WALL).segments)
    mount = SonarMount(one.offset_rad, N150.sonar_ring_radius_in)
    poses[:, 2] = offs
    is_detected = expected_echoes(poses, np.full(len(offs), edge), mount, around, MODEL)
    # The variance of the range: that of the pose and that of the sensor.
    variance = one.variance_in2 + MODEL.variance(is_detected.ranges_in[len(offs) // 2])
    middle_in = is_detected.ranges_in[np.argmin(np.abs(offs))]
    # The mixture of echoes and outliers, as in the filter.
    density = np.exp(-0.5 * (one.reading_in - middle_in) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
    good = 1.0 - MODEL.outlier_probability
    any_of = good * is_detected.probability.sum(axis=1)
    likelihood = good * (is_detected.probability * density).sum(axis=1) + MODEL.outlier_density * (1.0 - any_of)
    # No echo: the probability that no reflector is detected.
    if one.reading_in >= MODEL.highest_in:
        likelihood = 1.0 - any_of
    likelihood /= likelihood.sum()
    mean = float(likelihood @ offs)
    return mean, float(likelihood @ (offs - mean) ** 2) / float(np.var(offs))


@pytest.mark.parametrize("one", [
    reading_at(HALF_DEG, 2.0, 91.0), reading_at(HALF_DEG, 2.0, 255.0), reading_at(-HALF_DEG, 2.0, 91.0),
    reading_at(HALF_DEG + 1.5, 2.0, 91.0), reading_at(HALF_DEG - 0.5, 0.6, 255.0), reading_at(10.0, 4.0, 91.0),
    reading_at(10.0, 4.0, 40.0),
])  # fmt: skip
def test_mean_and_variance_are_those_of_drawn_axes(one: AimReading) -> None:
    off, share = ConeAim(WALL, N150, MODEL).posterior(one)
    drawn, drawn_share = by_sampling(one)
    assert off / one.std_rad == pytest.approx(drawn / one.std_rad, abs=0.05)
    assert share == pytest.approx(drawn_share, abs=0.05)


def test_perpendicular_wall_gives_no_angle_information() -> None:
    off, share = ConeAim(WALL, N150, MODEL).posterior(reading_at(0.0, 1.0, 91.0))
    assert off == pytest.approx(0.0, abs=1e-6)
    assert share == pytest.approx(1.0, abs=1e-3)


def test_turns_about_leave_little_doubt() -> None:
    """A ring mounted 3 degrees off, turned in front of one wall: the offset is found in either direction."""
    for turned_deg in (3.0, -3.0):
        aiming, mean, std = ConeAim(WALL, N150, MODEL), 0.0, radians(5.0)
        # The wall is passed in steps of 1.37 degrees, which do not repeat with the four phases.
        for angle_deg in np.concatenate([np.arange(phase - 30.0, 30.0, 1.37) for phase in (0.0, 0.4, 0.8, 1.2)]):
            # An ideal cone detects the wall if the true direction is within its half angle.
            is_detected = abs(angle_deg + turned_deg) < HALF_DEG
            one = reading_at(float(angle_deg) + degrees(mean), degrees(std), 91.0 if is_detected else 255.0)
            off, share = aiming.posterior(one)
            mean, std = mean + off, std * share**0.5
        assert degrees(mean) == pytest.approx(turned_deg, abs=0.4)
        assert degrees(std) < 0.5
