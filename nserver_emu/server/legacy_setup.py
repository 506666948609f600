r"""Reader of the original's robot.setup and world.setup.

    [section]            ; a comment
    key = value value \
          value          a backslash at the end joins the next line

Keys are case-sensitive, the last of two entries applies, unknown keys are ignored. No sample of either file survives;
documented are [server] port, [robot] type, [laser] calibration (8 numbers) and offset (2). The meaning of the laser's
ten numbers is not documented: they are checked and have no effect, which `unused` reports. New files use TOML.
"""

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
MAX_BYTES: Final = 1 << 20
"""More than any handwritten setup; a larger file is something else."""


@dataclass(frozen=True, slots=True)
class LegacySetup:
    """Settings of old setup files; None where a file has none. The laser's numbers have no effect."""

    port: int | None = None
    robot: str | None = None
    laser_calibration: tuple[float, ...] | None = None
    laser_offset: tuple[float, ...] | None = None

    @property
    def unused(self) -> tuple[str, ...]:
        """Keys that are present and have no effect."""
        given = {"[laser] calibration": self.laser_calibration, "[laser] offset": self.laser_offset}
        return tuple(key for key, numbers in given.items() if numbers is not None)


@dataclass(slots=True)
class Entry:
    """The values of a key, and its line number."""

    line: int
    words: list[str] = field(default_factory=list)


def read_setups(paths: Iterable[Path]) -> LegacySetup:
    """Read setup files; later ones override earlier ones. Raises SetupFileError."""
    setup = LegacySetup()
    for path in paths:
        setup = _with_entries(setup, _parsed_file(path), str(path))
    return setup


def parse_setup(text: str, file: str = "setup") -> Mapping[tuple[str, str], Entry]:
    """Parse a setup file into entries by section and key; `file` is its name in errors. Raises SetupFileError."""
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
    """Yield line numbers and lines without comments; lines that end in a backslash are joined with the next."""
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
    data = read_binary(path, MAX_BYTES, SetupFileError)
    return parse_setup(data.decode("latin-1"), str(path))


def _with_entries(setup: LegacySetup, entries: Mapping[tuple[str, str], Entry], file: str) -> LegacySetup:
    """Return the setup with the settings of one more file."""
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
