"""What the options of an address put on: for each a function that wraps a stream or a backend.

Rules: functions for the rows of nclient.schemes, each given what it wraps, the option's value, and the opening, in
whose `kept` it leaves what must outlive a stream.
"""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path

from nclient.backends.base import Backend
from nclient.backends.keep_alive import Feeding
from nclient.backends.wrappers import POLL_S, BumperStop, Capped, Reconnecting, Retrying
from nclient.errors import FaultPlanError, RecordingError
from nclient.faults.frames import Injector, LineLanguage, TcpLanguage
from nclient.faults.inject import FaultyLine, FaultyStream
from nclient.faults.plan import Plan, require_rules_for
from nclient.opening import Opening
from nclient.recording.recorder import HELLO_FIRST, TCP, ProgramsRecording, Recorded
from nclient.transports.stream import ByteStream

_FASTEST_FED = 1000
"""State[0] of a simulation a hundred times as fast as time: faster ones nobody feeds, and they need no net."""


# around the stream


def recorded(stream: ByteStream, path: str, opening: Opening) -> ByteStream:
    """The innermost wrapper: what really went over the line. The same file however often the stream is opened."""
    recording = opening.kept.get("record")
    if recording is None:
        try:
            recording = opening.kept["record"] = _recording(Path(path), opening)
        except RecordingError:
            stream.close()
            raise
    recorded: ByteStream = recording.around(stream)
    return recorded


def _recording(path: Path, opening: Opening) -> ProgramsRecording:
    """Who answers in this process has a time of its own, which the robot's clock tells."""
    line = _line_of(opening)
    what = Recorded(opening.foreign_text, line, opening.model)
    if opening.scheme.in_process:
        return ProgramsRecording(path, what)
    start_s = time.monotonic()
    return ProgramsRecording(path, what, lambda: time.monotonic() - start_s, datetime.now(UTC))


def faulty(stream: ByteStream, plan: Plan, opening: Opening) -> ByteStream:
    """Around the recording: what the program gets to see. One count however often the stream is opened."""
    kept = opening.kept
    if "faults" not in kept:
        try:
            require_rules_for(opening.address.scheme, plan)
        except FaultPlanError:
            stream.close()
            raise
        injector = Injector(plan, opening.address.scheme, time.monotonic())
        kept["faults"] = lambda: injector
    line = _line_of(opening)
    greets = line == HELLO_FIRST and opening.model.sends_mask
    language = TcpLanguage(wide=False) if line == TCP else LineLanguage(greets)
    return FaultyStream(stream, FaultyLine(language, kept["faults"]), time.monotonic, time.sleep)


def _line_of(opening: Opening) -> str:
    """What is spoken over the stream, as recordings name it."""
    line: str = opening.kept["script"].line if "script" in opening.kept else opening.scheme.line
    return line


# around the backend


def reconnecting(backend: Backend, longest_pause_s: float, opening: Opening) -> Backend:
    """Opened anew when it is lost."""
    return Reconnecting(backend, opening.talk, longest_pause_s)


def retrying(backend: Backend, retries: int, _opening: Opening) -> Backend:
    """Asked again what may be asked again."""
    return Retrying(backend, retries)


def stopped_by_bumpers(backend: Backend, _on: bool, _opening: Opening) -> Backend:
    """Stopped at a bumper hit."""
    return BumperStop(backend)


def fed(backend: Backend, timeout_s: int, opening: Opening) -> Backend:
    """Its motion's time-out set and fed; by default not in a simulation that nobody could keep up with."""
    speed = backend.greeting.slots.get(0, 0) if backend.greeting else 0
    if speed > _FASTEST_FED and "tm_s" not in opening.address.options:
        return backend
    often = POLL_S if opening.values.get("bumper_stop") else float("inf")
    return Feeding(backend, timeout_s, feeds=opening.values.get("feed", False), at_least_every_s=often)


def capped_speed(backend: Backend, max_speed_in_s: float, _opening: Opening) -> Backend:
    """No faster than so many inches a second."""
    return Capped(backend, max_speed_in_s=max_speed_in_s)


def capped_turn(backend: Backend, max_turn_deg_s: float, _opening: Opening) -> Backend:
    """Turning no faster than so many degrees a second."""
    return Capped(backend, max_turn_deg_s=max_turn_deg_s)
