"""Changes to an input: to its bytes, to the words of a text, to the tree of a JSON text. Pure: chance is an argument.

    bytes_changed     any input        words_changed     TOML, addresses, shell lines        tree_changed     JSON

Rules: what comes out is mostly still of its language, so that it gets past the first look and meets the checks behind.
Of a long run a good part is spent here: what a seed was taken apart into is remembered, and trees are shared, never
changed in place.
"""

from __future__ import annotations

import contextlib
import functools
import json
import re
from collections.abc import Callable, Sequence
from random import Random
from typing import Any, TypeVar

from fuzz.reader import Mutator

_T = TypeVar("_T")

NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"inf", b"-inf", b"1e400", b"-1e400", b"1e308", b"5e-324", b"1e-9", b"1e5", b"1e9",
    b"255", b"256", b"65535", b"65536", b"2147483647",
    b"2147483648", b"-2147483649", b"9223372036854775808", b"1" + b"0" * 400,
    b"7" * 5000, b"0x" + b"f" * 300, b"0x" + b"f" * 3600, b"1_000", b"0.1", b"1979-05-27T07:32:00Z",
)  # fmt: skip
TEXTS = (
    b'""', b"''", b'" "', rb'"\n\t"', b'"x"',
    b"true", b"false", b"[]", b"{}", b"[[]]", b"[" * 1500, b"]" * 1500, b"{a=" * 400,
    b'"\\ud800"', b'"\\u0000"', "٣".encode(), b"\xff", b"\xef\xbb\xbf", b"\x00",
    b'"' + b"a" * 300 + b'"', "ﬁ²½".encode(), b"\r",
    b"\\",
)  # fmt: skip
_TOKEN = re.compile(rb'"[^"\n]*"|\'[^\'\n]*\'|[\w.+-]+|\s+|.', re.DOTALL)
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 255, 2**31, -(2**31) - 1, 2**63, 10**400, 0.5, 1e308, -1e308, 5e-324,
    float("nan"), float("inf"), float("-inf"), "", " ", "\n\t", "\x85", "x",
    "\0", "\ud800", "nan", "1e400", "9" * 5000, [], {}, [[]], [0], [None],
    {"": 0}, {"ref": 0}, "a" * 300,
)  # fmt: skip
_EDITS = (1, 1, 1, 2, 4)
_NEST = 1200
_REMEMBERED = 512


def below(end: int, chance: Random) -> int:
    """A number from 0 to end - 1; three times as fast as randrange, and for these sizes as even."""
    return int(chance.random() * end)


def one_of(choices: Sequence[_T], chance: Random) -> _T:
    """One of these."""
    return choices[int(chance.random() * len(choices))]


def bytes_changed(data: bytes, chance: Random) -> bytes:
    """Bytes replaced, left out, put in, or said twice."""
    changed = bytearray(data)
    for _ in range(one_of(_EDITS, chance)):
        at = below(len(changed) + 1, chance)
        size = one_of((1, 1, 1, 2, 4, 16), chance)
        match below(5, chance):
            case 0:
                changed[at : at + size] = chance.randbytes(size)
            case 1:
                del changed[at : at + size]
            case 2:
                changed[at:at] = chance.randbytes(size)
            case 3:
                changed[at:at] = changed[at : at + 4 * size]
            case _:
                changed[at : at + 1] = one_of((b"\x00", b"\x01", b"\x5c", b"\x7f", b"\x80", b"\xff"), chance)
    return bytes(changed)


def words_changed(*words: bytes) -> Mutator:
    """A mutator of texts: their words replaced, moved, left out or said twice. `words`: those of the language."""

    def change(data: bytes, chance: Random) -> bytes:
        tokens = [*_tokens(data)]
        for _ in range(one_of(_EDITS, chance)):
            at = below(len(tokens) + 1, chance)
            match below(8, chance):
                case 0 | 1:
                    tokens[at : at + 1] = [one_of(NUMBERS, chance)]
                case 2:
                    tokens[at : at + 1] = [one_of(TEXTS, chance)]
                case 3 | 4 if words:
                    tokens[at : at + below(2, chance)] = [one_of(words, chance)]
                case 5:
                    del tokens[at : at + one_of((1, 1, 2, 8), chance)]
                case 6:
                    tokens[at:at] = tokens[at : at + one_of((1, 4, 16), chance)]
                case _:
                    other = below(len(tokens) + 1, chance)
                    tokens[at:at] = tokens[other : other + one_of((1, 3, 9), chance)]
        return b"".join(tokens)

    return change


def tree_changed(data: bytes, chance: Random) -> bytes:
    """A mutator of JSON, an object a line or one for all: values replaced, keys left out, branches said twice."""
    lines = data.split(b"\n")
    at = below(len(lines), chance)
    try:
        whole = _tree(lines[at])
        for _ in range(one_of(_EDITS, chance)):
            whole = _edited(whole, chance)
        lines[at] = b"[" * _NEST if below(40, chance) == 0 else _written(whole).encode()
    except (ValueError, RecursionError):  # no JSON, or nested so deeply that it is read and not written
        return bytes_changed(data, chance)
    if below(8, chance) == 0:
        lines.insert(at, one_of(lines, chance))
    return b"\n".join(lines)


def either(*mutators: Mutator) -> Mutator:
    """One of these, by chance."""
    return lambda data, chance: one_of(mutators, chance)(data, chance)


def behind(head: int, mutator: Mutator) -> Mutator:
    """A mutator of what follows the first so many bytes, which choose how the rest is read."""

    def change(data: bytes, chance: Random) -> bytes:
        first = data[:head]
        if below(4, chance) == 0:
            first = bytes(below(8, chance) for _ in range(head))
        return first + mutator(data[head:], chance)

    return change


@functools.lru_cache(_REMEMBERED)
def _tokens(data: bytes) -> tuple[bytes, ...]:
    return tuple(_TOKEN.findall(data))


@functools.lru_cache(_REMEMBERED)
def _tree(line: bytes) -> Any:
    return json.loads(line)


_written = json.JSONEncoder(separators=(",", ":"), check_circular=False).encode


def _edited(value: Any, chance: Random) -> Any:
    """A tree with one place of it changed, found by going down at random; all other branches are the same ones."""
    if not _branches(value) or below(12, chance) == 0:
        return _replaced(value, chance)
    holder = value.copy()
    key = one_of([*holder] if isinstance(holder, dict) else range(len(holder)), chance)
    if _branches(holder[key]) and below(6, chance):
        holder[key] = _edited(holder[key], chance)
        return holder
    match below(7, chance):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder[key:key] = holder[key : key + one_of((1, 4), chance)]
        case 1:
            holder[key] = holder[one_of([*holder], chance)]
        case _:
            holder[key] = _replaced(holder[key], chance)
    return holder


def _branches(value: Any) -> bool:
    return bool(value) and isinstance(value, list | dict)


def _replaced(value: Any, chance: Random) -> Any:
    """Another value; a number's mostly a near one."""
    match below(6, chance):
        case 0:
            return [value]
        case 1 | 2 if isinstance(value, int | float) and not isinstance(value, bool):
            with contextlib.suppress(OverflowError, ValueError):
                return one_of(_CHANGES, chance)(value)
    return one_of(_VALUES, chance)


_CHANGES: tuple[Callable[[Any], Any], ...] = (
    lambda value: -value, lambda value: value + 1, lambda value: value * 1e9, lambda value: value / 1e9, str,
)  # fmt: skip
