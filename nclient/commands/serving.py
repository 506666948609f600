"""What commands that let others in have in common: the door's options, and one visitor after the other.

Rules: one line on stdout when the door is open, `listening NAME HOST:PORT` or `listening NAME PATH`; everything else
goes to stderr. Loopback unless told otherwise: what speaks to a robot asks nobody who he is.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from nclient.transports.byte_stream import ByteStream
from nclient.transports.door import Door, TcpDoor, TerminalDoor

LOOPBACK = "127.0.0.1"


def add_door(parser: argparse.ArgumentParser) -> None:
    """--listen, --link, --bind, --once."""
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--listen", type=_port, metavar="PORT", help="let others in at a TCP port; 0 takes a free one")
    where.add_argument("--link", type=Path, metavar="PATH", help="... or at a pseudo-terminal that PATH is a link to")
    parser.add_argument("--bind", default=LOOPBACK, metavar="HOST", help=f"address of the port (default {LOOPBACK})")
    parser.add_argument("--once", action="store_true", help="end when the first visitor leaves")


@contextlib.contextmanager
def open_door(options: argparse.Namespace, name: str) -> Iterator[Door]:
    """The door that the options ask for, announced; SIGTERM and SIGHUP close it as Ctrl-C does."""
    door: Door = TcpDoor(options.bind, options.listen) if options.link is None else TerminalDoor(options.link)
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


def visitors(door: Door, once: bool, talk: Callable[[ByteStream], None]) -> None:
    """Talk with one after the other, for ever or once."""
    while True:
        peer = door.peer()
        try:
            talk(peer)
        finally:
            peer.close()
        if once:
            return


def tell(text: str) -> None:
    """A line for whoever watches."""
    print(f"nomad: {text}", file=sys.stderr, flush=True)


def _port(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"a port is 0 to 65535, not {text}")
    return int(text)
