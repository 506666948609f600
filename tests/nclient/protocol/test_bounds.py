"""Serial argument ranges: they equal the limits of the bytes that construct can build."""

from __future__ import annotations

import pytest
from construct import ConstructError

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.codec import clamp_to_serial, describe_serial_overflow, serial_argument_bounds
from nclient.protocol.commands import COMMANDS, Call, Command
from nclient.protocol.types import N150, N200, serial_wire_state

BOUNDED = [row for row in COMMANDS if row.line_type is not None and serial_argument_bounds(row.name)]


@pytest.mark.parametrize("row", BOUNDED, ids=lambda row: row.name)
def test_the_bytes_go_just_so_far(row: Command) -> None:
    middle = [0] * len(row.arguments)
    for place, (name, least, most) in enumerate(serial_argument_bounds(row.name)):
        # The flags and the time of ws have no range that one byte gives: flags become 0 or 1, and a long wait is sent
        # as several.
        if most > 0xFFFF:
            continue
        for value, fits in ((least, True), (most, True), (least - 1, False), (most + 1, False)):
            numbers = [*middle[:place], value, *middle[place + 1 :]]
            # 1. The error text names the argument exactly if its value is out of range.
            assert (describe_serial_overflow(Call(row.name, tuple(numbers))) == "") is fits, name
            # 2. Construct refuses the same values, as an independent limit of the field's bytes.
            if name == "history" and value > most:
                continue  # the line's own clamp, to ten
            if fits:
                row.line_request.build(numbers)
            else:
                with pytest.raises(ConstructError):
                    row.line_request.build(numbers)


@pytest.mark.parametrize(("asked", "sent"), [
    # Signed 16 bits in sign-magnitude: at most 32767 in both directions.
    (Call("vm", (40_000, -40_000, 5)), Call("vm", (32767, -32767, 5))),
    # Unsigned 16 bits.
    (Call("ac", (-1, 70_000, 3)), Call("ac", (0, 65535, 3))),
    (Call("conf_tm", (256,)), Call("conf_tm", (255,))),
    # The y of place_robot is a word of dp, its angles are words of da.
    (Call("place_robot", (1, 2, 40_000, 4)), Call("place_robot", (1, 2, 32767, 4))),
    # ws stays: a wait of more than 255 s is sent in pieces, and flags are not clamped.
    (Call("ws", (7, 0, 1, 600)), Call("ws", (7, 0, 1, 600))),
    (Call("ws", (1, 1, 1, -1)), Call("ws", (1, 1, 1, 0))),
    # Calls without a table of ranges, or with a wrong number of arguments, are returned as they are.
    (Call("gs"), Call("gs")), (Call("vm", (99_999,)), Call("vm", (99_999,))),
    (Call("tk", ("hello",)), Call("tk", ("hello",))), (Call("nothing", (1,)), Call("nothing", (1,))),
    (Call("arm_mv", (1, 70_000, 1, 70_000)), Call("arm_mv", (1, 70_000, 1, 70_000))),
    (Call("ct", (31, *[1] * 43)), Call("ct", (31, *[1] * 43))),
])  # fmt: skip
def test_brought_within(asked: Call, sent: Call) -> None:
    assert clamp_to_serial(asked) == sent


def test_out_of_range_arguments_are_named_with_their_bounds() -> None:
    with pytest.raises(WireError, match=r"pr: steering .*-32768.* -32767 to 32767"):
        codec.encode_serial_request(Call("pr", (32767, -32768, 0)), serial_wire_state(N150))
    with pytest.raises(WireError, match=r"conf_tm: .*300.* 0 to 255"):
        codec.encode_serial_request(Call("conf_tm", (300,)), serial_wire_state(N200))
