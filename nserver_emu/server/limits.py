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

_LIMIT: Final = "limit"
FOR_A_PAGE: Final = 7
"""Connections that a browser opens for a page at the same time: six for its files, and the websocket."""
SNAPSHOT_BYTES: Final = 1 << 29
"""The longest snapshot. One with the limits' defaults takes a few MB; a million shapes take 200."""
NONE: Final = 0
"""The value that lets go of a limit, for those that may be let go."""


class Limit(NamedTuple):
    """A row: the field and its option, the default, least and most, the unit, who enforces it, what happens."""

    name: str
    default: int
    least: int
    most: int
    unit: str
    guards: str
    reached: str
    where: str
    may_be_none: bool = False

    @property
    def option(self) -> str:
        """As it is said on the command line."""
        return f"--limit-{self.name.replace('_', '-')}"


def _limit(
    default: int, bounds: tuple[int, int], unit: str, guards: str, reached: str, where: str, none: bool = False
) -> int:
    found: int = field(default=default, metadata={_LIMIT: (*bounds, unit, guards, reached, where, none)})
    return found


@dataclass(frozen=True, slots=True)
class Limits:
    """A value for each limit."""

    connections: int = _limit(
        500, (1, 100_000), "connections", "clients and hosts of robots' own lines over TCP, all together",
        "the newcomer is closed at once, without a word", "server/admission.py")
    per_address: int = _limit(
        300, (1, 100_000), "connections", "the same, from one address",
        "the newcomer is closed at once, without a word", "server/admission.py")
    rate: int = _limit(
        10_000, (10, 1_000_000), "requests a second", "answers that one connection gets",
        "it is read and answered later, as if the network were slow; nothing is lost or refused",
        "server/admission.py", none=True)
    frame: int = _limit(
        254, (17, 254), "words", "the longest request, which only text and packets for the arm reach",
        "ERROR 2; the request is passed over, the connection goes on; one of more than "
        f"{MAX_UNKNOWN_WORDS} words ends it", "server/session.py")
    idle: int = _limit(
        14_400, (1, 31_536_000), "seconds", "a connection that says nothing and waits for nothing",
        "it is closed; what it drove stops", "server/admission.py", none=True)
    stall: int = _limit(
        30, (1, 86_400), "seconds", "a request begun and not finished; replies that are not taken",
        "it is closed; what it drove stops", "server/admission.py", none=True)
    write_queue: int = _limit(
        65_536, (1024, 16_777_216), "bytes", "replies that wait for a slow reader",
        "it is neither read nor answered until it has taken most of them", "server/connection.py")
    viewers: int = _limit(
        50, (1, 1000), "pages", "pages that are open at the same time",
        "the page's websocket is refused with HTTP 503; it asks again by itself. Of connections to its port there are "
        f"{FOR_A_PAGE} times as many; who asks nothing is closed as by --limit-stall", "viewer/server.py")
    obstacles: int = _limit(
        1000, (1, 100_000), "polygons", "obstacles in the world that clients may add to",
        "ERROR 5 to add_obstacle", "server/handlers/world.py")
    graphics: int = _limit(
        20_000, (1, 1_000_000), "shapes", "what draw_robot, draw_line and draw_arc leave in the window",
        "the oldest shape is forgotten for the new one", "server/handlers/graphics.py")
    log: int = _limit(
        1_000_000_000, (10_000, 10**15), "bytes", "the file of --record",
        "the recording ends there, whole, and the daemon says so once; the run goes on", "nclient/recording/format.py",
        none=True)

    @property
    def page_connections(self) -> int:
        """Connections at the page's port."""
        return FOR_A_PAGE * self.viewers


TABLE: Final[tuple[Limit, ...]] = tuple(
    Limit(row.name, int(getattr(Limits(), row.name)), *row.metadata[_LIMIT]) for row in fields(Limits)
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """An option for each limit."""
    group = parser.add_argument_group("limits", "what a client may take; what happens beyond is in docs/limits.md")
    for row in TABLE:
        none = f"; {NONE}: no limit" if row.may_be_none else ""
        group.add_argument(row.option, type=_reader(row), default=row.default, metavar="N",
                           help=f"{row.unit}: {row.guards} (default {row.default}{none})")


def limits_of(options: argparse.Namespace) -> Limits:
    """The limits that the options say."""
    return Limits(**{row.name: getattr(options, f"{_LIMIT}_{row.name}") for row in TABLE})


def _reader(row: Limit) -> Callable[[str], int]:
    def read(text: str) -> int:
        number = int(text) if text.isdecimal() else -1
        if not row.least <= number <= row.most and not (row.may_be_none and number == NONE):
            none = f", or {NONE} for none" if row.may_be_none else ""
            raise argparse.ArgumentTypeError(f"{row.least} to {row.most} {row.unit}{none}, not {text!r}")
        return number

    return read


log = logging.getLogger(__name__)

OWN: Final = 64
"""Descriptors of the daemon's own: ports, logs, recordings, lines, the loop."""


def make_room(connections: int) -> None:
    """Raise the process's own limit as far as it may be; say so where that is not enough for so many connections."""
    try:
        import resource
    except ImportError:
        return
    wanted = connections + OWN
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return
    may = wanted if hard == resource.RLIM_INFINITY else min(hard, wanted)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (may, hard))
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < wanted:
        log.warning("this process may have %d files open, and --limit-connections and --limit-viewers let in %d: raise "
                    "the one (ulimit -n, LimitNOFILE=) or lower the others", soft, connections)  # fmt: skip
