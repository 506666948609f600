"""Logging of the daemon on stderr: lines of text, or one JSON object per line for log collectors.

    {"time": "2026-11-21T10:27:45.123Z", "level": "warning", "logger": "nserver_emu.server.session",
     "message": "127.0.0.1:4711: refused: ...", "template": "%s: refused: %s ..."}        and "exception" for tracebacks

`template` is the same for all lines of one kind, so that they can be counted; fields passed by `extra=` are added. A
message is always one line. Where stderr or stdout is on a full disk the daemon continues: lost lines are counted, and
the count is logged when lines can be written again.
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
# Attributes of every record; the formatter adds two, and newer versions of Python taskName.
_STANDARD_FIELDS: Final = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --log-format, --log-level and -v."""
    parser.add_argument("--log-format", choices=(TEXT, JSON), default=TEXT,
                        help="format of stderr: text (default), or json, one object per line")
    parser.add_argument("--log-level", choices=tuple(LEVELS),
                        help="lowest level that is logged on stderr (default warning; -v info, -vv debug)")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="log more on stderr (-vv: everything)")


def configure(options: argparse.Namespace) -> None:
    """Configure logging, Python's warnings included; do nothing in a program that has configured it already."""
    # A program that embeds the daemon decides about logging itself.
    if logging.getLogger().handlers:
        return
    handler = LossCountingHandler(_unbuffered(sys.stderr))
    handler.setFormatter(JsonFormatter() if options.log_format == JSON else TextFormatter())
    logging.basicConfig(level=level_of(options), handlers=[handler])
    logging.captureWarnings(True)


def level_of(options: argparse.Namespace) -> int:
    """Return the lowest level that is logged: --log-level, or by the number of -v."""
    if options.log_level:
        return LEVELS[options.log_level]
    return (logging.WARNING, logging.INFO, logging.DEBUG)[min(options.verbose, 2)]


def print_line(line: str) -> None:
    """Print a line for programs on stdout; log an error and continue where it cannot be written."""
    try:
        print(line, flush=True)
    except OSError as error:
        log.error("stdout cannot be written: %s; the daemon goes on; the line was: %s", error.strerror, line)
        with Path(os.devnull).open("w") as null:  # for the buffered text, which Python flushes at exit
            os.dup2(null.fileno(), sys.stdout.fileno())


def log_failure(options: argparse.Namespace, error: Exception) -> None:
    """Report the error that ends the daemon, as its last line."""
    if options.log_format == JSON:
        logging.getLogger(__package__).critical("nserver: %s", error)
    else:
        print(f"nserver: {error}", file=sys.stderr)


def _unbuffered(stream: TextIO) -> TextIO:
    """Return an unbuffered stream to the same file, so that a line is either written or fails."""
    try:
        raw = io.FileIO(stream.fileno(), "w", closefd=False)
    except OSError:  # not a file: a program has replaced the stream
        return stream
    return io.TextIOWrapper(raw, stream.encoding, "backslashreplace", write_through=True)


class LossCountingHandler(logging.StreamHandler[TextIO]):
    """Handler for a stream that may be unwritable for some time."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream)
        self.lost = 0
        """Lines lost since the last line that was written."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, preceded by the number of lost lines, if any."""
        # First the number of lost lines; if that fails, this line is not attempted either.
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

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - name given by logging
        """Count a line that cannot be written; report other errors as logging does."""
        if isinstance(sys.exception(), OSError):
            self.lost += 1
        else:
            super().handleError(record)


class TextFormatter(logging.Formatter):
    """Time, level, message."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(message)s")


class JsonFormatter(logging.Formatter):
    """One JSON object per line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as JSON; values that JSON cannot express become strings."""
        # UTC in milliseconds, with Z instead of +00:00 as log collectors write it.
        at = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").removesuffix("+00:00")
        fields: dict[str, Any] = {
            "time": f"{at}Z", "level": record.levelname.lower(), "logger": record.name,
            "message": record.getMessage(), "template": str(record.msg),
        }  # fmt: skip
        # What is not a standard attribute of a record came by `extra=`.
        fields |= {name: value for name, value in vars(record).items() if name not in _STANDARD_FIELDS}
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
        return json.dumps(fields, default=str)
