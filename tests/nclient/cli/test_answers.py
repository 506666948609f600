"""Text of replies that the in-process simulation does not send."""

from __future__ import annotations

import pytest

from nclient.cli.state_text import format_reply
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150
from nclient.state import RobotState

STATE = RobotState(N150, (0,) * 45)


@pytest.mark.parametrize(("name", "reply", "reported"), [
    ("vm", Reply("nak"), "refused by the robot (NAK)"),
    ("tk", Reply("simple", values=(1,)), "ok"),
    ("conf_cp", Reply("compass", values=(1, 2, 3)), "1 2 3"),
    ("get_ra", Reply("velocity", {38: 100, 39: 5, 40: -5}),
     "translation 10.0 in/s2  steering 0.5 deg/s2  turret -0.5 deg/s2"),
    # 1500 ms, then the speed in tenths, then "paused".
    ("sim_control", Reply("control", values=(1, 1500, 20, 0)), "simulated time 1.500 s, 2 x real time"),
    ("sim_control", Reply("control", values=(1, 1500, 20, 1)), "simulated time 1.500 s, paused"),
    ("motion_check", Reply("simple", values=(1, 1000, -2000, 1570796)),
     "hits at x 1.0 in  y -2.0 in, normal 1.571 rad"),
    # The wire's word -1 is the unsigned 4294967295 ms; positions in thousandths; seed 3 and robot number 2.
    ("sim_truth", Reply("truth", values=(1, -1, 1000, 2000, 90000, 0, 3, 2)),
     "ground truth x 1.000 in  y 2.000 in  heading 90.000 deg  turret 0.000 deg | 4294967.295 s | robot 2, seed 3"),
])
def test_what_is_shown(name: str, reply: Reply, reported: str) -> None:
    assert list(format_reply(Call(name), reply, STATE)) == [reported]
