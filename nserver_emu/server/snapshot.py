"""The whole simulation as text and back, bit for bit: what `nserver --save` writes and `--restore` reads.

    {"format": "nserver snapshot", "version": ..., "root": value, "objects": [object, ...]}
    value     null | true | 1 | 0.5 | "text" | {"ref": number of an object}
    object    {"is": "list", "of": values} and the like; {"is": "module:Class", "of": {attribute: value}}

Rules: JSON, no pickle: a stranger's file can name classes of the simulation and the worlds and nothing else, and
reading it calls no function of theirs, not even a constructor. Objects that are one stay one. Floats are written so
that they read back the same, long tracks as base64 of their doubles; chance goes on where it was. Writing takes little
more memory than the text: it is done again and again beside clients who wait.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from array import array
from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Mapping
from enum import Enum
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from nclient.errors import SnapshotError
from nclient.file_text import read_text
from nclient.unwritable import unwritable
from nserver_emu.server.handlers import Emulator
from nserver_emu.server.limits import SNAPSHOT_BYTES
from nserver_emu.server.trial import try_out

FORMAT: Final = "nserver snapshot"
KEPT: Final = ("simulation", "pace", "graphics", "traces", "transcript", "arms")
"""What of an emulator is kept: all but connections, port and permissions, which belong to a daemon's start."""

_ROOMS: Final = (
    "nserver_emu.simulation.", "nserver_emu.server.arm", "nserver_emu.server.graphics", "nserver_emu.server.pace",
    "nserver_emu.server.traces", "nserver_emu.server.transcript", "worlds.",
)  # fmt: skip
_json: Final = json.JSONEncoder(separators=(",", ":")).encode
_PLAIN: Final = (type(None), bool, int, float, str)
_NUMBERS: Final = "biuf"
_PIECE: Final = 65_536
"""Characters that are made bytes at once."""
_MOST_NESTED: Final = 200
_DAMAGED: Final = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, AssertionError, RecursionError, MemoryError,
)  # fmt: skip
"""What reading and trying damaged data leads to."""


def save(emulator: Emulator, path: Path) -> None:
    """Write a snapshot. Raises SnapshotError where it cannot be written."""
    write(dumps(emulator), path, path.with_name(f".{path.name}.{os.getpid()}"))


def write(text: str, path: Path, unfinished: Path) -> None:
    """Put a snapshot's text into a file: whoever reads it meanwhile, or after the power failed, has the old one or the
    new one, never half of one. `unfinished`: what it is called until it is whole, in the same folder.

    Raises SnapshotError where it cannot be written, or could not be read again; the old one is still there.
    """
    if len(text) > SNAPSHOT_BYTES:  # all of it ASCII
        raise SnapshotError(f"{path}: cannot be written: {len(text)} bytes, and no more than {SNAPSHOT_BYTES} are read "
                            "again; lower --limit-graphics or --limit-obstacles")
    try:
        if path.exists() and not path.is_file():  # a device, a pipe: nothing may take its place
            path.write_text(text, encoding="utf-8")
            return
        with unfinished.open("w", encoding="utf-8") as file:
            for begin in range(0, len(text), _PIECE):
                file.write(text[begin : begin + _PIECE])
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
        _settle(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise SnapshotError(unwritable(path, error)) from error
    except ValueError as error:  # a name with a zero byte in it
        raise SnapshotError(f"{str(path)!r}: cannot be written: {error}") from error


def _settle(folder: Path) -> None:
    """The new name is on the disk, too, where the system opens folders."""
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


def restore(emulator: Emulator, path: Path) -> None:
    """Put an emulator into the state of a file. Raises SnapshotError, and then the emulator is as it was."""
    loads(emulator, read_text(path, SNAPSHOT_BYTES, SnapshotError), str(path))


def dumps(emulator: Emulator) -> str:
    """The snapshot of an emulator as text."""
    writer = _Writer()
    root = writer.value({name: getattr(emulator, name) for name in KEPT})
    head = _json({"format": FORMAT, "version": version("nomad-nserver"), "root": root})
    return writer.whole(f'{head[:-1]},"objects":[', "]}")


def loads(emulator: Emulator, text: str, name: str = "snapshot") -> None:
    """Put an emulator into the state of a snapshot; `name` is what errors call it."""
    try:
        whole = json.loads(text)
        if not isinstance(whole, dict) or whole.get("format") != FORMAT:
            raise SnapshotError("is no snapshot of an nserver")
        if whole.get("version") != version("nomad-nserver"):
            raise SnapshotError(f"was made by version {whole.get('version')} and can be read by that one only")
        parts, tried = (_Reader(whole["objects"]).value(whole["root"]) for _ in range(2))
        for part in KEPT:
            if type(parts[part]) is not type(getattr(emulator, part)):
                raise SnapshotError(f"its {part} is none")
        parts["pace"].check()
        try_out(tried["simulation"])
    except SnapshotError as error:
        raise SnapshotError(f"{name}: {error}") from None
    except _DAMAGED as error:
        raise SnapshotError(f"{name}: is damaged: {type(error).__name__}: {error}") from error
    for part in KEPT:
        setattr(emulator, part, parts[part])
    emulator.look_anew()
    emulator.drivers.orphan(emulator.simulation.robots)


class _Writer:
    """Objects to numbers, and to text at once, all in one piece: as dictionaries they would take ten times the memory
    until the end, and leave holes. What it cannot write it names."""

    def __init__(self) -> None:
        self._text = bytearray()
        self._begins, self._ends = array("q"), array("q")
        self._numbers: dict[int, int] = {}
        self._alive: list[Any] = []

    def value(self, thing: Any) -> Any:
        """A value as it stands in the file."""
        if type(thing) in _PLAIN:
            return thing
        number = self._numbers.get(id(thing))
        if number is None:
            number = len(self._alive)
            self._numbers[id(thing)] = number
            self._alive.append(thing)
            self._begins.append(0)
            self._ends.append(0)
            written = _json(self._object(thing))  # before it all that it holds, if that is not written yet
            self._begins[number] = len(self._text)
            self._text += written.encode()
            self._ends[number] = len(self._text)
        return {"ref": number}

    def whole(self, head: str, tail: str) -> str:
        """The text of all objects by their numbers, between two others. The end: it writes nothing more."""
        whole = bytearray(head.encode())
        for begin, end in zip(self._begins, self._ends, strict=True):
            whole += self._text[begin:end]
            whole += b","
        whole[-1:] = tail.encode()
        self._text.clear()
        return whole.decode()

    def _object(self, thing: Any) -> dict[str, Any]:
        match thing:
            case type():
                return {"is": "class", "of": _name(thing)}
            case Enum():
                return {"is": "member", "class": _name(type(thing)), "of": thing.name}
            case np.generic():
                return {"is": "array", "dtype": thing.dtype.str, "shape": [], "locked": False, "of": [thing.item()]}
            case np.ndarray():
                return {"is": "array", "dtype": thing.dtype.str, "shape": list(thing.shape),
                        "locked": not thing.flags.writeable, "of": thing.ravel().tolist()}  # fmt: skip
            case np.random.Generator():
                return {"is": "chance", "of": thing.bit_generator.state}
            case dict() | MappingProxyType():
                kind = "dict" if isinstance(thing, dict) else "view"
                return {"is": kind, "of": [[self.value(key), self.value(value)] for key, value in thing.items()]}
            case tuple() if hasattr(thing, "_fields"):
                return {"is": "record", "class": _name(type(thing)), "of": [self.value(item) for item in thing]}
            case list() | tuple() | set() | frozenset():
                return {"is": type(thing).__name__, "of": [self.value(item) for item in thing]}
            case array(typecode="d"):
                return {"is": "doubles", "of": b64encode(_as_kept(thing).tobytes()).decode()}
            case deque():
                return {"is": "deque", "most": thing.maxlen, "of": [self.value(item) for item in thing]}
            case _:
                return {"is": _name(type(thing)), "of": {k: self.value(v) for k, v in _attributes(thing).items()}}


class _Reader:
    """Plain data back to objects: each made empty first, so that those that hold one another find each other."""

    _COLLECTIONS: Final = {"list": list, "tuple": tuple, "set": set, "frozenset": frozenset}

    def __init__(self, objects: list[dict[str, Any]]) -> None:
        self._objects = objects
        self._made: dict[int, Any] = {}
        self._depth = 0

    def value(self, data: Any) -> Any:
        """What a value of the file means."""
        if not isinstance(data, dict):
            if type(data) not in _PLAIN:
                raise SnapshotError("is damaged: a value that is none")
            return data
        number = data["ref"]
        if number not in self._made:
            self._depth += 1
            if self._depth > _MOST_NESTED:
                raise SnapshotError("is damaged: nested too deeply")
            made = self._make(number, self._objects[number])
            self._made[number] = made
            self._depth -= 1
        return self._made[number]

    def _make(self, number: int, data: dict[str, Any]) -> Any:
        kind, of = data["is"], data["of"]
        match kind:
            case "class":
                return _class(of)
            case "member":
                return _class(data["class"])[of]
            case "array":
                kept = np.dtype(data["dtype"])
                if kept.kind not in _NUMBERS:
                    raise SnapshotError("is damaged: an array of no numbers")
                numbers = np.array(of, dtype=kept).reshape(data["shape"])
                numbers.setflags(write=not data["locked"])
                return numbers if data["shape"] else numbers[()]
            case "chance":
                bits = np.random.PCG64()
                bits.state = of
                return np.random.Generator(bits)
            case "dict" | "view":
                filled = {self.value(key): self.value(value) for key, value in of}
                return filled if kind == "dict" else MappingProxyType(filled)
            case "record":
                return tuple.__new__(_class(data["class"]), [self.value(item) for item in of])
            case "doubles":
                return _as_kept(array("d", b64decode(of, validate=True)))
            case "deque":
                return deque((self.value(item) for item in of), maxlen=data["most"])
            case _ if kind in self._COLLECTIONS:
                return self._COLLECTIONS[kind](self.value(item) for item in of)
        return self._instance(number, _class(kind), of)

    def _instance(self, number: int, kind: type, attributes: Mapping[str, Any]) -> Any:
        made: Any = object.__new__(kind)
        self._made[number] = made
        for name, data in attributes.items():
            if callable(getattr(kind, name, None)) or name.startswith("__"):
                raise SnapshotError(f"is damaged: {kind.__name__} has no attribute {name!r} of its own")
            object.__setattr__(made, name, self.value(data))
        return made


def _as_kept(doubles: array[float]) -> array[float]:
    """Little-endian in the file, whatever this machine is: there and back."""
    if sys.byteorder == "big":
        doubles = doubles[:]
        doubles.byteswap()
    return doubles


def _attributes(thing: Any) -> dict[str, Any]:
    """What an object holds: its dictionary, and its slots."""
    slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
    held = {name: getattr(thing, name) for name in slots if hasattr(thing, name)}
    return held | dict(getattr(thing, "__dict__", {}))


def _name(kind: type) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    if _class(name) is not kind:
        raise SnapshotError(f"a snapshot cannot keep a {name}")
    return name


def _class(name: str) -> Any:
    """A class of the rooms that a snapshot may hold, by its name; raises SnapshotError for any other."""
    module, _, qualified = name.partition(":")
    found = getattr(sys.modules.get(module), qualified, None) if module.startswith(_ROOMS) else None
    if not isinstance(found, type) or found.__module__ != module:
        raise SnapshotError(f"holds a {name}, which no snapshot may hold")
    return found
