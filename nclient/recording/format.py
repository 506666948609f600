"""A recording on disk: JSON lines, a header and then an entry for whatever went over a connection.

    {"format": "nomad recording", "version": 1, "package": ..., "started": ..., "wire": "tcp", "model": ..., ...}
    {"t": 0.1, "dir": "out", "bytes": "000f0000", "decoded": [{"to": "robot", "call": "gs", "args": []}]}
    {"t": 0.1, "dir": "in", "bytes": "0050...", "decoded": [{"to": "host", "reply": "state", ...}]}
    {"t": 0.2, "event": "open", "connection": "127.0.0.1:4711", "wire": "tcp", "model": "n150"}   and "close"

`out` went to the robot and `in` came from it, whoever wrote the file; `bytes` are as they came, `decoded` the frames
that they made whole. A daemon notes what it takes to do the same again: `steps`, pieces of simulated time that passed
since the entry before, [seconds, how many]; `by_time`, an answer that time brought; `at`, its clock on a robot's line.

Rules: time is handed in. What cannot be read names file, line and remedy; a last line cut short, as after a power cut,
is left out and remarked upon. A recording of days is read line by line; what is none is not read to its end. A disk
that fills up costs the recording, never the robot's run: it is told once.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import math
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TextIO

from nclient.common.files import remedy, unwritable
from nclient.errors import RecordingError

log = logging.getLogger(__name__)

FORMAT: Final = "nomad recording"
VERSION: Final = 1
OUT, IN, OPEN, CLOSE, TIME = "out", "in", "open", "close", "time"
_DIRECTIONS: Final = (OUT, IN)
_EVENTS: Final = (OPEN, CLOSE, TIME)
LONGEST_LINE: Final = 1 << 26
"""Characters. The longest that is written has a world in it, of 24 million at the most."""
_NAMED: Final = ("t", "dir", "event", "connection", "bytes", "decoded")


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a recording.

    time_s       seconds since the start, of the clock that the header names
    kind         out, in; open, close (a connection comes, goes); time (nothing was said while time passed)
    connection   whose; empty where there is only one
    data         the bytes of out and in
    decoded      the frames that they completed, as `nomad wire decode` shows them
    more         whatever else stands in the line: wire and model at open, steps
    line         where it stands in the file, 0 where it does not yet
    """

    time_s: float
    kind: str
    connection: str = ""
    data: bytes = b""
    decoded: tuple[Mapping[str, Any], ...] = ()
    more: Mapping[str, Any] = field(default_factory=dict)
    line: int = 0


@dataclass(frozen=True, slots=True)
class Recording:
    """A whole file. `cut`: what is to say of a last line that was left out, empty where none was."""

    name: str
    header: Mapping[str, Any]
    entries: tuple[Entry, ...]
    cut: str = ""

    def connections(self) -> tuple[str, ...]:
        """The names of the connections, in the order they came."""
        return tuple(dict.fromkeys(entry.connection for entry in self.entries if entry.kind != TIME))


class LogWriter:
    """Writes a recording; each line is on its way to the disk when `write` returns.

    Raises RecordingError when the file cannot be made. `header`: what goes beside format and version;
    `most_bytes`: the line that would not fit any more is not written, nor any after it (0: no limit).
    """

    def __init__(self, path: Path, header: Mapping[str, Any], most_bytes: int = 0) -> None:
        self.path = path
        self._left = most_bytes or math.inf
        self.failed = False
        self._over = False
        self._lock = threading.Lock()
        try:
            self._file = path.open("w", encoding="utf-8")
        except OSError as error:
            raise RecordingError(unwritable(path, error)) from error
        self._line({"format": FORMAT, "version": VERSION} | dict(header))

    def write(self, entry: Entry) -> None:
        """Add an entry. What the disk refuses is told once; from then on nothing is written."""
        self._line(as_object(entry))

    def close(self) -> None:
        """Let the file go. Twice is fine; what is written afterwards is lost."""
        self._over = True
        self.rest()

    def rest(self) -> None:
        """Let the file go until there is something to write again."""
        with self._lock:
            self._let_go()

    def _line(self, whole: Mapping[str, Any]) -> None:
        with self._lock:
            if self.failed or self._over:
                return
            try:
                if self._file.closed:
                    self._file = self.path.open("a", encoding="utf-8")
                line = json.dumps(whole, separators=(",", ":")) + "\n"
                self._left -= len(line)  # all of it ASCII
                if self._left < 0:
                    self._end("it is as long as it may be (--limit-log)")
                    return
                self._file.write(line)
                self._file.flush()
            except OSError as error:
                self._end(f"{error.strerror}; {remedy(error)}, and begin another recording")

    def _end(self, reason: str) -> None:
        self.failed = True
        log.error("%s: no longer recorded; the run goes on, what was written can be read: %s", self.path, reason)
        self._let_go()

    def _let_go(self) -> None:
        with contextlib.suppress(OSError):  # what a full disk still owes cannot be written, and was told
            self._file.close()


def as_object(entry: Entry) -> dict[str, Any]:
    """The entry as it stands in the file."""
    whole: dict[str, Any] = {"t": entry.time_s}
    whole["dir" if entry.kind in _DIRECTIONS else "event"] = entry.kind
    if entry.connection:
        whole["connection"] = entry.connection
    if entry.kind in _DIRECTIONS:
        whole["bytes"] = entry.data.hex()
    if entry.decoded:
        whole["decoded"] = [dict(found) for found in entry.decoded]
    return whole | dict(entry.more)


def read_recording(path: Path) -> Recording:
    """The recording in a file. Raises RecordingError, naming file, line and remedy."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return _recording(file, str(path))
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise RecordingError(f"{str(path)!r}: cannot be read ({error})") from None


def parse_recording(text: str, name: str) -> Recording:
    """The recording that a text is; `name` is what errors call it."""
    return _recording(io.StringIO(text), name)


def _recording(file: TextIO, name: str) -> Recording:
    lines = _lines(file, name)
    header = _header(next(lines, ""), name)
    remarks: list[str] = []
    entries = tuple(_entries(lines, name, remarks))
    return Recording(name, header, entries, "".join(remarks))


def _lines(file: TextIO, name: str) -> Iterator[str]:
    number = 1
    while line := file.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise RecordingError(f"{name}, line {number}: longer than {LONGEST_LINE} characters, which no line of a "
                                 "recording is; is it the right file?")
        yield line
        number += 1


def _header(line: str, name: str) -> dict[str, Any]:
    try:
        header = json.loads(line)
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise RecordingError(f'{name}, line 1: no recording; one begins with {{"format": "{FORMAT}", ...}}, as '
                             "record=FILE in an address or `nserver --record FILE` writes it")
    if header.get("version") != VERSION:
        raise RecordingError(f"{name}, line 1: version {header.get('version')}; this program reads version {VERSION}: "
                             "take the one that wrote it")
    return header


def _entries(lines: Iterator[str], name: str, remarks: list[str]) -> Iterator[Entry]:
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        try:
            yield _entry(line, number, name)
        except RecordingError:
            if line.endswith("\n"):
                raise
            remarks.append(f"{name}, line {number}: cut short after {len(line)} characters, and left out")


def _entry(line: str, number: int, name: str) -> Entry:
    try:
        return _read_entry(json.loads(line), number)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise RecordingError(
            f"{name}, line {number}: no entry of a recording ({type(error).__name__}: {error}); mend it or take it out"
        ) from None


def _read_entry(whole: dict[str, Any], number: int) -> Entry:
    kind = whole["dir"] if "dir" in whole else whole["event"]
    if kind not in (_DIRECTIONS if "dir" in whole else _EVENTS):
        raise ValueError(f"nothing is {kind!r}")
    more = {key: value for key, value in whole.items() if key not in _NAMED}
    time_s, decoded = float(whole["t"]), tuple(whole.get("decoded", ()))
    if not math.isfinite(time_s) or not all(isinstance(found, dict) for found in decoded):
        raise ValueError("t is seconds, decoded a list of objects")
    connection, data = str(whole.get("connection", "")), bytes.fromhex(whole.get("bytes", ""))
    return Entry(time_s, kind, connection, data, decoded, more, number)
