"""Robots with rings of their own: firing in groups, limits, and whole runs in the simulation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from localization.live.assumptions import resolve_body, resolve_robot_model
from localization.live.sensor_input import FiringSchedule, SensorData, corrected, restart_ring, sonar_readings
from nclient import connect
from nclient.cli.main import main
from nclient.errors import AddressError
from worlds.robots import N150, Calibration, load_bodies

MODELS = Path(__file__).parents[2] / "worlds" / "models"
EIGHT = load_bodies(MODELS / "corridor8.toml")["corridor8"]
RING24 = load_bodies(MODELS / "ring24.toml")["ring24"]


def address(name: str, world: str = "several_walls", options: str = "") -> str:
    return f"sim:{world}?robot={name}&model_file={MODELS / name}.toml{options}"


def test_groups_are_readable_at_once() -> None:
    schedule = FiringSchedule(10.0, EIGHT.ring.interval_s, EIGHT.ring.firing)
    assert schedule.round_s == pytest.approx(0.3)
    fired = schedule.readable(9.9, 10.2)
    # 10.2 s is past for certain one step of the clock later.
    assert [(sonar, round(instant_s, 3)) for sonar, instant_s in fired] == [
        (0, 10.0), (7, 10.0), (2, 10.06), (5, 10.06), (1, 10.12), (6, 10.12), (3, 10.18)
    ]  # fmt: skip
    assert schedule.order == (0, 7, 2, 5, 1, 6, 3, 4)


def test_each_firing_of_a_group_is_readable_once() -> None:
    schedule = FiringSchedule(0.0, RING24.ring.interval_s, RING24.ring.firing)
    seen, last_s = [], -1.0
    for step in range(1, 40):
        found = schedule.readable(last_s, 0.05 * step)
        seen += found
        last_s = found[-1].instant_s if found else last_s
    count = len({instant for _, instant in seen})
    expected = [
        (sonar, k * RING24.ring.interval_s) for k in range(count) for sonar in RING24.ring.firing[k % 6]
    ]  # fmt: skip
    assert [sonar for sonar, _ in seen] == [sonar for sonar, _ in expected]
    assert [instant_s for _, instant_s in seen] == pytest.approx([instant_s for _, instant_s in expected])


def state_of(readings: tuple[float, ...]) -> SensorData:
    return SensorData(1.0, 0.0, 0.0, 0.0, 0.0, readings)


def test_limits_are_limits_of_every_part_of_a_filter() -> None:
    ring = replace(EIGHT.ring, no_echo_in=0.0)
    # "No echo" of this ring, 0, becomes the 255 that filters know, and so does the largest range.
    seen = corrected(state_of((0.0, 50.0, ring.max_range_in, ring.min_range_in)), Calibration(), ring).sonars_in
    assert seen == (255.0, 50.0, 255.0, ring.min_range_in)
    far = replace(EIGHT.ring, min_range_in=10.0, max_range_in=400.0, no_echo_in=400.0)
    assert corrected(state_of((9.0, 10.0, 300.0, 400.0)), Calibration(), far).sonars_in == (6.0, 6.0, 300.0, 400.0)
    # With offsets, ranges stay within the limits of the ring.
    offsets = Calibration(offsets_in=(1.0, 60.0, -9.0))
    assert corrected(state_of((50.0, 50.0, 196.0)), offsets, EIGHT.ring).sonars_in == pytest.approx(
        (49.0, EIGHT.ring.min_range_in, EIGHT.ring.max_range_in), abs=2e-3
    )


def test_a_nomad_is_restarted_by_conf_sn() -> None:
    with connect("sim:several_walls") as robot:
        schedule, state = restart_ring(robot, N150.ring)
        assert state.ring_in is None
        assert state.clock_s is not None
        assert schedule == FiringSchedule(state.clock_s)


@pytest.mark.parametrize("body", [EIGHT, RING24])
def test_states_have_all_sonars_of_a_watched_ring(body: Any) -> None:
    with connect(address(body.name, options="&start=5,5,0,0")) as robot:
        schedule, state = restart_ring(robot, body.ring)
        assert (schedule.interval_s, schedule.firing) == (body.ring.interval_s, body.ring.firing)
        assert len(sonar_readings(state)) == body.ring.count
        # Reading the ring takes no simulated time; State has the first sixteen in whole inches.
        before = robot.truth().time_s
        readings = robot.read_ring().readings_in
        assert robot.truth().time_s == before
        for wire, reading in zip(state.sonars_in, readings, strict=False):
            assert wire == 255 or wire == pytest.approx(reading, abs=0.501) or wire == 6


# No command, an unknown one, a byte too many, and another packet type.
@pytest.mark.parametrize("packet", [(60,), (60, 2), (60, 0, 0), (61, 0)])
def test_other_packets_are_refused(packet: tuple[int, ...]) -> None:
    from nclient.errors import RobotRefused

    with connect("sim:several_walls") as robot, pytest.raises(RobotRefused):
        robot.send_packet(packet[0], bytes(packet[1:]))


def test_a_robot_without_the_packet_needs_a_ring_in_state() -> None:
    class Without:
        def watch_ring(self) -> None:
            from nclient.errors import RobotRefused

            raise RobotRefused("special_request", 4)

    robot: Any = Without()
    with pytest.raises(AddressError, match="16 sonars"):
        restart_ring(robot, RING24.ring)


def localized(words: list[str], capsys: pytest.CaptureFixture[str]) -> Any:
    assert main(["localize", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.long
@pytest.mark.parametrize(("name", "setup", "rmse_in"), [
    ("corridor8", "noisy", 0.5), ("corridor8", "measured", 0.5), ("ring24", "noisy", 0.3), ("ring24", "measured", 0.3),
])  # fmt: skip
def test_any_ring_is_localized(name: str, setup: str, rmse_in: float, capsys: pytest.CaptureFixture[str]) -> None:
    there = address(name, options=f"&setup={setup}&seed=2&start=5,5,0,0")
    result = localized([there, "--waypoints", "20,30"], capsys)
    assert (result["reached"], result["trust"]) == (1, "OK")
    assert result["rmse_position_in"] < rmse_in
    # All sonars of the ring contribute.
    rings = result["duration_s"] / (EIGHT if name == "corridor8" else RING24).ring.round_s
    assert result["echoes_used"] > 4 * rings


@pytest.mark.parametrize(("given", "name"), [
    (("sim:x?robot=Mine&model_file=y.toml", None, "n150"), "mine"),
    (("sim:x?model_file=y.toml", None, "n150"), "n150"),
    (("nserver://host/1", "mine", "n150"), "mine"),
])  # fmt: skip
def test_a_robot_of_a_model_file_has_its_own_name(given: tuple[str, str | None, str], name: str) -> None:
    there, option, model = given
    assert resolve_robot_model(option, model, there) == name


def test_bodies_come_from_the_file() -> None:
    assert resolve_body("ring24", MODELS / "ring24.toml", "nserver://host/1") == RING24
    assert resolve_body("corridor8", None, address("corridor8")) == EIGHT
    assert resolve_body("n150", None, "nserver://host/1") is N150
    with pytest.raises(AddressError, match="did you mean ring24"):
        resolve_body("ring42", MODELS / "ring24.toml", "nserver://host/1")
