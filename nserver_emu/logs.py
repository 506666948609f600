"""What the daemon writes to stderr: lines for people, or an object a line for programs that collect logs.

    {"time": "2026-11-21T10:27:45.123Z", "level": "warning", "logger": "nserver_emu.server.session",
     "message": "127.0.0.1:4711: refused: ...", "template": "%s: refused: %s ..."}        and "exception" where one was

Rules: options and forms only; who logs what is each room's own. `template` is the same for all lines of one kind, so
that they can be counted; what a room adds by `extra=` stands beside it. The line stays one line whatever it says.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from datetime import UTC, datetime
from typing import Any, Final

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
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if options.log_format == JSON else TextLines())
    logging.basicConfig(level=level_of(options), handlers=[handler])
    logging.captureWarnings(True)


def level_of(options: argparse.Namespace) -> int:
    """The least that is said: --log-level, or what so many -v ask for."""
    if options.log_level:
        return LEVELS[options.log_level]
    return (logging.WARNING, logging.INFO, logging.DEBUG)[min(options.verbose, 2)]


def tell_failure(options: argparse.Namespace, error: Exception) -> None:
    """Why the daemon ends, as its last line."""
    if options.log_format == JSON:
        logging.getLogger(__package__).critical("%s", error)
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
