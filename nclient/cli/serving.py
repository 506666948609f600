"""What commands that let others in have in common: the door's options, and one visitor after the other.

    visitors(door, ...) ──> talk(peer, turn)      turn.over(): he said nothing for too long, and another wants to

Rules: one line on stdout when the door is open, `listening NAME HOST:PORT` or `listening NAME PATH`; everything else
goes to stderr. Loopback unless told otherwise: what speaks to a robot asks nobody who he is.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from nclient.cli.idle import NONE, SILENT_S, IdleTimer
from nclient.common import allowlist
from nclient.common.arguments import seconds
from nclient.transports.listener import Listener, PtyListener, TcpListener
from nclient.transports.stream import ByteStream

LOOPBACK = "127.0.0.1"
LOOK_S = 0.2
"""How often one looks who else has come."""


def add_door(parser: argparse.ArgumentParser) -> None:
    """--listen, --link, --bind, --allow, --limit-silent, --once."""
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--listen", type=_port, metavar="PORT", help="let others in at a TCP port; 0 takes a free one")
    where.add_argument("--link", type=Path, metavar="PATH", help="... or at a pseudo-terminal that PATH is a link to")
    parser.add_argument("--bind", default=LOOPBACK, metavar="HOST", help=f"address of the port (default {LOOPBACK})")
    allowlist.add_options(parser)
    parser.add_argument("--limit-silent", type=seconds, default=SILENT_S, metavar="S",
                        help="seconds: a visitor who says nothing and waits for nothing; he makes room for another who "
                        f"has something to say (default {SILENT_S:g}; {NONE:g}: no limit)")
    parser.add_argument("--once", action="store_true", help="end when the first visitor leaves")


@contextlib.contextmanager
def open_door(options: argparse.Namespace, name: str, may: str = allowlist.DRIVES) -> Iterator[Listener]:
    """The door that the options ask for, announced; SIGTERM and SIGHUP close it as Ctrl-C does.

    `may`: what those who come in may do, for the warning where it is open to the network.
    """
    door: Listener = _port_door(options, may) if options.link is None else PtyListener(options.link)
    try:
        with _ended_by_signals():
            print(f"listening {name} {door.name}", flush=True)
            yield door
    finally:
        door.close()


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """They are as Ctrl-C; a command runs on the main thread, which gets the signals."""
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows has no SIGHUP
    before = {name: signal.signal(getattr(signal, name), signal.default_int_handler) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def _port_door(options: argparse.Namespace, may: str) -> TcpListener:
    rule = allowlist.allowlist_from_options(options)
    told: set[str] = set()

    def turned_away(host: str, reason: str) -> None:
        if reason not in told:
            told.add(reason)
            tell(f"{host}: turned away: {reason} (of further ones nothing is said)")

    door = TcpListener(options.bind, options.listen,
                   lambda host, at: "" if rule.allows(host, at) else allowlist.NOT_ALLOWED, turned_away)
    if open_to := allowlist.warning(options.bind, rule, may):
        tell(open_to)
    return door


class Turn:
    """One visitor's time. `silence`: his; `wanted`: whether another has something to say; `made_room`: it was over."""

    def __init__(
        self, limit_s: float, wanted: Callable[[], bool], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.silence = IdleTimer(limit_s, clock)
        self._limit_s, self._wanted, self._clock = limit_s, wanted, clock
        self._looked_s = -math.inf
        self._is_wanted = False
        self.made_room = False

    def over(self, at_rest: bool) -> bool:
        """Whether another's turn has come, which is told. `at_rest`: nothing of this one's is left to be read."""
        if self._clock() - self._looked_s >= LOOK_S:
            self._looked_s, self._is_wanted = self._clock(), self._wanted()
        if not (at_rest and self._is_wanted and self.silence.expired):
            return False
        tell(f"a visitor who said nothing for {self._limit_s:g} s makes room for another (--limit-silent)")
        self.made_room = True
        return True


def visitors(door: Listener, options: argparse.Namespace, talk: Callable[[ByteStream, Turn], None]) -> None:
    """Talk with one after the other, for ever or (--once) until one leaves by himself."""
    while True:
        peer = door.accept()
        try:
            talk(peer, turn := Turn(options.limit_silent, door.has_pending_request))
        finally:
            peer.close()
        if options.once and not turn.made_room:
            return


def tell(text: str) -> None:
    """A line for whoever watches."""
    print(f"nomad: {text}", file=sys.stderr, flush=True)


def _port(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"a port is 0 to 65535, not {text}")
    return int(text)
