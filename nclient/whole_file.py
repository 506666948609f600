"""A file that is written whole: whoever reads it meanwhile, or after the power failed, has the old one or the new one.

Rules: written under another name in the same folder first, and on the disk before it takes the old one's place. What a
symbolic link leads to is written, the link stays; nothing takes the place of a device or a pipe. Whatever goes wrong is
the writer's own `error`, which names the file and the remedy; the old one is still there then, and nothing beside it.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Final

from nclient.file_text import Failure
from nclient.unwritable import unwritable

_PIECE: Final = 65_536
"""Characters that are made bytes at once."""


def write_whole(path: Path, text: str, error: Failure, ending: str = "") -> None:
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
        raise error(unwritable(path, failure)) from failure
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
