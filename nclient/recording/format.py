"""Recordings on disk: JSON lines, a header and one entry for everything that crosses a connection.

    {"format": "nomad recording", "version": 1, "package": ..., "started": ..., "wire": "tcp", "model": ..., ...}
    {"t": 0.1, "dir": "out", "bytes": "000f0000", "decoded": [{"to": "robot", "call": "gs", "args": []}]}
    {"t": 0.1, "dir": "in", "bytes": "0050...", "decoded": [{"to": "host", "reply": "state", ...}]}
    {"t": 0.2, "event": "open", "connection": "127.0.0.1:4711", "wire": "tcp", "model": "n150"}   and "close"

`out` is to the robot and `in` from it, in every recording; `bytes` are as received, `decoded` the frames that they
complete. A server's recording has everything to repeat the run: `steps`, time steps since the entry before as
[seconds, count]; `by_time`, a reply that simulated time caused; `at`, the clock of a serial line.

Times are passed in. Read errors name file, line and remedy; an incomplete last line, as after a power failure, is left
out and reported. Long recordings are read line by line. If the disk is full, recording ends with one log message, and
the robot's run continues.

`format_entry` shows an entry as text, one line per frame, in inches, degrees and seconds:

       0.100  > vm 100 -50 0                                                        to the robot, as the C call
       0.104  < state x 0.0 y 0.0 steer 0.0 turret 0.0 v 10.0 -5.0 0.0 ...          from it
       0.105  < ! 3 bytes that are no frame
"""

import contextlib
import io
import json
import logging
import math
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, TextIO

from nclient.common.files import read_errors_as, write_error_hint, write_errors_as
from nclient.errors import RecordingError

log = logging.getLogger(__name__)

FORMAT: Final = "nomad recording"
VERSION: Final = 1
OUT, IN, OPEN, CLOSE, TIME = "out", "in", "open", "close", "time"
_DIRECTIONS: Final = (OUT, IN)
_EVENTS: Final = (OPEN, CLOSE, TIME)
MAX_LINE: Final = 1 << 26
"""Maximum characters of a line. The longest that is written holds a world, of at most 24 million characters."""
_NAMED: Final = ("t", "dir", "event", "connection", "bytes", "decoded")


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a recording.

    Attributes
    ----------
    time_s
        Seconds since the start, on the clock that the header names.
    kind
        out, in; open, close (of a connection); time (time passed without traffic).
    connection
        Name of the connection; empty if there is only one.
    data
        Bytes of out and in.
    decoded
        Frames that the bytes complete, as `nomad wire decode` shows them.
    more
        Other keys of the line: wire and model at open, steps.
    line
        Line number in the file, 0 if not written yet.
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
    """A whole file. `cut` is a message about an incomplete last line, empty if there is none."""

    name: str
    header: Mapping[str, Any]
    entries: tuple[Entry, ...]
    cut: str = ""

    def connections(self) -> tuple[str, ...]:
        """Return the names of the connections in the order of their first entries."""
        return tuple(dict.fromkeys(entry.connection for entry in self.entries if entry.kind != TIME))


class RecordingWriter:
    """Writer of a recording; every entry is flushed before `write` returns.

    Parameters
    ----------
    path
        File to write.
    header
        Keys of the first line besides format and version.
    max_bytes
        Maximum size of the file, 0 for no limit; the first entry beyond it ends the recording.

    Raises
    ------
    RecordingError
        If the file cannot be created.
    """

    def __init__(self, path: Path, header: Mapping[str, Any], max_bytes: int = 0) -> None:
        self.path = path
        # 0 means no limit.
        self._bytes_left = max_bytes or math.inf
        self.failed = False
        self._closed = False
        self._lock = threading.Lock()
        with write_errors_as(RecordingError, path):
            self._file = path.open("w", encoding="utf-8")
        self._line({"format": FORMAT, "version": VERSION} | dict(header))

    def write(self, entry: Entry) -> None:
        """Add an entry. After a write error, which is logged, nothing more is written."""
        self._line(as_object(entry))

    def close(self) -> None:
        """End the recording; idempotent. Later entries are ignored."""
        self._closed = True
        self.release()

    def release(self) -> None:
        """Close the file until the next entry."""
        with self._lock:
            self._close_file()

    def _line(self, whole: Mapping[str, Any]) -> None:
        with self._lock:
            if self.failed or self._closed:
                return
            try:
                # Released after the last entry: append.
                if self._file.closed:
                    self._file = self.path.open("a", encoding="utf-8")
                line = json.dumps(whole, separators=(",", ":")) + "\n"
                # json.dumps writes ASCII only, so that characters are bytes.
                self._bytes_left -= len(line)
                if self._bytes_left < 0:
                    self._fail("it has reached its maximum size (--limit-log)")
                    return
                self._file.write(line)
                self._file.flush()
            except OSError as error:
                self._fail(f"{error.strerror}; {write_error_hint(error)}, and begin another recording")

    def _fail(self, reason: str) -> None:
        self.failed = True
        log.error("%s: no longer recorded; the run goes on, what was written can be read: %s", self.path, reason)
        self._close_file()

    def _close_file(self) -> None:
        # Closing flushes again, which fails on a full disk; that error was logged already.
        with contextlib.suppress(OSError):
            self._file.close()


def as_object(entry: Entry) -> dict[str, Any]:
    """Return the entry as the JSON object of its line."""
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
    """Read a recording.

    Raises
    ------
    RecordingError
        If the file cannot be read or is no recording; the message has file, line and remedy.
    """
    with read_errors_as(RecordingError, path), path.open(encoding="utf-8", errors="replace") as file:
        return _recording(file, str(path))


def parse_recording(text: str, name: str) -> Recording:
    """Parse the text of a recording; `name` is the file's name in errors."""
    return _recording(io.StringIO(text), name)


def _recording(file: TextIO, name: str) -> Recording:
    # The header first: any other file is then reported as such, not as a broken entry.
    lines = _lines(file, name)
    header = _header(next(lines, ""), name)
    remarks: list[str] = []
    entries = tuple(_entries(lines, name, remarks))
    return Recording(name, header, entries, "".join(remarks))


def _lines(file: TextIO, name: str) -> Iterator[str]:
    # A line limit keeps a huge file without line ends from being read into memory.
    for number, line in enumerate(iter(partial(file.readline, MAX_LINE + 1), ""), start=1):
        if len(line) > MAX_LINE:
            raise RecordingError(f"{name}, line {number}: longer than {MAX_LINE} characters, which no line of a "
                                 "recording is; is it the right file?")
        yield line


def _header(line: str, name: str) -> dict[str, Any]:
    try:
        header = json.loads(line)
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise RecordingError(f'{name}, line 1: no recording; one begins with {{"format": "{FORMAT}", ...}}, as '
                             "record=FILE in an address or `nserver --record FILE` writes it")
    if (version := header.get("version")) != VERSION:
        raise RecordingError(f"{name}, line 1: version {version!r}; this program reads version {VERSION}: take the one "
                             "that wrote it")
    return header


def _entries(lines: Iterator[str], name: str, remarks: list[str]) -> Iterator[Entry]:
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        try:
            yield _read_entry(json.loads(line), number)
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            # Only a last line may be incomplete.
            if line.endswith("\n"):
                raise RecordingError(f"{name}, line {number}: no entry of a recording ({type(error).__name__}: "
                                     f"{error}); mend it or take it out") from None
            remarks.append(f"{name}, line {number}: cut short after {len(line)} characters, and left out")


def _read_entry(whole: dict[str, Any], number: int) -> Entry:
    # Any exception here means an invalid line; the caller adds file and line number.
    kind = whole["dir"] if "dir" in whole else whole["event"]
    if kind not in (_DIRECTIONS if "dir" in whole else _EVENTS):
        raise ValueError(f"nothing is {kind!r}")
    more = {key: value for key, value in whole.items() if key not in _NAMED}
    # NaN and infinity pass float() and json, and would break the order of times.
    time_s, decoded = float(whole["t"]), tuple(whole.get("decoded", ()))
    if not math.isfinite(time_s) or not all(isinstance(found, dict) for found in decoded):
        raise ValueError("t is seconds, decoded a list of objects")
    connection, data = str(whole.get("connection", "")), bytes.fromhex(whole.get("bytes", ""))
    return Entry(time_s, kind, connection, data, decoded, more, number)


# -- entries as text --------------------------------------------------------------------------------------------------

# Places in the State vector (docs/protocol.md).
_POSE: Final = ((34, "x"), (35, "y"), (36, "steer"), (37, "turret"))
_SONARS, _INFRAREDS, _SPEEDS = slice(17, 33), slice(1, 17), slice(38, 41)
_BUMPER, _COMPASS = 33, 43
_OPEN_KEYS: Final = ("wire", "model")
_ARROWS: Final = {OUT: ">", IN: "<"}
_SHOWN: Final[Mapping[str, tuple[str, ...]]] = {
    "state": ("pose", "v", "sonar", "infrared", "bumper", "compass", "laser", "clock", "volts"),
    "sonar": ("sonar", "clock"), "infrared": ("infrared", "clock"), "bumper": ("bumper", "clock"),
    "compass": ("compass", "clock"), "configuration": ("pose",), "velocity": ("v",), "laser": ("laser", "clock"),
}  # fmt: skip
"""Parts of a reply that are shown, by kind of reply."""
DecodedFrame = Mapping[str, Any]


def format_entry(entry: Entry, with_bytes: bool = False) -> Iterator[str]:
    """Yield the text lines of an entry, none for an entry about time.

    Parameters
    ----------
    entry
        An entry of a recording.
    with_bytes
        True to add a line with the bytes.

    Raises
    ------
    RecordingError
        If `decoded` does not have the form that a recorder writes.
    """
    # The text of a recording may come from anywhere, and goes to a terminal.
    return map(escape_controls, _entry_lines(entry, with_bytes))


def escape_controls(text: str) -> str:
    r"""Return the text with control characters as escapes, such as \x1b."""
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def _entry_lines(entry: Entry, with_bytes: bool) -> Iterator[str]:
    start = f"{entry.time_s:10.3f}  {entry.connection + ' ' if entry.connection else ''}"
    if entry.kind not in _ARROWS:
        if entry.kind != TIME:
            values = (str(entry.more[name]) for name in _OPEN_KEYS if name in entry.more)
            yield " ".join((f"{start}--", entry.kind, *values))
        return
    for frame in entry.decoded:
        yield f"{start}{_ARROWS[entry.kind]} {_format_checked(entry, frame)}"
    if with_bytes and entry.data:
        yield f"{start}{_ARROWS[entry.kind]} [{entry.data.hex(' ')}]"


def _format_checked(entry: Entry, frame: DecodedFrame) -> str:
    # The file may come from another program, so that any key may be missing or have another type.
    try:
        return format_frame(frame)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise RecordingError(f"line {entry.line}: `decoded` is not as a recorder writes it ({error!r:.80}); "
                             "take it out of that line, the bytes are enough") from None


def format_frame(frame: DecodedFrame) -> str:
    """Return a decoded frame as text."""
    if "error" in frame:
        return f"! {frame['error']}"
    if "call" in frame:
        return " ".join((str(frame["call"]), *map(str, frame["args"]), *_format_extra_arguments(frame)))
    # The parts that this kind of reply carries; others would be repeated from older replies.
    kind = str(frame["reply"])
    parts = [part for name in _SHOWN.get(kind, ()) if (part := _format_part(name, frame["State"], frame))]
    if kind not in _SHOWN and "values" in frame:
        parts = [" ".join(map(str, frame["values"]))]
    # "sonar 12 34 ..." rather than "sonar sonar 12 34 ...".
    is_named = any(part.startswith(f"{kind} ") for part in parts)
    return " ".join(parts if is_named else (kind, *parts))


def _format_extra_arguments(frame: DecodedFrame) -> Iterator[str]:
    if "mask" in frame:
        yield "mask " + "".join(map(str, frame["mask"]))
    yield from (f"({name} {frame[name]})" for name in ("pid", "packet_type") if name in frame)


def _format_part(name: str, state: list[Any], frame: DecodedFrame) -> str:
    """Return one part of a reply in inches, degrees, seconds and volts; "" if the reply does not have it."""
    match name:
        case "pose":
            return " ".join(f"{label} {state[slot] / 10:g}" for slot, label in _POSE if state[slot] is not None)
        case "v":
            return _format_list("v", [None if v is None else v / 10 for v in state[_SPEEDS]])
        case "sonar":
            return _format_list("sonar", state[_SONARS])
        case "infrared":
            return _format_list("infrared", state[_INFRAREDS])
        case "bumper":
            return "" if state[_BUMPER] is None else f"bumper {state[_BUMPER]:#x}"
        case "compass":
            return "" if state[_COMPASS] is None else f"compass {state[_COMPASS] / 10:g}"
        case "laser":
            return f"laser {frame['Laser'][0]} readings" if frame["Laser"] and frame["Laser"][0] else ""
        case "clock":
            return "" if frame["clock"] is None else f"clock {frame['clock'] / 1000:g}"
        case _:
            return "" if frame["volt_cpu"] is None else f"volts {frame['volt_cpu']:.1f} {frame['volt_motor']:.1f}"


def _format_list(name: str, values: list[float | None]) -> str:
    return "" if None in values else f"{name} {' '.join(f'{value:g}' for value in values if value is not None)}"
