"""Reading and writing of small files: worlds, fault plans, missions, snapshots, results.

Errors are raised as the caller's own type and name the file and a remedy. Reading stops at a maximum size, so that a
device or a recording given by mistake does not fill the memory. Writing is atomic: readers see the old file or the
new one, even after a power failure.
"""

import contextlib
import errno
import os
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from nclient.errors import NomadError

ErrorFactory = Callable[[str], Exception]
"""Makes the caller's error of a message."""
_MAX_BITS: Final = 4096
"""Limit of integers in TOML. Written as 0x... they can be longer than the 4,300 digits that Python prints as decimal,
and then no error message could show them."""


# -- reading ----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def read_errors_as(error: ErrorFactory, path: Path) -> Iterator[None]:
    """Turn an OSError or ValueError of the block into an error that names the path and the reason.

    An error of this project is raised as it is.
    """
    try:
        yield
    except NomadError:
        raise
    except OSError as failure:
        raise error(f"{path}: cannot be read: {failure.strerror}") from failure
    except ValueError as failure:
        # A file name with a NUL in it, or bytes that are no text.
        raise error(f"{str(path)!r}: cannot be read: {failure}") from None


def read_binary(path: Path, max_bytes: int, error: ErrorFactory) -> bytes:
    """Return the content of a file of at most `max_bytes`. Raises `error`."""
    with read_errors_as(error, path), path.open("rb") as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise error(f"{path}: is longer than {max_bytes} bytes, which is the most that is read of such a file; "
                    "is it the right one?")
    return data


def read_text(path: Path, max_bytes: int, error: ErrorFactory) -> str:
    """Return the text of a UTF-8 file of at most `max_bytes`, without a byte order mark. Raises `error`."""
    data = read_binary(path, max_bytes, error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        raise error(f"{path}: expected text in UTF-8, found other bytes at {failure.start}: "
                    f"{failure.reason}") from failure


def parse_toml(text: str, file: str, error: ErrorFactory) -> dict[str, Any]:
    """Parse TOML; `file` is the name in error messages. Raises `error`."""
    try:
        values = tomllib.loads(text)
    except RecursionError:
        raise error(f"{file}: is no TOML: nested too deeply") from None
    except ValueError as failure:
        raise error(f"{file}: is no TOML: {failure}") from failure
    if any(number.bit_length() > _MAX_BITS for number in _integers(values)):
        raise error(f"{file}: holds a whole number of more than {_MAX_BITS} bits")
    return values


def _integers(values: dict[str, Any]) -> Iterator[int]:
    # Iterative, because TOML may nest deeper than Python's recursion limit.
    pending: list[Any] = [values]
    while pending:
        value = pending.pop()
        if isinstance(value, int):
            yield value
        elif isinstance(value, dict):
            pending += value.values()
        elif isinstance(value, list):
            pending += value


# -- writing ----------------------------------------------------------------------------------------------------------

_NO_SPACE: Final = "make room on that disk, or name a file on another"
_NO_ACCESS: Final = "name a file in a folder that is there and may be written to"
_TOO_LARGE: Final = "raise the limit on the size of files (ulimit -f)"
_HINTS: Final = {errno.ENOSPC: _NO_SPACE, errno.EDQUOT: _NO_SPACE, errno.EFBIG: _TOO_LARGE}
_CHUNK: Final = 65_536
"""Characters that are encoded at once."""


def describe_write_error(path: Path, error: OSError, what: str = "") -> str:
    """Return a message such as `FILE: cannot be written: No space left on device; make room ...`.

    `what` names the content: `FILE: the report cannot be written: ...`.
    """
    return f"{path}: {what}{' ' if what else ''}cannot be written: {error.strerror}; {write_error_hint(error)}"


def write_error_hint(error: OSError) -> str:
    """Return a remedy for a write error."""
    return _HINTS.get(error.errno or 0, _NO_ACCESS)


@contextlib.contextmanager
def write_errors_as(error: ErrorFactory, path: Path, what: str = "") -> Iterator[None]:
    """Turn an OSError of the block into an error that names the path, the reason and a remedy."""
    try:
        yield
    except OSError as failure:
        raise error(describe_write_error(path, failure, what)) from failure


def write_atomic(path: Path, text: str, error: ErrorFactory, ending: str = "") -> None:
    """Replace the content of a file, in UTF-8.

    The text is written to a temporary file in the same folder, synchronised to the disk and renamed. Symbolic links
    are followed; devices and pipes are written to directly. After an error the old file is unchanged.

    Parameters
    ----------
    path
        File to write.
    text
        New content.
    error
        Makes the error to raise.
    ending
        Suffix of the temporary file `.FILE.ENDING`, default the process id. With a fixed ending a program that was
        killed replaces its own temporary file the next time.
    """
    try:
        real = Path(os.path.realpath(path))
        if real.exists() and not real.is_file():
            real.write_text(text, encoding="utf-8")
        else:
            _write_and_rename(real, real.with_name(f".{real.name}.{ending or os.getpid()}"), text)
    except OSError as failure:
        raise error(describe_write_error(path, failure)) from failure
    except ValueError as failure:
        # A file name with a NUL in it.
        raise error(f"{str(path)!r}: cannot be written: {failure}") from failure


def _write_and_rename(path: Path, temporary: Path, text: str) -> None:
    try:
        # 1. Write all of it to the disk under the temporary name.
        # A link or a file that is there already is removed and never written to: "x" creates or fails (O_EXCL).
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()
        with temporary.open("x", encoding="utf-8") as file:
            for begin in range(0, len(text), _CHUNK):
                file.write(text[begin : begin + _CHUNK])
            file.flush()
            os.fsync(file.fileno())
        # 2. Replace the old file in one step.
        temporary.replace(path)
    finally:
        # Removes the temporary file after any error, Ctrl-C included.
        with contextlib.suppress(OSError):
            temporary.unlink()
    # 3. Write the new name to the disk.
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    # Not every system can open folders.
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
