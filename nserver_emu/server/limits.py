"""Limits per client: one table from which the options, docs/limits.md and the tests are derived.

A new limit is a new field of `Limits`, with its effect and the module that enforces it. `make_room` raises the
process's limit of open files to what the limits on connections need.
"""

import argparse
import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Final, NamedTuple

from nclient.protocol.codec import MAX_UNKNOWN_WORDS

_LIMIT: Final = "limit"
# Connections that a browser opens for a page at once: six for files, and the websocket.
CONNECTIONS_PER_PAGE: Final = 7
# Maximum size of a snapshot. With default limits it takes a few MB; with a million shapes 200 MB.
SNAPSHOT_BYTES: Final = 1 << 29
# Value that disables a limit, where that is allowed.
NONE: Final = 0


class Limit(NamedTuple):
    """A limit: field, default, range, unit, subject, effect when exceeded, and the module that enforces it."""

    name: str
    default: int
    min: int
    max: int
    unit: str
    guards: str
    reached: str
    where: str
    may_be_none: bool = False

    @property
    def option(self) -> str:
        """Return the command-line option."""
        return f"--limit-{self.name.replace('_', '-')}"


def _limit(
    default: int, bounds: tuple[int, int], unit: str, guards: str, reached: str, where: str, none: bool = False
) -> int:
    return field(default=default, metadata={_LIMIT: (*bounds, unit, guards, reached, where, none)})


@dataclass(frozen=True, slots=True)
class Limits:
    """Values of all limits."""

    connections: int = _limit(
        500, (1, 100_000), "connections", "clients, and hosts of serial lines over TCP, in total",
        "the longest idle connection is closed for a new one; else see below", "server/admission.py")
    per_address: int = _limit(
        300, (1, 100_000), "connections", "clients, and hosts of serial lines over TCP, from one address",
        "the longest idle connection is closed for a new one; else see below", "server/admission.py")
    rate: int = _limit(
        10_000, (10, 1_000_000), "requests per second", "replies to one connection",
        "requests are read and answered later, as over a slow network; nothing is lost or refused",
        "server/connection.py", none=True)
    frame: int = _limit(
        254, (17, 254), "words", "length of a request; only texts and arm packets are long",
        "ERROR 2; the request is skipped and the connection continues; a request above "
        f"{MAX_UNKNOWN_WORDS} words closes it", "server/session.py")
    idle: int = _limit(
        14_400, (1, 31_536_000), "seconds", "time without requests from a connection that waits for no reply",
        "it is closed; robots that it drives stop", "server/admission.py", none=True)
    stall: int = _limit(
        30, (1, 86_400), "seconds", "time for an incomplete request, or for replies that are not read",
        "it is closed; robots that it drives stop", "server/admission.py", none=True)
    write_queue: int = _limit(
        65_536, (1024, 16_777_216), "bytes", "replies queued for a slow reader",
        "its requests are not processed until it has read most of the replies", "server/connection.py")
    viewers: int = _limit(
        50, (1, 1000), "pages",
        "open viewer pages, as many rosbridge clients, and as many publishers of velocities in ROS 2",
        "the page's websocket is refused with HTTP 503 and retried by the page. The port accepts "
        f"{CONNECTIONS_PER_PAGE} times as many connections; idle ones are closed as by --limit-stall",
        "viewer/server.py")
    page_rate: int = _limit(
        200, (10, 1_000_000), "messages per second", "messages of one page or rosbridge client, and HTTP requests of "
        "one address to their port", "they are handled later; only a rosbridge client's velocities are refused if they "
        "are late by 0.5 s", "viewer/http_port.py", none=True)
    obstacles: int = _limit(
        1000, (1, 100_000), "polygons", "obstacles in the world, and as many inner walls drawn at run time",
        "ERROR 5 to add_obstacle, an error at the page", "server/handlers/world.py")
    graphics: int = _limit(
        20_000, (1, 1_000_000), "shapes", "shapes drawn by draw_robot, draw_line and draw_arc",
        "the oldest shape is removed", "server/handlers/graphics.py")
    log: int = _limit(
        1_000_000_000, (10_000, 10**15), "bytes", "file of --record",
        "the recording ends, is valid up to there, and the daemon logs it once; the run continues",
        "nclient/recording/format.py", none=True)

    @property
    def page_connections(self) -> int:
        """Return the maximum number of connections to the viewer's port."""
        return CONNECTIONS_PER_PAGE * self.viewers


TABLE: Final[tuple[Limit, ...]] = tuple(
    Limit(row.name, int(getattr(Limits(), row.name)), *row.metadata[_LIMIT]) for row in fields(Limits)
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add an option for each limit."""
    group = parser.add_argument_group("limits", "limits per client; docs/limits.md describes the effects")
    for row in TABLE:
        none = f"; {NONE}: no limit" if row.may_be_none else ""
        group.add_argument(row.option, type=_reader(row), default=row.default, metavar="N",
                           help=f"at most N {row.unit}: {row.guards} (default: {row.default}{none})")


def limits_of(options: argparse.Namespace) -> Limits:
    """Return the limits that the options set."""
    return Limits(**{row.name: getattr(options, f"{_LIMIT}_{row.name}") for row in TABLE})


def _reader(row: Limit) -> Callable[[str], int]:
    def read(text: str) -> int:
        number = int(text) if text.isdecimal() else -1
        if not row.min <= number <= row.max and not (row.may_be_none and number == NONE):
            none = f", or {NONE} for none" if row.may_be_none else ""
            raise argparse.ArgumentTypeError(f"{row.min} to {row.max} {row.unit}{none}, not {text!r}")
        return number

    return read


log = logging.getLogger(__name__)

# File descriptors of the daemon itself: ports, logs, recordings, lines, event loop.
OTHER_DESCRIPTORS: Final = 64
# Connections that are accepted however few files the process may have open.
MIN_CONNECTIONS: Final = 16


def make_room(connections: int) -> int:
    """Raise the limit of open files for that many connections, and return for how many there is room.

    Logs a warning if these are fewer.
    """
    try:
        import resource
    except ImportError:
        return connections
    wanted = connections + OTHER_DESCRIPTORS
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return connections
    may = wanted if hard == resource.RLIM_INFINITY else min(hard, wanted)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (may, hard))
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < wanted:
        log.warning("this process may have %d files open, and --limit-connections and --limit-viewers allow %d: raise "
                    "the limit (ulimit -n, LimitNOFILE=) or lower the options", soft, connections)  # fmt: skip
    return max(MIN_CONNECTIONS, min(connections, soft - OTHER_DESCRIPTORS))
