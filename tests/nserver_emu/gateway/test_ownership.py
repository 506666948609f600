"""Ownership of a real robot: the first client that moves it, until it disconnects or sends lp; all may stop it."""

from __future__ import annotations

import pytest

from nclient.protocol.commands import COMMANDS, Call
from nserver_emu.gateway.gateway import Ownership, changes
from nserver_emu.server.estop import moves
from nserver_emu.server.session import ConnectionContext

VM = Call("vm", (100, 0, 0))


@pytest.mark.parametrize(
    ("modes", "moving", "changing"),
    # Modes 4 and 5 are settings, 1 is a velocity, 3 releases the motor.
    [((0, 0, 0), False, False), ((4, 0, 5), False, True), ((0, 1, 0), True, True), ((0, 0, 3), True, True)],
)
def test_mv_changes_the_robot_by_its_modes(modes: tuple[int, int, int], moving: bool, changing: bool) -> None:
    call = Call("mv", tuple(number for mode in modes for number in (mode, 50)))
    assert (moves(call), changes(call)) == (moving, changing)


def test_the_first_to_move_becomes_the_owner() -> None:
    owner, other, ownership = ConnectionContext(), ConnectionContext(), Ownership()
    assert ownership.allows(Call("sp", (1, 1, 1)), other)
    assert ownership.is_free_for(owner)
    assert ownership.allows(VM, owner)
    assert ownership.owner is owner
    assert not ownership.is_free_for(other)
    # All that moves or changes the robot; reading and stopping are allowed.
    for name in ("vm", "zr", "sp", "dp", "conf_tm", "place_robot", "tk", "lp"):
        assert not ownership.allows(Call(name, (0, 0, 0)), other)
    for name in ("st", "gs", "ct", "get_sn", "ws"):
        assert ownership.allows(Call(name, (1, 1, 1, 1)), other)
    assert ownership.allows(Call("mv", (0,) * 6), other)
    assert ownership.allows(Call("st"), owner)
    assert ownership.owner is owner


def test_lp_removes_the_owner() -> None:
    owner, other, ownership = ConnectionContext(), ConnectionContext(), Ownership()
    assert ownership.allows(VM, owner)
    assert ownership.allows(Call("lp"), owner)
    assert ownership.allows(VM, other)
    assert ownership.owner is other


def test_read_only_refuses_all_changes_but_st() -> None:
    context, ownership = ConnectionContext(), Ownership(read_only=True)
    refused = {row.name for row in COMMANDS if not ownership.allows(Call(row.name, (1, 1, 1, 1, 1, 1)), context)}
    assert ownership.owner is None
    assert refused == {
        "ac", "sp", "pr", "pa", "vm", "mv", "lp", "zr", "dp", "da", "conf_ir", "conf_sn", "conf_cp", "conf_ls",
        "conf_tm", "conf_sg", "conf_ser", "tk", "arm_zr", "arm_ws", "arm_mv", "special_request", "place_robot",
    }  # fmt: skip
