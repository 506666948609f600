"""The setups by name, with the settings of the experiments."""

from __future__ import annotations

from dataclasses import replace

from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.noise import SETUPS
from nserver_emu.simulation.odometry import EXACT, NO_NOISE, MotionNoise
from nserver_emu.simulation.sonar import SonarNoise


def test_ideal_has_neither_ramps_nor_noise() -> None:
    ideal = SETUPS["ideal"]
    assert (ideal.name, ideal.ramps, ideal.motion, ideal.sonar) == ("ideal", False, NO_NOISE, SonarNoise())


def test_noisy_has_the_settings_of_the_experiments() -> None:
    noisy = SETUPS["noisy"]
    assert (noisy.name, noisy.ramps) == ("noisy", True)
    assert noisy.motion == MotionNoise.walk(along=0.1, turn=0.1, drift=0.005)
    assert noisy.sonar == SonarNoise(range_std_relative=0.01, range_std_floor_in=0.05)


def test_measured_is_noisy_with_a_polaroid_ring() -> None:
    measured = SETUPS["measured"]
    assert (measured.name, measured.ramps, measured.motion) == ("measured", True, SETUPS["noisy"].motion)
    assert measured.sonar == Polaroid()


def test_worn_is_noisy_with_odometry_errors() -> None:
    worn = SETUPS["worn"]
    assert replace(worn, name="noisy", odometry=EXACT) == SETUPS["noisy"]
    assert worn.odometry != EXACT
