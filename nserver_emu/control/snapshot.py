"""Snapshots: the whole simulation of a server as JSON, and back, bit for bit (`nserver --save`, `--restore`).

    {"format": "nserver snapshot", "format_version": 3, "version": version of the package, "state": SnapshotState}

Every part of the simulation has a state, a NamedTuple or a dataclass next to its fields, and `to_state` and
`from_state` (or `set_state`). Its declaration is the schema of the file: NamedTuples are arrays, dataclasses objects.
`decoder` builds a typed state and accepts nothing else, so a file can neither name classes nor nest deeper than the
declarations; parts raise ValueError for values that a simulation cannot have, which bounds the work of a damaged file.
Floats are written with all digits. Random streams continue where they were.

Renaming a field changes the format, and so does adding one: increase FORMAT_VERSION. A dataclass's field whose default
is None may be missing, so that a new part, such as a sensor, leaves older snapshots readable.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

import numpy as np

from nclient.common.files import read_text, write_atomic
from nclient.errors import SnapshotError, version
from nserver_emu.server.admission import SNAPSHOT_BYTES
from nserver_emu.server.config import MAX_ROBOTS
from nserver_emu.server.graphics import MAX_UTTERANCES, Graphics, GraphicsState, Traces, TracesState, Utterance
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import SimulationClock, state_slots
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.axis import Arm, ArmState
from nserver_emu.simulation.simulation import Simulation, SimulationState
from nserver_emu.simulation.sonar import SonarNoise, SonarState
from worlds.rings import nomad_ring

FORMAT: Final = "nserver snapshot"
FORMAT_VERSION: Final = 3
"""Version 1 was a graph of objects with the names of their classes; it can no longer be read. Version 2, in which all
rings were those of the Nomads and fired one sonar at a time, is read as well."""

SAVED_PARTS: Final = ("simulation", "clock", "graphics", "traces", "transcript", "arms")
"""The attributes of an emulator that a snapshot replaces: all but connections, port and permissions, which belong to
the start of a server."""

TYPE_NAMES: Final[Mapping[type, str]] = {SonarNoise: "ray", Polaroid: "polaroid"}
"""Names of the dataclasses that are alternatives of one field; written as "type"."""

TRIAL_S: Final = 0.1
"""Simulated seconds of the trial of a restored simulation."""

MAX_NUMBER: Final = 1e15
"""Larger numbers occur in no simulation; sums and squares of smaller ones do not overflow."""

MAX_BITS: Final = 128
"""Size of the largest integers, the states of random streams."""

MAX_CONTAINERS, MAX_VALUES = 5_000_000, 16_000_000
"""Size of a snapshot: a million shapes have three million arrays and eleven million values."""

_ORDER_OF_SONARS: Final = SonarState._fields.index("firing")

_HEAD: Final = 100
"""Characters within which a snapshot names its format."""

_DAMAGED: Final = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, AssertionError, RecursionError,
                   MemoryError)
"""Errors that damaged data causes while it is read and tried."""

Decoder = Callable[[Any], Any]


@dataclasses.dataclass(frozen=True, slots=True)
class SnapshotState:
    """The state of a server's simulation, and of all that belongs to it."""

    simulation: SimulationState
    clock: SimulationClock
    graphics: GraphicsState
    traces: TracesState
    transcript: tuple[Utterance, ...]
    arms: dict[int, ArmState]

    @classmethod
    def of(cls, emulator: Emulator) -> SnapshotState:
        """Return the state of an emulator."""
        return cls(emulator.simulation.to_state(), emulator.clock, emulator.graphics.to_state(),
                   emulator.traces.to_state(), tuple(emulator.transcript),
                   {robot_id: arm.to_state() for robot_id, arm in emulator.arms.items()})

    def restore(self, emulator: Emulator) -> None:
        """Replace the state of an emulator; raise ValueError, and leave it unchanged, if this one cannot be."""
        # 1. All parts, before the first is replaced.
        self.clock.check()
        if len(self.simulation.robots) > MAX_ROBOTS:
            found = len(self.simulation.robots)
            raise ValueError(f"state.simulation.robots: expected at most {MAX_ROBOTS} robots, found {found}")
        simulation = Simulation.from_state(self.simulation)
        arms = {robot_id: Arm.from_state(arm) for robot_id, arm in self.arms.items()}
        for robot_id in {*arms, *self.traces.actual, *self.traces.encoder}:
            if robot_id not in simulation.robots:
                raise ValueError(f"an arm or a track of robot {robot_id}, which does not exist")
        if not all(0.0 <= arm.time_s <= simulation.time_s for arm in arms.values()):
            raise ValueError("an arm of another time")
        graphics, traces = Graphics.from_state(self.graphics), Traces.from_state(self.traces)
        # 2. A trial of a second simulation and of second arms from the same state.
        validate_snapshot(self.simulation)
        for arm in self.arms.values():
            Arm.from_state(arm).advance_to(simulation.time_s + TRIAL_S)
        # 3. The emulator.
        emulator.simulation, emulator.clock, emulator.arms = simulation, self.clock, arms
        emulator.graphics, emulator.traces = graphics, traces
        emulator.transcript = deque(self.transcript, maxlen=MAX_UTTERANCES)
        emulator.invalidate_state_cache()
        emulator.axis_ownership.release_all(simulation.robots)


def validate_snapshot(state: SimulationState) -> None:
    """Run a simulation from a state for a moment.

    The states of its parts bound the work. Raises ValueError, ArithmeticError, LookupError or TypeError if its numbers
    lead to that.
    """
    simulation = Simulation.from_state(state)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for robot in simulation.robots.values():
            state_slots(robot, 0)
        simulation.step(TRIAL_S)
        for robot in simulation.robots.values():
            state_slots(robot, 0)


# States to JSON and back


def _fields_of(value: Any) -> dict[str, Any]:
    """Return a dataclass as a JSON object; json handles everything else."""
    values = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return {"type": TYPE_NAMES[type(value)], **values} if type(value) in TYPE_NAMES else values


_ENCODER: Final = json.JSONEncoder(default=_fields_of, separators=(",", ":"), allow_nan=False)


@functools.cache
def decoder(kind: Any) -> Decoder:
    """Return the function that makes a value of a declared type out of JSON data.

    It raises ValueError, TypeError or KeyError for data of another type.
    """
    # 1. Scalars.
    if kind in (bool, int, float, str):
        return _SCALARS[kind]
    # 2. Generic types.
    arguments = get_args(kind)
    match get_origin(kind):
        case origin if origin is tuple:
            return _tuple_decoder(arguments)
        case origin if origin is dict:
            return _dict_decoder(decoder(arguments[0]), decoder(arguments[1]), is_number=arguments[0] is int)
        case origin if origin is Union or origin is UnionType:
            return _union_decoder(arguments)
    # 3. Enumerations, dataclasses and NamedTuples.
    if issubclass(kind, Enum):
        # True and 1.0 equal the 1 of an IntEnum.
        return _expecting(f"a {kind.__name__}", lambda data: not isinstance(data, bool | float), kind)
    hints = get_type_hints(kind)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return _dataclass_decoder(kind, {field.name: hints[field.name] for field in dataclasses.fields(kind)})
    fields = _tuple_decoder(tuple(hints[name] for name in kind._fields))
    return lambda data: kind(*fields(data))


def _expecting(what: str, is_valid: Callable[[Any], bool], make: Callable[[Any], Any] = lambda data: data) -> Decoder:
    """Return a decoder that checks a value, and says what it expected."""

    def decode(data: Any) -> Any:
        if not is_valid(data):
            raise ValueError(f"expected {what}")
        return make(data)

    return decode


# JSON has no other types than these, and type() distinguishes true and false from numbers.
_SCALARS: Final[Mapping[type, Decoder]] = {
    bool: _expecting("true or false", lambda data: isinstance(data, bool)),
    int: _expecting("a whole number", lambda data: type(data) is int and data.bit_length() <= MAX_BITS),
    float: _expecting(
        "a number", lambda data: type(data) in (int, float) and isfinite(data) and abs(data) <= MAX_NUMBER, float
    ),
    str: _expecting("a text", lambda data: isinstance(data, str)),
}
_array: Final = _expecting("an array", lambda data: isinstance(data, list))
_object: Final = _expecting("an object", lambda data: isinstance(data, dict))


def _decode(decode: Decoder, data: Any, key: str | int) -> Any:
    """Return the value of a part; errors name its key."""
    try:
        return decode(data)
    except _InvalidPart as error:
        error.keys.insert(0, key)
        raise
    except (ValueError, TypeError, LookupError) as error:
        reason = f"a {error.args[0]!r:.40} is missing" if isinstance(error, KeyError) else str(error)
        raise _InvalidPart(reason, key) from error


class _InvalidPart(ValueError):
    """A part of a snapshot with an invalid value; `keys` lead to it."""

    def __init__(self, reason: str, key: str | int) -> None:
        super().__init__(reason)
        self.keys = [key]

    def __str__(self) -> str:
        place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in self.keys)
        return f"state{place}: {self.args[0]}"


def _tuple_decoder(kinds: tuple[Any, ...]) -> Decoder:
    # tuple[X, ...] has any length, tuple[X, Y] exactly its own.
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        item = decoder(kinds[0])
        return lambda data: tuple([_decode(item, value, index) for index, value in enumerate(_array(data))])
    items = [decoder(kind) for kind in kinds]

    def decode(data: Any) -> Any:
        if len(_array(data)) != len(items):
            raise ValueError(f"expected {len(items)} values, found {len(data)}")
        return tuple([_decode(item, value, index) for index, (item, value) in enumerate(zip(items, data, strict=True))])

    return decode


def _dict_decoder(key: Decoder, value: Decoder, *, is_number: bool) -> Decoder:
    def decode(data: Any) -> Any:
        # Keys of JSON objects are texts, also those that stand for numbers.
        pairs = ((int(name) if is_number else name, each) for name, each in _object(data).items())
        return {key(name): _decode(value, each, name) for name, each in pairs}

    return decode


def _union_decoder(kinds: tuple[Any, ...]) -> Decoder:
    choices = [kind for kind in kinds if kind is not NoneType]
    if len(choices) == 1:
        only = decoder(choices[0])
        return lambda data: None if data is None else only(data)
    by_name = {TYPE_NAMES[kind]: decoder(kind) for kind in choices}
    return lambda data: by_name[_object(data)["type"]](data)


def _dataclass_decoder(kind: type, hints: Mapping[str, Any]) -> Decoder:
    fields = {name: decoder(hint) for name, hint in hints.items()}
    names = {*fields, "type"} if kind in TYPE_NAMES else {*fields}
    # Parts of a state that earlier versions did not have.
    optional = {field.name for field in dataclasses.fields(kind) if field.default is None}

    def decode(data: Any) -> Any:
        if not names - optional <= _object(data).keys() <= names:
            raise ValueError(f"expected the fields of a {kind.__name__}")
        return kind(**{name: _decode(field, data[name], name) for name, field in fields.items() if name in data})

    return decode


# Files


def save(emulator: Emulator, path: Path) -> None:
    """Write a snapshot to a regular file. Raises SnapshotError where it cannot be written."""
    write(dumps(emulator), path)


def require_regular(path: Path) -> None:
    """Raise SnapshotError for a pipe or a device, which could block the whole server; a new file is possible."""
    if path.exists() and not path.is_file():
        raise SnapshotError(f"{path}: cannot be written: it is no regular file; name another file")


def write(text: str, path: Path, ending: str = "") -> None:
    """Write a snapshot's text to a regular file.

    Raises SnapshotError, and leaves the previous file, if it cannot be written or would be too long to be read again.

    Parameters
    ----------
    ending
        Of the temporary file, as for `write_atomic`.
    """
    require_regular(path)
    if len(text) > SNAPSHOT_BYTES:  # the text is ASCII
        raise SnapshotError(f"{path}: cannot be written: {len(text)} bytes, and no more than {SNAPSHOT_BYTES} are read "
                            "again; lower --limit-graphics or --limit-obstacles")
    write_atomic(path, text, SnapshotError, ending)


def restore(emulator: Emulator, path: Path) -> None:
    """Replace the state of an emulator by that of a file. Raises SnapshotError and leaves the emulator unchanged."""
    loads(emulator, text_of(path), str(path))


def text_of(path: Path) -> str:
    """Return the text of a snapshot's file. Raises SnapshotError."""
    return read_text(path, SNAPSHOT_BYTES, SnapshotError)


def dumps(emulator: Emulator) -> str:
    """Return the snapshot of an emulator as text."""
    whole = {
        "format": FORMAT, "format_version": FORMAT_VERSION, "version": version(), "state": SnapshotState.of(emulator),
    }  # fmt: skip
    # Chunk by chunk: json.dumps holds all chunks until the end, seven times the memory of the text.
    text = bytearray()
    for chunk in _ENCODER.iterencode(whole):
        text += chunk.encode()
    return text.decode()


def _check_size(text: str) -> None:
    """Raise SnapshotError if reading a text would take much more memory than the text itself."""
    for what, found, maximum in (
        ("arrays and objects", text.count("[") + text.count("{"), MAX_CONTAINERS),
        ("values", text.count(","), MAX_VALUES),
    ):
        if found > maximum:
            raise SnapshotError(f"is damaged: expected at most {maximum} {what}, found {found}")


def _upgrade_rings(state: Any) -> None:
    """Turn the sonar rings of a state of format version 2 into those of today, in place; _DAMAGED if it is no state."""
    for robot in state["simulation"]["robots"].values():
        # 1. The body had a radius and angles.
        body = robot["model"]["body"]
        if "sonar_angles_rad" in body:
            radius_in, angles_rad = body.pop("sonar_ring_radius_in"), body.pop("sonar_angles_rad")
            nomad = json.loads(_ENCODER.encode(nomad_ring(0.0)))
            body["ring"] = {**nomad, "radius_in": radius_in, "angles_rad": angles_rad}
        # 2. The order was one of single sonars.
        robot["sonar"][_ORDER_OF_SONARS] = [[sonar] for sonar in robot["sonar"][_ORDER_OF_SONARS]]


def loads(emulator: Emulator, text: str, name: str = "snapshot") -> None:
    """Replace the state of an emulator by that of a snapshot; `name` is the file's name in errors."""
    try:
        # 1. Format and version.
        if FORMAT not in text[:_HEAD]:
            raise SnapshotError("is no snapshot of an nserver")
        _check_size(text)
        whole = json.loads(text)
        if not isinstance(whole, dict) or whole.get("format") != FORMAT:
            raise SnapshotError("is no snapshot of an nserver")
        if (found := whole.get("format_version", 1)) == 2:
            _upgrade_rings(whole["state"])
        elif found != FORMAT_VERSION:
            raise SnapshotError(f"has format version {found!r:.20}, saved by nserver {whole.get('version')!r:.20}; "
                                f"this nserver reads format version {FORMAT_VERSION} only")
        # 2. The state.
        decoder(SnapshotState)(whole["state"]).restore(emulator)
    except SnapshotError as error:
        raise SnapshotError(f"{name}: {error}") from None
    except _InvalidPart as error:
        raise SnapshotError(f"{name}: is damaged: {error}") from None
    except _DAMAGED as error:
        raise SnapshotError(f"{name}: is damaged: {type(error).__name__}: {error}") from error
