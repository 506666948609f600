"""The Polaroid model: acoustic paths against a ray tracer, levels and times against closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import cos, erf, inf, pi, radians, sin, sqrt

import numpy as np
import pytest

from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap
from nserver_emu.simulation.echo_paths import is_edge
from nserver_emu.simulation.segments import Pose, Stamp, to_ps
from nserver_emu.simulation.sonar import SonarRing
from nserver_emu.simulation.visibility import SensorPose
from tests.nserver_emu.simulation.single_pings import first_echo_in, measured_range
from worlds.geometry import FloatArray, nearest_points
from worlds.robots import N150

pytestmark = pytest.mark.long

MODEL = Polaroid()
LOUD = replace(MODEL, margin_db=1e6, edge_loss_db=inf)
"""Every path off walls is loud enough, none off edges."""
RING = N150.sonar_ring_radius_in
FACE = RING - MODEL.recess_in
MIDDLE = (0.0, 0.0)
QUIET = (0.0, 0.0)
STAMP = Stamp(Pose(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)


def ping(direction_rad: float = 0.0, instant_s: float = 0.0, noise: tuple[float, ...] = QUIET) -> Ping:
    return Ping(*MIDDLE, direction_rad, to_ps(instant_s), noise)


def first(walls: list[list[float]], now: Ping, model: Polaroid = MODEL, earlier: tuple[Ping, ...] = ()) -> float:
    return first_echo_in(model, now, earlier, ReflectorMap(np.array(walls)), N150)


def wall(normal_rad: float, distance_in: float, half_in: float = 500.0) -> list[float]:
    """A wall whose foot, seen from the transducer of sonar 0 of a robot in the middle, lies there."""
    foot_x, foot_y = FACE + distance_in * cos(normal_rad), distance_in * sin(normal_rad)
    along_x, along_y = -sin(normal_rad) * half_in, cos(normal_rad) * half_in
    return [foot_x - along_x, foot_y - along_y, foot_x + along_x, foot_y + along_y]


# Acoustic paths


def traced(walls: FloatArray, source: Ping, receiver: Ping, rays: int = 30001) -> list[float]:
    """Return the lengths of the paths between two transducers by tracing rays; within 0.03 in is a hit."""
    # Transmitter and receiver on the ring, rays evenly over the cone.
    start, end = (FACE * np.array([cos(c.direction_rad), sin(c.direction_rad)]) for c in (source, receiver))
    half = MODEL.cone_rad / 2.0
    angles = source.direction_rad + np.linspace(-half, half, rays)
    at, direction = np.tile(start, (rays, 1)), np.stack((np.cos(angles), np.sin(angles)), axis=1)
    gone, sequence, found = np.zeros(rays), [np.full(rays, -1)], []
    # At most three reflections: direct, two walls of a corner, and back over the first.
    for _ in range(4):
        a, b = walls[:, :2], walls[:, 2:]
        side = b - a
        # Intersection of each ray with each wall by Cramer's rule.
        turned = direction[:, :1] * side[:, 1] - direction[:, 1:] * side[:, 0]
        off = a - at[:, np.newaxis]
        ahead = (off[..., 0] * side[:, 1] - off[..., 1] * side[:, 0]) / turned
        share = (off[..., 0] * direction[:, 1:] - off[..., 1] * direction[:, :1]) / turned
        # Behind, beside the wall or at the wall just left: no hit.
        ahead[(share < 0) | (share > 1) | (ahead < 1e-7)] = inf
        ahead[np.arange(rays), sequence[-1]] = np.where(sequence[-1] < 0, ahead[np.arange(rays), sequence[-1]], inf)
        hit, reach = ahead.argmin(axis=1), ahead.min(axis=1)
        # Closest approach of each ray to the receiver, before the next wall.
        passing = ((end - at) * direction).sum(axis=1)
        miss = np.hypot(*(at + passing[:, np.newaxis] * direction - end).T)
        back = -direction @ np.array([cos(receiver.direction_rad), sin(receiver.direction_rad)])
        # Received: after a reflection, in front of the next wall, near enough and within the receiver's cone.
        met = (len(sequence) > 1) & (passing > 0) & (passing < reach) & (miss < 0.03) & (back > cos(half))
        # Three reflections count only as out and back over the same corner.
        if len(sequence) == 4:
            met &= sequence[1] == sequence[3]
        found += (gone + passing)[met].tolist()
        alive = np.isfinite(reach)
        at = at + np.where(alive, reach, 0.0)[:, np.newaxis] * direction
        gone = np.where(alive, gone + reach, 1e9)
        # Mirror the direction at the normal of the wall.
        normal = np.stack((-side[hit, 1], side[hit, 0]), axis=1) / np.hypot(*side[hit].T)[:, np.newaxis]
        direction = direction - 2.0 * (direction * normal).sum(axis=1)[:, np.newaxis] * normal
        sequence.append(hit)
    return sorted(found)


# The first echoes of 1 include some over a wall onto another, those of 5 some off two walls.
@pytest.mark.parametrize("seed", [1, 5])
def test_the_first_echo_is_the_shortest_path_of_traced_rays(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Seven walls of 80 in at random; none within an inch of the ring.
    turns = rng.uniform(-pi, pi, 7)
    middles = rng.uniform(-90.0, 90.0, (7, 2))
    spans = 40.0 * np.stack((np.cos(turns), np.sin(turns)), axis=1)
    walls = np.hstack((middles - spans, middles + spans))
    walls = walls[nearest_points(MIDDLE, walls)[1] > FACE + 1.0]
    for number in range(16):
        mine = ping(radians(22.5 * number))
        # Half of the path, less the recess of the transducer behind the face.
        lengths = traced(walls, mine, mine)
        expected = lengths[0] / 2.0 - MODEL.recess_in if lengths else inf
        measured = first_echo_in(LOUD, mine, (), ReflectorMap(walls), N150)
        assert measured == pytest.approx(expected, abs=0.02)


def test_a_slanted_wall_echoes_only_inside_the_cone() -> None:
    for degrees in (-12.0, -5.0, 0.0, 8.0, 12.0):
        assert first([wall(radians(degrees), 60.0)], ping()) == pytest.approx(59.5)
    for degrees in (-13.0, 13.0, 30.0):
        assert first([wall(radians(degrees), 60.0)], ping()) == inf


def test_a_square_corner_sends_all_back_from_its_vertex() -> None:
    for degrees in (20.0, 45.0, 71.0):
        x = FACE + 80.0
        arms = [radians(degrees + 90.0), radians(degrees + 180.0)]
        walls = [[x, 0.0, x + 90.0 * cos(arm), 90.0 * sin(arm)] for arm in arms]
        assert first(walls, ping(), LOUD) == pytest.approx(79.5)


def test_walls_reflected_in_a_slanted_wall_appear_too_far() -> None:
    x = FACE + 50.0
    mirror, other = [x - 10.0, -10.0, x + 10.0, 10.0], [x - 30.0, 70.0, x + 30.0, 70.0]
    assert first([mirror, other], ping(), LOUD) == pytest.approx(50.0 + 70.0 - 0.5)
    screen = [x - 30.0, 30.0, x + 30.0, 31.0]
    assert first([mirror, other, screen], ping(), LOUD) != pytest.approx(119.5)


def test_edges_scatter_but_not_where_a_wall_continues() -> None:
    end, far = [FACE + 40.0, 0.0, FACE + 90.0, 50.0], [FACE + 90.0, 50.0, FACE + 91.0, 51.0]
    assert first([end], ping()) == pytest.approx(39.5)
    walls = [(end[0], end[1], end[2], end[3]), (far[0], far[1], far[2], far[3])]
    corners = [(x, y) for x1, y1, x2, y2 in walls for x, y in ((x1, y1), (x2, y2))]
    assert [is_edge(x, y, walls) for x, y in corners] == [True, False, False, True]
    assert first([end, [FACE + 30.0, -1.0, FACE + 31.0, 1.0]], ping()) == pytest.approx(29.5, abs=1.0)


def test_walls_without_a_length_reflect_nothing() -> None:
    assert first([[FACE + 30.0, 0.0, FACE + 30.0, 0.0]], ping(), LOUD) == inf
    assert first_echo_in(MODEL, ping(), (), ReflectorMap(np.empty((0, 4))), N150) == inf


# Levels


def test_far_and_slanted_walls_are_lost_at_their_levels() -> None:
    for degrees in (0.0, 6.25, 12.49):
        lost = MODEL.cone_loss_db * (degrees / 12.5) ** 2
        reach = (MODEL.margin_db - lost) / MODEL.absorption_db_in
        assert first([wall(radians(degrees), reach - 0.1)], ping()) == pytest.approx(reach - 0.6)
        assert first([wall(radians(degrees), reach + 0.1)], ping()) == inf


def test_echoes_near_the_limit_are_lost_by_the_level_noise() -> None:
    rng = np.random.default_rng(3)
    model = replace(MODEL, edge_loss_db=inf)
    above_db, pings = 2.0, 2000
    reflectors = ReflectorMap(np.array([wall(0.0, (MODEL.margin_db - above_db) / MODEL.absorption_db_in)]))
    measured = sum(first_echo_in(model, ping(noise=model.draw(rng)), (), reflectors, N150) < inf for _ in range(pings))
    expected = 0.5 * (1.0 + erf(above_db / MODEL.margin_std_db / sqrt(2.0)))
    assert measured / pings == pytest.approx(expected, abs=4.0 * sqrt(expected * (1.0 - expected) / pings))


def test_ranges_have_one_percent_of_noise_and_a_floor() -> None:
    rng = np.random.default_rng(4)
    for distance, std in ((100.0, 0.995), (3.0, 0.05)):
        reflectors = ReflectorMap(np.array([wall(0.0, distance)]))
        measured = [measured_range(MODEL, ping(noise=MODEL.draw(rng)), (), reflectors, N150) for _ in range(1500)]
        assert np.mean(measured) == pytest.approx(distance - 0.5, abs=4.0 * std / sqrt(1500))
        assert np.std(measured) == pytest.approx(std, rel=0.08)
    assert measured_range(MODEL, ping(), (), ReflectorMap(np.empty((0, 4))), N150) == inf


# Neighbours


def test_cross_talk_is_too_short_by_the_head_start() -> None:
    midway, distance = radians(11.25), 100.0
    # A wall at right angles to the direction midway between two neighbouring sonars.
    at = np.array([cos(midway), sin(midway)]) * distance
    along = np.array([-sin(midway), cos(midway)]) * 300.0
    walls = [[*(at - along), *(at + along)]]
    one, other = ping(0.0, 0.0), ping(radians(22.5), 0.004)
    faces = FACE * np.array([[1.0, 0.0], [cos(radians(22.5)), sin(radians(22.5))]])
    # The path of the echo by the mirror image of the first transducer.
    image = faces[0] + 2.0 * (distance - FACE * cos(midway)) * at / distance
    length = float(np.hypot(*(image - faces[1])))
    # The second sonar fires 4 ms later and takes the first echo as its own: too short by 2 ms of sound.
    assert first(walls, other, earlier=(one,)) == pytest.approx((length - 0.004 * MODEL.sound_in_s) / 2.0 - 0.5)
    # Fired 14.5 ms later, the first echo has passed already.
    late = other._replace(instant_ps=to_ps(0.0145))
    assert first(walls, late, earlier=(one,)) == pytest.approx(distance - FACE * cos(midway) - 0.5)
    # A transducer that faces away does not receive it.
    facing_away = ping(radians(180.0), 0.004)
    assert first(walls, facing_away, earlier=(one,)) == inf


def ring(seed: int = 7, model: Polaroid = MODEL, side: float = 100.0) -> SonarRing:
    s = side
    walls = np.array([[-s, -s, s, -s], [s, -s, s, s], [s, s, -s, s], [-s, s, -s, -s]])
    return SonarRing(N150, model, walls, np.random.default_rng(seed))


def too_short(rate: int, order: tuple[int, ...]) -> float:
    """Share of readings that are clearly shorter than anything in the room."""
    sonars = ring(model=replace(MODEL, edge_loss_db=inf))
    # A new order starts at instant 0; the robot stands in the middle.
    sonars.configure(rate, order, 0)
    short = 0
    for number in range(320):
        sonar = order[number % 16]
        sonars.emit_due(SensorPose(*MIDDLE, radians(11.25)), STAMP)
        # Everything in the room is at least 85 in away.
        short += sonars.readings_in[sonar] < 85
    return short / 320


def test_neighbours_interfere_only_at_fast_firing() -> None:
    in_turn = tuple(range(16))
    assert too_short(15, in_turn) == 0.0
    assert 0.15 < too_short(1, in_turn) < 0.8


# The ring


def test_reading_often_or_late_gives_the_same_values() -> None:
    often, late = ring(), ring()
    for sonars in (often, late):
        sonars.configure(1, tuple(range(16)), 0)
    for number in range(64):
        for sonars in (often, late):
            sonars.emit_due(SensorPose(0.3 * number, -0.2 * number, 0.05 * number), STAMP)
        seen = often.readings_in
    assert late.readings_in == seen


def test_near_walls_read_6_and_dead_sonars_0() -> None:
    close = ring(side=12.0, model=replace(MODEL, dead=(4, 5)))
    before = close.readings_in
    close.emit_all(SensorPose(*MIDDLE, 0.0), STAMP)
    assert (before[4], before[5], before[6]) == (0, 0, 255)
    readings = close.readings_in
    assert (readings[0], readings[4], readings[5], readings[8]) == (6, 0, 0, 6)


def test_in_a_smooth_room_readings_differ_from_rays() -> None:
    sonars = ring()
    sonars.emit_all(SensorPose(*MIDDLE, 0.0), STAMP)
    readings = sonars.readings_in
    assert readings[0] == pytest.approx(91, abs=4)
    assert readings[2] == pytest.approx(100.0 * sqrt(2.0) - RING, abs=6)
    assert [readings[number] for number in (1, 3, 5, 7)] == [255] * 4
