"""Show a recording, or bytes that something else captured, line by line.

    nomad dump run.log                          what was asked and what was answered, in inches and degrees
    nomad dump run.log --filter vm --bytes      only that call, with all bytes
    nomad dump run.log --json                   an object a frame, as `nomad wire decode` prints them
    nomad dump capture.bin --line serial --model n150 --from-robot

A file of bare bytes needs --line, and all in it went one way: to the robot, unless --from-robot says otherwise.

Rules: files and printing only; what bytes mean is nclient.recording's and nclient.protocol's. Exit code 1 where the
file is no recording, or a last line was cut short.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from nclient.cli.serving import print_message
from nclient.common.exit_codes import ExitCode
from nclient.errors import RecordingError
from nclient.protocol.codec import find_command
from nclient.protocol.types import MODELS, N150, get_model
from nclient.recording.format import IN, OUT, Entry, Recording, format_entry, read_recording
from nclient.recording.recorder import LINES, FrameDecoder

_PIECE = 4096


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """A file, and what of it is shown."""
    parser.add_argument("file", type=Path, help="a recording, or with --line a file of bare bytes")
    parser.add_argument("--filter", default="", metavar="COMMAND", help="only calls of this C name, with what answers")
    parser.add_argument("--connection", default="", metavar="NAME", help="only that one")
    parser.add_argument("--bytes", action="store_true", help="show the bytes, too")
    parser.add_argument("--json", action="store_true", help="an object a frame, with its time")
    parser.add_argument("--line", choices=LINES, help="bare bytes, in this language")
    parser.add_argument("--model", choices=tuple(MODELS), default=N150.name, help="whose own line (default: n150)")
    parser.add_argument("--from-robot", action="store_true", help="bare bytes came from the robot")


def run(options: argparse.Namespace) -> int:
    """Show it; the exit code."""
    if options.filter:
        find_command(options.filter)
    recording = _captured(options) if options.line else read_recording(options.file)
    if options.connection and options.connection not in recording.connections():
        there = ", ".join(recording.connections())
        raise RecordingError(f"{options.file}: no connection {options.connection!r}; there are {there}")
    for entry in _wanted(recording, options):
        if options.json:
            _print_objects(entry)
        else:
            for line in format_entry(entry, options.bytes):
                print(line)
    if recording.cut:
        print_message(recording.cut)
    return ExitCode.FAILED if recording.cut else ExitCode.DONE


def _captured(options: argparse.Namespace) -> Recording:
    """Bare bytes as a recording without times."""
    try:
        data = options.file.read_bytes()
    except OSError as error:
        raise RecordingError(f"{options.file}: cannot be read ({error.strerror})") from error
    follower = FrameDecoder(options.line, get_model(options.model))
    follow, kind = (follower.to_host, IN) if options.from_robot else (follower.to_robot, OUT)
    pieces = [data[k : k + _PIECE] for k in range(0, len(data), _PIECE)]
    entries = tuple(Entry(0.0, kind, "", piece, tuple(follow(piece))) for piece in pieces)
    return Recording(str(options.file), {}, entries)


def _wanted(recording: Recording, options: argparse.Namespace) -> Iterator[Entry]:
    """The entries to show: with a filter, calls of that name and what came back until the next call."""
    answering: dict[str, bool] = {}
    for entry in recording.entries:
        if options.connection and entry.connection != options.connection:
            continue
        if not options.filter:
            yield entry
            continue
        if entry.kind == OUT:
            answering[entry.connection] = any(found.get("call") == options.filter for found in entry.decoded)
        if entry.kind in (OUT, IN) and answering.get(entry.connection):
            yield entry


def _print_objects(entry: Entry) -> None:
    for found in entry.decoded:
        whose = {"connection": entry.connection} if entry.connection else {}
        print(json.dumps({"t": entry.time_s} | whose | dict(found)))
