"""A long ws is split into pieces; its reply is that of the last one."""

from __future__ import annotations

import pytest

from nclient.backends.base import is_wait, split_wait
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply


@pytest.mark.parametrize(("flags", "motors", "pieces"), [
    # Motor bits after each piece: the wait ends when none of the named axes moves.
    ((1, 1, 1), [4, 1, 0], [2, 2, 2]),
    # 6 is steering and turret, which were not named.
    ((1, 0, 0), [1, 6], [2, 2]),
    # 7 s in pieces of 2 s.
    ((1, 1, 1), [7, 7, 7, 7], [2, 2, 2, 1]),
    # No axis is named: nothing is waited for.
    ((0, 0, 0), [7], [2]),
])
def test_pieces_end_when_axes_are_still_or_time_is_over(
    flags: tuple[int, ...], motors: list[int], pieces: list[int]
) -> None:
    sent: list[Call] = []

    def execute(call: Call) -> Reply:
        sent.append(call)
        return Reply("state", {41: motors[len(sent) - 1]}, clock=len(sent))

    reply = split_wait(Call("ws", (*flags, 7)), 2, execute)
    assert sent == [Call("ws", (*flags, piece)) for piece in pieces]
    assert reply.clock == len(pieces)


def test_a_wait_without_time_is_one_piece() -> None:
    sent: list[Call] = []
    split_wait(Call("ws", (1, 1, 1, 0)), 1, lambda call: sent.append(call) or Reply("state", {41: 7}))  # type: ignore[func-returns-value]
    assert sent == [Call("ws", (1, 1, 1, 0))]


def test_only_a_complete_ws_is_split() -> None:
    assert is_wait(Call("ws", (1, 1, 1, 9)))
    assert not is_wait(Call("ws", (1,)))
    assert not is_wait(Call("gs"))
