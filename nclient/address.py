"""Addresses as text: scheme:[//host[:port]/]what?options, taken apart, with hints for what is wrong.

    nserver://lab:7019/1?timeout_s=2      scheme nserver, host lab, port 7019, path /1
    serial:///dev/ttyUSB0?model=n150      scheme serial, no host, path /dev/ttyUSB0
    sim:thesis_room?seed=1                scheme sim, rest as the one who answers reads it

Rules: text in, values out; nothing is opened here and no scheme is known. A reader of an option's text raises
ValueError with what it wants to see; `Address` adds which address and option that was.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple
from urllib.parse import SplitResult, parse_qsl, unquote_plus, urlsplit

from nclient.common.hints import did_you_mean
from nclient.errors import AddressError, NomadError

Reader = Callable[[str], Any]


class Address(NamedTuple):
    """A text with its scheme, and its options unread."""

    text: str
    scheme: str
    options: Mapping[str, str]

    def parts(self, form: str) -> SplitResult:
        """Host, port and path. Raises AddressError where they are not there as `form` shows them."""
        if not self.text.partition(":")[2].startswith("//"):
            raise AddressError(f"{self.text!r}: such an address is {form}")
        try:
            parts = urlsplit(self.text)
            _ = parts.port
        except ValueError as error:
            raise AddressError(f"{self.text!r}: {error}; an address is {form}") from None
        return parts

    def without(self, names: Iterable[str]) -> str:
        """The text without these options, and otherwise as it was: for one who reads the rest."""
        path, question, query = self.text.partition("?")
        left = [piece for piece in query.split("&") if unquote_plus(piece.partition("=")[0]) not in names]
        return path + question + "&".join(left) if any(left) or not query else path

    def read(self, readers: Mapping[str, Reader], *, others: bool = False) -> dict[str, Any]:
        """The values of the options given. Raises AddressError for one that is unknown (unless `others`) or unreadable.

        The errors name the option, what it wants to be, and the nearest known.
        """
        values = {}
        for name, given in self.options.items():
            if name in readers:
                values[name] = self._value(name, given, readers[name])
            elif not others:
                raise AddressError(f"{self.text!r}: no option {name!r}{did_you_mean(name, readers)} "
                                   f"There are {', '.join(readers)}.")
        return values

    def _value(self, name: str, given: str, reader: Reader) -> Any:
        try:
            return reader(given)
        except NomadError:
            raise
        except ValueError as error:
            raise AddressError(f"{self.text!r}: {name} is {error}, not {given!r}") from None


def parsed(text: str) -> Address:
    """The address that a text is, its scheme "" where there is none. Raises AddressError for an option said twice."""
    scheme, colon, rest = text.strip().partition(":")
    query = rest.partition("#")[0].partition("?")[2]
    options = parse_qsl(query, keep_blank_values=True)
    for name, times in Counter(name for name, _ in options).items():
        if times > 1:
            raise AddressError(f"{text.strip()!r}: {name} is given {times} times; expected once")
    return Address(text.strip(), scheme.lower() if colon else "", dict(options))


# readers of an option's text


def seconds(text: str) -> float:
    """A time above 0 in seconds."""
    return _number(text, "a number of seconds above 0", lambda value: value > 0)


def seconds_or_none(text: str) -> float:
    """A time in seconds, 0 for none."""
    return _number(text, "a number of seconds, 0 for none", lambda value: value >= 0)


def speed(text: str) -> float:
    """A speed above 0."""
    return _number(text, "a number above 0", lambda value: value > 0)


def count(text: str) -> int:
    """A whole number, 0 or more."""
    if not (text.isascii() and text.isdecimal()):
        raise ValueError("a whole number, 0 or more")
    return int(text)


def baud(text: str) -> int:
    """A speed of a serial port."""
    if not count(text):
        raise ValueError("a number of bits a second")
    return int(text)


def motion_timeout(text: str) -> int:
    """Seconds as conf_tm takes them; one of them is too few to say anything within."""
    if not (text.isascii() and text.isdecimal()) or int(text) not in (0, *range(2, 256)):
        raise ValueError("whole seconds, 2 to 255, or 0 for none")
    return int(text)


def flag(text: str) -> bool:
    """1 or 0."""
    if text not in ("1", "0"):
        raise ValueError("1 or 0")
    return text == "1"


def one_of(names: Iterable[str]) -> Reader:
    """One of these words."""
    known = tuple(names)

    def read(text: str) -> str:
        if text not in known:
            raise ValueError(f"one of {', '.join(known)}")
        return text

    return read


def path(text: str) -> str:
    """The name of a file."""
    if not text:
        raise ValueError("the name of a file")
    return text


def _number(text: str, wanted: str, fits: Callable[[float], bool]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and fits(value)):
        raise ValueError(wanted)
    return value
