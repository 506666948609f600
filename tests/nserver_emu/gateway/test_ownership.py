"""Who may move a real robot: the first that moves it, until it leaves or lets it go; everybody may stop it."""

from __future__ import annotations

import pytest

from nclient.protocol.commands import COMMANDS, Call
from nserver_emu.gateway.gateway import Ownership, changes
from nserver_emu.server.ownership import moves
from nserver_emu.server.session import Visit

VM = Call("vm", (100, 0, 0))


@pytest.mark.parametrize(
    ("modes", "moving", "changing"),
    [((0, 0, 0), False, False), ((4, 0, 5), False, True), ((0, 1, 0), True, True), ((0, 0, 3), True, True)],
)
def test_an_mv_is_what_its_modes_are(modes: tuple[int, int, int], moving: bool, changing: bool) -> None:
    call = Call("mv", tuple(number for mode in modes for number in (mode, 50)))
    assert (moves(call), changes(call)) == (moving, changing)


def test_whoever_moves_it_first_owns_it_and_the_others_watch_and_stop() -> None:
    owner, other, ownership = Visit(), Visit(), Ownership()
    assert ownership.allows(Call("sp", (1, 1, 1)), other)
    assert ownership.is_free_for(owner)
    assert ownership.allows(VM, owner)
    assert ownership.owner is owner
    assert not ownership.is_free_for(other)
    for name in ("vm", "zr", "sp", "dp", "conf_tm", "place_robot", "tk", "lp"):
        assert not ownership.allows(Call(name, (0, 0, 0)), other)
    for name in ("st", "gs", "ct", "get_sn", "ws"):
        assert ownership.allows(Call(name, (1, 1, 1, 1)), other)
    assert ownership.allows(Call("mv", (0,) * 6), other)
    assert ownership.allows(Call("st"), owner)
    assert ownership.owner is owner


def test_the_owner_lets_it_go_with_lp() -> None:
    owner, other, ownership = Visit(), Visit(), Ownership()
    assert ownership.allows(VM, owner)
    assert ownership.allows(Call("lp"), owner)
    assert ownership.allows(VM, other)
    assert ownership.owner is other


def test_read_only_is_for_everybody_and_st_is_not_refused() -> None:
    visit, ownership = Visit(), Ownership(read_only=True)
    refused = {row.name for row in COMMANDS if not ownership.allows(Call(row.name, (1, 1, 1, 1, 1, 1)), visit)}
    assert ownership.owner is None
    assert refused == {
        "ac", "sp", "pr", "pa", "vm", "mv", "lp", "zr", "dp", "da", "conf_ir", "conf_sn", "conf_cp", "conf_ls",
        "conf_tm", "conf_sg", "conf_ser", "tk", "arm_zr", "arm_ws", "arm_mv", "special_request", "place_robot",
    }  # fmt: skip
