"""A robot's own errors in the simulation: what its wheels and its ring do then, against the words of the file."""

from __future__ import annotations

from dataclasses import replace
from math import radians, tau

import numpy as np
import pytest

from nserver_emu.simulation.models import MODELS, N150, RobotModel, parse_models
from nserver_emu.simulation.noise import IDEAL, MEASURED, WORN, RngFactory, apply_model
from nserver_emu.simulation.robot import SimulatedRobot
from worlds.io import load_world
from worlds.robots import Calibration
from worlds.world import StartPose

WALLS = load_world("thesis_room").walls
ERRS = Calibration(1.04, 0.97, 0.002, tuple(0.5 * (number % 4) for number in range(16)), radians(5.0))
START = StartPose(40.0, 40.0)


def robot_of(model: RobotModel) -> SimulatedRobot:
    return SimulatedRobot(RngFactory(1, 0), START, WALLS, model)


@pytest.mark.parametrize("name", MODELS)
def test_calibrated_distances_and_turns_on_every_drive(name: str) -> None:
    """Ten inches and half a turn counted, whatever the axes are."""
    robot = robot_of(replace(MODELS[name], calibration=ERRS))
    # Half a turn by the encoders; a Scout turns by opposite wheels.
    track = MODELS[name].track_in
    turn = 0.5 * tau
    if track is None:
        robot.move_relative(0.0, turn, turn)
    else:
        robot.move_relative(track * turn / 2.0, -track * turn / 2.0, 0.0)
    # 30 s, which is enough for the slowest turn.
    robot.advance_to(30 * 10**12)
    assert robot.encoder.steering_rad == pytest.approx(turn)
    # The turn scale of the calibration is 0.97.
    assert robot.actual.steering_rad == pytest.approx(0.97 * turn)
    before = robot.actual
    robot.move_relative(10.0, 0.0 if track is None else 10.0, 0.0)
    robot.advance_to(60 * 10**12)
    after = robot.actual
    # The drift of 0.002 rad/in bends a straight drive of 10 in.
    bend = after.steering_rad - before.steering_rad
    assert bend == pytest.approx(0.002 * 10.0)
    # Chord of an arc: 2 R sin(bend / 2), with the distance scale of 1.04.
    chord = np.hypot(after.x_in - before.x_in, after.y_in - before.y_in)
    assert chord == pytest.approx(10.4 * np.sin(bend / 2.0) / (bend / 2.0), rel=1e-6)


def test_calibrated_offsets_and_ring_angle() -> None:
    offsets = ERRS.offsets_in
    plain = robot_of(N150)
    # Only offsets, with the ring not turned.
    shifted = robot_of(replace(N150, calibration=replace(ERRS, turned_rad=0.0)))
    unshifted = plain.sonar.readings_in
    for sonar, (read, more) in enumerate(zip(shifted.sonar.readings_in, offsets, strict=True)):
        # Readings are whole inches.
        assert read - unshifted[sonar] == pytest.approx(more, abs=0.5)
    # A ring turned by 5 degrees measures like a turret turned by 5 degrees.
    turned = robot_of(replace(N150, calibration=Calibration(turned_rad=radians(5.0))))
    aimed = SimulatedRobot(RngFactory(1, 0), StartPose(40.0, 40.0, 0.0, radians(5.0)), WALLS, N150)
    assert turned.sonar.readings_in == aimed.sonar.readings_in
    assert turned.sonar.readings_in != plain.sonar.readings_in


def test_a_polaroid_ring_has_the_same_calibration() -> None:
    plain = SimulatedRobot(RngFactory(1, 0), START, WALLS, N150, MEASURED)
    calibration = Calibration(offsets_in=(3.0,) * 16)
    shifted = SimulatedRobot(RngFactory(1, 0), START, WALLS, replace(N150, calibration=calibration), MEASURED)
    pairs = list(zip(plain.sonar.readings_in, shifted.sonar.readings_in, strict=True))
    measured = [(one, other) for one, other in pairs if one < 250]
    assert len(measured) > 4
    assert all(other == one + 3 for one, other in measured)
    assert [other for one, other in pairs if one == 255] == [255] * sum(one == 255 for one, _ in pairs)


def test_without_calibration_the_setup_applies() -> None:
    assert apply_model(N150, WORN) is WORN
    setup = apply_model(replace(N150, calibration=ERRS), WORN)
    assert setup.odometry.slip_in == WORN.odometry.slip_in
    assert setup.odometry.scales == (1.04, 0.97, 1.0)
    assert setup.sonar.range_std_relative == WORN.sonar.range_std_relative


def test_model_files_contain_calibrations() -> None:
    text = '[[model]]\nname = "n150"\n[model.odometry]\nway_scale = 1.04\n[[model]]\nname = "twin"\nlike = "n150"\n'
    models = parse_models(text, "mine.toml")
    assert models["n150"].calibration == models["twin"].calibration == Calibration(distance_scale=1.04)
    assert models["n200"].calibration is None
    assert apply_model(models["n150"], IDEAL).odometry.scales[0] == 1.04
