"""Pass bytes between a TCP port or a pseudo-terminal and a robot or an Nserver elsewhere, and listen in.

    nomad bridge --listen 65001 "serial:///dev/ttyUSB0?baud=38400"       a robot's cable, from another machine
    nomad bridge --link /tmp/robot robotd://lab:65001 --dump             an old program's port, with all that is said
    nomad bridge --listen 7019 nserver://lab:7019 --record run.log       an Nserver, recorded

Whatever an address can say of its stream (record=, faults=) holds here, too; --record and --dump are in short.

Rules: bytes pass as they come, in both directions, one visitor at a time. The far end is opened anew for each visitor
but the first, so that both begin together, and what is wrong with the address is told at the start. Who has the line
keeps it while he talks or waits for an answer; who is silent makes room, lest he keep `nomad stop` from a robot.
Loopback only, unless --bind says otherwise: there is no authentication.
"""

from __future__ import annotations

import argparse
import contextlib
import threading
import time
from collections.abc import Callable
from urllib.parse import quote

from nclient.cli.idle import IdleMonitor
from nclient.cli.serving import LOOK_S, Turn, add_door, open_door, tell, visitors
from nclient.common.exit_codes import ExitCode
from nclient.connect import Connector
from nclient.errors import AddressError, ConnectionLost, ReplyTimeout
from nclient.protocol.types import Model
from nclient.recording.format import IN, OUT, Entry, format_entry
from nclient.recording.recorder import FrameDecoder, RecordingStream
from nclient.transports.stream import ByteStream, Deadline
from nclient.url import parse_address


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """A door, the far end, and what is written down."""
    parser.add_argument("address", help="the far end, such as serial:///dev/ttyUSB0 or nserver://lab:7019")
    add_door(parser)
    parser.add_argument("--record", metavar="FILE", help="write down all that passes")
    parser.add_argument("--dump", action="store_true", help="show on stdout what passes, as `nomad dump` does")


def run(options: argparse.Namespace) -> int:
    """Pass bytes until stopped; the exit code."""
    connector = _connector(options)
    waiting = [_far_end(connector, options.dump)]

    def talk(near: ByteStream, turn: Turn) -> None:
        try:
            far = waiting.pop() if waiting else _far_end(connector, options.dump)
        except ConnectionLost as error:
            tell(str(error))
            return
        try:
            pass_on(near, far, turn, IdleMonitor(turn.silence, connector.wire, connector.model))
        finally:
            far.close()

    try:
        with contextlib.suppress(KeyboardInterrupt), open_door(options, "bridge") as door:
            visitors(door, options, talk)
    finally:
        for far in waiting:
            far.close()
    return ExitCode.DONE


def pass_on(near: ByteStream, far: ByteStream, turn: Turn, overheard: IdleMonitor) -> None:
    """Bytes from each to the other, until one of the two or the near one's turn is over; the near one then is."""
    over = threading.Event()
    back = threading.Thread(
        target=_pass_one_way, args=(far, near, over, overheard.to_host, lambda _: False), daemon=True
    )
    back.start()
    _pass_one_way(near, far, over, overheard.to_robot, turn.over)
    back.join()


def _pass_one_way(
    source: ByteStream,
    target: ByteStream,
    over: threading.Event,
    hear: Callable[[bytes], None],
    ended: Callable[[bool], bool],
) -> None:
    """Until one of them is gone, which is told unless the other direction told it already, or until it is `ended`:
    asked again and again, with whether nothing was left to pass.
    """
    try:
        while not over.is_set():
            data = b""
            with contextlib.suppress(ReplyTimeout):
                data = source.receive(Deadline.after(LOOK_S))
                hear(data)
                target.send(data)
            if ended(not data):
                return
    except ConnectionLost as error:
        if not over.is_set():
            over.set()
            tell(str(error))
    finally:
        over.set()


def _connector(options: argparse.Namespace) -> Connector:
    given: str = options.address
    if options.record:
        given += f"{'&' if '?' in given else '?'}record={quote(options.record)}"
    connector = Connector(parse_address(given))
    if connector.address.in_process:
        scheme = connector.address.scheme
        instead = "`nomad play` serves a recording" if scheme == "replay" else "`nserver` serves a simulation"
        raise AddressError(f"{options.address!r} is answered in one's own process, nothing to bridge: {instead}")
    return connector


def _far_end(connector: Connector, dump: bool) -> ByteStream:
    stream = connector.open_stream()
    return RecordingStream(stream, _Shown(connector.wire, connector.model)) if dump else stream


class _Shown:
    """A tape that shows what it hears."""

    def __init__(self, line: str, model: Model) -> None:
        self._follower = FrameDecoder(line, model)
        self._start_s = time.monotonic()

    def to_robot(self, data: bytes) -> None:
        self._show(OUT, data, self._follower.to_robot(data))

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        del by_time
        self._show(IN, data, self._follower.to_host(data))

    def close(self) -> None:
        """Nothing more to show."""

    def _show(self, kind: str, data: bytes, decoded: list[dict[str, object]]) -> None:
        for line in format_entry(Entry(time.monotonic() - self._start_s, kind, "", data, tuple(decoded))):
            print(line, flush=True)
