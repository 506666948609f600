"""ClientState: stored as the C client does; None before the first value; errors change slot 44 only."""

from __future__ import annotations

import pytest

from nclient.protocol.client_state import ClientState
from nclient.protocol.replies import Reply
from nclient.protocol.types import NO_STAMP, Stamp

STATE = Reply(
    # Slot k holds -k, so that a value in a wrong slot is visible.
    "state", {slot: -slot for slot in range(45)}, laser=(1, -5), stamps={"bumper": Stamp(-1, *NO_STAMP[1:])},
    clock=7, volts=(1, 2),
)


def held_after(*replies: Reply, wide: bool = False) -> ClientState:
    held = ClientState(wide)
    for reply in replies:
        held.apply_reply(reply)
    return held


def test_at_first_nothing_was_ever_received() -> None:
    held = ClientState()
    assert held.slots == [None] * 45
    assert (held.laser, held.stamps, held.clock, held.volts) == (None, {}, None, None)


def test_a_state_reply_over_tcp_fills_all_and_clears_44() -> None:
    held = held_after(STATE)
    # Slot 44 reads 0 after a state reply, whatever its word 44 is.
    assert held.slots == [*(-slot for slot in range(44)), 0]
    assert (held.laser, held.clock, held.volts) == ((1, -5), 7, (1, 2))


def test_a_packet_on_the_line_leaves_what_it_does_not_carry() -> None:
    # A serial packet carries what the mask allows: here slots 34 and 41, no laser, no stamps; it does not clear slot
    # 44.
    held = held_after(STATE, Reply("error", values=(3,)), Reply("state", {34: 9, 41: 1}, clock=8, volts=(3, 4)))
    assert (held.slots[34], held.slots[41], held.slots[35], held.slots[44]) == (9, 1, -35, 3)
    assert (held.laser, held.clock, held.volts) == ((1, -5), 8, (3, 4))
    assert held.stamps["bumper"].x == -1


@pytest.mark.parametrize("reply", [
    # A NAK and a prediction are not stored; the simple reply and this velocity reply carry no slots.
    Reply("nak"), Reply("prediction", laser=(0,), values=(1,) * 44), Reply("simple", values=(0,)), Reply("velocity"),
])
def test_replies_that_change_nothing(reply: Reply) -> None:
    before, after = held_after(STATE), held_after(STATE, reply)
    assert vars(before) == vars(after)


def test_an_error_puts_its_code_in_44_until_the_next_state() -> None:
    assert held_after(STATE, Reply("error", values=(4,))).slots[44] == 4
    assert held_after(STATE, Reply("error", values=(4,)), STATE).slots[44] == 0


def test_a_64_bit_client_sees_no_minus() -> None:
    held = held_after(STATE, wide=True)
    # A 64-bit client reads the words without sign extension: -1 becomes 2^32 - 1.
    assert held.slots[:3] == [0, 2**32 - 1, 2**32 - 2]
    assert held.laser == (1, 2**32 - 5)
    assert held.stamps["bumper"].x == 2**32 - 1
    assert held_after(Reply("sonar", {17: 255}), wide=True).laser is None
