"""Rings of model files in the simulator: directions, mounts, groups, limits, and what State shows of them."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, radians, sin, tau
from pathlib import Path

import numpy as np
import pytest

from nclient import connect
from nclient.errors import AddressError, WorldFileError
from nserver_emu.server.server_state import sonar_words
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.models import load_models
from nserver_emu.simulation.noise import IDEAL, MEASURED, RngFactory, apply_model
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import Pose, Stamp, to_ps
from nserver_emu.simulation.sonar import SonarModel, SonarNoise, SonarRing
from nserver_emu.simulation.visibility import SensorPose
from worlds.raycast import cast_ray
from worlds.rings import Ring
from worlds.robots import N150
from worlds.world import StartPose

MODELS = Path(__file__).parents[2] / "worlds" / "models"
ROOM = np.array([[-90.0, -60.0, 90.0, -60.0], [90.0, -60.0, 90.0, 60.0], [90.0, 60.0, -90.0, 60.0],
                 [-90.0, 60.0, -90.0, -60.0]])  # fmt: skip
STAMP = Stamp(Pose(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)


def sonars_of(ring: Ring, model: SonarModel, seed: int = 0) -> SonarRing:
    return SonarRing(replace(N150, ring=ring), model, ROOM, np.random.default_rng(seed))


def robot_of(name: str) -> SimulatedRobot:
    model = load_models(MODELS / f"{name}.toml")[name]
    return SimulatedRobot(RngFactory(1, 0), StartPose(10.0, -5.0, 0.3, 0.3), ROOM, model, IDEAL)


@pytest.mark.parametrize("name", ["corridor8", "ring24"])
def test_readings_are_ranges_along_the_rays_of_the_ring(name: str) -> None:
    robot = robot_of(name)
    ring, readings = robot.model.body.ring, robot.sonar.readings_in
    assert len(readings) == ring.count
    for angle, reading in zip(ring.angles_rad, readings, strict=True):
        far, _ = cast_ray(10.0, -5.0, cos(0.3 + angle), sin(0.3 + angle), ROOM)
        assert reading == pytest.approx(far - ring.radius_in, abs=0.5 * ring.resolution_in + 1e-9)
        assert reading / ring.resolution_in == pytest.approx(round(reading / ring.resolution_in))


def test_mounted_sonars_measure_from_where_they_stand() -> None:
    # Sonar 0 stands 4 in left of the axis and looks ahead, sonar 1 at the rear and looks to the right.
    ring = replace(N150.ring, angles_rad=(0.0, -tau / 4), firing=((0, 1),), radius_in=1.0,
                   shifts_in=((7.0, 4.0), (2.0, 5.0)), resolution_in=0.001)  # fmt: skip
    sonars = sonars_of(ring, SonarNoise())
    sonars.emit_all(SensorPose(0.0, 0.0, 0.0), STAMP)
    assert ring.mount_in(0) == pytest.approx((8.0, 4.0))
    assert ring.mount_in(1) == pytest.approx((5.0, -3.0))
    assert sonars.readings_in == pytest.approx((90.0 - 8.0, 60.0 - 3.0), abs=1e-3)
    # Turned by a quarter, the robot has its left where its front was.
    sonars.emit_all(SensorPose(0.0, 0.0, tau / 4), STAMP)
    assert sonars.readings_in == pytest.approx((60.0 - 8.0, 90.0 - 3.0), abs=1e-3)


def test_groups_fire_at_once() -> None:
    ring = load_models(MODELS / "corridor8.toml")["corridor8"].body.ring
    sonars, fired = sonars_of(ring, SonarNoise()), []
    sonars.restart(to_ps(1.0))
    for _ in range(6):
        due_ps = sonars.due_ps
        sonars.emit_due(SensorPose(0.0, 0.0, 0.0), STAMP)
        pings = [(sonar, ping) for sonar, ping in enumerate(sonars.pings) if ping and ping.instant_ps == due_ps]
        fired.append((due_ps, tuple(sonar for sonar, _ in pings)))
    groups = [(0, 7), (2, 5), (1, 6), (3,), (4,), (0, 7)]
    assert fired == [(to_ps(1.0 + 0.06 * number), group) for number, group in enumerate(groups)]


def test_sonars_of_a_group_disturb_one_another() -> None:
    # Two sonars side by side before one wall: alone each measures it, at once each may receive the other's ping.
    wall = np.array([[60.0, -500.0, 60.0, 500.0]])
    ring = replace(N150.ring, angles_rad=(radians(2.0), radians(-2.0)), firing=((0, 1),), resolution_in=1e-3)
    loud = Polaroid(range_std_relative=0.0, range_std_floor_in=0.0, margin_std_db=0.0)
    readings = []
    for firing in (((0,), (1,)), ((0, 1),)):
        sonars = SonarRing(replace(N150, ring=replace(ring, firing=firing)), loud, wall, np.random.default_rng(0))
        sonars.restart(0)
        for _ in firing:
            sonars.emit_due(SensorPose(0.0, 0.0, 0.0), STAMP)
        readings.append(sonars.readings_in)
    # Both pings of the group are still audible.
    assert len(sonars.to_state().earlier) == 2
    # The mixed path is half the sum of both perpendiculars and a little longer, never shorter than the own one.
    assert readings[0] == pytest.approx(readings[1], abs=0.01)


@pytest.mark.parametrize(("gap_in", "reading_in"), [(1.0, 3.9), (3.9, 3.9), (5.0, 5.0), (196.0, 196.0), (197.0, 201.0)])
def test_limits_are_those_of_the_ring(gap_in: float, reading_in: float) -> None:
    ring = replace(N150.ring, min_range_in=3.9, max_range_in=196.85, no_echo_in=201.0, resolution_in=0.1)
    wall = np.array([[9.06 + gap_in, -1.0, 9.06 + gap_in, 1.0]])
    sonars = SonarRing(replace(N150, ring=ring), SonarNoise(), wall, np.random.default_rng(0))
    sonars.emit_all(SensorPose(0.0, 0.0, 0.0), STAMP)
    assert sonars.readings_in == pytest.approx((reading_in, *[201.0] * 15))
    assert ring.reading(inf) == 201.0


def test_the_cone_of_a_model_replaces_that_of_the_setup() -> None:
    model = load_models(MODELS / "corridor8.toml")["corridor8"]
    sonar = apply_model(model, MEASURED).sonar
    assert isinstance(sonar, Polaroid)
    assert sonar.cone_rad == pytest.approx(radians(30.0))
    assert apply_model(model, IDEAL) is IDEAL


def test_state_has_sixteen_sonars_in_whole_inches() -> None:
    for name in ("corridor8", "ring24"):
        robot = robot_of(name)
        words, readings = sonar_words(robot), robot.sonar.readings_in
        silent = robot.model.body.ring.no_echo_in
        expected = [255 if reading == silent else max(6, round(reading)) for reading in readings[:16]]
        assert words == (*expected, *[255] * (16 - len(expected)))


def test_a_client_reads_a_small_ring() -> None:
    with connect(f"sim:thesis_room?robot=corridor8&model_file={MODELS / 'corridor8.toml'}&start=40,45,0,0") as robot:
        state = robot.refresh()
        assert state.sonars_in[8:] == (255,) * 8
        # The wall at the right is 57 in from the axis.
        assert state.sonars_in[0] == round(57.0 - 23.0 / 2.54)


@pytest.mark.parametrize(
    "text", ["", "[[model", "model = 3", '[[model]]\nname = "n150"\n', '[[model]]\nlike = "n200"\n']
)
def test_an_unknown_robot_of_a_model_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises((WorldFileError, AddressError), match=r"mine\.toml|no robot model 'mine'"):
        connect(f"sim:thesis_room?robot=mine&model_file={path}")
