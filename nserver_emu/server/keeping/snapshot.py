"""The whole simulation as text and back, bit for bit: what `nserver --save` writes and `--restore` reads.

    {"format": "nserver snapshot", "version": ..., "root": value, "objects": [object, ...]}

Rules: JSON, no pickle; what values and objects are is snapshot_objects.py's. Floats are written so that they read back
the same. Writing takes little more memory than the text: it is done again and again beside clients who wait.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from nclient.distribution import version
from nclient.errors import SnapshotError
from nclient.file_text import read_text
from nclient.whole_file import write_whole
from nserver_emu.server.admission.limits import SNAPSHOT_BYTES
from nserver_emu.server.handling.handlers import Emulator
from nserver_emu.server.keeping.snapshot_objects import Reader, Writer
from nserver_emu.server.keeping.trial import try_out

FORMAT: Final = "nserver snapshot"
KEPT: Final = ("simulation", "pace", "graphics", "traces", "transcript", "arms")
"""What of an emulator is kept: all but connections, port and permissions, which belong to a daemon's start."""

_NONE: Final = "is no snapshot of an nserver"
_HEAD: Final = 100
"""Characters among which one says what it is."""
_DAMAGED: Final = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, AssertionError, RecursionError, MemoryError,
)  # fmt: skip
"""What reading and trying damaged data leads to."""


def save(emulator: Emulator, path: Path) -> None:
    """Write a snapshot. Raises SnapshotError where it cannot be written."""
    write(dumps(emulator), path)


def write(text: str, path: Path, ending: str = "") -> None:
    """Put a snapshot's text into a file. `ending`: as write_whole has it.

    Raises SnapshotError where it cannot be written, or could not be read again; the old one is still there.
    """
    if len(text) > SNAPSHOT_BYTES:  # all of it ASCII
        raise SnapshotError(f"{path}: cannot be written: {len(text)} bytes, and no more than {SNAPSHOT_BYTES} are read "
                            "again; lower --limit-graphics or --limit-obstacles")
    write_whole(path, text, SnapshotError, ending)


def restore(emulator: Emulator, path: Path) -> None:
    """Put an emulator into the state of a file. Raises SnapshotError, and then the emulator is as it was."""
    loads(emulator, text_of(path), str(path))


def text_of(path: Path) -> str:
    """What stands in a snapshot's file. Raises SnapshotError."""
    return read_text(path, SNAPSHOT_BYTES, SnapshotError)


def dumps(emulator: Emulator) -> str:
    """The snapshot of an emulator as text."""
    writer = Writer()
    root = writer.value({name: getattr(emulator, name) for name in KEPT})
    head = json.dumps({"format": FORMAT, "version": version(), "root": root}, separators=(",", ":"))
    return writer.whole(f'{head[:-1]},"objects":[', "]}")


def loads(emulator: Emulator, text: str, name: str = "snapshot") -> None:
    """Put an emulator into the state of a snapshot; `name` is what errors call it."""
    try:
        if FORMAT not in text[:_HEAD]:
            raise SnapshotError(_NONE)
        whole = json.loads(text)
        if not isinstance(whole, dict) or whole.get("format") != FORMAT:
            raise SnapshotError(_NONE)
        if whole.get("version") != version():
            raise SnapshotError(f"was made by version {whole.get('version')} and can be read by that one only")
        parts, tried = (Reader(whole["objects"]).value(whole["root"]) for _ in range(2))
        for part in KEPT:
            if type(parts[part]) is not type(getattr(emulator, part)):
                raise SnapshotError(f"its {part} is none")
        parts["pace"].check()
        try_out(tried["simulation"])
    except SnapshotError as error:
        raise SnapshotError(f"{name}: {error}") from None
    except _DAMAGED as error:
        raise SnapshotError(f"{name}: is damaged: {type(error).__name__}: {error}") from error
    for part in KEPT:
        setattr(emulator, part, parts[part])
    emulator.look_anew()
    emulator.drivers.orphan(emulator.simulation.robots)
