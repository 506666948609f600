"""Speeds are limited for every command and model."""

from __future__ import annotations

from typing import Any

import pytest

from nclient.backends.wrappers import SpeedLimiter
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.types import N150, N200, SCOUT, SCOUT_WHEEL_IN_PER_DEG
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_line import Answer, ScriptedLine, direct_on

# 80 and 300 in the wire's tenths.
BOTH: dict[str, Any] = {"max_speed_in_s": 8, "max_turn_deg_s": 30}


@pytest.mark.parametrize(
    ("name", "asked", "sent"),
    [
        ("vm", (200, 450, -450), (80, 300, -300)),
        ("vm", (-81, 299, 0), (-80, 299, 0)),
        ("vm", (80, 0, 0), (80, 0, 0)),
        ("sp", (200, 450, 450), (80, 300, 300)),
        # Mode 1 of mv is a velocity, 5 a speed, 4 an acceleration; 0 leaves the axis.
        ("mv", (1, 200, 1, -450, 1, 450), (1, 80, 1, -300, 1, 300)),
        ("mv", (5, 200, 4, 450, 0, 450), (5, 80, 4, 450, 0, 450)),
        ("gs", (), ()),
        ("ac", (300, 500, 500), (300, 500, 500)),
    ],
)
def test_speeds_are_limited(name: str, asked: tuple[int, ...], sent: tuple[int, ...]) -> None:
    robot = ScriptedLine()
    SpeedLimiter(direct_on(robot), **BOTH).execute(Call(name, asked))
    assert robot.calls == [Call(name, sent)]


def test_one_limit_leaves_other_axes_alone() -> None:
    robot = ScriptedLine()
    SpeedLimiter(direct_on(robot), max_speed_in_s=8).execute(Call("vm", (200, 450, 450)))
    SpeedLimiter(direct_on(robot), max_turn_deg_s=30).execute(Call("vm", (200, 450, 450)))
    assert [call.args for call in robot.calls] == [(80, 450, 450), (200, 300, 300)]


@pytest.mark.parametrize("call", [Call("pr", (100, 0, 0)), Call("mv", (0, 0, 2, 900, 0, 0)), Call("pa", (1, 2, 3))])
def test_limits_are_sent_before_the_first_relative_motion(call: Call) -> None:
    robot = ScriptedLine(model=N200)
    backend = SpeedLimiter(direct_on(robot), max_speed_in_s=8)
    robot.calls.clear()
    backend.execute(call)
    backend.execute(call)
    # Once, before the first motion that uses the speed of sp: the robot's own setting may be higher.
    assert robot.calls == [Call("mv", (5, 80, 0, 0, 0, 0)), call, call]


def test_sp_sets_the_speeds_of_all_axes() -> None:
    robot = ScriptedLine()
    backend = SpeedLimiter(direct_on(robot), **BOTH)
    backend.execute(Call("sp", (50, 450, 450)))
    backend.execute(Call("pr", (100, 0, 0)))
    assert robot.calls == [Call("sp", (50, 300, 300)), Call("pr", (100, 0, 0))]


def test_mv_sets_the_speed_of_an_axis() -> None:
    robot = ScriptedLine()
    backend = SpeedLimiter(direct_on(robot), max_speed_in_s=8)
    # A program's own speed of 2 in/s is below the limit, and is not replaced.
    asked = [Call("mv", (5, 20, 0, 0, 0, 0)), Call("pr", (100, 0, 0)), Call("mv", (5, 200, 2, 900, 0, 0))]
    for call in asked:
        backend.execute(call)
    assert robot.calls == [*asked[:2], Call("mv", (5, 80, 2, 900, 0, 0))]


def test_axes_that_mv_left_out_get_their_limits() -> None:
    robot = ScriptedLine()
    backend = SpeedLimiter(direct_on(robot), **BOTH)
    backend.execute(Call("mv", (0, 0, 5, 50, 0, 0)))
    backend.execute(Call("mv", (5, 70, 2, 100, 0, 0)))
    backend.execute(Call("pr", (1, 1, 1)))
    # The limit of the turret is sent before the motion; translation gets its speed in the same mv.
    assert [call.args for call in robot.calls] == [
        (0, 0, 5, 50, 0, 0), (0, 0, 0, 0, 5, 300), (5, 70, 2, 100, 0, 0), (1, 1, 1)
    ]  # fmt: skip


def test_an_unanswered_speed_is_sent_again() -> None:
    silence: list[Answer] = [None]
    robot = ScriptedLine({"sp": silence})
    backend = SpeedLimiter(direct_on(robot), max_speed_in_s=8)
    with pytest.raises(ReplyTimeout):
        backend.execute(Call("sp", (30, 450, 450)))
    robot.calls.clear()
    backend.execute(Call("pr", (100, 0, 0)))
    # The speed may have been set or not: it is sent again, without the axes that have no limit.
    assert robot.calls == [Call("mv", (5, 30, 0, 0, 0, 0)), Call("pr", (100, 0, 0))]


def test_a_refused_speed_does_not_count() -> None:
    # A NAK: type 8 without data.
    refused: list[Answer] = [bytes.fromhex("01 02 00 08 0b 5c")]
    robot = ScriptedLine({"sp": refused})
    backend = SpeedLimiter(direct_on(robot), max_speed_in_s=8)
    with pytest.raises(RobotRefused):
        backend.execute(Call("sp", (30, 450, 450)))
    backend.execute(Call("pr", (100, 0, 0)))
    assert robot.calls[1] == Call("mv", (5, 80, 0, 0, 0, 0))


def test_speeds_are_sent_again_after_a_link_loss() -> None:
    robot = ScriptedLine()
    stream = MemoryStream(robot)
    inner = direct_on(robot)
    backend = SpeedLimiter(inner, **BOTH)
    backend.execute(Call("sp", (50, 50, 50)))
    stream.close()
    inner.close()
    with pytest.raises(ConnectionLost):
        backend.execute(Call("gs"))
    # After a reconnect the robot may have been restarted, with its default speeds.
    again = direct_on(robot)
    backend._inner = again
    robot.calls.clear()
    backend.execute(Call("pr", (10, 0, 0)))
    assert robot.calls == [Call("mv", (5, 50, 5, 50, 5, 50)), Call("pr", (10, 0, 0))]


@pytest.mark.parametrize("asked", [(400, 400), (400, -400), (390, 100), (-300, 20), (60, 60), (0, 400)])
def test_wheels_of_a_scout_are_limited_together(asked: tuple[int, int]) -> None:
    robot = ScriptedLine(model=SCOUT)
    SpeedLimiter(direct_on(robot), **BOTH).execute(Call("vm", (*asked, 0)))
    right, left, _ = robot.calls[0].args
    assert max(abs(right), abs(left)) <= 80
    # Half the difference of the wheels turns the robot: 300 tenths of a degree in wheel travel, and 1 of rounding.
    assert abs(right - left) / 2 <= 300 * SCOUT_WHEEL_IN_PER_DEG + 1
    # The ratio of the wheels is preserved but for rounding, so that the robot follows the same arc.
    assert abs(right * asked[1] - left * asked[0]) <= max(abs(asked[0]), abs(asked[1]))
    # The oracle: one factor for both wheels, the smallest that any limit needs.
    slowest = min(80 / max(map(abs, asked)), 300 * SCOUT_WHEEL_IN_PER_DEG * 2 / max(1e-9, abs(asked[0] - asked[1])), 1)
    assert right == pytest.approx(asked[0] * slowest, abs=1)


def test_mv_and_sp_limit_the_wheels_of_a_scout() -> None:
    robot = ScriptedLine(model=SCOUT)
    # Wheels set apart may turn in opposite directions: each is limited to a full turn rate.
    wheel = int(300 * SCOUT_WHEEL_IN_PER_DEG)
    backend = SpeedLimiter(direct_on(robot), **BOTH)
    backend.execute(Call("sp", (390, 390, 0)))
    backend.execute(Call("mv", (1, 390, 0, 0, 0, 0)))
    backend.execute(Call("mv", (1, 100, 1, 50, 0, 0)))
    assert [call.args for call in robot.calls] == [
        (wheel, wheel, 0), (1, wheel, 0, 0, 0, 0), (1, wheel, 1, wheel, 0, 0)
    ]  # fmt: skip


def test_malformed_calls_are_left_to_the_inner_backend() -> None:
    robot = ScriptedLine(model=N150)
    with pytest.raises(ValueError, match="vm takes 3"):
        SpeedLimiter(direct_on(robot), **BOTH).execute(Call("vm", (1,)))
