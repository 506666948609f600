"""From an order as it was written to the Call that goes out: the table's numbers, each looked at before anything moves.

Rules: pure. Whatever is wrong with an order is a ShellError or a WireError here, so that a script can be looked
through before its first line is done.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from nclient.errors import ShellError, WireError
from nclient.protocol import language
from nclient.protocol.bounds import beyond_line
from nclient.protocol.commands import BY_NAME, Call, Command
from nclient.protocol.mask import SLOTS, Mask
from nclient.protocol.terms import Terms
from nclient.shell.language import ARRAYS, Order, Value
from nclient.shell.own_words import OWN
from nclient.shell.reference import Parameter, available, parameters, usage

_END = 255
"""What ends a firing order."""
_THOUSANDTHS = 1000
_FARTHEST = 2**63
"""More than any command takes, and less than where floats end."""


def call_of(order: Order, terms: Terms, smask: Sequence[int], pid: int) -> Call:
    """The call that an order is, where these terms hold; `smask`: what ct sends, `pid`: who connects.

    Raises ShellError for a command that there is not, or arguments that it does not take; WireError for numbers that
    cannot be sent.
    """
    row = _row(order.name, terms)
    call = Call(row.name, _arguments(row, order.values, smask, pid))
    if not terms.line:
        language.tcp_request(call)
    elif beyond := beyond_line(call):
        raise WireError(beyond)
    return call


def no_command(name: str, beside: Iterable[str] = ()) -> str:
    """That there is no such command, and which was probably meant; `beside`: what else may have been."""
    return f"{language.no_command(name, (*OWN, *beside))}; help lists them all"


def _row(name: str, terms: Terms) -> Command:
    row = BY_NAME.get(name)
    if row is None:
        raise ShellError(no_command(name, ARRAYS))
    if not available(row, terms):
        there = f"on the own line of a {terms.model.name}" if terms.line else "over TCP"
        raise ShellError(f"there is no {name} {there}; help {name} says where there is")
    return row


def _arguments(row: Command, values: tuple[Value, ...], smask: Sequence[int], pid: int) -> tuple[Any, ...]:
    if row.name == "tk":
        return (" ".join(str(value) for value in values),)
    if row.name == "ct":
        return _mask(values, smask)
    numbers = _numbers(row, values)
    if row.name == "motion_check":
        return (*numbers[:1], *(_THOUSANDTHS * number for number in numbers[1:]))
    if any(number != int(number) for number in numbers):
        raise ShellError(f"{row.name}: whole numbers are wanted (tenths, as in C), not {_shown(values)}")
    whole = tuple(map(int, numbers))
    return (*whole, pid) if row.beside is not None and row.beside[0] == "pid" else whole


def _mask(values: tuple[Value, ...], smask: Sequence[int]) -> tuple[int, ...]:
    given = _laid_open("ct", values)
    if given and len(given) != SLOTS:
        raise ShellError(f"ct: a mask has {SLOTS} numbers, not {len(given)}; ct alone sends Smask")
    return Mask(tuple(map(int, given)) if given else tuple(smask)).smask


def _numbers(row: Command, values: tuple[Value, ...]) -> tuple[int | float, ...]:
    """The numbers laid open, a firing order filled up; as many as the C call takes."""
    wanted = parameters(row)
    numbers = _laid_open(row.name, values)
    if row.any_length:
        return numbers
    least, most = _counts(wanted)
    if not least <= len(numbers) <= most or not _lists_fit(wanted, values):
        count = f"{most} numbers" if least == most else f"{least} to {most} numbers"
        raise ShellError(f"{row.name} takes {count if most else 'nothing'}, not {len(numbers)}: {usage(row)}")
    return (*numbers, *[_END] * (most - len(numbers)))


def _counts(wanted: tuple[Parameter, ...]) -> tuple[int, int]:
    single = sum(parameter.length == 1 for parameter in wanted)
    return single + (single < len(wanted)), sum(parameter.length for parameter in wanted)


def _lists_fit(wanted: tuple[Parameter, ...], values: tuple[Value, ...]) -> bool:
    """Whether lists stand only where C has an array."""
    return all(
        not isinstance(value, tuple) or (place < len(wanted) and wanted[place].length > 1)
        for place, value in enumerate(values)
    )


def _laid_open(name: str, values: tuple[Value, ...]) -> tuple[int | float, ...]:
    numbers: list[int | float] = []
    for value in values:
        if isinstance(value, str):
            raise ShellError(f"{name}: a number is wanted, not {value!r}")
        numbers.extend(value if isinstance(value, tuple) else (value,))
    if not all(abs(number) <= _FARTHEST for number in numbers):
        raise ShellError(f"{name}: finite numbers are wanted, of 64 bits at most, not {_shown(values):.60}")
    return tuple(numbers)


def _shown(values: tuple[Value, ...]) -> str:
    return " ".join(map(str, values))
