"""Objects as plain data and back: KINDS, a row a kind of object that a snapshot can hold.

    value     null | true | 1 | 0.5 | "text" | {"ref": number of an object}
    object    {"is": "list", "of": values} and the like; {"is": "module:Class", "of": {attribute: value}}

Rules: a stranger's file can name classes of the simulation and the worlds and nothing else, and reading it calls no
function of theirs, not even a constructor. Objects that are one stay one. Long tracks are base64 of their doubles;
chance goes on where it was. No file.

A simulation out of a stranger's file lives for a moment, so that what is wrong with it shows now and not later.

Rules: it is let do a bounded amount of work, whatever its clocks say; numbers that overflow or are none are refused
where they arise. The simulation that is tried is a copy, and is used for nothing else. No file, no clock.

The whole simulation as text and back, bit for bit: what `nserver --save` writes and `--restore` reads.

    {"format": "nserver snapshot", "version": ..., "root": value, "objects": [object, ...]}

Rules: JSON, no pickle; what values and objects are is snapshot_objects.py's. Floats are written so that they read back
the same. Writing takes little more memory than the text: it is done again and again beside clients who wait.
"""

from __future__ import annotations

import json
import sys
from array import array
from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from functools import partial
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from nclient.common.files import read_text, write_atomic
from nclient.common.hints import version
from nclient.errors import SnapshotError
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.limits import SNAPSHOT_BYTES
from nserver_emu.server.state_encoder import state_slots
from nserver_emu.simulation.simulation import Simulation

_ROOMS: Final = (
    "nserver_emu.simulation.", "nserver_emu.simulation.arm", "nserver_emu.server.graphics",
    "nserver_emu.server.context", "nserver_emu.server.graphics", "nserver_emu.server.context",
    "worlds.",
)  # fmt: skip
_json: Final = json.JSONEncoder(separators=(",", ":")).encode
_PLAIN: Final = (type(None), bool, int, float, str)
_NUMBERS: Final = {
    kept.str: kept
    for kind in (np.bool_, np.int32, np.int64, np.float64) for kept in (np.dtype(kind), np.dtype(kind).newbyteorder())
}  # fmt: skip
"""Arrays of these alone, by what numpy calls them. Its own reader of such texts evaluates what stands in them."""
_MOST_NESTED: Final = 200

Data = dict[str, Any]
"""An object as it stands in the file."""
Value = Callable[[Any], Any]
"""What stands for a thing in the file, or is meant by what stands there."""


class Kind(NamedTuple):
    """A row: what stands under "is"; which types are of it; the rest of a thing's data, and the thing of its data."""

    name: str
    has: Callable[[type], bool]
    data: Callable[[Any, Value], Data]
    thing: Callable[[Data, Value], Any]


class Writer:
    """Objects to numbers, and to text at once, all in one piece: as dictionaries they would take ten times the memory
    until the end, and leave holes. What it cannot write it names."""

    def __init__(self) -> None:
        self._text = bytearray()
        self._begins, self._ends = array("q"), array("q")
        self._numbers: dict[int, int] = {}
        self._alive: list[Any] = []
        self._kinds: dict[type, Kind | None] = {}

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

    def _object(self, thing: Any) -> Data:
        of = type(thing)
        if of not in self._kinds:
            self._kinds[of] = next((kind for kind in KINDS if kind.has(of)), None)
        kind = self._kinds[of]
        if kind is not None:
            return {"is": kind.name, **kind.data(thing, self.value)}
        return {"is": _name(of), "of": {name: self.value(held) for name, held in _attributes(thing).items()}}


class Reader:
    """Plain data back to objects: each made empty first, so that those that hold one another find each other."""

    def __init__(self, objects: list[Data]) -> None:
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
            made = self._object(number, self._objects[number])
            self._made[number] = made
            self._depth -= 1
        return self._made[number]

    def _object(self, number: int, data: Data) -> Any:
        kind = _BY_NAME.get(data["is"])
        if kind is not None:
            return kind.thing(data, self.value)
        return self._instance(number, _class(data["is"]), data["of"])

    def _instance(self, number: int, kind: type, attributes: Mapping[str, Any]) -> Any:
        made: Any = object.__new__(kind)
        self._made[number] = made
        for name, data in attributes.items():
            if callable(getattr(kind, name, None)) or name.startswith("__"):
                raise SnapshotError(f"is damaged: {kind.__name__} has no attribute {name!r} of its own")
            object.__setattr__(made, name, self.value(data))
        return made


def _under(*kinds: type) -> Callable[[type], bool]:
    return lambda kind: issubclass(kind, kinds)


def _is_record(kind: type) -> bool:
    return issubclass(kind, tuple) and hasattr(kind, "_fields")


def _numbers_data(thing: Any, _value: Value) -> Data:
    if thing.dtype.str not in _NUMBERS:
        raise SnapshotError(f"a snapshot cannot keep an array of {thing.dtype}")
    locked = isinstance(thing, np.ndarray) and not thing.flags.writeable
    return {"dtype": thing.dtype.str, "shape": list(thing.shape), "locked": locked, "of": thing.ravel().tolist()}


def _numbers(data: Data, _value: Value) -> Any:
    kept = _NUMBERS.get(data["dtype"])
    if kept is None:
        raise SnapshotError("is damaged: an array of no numbers")
    numbers = np.array(data["of"], dtype=kept).reshape(data["shape"])
    numbers.setflags(write=not data["locked"])
    return numbers if data["shape"] else numbers[()]


def _chance(data: Data, _value: Value) -> np.random.Generator:
    bits = np.random.PCG64()
    bits.state = data["of"]
    return np.random.Generator(bits)


def _pairs_data(thing: Mapping[Any, Any], value: Value) -> Data:
    return {"of": [[value(key), value(each)] for key, each in thing.items()]}


def _pairs(data: Data, value: Value) -> dict[Any, Any]:
    return {value(key): value(each) for key, each in data["of"]}


def _items_data(thing: Any, value: Value) -> Data:
    return {"of": [value(item) for item in thing]}


def _items(collection: Callable[[Any], Any], data: Data, value: Value) -> Any:
    return collection(value(item) for item in data["of"])


def _doubles_data(thing: array[float], _value: Value) -> Data:
    if thing.typecode != "d":
        raise SnapshotError(f"a snapshot cannot keep an array of {thing.typecode!r}")
    return {"of": b64encode(_little_endian(thing).tobytes()).decode()}


def _doubles(data: Data, _value: Value) -> array[float]:
    return _little_endian(array("d", b64decode(data["of"], validate=True)))


def _little_endian(doubles: array[float]) -> array[float]:
    """As in the file, whatever this machine is: there and back."""
    if sys.byteorder == "big":
        doubles = doubles[:]
        doubles.byteswap()
    return doubles


KINDS: Final = (
    Kind("class", _under(type),
         lambda thing, _: {"of": _name(thing)},
         lambda data, _: _class(data["of"])),
    Kind("member", _under(Enum),
         lambda thing, _: {"class": _name(type(thing)), "of": thing.name},
         lambda data, _: _class(data["class"])[data["of"]]),
    Kind("array", _under(np.generic, np.ndarray), _numbers_data, _numbers),
    Kind("chance", _under(np.random.Generator), lambda thing, _: {"of": thing.bit_generator.state}, _chance),
    Kind("dict", _under(dict), _pairs_data, _pairs),
    Kind("view", _under(MappingProxyType), _pairs_data, lambda data, value: MappingProxyType(_pairs(data, value))),
    Kind("record", _is_record,
         lambda thing, value: {"class": _name(type(thing)), **_items_data(thing, value)},
         lambda data, value: tuple.__new__(_class(data["class"]), [value(item) for item in data["of"]])),
    *(Kind(each.__name__, _under(each), _items_data, partial(_items, each)) for each in (list, tuple, set, frozenset)),
    Kind("doubles", _under(array), _doubles_data, _doubles),
    Kind("deque", _under(deque),
         lambda thing, value: {"most": thing.maxlen, **_items_data(thing, value)},
         lambda data, value: deque((value(item) for item in data["of"]), maxlen=data["most"])),
)  # fmt: skip
"""The first row that has a type counts; an object of no kind here is its class and its attributes."""
_BY_NAME: Final = {kind.name: kind for kind in KINDS}


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


TRIED_S: Final = 0.1
CALLS: Final = 50_000
"""Function calls that it may take, times the square of one more than there are robots: they hear one another. Ten
robots that hear as measured take 140,000."""
_CALLS: Final = ("call", "c_call")


def try_out(simulation: Simulation) -> None:
    """Let a simulation live for a moment.

    Raises SnapshotError where it does not come to its end, ValueError for clocks that cannot be, or whatever its
    numbers and missing parts lead to: ArithmeticError, TypeError, LookupError, AttributeError.
    """
    for robot in simulation.robots.values():
        robot.sonar.check()
    _bounded(lambda: _live(simulation), CALLS * (1 + len(simulation.robots)) ** 2)


def _live(simulation: Simulation) -> None:
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for robot in simulation.robots.values():
            state_slots(robot, 0)
        simulation.step(TRIED_S)
        for robot in simulation.robots.values():
            state_slots(robot, 0)


class Budget:
    """So many calls of functions, Python's own and C's. `count` is a profile function (sys.setprofile)."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def count(self, _frame: FrameType | None, event: str, _argument: Any) -> None:
        """Something happened; raises SnapshotError where that call is one too many."""
        self.left -= event in _CALLS
        if self.left < 0:
            raise SnapshotError("is damaged: its time has no end")


def _bounded(act: Callable[[], None], most_calls: int) -> None:
    """Do something that makes so many calls at most."""
    before = sys.getprofile()
    sys.setprofile(Budget(most_calls).count)
    try:
        act()
    finally:
        sys.setprofile(before)


FORMAT: Final = "nserver snapshot"
KEPT: Final = ("simulation", "clock", "graphics", "traces", "transcript", "arms")
"""What of an emulator is kept: all but connections, port and permissions, which belong to a daemon's start."""

_NONE: Final = "is no snapshot of an nserver"
_HEAD: Final = 100
"""Characters among which one says what it is."""
_DAMAGED: Final = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, AssertionError, RecursionError, MemoryError,
)  # fmt: skip
"""What reading and trying damaged data leads to."""


def save(emulator: Emulator, path: Path) -> None:
    """Write a snapshot. Raises SnapshotError where it cannot be written."""
    write(dumps(emulator), path)


def write(text: str, path: Path, ending: str = "") -> None:
    """Put a snapshot's text into a file. `ending`: as write_whole has it.

    Raises SnapshotError where it cannot be written, or could not be read again; the old one is still there.
    """
    if len(text) > SNAPSHOT_BYTES:  # all of it ASCII
        raise SnapshotError(f"{path}: cannot be written: {len(text)} bytes, and no more than {SNAPSHOT_BYTES} are read "
                            "again; lower --limit-graphics or --limit-obstacles")
    write_atomic(path, text, SnapshotError, ending)


def restore(emulator: Emulator, path: Path) -> None:
    """Put an emulator into the state of a file. Raises SnapshotError, and then the emulator is as it was."""
    loads(emulator, text_of(path), str(path))


def text_of(path: Path) -> str:
    """What stands in a snapshot's file. Raises SnapshotError."""
    return read_text(path, SNAPSHOT_BYTES, SnapshotError)


def dumps(emulator: Emulator) -> str:
    """The snapshot of an emulator as text."""
    writer = Writer()
    root = writer.value({name: getattr(emulator, name) for name in KEPT})
    head = json.dumps({"format": FORMAT, "version": version(), "root": root}, separators=(",", ":"))
    return writer.whole(f'{head[:-1]},"objects":[', "]}")


def loads(emulator: Emulator, text: str, name: str = "snapshot") -> None:
    """Put an emulator into the state of a snapshot; `name` is what errors call it."""
    try:
        if FORMAT not in text[:_HEAD]:
            raise SnapshotError(_NONE)
        whole = json.loads(text)
        if not isinstance(whole, dict) or whole.get("format") != FORMAT:
            raise SnapshotError(_NONE)
        if whole.get("version") != version():
            raise SnapshotError(f"was made by version {whole.get('version')} and can be read by that one only")
        parts, tried = (Reader(whole["objects"]).value(whole["root"]) for _ in range(2))
        for part in KEPT:
            if type(parts[part]) is not type(getattr(emulator, part)):
                raise SnapshotError(f"its {part} is none")
        parts["clock"].check()
        try_out(tried["simulation"])
    except SnapshotError as error:
        raise SnapshotError(f"{name}: {error}") from None
    except _DAMAGED as error:
        raise SnapshotError(f"{name}: is damaged: {type(error).__name__}: {error}") from error
    for part in KEPT:
        setattr(emulator, part, parts[part])
    emulator.invalidate_state_cache()
    emulator.axis_ownership.release_all(emulator.simulation.robots)
