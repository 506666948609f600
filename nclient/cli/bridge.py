"""Forward bytes between a TCP port or pseudo-terminal and a robot or Nserver elsewhere, and record them.

    nomad bridge --listen 65001 "serial:///dev/ttyUSB0?baud=38400"       make a robot's cable available on the network
    nomad bridge --link /tmp/robot robotd://lab:65001 --dump             give an old program a port, show the traffic
    nomad bridge --listen 7019 nserver://lab:7019 --record run.log       record the clients of an Nserver

Address options of the stream (record=, faults=) work here, too; --record and --dump are shortcuts.

Rules: bytes are forwarded unchanged, for one client at a time. The far end is opened at the start, so that a wrong
address is reported at once, and again for each further client, so that both connections begin together. A client that
is idle is disconnected when another one sends something: it must not block `nomad stop`. Loopback only, unless --bind
is given: there is no authentication.
"""

import argparse
import contextlib
import threading
import time
from collections.abc import Callable
from urllib.parse import quote

from nclient.cli import serving
from nclient.common.arguments import add_flag
from nclient.common.process import ExitCode
from nclient.connector import Connector
from nclient.errors import AddressError, ConnectionLost, ReplyTimeout
from nclient.protocol.types import Model
from nclient.recording.format import IN, OUT, Entry, format_entry
from nclient.recording.recorder import FrameDecoder, RecordingStream
from nclient.transports.stream import ByteStream, Deadline
from nclient.url import parse_address


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("address", metavar="ADDRESS", help="far end, such as serial:///dev/ttyUSB0 or nserver://lab:7019")
    serving.add_listener_options(parser)
    parser.add_argument("--record", metavar="FILE", help="record all traffic to FILE")
    add_flag(parser, "--dump", "print the traffic to stdout, as `nomad dump` does")


def run(options: argparse.Namespace) -> int:
    """Forward bytes until stopped, and return the exit code."""
    connector = _connector(options)
    # The far end for the first client; empty afterwards.
    opened = [_open_far_end(connector, options.dump)]

    def serve(near: ByteStream, session: serving.ClientSession) -> None:
        try:
            far = opened.pop() if opened else _open_far_end(connector, options.dump)
        except ConnectionLost as error:
            serving.print_message(str(error))
            return
        try:
            forward(near, far, session, serving.IdleMonitor(session.idle_timer, connector.wire, connector.model))
        finally:
            far.close()

    try:
        with contextlib.suppress(*serving.SIGNALS), serving.open_listener(options, "bridge") as listener:
            serving.serve_clients(listener, options, serve)
    finally:
        for far in opened:
            far.close()
    return ExitCode.DONE


def forward(near: ByteStream, far: ByteStream, session: serving.ClientSession, monitor: serving.IdleMonitor) -> None:
    """Forward bytes in both directions until one end is closed or the client's session ends."""
    # One thread per direction; either of them ends both.
    finished = threading.Event()
    to_near = threading.Thread(
        target=_forward_direction, args=(far, near, finished, monitor.to_host, lambda _: False), daemon=True
    )
    to_near.start()
    _forward_direction(near, far, finished, monitor.to_robot, session.should_end)
    to_near.join()


def _forward_direction(
    source: ByteStream,
    target: ByteStream,
    finished: threading.Event,
    observe: Callable[[bytes], None],
    should_end: Callable[[bool], bool],
) -> None:
    """Forward until `finished`, a lost connection, or `should_end`, which is called with True if nothing was read.

    A lost connection is reported once, by the direction that notices it first.
    """
    try:
        while not finished.is_set():
            data = b""
            # A timeout only means that there was nothing to forward in this interval.
            with contextlib.suppress(ReplyTimeout):
                data = source.receive(Deadline.after(serving.POLL_INTERVAL_S))
                observe(data)
                target.send(data)
            if should_end(not data):
                return
    except ConnectionLost as error:
        if not finished.is_set():
            finished.set()
            serving.print_message(str(error))
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
