"""Limits per client: one table from which the options, docs/limits.md and the tests are derived.

A new limit is a new field of `Limits`, with its effect and the module that enforces it. `make_room` raises the
process's limit of open files to what the limits on connections need.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Final, NamedTuple

from nclient.protocol.tcp_framing import MAX_UNKNOWN_WORDS

log = logging.getLogger(__name__)

# Key of a field's metadata, and prefix of the options.
_LIMIT: Final = "limit"
# Connections that a browser opens for a page at the same time: six for its files, and the websocket.
CONNECTIONS_PER_PAGE: Final = 7
# Maximum size of a snapshot. With the default limits one has a few MB, with a million shapes 200.
SNAPSHOT_BYTES: Final = 1 << 29
# The value that disables a limit, for those that can be disabled.
NONE: Final = 0
# Files and sockets of the process besides connections: ports, logs, recordings, lines, the event loop.
OTHER_DESCRIPTORS: Final = 64


class Limit(NamedTuple):
    """A limit as a row of the table."""

    name: str
    default: int
    min: int
    max: int
    unit: str
    # What it applies to, what happens beyond it, and the module that enforces it.
    guards: str
    reached: str
    where: str
    # True if 0 disables it.
    may_be_none: bool = False

    @property
    def option(self) -> str:
        """The command-line option."""
        return f"--limit-{self.name.replace('_', '-')}"


def _limit(
    default: int, bounds: tuple[int, int], unit: str, guards: str, reached: str, where: str, none: bool = False
) -> int:
    row: int = field(default=default, metadata={_LIMIT: (*bounds, unit, guards, reached, where, none)})
    return row


@dataclass(frozen=True, slots=True)
class Limits:
    """A value for each limit."""

    connections: int = _limit(
        500, (1, 100_000), "connections", "clients and hosts of robots' own lines over TCP together",
        "a new connection is closed at once without a reply", "server/admission.py")
    per_address: int = _limit(
        300, (1, 100_000), "connections", "the same, from one address",
        "a new connection is closed at once without a reply", "server/admission.py")
    rate: int = _limit(
        10_000, (10, 1_000_000), "requests a second", "replies to one connection",
        "its requests are read and answered later, as over a slow network; none is lost or refused",
        "server/admission.py", none=True)
    frame: int = _limit(
        254, (17, 254), "words", "length of a request; only text and packets for the arm are that long",
        "ERROR 2; the request is skipped and the connection continues; more than "
        f"{MAX_UNKNOWN_WORDS} words close it", "server/session.py")
    idle: int = _limit(
        14_400, (1, 31_536_000), "seconds", "a connection that sends nothing and waits for no reply",
        "it is closed, and its motions stop", "server/admission.py", none=True)
    stall: int = _limit(
        30, (1, 86_400), "seconds", "an incomplete request, or replies that are not read",
        "the connection is closed, and its motions stop", "server/admission.py", none=True)
    write_queue: int = _limit(
        65_536, (1024, 16_777_216), "bytes", "replies that a slow client has not read yet",
        "the connection is neither read nor answered until most of them are read", "server/connection.py")
    viewers: int = _limit(
        50, (1, 1000), "pages", "pages open at the same time",
        "the websocket of the page is refused with HTTP 503, and the page tries again; its port accepts "
        f"{CONNECTIONS_PER_PAGE} times as many connections, and --limit-stall closes those without a request",
        "viewer/server.py")
    obstacles: int = _limit(
        1000, (1, 100_000), "polygons", "obstacles in the world that clients may add to",
        "ERROR 5 to add_obstacle", "server/handlers/world.py")
    graphics: int = _limit(
        20_000, (1, 1_000_000), "shapes", "shapes of draw_robot, draw_line and draw_arc in the window",
        "the oldest shape is removed", "server/handlers/graphics.py")
    log: int = _limit(
        1_000_000_000, (10_000, 10**15), "bytes", "the file of --record",
        "the recording ends there and is complete so far; nserver logs it once and continues",
        "nclient/recording/format.py", none=True)

    @property
    def page_connections(self) -> int:
        """Maximum number of connections to the viewer's port."""
        return CONNECTIONS_PER_PAGE * self.viewers


TABLE: Final[tuple[Limit, ...]] = tuple(
    Limit(row.name, int(getattr(Limits(), row.name)), *row.metadata[_LIMIT]) for row in fields(Limits)
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add an option for each limit."""
    group = parser.add_argument_group("limits", "limits per client; the effect of each is in docs/limits.md")
    for row in TABLE:
        none = f"; {NONE}: no limit" if row.may_be_none else ""
        group.add_argument(row.option, type=_parser_for(row), default=row.default, metavar="N",
                           help=f"{row.unit}: {row.guards} (default {row.default}{none})")


def limits_of(options: argparse.Namespace) -> Limits:
    """Return the limits from parsed options."""
    return Limits(**{row.name: getattr(options, f"{_LIMIT}_{row.name}") for row in TABLE})


def _parser_for(row: Limit) -> Callable[[str], int]:
    """Return a function that parses the value of a limit."""

    def parse(text: str) -> int:
        number = int(text) if text.isdecimal() else -1
        if not row.min <= number <= row.max and not (row.may_be_none and number == NONE):
            none = f", or {NONE} for none" if row.may_be_none else ""
            raise argparse.ArgumentTypeError(f"{row.min} to {row.max} {row.unit}{none}, not {text!r}")
        return number

    return parse


def make_room(connections: int) -> None:
    """Raise the process's limit of open files for this many connections, and warn if that is not permitted."""
    try:
        import resource
    except ImportError:
        # Windows has no such limit.
        return
    needed = connections + OTHER_DESCRIPTORS
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    new_soft = needed if hard == resource.RLIM_INFINITY else min(hard, needed)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (new_soft, hard))
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < needed:
        log.warning("this process may have %d files open, fewer than --limit-connections and --limit-viewers need "
                    "(%d): raise the limit (ulimit -n, LimitNOFILE=) or lower the options", soft, needed)  # fmt: skip
