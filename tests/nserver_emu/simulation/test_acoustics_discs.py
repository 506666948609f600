"""Echoes of other robots: against fans of rays, against the closed forms, and behind and before walls."""

from __future__ import annotations

from dataclasses import replace
from math import asin, cos, hypot, inf, log10, pi, radians, sin, sqrt

import numpy as np
import pytest

from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap
from nserver_emu.simulation.models import N150 as N150_MODEL
from nserver_emu.simulation.noise import MEASURED
from nserver_emu.simulation.odometry import NO_NOISE
from nserver_emu.simulation.segments import to_ps
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.simulation.single_pings import first_echo_in
from worlds.geometry import FloatArray
from worlds.robots import N150
from worlds.world import StartPose, World

pytestmark = pytest.mark.long

MODEL = Polaroid()
ROUND = replace(MODEL, skin_loss_db=inf, margin_std_db=0.0)
"""Discs as smooth mirrors only."""
LOUD = replace(ROUND, margin_db=1e6, edge_loss_db=inf)
RING = N150.sonar_ring_radius_in
FACE = RING - MODEL.recess_in
RADIUS = N150.radius_in
HALF = MODEL.cone_rad / 2.0
FAR = 1e6
NO_DISCS = np.empty((0, 3))
NO_WALLS = np.empty((0, 4))


def ping(direction_rad: float = 0.0, instant_s: float = 0.0) -> Ping:
    return Ping(0.0, 0.0, direction_rad, to_ps(instant_s), (0.0, 0.0))


def disc(away_in: float, bearing_rad: float = 0.0, radius_in: float = RADIUS) -> FloatArray:
    """A robot whose middle is that far from the transducer of sonar 0, and there seen from it."""
    return np.array([[FACE + away_in * cos(bearing_rad), away_in * sin(bearing_rad), radius_in]])


def first(
    discs: FloatArray, model: Polaroid = MODEL, walls: FloatArray = NO_WALLS, now: Ping | None = None,
    earlier: tuple[Ping, ...] = (),
) -> float:  # fmt: skip
    return first_echo_in(model, now or ping(), earlier, ReflectorMap(walls), N150, discs)


def rays(count: int) -> tuple[FloatArray, FloatArray]:
    """A fan over the cone of sonar 0: angles off its axis (count,) and directions (count, 2)."""
    angles = np.linspace(-HALF, HALF, count)
    return angles, np.stack((np.cos(angles), np.sin(angles)), axis=1)


def met_by(directions: FloatArray, discs: FloatArray, walls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ranges (count,) at which rays from the transducer first hit a disc, and the cosines of incidence.

    The range is FAR if there is no disc or a wall is in front of it. Oracle by brute force: each ray with each disc by
    the quadratic formula and with each wall by solving the 2x2 system.
    """
    ranges, cosines = np.full(len(directions), FAR), np.zeros(len(directions))
    for ray, direction in enumerate(directions):
        for x, y, radius in discs:
            # Nearest solution of |t d - c| = r.
            to = np.array([x - FACE, y])
            root = (to @ direction) ** 2 - to @ to + radius**2
            reach = to @ direction - sqrt(root) if root >= 0.0 else FAR
            if 0.0 < reach < ranges[ray]:
                # Cosine between the ray and the normal at the point of incidence.
                ranges[ray], cosines[ray] = reach, -direction @ (reach * direction - to) / radius
        for x1, y1, x2, y2 in walls:
            reach, share = np.linalg.solve([[direction[0], x1 - x2], [direction[1], y1 - y2]], [x1 - FACE, y1])
            if 0.0 < reach < ranges[ray] and 0.0 <= share <= 1.0:
                ranges[ray] = FAR
    return ranges, cosines


# Against many rays


@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_loud_point_of_a_robot_is_the_echo(seed: int) -> None:
    """Compare with 4001 rays: each point of the disc with its loss, and the points of normal incidence."""
    rng = np.random.default_rng(seed)
    # Two robots of random size in front of the transducer, and a short wall among them.
    discs = np.concatenate([disc(rng.uniform(15.0, 120.0), rng.uniform(-0.6, 0.6), rng.uniform(7.0, 10.0))
                            for _ in range(2)])  # fmt: skip
    middle, turn = rng.uniform((20.0, -10.0), (60.0, 10.0)), rng.uniform(-pi, pi)
    along = 4.0 * np.array([cos(turn), sin(turn)])
    walls = np.array([[*(middle - along), *(middle + along)]])
    # Edges of the wall are silent: the oracle has none.
    model = replace(MODEL, edge_loss_db=inf)
    angles, directions = rays(4001)
    ranges, cosines = met_by(directions, discs, walls)
    # Two-way losses of each ray: off the axis and by range.
    beam_db = MODEL.cone_loss_db * (angles / HALF) ** 2 + MODEL.absorption_db_in * ranges
    # Anywhere on a robot some sound is scattered back.
    loud = beam_db + MODEL.skin_loss_db <= MODEL.margin_db
    # At normal incidence it is reflected, and spreads by the curvature of the disc.
    for x, y, radius in discs:
        spread_db = 10.0 * log10(1.0 + (hypot(x - FACE, y) - radius) / radius)
        ours = np.abs(np.hypot(FACE + ranges * directions[:, 0] - x, ranges * directions[:, 1] - y) - radius) < 1e-6
        loud |= ours & (cosines > 1.0 - 1e-5) & (beam_db + spread_db <= MODEL.margin_db)
    expected = ranges[loud].min(initial=inf)
    # The wall alone, by the simulator itself: walls are tested elsewhere.
    off_the_wall = first_echo_in(model, ping(), (), ReflectorMap(walls), N150)
    measured = first(discs, model, walls)
    assert measured == pytest.approx(min(expected - MODEL.recess_in, off_the_wall), abs=0.5)


@pytest.mark.parametrize("distance", [12.0, 40.0, 90.0, 250.0])
def test_a_round_robot_spreads_the_sound_as_a_bundle_of_rays(distance: float) -> None:
    """Two rays close together come back so much farther apart than off a wall; the reach is where that is too soft."""
    # Two rays at +-1e-5 rad; the second follows by symmetry.
    angle = 1e-5
    # Angle of incidence by the law of sines.
    sideways = distance * sin(angle) / RADIUS
    struck = asin(sideways)
    range_in = distance * cos(angle) - RADIUS * sqrt(1.0 - sideways**2)
    # Direction after reflection, and the distance between the rays back at the sonar.
    turned = pi + angle - 2.0 * struck
    back = np.array([range_in * cos(angle), range_in * sin(angle)])
    apart = abs(back[1] + (-back[0] / cos(turned)) * sin(turned))
    gap = distance - RADIUS
    # A flat mirror would return them 2 x gap x angle apart.
    spread_db = 10.0 * log10(apart / (2.0 * gap * angle))
    needed_db = spread_db + MODEL.absorption_db_in * gap
    # A margin just above the loss detects it, one just below does not.
    assert first(disc(distance), replace(ROUND, margin_db=needed_db + 0.01)) == pytest.approx(gap - MODEL.recess_in)
    assert first(disc(distance), replace(ROUND, margin_db=needed_db - 0.01)) == inf


@pytest.mark.parametrize(("bearing_deg", "distance"), [(5.0, 50.0), (11.25, 80.0), (16.0, 30.0)])
def test_neighbours_receive_what_obeys_the_law_of_reflection(bearing_deg: float, distance: float) -> None:
    """The shortest path over 200,001 points of the rim is the specular one."""
    one, other = ping(0.0), ping(radians(22.5), 0.001)
    target = disc(distance, radians(bearing_deg))
    x, y, radius = target[0]
    # Fermat: of all points of the rim the reflecting one has the shortest path.
    around = np.linspace(0.0, 2.0 * pi, 200_001)
    rim = np.stack((x + radius * np.cos(around), y + radius * np.sin(around)), axis=1)
    faces = [(FACE, 0.0), (FACE * cos(radians(22.5)), FACE * sin(radians(22.5)))]
    there, back = (np.hypot(rim[:, 0] - u, rim[:, 1] - v) for u, v in faces)
    length = float((there + back).min())
    # The sonar's own echo, and the earlier one of its neighbour with its head start of 1 ms.
    self_index = hypot(x - faces[1][0], y - faces[1][1]) - radius - MODEL.recess_in
    cross = (length - 0.001 * MODEL.sound_in_s) / 2.0 - MODEL.recess_in
    wide = replace(LOUD, cone_rad=pi / 2.0)
    assert first(target, wide, now=other, earlier=(one,)) == pytest.approx(min(self_index, cross), abs=1e-6)
    assert cross < self_index


# Closed forms of the cone


def test_a_robot_echoes_from_its_nearest_point_in_the_cone() -> None:
    # Within the cone the nearest point is straight towards the centre.
    for bearing in (-0.2, 0.0, 0.1, HALF - 1e-9):
        assert first(disc(60.0, bearing), LOUD) == pytest.approx(60.0 - RADIUS - MODEL.recess_in)
    # Centre outside the cone: the nearest point lies on the rim of the cone.
    for bearing in (HALF + 0.01, 0.3, -0.35):
        beyond = abs(bearing) - HALF
        reach = 25.0 * cos(beyond) - sqrt(RADIUS**2 - (25.0 * sin(beyond)) ** 2)
        assert first(disc(25.0, bearing)) == pytest.approx(reach - MODEL.recess_in)
        assert first(disc(25.0, bearing), LOUD) == inf
    # No part of the disc is within the cone.
    for bearing in (HALF + asin(RADIUS / 60.0) + 1e-3, 1.0, pi):
        assert first(disc(60.0, bearing)) == inf
    assert first(disc(RADIUS + 0.2, 2.5)) == inf


@pytest.mark.parametrize("gap_in", [0.05, 1.0, 60.0])
def test_the_rim_of_the_cone_is_in_it_wherever_the_robot_is(gap_in: float) -> None:
    """Rounding of the coordinates would leave out half of these echoes, and the next point is farther away."""
    away, bearing = RADIUS + gap_in, HALF + 0.5 * asin(RADIUS / (RADIUS + gap_in))
    along = away * cos(bearing - HALF) - sqrt(RADIUS**2 - (away * sin(bearing - HALF)) ** 2)
    model = replace(MODEL, margin_db=1e6)
    for turn in np.linspace(-3.0, 3.0, 61).tolist():
        now = Ping(1156.8, 387.9, turn, 0, (0.0, 0.0))
        x = 1156.8 + FACE * cos(turn) + away * cos(turn + bearing)
        y = 387.9 + FACE * sin(turn) + away * sin(turn + bearing)
        assert first(np.array([[x, y, RADIUS]]), model, now=now) == pytest.approx(along - MODEL.recess_in, abs=1e-7)


def test_a_robot_echoes_at_angles_at_which_a_wall_does_not() -> None:
    """A wall through the nearest point of the robot, 45 degrees off, mirrors all away; a robot always faces one."""
    x = FACE + 40.0
    wall = np.array([[x - 5.0, -5.0, x + 5.0, 5.0]])
    mute = replace(MODEL, edge_loss_db=inf)
    assert first(NO_DISCS, mute, wall) == inf
    turned = disc(40.0 + RADIUS, 0.0)
    assert first(turned, mute) == pytest.approx(39.5)


def test_inside_a_robot_there_is_no_echo_from_it() -> None:
    assert first(disc(5.0)) == inf


# Walls and robots


def test_a_robot_hides_walls_and_a_wall_hides_robots() -> None:
    # A wall 100 in away; the recess of the transducer is half an inch.
    x = FACE + 100.0
    back_wall = np.array([[x, -300.0, x, 300.0]])
    narrow = disc(50.0, 0.0, 3.0)
    assert first(NO_DISCS, LOUD, back_wall) == pytest.approx(99.5)
    # Reflection at walls only: losses at a robot exceed the margin.
    deaf_to_robots = replace(LOUD, margin_db=11.0, absorption_db_in=0.0)
    assert first(narrow, LOUD, back_wall) == pytest.approx(46.5)
    assert first(narrow, deaf_to_robots, back_wall) == inf
    assert first(disc(50.0, 0.1, 3.0), deaf_to_robots, back_wall) == pytest.approx(99.5)
    # A screen at an angle in front of a robot hides it; its own echo is unchanged.
    screen = np.array([[FACE + 30.0, -20.0, FACE + 31.0, 20.0]])
    assert first(disc(60.0), LOUD, screen) == first(NO_DISCS, LOUD, screen) < 31.0
    # A screen that reflects sideways: neither robot nor screen is detected.
    slanted = np.array([[FACE + 30.0, -20.0, FACE + 50.0, 20.0]])
    assert first(disc(90.0), LOUD, slanted) == inf


def test_a_robot_reflected_in_a_slanted_wall_appears_too_far() -> None:
    x = FACE + 50.0
    mirror = np.array([[x - 10.0, -10.0, x + 10.0, 10.0]])
    robot = np.array([[x, 70.0, RADIUS]])
    assert first(robot, LOUD, mirror) == pytest.approx(50.0 + 70.0 - RADIUS - 0.5)
    needed_db = 2.0 * MODEL.bounce_loss_db + MODEL.absorption_db_in * (120.0 - RADIUS) + 10.0 * log10(120.0 / RADIUS)
    mute = replace(ROUND, edge_loss_db=inf)
    assert first(robot, replace(mute, margin_db=needed_db + 0.01), mirror) < inf
    assert first(robot, replace(mute, margin_db=needed_db - 0.01), mirror) == inf


def test_a_robot_beside_the_axis_is_measured_in_the_ring(room: World) -> None:
    simulation = Simulation(room, 1)
    simulation.add_robot(1, StartPose(0.0, 0.0), N150_MODEL, MEASURED)
    simulation.add_robot(2, StartPose(50.0, 11.0), N150_MODEL, MEASURED)
    # One second: the ring fires once (16 x 60 ms).
    simulation.step(1.0)
    # The other robot is off the axis by more than its radius, and within the cone.
    assert RADIUS < 11.0
    readings = simulation.robots[1].sonar.readings_in
    assert readings[0] == pytest.approx(hypot(50.0 - FACE, 11.0) - RADIUS - 0.5, abs=2.0)
    # Moved out of the cone: the reading is that of the wall.
    simulation.robots[2].place(-50.0, 60.0, 0.0, 0.0)
    simulation.step(1.0)
    assert simulation.robots[1].sonar.readings_in[0] > 80


def two_measured(room: World) -> Simulation:
    """Two robots that pass one another, their motion exact, firing as fast as they can."""
    simulation = Simulation(room, 1)
    setup = replace(MEASURED, motion=NO_NOISE)
    for robot_id, (x, y, heading) in enumerate(((-40.0, -12.0, 0.0), (40.0, 12.0, pi)), start=1):
        robot = simulation.add_robot(robot_id, StartPose(x, y, heading, heading), N150_MODEL, setup)
        robot.configure_sonars(3, tuple(range(16)))
        robot.set_velocities(15.0, 0.0, 0.3)
    return simulation


def measured(simulation: Simulation) -> list[tuple[float, ...]]:
    return [robot.sonar.readings_in for robot in simulation.robots.values()]


def test_step_size_and_reading_change_no_echo_of_a_robot(room: World) -> None:
    results = []
    # Steps much longer than, equal to and not a divisor of the tick of 10 ms.
    for step_s in (0.5, 0.01, 0.007):
        simulation = two_measured(room)
        while simulation.time_s < 1.5 - 1e-9:
            simulation.step(min(step_s, 1.5 - simulation.time_s))
            if step_s == 0.007:
                measured(simulation)
        results.append(measured(simulation))
    assert results[0] == results[1] == results[2]


def test_restored_robots_continue_to_measure_one_another(room: World) -> None:
    simulation = two_measured(room)
    simulation.step(0.777)
    twin = Simulation.from_state(simulation.to_state())
    for one in (simulation, twin):
        one.step(1.0)
    assert measured(simulation) == measured(twin)
