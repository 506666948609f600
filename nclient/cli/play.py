"""Answer as a recorded robot did: a recording on a TCP port or a pseudo-terminal.

    nomad play run.log --listen 7019                    an old client meets the robot of that day
    nomad play run.log --link /tmp/robot --pace recorded
    nomad play run.log --listen 0 --order loose --connection 127.0.0.1:4711

Each visitor meets the recording from its beginning. One that asks something else than was recorded is hung up on, what
and where is told on stderr, and the exit code is 1 in the end. One that says nothing makes room for another.

Rules: sockets, waiting and printing only; what is answered is nclient.recording's.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from nclient.cli.serving import LOOK_S, Turn, add_door, open_door, tell, visitors
from nclient.common.exit_codes import ExitCode
from nclient.errors import ConnectionLost, RecordingError, ReplyTimeout
from nclient.recording.format import read_recording
from nclient.recording.replayer import ORDERS, STRICT, Piece, Player, load_exchanges
from nclient.transports.stream import ByteStream, Deadline

AT_ONCE, RECORDED = "at-once", "recorded"
_MAY = "may have the recording answer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """A file, a door, and how it is played."""
    parser.add_argument("file", type=Path, help="a recording, as record=FILE in an address or nserver --record makes")
    add_door(parser)
    parser.add_argument("--pace", choices=(AT_ONCE, RECORDED), default=AT_ONCE,
                        help="answer at once (default), or after as long as the robot took")
    parser.add_argument("--order", choices=ORDERS, default=STRICT,
                        help="strict: as it was asked (default); loose: each question as the next one like it was")
    parser.add_argument("--connection", default="", metavar="NAME", help="which one (default: the recording's first)")


def run(options: argparse.Namespace) -> int:
    """Play until stopped; the exit code."""
    recording = read_recording(options.file)
    if recording.cut:
        tell(recording.cut)
    script = load_exchanges(recording, options.connection)
    wait = time.sleep if options.pace == RECORDED else None
    strayed: list[RecordingError] = []

    def talk(peer: ByteStream, turn: Turn) -> None:
        try:
            play(Player(script, options.order), peer, wait, turn)
        except RecordingError as error:
            strayed.append(error)
            tell(str(error))

    with contextlib.suppress(KeyboardInterrupt), open_door(options, "play", _MAY) as door:
        visitors(door, options, talk)
    return ExitCode.FAILED if strayed else ExitCode.DONE


def play(player: Player, peer: ByteStream, wait: Callable[[float], None] | None, turn: Turn) -> None:
    """One visitor, until it leaves or its turn is over. Raises RecordingError where it asks what was not recorded."""
    with contextlib.suppress(ConnectionLost):
        _send(player.greeting, peer, wait)
        while True:
            data = b""
            with contextlib.suppress(ReplyTimeout):
                data = peer.receive(Deadline.after(LOOK_S))
                _send(player.answers(data), peer, wait)
                turn.silence.heard()
            if turn.over(at_rest=not data):
                return


def _send(pieces: Iterable[Piece], peer: ByteStream, wait: Callable[[float], None] | None) -> None:
    """At the moments they came, or at once."""
    passed_s = 0.0
    for piece in pieces:
        if wait is not None and piece.after_s > passed_s:
            wait(piece.after_s - passed_s)
            passed_s = piece.after_s
        peer.send(piece.data)
