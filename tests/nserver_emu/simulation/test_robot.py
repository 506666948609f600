"""Commands and what they do to the encoder robot and the actual one."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, radians, remainder, sin, tau

import numpy as np
import pytest

from nclient.protocol.types import DEFAULT_SONAR_ORDER as DEFAULT_ORDER
from nserver_emu.simulation.noise import NOISY, RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose

Lone = Callable[..., tuple[Simulation, SimulatedRobot]]
REACH = 100.0 - 9.72
"""Where a robot touches the walls of the room."""

RAMPS_ONLY = RobotSetup("ramps only", ramps=True, motion=NOISY.motion.__class__(), sonar=NOISY.sonar.__class__())


def still(robot: SimulatedRobot) -> bool:
    return robot.is_still((0, 1, 2))


def test_at_power_on_all_sonars_have_readings(lone: Lone) -> None:
    _, robot = lone(StartPose(10.0, -20.0, 0.5, -0.5))
    assert robot.encoder == robot.actual == pytest.approx((10.0, -20.0, 0.5, tau - 0.5))
    assert robot.velocities == (0.0, 0.0, 0.0)
    assert robot.moving == (False, False, False)
    assert robot.bumpers == 0
    assert 255 not in robot.sonar.readings_in
    assert all(stamp.pose == robot.encoder and stamp.sensor_time_s == 0.0 for stamp in robot.sonar.stamps)


def test_velocities_draw_an_arc_until_the_next_command(lone: Lone) -> None:
    simulation, robot = lone()
    robot.set_velocities(10.0, 0.5, -0.25)
    assert robot.velocities == (10.0, 0.5, -0.25)
    simulation.step(3.0)
    arc = 20.0 * sin(1.5), 20.0 * (1.0 - cos(1.5)), 1.5, tau - 0.75
    assert robot.encoder == robot.actual == pytest.approx(arc)
    robot.stop()
    assert (robot.velocities, still(robot)) == ((0.0, 0.0, 0.0), True)


def test_relative_moves_run_all_at_once_each_at_its_speed(lone: Lone) -> None:
    simulation, robot = lone()
    robot.set_speeds(5.0, 0.2, 0.4)
    robot.move_relative(-10.0, 0.0, 1.0)
    assert robot.velocities == (-5.0, 0.0, 0.4)
    # 10 in at 5 in/s take 2 s; the turret needs 2.5 s for 1 rad.
    simulation.step(1.99)
    assert robot.moving == (True, False, True)
    simulation.step(0.02)
    assert robot.moving == (False, False, True)
    # Axes 0 and 2 together are not still, 0 and 1 are.
    assert not robot.is_still((0, 2))
    assert robot.is_still((0, 1))
    simulation.step(1.0)
    assert (robot.velocities, still(robot)) == ((0.0, 0.0, 0.0), True)
    # Steering and turret begin at 0; the turret has turned its radian.
    assert robot.encoder == pytest.approx((-10.0, 0.0, 0.0, 1.0))


def test_mv_commands_each_axis_separately(lone: Lone) -> None:
    simulation, robot = lone()
    robot.set_velocities(1.0, 0.0, 0.3)
    # Mode 0 leaves the axis, 1 sets a velocity, 3 lets it go.
    robot.command_axis(0, 0, 99.0)
    robot.command_axis(1, 1, -0.5)
    robot.command_axis(2, 3, 99.0)
    assert robot.velocities == (1.0, -0.5, 0.0)
    # Mode 5 sets the speed, which mode 2 (relative) uses at once.
    robot.command_axis(0, 5, 4.0)
    robot.command_axis(0, 2, -8.0)
    assert robot.velocities == (-4.0, -0.5, 0.0)
    # 8 in at 4 in/s take 2 s.
    simulation.step(2.5)
    assert robot.moving == (False, True, False)


def test_mv_sets_accelerations(lone: Lone) -> None:
    simulation, robot = lone(setup=RAMPS_ONLY)
    robot.command_axis(0, 4, 10.0)
    robot.set_velocities(20.0, 0.0, 0.0)
    simulation.step(1.0)
    assert robot.velocities[0] == pytest.approx(10.0)
    assert robot.encoder.x_in == pytest.approx(5.0)


@pytest.mark.parametrize("command", [-1, 6, 7, 8])
def test_mv_has_six_commands(lone: Lone, command: int) -> None:
    _, robot = lone()
    with pytest.raises(ValueError, match=str(command)):
        robot.command_axis(0, command, 1.0)


def test_ramps_stop_smoothly_and_always_show_a_velocity(lone: Lone) -> None:
    simulation, robot = lone(setup=RAMPS_ONLY)
    # 10 in/s^2 up to 20 in/s: two seconds, 20 in.
    robot.set_accelerations(10.0, radians(100.0), radians(100.0))
    robot.set_velocities(20.0, 0.0, 0.0)
    assert robot.velocities[0] > 0.0
    simulation.step(2.0)
    robot.stop()
    assert robot.velocities[0] == pytest.approx(20.0)
    # Braking takes two seconds more, and 20 in.
    simulation.step(1.99)
    assert robot.velocities[0] > 0.0
    simulation.step(0.02)
    assert (robot.velocities[0], still(robot)) == (0.0, True)
    assert robot.actual.x_in == pytest.approx(40.0)
    robot.set_velocities(0.0, 0.5, 0.5)
    # Limp: all axes are released at once.
    robot.limp()
    assert still(robot)


def test_dp_and_da_change_only_the_encoders(lone: Lone) -> None:
    simulation, robot = lone(StartPose(5.0, 5.0, 0.2, 0.1))
    robot.define_position(-7.0, 3.0)
    robot.define_angles(pi / 2, 1.0)
    assert robot.encoder == pytest.approx((-7.0, 3.0, pi / 2, 1.0))
    robot.move_relative(10.0, 0.0, 0.0)
    simulation.step(1.0)
    assert robot.encoder == pytest.approx((-7.0, 13.0, pi / 2, 1.0))
    assert robot.actual == pytest.approx((5.0 + 10.0 * cos(0.2), 5.0 + 10.0 * sin(0.2), 0.2, 0.1))


def test_place_moves_both_and_ends_a_search_for_zero(lone: Lone) -> None:
    _, robot = lone(StartPose(0.0, 0.0, 1.0, 1.0), setup=NOISY)
    robot.define_angles(0.3, 0.3)
    robot.zero()
    robot.place(40.0, -30.0, 2.0, 3.0)
    assert robot.encoder == robot.actual == pytest.approx((40.0, -30.0, 2.0, 3.0))
    assert not robot.zeroing


def test_zero_turns_to_the_bumpers_zero_and_then_reads_0(lone: Lone) -> None:
    simulation, robot = lone(StartPose(30.0, 20.0, radians(90.0), radians(-45.0)))
    robot.set_velocities(5.0, 0.0, 0.0)
    # Both axes seek zero at 45 degrees per second, over 90 and 45 degrees.
    robot.zero()
    assert robot.zeroing
    assert robot.velocities == pytest.approx((0.0, radians(-45.0), radians(45.0)))
    # After 1.5 s the steering has 22.5 of its 90 degrees left.
    simulation.step(1.5)
    assert robot.encoder[:3] == pytest.approx((30.0, 20.0, radians(22.5)))
    # The rest of the 2 s; then all encoders read zero, and the robot is where it was.
    simulation.step(0.6)
    assert (robot.zeroing, robot.encoder) == (False, (0.0, 0.0, 0.0, 0.0))
    assert robot.actual[:2] == (30.0, 20.0)
    assert [remainder(angle, tau) for angle in robot.actual[2:]] == pytest.approx([0.0, 0.0], abs=1e-9)
    # At zero already: only the position is reset.
    robot.define_position(1.0, 1.0)
    robot.zero()
    assert (robot.zeroing, robot.encoder) == (False, (0.0, 0.0, 0.0, 0.0))


@pytest.mark.long
def test_zero_finds_the_body_that_noise_has_turned(lone: Lone) -> None:
    simulation, robot = lone(setup=NOISY)
    robot.set_velocities(3.0, 0.5, 0.3)
    simulation.step(10.0)
    robot.zero()
    simulation.step(12.0)
    assert not robot.zeroing
    assert robot.actual.steering_rad == pytest.approx(robot.actual.turret_rad)
    assert abs(robot.actual.steering_rad - pi) < pi - 0.01


@pytest.mark.parametrize("command", ["stop", "limp", "set_velocities", "move_relative", "command_axis"])
def test_a_motion_command_ends_a_search_for_zero(lone: Lone, command: str) -> None:
    simulation, robot = lone(StartPose(3.0, 0.0, 1.0, 0.0))
    robot.zero()
    values = {"stop": (), "limp": (), "command_axis": (1, 1, 0.0)}.get(command, (0.0, 0.0, 0.0))
    getattr(robot, command)(*values)
    simulation.step(5.0)
    assert (robot.zeroing, robot.encoder.x_in) == (False, 3.0)


def test_settings_do_not_end_a_search_for_zero(lone: Lone) -> None:
    simulation, robot = lone(StartPose(3.0, 0.0, 1.0, 0.0))
    robot.zero()
    robot.command_axis(1, 5, 0.1)
    robot.set_timeout(0.5)
    simulation.step(1.0)
    assert robot.zeroing
    simulation.step(1.0)
    assert (robot.zeroing, robot.encoder.x_in) == (False, 0.0)


def test_the_timeout_stops_at_its_very_instant(lone: Lone) -> None:
    simulation, robot = lone()
    robot.set_timeout(1.0)
    # Half a second without commands: no motion, nothing to stop.
    simulation.step(0.5)
    robot.set_velocities(10.0, 0.1, 0.1)
    # Fed after 0.7 s, it moves for one more second.
    simulation.step(0.7)
    robot.feed()
    simulation.step(0.999)
    assert robot.velocities == (10.0, 0.1, 0.1)
    simulation.step(5.0)
    assert still(robot)
    # 0.1 rad/s during 1.7 s.
    assert robot.encoder.turret_rad == pytest.approx(0.17)
    robot.set_velocities(-10.0, 0.0, 0.0)
    simulation.step(0.5)
    assert robot.velocities[0] == -10.0
    # A timeout of 0 switches the rule off.
    robot.set_timeout(0.0)
    simulation.step(3.0)
    assert robot.velocities[0] == -10.0


@pytest.mark.long
def test_without_a_timeout_nothing_stops(lone: Lone) -> None:
    simulation, robot = lone()
    robot.set_timeout(-1.0)
    robot.set_velocities(0.0, 0.1, 0.0)
    simulation.step(1000.0)
    assert robot.moving[1]


def test_contact_stops_the_wheels_and_sets_the_bumper(lone: Lone) -> None:
    simulation, robot = lone()
    robot.set_velocities(10.0, 0.0, 0.3)
    # 9 s at 10 in/s do not reach the wall, 10 s do.
    simulation.step(9.0)
    assert robot.bumpers == 0
    simulation.step(1.0)
    # Robot and encoders stop at the same place; the turret goes on.
    assert robot.actual.x_in == pytest.approx(REACH, abs=1e-9)
    assert robot.encoder.x_in == pytest.approx(REACH, abs=1e-9)
    assert robot.moving == (False, False, True)
    assert robot.velocities[0] == 0.0
    assert robot.bumpers == 1
    assert robot.encoder.turret_rad == pytest.approx(3.0)


def test_steering_goes_on_after_a_contact_in_an_arc(lone: Lone) -> None:
    simulation, robot = lone(StartPose(60.0, 0.0))
    robot.set_velocities(20.0, 0.2, 0.0)
    simulation.step(5.0)
    assert robot.actual.steering_rad == pytest.approx(1.0)
    assert robot.actual.x_in == pytest.approx(REACH, abs=1e-9)
    assert 0.0 < robot.actual.y_in < 20.0


def test_leaving_sliding_and_pressing_on(lone: Lone) -> None:
    simulation, robot = lone(StartPose(80.0, 0.0))
    robot.set_velocities(10.0, 0.0, 0.0)
    simulation.step(3.0)
    # A motion towards the wall: the first reply shows the velocity, then it stops.
    robot.set_velocities(10.0, 0.0, 0.0)
    assert robot.velocities[0] == 10.0
    simulation.step(0.1)
    assert (robot.velocities[0], robot.bumpers) == (0.0, 1)
    # A quarter turn: it slides along the wall, with the bumper pressed.
    robot.move_relative(0.0, pi / 2, 0.0)
    simulation.step(3.0)
    robot.move_relative(30.0, 0.0, 0.0)
    simulation.step(2.0)
    assert robot.actual.y_in == pytest.approx(30.0)
    assert robot.bumpers == 1
    # 45 degrees away from the wall: it leaves.
    robot.move_relative(0.0, pi / 4, 0.0)
    simulation.step(2.0)
    robot.move_relative(10.0, 0.0, 0.0)
    simulation.step(1.0)
    # 10 in at 45 degrees are 7.07 in off the wall.
    assert robot.actual.x_in == pytest.approx(REACH - 10.0 / 2**0.5)
    assert robot.bumpers == 0
    # Backwards, it meets the wall after 10 in of the 20.
    robot.move_relative(-20.0, 0.0, 0.0)
    simulation.step(2.0)
    assert robot.actual.x_in == pytest.approx(REACH)
    assert robot.bumpers == 1


def test_a_disc_blocks_like_a_wall_without_echoes(lone: Lone) -> None:
    simulation, robot = lone()
    robot.set_obstacles([(60.0, 0.0, 9.72)])
    robot.set_velocities(20.0, 0.0, 0.0)
    simulation.step(5.0)
    assert robot.actual.x_in == pytest.approx(60.0 - 2.0 * 9.72)
    assert robot.bumpers == 1
    assert robot.sonar.readings_in[0] == round(100.0 - robot.actual.x_in - 9.06)


def test_a_robot_set_into_a_wall_can_only_leave_it(lone: Lone) -> None:
    simulation, robot = lone()
    # Placed 5 in from the wall, with a radius of 9.72 in.
    robot.place(95.0, 0.0, 0.0, 0.0)
    assert robot.bumpers != 0
    # Pressing on does not move it, leaving does.
    robot.set_velocities(5.0, 0.0, 0.0)
    simulation.step(1.0)
    assert robot.actual.x_in == 95.0
    robot.set_velocities(-5.0, 0.0, 0.0)
    simulation.step(1.0)
    assert robot.actual.x_in == pytest.approx(90.0)
    assert robot.bumpers == 0


@pytest.mark.long
def test_noise_never_stops_the_wheels_of_a_leaving_robot(lone: Lone) -> None:
    simulation, robot = lone(setup=NOISY)
    held = 0
    # Sixty trials at the wall: noise may push towards it, and the wheels must turn all the same.
    for _ in range(60):
        robot.place(REACH, 0.0, 0.0, 0.0)
        robot.set_velocities(-0.4, 0.0, 0.0)
        before = robot.encoder.x_in
        simulation.step(0.01)
        assert robot.moving[0]
        assert robot.encoder.x_in < before
        assert robot.actual.x_in <= REACH
        # The bumper is pressed in some trials only.
        held += robot.bumpers
    assert 5 < held < 55
    # 40 s at 0.4 in/s: it leaves for good.
    simulation.step(40.0)
    assert robot.actual.x_in < REACH - 5.0


def test_noisy_wheels_stop_at_walls_as_well(lone: Lone) -> None:
    simulation, robot = lone(setup=NOISY, seed=4)
    robot.set_velocities(15.0, 0.0, 0.0)
    simulation.step(10.0)
    assert robot.moving == (False, False, False)
    assert robot.bumpers != 0
    assert robot.actual.x_in == pytest.approx(REACH, abs=1e-3)
    assert robot.encoder.x_in != pytest.approx(REACH, abs=1e-3)


def test_sonars_fire_in_their_order_and_stamp_the_encoder_pose(lone: Lone) -> None:
    simulation, robot = lone()
    # Encoders are offset, to tell them from the actual pose.
    robot.define_position(1000.0, 0.0)
    simulation.step(0.1)
    # Two sonars in turn, 20 ms apart: sonar 4 fires at 0.18 s last, sonar 12 at 0.16 s.
    robot.configure_sonars(5, (4, 12, 255))
    robot.set_velocities(10.0, 0.0, 0.5)
    simulation.step(0.095)
    fired = {number: stamp for number, stamp in enumerate(robot.sonar.stamps) if stamp.sensor_time_s >= 0.1}
    assert {number: stamp.sensor_time_s for number, stamp in fired.items()} == {4: 0.18, 12: 0.16}
    # 0.08 s after the command: 0.8 in and 0.04 rad.
    assert fired[4].pose == pytest.approx((1000.8, 0.0, 0.0, 0.04))
    assert fired[4].velocities == (10.0, 0.0, 0.5)
    assert fired[4].pose_time_s == 0.18
    # Robot time is not that of the last firing.
    assert robot.time_s == pytest.approx(0.195)


def test_sonars_measure_from_the_actual_pose(lone: Lone) -> None:
    simulation, robot = lone()
    # Encoders at another place and angle must not matter for the readings.
    robot.define_position(50.0, 50.0)
    robot.define_angles(1.0, 1.0)
    robot.set_velocities(20.0, 0.0, 0.0)
    simulation.step(2.001)
    # Each reading is rounded at the place where the sonar fired.
    read = dict(zip(DEFAULT_ORDER, [robot.sonar.readings_in[number] for number in DEFAULT_ORDER], strict=True))
    front_stamp = robot.sonar.stamps[0]
    assert read[0] == round(100.0 - 20.0 * front_stamp.sensor_time_s - 9.06)
    assert read[8] == round(100.0 + 20.0 * robot.sonar.stamps[8].sensor_time_s - 9.06)


@pytest.mark.long
def test_the_random_walk_of_a_run_has_the_spread_of_its_formula(lone: Lone) -> None:
    """20 in ahead: x spreads by a_t sqrt(20), y by the integral of the heading's walk, the heading by a_d sqrt(20)."""
    strays = []
    # 300 runs: the relative standard deviation of a variance is sqrt(2 / 300).
    for seed in range(300):
        simulation, robot = lone(StartPose(-50.0, 0.0), setup=NOISY, seed=seed)
        # Sonars are off: firing would divide the motion, and its noise, into pieces.
        robot.configure_sonars(15, (255,))
        robot.move_relative(20.0, 0.0, 0.0)
        for _ in range(20):
            simulation.step(0.1)
        actual, encoder = robot.actual, robot.encoder
        assert encoder == pytest.approx((-30.0, 0.0, 0.0, 0.0))
        turned = (actual.steering_rad + pi) % tau - pi
        strays.append((actual.x_in - encoder.x_in, actual.y_in - encoder.y_in, turned))
    # Variances of the formula with the noise of the setup: 0.1 in per sqrt(in), 0.005 rad per sqrt(in).
    expected = np.array([0.1**2 * 20.0, 0.005**2 * 20.0**3 / 3.0, 0.005**2 * 20.0])
    # Four standard deviations.
    np.testing.assert_allclose(np.var(strays, axis=0) / expected, 1.0, atol=4.0 * np.sqrt(2.0 / 300.0))
