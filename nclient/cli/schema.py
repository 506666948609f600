"""Print the JSON Schema of a kind of file, so that editors complete and check it.

    nomad schema world > world.schema.json        then in a world's first line: #:schema world.schema.json

The schema is made from the types with which the file is read. It cannot express what needs geometry or other files:
such errors are found when the file is read. Its keywords are those of draft 7, which editors understand.
"""

# Kinds of files are found by the entry points of the group nomad.schemas: msgspec types.

import argparse
import json
from collections.abc import Iterator
from typing import Any, Final, get_args

import msgspec

from nclient.common.hints import entry_points
from nclient.common.process import ExitCode

GROUP: Final = "nomad.schemas"
DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    kinds = sorted(point.name for point in entry_points(group=GROUP))
    parser.add_argument("kind", choices=kinds, help="kind of file")


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
