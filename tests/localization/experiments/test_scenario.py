"""Scenarios: addresses, noise and scales of trials."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from localization.experiments.live_trial import COURSES, SCENARIOS
from worlds.io import load_world


@pytest.mark.parametrize("name", SCENARIOS)
def test_setup_defines_noise_of_robot(name: str) -> None:
    scenario = SCENARIOS[name]
    setup = tomllib.loads(scenario.setup(5))
    assert setup["base"] == scenario.base
    assert setup["odometry"]["scales"] == [scenario.scale(5), 1.0, 1.0]
    assert ("clock_step_s" in setup) is scenario.line
    noise = scenario.odometry
    variances = [setup["motion"][key] for key in ("alpha1", "alpha2", "alpha3")]
    assert variances == pytest.approx([noise.rotation_std**2, noise.drift_std**2, noise.translation_std**2])


def test_scales_are_drawn_per_seed_with_std_of_filter() -> None:
    measured = SCENARIOS["measured"]
    drawn = [measured.scale(seed) for seed in range(400)]
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.01)
    # The filter assumes a scale error of 5 percent, which is what is drawn.
    assert np.std(drawn) == pytest.approx(0.05, rel=0.1)
    assert measured.scale(3) == drawn[3]
    assert measured.constants == (0.05,)
    assert SCENARIOS["exact"].scale(3) == 1.0
    assert SCENARIOS["exact"].constants == ()


@pytest.mark.parametrize(("figure", "world"), COURSES.items())
def test_every_course_is_a_path_of_its_world(figure: str, world: str) -> None:
    assert figure in load_world(world).paths
