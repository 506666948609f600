"""Construct classes that messages on the serial line are made of (over TCP there are only words: codec.py).

    low byte first; signed numbers are sign-magnitude (top bit = minus): -50 is 32 80, -0 reads as 0

A class parses to one part of a Reply: State slots {number: value}, stamps {name: Stamp}, a laser vector (n, values...),
or plain values. Classes that depend on mask or model read them from the WireState in the context
(`wire_state=` of parse and build). Missing bytes raise construct's StreamError.

Numbers are packed as runs (class Run): one call of struct per run instead of one per number makes state packets ten
times as fast.
"""

import struct
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Literal

from construct import Construct, FormatFieldError, Int8ub, Int16ul, Int32ul, StreamError

from nclient.protocol.types import NO_STAMP, STAMP_KEYS, Mask, Position, Stamp
from nclient.protocol.wire_state import WireState

MAX_LASER_READINGS = 482
"""Number of columns of the laser, and so the maximum number of readings in a reply."""


class Masked(Construct):
    """A field that some masks exclude completely."""

    @abstractmethod
    def is_absent(self, mask: Mask) -> bool:
        """Return True if the mask excludes all of it."""


def wire_state_of(context: Any) -> WireState:
    """Return the WireState of a construct context."""
    wire_state: WireState = context._params.wire_state
    return wire_state


def take(stream: Any, count: int, path: str) -> bytes:
    """Read `count` bytes; StreamError if there are fewer."""
    data: bytes = stream.read(count)
    return data if len(data) == count else _exactly(data, count, path)


def _exactly(data: bytes, count: int, path: str) -> bytes:
    if len(data) != count:
        raise StreamError(f"{count} bytes wanted, {len(data)} there", path=path)
    return data


def checked_readings(count: int, path: str) -> int:
    """Return a count of laser readings; StreamError if it is out of range."""
    if not 0 <= count <= MAX_LASER_READINGS:
        raise StreamError(f"a laser sends 0..{MAX_LASER_READINGS} readings, not {count}", path=path)
    return count


def check_laser(laser: Sequence[int], width: int, path: str) -> None:
    """Raise FormatFieldError if a laser vector's length does not match its count."""
    if len(laser) != 1 + width * checked_readings(laser[0], path):
        raise FormatFieldError(
            f"a laser vector of {laser[0]} readings has {width * laser[0]} numbers after the count, "
            f"not {len(laser) - 1}", path=path)


class Run:
    """Packing of consecutive numbers of the same size, low byte first.

    Parameters
    ----------
    code
        Format character of struct.
    signed
        True for sign-magnitude numbers.
    """

    def __init__(self, code: str, signed: bool = False) -> None:
        self.octets: Final = struct.calcsize(f"<{code}")
        # The top bit is the sign; 0 switches sign-magnitude off.
        self.sign: Final = 1 << (8 * self.octets - 1) if signed else 0
        self._code: Final = code

    def pack(self, numbers: Sequence[int]) -> bytes:
        """Return the bytes of these numbers. Raises ValueError if one does not fit."""
        if self.sign:
            numbers = [number if 0 <= number < self.sign else self._magnitude(number) for number in numbers]
        try:
            return struct.pack(f"<{len(numbers)}{self._code}", *numbers)
        except struct.error as error:
            raise ValueError(f"{list(numbers)} in {self.octets} bytes each: {error}") from None

    def unpack(self, data: bytes) -> tuple[int, ...]:
        """Return the numbers in these bytes, whose length must be a multiple of the size."""
        numbers = struct.unpack(f"<{len(data) // self.octets}{self._code}", data)
        if not self.sign:
            return numbers
        # Top bit set: the rest is the magnitude. 0x8000 is -0 and reads as 0.
        return tuple(number if number < self.sign else self.sign - number for number in numbers)

    def _magnitude(self, number: int) -> int:
        # The magnitude has one bit less than the field.
        if abs(number) >= self.sign:
            raise ValueError(f"{number} does not fit sign-magnitude below {self.sign}")
        return self.sign - number


BYTES: Final = Run("B")
SHORTS: Final = Run("H")
LONGS: Final = Run("I")
SIGNED_SHORTS: Final = Run("H", signed=True)
SIGNED_LONGS: Final = Run("I", signed=True)


# Single fields of the serial line, low byte first; clocks are unsigned ms.
LINE_BYTE = Int8ub
LINE_UNSIGNED = Int16ul
LINE_CLOCK = Int32ul


class Number(Construct):
    """A single number, packed as a run of one."""

    def __init__(self, run: Run) -> None:
        super().__init__()
        self.run = run

    def _parse(self, stream: Any, context: Any, path: str) -> int:
        return self.run.unpack(take(stream, self.run.octets, path))[0]

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        stream.write(_packed(self.run, (obj,), path))
        return obj

    def _sizeof(self, context: Any, path: str) -> int:
        return self.run.octets


LINE_SIGNED = Number(SIGNED_SHORTS)
LINE_LONG = Number(SIGNED_LONGS)


class _MaskedSlots(Masked):
    """State slots on the robot's own line; only those in the mask where `masked`."""

    def __init__(self, first: int, last: int, masked: bool) -> None:
        super().__init__()
        self.slots: Sequence[int] = range(first, last + 1)
        self.masked = masked
        self._chosen: tuple[Mask | None, Sequence[int]] = (None, ())

    def is_absent(self, mask: Mask) -> bool:
        return self.masked and not any(map(mask.has, self.slots))

    def _selected(self, context: Any) -> Sequence[int]:
        """Return the selected slots, cached for the last mask since masks rarely change."""
        if not self.masked:
            return self.slots
        # Compared by identity: a changed mask is a new object.
        mask, slots = wire_state_of(context).mask, self.slots
        chosen = self._chosen
        if chosen[0] is not mask:
            chosen = self._chosen = (mask, [slot for slot in slots if mask.has(slot)])
        return chosen[1]


class LineSlots(_MaskedSlots):
    """State slots on the serial line as a run of numbers; with `masked` only those that the mask selects."""

    def __init__(self, first: int, last: int, run: Run, masked: bool = True) -> None:
        super().__init__(first, last, masked)
        self.run = run

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        slots = self._selected(context)
        return dict(zip(slots, self.run.unpack(take(stream, self.run.octets * len(slots), path)), strict=True))

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        stream.write(_packed(self.run, [obj.get(slot, 0) for slot in self._selected(context)], path))
        return obj


class LineNibbles(_MaskedSlots):
    """Infrared readings on the serial line: four bits each, low half first, padded with 0 to a byte."""

    def __init__(self, first: int, last: int, masked: bool = True) -> None:
        super().__init__(first, last, masked)

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        slots = self._selected(context)
        # Two readings per byte, the first in the low half.
        data = take(stream, (len(slots) + 1) // 2, path)
        return {slot: data[k // 2] >> 4 * (k % 2) & 15 for k, slot in enumerate(slots)}

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        values = [obj.get(slot, 0) & 15 for slot in self._selected(context)]
        values += [0] * (len(values) % 2)
        stream.write(bytes(low | high << 4 for low, high in zip(values[::2], values[1::2], strict=True)))
        return obj


class BumperBytes(_MaskedSlots):
    """Three bumper bytes on the serial line as one number, in the model's byte order."""

    def __init__(self, slot: int, masked: bool = True) -> None:
        super().__init__(slot, slot, masked)

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        order = _bumper_order(context)
        return {slot: int.from_bytes(take(stream, 3, path), order) for slot in self._selected(context)}

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        for slot in self._selected(context):
            stream.write((obj.get(slot, 0) & 0xFFFFFF).to_bytes(3, _bumper_order(context)))
        return obj


class LineStamps(Masked):
    """Stamps on the serial line of one kind of sensor, if its bit is set in Smask[0]: 7 int32 and 2 uint32 each.

    In a state packet only the sensors that the mask selects have stamps (`slots`: their State slots); the reply to a
    get_ command has all of them.
    """

    def __init__(self, wanted: Position, slots: Sequence[int] = ()) -> None:
        super().__init__()
        self.keys = STAMP_KEYS[wanted]
        self.wanted = int(wanted)
        self.slots = slots

    def is_absent(self, mask: Mask) -> bool:
        """Return True if the mask selects no stamped sensor."""
        return not self._selected(mask)

    def _selected(self, mask: Mask) -> list[str]:
        # Two conditions: the kind has stamps, and the sensor is in the mask.
        if not mask.position & self.wanted:
            return []
        if not self.slots:
            return list(self.keys)
        return [key for key, slot in zip(self.keys, self.slots, strict=True) if mask.has(slot)]

    def _parse(self, stream: Any, context: Any, path: str) -> dict[str, Stamp]:
        return {
            key: Stamp._make(
                # 7 x 4 bytes of pose and velocities, 2 x 4 bytes of times in ms.
                SIGNED_LONGS.unpack(take(stream, 28, path)) + LONGS.unpack(take(stream, 8, path))
            )
            for key in self._selected(wire_state_of(context).mask)
        }

    def _build(self, obj: Mapping[str, Stamp], stream: Any, context: Any, path: str) -> Mapping[str, Stamp]:
        for key in self._selected(wire_state_of(context).mask):
            stamp = obj.get(key, NO_STAMP)
            stream.write(_packed(SIGNED_LONGS, stamp[:7], path) + _packed(LONGS, stamp[7:], path))
        return obj


class LineLaser(Masked):
    """Laser block on the serial line: count, then `width` signed numbers or one pixel per reading.

    `masked_by` is the State slot whose mask bit includes the block; None: always included.
    """

    def __init__(self, width: Callable[[WireState], int], masked_by: int | None = None) -> None:
        super().__init__()
        self.width = width
        self.masked_by = masked_by

    def is_absent(self, mask: Mask) -> bool:
        """Return True if the field is masked and the mask switches it off."""
        return self.masked_by is not None and not mask.has(self.masked_by)

    def _parse(self, stream: Any, context: Any, path: str) -> tuple[int, ...] | None:
        wire_state = wire_state_of(context)
        if self.is_absent(wire_state.mask):
            return None
        count = checked_readings(SHORTS.unpack(take(stream, 2, path))[0], path)
        width = self.width(wire_state)
        run = SHORTS if width == 1 else SIGNED_SHORTS
        return (count, *run.unpack(take(stream, 2 * count * width, path)))

    def _build(self, obj: Sequence[int] | None, stream: Any, context: Any, path: str) -> Any:
        wire_state = wire_state_of(context)
        if self.is_absent(wire_state.mask):
            return obj
        laser = obj or (0,)
        width = self.width(wire_state)
        check_laser(laser, width, path)
        run = SHORTS if width == 1 else SIGNED_SHORTS
        stream.write(_packed(SHORTS, laser[:1], path) + _packed(run, laser[1:], path))
        return obj


class LineRun(Construct):
    """A fixed number of numbers on the serial line."""

    def __init__(self, count: int, run: Run) -> None:
        super().__init__()
        self.count = count
        self.run = run

    def _parse(self, stream: Any, context: Any, path: str) -> tuple[int, ...]:
        return self.run.unpack(take(stream, self.count * self.run.octets, path))

    def _build(self, obj: Sequence[int], stream: Any, context: Any, path: str) -> Sequence[int]:
        if len(obj) != self.count:
            raise FormatFieldError(f"{self.count} numbers wanted, {len(obj)} given", path=path)
        stream.write(_packed(self.run, obj, path))
        return obj


def _packed(run: Run, numbers: Sequence[int], path: str) -> bytes:
    try:
        return run.pack(numbers)
    except (ValueError, TypeError) as error:
        raise FormatFieldError(str(error), path=path) from None


def _bumper_order(context: Any) -> Literal["little", "big"]:
    return "little" if wire_state_of(context).model.bumpers_low_first else "big"
