"""What can be done to a frame, each kind a value: its settings are its fields, and they check themselves.

    the whole frame   drop | delay | nak | silence | hang_up
    its bytes         corrupt | drop_byte | stray | cut | noise

Rules: values only, nothing happens here (injector.py). A setting out of its range is a FaultPlanError that names it.
`place` is an index into the frame, negative from its end (-2 is the checksum); left out, chance picks one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from nclient.errors import FaultPlanError

BIT, BYTE = "bit", "byte"
MOST_STRAY = 0xFFFF
"""The most stray bytes at once."""
LONGEST_S = 86_400.0
"""The longest delay or silence, seconds: a day."""


@dataclass(frozen=True, slots=True)
class Drop:
    """The frame does not arrive."""

    kind: ClassVar[str] = "drop"


@dataclass(frozen=True, slots=True)
class Delay:
    """The frame arrives `delay_s` later, evenly spread over that +- `jitter_s`, and what follows it no earlier."""

    delay_s: float
    jitter_s: float = 0.0
    kind: ClassVar[str] = "delay"

    def __post_init__(self) -> None:
        check_number("delay_s", self.delay_s, 0.0, LONGEST_S)
        check_number("jitter_s", self.jitter_s, 0.0, LONGEST_S)
        if self.jitter_s > self.delay_s:
            fail("jitter_s", f"at most delay_s, {self.delay_s:g}, since nothing arrives before it is sent",
                 self.jitter_s)


@dataclass(frozen=True, slots=True)
class Corrupt:
    """One byte becomes another: by one `change`d bit, or any byte but what it was."""

    change: str = BYTE
    place: int | None = None
    kind: ClassVar[str] = "corrupt"

    def __post_init__(self) -> None:
        check_choice("change", self.change, (BIT, BYTE))
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class DropByte:
    """One byte does not arrive."""

    place: int | None = None
    kind: ClassVar[str] = "drop_byte"

    def __post_init__(self) -> None:
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class Stray:
    """`count` bytes that nobody sent, at one place; before the first byte and behind the last are places, too."""

    count: int = 1
    place: int | None = None
    kind: ClassVar[str] = "stray"

    def __post_init__(self) -> None:
        check_whole("count", self.count, 1, MOST_STRAY)
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class Cut:
    """The first `keep` bytes arrive, at least one less than there are."""

    keep: int | None = None
    kind: ClassVar[str] = "cut"

    def __post_init__(self) -> None:
        if self.keep is not None:
            check_whole("keep", self.keep, 0)


@dataclass(frozen=True, slots=True)
class Nak:
    """A refusal instead: of a request, which then does not arrive, or in place of a reply.

    A NAK on a robot's own line, an ERROR reply over Nserver's protocol.
    """

    kind: ClassVar[str] = "nak"


@dataclass(frozen=True, slots=True)
class Silence:
    """From this frame on nothing arrives for `silence_s`, whatever the command, in the directions of the rule."""

    silence_s: float
    kind: ClassVar[str] = "silence"

    def __post_init__(self) -> None:
        check_number("silence_s", self.silence_s, 0.0, LONGEST_S)


@dataclass(frozen=True, slots=True)
class HangUp:
    """The connection ends, after `keep` bytes of the frame."""

    keep: int = 0
    kind: ClassVar[str] = "hang_up"

    def __post_init__(self) -> None:
        check_whole("keep", self.keep, 0)


@dataclass(frozen=True, slots=True)
class Noise:
    """Each byte for itself, in per cent of all: becomes another, does not arrive, or has a stray one behind it."""

    corrupt_percent: float = 0.0
    drop_percent: float = 0.0
    add_percent: float = 0.0
    change: str = BYTE
    kind: ClassVar[str] = "noise"

    def __post_init__(self) -> None:
        rates = {name: getattr(self, name) for name in ("corrupt_percent", "drop_percent", "add_percent")}
        for name, rate in rates.items():
            check_number(name, rate, 0.0, 100.0)
        check_choice("change", self.change, (BIT, BYTE))
        if not 0.0 < sum(rates.values()) <= 100.0:
            fail(" + ".join(rates), "together more than 0 and at most 100", sum(rates.values()))


Alteration = Corrupt | DropByte | Stray | Cut
"""What changes bytes of a frame by chance alone."""
Fault = Drop | Delay | Alteration | Nak | Silence | HangUp | Noise
KINDS: dict[str, type[Fault]] = {
    kind.kind: kind for kind in (Drop, Delay, Corrupt, DropByte, Stray, Cut, Nak, Silence, HangUp, Noise)
}
"""Every kind by the name that a plan calls it."""


def fail(key: str, wanted: str, found: object) -> None:
    """Raise FaultPlanError about one setting."""
    shown = f"{found:g}" if isinstance(found, float) else repr(found)
    raise FaultPlanError(f"{key}: {wanted}, not {shown}")


def check_whole(key: str, value: object, least: int, most: int | None = None) -> None:
    """Refuse what is no whole number from `least` to `most`."""
    wanted = f"a whole number, {least} or more" if most is None else f"a whole number, {least} to {most}"
    if not isinstance(value, int) or isinstance(value, bool) or value < least or (most is not None and value > most):
        fail(key, wanted, value)


def check_number(key: str, value: object, least: float, most: float) -> None:
    """Refuse what is no number from `least` to `most`."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        upper = f"{least:g} or more" if math.isinf(most) else f"{least:g} to {most:g}"
        fail(key, f"a number, {upper}", value)


def check_choice(key: str, value: object, choices: Iterable[str]) -> None:
    """Refuse what is none of these words."""
    choices = tuple(choices)
    if value not in choices:
        fail(key, f"one of {', '.join(choices)}", value)


def _check_place(place: object) -> None:
    if place is not None and (not isinstance(place, int) or isinstance(place, bool)):
        fail("place", "a whole number, the index of a byte, negative from the end", place)
