"""The pieces of a robot's own line, as construct classes. No message is declared here.

    low byte first; signed numbers are sign-magnitude (top bit = minus): -50 is 32 80

Rules: those of fields.py; numbers go in runs (runs.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from construct import Construct, FormatFieldError, Int8ub, Int16ul, Int32ul

from nclient.protocol.fields import Masked, check_laser, checked_readings, take, terms_of
from nclient.protocol.mask import Mask, Position
from nclient.protocol.runs import LONGS, SHORTS, SIGNED_LONGS, SIGNED_SHORTS, Run
from nclient.protocol.stamps import NO_STAMP, STAMP_KEYS, Stamp
from nclient.protocol.terms import Terms

LINE_BYTE = Int8ub
LINE_UNSIGNED = Int16ul
LINE_CLOCK = Int32ul


class Number(Construct):
    """One number of a run (runs.py)."""

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

    def absent(self, mask: Mask) -> bool:
        return self.masked and not any(map(mask.has, self.slots))

    def _selected(self, context: Any) -> Sequence[int]:
        """A mask seldom changes, so what the last one chose is kept."""
        if not self.masked:
            return self.slots
        mask, slots = terms_of(context).mask, self.slots
        chosen = self._chosen
        if chosen[0] is not mask:
            chosen = self._chosen = (mask, [slot for slot in slots if mask.has(slot)])
        return chosen[1]


class LineSlots(_MaskedSlots):
    """State slots on the robot's own line, numbers of a run; only those in the mask where `masked`."""

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
    """Infrared readings on the robot's own line: four bits each, low half first, padded with 0 to a byte."""

    def __init__(self, first: int, last: int, masked: bool = True) -> None:
        super().__init__(first, last, masked)

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        slots = self._selected(context)
        data = take(stream, (len(slots) + 1) // 2, path)
        return {slot: data[k // 2] >> 4 * (k % 2) & 15 for k, slot in enumerate(slots)}

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        values = [obj.get(slot, 0) & 15 for slot in self._selected(context)]
        values += [0] * (len(values) % 2)
        stream.write(bytes(low | high << 4 for low, high in zip(values[::2], values[1::2], strict=True)))
        return obj


class BumperBytes(_MaskedSlots):
    """The three bumper bytes on the robot's own line as one number, in the order of the model."""

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
    """Stamps on the robot's own line of one kind of sensor, if its bit is set in Smask[0].

    In a state packet only those in the mask have stamps (`slots`: their State slots); a get_ answer has them all.
    """

    def __init__(self, wanted: Position, slots: Sequence[int] = ()) -> None:
        super().__init__()
        self.keys = STAMP_KEYS[wanted]
        self.wanted = int(wanted)
        self.slots = slots

    def absent(self, mask: Mask) -> bool:
        return not self._selected(mask)

    def _selected(self, mask: Mask) -> list[str]:
        if not mask.position & self.wanted:
            return []
        if not self.slots:
            return list(self.keys)
        return [key for key, slot in zip(self.keys, self.slots, strict=True) if mask.has(slot)]

    def _parse(self, stream: Any, context: Any, path: str) -> dict[str, Stamp]:
        return {
            key: Stamp._make(
                SIGNED_LONGS.unpack(take(stream, 28, path)) + LONGS.unpack(take(stream, 8, path))
            )
            for key in self._selected(terms_of(context).mask)
        }

    def _build(self, obj: Mapping[str, Stamp], stream: Any, context: Any, path: str) -> Mapping[str, Stamp]:
        for key in self._selected(terms_of(context).mask):
            stamp = obj.get(key, NO_STAMP)
            stream.write(_packed(SIGNED_LONGS, stamp[:7], path) + _packed(LONGS, stamp[7:], path))
        return obj


class LineLaser(Masked):
    """A laser block on the robot's own line: count, then `width` signed numbers or one pixel a reading.

    `masked_by`: the State slot whose mask bit decides whether the block is there at all; None: always.
    """

    def __init__(self, width: Callable[[Terms], int], masked_by: int | None = None) -> None:
        super().__init__()
        self.width = width
        self.masked_by = masked_by

    def absent(self, mask: Mask) -> bool:
        return self.masked_by is not None and not mask.has(self.masked_by)

    def _parse(self, stream: Any, context: Any, path: str) -> tuple[int, ...] | None:
        terms = terms_of(context)
        if self.absent(terms.mask):
            return None
        count = checked_readings(SHORTS.unpack(take(stream, 2, path))[0], path)
        width = self.width(terms)
        run = SHORTS if width == 1 else SIGNED_SHORTS
        return (count, *run.unpack(take(stream, 2 * count * width, path)))

    def _build(self, obj: Sequence[int] | None, stream: Any, context: Any, path: str) -> Any:
        terms = terms_of(context)
        if self.absent(terms.mask):
            return obj
        laser = obj or (0,)
        width = self.width(terms)
        check_laser(laser, width, path)
        run = SHORTS if width == 1 else SIGNED_SHORTS
        stream.write(_packed(SHORTS, laser[:1], path) + _packed(run, laser[1:], path))
        return obj


class LineRun(Construct):
    """A fixed count of numbers on the robot's own line."""

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
    return "little" if terms_of(context).model.bumpers_low_first else "big"
