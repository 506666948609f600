"""What stands in a file: a world, a plan of faults, a mission, a simulation that was saved. Such files are read here.

Rules: whatever is wrong is the reader's own `error`, which names the file. What is too long is not read to its end, so
that a device or a recording given by mistake fills no memory; a byte order mark is passed over. What TOML means is its
reader's.

What to say of a file that cannot be written: its name, why, and what helps.

Rules: on the ground floor, so that whoever writes files says it the same way. Nothing is written here.

A file that is written whole: whoever reads it meanwhile, or after the power failed, has the old one or the new one.

Rules: written under another name in the same folder first, and on the disk before it takes the old one's place. What a
symbolic link leads to is written, the link stays; nothing takes the place of a device or a pipe. Whatever goes wrong is
the writer's own `error`, which names the file and the remedy; the old one is still there then, and nothing beside it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

Failure = Callable[[str], Exception]
"""Of a message, the error that the reader documents."""
_MOST_BITS: Final = 4096
"""Written with 0x it may be longer than what Python shows as decimal (4,300 digits): no error could tell of it."""


def read_binary(path: Path, most_bytes: int, error: Failure) -> bytes:
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
    data = read_binary(path, most_bytes, error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        raise error(
            f"{path}: expected text in UTF-8, found other bytes at {failure.start}: {failure.reason}"
        ) from failure


def parse_toml(text: str, file: str, error: Failure) -> dict[str, Any]:
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


_ROOM: Final = "make room on that disk, or name a file on another"
_MAY: Final = "name a file in a folder that is there and may be written to"
_SIZE: Final = "raise the limit on the size of files (ulimit -f)"
_REMEDIES: Final = {errno.ENOSPC: _ROOM, errno.EDQUOT: _ROOM, errno.EFBIG: _SIZE}


def describe_write_error(path: Path, error: OSError, what: str = "") -> str:
    """`FILE: cannot be written: No space left on device; make room ...`; `what` stands in the file's place after its
    name: `FILE: the report cannot be written: ...`."""
    return f"{path}: {what}{' ' if what else ''}cannot be written: {error.strerror}; {remedy(error)}"


def remedy(error: OSError) -> str:
    """What helps against it."""
    return _REMEDIES.get(error.errno or 0, _MAY)


_PIECE: Final = 65_536
"""Characters that are made bytes at once."""


def write_atomic(path: Path, text: str, error: Failure, ending: str = "") -> None:
    """Put a text into a file, UTF-8. Raises `error` where that cannot be.

    `ending`: of the other name, `.FILE.ENDING`. One who writes the same file again and again gives his own: what he
    left when he was killed is written over. Whoever gives none has one that no other process has.
    """
    try:
        real = Path(os.path.realpath(path))
        if real.exists() and not real.is_file():
            real.write_text(text, encoding="utf-8")
        else:
            _write(real, real.with_name(f".{real.name}.{ending or os.getpid()}"), text)
    except OSError as failure:
        raise error(describe_write_error(path, failure)) from failure
    except ValueError as failure:  # a name with a zero byte in it
        raise error(f"{str(path)!r}: cannot be written: {failure}") from failure


def _write(path: Path, unfinished: Path, text: str) -> None:
    try:
        with unfinished.open("w", encoding="utf-8") as file:
            for begin in range(0, len(text), _PIECE):
                file.write(text[begin : begin + _PIECE])
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    finally:  # Ctrl-C as well
        with contextlib.suppress(OSError):
            unfinished.unlink()
    _settle(path.parent)


def _settle(folder: Path) -> None:
    """The new name is on the disk, too, where the system opens folders."""
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
