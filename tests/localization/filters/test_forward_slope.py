"""The derivative of an expected range by a displacement along the heading, by moving the robot and casting rays."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest

from localization.filters.belief import independent
from localization.filters.registry import update_for
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar
from localization.filters.update import NONE
from worlds.io import load_world
from worlds.robots import N150

WALLS = load_world("several_walls").walls
STEP_IN = 0.01


@pytest.mark.parametrize("sonar", [WIRE_SONAR, ConeSonar()], ids=["rays", "cones"])
@pytest.mark.parametrize("pose", [(20.0, 30.0, 0.4), (70.0, 20.0, -2.1), (30.0, 75.0, 1.2)])
def test_slope_is_that_of_ranges_from_a_step_ahead(sonar: RaySonar | ConeSonar, pose: tuple[float, ...]) -> None:
    update, slopes = update_for(WALLS, N150, sonar), []
    x, y, heading = pose
    ahead = (x + STEP_IN * cos(heading), y + STEP_IN * sin(heading), heading)
    for number in range(len(N150.sonar_angles_rad)):
        # The innovation of one reading, here and a step ahead, of a belief that is nearly certain.
        here, there = (
            update.updated(independent(at, (1e-3, 1e-3, 1e-5)), number, 0.0, 60.0)[1] for at in (pose, ahead)
        )
        if here.refusal in (NONE, there.refusal) and abs(here.innovation_in - there.innovation_in) < 3.0 * STEP_IN:
            assert here.slope == pytest.approx((here.innovation_in - there.innovation_in) / STEP_IN, abs=2e-3)
            slopes.append(here.slope)
    # Walls at a slant and beside the robot as well: the cosine of the beam is not the derivative.
    assert len(slopes) > 5
    assert np.ptp(slopes) > 1.0
