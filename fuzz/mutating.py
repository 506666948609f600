"""Changes to an input: to its bytes, to the words of a text, to the tree of a JSON text. Pure: chance is an argument.

    bytes_changed     any input        words_changed     TOML, addresses, shell lines        tree_changed     JSON

Rules: what comes out is mostly still of its language, so that it gets past the first look and meets the checks behind.
"""

from __future__ import annotations

import contextlib
import copy
import json
import re
from collections.abc import Callable
from random import Random
from typing import Any

from fuzz.reader import Mutator

NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"inf", b"-inf", b"1e400", b"-1e400", b"1e308", b"5e-324", b"1e-9", b"1e5", b"1e9",
    b"255", b"256", b"65535", b"65536", b"2147483647",
    b"2147483648", b"-2147483649", b"9223372036854775808", b"1" + b"0" * 400,
    b"7" * 5000, b"0x" + b"f" * 300, b"1_000", b"0.1", b"1979-05-27T07:32:00Z",
)  # fmt: skip
TEXTS = (
    b'""', b"''", b'"x"', b"true", b"false", b"[]", b"{}", b"[[]]", b"[" * 1500, b"]" * 1500, b"{a=" * 400,
    b'"\\ud800"', b'"\\u0000"', "٣".encode(), b"\xff", b"\xef\xbb\xbf", b"\x00",
    b'"' + b"a" * 300 + b'"', "ﬁ²½".encode(), b"\r",
    b"\\",
)  # fmt: skip
_TOKEN = re.compile(rb'"[^"\n]*"|\'[^\'\n]*\'|[\w.+-]+|\s+|.', re.DOTALL)
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 255, 2**31, -(2**31) - 1, 2**63, 10**400, 0.5, 1e308, -1e308, 5e-324,
    float("nan"), float("inf"), float("-inf"), "", "x",
    "\0", "\ud800", "nan", "1e400", "9" * 5000, [], {}, [[]], [0], [None],
    {"": 0}, {"ref": 0}, "a" * 300,
)  # fmt: skip
_EDITS = (1, 1, 1, 2, 4)
_NEST = 1200


def bytes_changed(data: bytes, chance: Random) -> bytes:
    """Bytes replaced, left out, put in, or said twice."""
    changed = bytearray(data)
    for _ in range(chance.choice(_EDITS)):
        at = chance.randint(0, len(changed))
        size = chance.choice((1, 1, 1, 2, 4, 16))
        match chance.randrange(5):
            case 0:
                changed[at : at + size] = chance.randbytes(size)
            case 1:
                del changed[at : at + size]
            case 2:
                changed[at:at] = chance.randbytes(size)
            case 3:
                changed[at:at] = changed[at : at + 4 * size]
            case _:
                changed[at : at + 1] = bytes((chance.choice((0, 1, 0x5C, 0x7F, 0x80, 0xFF)),))
    return bytes(changed)


def words_changed(*words: bytes) -> Mutator:
    """A mutator of texts: their words replaced, moved, left out or said twice. `words`: those of the language."""

    def change(data: bytes, chance: Random) -> bytes:
        tokens = _TOKEN.findall(data)
        for _ in range(chance.choice(_EDITS)):
            at = chance.randint(0, len(tokens))
            match chance.randrange(8):
                case 0 | 1:
                    tokens[at : at + 1] = [chance.choice(NUMBERS)]
                case 2:
                    tokens[at : at + 1] = [chance.choice(TEXTS)]
                case 3 | 4 if words:
                    tokens[at : at + chance.randrange(2)] = [chance.choice(words)]
                case 5:
                    del tokens[at : at + chance.choice((1, 1, 2, 8))]
                case 6:
                    tokens[at:at] = tokens[at : at + chance.choice((1, 4, 16))]
                case _:
                    other = chance.randint(0, len(tokens))
                    tokens[at:at] = tokens[other : other + chance.choice((1, 3, 9))]
        return b"".join(tokens)

    return change


def tree_changed(data: bytes, chance: Random) -> bytes:
    """A mutator of JSON, an object a line or one for all: values replaced, keys left out, branches said twice."""
    lines = data.split(b"\n")
    at = chance.randrange(len(lines))
    try:
        whole = json.loads(lines[at])
    except (ValueError, RecursionError):
        return bytes_changed(data, chance)
    box = [whole]
    for _ in range(chance.choice(_EDITS)):
        _edit(box, chance)
    if chance.randrange(40) == 0:
        lines[at] = b"[" * _NEST
    else:
        lines[at] = json.dumps(box[0] if box else None, separators=(",", ":")).encode()
    if chance.randrange(8) == 0:
        lines.insert(at, lines[chance.randrange(len(lines))])
    return b"\n".join(lines)


def either(*mutators: Mutator) -> Mutator:
    """One of these, by chance."""
    return lambda data, chance: chance.choice(mutators)(data, chance)


def behind(head: int, mutator: Mutator) -> Mutator:
    """A mutator of what follows the first so many bytes, which choose how the rest is read."""

    def change(data: bytes, chance: Random) -> bytes:
        first = data[:head]
        if chance.randrange(4) == 0:
            first = bytes(chance.randrange(8) for _ in range(head))
        return first + mutator(data[head:], chance)

    return change


def _edit(box: list[Any], chance: Random) -> None:
    """Change one place of a tree, found by going down at random."""
    holder: Any = box
    key: Any = 0
    while holder[key] and isinstance(holder[key], list | dict) and chance.randrange(6):
        holder = holder[key]
        key = chance.choice([*holder]) if isinstance(holder, dict) else chance.randrange(len(holder))
    value = holder[key]
    match chance.randrange(7):
        case 0 | 1 | 2:
            holder[key] = copy.deepcopy(chance.choice(_VALUES))
        case 3 if isinstance(value, int | float) and not isinstance(value, bool):
            with contextlib.suppress(OverflowError, ValueError):
                holder[key] = chance.choice(_CHANGES)(value)
        case 4 if holder is not box:
            del holder[key]
        case 5 if isinstance(holder, list) and holder is not box:
            holder[key:key] = copy.deepcopy(holder[key : key + chance.choice((1, 4))])
        case 6 if isinstance(holder, dict):
            holder[key] = copy.deepcopy(holder[chance.choice([*holder])])
        case _:
            holder[key] = [value]


_CHANGES: tuple[Callable[[Any], Any], ...] = (
    lambda value: -value, lambda value: value + 1, lambda value: value * 1e9, lambda value: value / 1e9, str,
)  # fmt: skip
