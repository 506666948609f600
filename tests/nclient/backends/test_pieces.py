"""A long ws is asked in pieces, and its answer is the one that the whole would have had."""

from __future__ import annotations

import pytest

from nclient.backends.base import is_wait, split_wait
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply


@pytest.mark.parametrize(("flags", "motors", "pieces"), [
    ((1, 1, 1), [4, 1, 0], [2, 2, 2]),
    ((1, 0, 0), [1, 6], [2, 2]),
    ((1, 1, 1), [7, 7, 7, 7], [2, 2, 2, 1]),
    ((0, 0, 0), [7], [2]),
])
def test_until_the_axes_that_it_names_are_still_or_time_is_over(
    flags: tuple[int, ...], motors: list[int], pieces: list[int]
) -> None:
    said: list[Call] = []

    def say(call: Call) -> Reply:
        said.append(call)
        return Reply("state", {41: motors[len(said) - 1]}, clock=len(said))

    reply = split_wait(Call("ws", (*flags, 7)), 2, say)
    assert said == [Call("ws", (*flags, piece)) for piece in pieces]
    assert reply.clock == len(pieces)


def test_no_time_is_asked_once() -> None:
    said: list[Call] = []
    split_wait(Call("ws", (1, 1, 1, 0)), 1, lambda call: said.append(call) or Reply("state", {41: 7}))  # type: ignore[func-returns-value]
    assert said == [Call("ws", (1, 1, 1, 0))]


def test_what_can_be_cut() -> None:
    assert is_wait(Call("ws", (1, 1, 1, 9)))
    assert not is_wait(Call("ws", (1,)))
    assert not is_wait(Call("gs"))
