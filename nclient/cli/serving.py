"""Common parts of commands that accept connections: options, listener, idle limit, one client after another.

    serve_clients(listener, ...) ──> serve(stream, session)      session.should_end(): idle, and another client waits

stdout gets one line when the listener is open, `listening NAME HOST:PORT` or `listening NAME PATH`; messages go to
stderr. The default is loopback only, because the robot protocols have no authentication.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final
from urllib.parse import quote

from nclient.backends.nserver import CLICK_S, ORDINARY_S
from nclient.common.arguments import add_flag, add_value, seconds, whole_number
from nclient.common.process import ExitCode, TerminatedBySignal
from nclient.connector import Connector
from nclient.errors import AddressError, ConnectionLost, RecordingError, ReplyTimeout
from nclient.protocol.commands import BY_NAME
from nclient.protocol.types import Model
from nclient.recording.format import IN, OUT, Entry, format_entry, read_recording
from nclient.recording.recorder import FrameDecoder, RecordingStream
from nclient.recording.replayer import ORDERS, STRICT, Player, ReplyChunk, RequestKey, RequestReader, load_exchanges
from nclient.transports import listener as listening
from nclient.transports.listener import Listener, PtyListener, TcpListener
from nclient.transports.stream import ByteStream, Deadline
from nclient.url import parse_address

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
    parser.add_argument("--bind", default=listening.LOOPBACK, metavar="HOST",
                        help=f"listen on this address (default: {listening.LOOPBACK})")
    listening.add_options(parser)
    add_value(parser, "--limit-silent", "S", seconds,
              "disconnect a client that is idle for S seconds when another client waits with a request "
              f"(default: {DEFAULT_IDLE_LIMIT_S:g}; {NO_LIMIT:g}: no limit)", DEFAULT_IDLE_LIMIT_S)
    add_flag(parser, "--once", "exit when the first client disconnects")


SIGNALS: Final = (KeyboardInterrupt, TerminatedBySignal)
"""What Ctrl-C, SIGTERM and SIGHUP raise: the usual end of a command that serves."""


@contextlib.contextmanager
def open_listener(options: argparse.Namespace, name: str, may: str = listening.DRIVES) -> Iterator[Listener]:
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
    allowed = listening.allowlist_from_options(options)
    reported: set[str] = set()

    def report_rejection(host: str, reason: str) -> None:
        if reason not in reported:
            reported.add(reason)
            print_message(f"{host}: rejected: {reason} (further ones are not reported)")

    def refusal(host: str, at: str) -> str:
        return "" if allowed.allows(host, at) else listening.NOT_ALLOWED

    listener = TcpListener(options.bind, options.listen, refusal, report_rejection)
    if warning := listening.warning(options.bind, allowed, may):
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

    def __init__(self, limit_s: float, has_waiting_client: Callable[[], bool],
                 clock: Callable[[], float] = time.monotonic) -> None:
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


def serve_clients(listener: Listener, options: argparse.Namespace,
                  serve: Callable[[ByteStream, ClientSession], None]) -> None:
    """Serve one client after another, forever or, with --once, until one disconnects by itself."""
    while True:
        # One client at a time: two programs would disturb each other on one robot.
        with contextlib.closing(listener.accept()) as stream:
            serve(stream, session := ClientSession(options.limit_silent, listener.has_pending_request))
        if options.once and not session.was_idle:
            return


def print_message(text: str) -> None:
    """Print a message to stderr."""
    print(f"nomad: {text}", file=sys.stderr, flush=True)


class BridgeCommand:
    """Forward bytes between a TCP port or pseudo-terminal and a robot or Nserver elsewhere, and record them.

        nomad bridge --listen 65001 "serial:///dev/ttyUSB0?baud=38400"    make a robot's cable available on the network
        nomad bridge --link /tmp/robot robotd://lab:65001 --dump          give an old program a port, show the traffic
        nomad bridge --listen 7019 nserver://lab:7019 --record run.log    record the clients of an Nserver

    Address options of the stream (record=, faults=) work here, too; --record and --dump are shortcuts.

    Rules: bytes are forwarded unchanged, for one client at a time. The far end is opened at the start, so that a
    wrong address is reported at once, and again for each further client, so that both connections begin together. A
    client that is idle is disconnected when another one sends something: it must not block `nomad stop`. Loopback
    only, unless --bind is given: there is no authentication.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        parser.add_argument("address", metavar="ADDRESS", help="far end, such as serial:///dev/ttyUSB0 or nserver://lab:7019")
        add_listener_options(parser)
        parser.add_argument("--record", metavar="FILE", help="record all traffic to FILE")
        add_flag(parser, "--dump", "print the traffic to stdout, as `nomad dump` does")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Forward bytes until stopped, and return the exit code."""
        connector = _connector(options)
        # The far end for the first client; empty afterwards.
        opened = [_open_far_end(connector, options.dump)]

        def serve(near: ByteStream, session: ClientSession) -> None:
            try:
                far = opened.pop() if opened else _open_far_end(connector, options.dump)
            except ConnectionLost as error:
                print_message(str(error))
                return
            with contextlib.closing(far):
                forward(near, far, session, IdleMonitor(session.idle_timer, connector.wire, connector.model))

        try:
            with contextlib.suppress(*SIGNALS), open_listener(options, "bridge") as listener:
                serve_clients(listener, options, serve)
        finally:
            for far in opened:
                far.close()
        return ExitCode.DONE


def forward(near: ByteStream, far: ByteStream, session: ClientSession, monitor: IdleMonitor) -> None:
    """Forward bytes in both directions until one end is closed or the client's session ends."""
    # One thread per direction; either of them ends both.
    finished = threading.Event()
    to_near = threading.Thread(target=_forward_direction, args=(far, near, finished, monitor.to_host, lambda _: False),
                               daemon=True)
    to_near.start()
    _forward_direction(near, far, finished, monitor.to_robot, session.should_end)
    to_near.join()


def _forward_direction(source: ByteStream, target: ByteStream, finished: threading.Event,
                       observe: Callable[[bytes], None], should_end: Callable[[bool], bool]) -> None:
    """Forward until `finished`, a lost connection, or `should_end`, which is called with True if nothing was read.

    A lost connection is reported once, by the direction that notices it first.
    """
    try:
        while not finished.is_set():
            data = b""
            # A timeout only means that there was nothing to forward in this interval.
            with contextlib.suppress(ReplyTimeout):
                data = source.receive(Deadline.after(POLL_INTERVAL_S))
                observe(data)
                target.send(data)
            if should_end(not data):
                return
    except ConnectionLost as error:
        if not finished.is_set():
            finished.set()
            print_message(str(error))
    finally:
        finished.set()


def _connector(options: argparse.Namespace) -> Connector:
    address: str = options.address
    if options.record:
        address += f"{'&' if '?' in address else '?'}record={quote(options.record)}"
    connector = Connector(parse_address(address))
    if connector.address.in_process:
        scheme = connector.address.scheme
        instead = "`nomad play` serves a recording" if scheme == "replay" else "`nserver` serves a simulation"
        raise AddressError(f"{options.address!r} runs in this process, so that there is nothing to bridge: {instead}")
    return connector


def _open_far_end(connector: Connector, dump: bool) -> ByteStream:
    stream = connector.open_stream()
    return RecordingStream(stream, _TrafficPrinter(connector.wire, connector.model)) if dump else stream


class _TrafficPrinter:
    """ConnectionRecorder that prints the traffic."""

    def __init__(self, line: str, model: Model) -> None:
        self._decoder = FrameDecoder(line, model)
        self._start_s = time.monotonic()

    def to_robot(self, data: bytes) -> None:
        self._show(OUT, data, self._decoder.to_robot(data))

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        del by_time
        self._show(IN, data, self._decoder.to_host(data))

    def close(self) -> None:
        """Do nothing: everything was printed."""

    def _show(self, kind: str, data: bytes, decoded: list[dict[str, object]]) -> None:
        for line in format_entry(Entry(time.monotonic() - self._start_s, kind, "", data, tuple(decoded))):
            print(line, flush=True)


AT_ONCE, RECORDED = "at-once", "recorded"
_MAY = "may have the recording answer"


class PlayCommand:
    """Replay a recorded robot or server on a TCP port or pseudo-terminal.

        nomad play run.log --listen 7019                    an old client connects to the robot of that recording
        nomad play run.log --link /tmp/robot --pace recorded
        nomad play run.log --listen 0 --order loose --connection 127.0.0.1:4711

    Every client gets the recording from its beginning. A client that sends a request which was not recorded is
    disconnected, the place is reported on stderr, and the exit code is 1 in the end. An idle client is disconnected
    when another one sends something.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        parser.add_argument("file", type=Path, metavar="FILE",
                            help="recording, as made by record=FILE in an address or nserver --record")
        add_listener_options(parser)
        parser.add_argument("--pace", choices=(AT_ONCE, RECORDED), default=AT_ONCE,
                            help="reply at once (default), or after the recorded delay")
        parser.add_argument("--order", choices=ORDERS, default=STRICT,
                            help="expect requests in the recorded order (strict, default), or reply to each as to the "
                            "next equal recorded one (loose)")
        parser.add_argument("--connection", default="", metavar="NAME",
                            help="play this connection (default: the first one of the recording)")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Play until stopped, and return the exit code."""
        recording = read_recording(options.file)
        if recording.cut:
            print_message(recording.cut)
        connection = load_exchanges(recording, options.connection)
        # With the recorded pace the delays between request and reply are repeated, not those between requests.
        sleep = time.sleep if options.pace == RECORDED else None
        mismatches: list[RecordingError] = []

        def serve(stream: ByteStream, session: ClientSession) -> None:
            try:
                play(Player(connection, options.order), stream, sleep, session)
            except RecordingError as error:
                mismatches.append(error)
                print_message(str(error))

        with contextlib.suppress(*SIGNALS), open_listener(options, "play", _MAY) as listener:
            serve_clients(listener, options, serve)
        return ExitCode.FAILED if mismatches else ExitCode.DONE


def play(player: Player, stream: ByteStream, sleep: Callable[[float], None] | None, session: ClientSession) -> None:
    """Serve one client until it disconnects or its session ends.

    Raises
    ------
    RecordingError
        If the client sends a request that was not recorded.
    """
    with contextlib.suppress(ConnectionLost):
        # What a robot sends by itself on connecting, such as the handshake of an N200.
        _send(player.initial, stream, sleep)
        while True:
            data = b""
            with contextlib.suppress(ReplyTimeout):
                data = stream.receive(Deadline.after(POLL_INTERVAL_S))
                _send(player.answers(data), stream, sleep)
                session.idle_timer.request_received()
            if session.should_end(at_rest=not data):
                return


def _send(chunks: Iterable[ReplyChunk], stream: ByteStream, sleep: Callable[[float], None] | None) -> None:
    """Send chunks with their recorded delays, or at once if `sleep` is None."""
    # Delays are counted from the request, so only the difference to the previous chunk is waited.
    passed_s = 0.0
    for chunk in chunks:
        if sleep is not None and chunk.after_s > passed_s:
            sleep(chunk.after_s - passed_s)
            passed_s = chunk.after_s
        stream.send(chunk.data)
