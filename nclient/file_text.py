"""What stands in a file: a world, a plan of faults, a mission, a simulation that was saved. Such files are read here.

Rules: whatever is wrong is the reader's own `error`, which names the file. What is too long is not read to its end, so
that a device or a recording given by mistake fills no memory; a byte order mark is passed over. What TOML means is its
reader's.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

Failure = Callable[[str], Exception]
"""Of a message, the error that the reader documents."""
_MOST_BITS: Final = 4096
"""Written with 0x it may be longer than what Python shows as decimal (4,300 digits): no error could tell of it."""


def read_data(path: Path, most_bytes: int, error: Failure) -> bytes:
    """The bytes of a file of `most_bytes` or fewer. Raises `error`."""
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as failure:
        raise error(f"{path}: cannot be read: {failure.strerror}") from failure
    except ValueError as failure:  # a name with a zero byte in it
        raise error(f"{str(path)!r}: cannot be read: {failure}") from None
    if len(data) > most_bytes:
        raise error(f"{path}: is longer than {most_bytes} bytes, which is the most that is read of such a file; "
                    "is it the right one?")
    return data


def read_text(path: Path, most_bytes: int, error: Failure) -> str:
    """The text of such a file, UTF-8. Raises `error`."""
    data = read_data(path, most_bytes, error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        raise error(
            f"{path}: expected text in UTF-8, found other bytes at {failure.start}: {failure.reason}"
        ) from failure


def toml_of(text: str, file: str, error: Failure) -> dict[str, Any]:
    """What a text in TOML holds; `file` is what errors call it. Raises `error`."""
    try:
        values = tomllib.loads(text)
    except RecursionError:
        raise error(f"{file}: is no TOML: nested too deeply") from None
    except ValueError as failure:
        raise error(f"{file}: is no TOML: {failure}") from failure
    if any(number.bit_length() > _MOST_BITS for number in _whole_numbers(values)):
        raise error(f"{file}: holds a whole number of more than {_MOST_BITS} bits")
    return values


def _whole_numbers(values: dict[str, Any]) -> Iterator[int]:
    left: list[Any] = [values]
    while left:
        value = left.pop()
        if isinstance(value, int):
            yield value
        elif isinstance(value, dict):
            left += value.values()
        elif isinstance(value, list):
            left += value
