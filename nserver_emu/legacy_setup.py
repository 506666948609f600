"""The original's robot.setup and world.setup, as far as their keys are known. Text in, a value out.

    [section]            ; a comment
    key = value value \\
          value          a backslash at the end joins the next line

Keys are case-sensitive, the last of two wins, unknown ones are left alone. No sample of either file survives, so what
is known is little: [server] port; [robot] type; [laser] calibration (8 numbers) and offset (2). What the laser's ten
numbers mean no source tells: they are checked and kept, and have no effect; `unused` says so to whoever gave them. Our
own TOML files are the real format.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from nclient.common.files import read_binary
from nclient.errors import AddressError, SetupFileError
from nclient.protocol.types import get_model

CALIBRATION_NUMBERS: Final = 8
OFFSET_NUMBERS: Final = 2
MOST_BYTES: Final = 1 << 20
"""More than any setup by hand; a larger file is something else."""


@dataclass(frozen=True, slots=True)
class OldSetup:
    """What old setup files say; None where they do not. The laser's numbers are kept as they stand, without effect."""

    port: int | None = None
    robot: str | None = None
    laser_calibration: tuple[float, ...] | None = None
    laser_offset: tuple[float, ...] | None = None

    @property
    def unused(self) -> tuple[str, ...]:
        """The keys that were given and have no effect."""
        given = {"[laser] calibration": self.laser_calibration, "[laser] offset": self.laser_offset}
        return tuple(key for key, numbers in given.items() if numbers is not None)


@dataclass(slots=True)
class Entry:
    """The words behind a key, and the line on which the key stands."""

    line: int
    words: list[str] = field(default_factory=list)


def read_setups(paths: Iterable[Path]) -> OldSetup:
    """What these files say together, the later ones above the earlier. Raises SetupFileError."""
    setup = OldSetup()
    for path in paths:
        setup = _understood(setup, _parsed_file(path), str(path))
    return setup


def parse_setup(text: str, file: str = "setup") -> Mapping[tuple[str, str], Entry]:
    """The entries of a setup file by section and key; `file` is what errors call it. Raises SetupFileError."""
    entries: dict[tuple[str, str], Entry] = {}
    section = ""
    for number, line in _joined(text):
        content = line.partition(";")[0].strip()
        if not content:
            continue
        if content.startswith("["):
            if not content.endswith("]"):
                raise SetupFileError(f"{file}, line {number}: expected [section], found {content!r}")
            section = content[1:-1].strip()
            continue
        key, sign, value = content.partition("=")
        if not sign or not key.strip():
            raise SetupFileError(f"{file}, line {number}: expected key = value, found {content!r}")
        entries[section, key.strip()] = Entry(number, value.split())
    return entries


def _joined(text: str) -> Iterator[tuple[int, str]]:
    """The lines with those that a backslash joins in one, and the number on which each begins; comments go first."""
    whole, first = "", 0
    for number, line in enumerate(text.splitlines(), start=1):
        first = first or number
        content = line.partition(";")[0].rstrip()
        if content.endswith("\\"):
            whole += content[:-1] + " "
            continue
        yield first, whole + content
        whole, first = "", 0
    if whole:
        yield first, whole


def _parsed_file(path: Path) -> Mapping[tuple[str, str], Entry]:
    data = read_binary(path, MOST_BYTES, SetupFileError)
    return parse_setup(data.decode("latin-1"), str(path))


def _understood(setup: OldSetup, entries: Mapping[tuple[str, str], Entry], file: str) -> OldSetup:
    """The setup with what the known keys of a file say."""
    if entry := entries.get(("server", "port")):
        setup = replace(setup, port=_port(entry, file))
    if entry := entries.get(("robot", "type")):
        setup = replace(setup, robot=_robot(entry, file))
    if entry := entries.get(("laser", "calibration")):
        setup = replace(setup, laser_calibration=_numbers(entry, CALIBRATION_NUMBERS, f"{file}", "calibration"))
    if entry := entries.get(("laser", "offset")):
        setup = replace(setup, laser_offset=_numbers(entry, OFFSET_NUMBERS, f"{file}", "offset"))
    return setup


def _port(entry: Entry, file: str) -> int:
    word = entry.words[0] if len(entry.words) == 1 else ""
    if not (word.isascii() and word.isdecimal()) or len(word) > 5 or int(word) > 0xFFFF:
        raise SetupFileError(f"{file}, line {entry.line}: port is a number 0 to 65535, not {' '.join(entry.words)!r}")
    return int(word)


def _robot(entry: Entry, file: str) -> str:
    try:
        return get_model(" ".join(entry.words)).name
    except AddressError as error:
        raise SetupFileError(f"{file}, line {entry.line}: {error}") from None


def _numbers(entry: Entry, count: int, file: str, key: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in entry.words)
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise SetupFileError(f"{file}, line {entry.line}: {key} is {count} numbers, not {' '.join(entry.words)!r}")
    return numbers
