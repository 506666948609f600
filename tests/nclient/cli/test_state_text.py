"""A state in words and as an object: every number where it belongs, units beside it, nothing made up."""

from __future__ import annotations

import json

import pytest

from nclient.cli import state_text
from nclient.errors import ShellError
from nclient.protocol.types import N150, N200, SCOUT, Model
from nclient.state import RobotState

SONARS = [40] * 16


def state(model: Model = N150, slots: dict[int, int] | None = None, **more: object) -> RobotState:
    """A robot at rest, but for these slots."""
    # Slots that are not given are 0, which means at rest for all but the sonars.
    raw = {17 + number: reading for number, reading in enumerate(SONARS)} | {33: 0} | (slots or {})
    return RobotState(model, tuple(raw.get(slot, 0) for slot in range(45)), **more)  # type: ignore[arg-type]


def test_a_line_has_pose_motion_the_nearest_echo_and_the_clock() -> None:
    # Tenths of inches and degrees; sonar 3 (slot 20) points at 3 x 22.5 = 67.5 degrees.
    reported = state_text.format_state(state(slots={34: 240, 35: -15, 36: 450, 37: 3590, 20: 7}, clock_ms=12345))
    assert reported == (
        "x 24.0 in  y -1.5 in  steering 45.0 deg  turret 359.0 deg | standing | nearest 7 in at 67.5 deg | clock 12.3 s"
    )


def test_a_line_stresses_bumpers_and_omits_missing_sensors() -> None:
    # 255 means no echo. Bits 0 and 2 of the bumpers are set.
    reported = state_text.format_state(state(slots={17 + number: 255 for number in range(16)} | {33: 0b101}))
    assert reported.endswith("| standing | BUMPER 0 2")
    assert "nearest" not in reported
    assert "clock" not in reported


def test_motion_names_the_axes_that_move() -> None:
    # Velocities 10 in/s and -5 deg/s; motor bits 0 and 1: translation and steering.
    reported = state_text.format_motion(state(slots={38: 100, 39: -50, 41: 0b011}))
    assert reported == "moving: translation 10.0 in/s, steering -5.0 deg/s"
    # The motor bits decide: a velocity without one is not motion.
    assert state_text.format_motion(state(slots={38: 100})) == "standing"


def test_all_parts_come_with_their_names() -> None:
    reported = [line.split()[0] for line in state_text.format_parts(state())]
    assert reported == list(state_text.PARTS)
    assert [line.split()[0] for line in state_text.format_parts(state(), ("sonar", "pose"))] == ["sonar", "pose"]


@pytest.mark.parametrize(("model", "slots", "part", "reported"), [
    (N150, {17: 255, 18: 12}, "sonar", "  -  12  40"),
    (N150, {}, "infrared", "none on this model"),
    (N200, {1: 15, 2: 3}, "infrared", " 15   3   0"),
    # The upper four bits of the first byte read 1 on a N150 at rest.
    (N150, {33: 0xF00000}, "bumpers", "free"),
    (N150, {33: 0xF00002}, "bumpers", "TOUCHING: 1"),
    (N150, {43: 900}, "compass", "90.0 deg"),
    (N150, {38: 100}, "velocity", "translation 10.0 in/s  steering 0.0 deg/s  turret 0.0 deg/s"),
    (SCOUT, {38: 100, 39: 100}, "velocity", "right 10.0 in/s  left 10.0 in/s"),
    # Bits 4, 5 and 6: plugged, charging, emergency stop.
    (SCOUT, {41: 0b1110000}, "motors", "standing, on mains, charging, EMERGENCY STOP"),
    (N150, {44: 5}, "error", "5"),
    (N150, {}, "error", "none"),
    (N150, {}, "clock", "unknown"),
    (N150, {}, "battery", "unknown"),
    (N200, {}, "laser", "no readings"),
    (N150, {}, "laser", "none on this model"),
])
def test_a_part_in_words(model: Model, slots: dict[int, int], part: str, reported: str) -> None:
    (line,) = state_text.format_parts(state(model, slots), (part,))
    assert reported in line


def test_reported_values_are_shown() -> None:
    reported = "\n".join(
        state_text.format_parts(state(N200, clock_ms=1500, raw_volts=(255, 255), laser=(5, *range(10, 110, 10))))
    )
    assert "1.500 s" in reported
    assert "computer 12.0 V  motors 12.8 V" in reported
    assert "5 readings, in: (1.0, 2.0)  (3.0, 4.0)  (5.0, 6.0)  (7.0, 8.0) .." in reported


@pytest.mark.parametrize(("laser", "reported"), [
    ((3, 7, 8, 9), "3 rows of the camera: 7 8 9"), ((9, *range(9)), "9 rows of the camera: 0 1 2 3 4 5 6 7 .."),
])  # fmt: skip
def test_rows_of_the_camera_are_no_points(laser: tuple[int, ...], reported: str) -> None:
    (line,) = state_text.format_parts(state(N200, laser=laser), ("laser",))
    assert line.endswith(reported)


def test_a_part_that_there_is_not() -> None:
    with pytest.raises(ShellError, match=r"'sonars'.* sonar"):
        state_text.check_parts(("pose", "sonars"))


def test_an_object_for_programs_is_plain_json() -> None:
    seen = state(slots={17: 255, 34: 240}, clock_ms=1500, raw_volts=(0, 0))
    reported = json.loads(json.dumps(state_text.as_json(seen)))
    # (2 + 3 x 0 / 255) x 12 / 5 = 4.8 V for the raw byte 0.
    assert (reported["x_in"], reported["clock_s"], reported["cpu_v"], reported["moving"]) == (24.0, 1.5, 4.8, False)
    assert reported["sonars_in"] == [None, *SONARS[1:]]
    assert reported["infrareds"] is None
    bare = state_text.as_json(state(N200))
    assert (bare["cpu_v"], bare["clock_s"], bare["infrareds"]) == (None, None, [0] * 16)
