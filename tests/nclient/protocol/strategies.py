"""Hypothesis strategies for the protocol's tests: calls with valid arguments, terms, replies, frames, cuts.

Ranges are written down here anew, from the documentation, not taken from the declarations under test.
"""

from __future__ import annotations

from itertools import pairwise
from random import Random
from typing import Any

from hypothesis import strategies as st

from nclient.protocol.commands import COMMANDS, Call, Command
from nclient.protocol.replies import Reply
from nclient.protocol.types import (
    EVERYTHING,
    INFRARED_KEYS,
    MODELS,
    SONAR_KEYS,
    Mask,
    Model,
    Stamp,
    WireState,
    serial_wire_state,
    tcp_wire_state,
)

ALL_STAMPS = (*INFRARED_KEYS, *SONAR_KEYS, "bumper", "laser", "compass")
TCP_ROWS = tuple(row for row in COMMANDS if row.tcp_type is not None)
LINE_CASES = tuple(
    (row, MODELS[model]) for row in COMMANDS if row.line_type is not None for model in sorted(row.line_models)
)
LINE_CASE_NAMES = tuple(f"{row.name}-{model.name}" for row, model in LINE_CASES)

word = st.integers(-(2**31), 2**31 - 1)
uint8 = st.integers(0, 255)
uint16 = st.integers(0, 65535)
# Sign-magnitude: the 16 bits 0x8000 are "minus zero", so that -32768 cannot be sent.
signed16 = st.integers(-32767, 32767)
uint32 = st.integers(0, 2**32 - 1)
flag = st.integers(0, 1)
_bits = st.lists(flag, min_size=43, max_size=43)
masks = st.builds(lambda position, bits: Mask((position, *bits)), st.integers(0, 31), _bits)
# The serial line does not carry Smask[41], and it is read as 1.
line_masks = masks.map(lambda mask: Mask((*mask.smask[:41], 1, *mask.smask[42:])))
# Over TCP a reading has 4 words in the line modes 1 and 33, 2 in the point modes 51, 50 and 19, and 1 in the others.
laser_modes = st.sampled_from((51, 50, 19, 1, 33, 0, 35, 49, 255))
cuts = st.lists(st.integers(0, 400), max_size=12)

_LINE_BYTES = {"conf_ir", "conf_sn", "conf_cp", "conf_tm", "conf_sg"}
_texts = st.characters(min_codepoint=1, max_codepoint=255)


def calls(row: Command, line: bool) -> st.SearchStrategy[Call]:
    """Calls of this command whose bytes, parsed, give the very same call back."""
    return _arguments(row, line).map(lambda args: Call(row.name, tuple(args)))


def _arguments(row: Command, line: bool) -> st.SearchStrategy[Any]:
    match row.name:
        case "tk":
            # Serial: 255 bytes of a host's frame, less 6 of the frame and the NUL. TCP: 64 words, less the NUL.
            return st.text(_texts, max_size=248 if line else 255).map(lambda text: (text,))
        case "ct":
            return (line_masks if line else masks).map(lambda mask: mask.smask)
        case "special_request":
            # Packets 40 to 42 are those of the arm, which have rows of their own in the command table.
            packet = st.integers(0, 255).filter(lambda kind: kind not in (40, 41, 42))
            # Serial: 255 bytes of a frame, less 6 of the frame and 4 of the packet's own header.
            return st.tuples(packet, st.lists(uint8, max_size=245 if line else 250)).map(lambda t: (t[0], *t[1]))
        case "arm_zr":
            return st.tuples(uint16)
        case "arm_ws":
            return st.tuples(uint16, uint16, uint32)
        case "arm_mv":
            return st.tuples(word, word, word, word)
        case "motion_check":
            return motion_checks()
        case "add_obstacle" | "delete_obstacle":
            return obstacles(tail=0)
        case "move_obstacle":
            return obstacles(tail=2)
    return st.tuples(*[_argument(row, argument.name, line) for argument in row.arguments])


def _argument(row: Command, name: str, line: bool) -> st.SearchStrategy[int]:
    if row.name == "ws" and name != "timeout_s":
        return flag
    if not line:
        return word
    if name == "history":
        # The serial line sends a history of more than 10 as 10: a larger one is not what the parser returns.
        return st.integers(0, 10)
    if row.name == "conf_ls" and name == "mode":
        # Mode 51 is sent as 35 on the serial line, and 35 is read as 51.
        return uint8.filter(lambda mode: mode != 35)
    if name in ("num_data", "baud") or name.endswith("_mode") or row.name in ("ac", "sp"):
        return uint16
    if row.name in _LINE_BYTES | {"conf_ls", "ws"} or name == "port":
        return uint8
    return signed16


def obstacles(tail: int) -> st.SearchStrategy[tuple[int, ...]]:
    """n, the vertices, and `tail` numbers more."""
    def sized(n: int) -> st.SearchStrategy[tuple[int, ...]]:
        size = 2 * n + tail
        return st.lists(word, min_size=size, max_size=size).map(lambda numbers: (n, *numbers))

    return st.integers(1, 10).flatmap(sized)


def motion_checks() -> st.SearchStrategy[tuple[float, ...]]:
    """motion_check in thousandths, such as eight words can carry: tens for lengths, any millionth for angles."""
    # On the wire lengths are hundredths: thousandths that end in 0 survive the truncation.
    length = word.map(lambda value: 10 * value)
    # On the wire angles are millionths: any word is one, and it is divided by 1000 for the argument.
    angle = word.map(lambda value: value // 1000 if value % 1000 == 0 else value / 1000)
    line = st.tuples(st.just(0), length, length, length, length)
    arc = st.tuples(st.just(1), length, length, angle, angle, length, length, length)
    return st.one_of(line, arc)


def tcp_agreements(wide: bool) -> st.SearchStrategy[WireState]:
    """Terms of a connection to an Nserver: any mask, any laser mode, any shape asked for last."""
    def agreed(mask: Mask, mode: int, width: int | None) -> WireState:
        wire_state = tcp_wire_state(MODELS["n200"])
        wire_state.set_mask(mask)
        wire_state.set_laser_mode(mode)
        # After get_sg or get_ls the readings have another number of words than the laser mode has.
        wire_state.laser_width = width or wire_state.laser_width
        wire_state.wide = wide
        return wire_state

    return st.builds(agreed, masks, laser_modes, st.sampled_from((None, 1, 2, 4)))


def line_agreements(model: Model) -> st.SearchStrategy[WireState]:
    """Terms of a line: any mask and laser mode on a N200, the only ones there are on the others."""
    if not model.sends_mask:
        return st.just(serial_wire_state(model))

    def agreed(mask: Mask, mode: int) -> WireState:
        wire_state = serial_wire_state(model)
        wire_state.set_mask(mask)
        wire_state.set_laser_mode(mode)
        return wire_state

    return st.builds(agreed, line_masks, laser_modes)


# Small counts often, and up to the 482 columns of the laser's camera now and then.
laser_counts = st.one_of(st.integers(0, 12), st.integers(0, 482))
seeds = st.integers(0, 2**32 - 1)


def tcp_reply_of(kind: str, seed: int, laser: tuple[int, int], values: int) -> Reply:
    """A reply full of random words: `laser` (n, words a reading), `values` plain numbers."""
    rng = Random(seed)
    count, width = laser
    return Reply(
        kind,
        slots={slot: _word(rng) for slot in range(45)},
        laser=(count, *(_word(rng) for _ in range(count * width))),
        stamps={key: _stamp(rng) for key in ALL_STAMPS},
        clock=rng.randrange(2**32),
        volts=(rng.randrange(256), rng.randrange(256)),
        values=tuple(_word(rng) for _ in range(values)),
    )


def line_reply_of(kind: str, seed: int, laser: tuple[int, int], values: int, signed_compass: bool) -> Reply:
    """A reply full of random numbers, each in the range that its field on the line has."""
    rng = Random(seed)
    count, width = laser
    # Each slot in the range of its field: 4 bits infrared, 8 bits sonar and motor status, sign-magnitude of 15 bits
    # pose and velocities, 3 bytes bumper.
    slots = {slot: rng.randrange(16) for slot in range(1, 17)}
    slots |= {slot: rng.randrange(256) for slot in (*range(17, 33), 41)}
    slots |= {slot: _signed(rng, 15) for slot in range(34, 41)}
    # The compass is signed in a state packet, and unsigned in the reply to get_cp.
    slots |= {33: rng.randrange(2**24), 43: _signed(rng, 15) if signed_compass else rng.randrange(65536)}
    readings = [rng.randrange(65536) if width == 1 else _signed(rng, 15) for _ in range(count * width)]
    return Reply(
        kind,
        slots=slots,
        laser=(count, *readings),
        stamps={key: _stamp(rng) for key in ALL_STAMPS},
        clock=rng.randrange(2**32),
        volts=(rng.randrange(256), rng.randrange(256)),
        values=tuple(rng.randrange(256) for _ in range(values)),
    )


def in_pieces(data: bytes, places: list[int]) -> list[bytes]:
    """The bytes cut at these places (modulo their number)."""
    marks = [0, *sorted(place % (len(data) + 1) for place in places), len(data)]
    return [data[start:end] for start, end in pairwise(marks)]


def _word(rng: Random) -> int:
    # Small numbers of both signs, as poses and velocities are, would be rare among random words.
    return rng.choice((rng.randrange(-(2**31), 2**31), rng.randrange(-300, 300)))


def _signed(rng: Random, bits: int) -> int:
    return rng.randrange(-(2**bits) + 1, 2**bits)


def _stamp(rng: Random) -> Stamp:
    return Stamp(*[_signed(rng, 31) for _ in range(7)], *[rng.randrange(2**32) for _ in range(2)])


FULL = EVERYTHING.with_position(31)
"""The mask of the longest replies: everything on, every stamp asked for."""
