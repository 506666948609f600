"""Systematic errors: squares after Borenstein and Feng's UMBmark come out as the parameters say; slip; the turret."""

from __future__ import annotations

from cmath import exp, phase
from math import pi, radians, sin

import pytest

from nserver_emu.simulation.models import N150, SCOUT, SCOUT_TRACK_IN, RobotModel
from nserver_emu.simulation.noise import WORN, RobotSetup
from nserver_emu.simulation.odometry import NO_NOISE, MotionNoise, Odometry
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarNoise
from worlds.world import StartPose, World

LEG_IN = 60.0
CCW, CW = 1, -1


def erring(odometry: Odometry, ramps: bool = True, motion: MotionNoise = NO_NOISE) -> RobotSetup:
    return RobotSetup("erring", ramps, motion, SonarNoise(), odometry=odometry)


def robot_with(
    room: World, odometry: Odometry, model: RobotModel = N150, start: StartPose | None = None
) -> tuple[Simulation, SimulatedRobot]:
    simulation = Simulation(room)
    return simulation, simulation.add_robot(1, start, model, erring(odometry))


def square(
    room: World, odometry: Odometry, model: RobotModel, sense: int, leg_in: float = LEG_IN
) -> tuple[complex, float]:
    """(place, turn) at the end of the actual robot, after four legs and four quarter turns back by its encoders."""
    corner = StartPose(-leg_in / 2, -sense * leg_in / 2)
    simulation, robot = robot_with(room, odometry, model, corner)
    # Turns of 90 degrees: by opposite wheels of a Scout, else by the steering.
    wheel = sense * radians(90.0) * SCOUT_TRACK_IN / 2
    legs = (leg_in, leg_in, 0.0) if model is SCOUT else (leg_in, 0.0, 0.0)
    turns = (wheel, -wheel, 0.0) if model is SCOUT else (0.0, sense * pi / 2, 0.0)
    for _ in range(4):
        for motion in (legs, turns):
            robot.move_relative(*motion)
            # 12 s are enough for a leg.
            simulation.step(12.0)
            assert robot.is_still((0, 1, 2))
    # By its encoders the robot is back at the corner.
    assert robot.encoder[:2] == pytest.approx((corner.x_in, corner.y_in), abs=1e-9)
    actual = robot.actual
    return complex(actual.x_in - corner.x_in, actual.y_in - corner.y_in), actual.steering_rad


def composed(steps: list[tuple[complex, float]]) -> tuple[complex, float]:
    """Motions (displacement ahead, turn) put one after another in the plane of complex numbers."""
    place, turn = 0j, 0.0
    for displacement, turned in steps * 4:
        place += displacement * exp(1j * turn)
        turn += turned
    return place, turn


def arc(length: float, turn: float) -> tuple[complex, float]:
    """The end of an arc of this length and turn, started along the x axis."""
    return (length * (exp(1j * turn) - 1.0) / (1j * turn) if turn else complex(length)), turn


@pytest.mark.long
@pytest.mark.parametrize("sense", [CCW, CW])
def test_an_exact_square_closes(room: World, sense: int) -> None:
    place, _ = square(room, Odometry(), N150, sense)
    assert abs(place) < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("sense", [CCW, CW])
def test_a_synchro_square_is_the_closed_form(room: World, sense: int) -> None:
    odometry = Odometry(scales=(1.02, 0.99, 1.0), drifts=(radians(0.05), 0.004))
    place, turn = square(room, odometry, N150, sense)
    piece = arc(1.02 * LEG_IN, radians(0.05) * LEG_IN)
    corner = (0j, sense * (0.99 + 0.004) * pi / 2)
    expected, turned = composed([piece, corner])
    assert (place.real, place.imag) == pytest.approx((expected.real, expected.imag), abs=1e-6)
    assert phase(exp(1j * (turn - turned))) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("sense", [CCW, CW])
def test_a_scouts_square_is_the_closed_form(room: World, sense: int) -> None:
    # Wheels 0.6 % larger and 0.3 % smaller, track 2 % narrower than assumed.
    right, left, share = 1.006, 0.997, 0.98
    outward = (1.0 / share - 1.0) / SCOUT_TRACK_IN
    place, turn = square(room, Odometry((right, left, 1.0), (outward, -outward)), SCOUT, sense)
    # Each wheel turns a quarter of the circle of the assumed track.
    counted = sense * pi / 2 * SCOUT_TRACK_IN / 2
    track = SCOUT_TRACK_IN
    # A leg is an arc because of unequal wheels; a corner turns too far.
    piece = arc(LEG_IN * (right + left) / 2, LEG_IN * (right - left) / track)
    corner = arc(counted * (right - left) / 2, counted * (right + left) / track + outward * 2.0 * counted)
    expected, turned = composed([piece, corner])
    assert (place.real, place.imag) == pytest.approx((expected.real, expected.imag), abs=1e-6)
    assert phase(exp(1j * (turn - turned))) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(("diameters", "share"), [(1.004, 1.0), (1.0, 0.99), (0.998, 1.006)])
def test_umbmark_recovers_diameters_and_wheelbase(room: World, diameters: float, share: float) -> None:
    """Its formulas hold for small errors: alpha by the sum, beta by the difference of the two centres of gravity."""
    # Borenstein and Feng: errors of wheel diameters and track.
    outward = (1.0 / share - 1.0) / SCOUT_TRACK_IN
    mean = (diameters + 1.0) / 2.0
    odometry = Odometry((diameters / mean, 1.0 / mean, 1.0), (outward, -outward))
    # Ends of the square in both directions.
    errors = {sense: square(room, odometry, SCOUT, sense)[0] for sense in (CCW, CW)}
    # alpha from the sum, beta from the difference of the x errors.
    alpha = (errors[CW].real + errors[CCW].real) / (-4.0 * LEG_IN)
    beta = (errors[CW].real - errors[CCW].real) / (-4.0 * LEG_IN)
    # The curvature of a leg gives the ratio of diameters.
    across = 2.0 * sin(beta / 2.0) / LEG_IN
    half = SCOUT_TRACK_IN / 2.0
    assert (1.0 + half * across) / (1.0 - half * across) == pytest.approx(diameters, abs=1e-4)
    assert (pi / 2) / (pi / 2 - alpha) == pytest.approx(share, abs=5e-4)


@pytest.mark.long
def test_worn_errors_after_a_square_of_4_m_are_as_documented(room: World) -> None:
    """Return UMBmark's systematic error, the larger of both ends, without noise: by the closed form and simulated."""
    # 4 m in inches.
    leg_in, odometry = 4.0 / 0.0254, WORN.odometry
    scale, _, _ = odometry.scales
    drift, _ = odometry.drifts
    # The documented ends: 126 mm for an N150, 338 mm for a Scout.
    for model, off_mm in ((N150, 126.0), (SCOUT, 338.0)):
        wheels = (SCOUT_TRACK_IN, scale - 1.0) if model is SCOUT else (1.0, 0.0)
        counted = pi / 4 * SCOUT_TRACK_IN
        ends, errors = [], []
        for sense in (CCW, CW):
            # Scout: scale and drift act on the wheels and on the turn.
            if model is SCOUT:
                piece = arc(leg_in * (scale + 1.0) / 2.0, leg_in * (wheels[1] / wheels[0] + drift))
                turn = sense * counted * ((scale + 1.0) / SCOUT_TRACK_IN + drift)
                corner = arc(sense * counted * wheels[1] / 2.0, turn)
            else:
                # N150: legs are arcs by the drift, corners are exact.
                piece, corner = arc(leg_in * scale, leg_in * drift), (0j, sense * pi / 2)
            ends.append(abs(composed([piece, corner])[0]) * 25.4)
            errors.append(abs(square(room, odometry, model, sense, leg_in)[0]) * 25.4)
        # Simulation and closed form agree to 0.01 mm.
        assert errors == pytest.approx(ends, abs=0.01)
        assert max(ends) == pytest.approx(off_mm, abs=0.5)


def test_encoders_count_the_slip_at_a_wall(room: World) -> None:
    simulation, robot = robot_with(room, Odometry(slip_in=0.4))
    # Encoders have another direction than the robot: counted distance is along y.
    robot.define_angles(pi / 2, 0.0)
    robot.set_velocities(10.0, 0.0, 0.0)
    simulation.step(20.0)
    # The wall is 100 in away; the wheels slip 0.4 in before the motor stops.
    reach = 100.0 - N150.body.radius_in
    assert robot.actual[:2] == pytest.approx((reach, 0.0))
    assert robot.encoder[:2] == pytest.approx((0.0, reach + 0.4))
    assert not robot.moving[0]
    robot.set_velocities(-10.0, 0.0, 0.0)
    simulation.step(25.0)
    assert robot.actual.x_in == pytest.approx(-reach)
    assert robot.encoder.y_in == pytest.approx(reach + 0.4 - 2.0 * reach - 0.4)


def test_finding_zero_corrects_the_turret(room: World) -> None:
    simulation, robot = robot_with(room, Odometry(scales=(1.0, 1.0, 1.05)))
    robot.move_relative(0.0, 0.0, 1.0)
    simulation.step(5.0)
    assert robot.encoder.turret_rad == pytest.approx(1.0)
    assert robot.actual == pytest.approx((0.0, 0.0, 0.0, 1.05))
    robot.zero()
    simulation.step(5.0)
    assert (robot.encoder.turret_rad, robot.actual.turret_rad) == pytest.approx((0.0, 0.0))


def test_a_wall_is_met_where_the_body_really_is(room: World) -> None:
    simulation, robot = robot_with(room, Odometry(scales=(1.25, 1.0, 1.0)))
    robot.set_velocities(8.0, 0.0, 0.0)
    simulation.step(20.0)
    reach = 100.0 - N150.body.radius_in
    assert robot.actual.x_in == pytest.approx(reach)
    assert robot.encoder.x_in == pytest.approx(reach / 1.25)


def test_a_wall_holds_a_drifting_scout_while_it_turns(room: World) -> None:
    start = StartPose(100.0 - SCOUT.body.radius_in, 0.0, radians(180.0))
    simulation, robot = robot_with(room, Odometry(scales=(1.2, 0.8, 1.0)), SCOUT, StartPose(0.0, 0.0))
    robot.place(start.x_in, start.y_in, start.steering_rad, 0.0)
    robot.move_relative(-30.0, 30.0, 0.0)
    simulation.step(0.8)
    assert robot.moving == (True, True, False)
    assert robot.actual.x_in <= start.x_in + 1e-9
    simulation.step(3.0)
    assert robot.is_still((0, 1))
    assert robot.encoder.steering_rad != pytest.approx(start.steering_rad)
