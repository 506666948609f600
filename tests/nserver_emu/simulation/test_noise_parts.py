"""Parts of a setup by name, and a robot that errs otherwise from one moment on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nserver_emu.simulation.models import N150, N200
from nserver_emu.simulation.noise import (
    IDEAL,
    MEASURED,
    NOISY,
    PARTS,
    SETUPS,
    WORN,
    RobotSetup,
    apply_model,
    part_choices,
    part_name,
    with_part,
)
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarNoise
from worlds.io import load_world
from worlds.robots import Calibration
from worlds.world import StartPose


def test_every_field_that_is_noise_is_in_one_part() -> None:
    fields = [field for part in PARTS.values() for field in part]
    assert sorted(fields) == sorted({*RobotSetup.__dataclass_fields__} - {"name", "ramps", "clock_step_s"})


def test_parts_are_named_after_the_first_setup_that_has_them() -> None:
    assert list(part_choices("sensors", N150, IDEAL)) == ["ideal", "noisy", "measured", "building"]
    assert list(part_choices("motion", N150, IDEAL)) == ["ideal", "noisy", "worn"]
    assert part_name("motion", MEASURED, N150, IDEAL) == "noisy"
    assert part_name("sensors", WORN, N150, IDEAL) == "noisy"
    for part in PARTS:
        for setup in SETUPS.values():
            assert part_name(part, with_part(IDEAL, part, setup), N150, IDEAL) == part_name(part, setup, N150, IDEAL)


def test_the_initial_setup_can_be_chosen_again() -> None:
    twin = replace(NOISY, name="room 12", sonar=SonarNoise(range_std_relative=0.3))
    assert list(part_choices("sensors", N150, twin)) == ["ideal", "noisy", "measured", "building", "room 12"]
    assert list(part_choices("motion", N150, twin)) == ["ideal", "noisy", "worn"]
    assert part_name("sensors", twin, N150, twin) == "room 12"
    assert part_name("sensors", twin, N150, IDEAL) == "room 12"
    called_so = replace(twin, name="noisy")
    assert part_choices("sensors", N150, called_so)["noisy"] is NOISY
    assert part_choices("sensors", N150, called_so)["noisy as begun"] is called_so


def a_simulation(setup: RobotSetup) -> Simulation:
    simulation = Simulation(load_world("thesis_room"), seed=3)
    simulation.add_robot(1, StartPose(40.0, 40.0, 0.3), N200, setup)
    return simulation


def test_ramps_and_clock_stay_and_noise_changes() -> None:
    robot = a_simulation(IDEAL).robots[1]
    robot.set_noise_model(MEASURED)
    assert robot.setup == replace(MEASURED, ramps=False, clock_step_s=0.0)
    assert robot.initial_setup is IDEAL
    robot.set_noise_model(IDEAL)
    assert robot.setup == IDEAL


@pytest.mark.parametrize("after", [NOISY, MEASURED])
def test_a_switch_changes_only_later_readings(after: RobotSetup) -> None:
    before = a_simulation(IDEAL)
    robot = before.robots[1]
    before.step(2.0)
    ideal, infrared = robot.sonar.readings_in, robot.infrared and robot.infrared.readings
    robot.set_noise_model(after)
    # Readings taken before stay as they are.
    assert robot.sonar.readings_in == ideal
    assert robot.infrared
    assert robot.infrared.readings == infrared
    measured = set()
    for _ in range(5):
        before.step(1.0)
        measured.add(robot.sonar.readings_in)
    # Each second another reading: noise is on.
    assert len(measured) == 5
    # Back to ideal: the first readings again.
    robot.set_noise_model(IDEAL)
    before.step(1.0)
    assert robot.sonar.readings_in == ideal
    assert robot.infrared.readings == infrared


def test_motion_noise_applies_while_switched_on() -> None:
    simulation = Simulation(load_world("thesis_room"), seed=3)
    robot = simulation.add_robot(1, StartPose(20.0, 20.0, 0.3), N150, IDEAL)

    def off_in() -> float:
        # 20 in ahead and half a radian of turn.
        robot.move_relative(20.0, 0.5, 0.0)
        simulation.step(20.0)
        assert not any(robot.moving)
        return abs(robot.actual.x_in - robot.encoder.x_in) + abs(robot.actual.y_in - robot.encoder.y_in)

    # Without noise encoders and truth agree exactly.
    assert off_in() == 0.0
    robot.set_noise_model(NOISY)
    strayed = off_in()
    assert strayed > 0.01
    robot.set_noise_model(IDEAL)
    turned_rad = robot.actual.steering_rad - robot.encoder.steering_rad
    off_in()
    # The heading error of the noisy motion stays, none is added.
    assert robot.actual.steering_rad - robot.encoder.steering_rad == pytest.approx(turned_rad, abs=1e-12)


def test_switching_a_sonar_dead_and_back() -> None:
    simulation = a_simulation(IDEAL)
    robot = simulation.robots[1]
    simulation.step(1.0)
    alive = robot.sonar.readings_in
    robot.set_noise_model(replace(IDEAL, sonar=SonarNoise(dead=(3,))))
    # A dead sonar reads 0 at once.
    assert robot.sonar.readings_in == (*alive[:3], 0, *alive[4:])
    robot.set_noise_model(IDEAL)
    simulation.step(1.0)
    assert robot.sonar.readings_in == alive


def test_calibrations_stay_when_parts_are_switched() -> None:
    offsets_in = tuple(0.1 * number for number in range(16))
    calibration = Calibration(distance_scale=1.02, turn_scale=0.97, offsets_in=offsets_in)
    twin = replace(N150, calibration=calibration)
    # Each choice of noise has the offsets of this robot.
    choices = part_choices("sensors", twin, apply_model(twin, IDEAL))
    assert {setup.sonar.offsets_in for setup in choices.values()} == {calibration.offsets_in}
    odometries = [
        setup.odometry.scales[:2] for setup in part_choices("motion", twin, apply_model(twin, IDEAL)).values()
    ]
    assert set(odometries) == {(1.02, 0.97)}
    assert part_name("sensors", apply_model(twin, NOISY), twin, apply_model(twin, IDEAL)) == "noisy"
