"""The settings that are fixed for all figures, and the length of a figure's path."""

from __future__ import annotations

import math

import pytest

from localization.experiments.figure_trial import FIGURES, NOISE, START_STD, WAYPOINT_RADIUS_IN, figure_setup
from localization.filters.sonar_ray import IDEAL_SONAR
from nserver_emu.simulation.noise import NOISY


def test_noise_of_experiments_is_fixed() -> None:
    assert (NOISE.translation_std, NOISE.rotation_std, NOISE.drift_std) == (0.1, 0.1, 0.005)
    motion = NOISY.motion
    emulated = motion.distance_std_in(1.0, 0.0), motion.turn_std_rad(0.0, 1.0), motion.turn_std_rad(1.0, 0.0)
    assert emulated == pytest.approx((0.1, 0.1, 0.005)), "the emulator's noisy robots stray as the filter takes them to"
    assert START_STD == (0.1, 0.1, 0.01)
    assert WAYPOINT_RADIUS_IN == 0.25
    assert IDEAL_SONAR.range_std_relative == 0.01
    assert (IDEAL_SONAR.range_std_floor_in, IDEAL_SONAR.rounding_var_in2) == (0.05, 0.0)


@pytest.mark.parametrize(
    ("name", "goals"),
    [
        ("5.2", [[60, 40]]),
        ("5.4", [[60, 40]]),
        ("5.6", [[60, 40]]),
        ("5.8", [[35, 55], [90, 55]]),
        ("5.9", [[60, 60], [70, 20]]),
    ],
)
def test_each_figure_drives_from_its_start_through_its_goals(name: str, goals: list[list[float]]) -> None:
    course = figure_setup(FIGURES[name])
    assert course.goals_in.tolist() == goals
    assert course.filtered == (name != "5.2")
    gains = (0.5, 0.5, 0.08, 0.8) if name == "5.6" else (0.05, 0.05, 0.1, 0.1)
    assert (course.gains.drho_max_in, course.gains.dtheta_max_rad) == gains[:2]
    assert (course.gains.alpha_rho, course.gains.alpha_theta) == gains[2:]


def test_the_text_cannot_have_covered_its_path_in_1199_steps() -> None:
    course = figure_setup(FIGURES["5.4"])
    assert course.length_in == pytest.approx(math.hypot(60, 40))
    # 72.1 in at 0.05 in a step.
    assert course.min_steps == 1442
    assert course.max_steps > 3 * 1442
