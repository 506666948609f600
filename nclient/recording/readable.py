"""A recording for people: a line for each frame that went by, in inches, degrees and seconds.

       0.100  > vm 100 -50 0                                                        to the robot, as the C call
       0.104  < state x 0.0 y 0.0 steer 0.0 turret 0.0 v 10.0 -5.0 0.0 ...          from it
       0.105  < ! 3 bytes that are no frame

Rules: text only. What is told is what the decoded frames hold; State's slots are named as PROTOCOL.md names them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from nclient.errors import RecordingError
from nclient.recording.format import IN, OUT, TIME, Entry

_POSE: Final = ((34, "x"), (35, "y"), (36, "steer"), (37, "turret"))
_SONARS, _INFRAREDS, _SPEEDS = slice(17, 33), slice(1, 17), slice(38, 41)
_OF_OPEN: Final = ("wire", "model")
_ARROWS: Final = {OUT: ">", IN: "<"}
_SHOWN: Final[Mapping[str, tuple[str, ...]]] = {
    "state": ("pose", "v", "sonar", "infrared", "bumper", "compass", "laser", "clock", "volts"),
    "sonar": ("sonar", "clock"), "infrared": ("infrared", "clock"), "bumper": ("bumper", "clock"),
    "compass": ("compass", "clock"), "configuration": ("pose",), "velocity": ("v",), "laser": ("laser", "clock"),
}  # fmt: skip
Found = Mapping[str, Any]
State = list[Any]


def lines_of(entry: Entry, with_bytes: bool = False) -> Iterator[str]:
    """The lines for one entry, none where only time passed. `with_bytes`: the bytes, too.

    Raises RecordingError where `decoded` is not as a recorder writes it.
    """
    start = f"{entry.time_s:10.3f}  {entry.connection + ' ' if entry.connection else ''}"
    if entry.kind not in _ARROWS:
        if entry.kind != TIME:
            what = (str(entry.more[name]) for name in _OF_OPEN if name in entry.more)
            yield " ".join((f"{start}--", entry.kind, *what))
        return
    for found in entry.decoded:
        yield f"{start}{_ARROWS[entry.kind]} {_told_of(entry, found)}"
    if with_bytes and entry.data:
        yield f"{start}{_ARROWS[entry.kind]} [{entry.data.hex(' ')}]"


def _told_of(entry: Entry, found: Found) -> str:
    """Frames out of a file may be anybody's."""
    try:
        return told(found)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise RecordingError(f"line {entry.line}: `decoded` is not as a recorder writes it ({error!r:.80}); "
                             "take it out of that line, the bytes are enough") from None


def told(found: Found) -> str:
    """A decoded frame in words."""
    if "error" in found:
        return f"! {found['error']}"
    if "call" in found:
        return " ".join((str(found["call"]), *map(str, found["args"]), *_beside(found)))
    kind = str(found["reply"])
    parts = [part for name in _SHOWN.get(kind, ()) if (part := _part(name, found))]
    if kind not in _SHOWN and "values" in found:
        parts = [" ".join(map(str, found["values"]))]
    named = any(part.startswith(f"{kind} ") for part in parts)
    return " ".join(parts if named else (kind, *parts))


def _beside(found: Found) -> Iterator[str]:
    if "mask" in found:
        yield "mask " + "".join(map(str, found["mask"]))
    yield from (f"({name} {found[name]})" for name in ("pid", "packet_type") if name in found)


def _part(name: str, found: Found) -> str:
    return _PARTS[name](found["State"], found)


def _pose(state: State, _: Found) -> str:
    return " ".join(f"{what} {state[slot] / 10:g}" for slot, what in _POSE if state[slot] is not None)


def _speeds(state: State, _: Found) -> str:
    return _listed("v", [None if v is None else v / 10 for v in state[_SPEEDS]])


def _laser(_: State, found: Found) -> str:
    return f"laser {found['Laser'][0]} readings" if found["Laser"] and found["Laser"][0] else ""


def _clock(_: State, found: Found) -> str:
    return "" if found["clock"] is None else f"clock {found['clock'] / 1000:g}"


def _volts(_: State, found: Found) -> str:
    return "" if found["volt_cpu"] is None else f"volts {found['volt_cpu']:.1f} {found['volt_motor']:.1f}"


def _listed(name: str, values: list[float | None]) -> str:
    return "" if None in values else f"{name} {' '.join(f'{value:g}' for value in values if value is not None)}"


_PARTS: Final[Mapping[str, Callable[[State, Found], str]]] = {
    "pose": _pose,
    "v": _speeds,
    "sonar": lambda state, _: _listed("sonar", state[_SONARS]),
    "infrared": lambda state, _: _listed("infrared", state[_INFRAREDS]),
    "bumper": lambda state, _: "" if state[33] is None else f"bumper {state[33]:#x}",
    "compass": lambda state, _: "" if state[43] is None else f"compass {state[43] / 10:g}",
    "laser": _laser,
    "clock": _clock,
    "volts": _volts,
}
"""What is told of each part of a reply; "" where the reply does not have it."""
