"""The text of a file that somebody wrote: a world, a setup, models. All that is read here of such files is read so.

Rules: whatever is wrong is a WorldFileError that names the file. What is too long is not read to its end, so that a
device or a recording given by mistake fills no memory; a byte order mark is passed over.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from nclient.errors import WorldFileError

MOST_BYTES: Final = 1 << 22
"""Some forty thousand obstacles, which Python's TOML takes seconds for; none that was made by hand comes near it."""


def read_text(path: Path) -> str:
    """What stands in a file, UTF-8. Raises WorldFileError."""
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise WorldFileError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # a name with a zero byte in it
        raise WorldFileError(f"{str(path)!r}: cannot be read: {error}") from None
    if len(data) > MOST_BYTES:
        raise WorldFileError(f"{path}: is longer than {MOST_BYTES} bytes, which is the most that is read of such a "
                             "file; is it the right one?")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise WorldFileError(
            f"{path}: expected text in UTF-8, found other bytes at {error.start}: {error.reason}"
        ) from error
