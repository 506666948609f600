"""What a daemon answers to `nserver ctl`: read, and shown for people to read. Pure.

    {"ok": true, "said": {...}} | {"ok": false, "error": "..."}

Rules: a daemon of another version, or something that is none, costs an error in words and no more.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final

from nclient.errors import ControlError

Said = dict[str, Any]
NO_ANSWER: Final = "what answers there is no nserver of this version"
_NONSENSE: Final = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError)
"""What other answers lead to."""


def said_in(answer: bytes) -> Said:
    """What a line of the daemon says. Raises ControlError where it refuses, or the line is no answer."""
    try:
        told = json.loads(answer)
        refused, said = not told["ok"], told.get("said")
        error = _printable(str(told["error"])).strip() if refused else ""
    except _NONSENSE as nonsense:
        raise ControlError(f"{NO_ANSWER} ({nonsense!r:.80})") from None
    if refused:
        raise ControlError(error or "refused, without a word why")
    if not isinstance(said, dict):
        raise ControlError(NO_ANSWER)
    return said


def shown(said: Said) -> list[str]:
    """An answer for people to read, line by line. Raises ControlError where it is none that we know."""
    try:
        return [_printable(line) for line in _lines(said)]
    except _NONSENSE as error:
        raise ControlError(f"{NO_ANSWER} ({error!r:.80}); --json shows it as it is") from None


def _printable(text: str) -> str:
    """Half a surrogate, which JSON can spell, as it was spelt."""
    return text.encode("utf-8", "backslashreplace").decode()


def _lines(said: Said) -> Iterator[str]:
    if "plan" in said:
        yield said["plan"].rstrip()
    elif "text" in said:
        yield said["text"].rstrip()
    elif "noise" in said:
        yield from (f"robot {number}: {_noise(noise)}" for number, noise in said["noise"].items())
    elif "held" in said:
        yield from (f"robot {number}{_held(hold)}" for number, hold in said["held"].items())
        if not said["held"]:
            yield "no robot is held"
    elif "counts" in said:
        yield from _counts(said["counts"])
    elif "robots" in said:
        yield from _status(said)
    elif "time_s" in said:
        yield _time(said)
    else:
        yield ", ".join(f"{name}: {value}" for name, value in said.items())


def _status(said: dict[str, Any]) -> Iterator[str]:
    yield f"nserver {said['version']}, {said['world']}, seed {said['seed']}"
    yield _time(said)
    for robot in said["robots"]:
        touched = f", bumpers {robot['bumpers']:#x}" if robot["bumpers"] else ""
        yield (
            f"robot {robot['number']}: {robot['model']} at {robot['x_in']:.1f}, {robot['y_in']:.1f} in, "
            f"{robot['steering_deg']:.1f} deg, {'moving' if robot['moving'] else 'standing'}{touched}, "
            f"{_noise(robot['noise'])}{_held(robot['held'])}"
        )
    for name, place in said["lines"].items():
        yield f"line {name}: {place}"
    for client in said["connections"]:
        whose = "no robot yet" if client["robot"] is None else f"robot {client['robot']}"
        yield f"client {client['name']}: {whose}, {client['refused']} refused{', waiting' if client['waiting'] else ''}"
    struck = ", ".join(f"{kind} {count}" for kind, count in said["faults"]["struck"].items())
    yield f"faults: {said['faults']['rules']} rules{f', so far {struck}' if struck else ''}"


def _noise(noise: dict[str, str]) -> str:
    return f"sensors {noise['sensors']}, motion {noise['motion']}"


def _held(hold: dict[str, Any] | None) -> str:
    return "" if hold is None else f", held by {hold['by']}, told to move {hold['ignored']} times since"


def _time(said: dict[str, Any]) -> str:
    if said["paused"]:
        pace = "paused"
    elif said["lockstep_s"] is not None:
        pace = f"lockstep, {said['lockstep_s']:g} s a request"
    else:
        pace = "as fast as it can" if said["speed"] == "max" else f"{said['speed']:g} x real time"
    return f"time {said['time_s']:.3f} s, {pace}"


def _counts(counts: dict[str, dict[str, dict[str, int]]]) -> Iterator[str]:
    if not counts:
        yield "no faults"
    for line, rules in counts.items():
        for rule, tally in rules.items():
            yield f"{line}, {rule}: " + ", ".join(f"{kind} {count}" for kind, count in tally.items())
