"""The pieces that requests and replies over TCP are made of, as construct classes. No message is declared here.

    everything is a big-endian signed 32-bit word; clocks are read as unsigned        on the line: line_fields.py

Rules: a piece parses to one of four things a Reply holds, State slots {number: value}, stamps {name: Stamp},
a laser vector (n, values...), or a plain value; pieces whose presence depends on the conversation read its
Terms from the context (`terms=` given to parse and build). Too few bytes is construct's StreamError.
"""

from __future__ import annotations

import struct
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any

from construct import Construct, FormatFieldError, Int32sb, Int32ub, StreamError

from nclient.protocol.mask import Mask, Position
from nclient.protocol.stamps import NO_STAMP, STAMP_KEYS, Stamp
from nclient.protocol.terms import Terms

WORD = Int32sb
UNSIGNED_WORD = Int32ub
STAMP_WORDS = struct.Struct(">7i2I")
MAX_LASER_READINGS = 482
"""Columns of the laser; no reply holds more readings."""


class Masked(Construct):
    """A piece that some masks leave out whole."""

    @abstractmethod
    def absent(self, mask: Mask) -> bool:
        """Whether nothing of it is there under this mask."""


class Words(Construct):
    """A run of signed words as a tuple of ints: `count` of them, or all there are where count is None."""

    def __init__(self, count: int | None) -> None:
        super().__init__()
        self.count = count

    def _parse(self, stream: Any, context: Any, path: str) -> tuple[int, ...]:
        if self.count is None:
            data = stream.read()
            count = len(data) // 4
            return struct.unpack(f">{count}i", _exactly(data, 4 * count, path))
        return struct.unpack(f">{self.count}i", take(stream, 4 * self.count, path))

    def _build(self, obj: Sequence[int], stream: Any, context: Any, path: str) -> Sequence[int]:
        if self.count is not None and len(obj) != self.count:
            raise FormatFieldError(f"{self.count} words wanted, {len(obj)} given", path=path)
        try:
            stream.write(struct.pack(f">{len(obj)}i", *obj))
        except struct.error:
            wrong = next(value for value in obj if not isinstance(value, int) or not -(2**31) <= value < 2**31)
            raise FormatFieldError(f"a word is a whole number, -2^31 to 2^31 - 1, not {wrong!r}", path=path) from None
        return obj

    def _sizeof(self, context: Any, path: str) -> int:
        if self.count is None:
            raise FormatFieldError("any number of words", path=path)
        return 4 * self.count


class WordSlots(Construct):
    """State[first] to State[last] over TCP, a word each. A slot that is not given is sent as 0."""

    def __init__(self, first: int, last: int) -> None:
        super().__init__()
        self.slots = range(first, last + 1)
        self.format = struct.Struct(f">{len(self.slots)}i")
        self.all_of = itemgetter(*self.slots, first)  # one slot more, so that a run of one is a tuple too

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        return dict(zip(self.slots, self.format.unpack(take(stream, self.format.size, path)), strict=True))

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        try:
            values = self.all_of(obj)[:-1]
        except KeyError:
            values = tuple(obj.get(slot, 0) for slot in self.slots)
        try:
            stream.write(self.format.pack(*values))
        except struct.error as error:
            raise FormatFieldError(f"State {dict(obj)}: {error}", path=path) from None
        return obj


class WordStamps(Construct):
    """Stamps over TCP, nine words each, of the sensors whose bit is set in Smask[0], mask or not."""

    def __init__(self, *wanted: Position) -> None:
        super().__init__()
        self.wanted = wanted or tuple(Position)

    def _keys(self, context: Any) -> Iterable[str]:
        position = terms_of(context).mask.position
        return [key for bit in self.wanted if position & bit for key in STAMP_KEYS[bit]] if position else ()

    def _parse(self, stream: Any, context: Any, path: str) -> dict[str, Stamp]:
        size = STAMP_WORDS.size
        return {k: Stamp._make(STAMP_WORDS.unpack(take(stream, size, path))) for k in self._keys(context)}

    def _build(self, obj: Mapping[str, Stamp], stream: Any, context: Any, path: str) -> Mapping[str, Stamp]:
        for key in self._keys(context):
            stream.write(_pack(">7i2I", obj.get(key, NO_STAMP), path))
        return obj


class WordLaser(Construct):
    """A laser block over TCP: n, then `width(terms)` words a reading. Nothing given is sent as n = 0."""

    def __init__(self, width: Callable[[Terms], int]) -> None:
        super().__init__()
        self.width = width

    def _parse(self, stream: Any, context: Any, path: str) -> tuple[int, ...]:
        (count,) = struct.unpack(">i", take(stream, 4, path))
        if not count:
            return (0,)
        words = checked_readings(count, path) * self.width(terms_of(context))
        return (count, *struct.unpack(f">{words}i", take(stream, 4 * words, path)))

    def _build(self, obj: Sequence[int] | None, stream: Any, context: Any, path: str) -> Any:
        laser = obj or (0,)
        check_laser(laser, self.width(terms_of(context)), path)
        stream.write(_pack(f">{len(laser)}i", laser, path))
        return obj


def terms_of(context: Any) -> Terms:
    """What the conversation has agreed."""
    terms: Terms = context._params.terms
    return terms


def take(stream: Any, count: int, path: str) -> bytes:
    """So many bytes; StreamError where they are not there."""
    data: bytes = stream.read(count)
    return data if len(data) == count else _exactly(data, count, path)


def _exactly(data: bytes, count: int, path: str) -> bytes:
    if len(data) != count:
        raise StreamError(f"{count} bytes wanted, {len(data)} there", path=path)
    return data


def _pack(layout: str, values: Iterable[int], path: str) -> bytes:
    try:
        return struct.pack(layout, *values)
    except struct.error as error:
        raise FormatFieldError(str(error), path=path) from None


def checked_readings(count: int, path: str) -> int:
    """A count of laser readings that can be."""
    if not 0 <= count <= MAX_LASER_READINGS:
        raise StreamError(f"a laser sends 0..{MAX_LASER_READINGS} readings, not {count}", path=path)
    return count


def check_laser(laser: Sequence[int], width: int, path: str) -> None:
    """Refuse a laser vector whose count does not say how long it is."""
    if len(laser) != 1 + width * checked_readings(laser[0], path):
        raise FormatFieldError(
            f"a laser vector of {laser[0]} readings has {width * laser[0]} numbers after the count, "
            f"not {len(laser) - 1}", path=path)
