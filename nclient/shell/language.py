"""The language of the shell: a line of text to orders, as one types them or as C has them.

    pr 240 0 0                    words, or commas, or the whole call of C: pr(240, 0, 0); ws(1, 1, 1, 20);
    conf_sn 15 {0, 2, 15}         a list for a C array, in braces or brackets
    tk "good morning"             a text, in quotes where it is more than words
    Smask[17] = 0                 a number of the mask that ct sends next; State[34] and Laser[0] are shown
    help pr   # a comment         words of the shell's own (own_words.py)

Rules: text in, orders out; nothing is known here of commands or robots. A line that cannot be read is a ShellError.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from nclient.errors import ShellError

ARRAYS = ("State", "Smask", "Laser")
"""The C library's arrays, by which numbers are looked at and the mask is set."""
Value = int | float | str | tuple[int | float, ...]

_TOKEN = re.compile(
    r"""\s*(?:(?P<comment>\#.*)
    |"(?P<double>(?:[^"\\]|\\.)*)"|'(?P<single>[^']*)'
    |(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.]))
    |(?P<word>[^\s,;(){}\[\]="'\#]+)
    |(?P<mark>[,;(){}\[\]=]))""",
    re.VERBOSE,
)
_MOST_DIGITS = 9
_OPENS = {"(": ")", "{": "}", "[": "]"}


class Order(NamedTuple):
    """A command and its values, as they were written: whole numbers, others, texts, lists."""

    name: str
    values: tuple[Value, ...] = ()


class Element(NamedTuple):
    """Smask[17] = 0, State[34]: an element of one of the arrays, or all of it; what to set it to, if anything."""

    array: str
    place: int | None = None
    value: int | None = None


class _Token(NamedTuple):
    kind: str
    text: str


def parse(text: str) -> tuple[Order | Element, ...]:
    """The orders of a line; none for an empty one or a comment. Raises ShellError, saying what is wrong where."""
    return tuple(_order(tokens) for tokens in _statements(tuple(_tokens(text))))


def _tokens(text: str) -> Iterator[_Token]:
    place, text = 0, text.rstrip()
    while place < len(text):
        found = _TOKEN.match(text, place)
        if found is None:
            raise ShellError(f"a quote that does not end: {text[place:].strip()}")
        place, kind = found.end(), found.lastgroup or ""
        said = found[kind]
        if kind == "double":
            said = re.sub(r"\\(.)", r"\1", said)
        if kind != "comment":
            yield _Token("text" if kind in ("double", "single") else kind, said)


def _statements(tokens: tuple[_Token, ...]) -> Iterator[list[_Token]]:
    statement: list[_Token] = []
    for token in tokens:
        if token == ("mark", ";"):
            if statement:
                yield statement
            statement = []
        else:
            statement.append(token)
    if statement:
        yield statement


def _order(tokens: list[_Token]) -> Order | Element:
    head, rest = tokens[0], tokens[1:]
    if head.kind != "word":
        raise ShellError(f"a line begins with a command, not with {head.text!r}; help lists them")
    if head.text in ARRAYS:
        return _element(head.text, rest)
    if rest and rest[0] == ("mark", "("):
        if rest[-1] != ("mark", ")") or ("mark", "(") in rest[1:]:
            raise ShellError(f"{head.text}: a call is {head.text}(1, 2, 3), one pair of parentheses")
        rest = rest[1:-1]
    return Order(head.text, tuple(_values(head.text, rest)))


def _values(name: str, tokens: list[_Token]) -> Iterator[Value]:
    """Numbers, texts and lists; commas stand between, if at all."""
    waiting: list[int | float] | None = None
    closing = ""
    for token in tokens:
        if token.kind == "mark":
            if waiting is None and token.text in "{[":
                waiting, closing = [], _OPENS[token.text]
            elif waiting is not None and token.text == closing:
                yield tuple(waiting)
                waiting = None
            elif token.text != ",":
                raise ShellError(f"{name}: {token.text!r} does not belong there")
        elif waiting is None:
            yield _number(token.text) if token.kind == "number" else token.text
        elif token.kind == "number":
            waiting.append(_number(token.text))
        else:
            raise ShellError(f"{name}: a list holds numbers, not {token.text!r}")
    if waiting is not None:
        raise ShellError(f"{name}: the list does not end; {closing} is missing")


def _element(array: str, tokens: list[_Token]) -> Element:
    match [(token.kind, token.text) for token in tokens]:
        case []:
            return Element(array)
        case [("mark", "["), ("number", index), ("mark", "]"), *rest] if _is_place(index):
            match rest:
                case []:
                    return Element(array, int(index))
                case [("mark", "="), ("number", value)] if array == "Smask" and _is_place(value):
                    return Element(array, int(index), int(value))
    example = "Smask[17] = 0" if array == "Smask" else f"{array} or {array}[0]"
    raise ShellError(f"{array}: it is written {example}")


def _is_place(text: str) -> bool:
    return text.isdecimal() and len(text) <= _MOST_DIGITS


def _number(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:
        return float(text)
