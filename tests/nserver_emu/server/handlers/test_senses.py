"""Infrareds, compass, laser, battery and clock in wire units: an N200 that has them, an N150 that lacks some."""

from __future__ import annotations

import math

import pytest

from nclient.protocol.types import CPU_RANGE_V, EVERYTHING, MOTOR_RANGE_V, NO_STAMP, Mask, Position, volts
from nserver_emu.control.snapshot import dumps, loads
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import clock_ms, volts_raw
from nserver_emu.simulation.models import N150, N200, SCOUT
from nserver_emu.simulation.noise import IDEAL, MEASURED, RobotSetup
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation
from worlds.io import load_world
from worlds.world import StartPose


def n200(start: StartPose | None = None, setup: RobotSetup = IDEAL) -> Emulator:
    made = Simulation(load_world("thesis_room"), seed=3)
    made.add_robot(1, start or StartPose(0.0, 0.0, 0.0, 0.0), N200, setup)
    return Emulator(made)


@pytest.fixture
def emulator() -> Emulator:
    """An N200 12 in from the walls behind it and to its right, 102.17 in from those before it."""
    return n200()


@pytest.fixture
def client(emulator: Emulator) -> WireClient:
    return meet(emulator)[0]


def test_an_n150_has_a_compass_and_neither_infrareds_nor_laser() -> None:
    client, _ = meet(Emulator(simulation(start=StartPose(0.0, 0.0, 0.0, math.radians(33.0)))))
    # Error 4 for each command of a sensor that the N150 lacks; in State its infrareds show 15, nothing.
    for name, args in (("get_ir", ()), ("get_ls", ()), ("get_sg", ()), ("conf_ls", (51, 0, 0, 0, 0)),
                       ("conf_sg", (10, 5, 60)), ("conf_ir", (0, *range(16)))):  # fmt: skip
        assert client.ask(name, *args).values == (4,)
    assert client.ask("get_cp").slots == {43: 330}
    reply = client.ask("gs")
    assert [reply.slots[slot] for slot in (*range(1, 17), 42, 43)] == [15] * 16 + [0, 330]
    assert reply.laser == (0,)


def test_a_scout_has_no_compass() -> None:
    made = Simulation(load_world("thesis_room"))
    made.add_robot(1, StartPose(0.0, 0.0, 0.0, 1.0), SCOUT, MEASURED)
    client, _ = meet(Emulator(made))
    for name, args in (("get_cp", ()), ("conf_cp", (1,)), ("conf_cp", (7,))):
        assert client.ask(name, *args).values == (4,)
    client.ask("ct", *EVERYTHING.with_position(Position.COMPASS | Position.BUMPER).smask)
    made.step(1.0)
    reply = client.ask("gs")
    assert reply.slots[43] == 0
    assert reply.stamps["compass"] == NO_STAMP
    # The measured clock has steps of 16.4 ms: 60 of them are 984 ms.
    assert reply.stamps["bumper"].pose_time == 984


# Infrareds


def test_infrareds_show_how_near_a_wall_is_in_state_and_answer(emulator: Emulator, client: WireClient) -> None:
    slots = client.ask("gs").slots
    assert [slots[slot] for slot in range(1, 17)] == [*[15] * 6, 8, 4, 3, 4, 8, 4, 3, 4, 8, 15]
    assert client.ask("get_ir").slots == {slot: slots[slot] for slot in range(1, 17)}
    emulator.simulation.robots[1].place(10.0, 10.0, 0.0, 0.0)
    emulator.simulation.step(0.06)
    # 0.06 s: one infrared reading at the new place.
    assert client.ask("get_ir").slots[9] == 13


def test_conf_ir_sets_history_and_sensors(emulator: Emulator, client: WireClient) -> None:
    # 12 is above the maximum history of 9 tenths: a reading counts a tenth, 0.9 x 3 + 0.1 x 15 = 4.2.
    client.ask("conf_ir", 12, *range(16))
    emulator.simulation.robots[1].place(50.0, 50.0, 0.0, 0.0)
    emulator.simulation.step(0.06)
    assert client.ask("get_ir").slots[9] == 4
    # After a second of readings the old value has little weight left.
    emulator.simulation.step(1.0)
    assert client.ask("get_ir").slots[9] == 13
    before = client.ask("get_ir").slots[13]
    # Only infrared 8 measures (255 ends the order); the others keep their last reading.
    assert client.ask("conf_ir", 0, 8, 255, *[99] * 14).slots[9] == 15
    assert client.ask("get_ir").slots[13] == before
    for args in ((-1, *range(16)), (0, 16, *range(15))):
        assert client.ask("conf_ir", *args).values == (2,)


# Compass


def test_conf_cp_switches_the_compass_and_a_turn_calibrates_it() -> None:
    emulator = n200(setup=MEASURED)
    client, _ = meet(emulator)
    robot = emulator.simulation.robots[1]

    def off_deg() -> float:
        shown = math.radians(client.ask("get_cp").slots[43] / 10)
        return abs(math.degrees(math.remainder(shown - robot.actual.turret_rad, math.tau)))

    emulator.simulation.step(0.1)
    # The measured compass is off by some degrees until it is calibrated.
    assert 2.0 < off_deg() < 6.5
    assert client.ask("conf_cp", 2).kind == "state"
    # 400 deg: calibration needs a full turn of the turret.
    client.ask("pr", 0, 0, 4000)
    emulator.simulation.step(20.0)
    assert off_deg() < 2.5
    # Mode 0: off. The turret turns, and the reading stays.
    client.ask("conf_cp", 0)
    before = client.ask("get_cp").slots
    client.ask("pr", 0, 0, 900)
    emulator.simulation.step(20.0)
    assert client.ask("get_cp").slots == before
    assert client.ask("conf_cp", 3).values == (2,)


# Laser

BEFORE_A_WALL = StartPose(40.0, 45.0, 0.0, 0.0)
"""62.17 in before a wall that fills all columns."""


def test_the_laser_gives_points_lines_and_pixels_by_its_mode() -> None:
    client, _ = meet(n200(BEFORE_A_WALL))
    points = client.ask("gs").laser
    assert points is not None
    assert points[0] == 482
    assert client.ask("get_ls").laser == points
    # Each point has x = 62.17 in, rounded to tenths; only y differs.
    assert set(points[1::2]) == {622}
    line = client.ask("get_sg").laser
    assert line is not None
    assert line[0] == 1
    # x1 y1 x2 y2 of the one line: across the whole field of view.
    assert line[1:] == pytest.approx((622, -307, 622, 307), abs=1)
    assert client.ask("gs").laser == line
    assert client.ask("conf_ls", 33, 0, 0, 0, 0).laser == line
    assert client.ask("get_ls").laser == points
    # Mode 3: rows of the camera, one word per column.
    pixels = client.ask("conf_ls", 3, 0, 0, 0, 0).laser
    assert pixels is not None
    assert (pixels[0], len(pixels), min(pixels[1:]) > 0) == (482, 483, True)


def test_other_robots_are_in_laser_and_infrareds_of_state() -> None:
    emulator = n200(BEFORE_A_WALL)
    client, _ = meet(emulator)
    emulator.simulation.add_robot(2, StartPose(65.0, 45.0), N150)
    points = client.ask("get_ls").laser
    assert points is not None
    xy = [(points[at] / 10, points[at + 1] / 10) for at in range(1, len(points), 2)]
    arc = [point for point in xy if point[0] < 62.0]
    # All points are on the circle of the N150, whose radius is 9.72 in.
    assert all(math.hypot(x - 25.0, y) == pytest.approx(9.72, abs=0.08) for x, y in arc)
    # All columns: from 16 in before its centre the disc spans asin(9.72 / 16) = 37 degrees to each side, the laser 26.
    assert len(xy) == len(arc) == 482
    emulator.simulation.robots[2].place(62.0, 67.0, 0.0, 0.0)
    emulator.simulation.step(0.1)
    # Infrared 2 (slot 3) at 45 deg: distance of the centres minus radius 9.72 and ring 9.0.
    assert client.ask("gs").slots[3] == round(math.hypot(22.0, 22.0) - 18.72) == 12


def test_each_connection_has_its_own_laser_mode(emulator: Emulator, client: WireClient) -> None:
    other, _ = meet(emulator)
    # Mode 50 has bit 0 cleared: the laser is off for this connection only.
    assert client.ask("conf_ls", 50, 0, 0, 0, 0).laser == (0,)
    assert client.ask("get_ls").laser == (0,)
    assert client.ask("gs").slots[42] == 50
    reply = other.ask("gs")
    assert reply.slots[42] == 51
    assert reply.laser is not None
    assert reply.laser[0] == 482
    no_laser = Mask(tuple(0 if slot in (0, 42) else 1 for slot in range(44)))
    assert other.ask("ct", *no_laser.smask).laser == (0,)


def test_conf_ls_sets_columns_and_conf_sg_line_extraction() -> None:
    client, _ = meet(n200(BEFORE_A_WALL))
    few = client.ask("conf_ls", 51, 0, 0, 20, 0).laser
    assert few is not None
    assert few[0] == 20
    # 21 points at least per line, but there are 20: no line.
    assert client.ask("conf_sg", 10, 21, 60).kind == "state"
    assert client.ask("get_sg").laser == (0,)
    client.ask("conf_sg", 10, 5, 100)
    line = client.ask("get_sg").laser
    assert line is not None
    assert line[0] == 1
    assert client.ask("conf_sg", 256, 0, 0).values == (2,)


def test_columns_and_lines_are_each_connections_own() -> None:
    emulator = n200(BEFORE_A_WALL)
    (client, _), (other, _) = meet(emulator), meet(emulator)
    # The other connection must see all columns and its own line extraction.
    whole, line = other.ask("get_ls").laser, other.ask("get_sg").laser
    other.ask("conf_ls", 51, 0, 0, 0, 0)
    client.ask("conf_ls", 51, 0, 0, 20, 0)
    client.ask("conf_sg", 10, 21, 60)
    assert client.ask("get_sg").laser == (0,)
    assert other.ask("get_ls").laser == whole
    assert other.ask("get_sg").laser == line
    assert client.ask("get_ls").laser != whole


@pytest.mark.parametrize("mode", [3, 33, 51])
def test_other_arguments_of_conf_ls_have_no_effect(mode: int) -> None:
    client, _ = meet(n200(StartPose(20.0, 45.0, 0.3, 0.2), MEASURED))
    plain = client.ask("conf_ls", mode, 0, 0, 100, 0).laser
    # Threshold, width and processing change nothing; the number of columns does.
    for numbers in ((255, 0, 100, 0), (0, 255, 100, 0), (0, 0, 100, 255), (120, 7, 100, 1)):
        assert client.ask("conf_ls", mode, *numbers).laser == plain
    assert client.ask("conf_ls", mode, 0, 0, 50, 0).laser != plain


def test_a_prediction_has_infrared_compass_and_laser(client: WireClient) -> None:
    here = client.ask("gs")
    reply = client.ask("predict_sensors", 400, 450, 0, 900)
    # Compass 900: the predicted turret. 572: the wall in y is 57.2 in away.
    assert (reply.values[1:17], reply.values[42:44]) == ((15,) * 16, (51, 900))
    assert reply.laser is not None
    assert set(reply.laser[1::2]) == {572}
    assert client.ask("gs").laser == here.laser


@pytest.mark.long
def test_a_measured_robot_continues_from_a_snapshot() -> None:
    emulator = n200(setup=MEASURED)
    client, _ = meet(emulator)
    client.ask("conf_sn", 1, *range(16))
    client.ask("conf_ir", 5, *range(16))
    client.ask("vm", 50, 100, 200)
    emulator.simulation.step(1.03)
    copy = n200(setup=MEASURED)
    loads(copy, dumps(emulator))
    other, _ = meet(copy)
    # Both copies must agree in every step: random streams, rings and compass are part of the snapshot.
    for _ in range(5):
        assert other.ask("gs") == client.ask("gs")
        emulator.simulation.step(0.21)
        copy.simulation.step(0.21)


# Stamps, clock, battery


def test_every_sensor_has_its_stamp(emulator: Emulator, client: WireClient) -> None:
    client.ask("vm", 100, 0, 0)
    emulator.simulation.step(0.25)
    stamps = client.ask("ct", *EVERYTHING.with_position(Position(31)).smask).stamps
    assert set(stamps) == {f"{kind}_{i}" for kind in ("ir", "sonar") for i in range(16)} | {
        "bumper", "laser", "compass"}  # fmt: skip
    # The last infrared reading was at 240 ms, 2.4 in; the laser is read at the request.
    assert [(stamps[key].x, stamps[key].sensor_time) for key in ("ir_0", "laser")] == [(24, 240), (25, 250)]
    # The compass is read every 0.1 s.
    assert (stamps["compass"].pose_time, stamps["compass"].sensor_time) == (250, 200)
    for name, key in (("get_ir", "ir_7"), ("get_cp", "compass"), ("get_ls", "laser"), ("get_sg", "laser")):
        assert client.ask(name).stamps[key] == stamps[key]


def test_the_clock_of_a_measured_robot_goes_in_steps_of_16_4_ms() -> None:
    # 1.0 s: 60 steps of 16.4 ms, and 16.4 s: exactly 1000 steps.
    assert [clock_ms(time_s, 0.0164) for time_s in (0.0163, 0.0164, 1.0, 16.4)] == [0, 16, 984, 16400]
    measured = n200(setup=MEASURED)
    stepped, _ = meet(measured)
    smooth, _ = meet(n200())
    assert stepped.ask("gs").clock == smooth.ask("gs").clock == 0
    measured.simulation.step(1.0)
    assert [stepped.ask(name).clock for name in ("gs", "get_sn", "get_ir", "get_cp", "get_ls", "get_bp")] == [984] * 6
    assert stepped.ask("sim_truth").values[1] == 1000


def test_the_batteries_drain(client: WireClient) -> None:
    assert client.ask("gs").volts == volts_raw(0.0)
    for hours in (0.0, 2.0, 4.0, 6.0):
        cpu, motors = volts_raw(hours * 3600.0)
        # The battery model loses 0.2 V an hour.
        assert volts(cpu, CPU_RANGE_V) == pytest.approx(12.0 - 0.2 * hours, abs=0.02)
        assert volts(motors, MOTOR_RANGE_V) == pytest.approx(12.0 - 0.2 * hours, abs=0.02)
