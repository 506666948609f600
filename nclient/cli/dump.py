"""Show a recording, or captured bytes, line by line.

    nomad dump run.log                          requests and replies in inches and degrees
    nomad dump run.log --filter vm --bytes      only this command, with all bytes
    nomad dump run.log --json                   one JSON object per frame, as `nomad wire decode` prints them
    nomad dump capture.bin --line serial --model n150 --from-robot

A file of plain bytes needs --line; its bytes are taken as sent to the robot, or with --from-robot by the robot.
Exit code 1 if the file is no recording or its last line is incomplete.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from nclient.cli.serving import print_message
from nclient.common.arguments import add_flag
from nclient.common.process import ExitCode
from nclient.errors import RecordingError
from nclient.protocol.codec import find_command
from nclient.protocol.types import MODELS, N150, get_model
from nclient.recording.format import IN, OUT, Entry, Recording, escape_controls, format_entry, read_recording
from nclient.recording.recorder import LINES, FrameDecoder

# Bytes of a file of plain bytes that are decoded and shown together.
_PIECE = 4096


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("file", type=Path, metavar="FILE", help="recording, or with --line a file of plain bytes")
    parser.add_argument("--filter", default="", metavar="COMMAND", help="show only this C command and its replies")
    parser.add_argument("--connection", default="", metavar="NAME", help="show only this connection")
    add_flag(parser, "--bytes", "show the bytes as well")
    add_flag(parser, "--json", "print one JSON object per frame, with its time")
    parser.add_argument("--line", choices=LINES, help="read plain bytes of this protocol")
    parser.add_argument("--model", choices=tuple(MODELS), default=N150.name, help="model of the robot (default: n150)")
    add_flag(parser, "--from-robot", "plain bytes are from the robot")


def run(options: argparse.Namespace) -> int:
    """Show the file, and return the exit code."""
    if options.filter:
        find_command(options.filter)
    recording = _read_plain_bytes(options) if options.line else read_recording(options.file)
    if options.connection and options.connection not in recording.connections():
        there = escape_controls(", ".join(recording.connections()))
        raise RecordingError(f"{options.file}: no connection {options.connection!r}; there are {there}")
    for entry in _selected_entries(recording, options):
        if options.json:
            connection = {"connection": entry.connection} if entry.connection else {}
            for found in entry.decoded:
                print(json.dumps({"t": entry.time_s} | connection | dict(found)))
        else:
            for line in format_entry(entry, options.bytes):
                print(line)
    if recording.cut:
        print_message(recording.cut)
    return ExitCode.FAILED if recording.cut else ExitCode.DONE


def _read_plain_bytes(options: argparse.Namespace) -> Recording:
    """Return a file of plain bytes as a recording without times."""
    try:
        data = options.file.read_bytes()
    except OSError as error:
        raise RecordingError(f"{options.file}: cannot be read ({error.strerror})") from error
    # Plain bytes have one direction and no times; the decoder joins frames across pieces.
    decoder = FrameDecoder(options.line, get_model(options.model))
    decode, kind = (decoder.to_host, IN) if options.from_robot else (decoder.to_robot, OUT)
    pieces = [data[k : k + _PIECE] for k in range(0, len(data), _PIECE)]
    entries = tuple(Entry(0.0, kind, "", piece, tuple(decode(piece))) for piece in pieces)
    return Recording(str(options.file), {}, entries)


def _selected_entries(recording: Recording, options: argparse.Namespace) -> Iterator[Entry]:
    """Yield the entries to show: with --filter, requests of that command and everything until the next request."""
    answering: dict[str, bool] = {}
    for entry in recording.entries:
        if options.connection and entry.connection != options.connection:
            continue
        if not options.filter:
            yield entry
            continue
        # A reply does not name its request: it is shown if the last request of its connection is.
        if entry.kind == OUT:
            answering[entry.connection] = any(found.get("call") == options.filter for found in entry.decoded)
        if entry.kind in (OUT, IN) and answering.get(entry.connection):
            yield entry
