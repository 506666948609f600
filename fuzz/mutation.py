"""Mutations of an input: of its bytes, of the words of a text, of a JSON tree. Randomness is an argument.

    mutate_bytes     any input        word_mutator     TOML, addresses, shell lines        mutate_json     JSON

The result is mostly still valid syntax, so that it reaches the checks behind the parser. Long runs spend much of their
time here: tokens and trees of recent inputs are cached, and trees share their unchanged branches.
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

# Numbers at the limits of integers and floats, of their text form, and of common checks.
NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"inf", b"-inf", b"1e400", b"-1e400", b"1e308", b"5e-324", b"1e-9", b"1e5", b"1e9",
    b"255", b"256", b"65535", b"65536", b"2147483647",
    b"2147483648", b"-2147483649", b"9223372036854775808", b"1" + b"0" * 400,
    b"7" * 5000, b"0x" + b"f" * 300, b"0x" + b"f" * 3600, b"1_000", b"0.1", b"1979-05-27T07:32:00Z",
)  # fmt: skip
# Texts that parsers and formatters handle differently: empty, nested, not ASCII, unpaired surrogates.
TEXTS = (
    b'""', b"''", b'" "', rb'"\n\t"', b'"x"',
    b"true", b"false", b"[]", b"{}", b"[[]]", b"[" * 1500, b"]" * 1500, b"{a=" * 400,
    b'"\\ud800"', b'"\\u0000"', "٣".encode(), b"\xff", b"\xef\xbb\xbf", b"\x00",
    b'"' + b"a" * 300 + b'"', "ﬁ²½".encode(), b"\r",
    b"\\",
)  # fmt: skip
# Quoted texts, words and numbers, blanks, single characters.
_TOKEN = re.compile(rb'"[^"\n]*"|\'[^\'\n]*\'|[\w.+-]+|\s+|.', re.DOTALL)
# The same limits as JSON values.
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 255, 2**31, -(2**31) - 1, 2**63, 10**400, 0.5, 1e308, -1e308, 5e-324,
    float("nan"), float("inf"), float("-inf"), "", " ", "\n\t", "\x85", "x",
    "\0", "\ud800", "nan", "1e400", "9" * 5000, [], {}, [[]], [0], [None],
    {"": 0}, {"ref": 0}, "a" * 300,
)  # fmt: skip
_EDITS = (1, 1, 1, 2, 4)
_DEPTH = 1200
_CACHE_SIZE = 512


def random_below(end: int, rng: Random) -> int:
    """Return a number from 0 to end - 1; three times as fast as randrange, and uniform enough for small ranges."""
    return int(rng.random() * end)


def choose(choices: Sequence[_T], rng: Random) -> _T:
    """Return a random element."""
    return choices[int(rng.random() * len(choices))]


def mutate_bytes(data: bytes, rng: Random) -> bytes:
    """Replace, delete, insert or repeat bytes."""
    result = bytearray(data)
    for _ in range(choose(_EDITS, rng)):
        at = random_below(len(result) + 1, rng)
        size = choose((1, 1, 1, 2, 4, 16), rng)
        match random_below(5, rng):
            case 0:
                result[at : at + size] = rng.randbytes(size)
            case 1:
                del result[at : at + size]
            case 2:
                result[at:at] = rng.randbytes(size)
            case 3:
                result[at:at] = result[at : at + 4 * size]
            case _:
                result[at : at + 1] = choose((b"\x00", b"\x01", b"\x5c", b"\x7f", b"\x80", b"\xff"), rng)
    return bytes(result)


def word_mutator(*words: bytes) -> Mutator:
    """Return a mutator that replaces, inserts, deletes or repeats words of a text; `words` are its keywords."""

    def change(data: bytes, rng: Random) -> bytes:
        tokens = [*_tokens(data)]
        for _ in range(choose(_EDITS, rng)):
            at = random_below(len(tokens) + 1, rng)
            match random_below(8, rng):
                case 0 | 1:
                    tokens[at : at + 1] = [choose(NUMBERS, rng)]
                case 2:
                    tokens[at : at + 1] = [choose(TEXTS, rng)]
                case 3 | 4 if words:
                    tokens[at : at + random_below(2, rng)] = [choose(words, rng)]
                case 5:
                    del tokens[at : at + choose((1, 1, 2, 8), rng)]
                case 6:
                    tokens[at:at] = tokens[at : at + choose((1, 4, 16), rng)]
                case _:
                    other = random_below(len(tokens) + 1, rng)
                    tokens[at:at] = tokens[other : other + choose((1, 3, 9), rng)]
        return b"".join(tokens)

    return change


def mutate_json(data: bytes, rng: Random) -> bytes:
    """Replace values, delete keys or repeat branches of JSON, on one line of several or of the whole text."""
    lines = data.split(b"\n")
    at = random_below(len(lines), rng)
    try:
        tree = _parse(lines[at])
        for _ in range(choose(_EDITS, rng)):
            tree = _edit(tree, rng)
        lines[at] = b"[" * _DEPTH if random_below(40, rng) == 0 else _encode(tree).encode()
    except (ValueError, RecursionError):  # not JSON, or nested too deeply to be written
        return mutate_bytes(data, rng)
    if random_below(8, rng) == 0:
        lines.insert(at, choose(lines, rng))
    return b"\n".join(lines)


def any_of(*mutators: Mutator) -> Mutator:
    """Return a mutator that applies a random one of these."""
    return lambda data, rng: choose(mutators, rng)(data, rng)


def after_header(head: int, mutator: Mutator) -> Mutator:
    """Return a mutator of the bytes after a header, whose bytes select how the rest is read."""

    def change(data: bytes, rng: Random) -> bytes:
        first = data[:head]
        if random_below(4, rng) == 0:
            first = bytes(random_below(8, rng) for _ in range(head))
        return first + mutator(data[head:], rng)

    return change


@functools.lru_cache(_CACHE_SIZE)
def _tokens(data: bytes) -> tuple[bytes, ...]:
    return tuple(_TOKEN.findall(data))


@functools.lru_cache(_CACHE_SIZE)
def _parse(line: bytes) -> Any:
    return json.loads(line)


_encode = json.JSONEncoder(separators=(",", ":"), check_circular=False).encode


def _edit(value: Any, rng: Random) -> Any:
    """Return a tree with one random change; the other branches are shared with the original."""
    if not _has_children(value) or random_below(12, rng) == 0:
        return _replacement(value, rng)
    # Copy only the nodes on the path to the change.
    parent = value.copy()
    key = choose([*parent] if isinstance(parent, dict) else range(len(parent)), rng)
    if _has_children(parent[key]) and random_below(6, rng):
        parent[key] = _edit(parent[key], rng)
        return parent
    match random_below(7, rng):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, list):
            parent[key:key] = parent[key : key + choose((1, 4), rng)]
        case 1:
            parent[key] = parent[choose([*parent], rng)]
        case _:
            parent[key] = _replacement(parent[key], rng)
    return parent


def _has_children(value: Any) -> bool:
    return bool(value) and isinstance(value, list | dict)


def _replacement(value: Any, rng: Random) -> Any:
    """Return another value; for a number mostly a similar one."""
    match random_below(6, rng):
        case 0:
            return [value]
        case 1 | 2 if isinstance(value, int | float) and not isinstance(value, bool):
            with contextlib.suppress(OverflowError, ValueError):
                return choose(_ARITHMETIC, rng)(value)
    return choose(_VALUES, rng)


_ARITHMETIC: tuple[Callable[[Any], Any], ...] = (
    lambda value: -value, lambda value: value + 1, lambda value: value * 1e9, lambda value: value / 1e9, str,
)  # fmt: skip
