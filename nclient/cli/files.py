"""The commands on files: convert and dump recordings, and print the schema of a kind of file."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, get_args

import msgspec

from nclient.cli.serving import print_message
from nclient.common.arguments import add_flag
from nclient.common.files import read_errors_as
from nclient.common.process import ExitCode
from nclient.errors import RecordingError, entry_points
from nclient.protocol.codec import find_command
from nclient.protocol.types import MODELS, N150, get_model
from nclient.recording.format import IN, OUT, Entry, Recording, escape_controls, format_entry, read_recording
from nclient.recording.recorder import LINES, FrameDecoder


class ConvertCommand:
    """Convert recordings to and from MCAP, ROS bags, CARMEN logs and CSV; formats by suffix.

        nomad convert run.log run.mcap        ROS 2 messages, for Foxglove and ROS tools; back gives the same recording
        nomad convert run.mcap run.log        .bag: ROS 1; a name without suffix: the folder of a ROS 2 bag
        nomad convert run.log run.csv         time series, as nomad localize --from reads it; .clf: CARMEN log
        nomad convert flight.bag flight.csv --field x_m=/state:raw.0 --field y_m=/state:raw.1

    What a format cannot hold is named on stderr. `replay:FILE` takes all of these files as an address.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        parser.add_argument("source", type=Path, metavar="FROM", help="file to read, recognized by its content")
        parser.add_argument("target", type=Path, metavar="TO",
                            help="file to write: .log .mcap .bag .csv .clf, or without suffix a ROS 2 bag")
        parser.add_argument("--field", action="append", default=[], metavar="COLUMN=TOPIC:PLACE",
                            help="read a number of another type of message, such as sonar_0_m=/ranges:raw.0; columns "
                            "x_m, y_m, heading_rad or qx qy qz qw, sonar_0_m ...; repeatable")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Convert a file, and return the exit code."""
        from nclient.recording import convert  # here: completion and help need no formats

        # The target first: a mistake there must not cost the time to read a long file.
        convert.format_to_write(options.target)
        drive = convert.read_drive(options.source, options.field)
        convert.write_drive(drive, options.target)
        for omitted in drive.omitted:
            print(f"nomad: left out: {escape_controls(omitted)}", file=sys.stderr)
        first, last = drive.samples[0].time_s, drive.samples[-1].time_s
        print(f"{options.target}: {len(drive.samples)} samples, {last - first:.1f} s")
        return ExitCode.DONE


# Bytes of a file of plain bytes that are decoded and shown together.
_PIECE = 4096


class DumpCommand:
    """Show a recording, or captured bytes, line by line.

        nomad dump run.log                          requests and replies in inches and degrees
        nomad dump run.log --filter vm --bytes      only this command, with all bytes
        nomad dump run.log --json                   one JSON object per frame, as `nomad wire decode` prints them
        nomad dump capture.bin --line serial --model n150 --from-robot

    A file of plain bytes needs --line; its bytes are taken as sent to the robot, or with --from-robot by the robot.
    Exit code 1 if the file is no recording or its last line is incomplete.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        parser.add_argument("file", type=Path, metavar="FILE", help="recording, or with --line a file of plain bytes")
        parser.add_argument("--filter", default="", metavar="COMMAND", help="show only this C command and its replies")
        parser.add_argument("--connection", default="", metavar="NAME", help="show only this connection")
        add_flag(parser, "--bytes", "show the bytes as well")
        add_flag(parser, "--json", "print one JSON object per frame, with its time")
        parser.add_argument("--line", choices=LINES, help="read plain bytes of this protocol")
        parser.add_argument("--model", choices=tuple(MODELS), default=N150.name,
                            help="model of the robot (default: n150)")
        add_flag(parser, "--from-robot", "plain bytes are from the robot")

    @staticmethod
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
    with read_errors_as(RecordingError, options.file):
        data = options.file.read_bytes()
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


# Kinds of files are found by the entry points of the group nomad.schemas: msgspec types.


GROUP: Final = "nomad.schemas"
DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


class SchemaCommand:
    """Print the JSON Schema of a kind of file, so that editors complete and check it.

        nomad schema world > world.schema.json        then in a world's first line: #:schema world.schema.json

    The schema is made from the types with which the file is read. It cannot express what needs geometry or other
    files: such errors are found when the file is read. Its keywords are those of draft 7, which editors understand.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        kinds = sorted(point.name for point in entry_points(group=GROUP))
        parser.add_argument("kind", choices=kinds, help="kind of file")

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Print the schema, and return the exit code."""
        print(json.dumps(file_schema(options.kind), indent=2))
        return ExitCode.DONE


def file_schema(kind: str) -> dict[str, Any]:
    """Return the schema of a kind of file."""
    (point,) = entry_points(group=GROUP).select(name=kind)
    return json_schema(point.load())


def json_schema(kind: Any) -> dict[str, Any]:
    """Return the JSON Schema of a type, with the conditions on several keys that its tables have as CONDITIONS."""
    schema = msgspec.json.schema(kind)
    for struct in _structs(kind):
        table = schema["$defs"][struct.__name__]
        if conditions := getattr(struct, "CONDITIONS", []):
            table["allOf"] = conditions
        for key, entry in table["properties"].items():
            # An editor would insert an empty default.
            if not entry.get("default", True):
                del entry["default"]
            # A table describes the key that has it.
            if "description" not in entry and (described := _referenced(entry, schema["$defs"])):
                entry["description"] = described
            if key == struct.__struct_config__.tag_field:
                entry["description"] = "kind of this table"
    return {"$schema": DIALECT, "description": kind.__doc__} | schema


def _referenced(entry: dict[str, Any], tables: dict[str, Any]) -> str:
    """Return the description of the table, or of the list of tables, that an entry refers to; "" for none."""
    name = (entry.get("items", entry)).get("$ref", "").rpartition("/")[2]
    return str(tables.get(name, {}).get("description", ""))


def _structs(kind: Any) -> Iterator[Any]:
    """Yield the structs that a type consists of."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        yield kind
        for field in msgspec.structs.fields(kind):
            yield from _structs(field.type)
    for part in get_args(kind):
        yield from _structs(part)
