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

A recording for people: a line for each frame that went by, in inches, degrees and seconds.

       0.100  > vm 100 -50 0                                                        to the robot, as the C call
       0.104  < state x 0.0 y 0.0 steer 0.0 turret 0.0 v 10.0 -5.0 0.0 ...          from it
       0.105  < ! 3 bytes that are no frame

Rules: text only. What is told is what the decoded frames hold; State's slots are named as PROTOCOL.md names them.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import math
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TextIO

from nclient.common.files import describe_write_error, remedy
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


class RecordingWriter:
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
            raise RecordingError(describe_write_error(path, error)) from error
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


_POSE: Final = ((34, "x"), (35, "y"), (36, "steer"), (37, "turret"))
_SONARS, _INFRAREDS, _SPEEDS = slice(17, 33), slice(1, 17), slice(38, 41)
_OF_OPEN: Final = ("wire", "model")
_ARROWS: Final = {OUT: ">", IN: "<"}
_SHOWN: Final[Mapping[str, tuple[str, ...]]] = {
    "state": ("pose", "v", "sonar", "infrared", "bumper", "compass", "laser", "clock", "volts"),
    "sonar": ("sonar", "clock"), "infrared": ("infrared", "clock"), "bumper": ("bumper", "clock"),
    "compass": ("compass", "clock"), "configuration": ("pose",), "velocity": ("v",), "laser": ("laser", "clock"),
}  # fmt: skip
Found = Mapping[str, Any]
State = list[Any]


def format_entry(entry: Entry, with_bytes: bool = False) -> Iterator[str]:
    """The lines for one entry, none where only time passed. `with_bytes`: the bytes, too.

    Raises RecordingError where `decoded` is not as a recorder writes it.
    """
    start = f"{entry.time_s:10.3f}  {entry.connection + ' ' if entry.connection else ''}"
    if entry.kind not in _ARROWS:
        if entry.kind != TIME:
            what = (str(entry.more[name]) for name in _OF_OPEN if name in entry.more)
            yield " ".join((f"{start}--", entry.kind, *what))
        return
    for found in entry.decoded:
        yield f"{start}{_ARROWS[entry.kind]} {_told_of(entry, found)}"
    if with_bytes and entry.data:
        yield f"{start}{_ARROWS[entry.kind]} [{entry.data.hex(' ')}]"


def _told_of(entry: Entry, found: Found) -> str:
    """Frames out of a file may be anybody's."""
    try:
        return format_frame(found)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise RecordingError(f"line {entry.line}: `decoded` is not as a recorder writes it ({error!r:.80}); "
                             "take it out of that line, the bytes are enough") from None


def format_frame(found: Found) -> str:
    """A decoded frame in words."""
    if "error" in found:
        return f"! {found['error']}"
    if "call" in found:
        return " ".join((str(found["call"]), *map(str, found["args"]), *_beside(found)))
    kind = str(found["reply"])
    parts = [part for name in _SHOWN.get(kind, ()) if (part := _part(name, found))]
    if kind not in _SHOWN and "values" in found:
        parts = [" ".join(map(str, found["values"]))]
    named = any(part.startswith(f"{kind} ") for part in parts)
    return " ".join(parts if named else (kind, *parts))


def _beside(found: Found) -> Iterator[str]:
    if "mask" in found:
        yield "mask " + "".join(map(str, found["mask"]))
    yield from (f"({name} {found[name]})" for name in ("pid", "packet_type") if name in found)


def _part(name: str, found: Found) -> str:
    return _PARTS[name](found["State"], found)


def _pose(state: State, _: Found) -> str:
    return " ".join(f"{what} {state[slot] / 10:g}" for slot, what in _POSE if state[slot] is not None)


def _speeds(state: State, _: Found) -> str:
    return _listed("v", [None if v is None else v / 10 for v in state[_SPEEDS]])


def _laser(_: State, found: Found) -> str:
    return f"laser {found['Laser'][0]} readings" if found["Laser"] and found["Laser"][0] else ""


def _clock(_: State, found: Found) -> str:
    return "" if found["clock"] is None else f"clock {found['clock'] / 1000:g}"


def _volts(_: State, found: Found) -> str:
    return "" if found["volt_cpu"] is None else f"volts {found['volt_cpu']:.1f} {found['volt_motor']:.1f}"


def _listed(name: str, values: list[float | None]) -> str:
    return "" if None in values else f"{name} {' '.join(f'{value:g}' for value in values if value is not None)}"


_PARTS: Final[Mapping[str, Callable[[State, Found], str]]] = {
    "pose": _pose,
    "v": _speeds,
    "sonar": lambda state, _: _listed("sonar", state[_SONARS]),
    "infrared": lambda state, _: _listed("infrared", state[_INFRAREDS]),
    "bumper": lambda state, _: "" if state[33] is None else f"bumper {state[33]:#x}",
    "compass": lambda state, _: "" if state[43] is None else f"compass {state[43] / 10:g}",
    "laser": _laser,
    "clock": _clock,
    "volts": _volts,
}
"""What is told of each part of a reply; "" where the reply does not have it."""
