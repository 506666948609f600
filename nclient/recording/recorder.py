"""Writes down what goes over connections: one recorder a file, one tape a connection.

    recorder.open(name, line, model) ──> tape.to_robot(bytes)   tape.to_host(bytes)   tape.close()
    recorder.stepped(dt_s)               simulated time passed that nobody asked for

Rules: the clock is handed in; without one, time is the robot's own clock as its answers tell it, so that a run in
simulated time is recorded the same whenever it is made. OFF records nothing and costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

from nclient.protocol.models import Model
from nclient.recording.follower import TCP, Follower
from nclient.recording.log import CLOSE, IN, OPEN, OUT, TIME, Entry, LogWriter

_MOST_PIECES: Final = 1000
"""Different pieces of time that are kept before they are written down."""
_DIGITS: Final = 6


class Tape(Protocol):
    """What records one connection."""

    def to_robot(self, data: bytes) -> None:
        """These bytes went to the robot."""
        ...

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        """These came from it; none: it was asked something, and has said nothing yet. `by_time`: since time passed."""
        ...

    def close(self) -> None:
        """The connection is over. Twice is fine."""
        ...


class Recorder:
    """Everything of a daemon, or of a client.

    clock       seconds since the start; None: the robot's own clock
    line_clock  what a daemon takes the age of half a frame from on a robot's own line, noted as `at`
    """

    def __init__(
        self, log: LogWriter, clock: Callable[[], float] | None = None, line_clock: Callable[[], float] | None = None
    ) -> None:
        self._log = log
        self._clock = clock
        self.line_clock = line_clock
        self._steps: list[tuple[float, int]] = []

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> Tape:
        """A tape for a connection of that name. `line`: one of follower.LINES; `robot_id`: whose own line it is."""
        tape = _ConnectionTape(self, name, Follower(line, model), None if line == TCP else self.line_clock)
        whose: dict[str, object] = {} if robot_id is None else {"robot_id": robot_id}
        self.write(OPEN, name, 0.0, more={"wire": line, "model": model.name} | whose)
        return tape

    def stepped(self, dt_s: float) -> None:
        """So much simulated time passed in one piece, not by a request."""
        if self._steps and self._steps[-1][0] == dt_s:
            self._steps[-1] = (dt_s, self._steps[-1][1] + 1)
            return
        if len(self._steps) >= _MOST_PIECES:
            self.write(TIME, "", 0.0)
        self._steps.append((dt_s, 1))

    def paced(self, factor: float | None, paused: bool) -> None:
        """Time goes otherwise from now on, by no request; State[0] shows it."""
        self.write(TIME, "", 0.0, more={"pace": [factor, paused]})

    def changed(self, what: Mapping[str, Any]) -> None:
        """The simulation was changed so from now on, by no request."""
        self.write(TIME, "", 0.0, more=dict(what))

    def write(
        self, kind: str, name: str, robots_clock_s: float, data: bytes = b"",
        decoded: tuple[dict[str, object], ...] = (), more: dict[str, object] | None = None,
    ) -> None:  # fmt: skip
        """Add an entry, and the time that passed before it."""
        now_s = round(robots_clock_s if self._clock is None else self._clock(), _DIGITS)
        passed: dict[str, object] = {"steps": [list(piece) for piece in self._steps]} if self._steps else {}
        self._steps.clear()
        self._log.write(Entry(now_s, kind, name, data, decoded, (more or {}) | passed))

    def rest(self) -> None:
        """Let the file go until there is something to write again."""
        self._log.rest()

    def close(self) -> None:
        """Write what time passed last, and let the file go."""
        if self._steps:
            self.write(TIME, "", 0.0)
        self._log.close()


class _ConnectionTape:
    """See Tape."""

    def __init__(
        self, recorder: Recorder, name: str, follower: Follower, clock: Callable[[], float] | None
    ) -> None:
        self._recorder, self._name, self._follower = recorder, name, follower
        self._clock = clock
        self._over = False

    def to_robot(self, data: bytes) -> None:
        decoded = tuple(self._follower.to_robot(data))
        self._recorder.write(OUT, self._name, self._follower.clock_s, data, decoded, self._at())

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        decoded = tuple(self._follower.to_host(data))
        more: dict[str, object] = {"by_time": True} if by_time else {}
        self._recorder.write(IN, self._name, self._follower.clock_s, data, decoded, self._at() | more)

    def close(self) -> None:
        if not self._over:
            self._over = True
            self._recorder.write(CLOSE, self._name, self._follower.clock_s)

    def _at(self) -> dict[str, object]:
        return {} if self._clock is None else {"at": self._clock()}


class _Off:
    """Records nothing."""

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> Tape:
        del name, line, model, robot_id
        return self

    def to_robot(self, data: bytes) -> None: ...

    def to_host(self, data: bytes, by_time: bool = False) -> None: ...

    def stepped(self, dt_s: float) -> None: ...

    def paced(self, factor: float | None, paused: bool) -> None: ...

    def changed(self, what: Mapping[str, Any]) -> None: ...

    def close(self) -> None: ...


OFF: Final = _Off()
"""What whoever is not recorded hands things to."""


class AnyRecorder(Protocol):
    """What a daemon hands things to, whether they are written down, looked at, or neither."""

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> Tape: ...
    def stepped(self, dt_s: float) -> None: ...
    def paced(self, factor: float | None, paused: bool) -> None: ...
    def changed(self, what: Mapping[str, Any]) -> None: ...
    def close(self) -> None: ...
