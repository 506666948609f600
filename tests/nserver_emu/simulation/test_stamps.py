"""Sonars that fire inside a piece of motion, against the same robot moved from firing to firing."""

from __future__ import annotations

from dataclasses import replace
from math import remainder, tau

import pytest

from nclient.protocol.types import DEFAULT_SONAR_ORDER as DEFAULT_ORDER
from nserver_emu.control.snapshot import dumps, loads
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.axis import Axis
from nserver_emu.simulation.models import N150, N200, SCOUT, RobotModel
from nserver_emu.simulation.noise import IDEAL, NOISY, RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import Pose
from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose, World

CUT_S = 0.004
"""The unit of the ring's rate: every firing is at the end of a step."""


def driven_robot(room: World, model: RobotModel, setup: RobotSetup) -> SimulatedRobot:
    """A robot that the encoders believe elsewhere, its ring fast, soon at a wall."""
    robot = Simulation(room, seed=4).add_robot(1, StartPose(84.0, 20.0, 0.3, 1.0), model, setup)
    robot.define_position(-7.0, 3.0)
    robot.define_angles(1.1, 2.2)
    robot.configure_sonars(5, DEFAULT_ORDER)
    return robot


def both(whole: SimulatedRobot, cut: SimulatedRobot, begin: int, steps: int) -> None:
    """Let so many steps pass in both, in one of them at once."""
    for step in range(begin, begin + steps):
        cut.advance_to((step + 1) * 4_000_000_000)
    whole.advance_to((begin + steps) * 4_000_000_000)


def apart(pose: Pose, other: Pose) -> float:
    """Return the greatest difference of two poses, angles wrapped to (-pi, pi]."""
    angles = (pose.steering_rad - other.steering_rad, pose.turret_rad - other.turret_rad)
    return max(abs(pose.x_in - other.x_in), abs(pose.y_in - other.y_in), *(abs(remainder(by, tau)) for by in angles))


@pytest.mark.long
@pytest.mark.parametrize("model", [N150, N200, SCOUT], ids=lambda model: model.name)
@pytest.mark.parametrize("ramps", [False, True])
def test_firing_inside_a_segment_equals_firing_between_segments(room: World, model: RobotModel, ramps: bool) -> None:
    setup = replace(IDEAL, ramps=ramps)
    whole, cut = driven_robot(room, model, setup), driven_robot(room, model, setup)
    # Fast, slow, turning and standing, with and without a timeout, zeroing and relative moves.
    stopped, step, commands = 0, 0, [(15.0, 0.4, -0.5), (-12.0, 0.0, 0.3), (18.0, 16.0, 0.0), (0.0, 0.0, 0.2)]
    for number, speeds in enumerate(commands * 2):
        for robot in (whole, cut):
            robot.set_timeout(0.9 if number % 2 else 0.0)
            if number == 4:
                robot.zero()
            elif number == 6:
                robot.move_relative(6.0, 3.0, 0.4)
            else:
                robot.set_velocities(*speeds)
        # 301 steps of one robot in a go, of the other cut at each firing.
        both(whole, cut, step, 301)
        step += 301
        stopped += whole.bumpers != 0
        assert whole.sonar.readings_in == cut.sonar.readings_in
        assert (whole.moving, whole.bumpers, whole.zeroing) == (cut.moving, cut.bumpers, cut.zeroing)
        # Rounding differs, because one adds more pieces.
        assert apart(whole.actual, cut.actual) < 1e-9
        for ours, theirs in zip(whole.sonar.stamps, cut.sonar.stamps, strict=True):
            assert apart(ours.pose, theirs.pose) < 1e-9
            assert ours.velocities == pytest.approx(theirs.velocities, abs=1e-9)
            assert ours[2:] == theirs[2:]
    # A contact must have occurred.
    assert stopped


def test_stamps_do_not_depend_on_when_they_are_read(room: World) -> None:
    asked, left = driven_robot(room, N150, IDEAL), driven_robot(room, N150, IDEAL)
    for robot in (asked, left):
        robot.set_velocities(10.0, 0.5, -0.5)
        # 0.3 s: five firings.
        robot.advance_to(300_000_000_000)
    at_once = asked.sonar.stamps
    # What happens later must not change a stamp.
    for robot in (asked, left):
        robot.stop()
        robot.place(0.0, 0.0, 0.0, 0.0)
        robot.define_angles(1.0, 2.0)
    assert asked.sonar.stamps == left.sonar.stamps == at_once


def test_noisy_motion_is_divided_at_firings(room: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise is drawn once for each piece, so the pieces must not change."""
    pieces: list[float] = []
    moved = Axis.advance

    def advance(axis: Axis, dt_s: float) -> float:
        pieces.append(dt_s)
        return moved(axis, dt_s)

    monkeypatch.setattr(Axis, "advance", advance)
    # Noise divides at firings (20 ms); without noise the segment stays whole.
    for setup, expected_s in ((NOISY, [0.02, 0.02, 0.02]), (IDEAL, [0.06])):
        robot = driven_robot(room, N150, replace(setup, ramps=False))
        robot.set_velocities(10.0, 0.5, 0.0)
        pieces.clear()
        robot.advance_to(60_000_000_000)
        # Three axes advance for each piece.
        assert pieces[::3] == pytest.approx(expected_s)


def test_a_snapshot_between_firings_continues_bit_for_bit(room: World) -> None:
    def emulator() -> Emulator:
        simulation = Simulation(room, seed=4)
        simulation.add_robot(1, StartPose(70.0, 20.0, 0.3, 1.0))
        return Emulator(simulation)

    original, again = emulator(), emulator()
    robot = original.simulation.robots[1]
    robot.set_velocities(10.0, 0.5, -0.5)
    # Between two firings: 0.17 s is not a multiple of 60 ms.
    original.simulation.step(0.17)
    text = dumps(original)
    loads(again, text)
    # Saving what was restored gives the same text.
    assert dumps(again) == text
    for one in (original, again):
        one.simulation.step(0.3)
    back = again.simulation.robots[1]
    assert (back.sonar.stamps, back.sonar.readings_in) == (robot.sonar.stamps, robot.sonar.readings_in)
    assert (back.actual, back.encoder) == (robot.actual, robot.encoder)
