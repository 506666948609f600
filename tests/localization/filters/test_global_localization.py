"""Global localization: LOST within seconds after a displacement, and recovery."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.experiments.live_trial import QUIET
from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.global_localization import GlobalLocalizer
from localization.filters.health import HealthStatus
from localization.filters.pose_search import Alternatives
from localization.filters.registry import finder
from localization.filters.sonar_cone import ConeSonar
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule
from nclient import Robot, connect
from nclient.protocol.types import DEFAULT_SONAR_ORDER
from nclient.state import Pose
from worlds.io import load_world
from worlds.robots import N150

pytestmark = pytest.mark.long

ROOM = LocalizationConfig(load_world("several_walls").walls, N150, QUIET, ConeSonar(), clearance_in=N150.radius_in)
SQUARE = LocalizationConfig(load_world("thesis_room").walls, N150, QUIET, ConeSonar(), clearance_in=N150.radius_in)
START = (30.0, 60.0, 0.3)


def open_at(world: str, pose: tuple[float, float, float]) -> Robot:
    heading = math.degrees(pose[2])
    return connect(f"sim:{world}?setup=measured&seed=3&start={pose[0]},{pose[1]},{heading},{heading}&step_s=0.05")


def localizer_of(robot: Robot, filter_: GlobalLocalizer) -> Localizer:
    state = robot.configure_sonars(rate=15, order=DEFAULT_SONAR_ORDER)
    assert state.clock_s is not None
    return Localizer(ROOM, filter_.belief, FiringSchedule(state.clock_s), filter_)


def turn(robot: Robot, localizer: Localizer, seconds: float) -> Estimate:
    """Turn on the spot, polling."""
    for _ in range(round(seconds / 0.1)):
        robot.drive(translation_in_s=0.0, steering_rad_s=0.2)
        estimate = localizer.update(robot.refresh())
    return estimate


def off_in(robot: Robot, estimate: Estimate) -> float:
    truth = robot.truth()
    return math.hypot(estimate.pose[0] - truth.x_in, estimate.pose[1] - truth.y_in)


def test_tracking_from_belief_equals_kalman_filter() -> None:
    with open_at("several_walls", START) as robot:
        localizer = localizer_of(robot, finder(ROOM, independent(START, (0.2, 0.2, 0.01))))
        estimate = turn(robot, localizer, 4.0)
        assert estimate.health.status is HealthStatus.OK
        assert off_in(robot, estimate) < 1.0


def test_pose_is_found_without_prior_if_room_is_unique() -> None:
    with open_at("several_walls", START) as robot:
        nowhere = finder(ROOM, None)
        assert nowhere.health == (HealthStatus.LOST, "searching: the start is unknown")
        assert nowhere.belief.std[0] > 100
        localizer = localizer_of(robot, nowhere)
        estimate = turn(robot, localizer, 4.0)
        assert estimate.health.status is HealthStatus.OK
        assert off_in(robot, estimate) < 2.0


def test_in_a_square_room_four_places_look_alike() -> None:
    with open_at("thesis_room", (20.0, 35.0, 0.3)) as robot:
        several = finder(SQUARE, None)
        # Three seconds of turning are not enough to exclude any of the four corners.
        estimate = turn(robot, localizer_of(robot, several), 4.0)
        assert len(several.places) == 4
        assert estimate.health.status is HealthStatus.LOST
        assert "4 places look alike" in estimate.health.reason
        # One of the hypotheses is the true place.
        places = [place.belief.mean for place in several.places]
        truth = robot.truth()
        assert min(math.hypot(place[0] - truth.x_in, place[1] - truth.y_in) for place in places) < 2.0


def test_kidnapped_robot_is_lost_within_5_s_and_recovers() -> None:
    with open_at("several_walls", START) as robot:
        localizer = localizer_of(robot, finder(ROOM, independent(START, (0.2, 0.2, 0.01))))
        turn(robot, localizer, 3.0)
        displaced = robot.refresh()
        # The robot is moved by hand; its encoders are set back, so that it cannot notice.
        robot.place(Pose(80.0, 75.0, 2.0, 2.0))
        robot.set_position(x_in=displaced.x_in, y_in=displaced.y_in)
        robot.set_angles(steering_rad=displaced.steering_rad, turret_rad=displaced.turret_rad)
        # At most ten seconds, in steps of a tenth.
        reports = (turn(robot, localizer, 0.1).health for _ in range(100))
        lost_after, health = next(
            (0.1 * tick, report) for tick, report in enumerate(reports) if report.status is HealthStatus.LOST
        )
        assert lost_after <= 5.0
        assert "another place" in health.reason
        # Six seconds for the ring to be read several times while turning.
        estimate = turn(robot, localizer, 6.0)
        assert estimate.health.status is HealthStatus.OK
        assert off_in(robot, estimate) < 2.0


def test_a_found_pose_has_odometry_parameters() -> None:
    lost = finder(ROOM, None, parameter_stds=(0.05,))
    assert lost.belief.mean.shape == (4,)
    assert lost.belief.std[3] == pytest.approx(0.05)
    np.testing.assert_allclose(lost.predicted(1.0, 0.0).mean[:2], [1.0, 0.0])


def test_falling_evidence_alone_means_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "localization.filters.pose_search.alternatives", lambda *_: Alternatives(None, None, -math.inf)
    )
    with open_at("several_walls", START) as robot:
        localizer = localizer_of(robot, finder(ROOM, independent((80.0, 75.0, 2.0), (0.2, 0.2, 0.01))))
        reports = (turn(robot, localizer, 0.1).health for _ in range(200))
        assert "anywhere" in next(health for health in reports if health.status is HealthStatus.LOST).reason


@pytest.mark.parametrize("slip_rad", [0.35, -0.35])
def test_a_slipped_heading_is_corrected_without_being_lost(slip_rad: float) -> None:
    """Far more standard deviations off than a filter comes back from by itself, but the place is the right one."""
    with open_at("several_walls", START) as robot:
        # A slip of the given angle, while the filter claims 0.02 rad.
        slipped = independent((*START[:2], START[2] + slip_rad), (0.2, 0.2, 0.02))
        localizer = localizer_of(robot, finder(ROOM, slipped, parameter_stds=(0.05,)))
        reports = [turn(robot, localizer, 0.1) for _ in range(40)]
        assert HealthStatus.LOST not in {estimate.health.status for estimate in reports}
        assert off_in(robot, reports[-1]) < 1.0
        off_rad = reports[-1].pose[2] - robot.truth().steering_rad
        assert abs(math.remainder(off_rad, math.tau)) < 0.15
