"""Pass bytes between a TCP port or a pseudo-terminal and a robot or an Nserver elsewhere, and listen in.

    nomad bridge --listen 65001 "serial:///dev/ttyUSB0?baud=38400"       a robot's cable, from another machine
    nomad bridge --link /tmp/robot robotd://lab:65001 --dump             an old program's port, with all that is said
    nomad bridge --listen 7019 nserver://lab:7019 --record run.log       an Nserver, recorded

Whatever an address can say of its stream (record=, faults=) holds here, too; --record and --dump are in short.

Rules: bytes pass as they come, in both directions, one visitor at a time. The far end is opened anew for each visitor
but the first, so that both begin together, and what is wrong with the address is told at the start. Loopback only,
unless --bind says otherwise: there is no authentication.
"""

from __future__ import annotations

import argparse
import contextlib
import threading
import time
from urllib.parse import quote

from nclient.commands.serving import add_door, open_door, tell, visitors
from nclient.errors import AddressError, ConnectionLost, ReplyTimeout
from nclient.exit_codes import ExitCode
from nclient.protocol.models import Model
from nclient.recording.follower import Follower
from nclient.recording.log import IN, OUT, Entry
from nclient.recording.readable import lines_of
from nclient.recording.stream import RecordingStream
from nclient.schemes import Opening, Wanted, opening_of
from nclient.transports import memory
from nclient.transports.byte_stream import ByteStream, Deadline

_LOOK_S = 0.2
"""How soon one direction sees that the other is over."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """A door, the far end, and what is written down."""
    parser.add_argument("address", help="the far end, such as serial:///dev/ttyUSB0 or nserver://lab:7019")
    add_door(parser)
    parser.add_argument("--record", metavar="FILE", help="write down all that passes")
    parser.add_argument("--dump", action="store_true", help="show on stdout what passes, as `nomad dump` does")


def run(options: argparse.Namespace) -> int:
    """Pass bytes until stopped; the exit code."""
    opening = _opening(options)
    waiting = [_far_end(opening, options.dump)]

    def talk(near: ByteStream) -> None:
        try:
            far = waiting.pop() if waiting else _far_end(opening, options.dump)
        except ConnectionLost as error:
            tell(str(error))
            return
        try:
            pass_on(near, far)
        finally:
            far.close()

    try:
        with contextlib.suppress(KeyboardInterrupt), open_door(options, "bridge") as door:
            visitors(door, options.once, talk)
    finally:
        for far in waiting:
            far.close()
    return ExitCode.DONE


def pass_on(near: ByteStream, far: ByteStream) -> None:
    """Bytes from each to the other, until one of the two is over; the near one then is."""
    over = threading.Event()
    back = threading.Thread(target=_pass_one_way, args=(far, near, over), daemon=True)
    back.start()
    _pass_one_way(near, far, over)
    back.join()


def _pass_one_way(source: ByteStream, target: ByteStream, over: threading.Event) -> None:
    """Until one of them is gone, which is told unless the other direction told it already."""
    try:
        while not over.is_set():
            with contextlib.suppress(ReplyTimeout):
                target.send(source.receive(Deadline.after(_LOOK_S)))
    except ConnectionLost as error:
        if not over.is_set():
            over.set()
            tell(str(error))
    finally:
        over.set()


def _opening(options: argparse.Namespace) -> Opening:
    given: str = options.address
    if options.record:
        given += f"{'&' if '?' in given else '?'}record={quote(options.record)}"
    opening = opening_of(given, Wanted())
    scheme = opening.address.scheme
    if scheme in memory.schemes() or scheme == "replay":
        instead = "`nomad play` serves a recording" if scheme == "replay" else "`nserver` serves a simulation"
        raise AddressError(f"{options.address!r} is answered in one's own process, nothing to bridge: {instead}")
    return opening


def _far_end(opening: Opening, dump: bool) -> ByteStream:
    stream = opening.stream()
    return RecordingStream(stream, _Shown(opening.scheme.line, opening.model)) if dump else stream


class _Shown:
    """A tape that shows what it hears."""

    def __init__(self, line: str, model: Model) -> None:
        self._follower = Follower(line, model)
        self._start_s = time.monotonic()

    def to_robot(self, data: bytes) -> None:
        self._show(OUT, data, self._follower.to_robot(data))

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        del by_time
        self._show(IN, data, self._follower.to_host(data))

    def close(self) -> None:
        """Nothing more to show."""

    def _show(self, kind: str, data: bytes, decoded: list[dict[str, object]]) -> None:
        for line in lines_of(Entry(time.monotonic() - self._start_s, kind, "", data, tuple(decoded))):
            print(line, flush=True)
