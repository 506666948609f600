"""What the daemon writes to stderr: lines for people, or an object a line for programs that collect logs.

    {"time": "2026-11-21T10:27:45.123Z", "level": "warning", "logger": "nserver_emu.server.session",
     "message": "127.0.0.1:4711: refused: ...", "template": "%s: refused: %s ..."}        and "exception" where one was

Rules: options and forms only; who logs what is each room's own. `template` is the same for all lines of one kind, so
that they can be counted; what a room adds by `extra=` stands beside it. The line stays one line whatever it says.
Where stderr or stdout is a disk that is full the daemon goes on: lines that were lost are counted, and told of when
lines can be written again.
"""

from __future__ import annotations

import argparse
import io
import json
import logging
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TextIO

log = logging.getLogger(__name__)

TEXT, JSON = "text", "json"
LEVELS: Final = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
_OWN: Final = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


def add_options(parser: argparse.ArgumentParser) -> None:
    """--log-format, --log-level, -v."""
    parser.add_argument("--log-format", choices=(TEXT, JSON), default=TEXT,
                        help="of stderr: text for people (default), or json, an object a line")
    parser.add_argument("--log-level", choices=tuple(LEVELS),
                        help="say nothing below this on stderr (default warning; -v info, -vv debug)")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more on stderr (-vv: everything)")


def begin(options: argparse.Namespace) -> None:
    """Log as the options say, Python's own warnings as well; not where a program that hosts us has its own way."""
    if logging.getLogger().handlers:
        return
    handler = Lines(_unbuffered(sys.stderr))
    handler.setFormatter(JsonLines() if options.log_format == JSON else TextLines())
    logging.basicConfig(level=level_of(options), handlers=[handler])
    logging.captureWarnings(True)


def level_of(options: argparse.Namespace) -> int:
    """The least that is said: --log-level, or what so many -v ask for."""
    if options.log_level:
        return LEVELS[options.log_level]
    return (logging.WARNING, logging.INFO, logging.DEBUG)[min(options.verbose, 2)]


def tell(line: str) -> None:
    """A line on stdout for programs; where it cannot be written, those who serve go on without."""
    try:
        print(line, flush=True)
    except OSError as error:
        log.error("stdout cannot be written: %s; the daemon goes on; what it had to say: %s", error.strerror, line)
        with Path(os.devnull).open("w") as nowhere:  # what is still kept back goes there at the end
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


def _unbuffered(stream: TextIO) -> TextIO:
    """The same place, with nothing kept back: a line is written or it is not."""
    try:
        raw = io.FileIO(stream.fileno(), "w", closefd=False)
    except OSError:  # it is no file: whoever put it there reads it himself
        return stream
    return io.TextIOWrapper(raw, stream.encoding, "backslashreplace", write_through=True)


class Lines(logging.StreamHandler[TextIO]):
    """Lines on a stream that may refuse them for a while."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream)
        self.lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Write it, and before it how many were lost."""
        if self.lost:
            message = logging.makeLogRecord({
                "name": __name__, "levelno": logging.WARNING, "levelname": "WARNING",
                "msg": "%d lines of this log were lost: it could not be written", "args": (self.lost,),
            })  # fmt: skip
            before = self.lost
            super().emit(message)
            if self.lost > before:
                return
            self.lost = 0
        super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging calls it so
        """A line that cannot be written is counted; a fault in what is logged is shown as ever."""
        if isinstance(sys.exception(), OSError):
            self.lost += 1
        else:
            super().handleError(record)


def tell_failure(options: argparse.Namespace, error: Exception) -> None:
    """Why the daemon ends, as its last line."""
    if options.log_format == JSON:
        logging.getLogger(__package__).critical("nserver: %s", error)
    else:
        print(f"nserver: {error}", file=sys.stderr)


class TextLines(logging.Formatter):
    """Time, level, message."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(message)s")


class JsonLines(logging.Formatter):
    """An object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as JSON; what is no JSON in it as text."""
        at = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").removesuffix("+00:00")
        told: dict[str, Any] = {
            "time": f"{at}Z", "level": record.levelname.lower(), "logger": record.name,
            "message": record.getMessage(), "template": str(record.msg),
        }  # fmt: skip
        told |= {name: value for name, value in vars(record).items() if name not in _OWN}
        if record.exc_info:
            told["exception"] = self.formatException(record.exc_info)
        return json.dumps(told, default=str)
