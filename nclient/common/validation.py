"""Check data of files and messages against msgspec types; error messages with key, value and remedy; JSON Schema.

A type states its constraints once, with `msgspec.Meta`: the bounds; `title`, the phrase that follows "expected" in an
error; `description`, shown by editors and for missing keys. Errors are explained from the JSON Schema of the type, so
that programs and editors expect the same.
"""

import dataclasses
import functools
import json
import operator
import re
import reprlib
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints, overload

import msgspec

from nclient.common.files import ErrorFactory
from nclient.errors import suggest

T = TypeVar("T")

Text = Annotated[str, msgspec.Meta(pattern=r"\S", title="a text")]
"""A text that is not blank."""
MAX_SHOWN: Final = 60
"""Characters of a wrong value that a message shows."""


class InvalidValue(ValueError):
    """A value that is not allowed.

    Attributes
    ----------
    complaint
        What is expected and what was found.
    key
        Path of the key, `wall[2].points_in[0]`, counted from 0; "" for the whole.
    """

    def __init__(self, complaint: str, key: str = "") -> None:
        super().__init__(f"{key}: {complaint}" if key else complaint)
        self.complaint = complaint
        self.key = key


@contextmanager
def reported_as(error: ErrorFactory, where: str = "") -> Iterator[None]:
    """Turn InvalidValue into the caller's error; `where` is the file, or the part of it, that the message names."""
    try:
        yield
    except InvalidValue as failure:
        raise error(f"{where}: {failure}" if where else str(failure)) from None


@overload
def convert(value: object, kind: type[T], key: str = ...) -> T: ...
@overload
def convert(value: object, kind: Any, key: str = ...) -> Any: ...
def convert(value: object, kind: Any, key: str = "") -> Any:
    """Return plain data as an object of a type.

    Parameters
    ----------
    value
        Data as tomllib or json return them.
    kind
        Any type that msgspec knows.
    key
        Key of the value, for messages.

    Raises
    ------
    InvalidValue
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as failure:
        raise _explain(failure, value, kind, key) from None
    except UnicodeEncodeError as failure:
        # JSON may escape half of a surrogate pair.
        raise InvalidValue(f"expected text, found {failure.object!r:.60}, which is no character", key) from None


def decode_json(text: str) -> Any:
    """Return the value of a JSON text. Raises InvalidValue, also if it is nested too deeply.

    NaN and infinity are read, so that the error for them names their key.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as failure:
        raise InvalidValue(f"is no JSON: {failure}") from None


def check_fields(instance: Any, error: ErrorFactory) -> None:
    """Check the values of a dataclass against the types of its fields. Raises `error`."""
    with reported_as(error):
        for name, kind in field_types(type(instance)).items():
            convert(getattr(instance, name), kind, name)


def field_types(kind: Any) -> dict[str, Any]:
    """Return the types of a dataclass's fields, with their constraints."""
    return _field_types(kind)


@functools.cache
def _field_types(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def dataclass_keys(kind: Any) -> list[tuple[str, Any, Any]]:
    """Return the fields of a dataclass as optional keys of a struct, for msgspec.defstruct."""
    return [(name, without_none(each) | msgspec.UnsetType, msgspec.UNSET) for name, each in field_types(kind).items()]


def without_none(kind: Any) -> Any:
    """Return the type of a key whose absence is None in a program: files have no null."""
    if get_origin(kind) not in (Union, UnionType):
        return kind
    return functools.reduce(operator.or_, (each for each in get_args(kind) if each is not NoneType))


def one_of(names: Iterable[str]) -> Any:
    """Return the type of a text that is one of these names."""
    literal: Any = Literal
    return literal[tuple(names)]


def at_most_one(keys: Iterable[str], least: int = 0) -> dict[str, Any]:
    """Return the condition that one of the keys is given, or for `least` 0 none of them, as JSON Schema."""
    choices: list[dict[str, Any]] = [{"required": [key]} for key in keys]
    return {"oneOf": choices if least else [*choices, {"not": {"anyOf": choices}}]}


def keys_of(struct: Any) -> tuple[str, ...]:
    """Return the keys that a table may have."""
    names: tuple[str, ...] = struct.__struct_fields__
    return names


def given(struct: Any) -> dict[str, Any]:
    """Return the keys of a table that the file contains, with their values."""
    return {key: getattr(struct, key) for key in keys_of(struct) if getattr(struct, key) is not msgspec.UNSET}


def unknown_key(key: str, allowed: Iterable[str]) -> InvalidValue:
    """Return the error for a key that is not one of those allowed."""
    names = tuple(allowed)
    return InvalidValue(f"unknown key; expected one of {', '.join(names)}{suggest(key, names)}", key)


def describe_value(value: object) -> str:
    """Return a value as text for an error message: kind and value, shortened if long."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {_shorten(repr(value))}"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"the list {_shorten(_LISTS.repr(value))}"
    if isinstance(value, int) and abs(value) >= 10**30:
        return "a number of more than 30 digits"
    return _shorten(str(value))


# Lists may be long, and nested more deeply than repr can show.
_LISTS: Final = reprlib.Repr()
_LISTS.maxlist = MAX_SHOWN
_LISTS.maxlevel = 4


def _shorten(text: str) -> str:
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."


# -- errors -----------------------------------------------------------------------------------------------------------

Node = dict[str, Any]
"""JSON Schema of a type."""


def _explain(failure: msgspec.ValidationError, value: Any, kind: Any, key: str) -> InvalidValue:
    """Return our error for one of msgspec, whose message ends in the path: "... - at `$.wall[2].points_in`"."""
    message, _, place = str(failure).rpartition(" - at `$")
    parts = re.findall(r"[^.\[\]`]+", place) if message else []
    found = failure.__cause__
    if not isinstance(found, InvalidValue):
        # An unknown key may contain anything, so what looks like a path need not be one.
        try:
            found = _complain(kind, value, parts)
        except (LookupError, TypeError, ValueError, StopIteration):
            found, parts = InvalidValue(str(failure)), []
    for part in [*parts, found.key] if found.key else parts:
        key += f"[{part}]" if part.isdecimal() else f".{part}" if key else part
    return InvalidValue(found.complaint, key)


def _complain(kind: Any, value: Any, parts: list[str]) -> InvalidValue:
    """Return the error for the part of a value that differs from its schema; the key is relative to that part."""
    # 1. Walk to the part.
    root, definitions = _schema_of(kind)
    node, parent = _resolve(root, value, definitions), {}
    for part in parts:
        child, value = _enter(node, value, part)
        node, parent = _resolve(child, value, definitions), node
    # 2. A table with wrong keys, or a list with too few or too many items.
    if isinstance(value, dict) and node["type"] == "object":
        return _complain_keys(node, value)
    if isinstance(value, list | tuple) and node["type"] == "array":
        low, high, items = node.get("minItems", 0), node.get("maxItems"), node.get("x-items", "values")
        if low != high:
            limit = f"at least {low}" if len(value) < low else f"at most {high}"
            return InvalidValue(f"expected {limit} {items}, found {len(value)}")
    # 3. A wrong value.
    found = describe_value(value)
    if "enum" in node and isinstance(value, str):
        found = repr(value) + suggest(value, node["enum"])
    tables = node if node.get("type") == "array" else parent
    items = _resolve(tables.get("items") or {}, None, definitions)
    if items["type"] == "object" and "title" not in tables:
        name = next(part for part in reversed(parts) if not part.isdecimal())
        return InvalidValue(f"expected tables under [[{name}]], each with its double brackets, found {found}")
    hint = node.get("x-hint", "") if _is_number(value) and _is_finite(value) else ""
    return InvalidValue(f"expected {_expected(node, value)}, found {found}{hint}")


@functools.lru_cache(maxsize=64)
def _schema_of(kind: Any) -> tuple[Node, dict[str, Node]]:
    """Return the schema of a type, and those that it refers to: some milliseconds of work for a large type."""
    (root,), definitions = msgspec.json.schema_components([kind])
    return root, definitions


def _complain_keys(node: Node, value: dict[str, Any]) -> InvalidValue:
    """Return the error for a table with unknown or missing keys."""
    fields = node["properties"]
    unknown = [key for key in value if key not in fields and node.get("additionalProperties") is False]
    if unknown:
        return unknown_key(unknown[0], (key for key in fields if not fields[key].get("deprecated")))
    missing = next(key for key in node["required"] if key not in value)
    if "enum" in fields[missing]:
        return InvalidValue(f"is missing; expected one of {', '.join(fields[missing]['enum'])}", missing)
    what = fields[missing].get("description") or fields[missing].get("title")
    return InvalidValue(f"is missing: {what}" if what else "is missing", missing)


def _enter(node: Node, value: Any, part: str) -> tuple[Node, Any]:
    """Return the schema and the value under a key or an index."""
    if isinstance(value, dict):
        return node["properties"][part], value[part]
    return node["items"], value[int(part)]


def _resolve(node: Node, value: Any, definitions: dict[str, Node]) -> Node:
    """Return the schema that a reference names; of a choice, the one that a value was probably meant for."""
    if "$ref" in node:
        beside = {key: each for key, each in node.items() if key != "$ref"}
        return _resolve(definitions[node["$ref"].rpartition("/")[2]] | beside, value, definitions)
    if "discriminator" in node:
        # Tables of several kinds: the value under one key names the kind.
        tag, kinds = node["discriminator"]["propertyName"], node["discriminator"]["mapping"]
        name = value.get(tag) if isinstance(value, dict) else None
        if isinstance(name, str) and name in kinds:
            return _resolve({"$ref": kinds[name]}, value, definitions)
        return {"type": "object", "properties": {tag: {"enum": list(kinds)}}, "required": [tag]}
    if "anyOf" in node:
        lists = [each for each in node["anyOf"] if each.get("type") == "array" and isinstance(value, list)]
        return _resolve((lists or node["anyOf"])[0], value, definitions)
    return {"type": ""} | node


def _expected(node: Node, value: Any) -> str:
    """Return what a schema expects, in words."""
    if "enum" in node and not node["type"]:
        return f"one of {', '.join(map(str, node['enum']))}"
    low, high, title = node.get("minimum"), node.get("maximum"), node.get("title")
    match node["type"]:
        case "object":
            return "a table"
        case "boolean":
            return "true or false"
        case "integer":
            bounds = f", {low} or more" if high is None else f" from {low} to {high}"
            return str(title or "a whole number" + ("" if low is None else bounds))
        case "number":
            span = _span(low, high)
            if not _is_number(value):
                return f"{title or span}, a number"
            return span if _is_finite(value) else f"{title or span}, a finite number"
        case "array":
            return str(title or "a list")
    return str(title or "a text")


def _span(low: float | None, high: float | None) -> str:
    if high is None or high >= sys.float_info.max:
        return "more than 0" if low is None else f"{low:g} or more"
    return f"more than 0, at most {high:g}" if low is None else f"{low:g} to {high:g}"


def _is_number(value: Any) -> bool:
    # In Python True is an int.
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_finite(value: float) -> bool:
    # Comparison does not overflow, as conversion of a long int does.
    return -sys.float_info.max <= value <= sys.float_info.max
