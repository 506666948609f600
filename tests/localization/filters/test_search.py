"""The search for an unknown pose from a ring of echoes: the pose, and its alternatives."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from localization.experiments.live_trial import EXACT_RAYS, QUIET
from localization.filters.base import Place
from localization.filters.belief import Floats, difference, independent
from localization.filters.global_localization import MIN_LEAD_NATS
from localization.filters.pose_search import EchoRecord, EchoReplay, alternatives, merged, search
from localization.filters.range_table import RangeTable, build_range_table
from localization.filters.registry import update_for
from localization.filters.sonar_cone import ConeSonar, expected_echoes, reflectors
from localization.filters.sonar_ray import RaySonar
from nclient import connect
from nclient.protocol.types import DEFAULT_SONAR_ORDER
from worlds.io import load_world
from worlds.rings import SonarMount
from worlds.robots import N150

pytestmark = pytest.mark.long

KINDS: dict[str, RaySonar | ConeSonar] = {"ideal": EXACT_RAYS, "measured": ConeSonar()}


@cache
def table_of(world: str, setup: str) -> RangeTable:
    return build_range_table(load_world(world).walls, N150, KINDS[setup], N150.radius_in)


Pose = tuple[float, float, float]


def records_at(world: str, setup: str, pose: Pose, distance_in: float = 0.0) -> tuple[list[EchoRecord], Floats]:
    """A ring of echoes, taken while driving `distance_in` ahead; and the true pose at the last."""
    x, y, heading_deg = pose
    # 60 ms is the interval between two sonars: each refresh has one new echo.
    address = f"sim:{world}?setup={setup}&seed=5&start={x},{y},{heading_deg},{heading_deg}&step_s=0.06"
    with connect(address) as robot:
        robot.configure_sonars(rate=15, order=DEFAULT_SONAR_ORDER)
        if distance_in:
            robot.drive(translation_in_s=distance_in, steering_rad_s=0.0)
        records = []
        for sonar in DEFAULT_SONAR_ORDER:
            state, truth = robot.refresh(), robot.truth()
            encoders = np.array([state.x_in, state.y_in, state.steering_rad])
            # The ring turns with the turret, encoders report steering and turret.
            offset = state.turret_rad - state.steering_rad
            reading = float(state.sonars_in[sonar])
            records.append(EchoRecord(encoders, offset + N150.sonar_angles_rad[sonar], sonar, offset, reading))
    return records, np.array([truth.x_in, truth.y_in, truth.steering_rad])


def found_at(world: str, setup: str, records: list[EchoRecord]) -> list[Place]:
    return search(records, table_of(world, setup), replay_of(world, setup))


def replay_of(world: str, setup: str) -> EchoReplay:
    return EchoReplay(update_for(load_world(world).walls, N150, KINDS[setup]), QUIET)


@pytest.mark.parametrize("setup", KINDS)
@pytest.mark.parametrize("distance_in", [0.0, 5.0])
def test_an_asymmetric_room_gives_one_pose(setup: str, distance_in: float) -> None:
    records, truth = records_at("several_walls", setup, (30.0, 60.0, 20.0), distance_in)
    best = found_at("several_walls", setup, records)[0]
    off = difference(best.belief.mean, truth)
    assert np.hypot(off[0], off[1]) < 3.0
    assert abs(off[2]) < 0.15
    assert best.probability > 0.9


@pytest.mark.parametrize("setup", KINDS)
def test_a_square_room_has_four_places_that_look_alike(setup: str) -> None:
    records, truth = records_at("thesis_room", setup, (20.0, 35.0, 10.0))
    # Besides, the same places with headings that explain the echoes a thousand times worse.
    found = [each for each in found_at("thesis_room", setup, records) if each.probability > 0.001]
    assert len(found) == 4
    # The centre of the square room; the other places are rotations by quarter turns about it.
    centre = np.array([45.085, 45.085])
    turned = []
    for quarter in range(4):
        cos, sin = math.cos(quarter * math.pi / 2), math.sin(quarter * math.pi / 2)
        turned.append(centre + np.array([[cos, -sin], [sin, cos]]) @ (truth[:2] - centre))
    for place in turned:
        assert min(np.hypot(*(hypothesis.belief.mean[:2] - place)) for hypothesis in found) < 3.0
    assert sum(hypothesis.probability for hypothesis in found) == pytest.approx(1.0, abs=0.002)
    # No place is clearly better than the others.
    assert max(hypothesis.probability for hypothesis in found) < 0.8


def test_no_echoes_or_no_free_space_give_no_pose() -> None:
    replay = replay_of("thesis_room", "ideal")
    records, _ = records_at("thesis_room", "ideal", (20.0, 35.0, 10.0))
    assert search([], table_of("thesis_room", "ideal"), replay) == []
    narrow = build_range_table([[0, 0, 10, 0], [10, 0, 10, 10], [10, 10, 0, 10], [0, 10, 0, 0]], N150, EXACT_RAYS, 9.0)
    assert not len(narrow.places_in)
    assert search(records, narrow, replay) == []


def test_equal_hypotheses_merge_and_improbable_ones_drop() -> None:
    here, beside, there = (independent([x, 0.0, 0.0], [0.5, 0.5, 0.02]) for x in (0.0, 1.0, 30.0))
    found = merged([(beside, -3.0), (here, -1.0), (there, -2.0), (independent([60, 0, 0], [1, 1, 1]), -40.0)])
    assert [hypothesis.belief for hypothesis in found] == [here, there]
    assert found[0].probability == pytest.approx(1.0 / (1.0 + math.exp(-1.0)))
    assert merged([]) == []


def test_the_table_holds_the_echo_at_the_middle_of_a_cell() -> None:
    table, around = table_of("several_walls", "measured"), reflectors(load_world("several_walls").walls)
    # Any place of the table; the turn index has steps of 3 degrees.
    place = table.places_in[100]
    for turn in range(0, 120, 7):
        pose = np.array([*place, math.radians(3.0 * turn)])
        range_in, expected = (part.item() for part in table.look_up(place[:1, None], place[1:, None], np.array([turn])))
        # The exact probability and range, with a blur of half a cell.
        exact = expected_echoes(pose, np.array(0.015), SonarMount(0.0, 9.06), around, ConeSonar())
        best = int(exact.probability.argmax())
        assert expected == pytest.approx(exact.probability[best], abs=0.05)
        if expected > 0.5:
            # Whole inches.
            assert range_in == pytest.approx(exact.ranges_in[best], abs=0.5 + 1e-6)


def test_poses_off_the_floor_have_no_echo() -> None:
    x, y = np.array([[-500.0], [-12.0], [20.0]]), np.array([[20.0], [20.0], [9e3]])
    ranges, probabilities = table_of("thesis_room", "ideal").look_up(x, y, np.array([0, 60]))
    assert not ranges.any()
    assert not probabilities.any()


@pytest.mark.parametrize("setup", KINDS)
def test_readings_taken_anywhere_have_a_density(setup: str) -> None:
    table = table_of("several_walls", setup)
    assert sum(table.density(reading) for reading in range(255)) + table.density(255) == pytest.approx(1.0, abs=0.31)
    assert min(table.density(reading) for reading in range(256)) > 0.0
    assert table.density(400) == table.density(255)


@pytest.mark.parametrize("setup", KINDS)
def test_only_wrong_pose_has_alternative(setup: str) -> None:
    records, truth = records_at("several_walls", setup, (30.0, 60.0, 20.0))
    table = table_of("several_walls", setup)
    replay = replay_of("several_walls", setup)
    right, wrong = (independent(place, (0.2, 0.2, 0.01)) for place in (truth, truth + np.array([25.0, 5.0, 1.0])))
    # At the true pose nothing explains the echoes clearly better.
    assert alternatives(right, records, table, replay).lead_nats < 0.5 * MIN_LEAD_NATS
    found = alternatives(wrong, records, table, replay)
    assert found.lead_nats > MIN_LEAD_NATS
    assert found.elsewhere is not None
    off = difference(found.elsewhere.mean, truth)
    assert np.hypot(off[0], off[1]) < 3.0


def test_no_alternative_without_free_space() -> None:
    records, truth = records_at("several_walls", "ideal", (30.0, 60.0, 20.0))
    walls = load_world("several_walls").walls
    # Clearance 500 in: the room has no free place for such a robot.
    nowhere = build_range_table(walls, N150, KINDS["ideal"], 500.0)
    replay = replay_of("several_walls", "ideal")
    assert alternatives(independent(truth, (0.2, 0.2, 0.01)), records, nowhere, replay) == (
        None,
        None,
        -math.inf,
    )


@pytest.mark.parametrize("heading_std", [0.02, 0.15])
def test_a_slipped_heading_has_its_alternative_nearby(heading_std: float) -> None:
    """A robot that turned on the spot with poor encoders, whether it knows how far its heading may be off or not."""
    records, truth = records_at("several_walls", "measured", (30.0, 60.0, 20.0))
    replay = replay_of("several_walls", "measured")
    # Turned by 0.3 rad on the spot.
    turned = independent(truth + np.array([0.0, 0.0, 0.3]), (0.2, 0.2, heading_std))
    found = alternatives(turned, records, table_of("several_walls", "measured"), replay)
    assert found.near is not None
    off = difference(found.near.mean, truth)
    assert np.hypot(off[0], off[1]) < 2.0
    assert abs(off[2]) < 0.1
    if found.elsewhere is not None:
        off = difference(found.elsewhere.mean, turned.mean)
        assert np.hypot(off[0], off[1]) > 6.0 or abs(off[2]) > 0.3
