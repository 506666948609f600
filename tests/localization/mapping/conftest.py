"""The map of one drive, which several tests of this folder look at and none changes."""

from __future__ import annotations

import pytest

from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate
from localization.mapping.learn import learn_map
from tests.localization.mapping.drives import drive


@pytest.fixture(scope="session")
def estimate() -> MapEstimate:
    return learn_map(drive(1), OdometryNoise(0.05, 0.05, 0.002), ConeSonar())
