"""Persistent settings are restored in order, the last of each kind, and nothing moves."""

from __future__ import annotations

import pytest

from nclient.backends.wrappers import PersistentSettings
from nclient.protocol.commands import Call

ORDER = tuple(range(16))
SETTINGS = [
    Call("connect_robot", (2, 99)), Call("ct", (0,) * 44), Call("conf_ls", (33, 20, 20, 60, 4)), Call("conf_tm", (5,)),
    Call("conf_ir", (4, *ORDER)), Call("conf_sn", (15, *ORDER)), Call("conf_cp", (1,)), Call("conf_sg", (50, 4, 30)),
    Call("ac", (300, 500, 500)), Call("sp", (200, 450, 450)),
]  # fmt: skip


def after(*calls: Call) -> list[Call]:
    settings = PersistentSettings()
    for call in calls:
        settings.record(call)
    return list(settings.calls())


def test_settings_are_restored_in_a_fixed_order() -> None:
    # Recorded in reverse, they come back in the order that a new connection needs: robot, mask, laser, then the rest.
    assert after(*reversed(SETTINGS)) == SETTINGS
    assert after() == []


def test_only_the_last_call_of_each_kind_counts() -> None:
    assert after(Call("conf_tm", (5,)), Call("conf_tm", (0,))) == [Call("conf_tm", (0,))]
    assert after(Call("create_robot", (3, 1))) == [Call("connect_robot", (3, 1))]


@pytest.mark.parametrize("call", [
    Call("vm", (1, 2, 3)), Call("pr", (1, 2, 3)), Call("mv", (1, 50, 2, 60, 6, 70)), Call("dp", (1, 2)), Call("gs"),
    # A compass calibration, mode 2, is an action and no setting.
    Call("conf_cp", (2,)),
])  # fmt: skip
def test_motions_and_actions_are_not_restored(call: Call) -> None:
    assert after(call) == []


# Mode 5 sets a speed, 4 an acceleration, for one axis.
def test_speeds_of_mv_are_restored_by_axis() -> None:
    speed = Call("mv", (5, 50, 0, 0, 0, 0))
    assert after(speed) == [speed]
    # Together with the speeds of sp it is one sp.
    assert after(Call("sp", (200, 450, 450)), speed) == [Call("sp", (50, 450, 450))]
    assert after(speed, Call("mv", (4, 300, 5, 90, 1, 7))) == [
        Call("mv", (4, 300, 0, 0, 0, 0)), Call("mv", (5, 50, 5, 90, 0, 0))
    ]
    # All three axes are set: one sp replaces the mv.
    assert after(speed, Call("mv", (0, 0, 5, 60, 5, 70))) == [Call("sp", (50, 60, 70))]
