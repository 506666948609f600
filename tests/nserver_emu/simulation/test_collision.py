"""Contacts against a slow march along the path, and what a robot meets: sliding, leaving, corners, other robots."""

from __future__ import annotations

from math import cos, inf, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nserver_emu.simulation.collision import TOUCH_IN, Capsule, Contact, PlacedSegment, first_contact, walls_within
from nserver_emu.simulation.segments import ConstantAccelerationSegment
from worlds.geometry import nearest_points

RADIUS = 9.72
WALL = np.array([[50.0, -40.0, 50.0, 40.0]])
LONG_WALL = np.array([[50.0, -120.0, 50.0, 120.0]])


def all_of(walls: np.ndarray) -> tuple[Capsule, ...]:
    return tuple(Capsule(*wall) for wall in walls.tolist())


def straight(speed: float, seconds: float) -> ConstantAccelerationSegment:
    return ConstantAccelerationSegment(seconds, speed, 0.0, 0.0, 0.0)


def gap(walls: np.ndarray, x: float, y: float) -> float:
    """Smallest distance from the disc to a wall, by the distance to many points of each: slow and plain."""
    shares = np.linspace(0.0, 1.0, 4001)[:, None, None]
    points = walls[:, :2] + shares * (walls[:, 2:] - walls[:, :2])
    return float(np.hypot(points[..., 0] - x, points[..., 1] - y).min()) - RADIUS


def test_head_on() -> None:
    for speed, heading in ((10.0, 0.0), (-10.0, pi)):
        contact = first_contact(PlacedSegment(0.0, 3.0, heading, straight(speed, 10.0)), RADIUS, all_of(WALL))
        assert contact is not None
        assert contact.time_s == pytest.approx((50.0 - RADIUS) / 10.0, abs=1e-9)
        assert (contact.away_x, contact.away_y) == pytest.approx((-1.0, 0.0))


def test_too_short_a_path_touches_nothing() -> None:
    assert first_contact(PlacedSegment(0.0, 3.0, 0.0, straight(10.0, 4.0)), RADIUS, all_of(WALL)) is None
    assert first_contact(PlacedSegment(0.0, 0.0, 0.0, straight(10.0, 4.0)), RADIUS, ()) is None


def test_the_end_of_a_wall_is_round() -> None:
    contact = first_contact(PlacedSegment(0.0, 45.0, 0.0, straight(10.0, 10.0)), RADIUS, all_of(WALL))
    assert contact is not None
    across = sqrt(RADIUS**2 - 5.0**2)
    assert contact.time_s == pytest.approx((50.0 - across) / 10.0, abs=1e-9)
    assert (contact.away_x, contact.away_y) == pytest.approx((-across / RADIUS, 5.0 / RADIUS))


def test_a_disc_is_another_robot() -> None:
    disc = Capsule.disc(40.0, 0.0, 9.0)
    contact = first_contact(PlacedSegment(0.0, 0.0, 0.0, straight(10.0, 10.0)), RADIUS, (disc,))
    assert contact is not None
    assert contact.time_s == pytest.approx((40.0 - 9.0 - RADIUS) / 10.0)
    assert disc.gap_to(RADIUS, 0.0, 0.0) == pytest.approx((31.0 - RADIUS, -1.0, 0.0))
    assert disc.gap_to(RADIUS, 40.0, 20.0) == pytest.approx((11.0 - RADIUS, 0.0, 1.0))


def test_an_accelerated_approach() -> None:
    placed = PlacedSegment(0.0, 0.0, 0.0, ConstantAccelerationSegment(10.0, 0.0, 2.0, 0.0, 0.0))
    contact = first_contact(placed, RADIUS, all_of(WALL))
    assert contact is not None
    assert contact.time_s == pytest.approx(sqrt(50.0 - RADIUS), abs=1e-9)


def test_an_arc_into_a_wall() -> None:
    radius, rate = 60.0, 0.25
    placed = PlacedSegment(0.0, -radius, 0.0, ConstantAccelerationSegment(20.0, radius * rate, 0.0, rate, 0.0))
    contact = first_contact(placed, RADIUS, all_of(LONG_WALL))
    assert contact is not None
    turn = rate * contact.time_s
    assert radius * sin(turn) == pytest.approx(50.0 - RADIUS, abs=1e-9)
    assert placed.position(contact.time_s) == pytest.approx((50.0 - RADIUS, -radius * cos(turn)))


scenes: st.SearchStrategy[np.ndarray] = st.lists(st.tuples(*[st.floats(-60.0, 60.0)] * 4), min_size=1, max_size=4).map(
    np.array
)
turns = st.one_of(st.just(0.0), st.floats(-0.8, 0.8))
motions = st.builds(
    ConstantAccelerationSegment,
    st.floats(0.5, 4.0),
    st.floats(0.5, 20.0),
    st.one_of(st.just(0.0), st.floats(0.0, 20.0)),
    turns,
    turns,
)


@settings(max_examples=60)
@given(scenes, motions, st.floats(-pi, pi), st.sampled_from((1.0, -1.0)))
@example(np.array([[0.0, 11.0, 6.0, 9.0]]), ConstantAccelerationSegment(3.0, 1.0, 9.0, 0.0, 0.0), 0.0, 1.0)
def test_a_slow_march_finds_the_same(
    capsules: np.ndarray, motion: ConstantAccelerationSegment, heading: float, sign: float
) -> None:
    motion = motion._replace(speed=sign * motion.speed, acceleration=sign * motion.acceleration)
    # Starts inside a wall are not meaningful.
    if gap(capsules, 0.0, 0.0) < 0.5:
        return
    placed = PlacedSegment(0.0, 0.0, heading, motion)
    contact = first_contact(placed, RADIUS, all_of(capsules))
    end = motion.duration_s if contact is None else contact.time_s
    # Sixty positions up to the contact, or up to the end: no overlap beyond the chord error.
    gaps = [gap(capsules, *placed.position(end * number / 60.0)) for number in range(61)]
    assert min(gaps) > -2e-4
    if contact is not None:
        # At the contact the robot touches and presses on.
        assert gaps[-1] < 1e-3
        assert contact.pressed_by(
            placed.heading_rad + motion.turn_at(end), motion.velocity_at(end) or motion.acceleration
        )


def test_a_touching_robot_may_leave_and_slide_but_not_press() -> None:
    ground = all_of(WALL)
    # Touching exactly, by rounding, and 2 in inside of the wall.
    for inset in (0.0, 1e-9, -1e-9, 2.0):
        x = 50.0 - RADIUS + inset
        # Along the wall and away from it, forwards and backwards: no contact.
        for heading in (pi / 2, -pi / 2, pi / 2 + 0.01, pi):
            assert first_contact(PlacedSegment(x, 0.0, heading, straight(10.0, 1.0)), RADIUS, ground) is None
            assert first_contact(PlacedSegment(x, 0.0, heading + pi, straight(-10.0, 1.0)), RADIUS, ground) is None
        # Towards the wall: contact at once.
        for heading in (0.0, 1.5, -1.5):
            contact = first_contact(PlacedSegment(x, 0.0, heading, straight(10.0, 1.0)), RADIUS, ground)
            assert contact is not None
            assert contact.time_s == pytest.approx(0.0, abs=1e-8)
            assert contact.pressed_by(heading, 10.0)
            assert not contact.pressed_by(heading, -10.0)


def test_a_path_that_leaves_one_wall_may_meet_another() -> None:
    corner = np.array([[50.0, -40.0, 50.0, 40.0], [-40.0, 40.0, 50.0, 40.0]])
    placed = PlacedSegment(50.0 - RADIUS, 0.0, pi / 2, straight(10.0, 9.0))
    contact = first_contact(placed, RADIUS, all_of(corner))
    assert contact is not None
    assert contact.time_s == pytest.approx((40.0 - RADIUS) / 10.0)
    assert (contact.away_x, contact.away_y) == pytest.approx((0.0, -1.0))


def test_a_grazing_arc_is_found_within_the_chord_error() -> None:
    radius, rate = 30.0, 0.3
    # The arc enters the wall by half a ten-thousandth of an inch.
    graze = 5e-5
    placed = PlacedSegment(
        50.0 - RADIUS - radius + graze, -radius, 0.0, ConstantAccelerationSegment(12.0, radius * rate, 0.0, rate, 0.0)
    )
    contact = first_contact(placed, RADIUS, all_of(LONG_WALL))
    end = 12.0 if contact is None else contact.time_s
    # The deepest point of 500 along the path.
    deepest = max(placed.position(end * number / 500)[0] for number in range(501)) + RADIUS - 50.0
    assert deepest < TOUCH_IN / 5.0


def test_arcs_around_a_post_are_as_exact_as_their_chords() -> None:
    post = (Capsule.disc(0.0, 0.0, 5.0),)
    for extra, sign in ((2e-5, 1.0), (2e-5, -1.0), (1e-3, 1.0)):
        radius = RADIUS + 5.0 + extra
        placed = PlacedSegment(
            radius, 0.0, sign * pi / 2, ConstantAccelerationSegment(2.0, 10.0, 0.0, sign * 10.0 / radius, 0.0)
        )
        contact = first_contact(placed, RADIUS, post)
        assert (contact is None) == (extra > 2e-4)


def test_a_centre_on_the_wall_may_go_anywhere() -> None:
    placed = PlacedSegment(50.0, 0.0, 0.3, straight(10.0, 1.0))
    assert first_contact(placed, RADIUS, all_of(WALL)) is None
    assert all_of(WALL)[0].gap_to(0.0, 50.0, 0.0) == (0.0, 0.0, 0.0)
    assert Capsule.disc(50.0, 0.0, 9.0).gap_to(1.0, 50.0, 0.0) == (-10.0, 0.0, 0.0)


def test_near_walls_and_the_distance_of_the_others() -> None:
    capsules, rest = walls_within(0.0, 0.0, 50.0, np.concatenate((WALL, LONG_WALL + 30.0)))
    assert (capsules, rest) == (all_of(WALL), 80.0)
    assert walls_within(0.0, 0.0, 50.0, WALL) == (all_of(WALL), inf)
    assert walls_within(0.0, 0.0, 49.9, WALL) == ((), 50.0)
    assert walls_within(0.0, 0.0, 1e4, np.empty((0, 4))) == ((), inf)


@pytest.mark.parametrize("distance_in", [0.0, 20.0, 300.0])
def test_many_walls_are_searched_as_few(distance_in: float) -> None:
    rng = np.random.default_rng(1)
    ends = rng.uniform(-2000.0, 2000.0, (500, 2))
    walls = np.column_stack((ends, ends + rng.uniform(-40.0, 40.0, (500, 2))))
    for x, y in (*rng.uniform(-2500.0, 2500.0, (50, 2)).tolist(), (9000.0, 0.0)):
        distances = nearest_points((x, y), walls)[1]
        is_near = distances <= distance_in
        expected = tuple(Capsule(*wall) for wall in walls[is_near].tolist())
        assert walls_within(x, y, distance_in, walls) == (expected, distances[~is_near].min())


def test_pressing_depends_on_the_direction_of_motion() -> None:
    wall_ahead = Contact(0.0, -1.0, 0.0)
    assert wall_ahead.pressed_by(0.0, 1.0)
    assert not wall_ahead.pressed_by(0.0, -1.0)
    assert wall_ahead.pressed_by(pi, -1.0)
    assert not wall_ahead.pressed_by(pi / 2, 1.0)
    assert not wall_ahead.pressed_by(pi / 2, -1.0)
