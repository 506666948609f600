"""A backend that keeps a robot's time-out fed: a program that lives may sleep, one that is gone leaves a robot at rest.

    connecting ──> conf_tm tm_s ──> nothing said for tm_s / 3 ──> gs, on a thread of its own ──> ...

Rules: one exchange at a time: calls and the feeder share a lock, and a feeder that finds it taken has nothing to do.
What the feeder meets (the link lost, a bumper hit) is raised by the next call. A program that sends conf_tm itself
takes the time-out over: it is fed no more. It feeds only where time runs by itself. ws, during which nothing can be
said, is asked in pieces shorter than the time-out. A robot that was switched off and on is given its time-out again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from nclient.backends.base import Backend, Wrapper, in_pieces, is_wait
from nclient.errors import NomadError, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply

DEFAULT_TIMEOUT_S = 5
SHORTEST_TIMEOUT_S = 2
"""A robot counts whole seconds: one of them is too few to say ws within."""
_SHARE = 3
_SPEED_SLOT, _REAL_TIME = 0, 10
_SHORTEST_INTERVAL_S = 0.005
_GS = Call("gs")


class Feeding(Wrapper):
    """Sets the time-out at once. `feeds`: whether to feed it; `at_least_every_s`: ask that often whatever it is."""

    def __init__(
        self,
        inner: Backend,
        timeout_s: int = DEFAULT_TIMEOUT_S,
        *,
        feeds: bool = True,
        at_least_every_s: float = float("inf"),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(inner)
        self._timeout_s = timeout_s
        self._interval_s = min(timeout_s / _SHARE, at_least_every_s)
        self._clock = clock
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._met: NomadError | None = None
        self._factor = 1.0
        self._robot_ms = 0
        self._greeting = inner.greeting
        self._said_s = clock()
        self._ours = self._set(inner)
        self._thread = threading.Thread(target=self._feed, name="nomad-feeder", daemon=True)
        if feeds and self._ours:
            self._thread.start()

    @property
    def greeting(self) -> Reply | None:
        """The state that came with connecting, at the latest with the time-out."""
        return self._greeting

    def execute(self, call: Call) -> Reply:
        """The answer; or what the feeder met since the last call."""
        with self._lock:
            if self._met is not None:
                met, self._met = self._met, None
                raise met
            if self._ours and is_wait(call):
                return in_pieces(call, self._timeout_s // 2, self._say)
            if call.name == "conf_tm":
                self._ours = False
            return self._say(call)

    def close(self) -> None:
        """End the feeder and close the backend inside."""
        self._over.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        self._inner.close()

    def beat(self) -> float:
        """What the feeder does: ask, where nothing was said for long. Seconds until it may be needed again."""
        interval_s = max(_SHORTEST_INTERVAL_S, self._interval_s / max(1.0, self._factor))
        left_s = self._said_s + interval_s - self._clock()
        if left_s > 0:
            return left_s
        if not self._lock.acquire(blocking=False):
            return interval_s
        try:
            if self._ours and self._factor and self._met is None:
                self._say(_GS)
        except ReplyTimeout as error:
            self._met = error if self._inner.closed else None
        except NomadError as error:
            self._met = error
        finally:
            self._lock.release()
        return interval_s

    def _feed(self) -> None:
        left_s = self._interval_s
        while not self._over.wait(left_s):
            left_s = self.beat()

    def _set(self, inner: Backend) -> bool:
        """Set the time-out; whether the other end has one."""
        try:
            reply = inner.execute(Call("conf_tm", (self._timeout_s,)))
        except RobotRefused:
            return False
        self._note(reply)
        if self._greeting is None:
            self._greeting = reply
        return True

    def _say(self, call: Call) -> Reply:
        reply = self._inner.execute(call)
        self._said_s = self._clock()
        self._note(reply)
        if reply.clock is not None:
            self._watch(reply.clock)
        return reply

    def _watch(self, robot_ms: int) -> None:
        """A clock that began anew is a robot that was switched off and on, and has forgotten its time-out."""
        if robot_ms < self._robot_ms and self._ours:
            try:
                self._inner.execute(Call("conf_tm", (self._timeout_s,)))
            except (ReplyTimeout, RobotRefused):
                return  # the next answer tells it again
        self._robot_ms = robot_ms

    def _note(self, reply: Reply) -> None:
        speed = reply.slots.get(_SPEED_SLOT)
        if speed is not None:
            self._factor = speed / _REAL_TIME
