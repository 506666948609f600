"""Replay a recorded robot or server on a TCP port or pseudo-terminal.

    nomad play run.log --listen 7019                    an old client connects to the robot of that recording
    nomad play run.log --link /tmp/robot --pace recorded
    nomad play run.log --listen 0 --order loose --connection 127.0.0.1:4711

Every client gets the recording from its beginning. A client that sends a request which was not recorded is
disconnected, the place is reported on stderr, and the exit code is 1 in the end. An idle client is disconnected when
another one sends something.
"""

import argparse
import contextlib
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from nclient.cli import serving
from nclient.common.process import ExitCode
from nclient.errors import ConnectionLost, RecordingError, ReplyTimeout
from nclient.recording.format import read_recording
from nclient.recording.replayer import ORDERS, STRICT, Player, ReplyChunk, load_exchanges
from nclient.transports.stream import ByteStream, Deadline

AT_ONCE, RECORDED = "at-once", "recorded"
_MAY = "may have the recording answer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("file", type=Path, metavar="FILE",
                        help="recording, as made by record=FILE in an address or nserver --record")
    serving.add_listener_options(parser)
    parser.add_argument("--pace", choices=(AT_ONCE, RECORDED), default=AT_ONCE,
                        help="reply at once (default), or after the recorded delay")
    parser.add_argument("--order", choices=ORDERS, default=STRICT,
                        help="expect requests in the recorded order (strict, default), or reply to each as to the next "
                        "equal recorded one (loose)")
    parser.add_argument("--connection", default="", metavar="NAME",
                        help="play this connection (default: the first one of the recording)")


def run(options: argparse.Namespace) -> int:
    """Play until stopped, and return the exit code."""
    recording = read_recording(options.file)
    if recording.cut:
        serving.print_message(recording.cut)
    connection = load_exchanges(recording, options.connection)
    # With the recorded pace the delays between request and reply are repeated, not those between requests.
    sleep = time.sleep if options.pace == RECORDED else None
    mismatches: list[RecordingError] = []

    def serve(stream: ByteStream, session: serving.ClientSession) -> None:
        try:
            play(Player(connection, options.order), stream, sleep, session)
        except RecordingError as error:
            mismatches.append(error)
            serving.print_message(str(error))

    with contextlib.suppress(*serving.SIGNALS), serving.open_listener(options, "play", _MAY) as listener:
        serving.serve_clients(listener, options, serve)
    return ExitCode.FAILED if mismatches else ExitCode.DONE


def play(
    player: Player, stream: ByteStream, sleep: Callable[[float], None] | None, session: serving.ClientSession
) -> None:
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
                data = stream.receive(Deadline.after(serving.POLL_INTERVAL_S))
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
