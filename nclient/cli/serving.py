"""Common parts of commands that accept connections: options, listener, idle limit, one client after another.

    serve_clients(listener, ...) ──> serve(stream, session)      session.should_end(): idle, and another client waits

stdout gets one line when the listener is open, `listening NAME HOST:PORT` or `listening NAME PATH`; messages go to
stderr. The default is loopback only, because the robot protocols have no authentication.
"""

import argparse
import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from nclient.backends.nserver import CLICK_S, ORDINARY_S
from nclient.common import allowlist
from nclient.common.arguments import add_flag, add_value, seconds, whole_number
from nclient.common.process import TerminatedBySignal
from nclient.protocol.commands import BY_NAME
from nclient.protocol.types import Model
from nclient.recording.replayer import RequestKey, RequestReader
from nclient.transports.listener import Listener, PtyListener, TcpListener
from nclient.transports.stream import ByteStream

POLL_INTERVAL_S = 0.2
"""Interval of checks for other clients."""
DEFAULT_IDLE_LIMIT_S: Final = 5.0
"""Default idle limit: the motion timeout that connect() sets, after which a robot without its program stops."""
NO_LIMIT: Final = 0.0
"""Idle limit of a client that may be idle forever."""


# -- options and listener ---------------------------------------------------------------------------------------------


def add_listener_options(parser: argparse.ArgumentParser) -> None:
    """Add --listen, --link, --bind, --allow, --limit-silent and --once."""
    place = parser.add_mutually_exclusive_group(required=True)
    port = whole_number("a port", 0, 65535)
    add_value(place, "--listen", "PORT", port, "listen on this TCP port; 0 takes a free one")
    add_value(place, "--link", "PATH", Path, "create a pseudo-terminal, with PATH as a link to it")
    parser.add_argument("--bind", default=allowlist.LOOPBACK, metavar="HOST",
                        help=f"listen on this address (default: {allowlist.LOOPBACK})")
    allowlist.add_options(parser)
    add_value(parser, "--limit-silent", "S", seconds,
              "disconnect a client that is idle for S seconds when another client waits with a request "
              f"(default: {DEFAULT_IDLE_LIMIT_S:g}; {NO_LIMIT:g}: no limit)", DEFAULT_IDLE_LIMIT_S)
    add_flag(parser, "--once", "exit when the first client disconnects")


SIGNALS: Final = (KeyboardInterrupt, TerminatedBySignal)
"""What Ctrl-C, SIGTERM and SIGHUP raise: the usual end of a command that serves."""


@contextlib.contextmanager
def open_listener(options: argparse.Namespace, name: str, may: str = allowlist.DRIVES) -> Iterator[Listener]:
    """Open the listener that the options select and announce it.

    Parameters
    ----------
    options
        Parsed options of `add_listener_options`.
    name
        Name of the command in the announcement.
    may
        What clients may do, for the warning about listening on the network.
    """
    listener: Listener = _open_port(options, may) if options.link is None else PtyListener(options.link)
    with contextlib.closing(listener):
        print(f"listening {name} {listener.name}", flush=True)
        yield listener


def _open_port(options: argparse.Namespace, may: str) -> TcpListener:
    allowed = allowlist.allowlist_from_options(options)
    reported: set[str] = set()

    def report_rejection(host: str, reason: str) -> None:
        if reason not in reported:
            reported.add(reason)
            print_message(f"{host}: rejected: {reason} (further ones are not reported)")

    def refusal(host: str, at: str) -> str:
        return "" if allowed.allows(host, at) else allowlist.NOT_ALLOWED

    listener = TcpListener(options.bind, options.listen, refusal, report_rejection)
    if warning := allowlist.warning(options.bind, allowed, may):
        print_message(warning)
    return listener


# -- idle clients -----------------------------------------------------------------------------------------------------


class IdleTimer:
    """Idle time of a client; a client that waits for a slow reply (ws, zr) is not idle.

    Parameters
    ----------
    limit_s
        Idle time after which the timer expires, or NO_LIMIT.
    clock
        Returns seconds.
    """

    def __init__(self, limit_s: float, clock: Callable[[], float]) -> None:
        self._limit_s, self._clock = limit_s, clock
        self._expires_s = clock() + limit_s
        self._waiting = False

    def request_received(self, reply_s: float = 0.0) -> None:
        """Restart the timer at data from the client; the reply may take `reply_s` besides the usual latency."""
        # Never earlier than before: a quick request after a slow one must not shorten its time.
        self._expires_s = max(self._expires_s, self._clock() + self._limit_s + reply_s)
        self._waiting = self._waiting or reply_s > 0

    def reply_received(self) -> None:
        """Restart the timer at the reply to a slow request; other replies do not count as activity."""
        if self._waiting:
            self._waiting = False
            self._expires_s = self._clock() + self._limit_s

    @property
    def expired(self) -> bool:
        """Return True if the client was idle for longer than the limit."""
        return self._limit_s != NO_LIMIT and self._clock() >= self._expires_s


class IdleMonitor:
    """Updates an IdleTimer from forwarded traffic; each direction may be called from a thread of its own.

    Parameters
    ----------
    timer
        The client's timer.
    line
        Protocol, one of `recorder.LINES`.
    model
        Model of the robot.
    """

    def __init__(self, timer: IdleTimer, line: str, model: Model) -> None:
        self._timer = timer
        self._reader = RequestReader(line, model)
        self._lock = threading.Lock()

    def to_robot(self, data: bytes) -> None:
        """Process bytes from the client."""
        with self._lock:
            self._timer.request_received(max(map(_reply_time_s, self._reader.receive(data)), default=0.0))

    def to_host(self, data: bytes) -> None:
        """Process bytes from the robot; only a valid frame counts as a reply."""
        with self._lock:
            # Noise on a line is not a sign of life.
            if not all(frame.error for frame in self._reader.tap.to_host(data)):
                self._timer.reply_received()


def _reply_time_s(request: RequestKey) -> float:
    """Return the maximum time of a slow reply, 0 for a command with an immediate reply."""
    # ws and get_robot_conf reply late by design: ws states its timeout in s, the other waits for a click.
    if request.name == "ws":
        return float(max(0, request.args[-1]))
    if request.name == "get_robot_conf":
        return CLICK_S
    row = BY_NAME.get(request.name)
    return row.line_timeout_s if row and row.line_timeout_s > ORDINARY_S else 0.0


# -- clients, one after another ---------------------------------------------------------------------------------------


class ClientSession:
    """Limits of one client's connection.

    Parameters
    ----------
    limit_s
        Idle limit, or NO_LIMIT.
    has_waiting_client
        Returns True if another client has sent a request.
    clock
        Returns seconds.
    """

    def __init__(
        self, limit_s: float, has_waiting_client: Callable[[], bool], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.idle_timer = IdleTimer(limit_s, clock)
        self._limit_s, self._has_waiting_client, self._clock = limit_s, has_waiting_client, clock
        self._polled_s = -math.inf
        self._client_waits = False
        self.was_idle = False

    def should_end(self, at_rest: bool) -> bool:
        """Return True, with a message, if the client is idle and another one waits.

        `at_rest` is False while there is data of this client to process.
        """
        # Checking for other clients is a system call for each: not at every turn.
        if self._clock() - self._polled_s >= POLL_INTERVAL_S:
            self._polled_s, self._client_waits = self._clock(), self._has_waiting_client()
        if not (at_rest and self._client_waits and self.idle_timer.expired):
            return False
        print_message(f"a client idle for {self._limit_s:g} s was disconnected for another one (--limit-silent)")
        self.was_idle = True
        return True


def serve_clients(
    listener: Listener, options: argparse.Namespace, serve: Callable[[ByteStream, ClientSession], None]
) -> None:
    """Serve one client after another, forever or, with --once, until one disconnects by itself."""
    while True:
        # One client at a time: two programs would disturb each other on one robot.
        stream = listener.accept()
        try:
            serve(stream, session := ClientSession(options.limit_silent, listener.has_pending_request))
        finally:
            stream.close()
        if options.once and not session.was_idle:
            return


def print_message(text: str) -> None:
    """Print a message to stderr."""
    print(f"nomad: {text}", file=sys.stderr, flush=True)
