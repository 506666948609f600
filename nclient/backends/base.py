"""The interface of backends, the base class of their wrappers, keep-alive, and statistics of a link.

A backend is one session with one robot: `execute(call)` returns the reply. What wraps a backend (retries, a speed
limit) is a `Backend` again. Backends are not thread-safe: `Robot` holds a lock.

Keep-alive renews the robot's motion timeout (conf_tm), so that the robot stops if its program dies, not if its program
sleeps.

    connected and in use       gs from a thread, so that the timeout does not expire
    closed                     the thread ends
    dropped without closing    the thread stops the robot, closes the connection and ends

    connecting -> conf_tm tm_s -> no request for tm_s / 3 -> gs, sent by a thread -> ...

Calls and the thread share a lock; a thread that finds it taken has nothing to do. An error in the thread (a lost link,
a bumper hit) is raised by the next call. A program that sends conf_tm itself takes over, and keep-alive ends. A ws,
during which no request is possible, is split into pieces shorter than the timeout. A robot that was restarted gets its
timeout again. The thread has only a weak reference, so that a robot that the program no longer references is dropped.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
import weakref
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Final, Protocol

from nclient.errors import NomadError, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import WireState

BUCKETS_S: Final[tuple[float, ...]] = tuple(0.0001 * (1 << k) for k in range(20))
"""Upper edges of the latency buckets, 0.1 ms x 2^k up to 52 s; a last bucket has everything above."""


@dataclass(slots=True)
class LinkStatistics:
    """Counts and latencies of a link since connecting, across reconnects. An exchange is one request sent."""

    exchanges: int = 0
    answers: int = 0
    """Exchanges that ended with an accepted reply, NAKs included."""
    frames: int = 0
    """Frames received with a valid checksum."""
    skipped_bytes: int = 0
    """Bytes received that belong to no valid frame."""
    checksum_errors: int = 0
    """Complete frames with a wrong checksum."""
    misfits: int = 0
    """Valid frames whose data do not fit any reply of this model and mask."""
    implausible: int = 0
    """Replies rejected by validation."""
    strays: int = 0
    """Frames that answer no outstanding request: mostly late replies."""
    naks: int = 0
    timeouts: int = 0
    """Exchanges without an accepted reply in time."""
    retries: int = 0
    losses: int = 0
    """Connections lost."""
    reconnects: int = 0
    latencies: list[int] = field(default_factory=lambda: [0] * (len(BUCKETS_S) + 1))
    """Histogram over `BUCKETS_S`."""
    longest_s: float = 0.0
    """Maximum latency."""

    def record_latency(self, seconds: float) -> None:
        """Count a reply and the time it took."""
        self.answers += 1
        self.latencies[bisect_left(BUCKETS_S, seconds)] += 1
        self.longest_s = max(self.longest_s, seconds)

    def latency_s(self, fraction: float) -> float:
        """Return a quantile of the latencies in seconds.

        Parameters
        ----------
        fraction
            Fraction of replies that took no longer, 0 to 1.

        Returns
        -------
        float
            The upper edge of a bucket, at most the maximum latency; 0 before any reply.
        """
        # Sum up buckets until the fraction is reached; the last bucket has no upper edge.
        needed, count = fraction * sum(self.latencies), 0
        for edge, in_bucket in zip(BUCKETS_S, self.latencies, strict=False):
            count += in_bucket
            if count >= needed:
                return min(edge, self.longest_s)
        return self.longest_s

    def counts(self) -> dict[str, int]:
        """Return the counts by name."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name not in _TIMES}

    def __str__(self) -> str:
        """Return three lines: exchanges, faults, latencies."""
        faults = [f"{count} {name.replace('_', ' ')}" for name, count in self.counts().items()
                  if count and name not in _NO_FAULTS]
        times = ", ".join(f"{part:.0%} within {1000 * self.latency_s(part):.3g} ms" for part in (0.5, 0.99))
        return "\n".join([f"{self.exchanges} exchanges, {self.answers} answers", ", ".join(faults) or "no faults seen",
                          f"{times}, the longest {1000 * self.longest_s:.3g} ms" if self.answers else "no times yet"])


_TIMES: Final = frozenset({"latencies", "longest_s"})
_NO_FAULTS: Final = frozenset({"exchanges", "answers", "frames"})


class Backend(Protocol):
    """A session with one robot."""

    @property
    def wire_state(self) -> WireState:
        """Return model, sensor mask and laser mode, which determine the format of replies."""

    @property
    def greeting(self) -> Reply | None:
        """Return the state received while connecting, None if there was none."""

    @property
    def port(self) -> int:
        """Return the port on which the server accepts connections, as it replied to connect_robot; 1 without server."""

    @property
    def closed(self) -> bool:
        """Return True if the session is over; every call then raises ConnectionLost."""

    @property
    def link(self) -> LinkStatistics | None:
        """Return the statistics of the link, None if nothing is counted."""

    def execute(self, call: Call) -> Reply:
        """Send a command and return its reply, an empty one if the command has none.

        Raises
        ------
        RobotRefused
            If the command was refused; the session continues.
        WireError
            If the call cannot be encoded; nothing was sent.
        ConnectionLost
            If the link is lost; the session is closed.
        ReplyTimeout
            If no reply came in time. The session is closed over TCP and continues on a serial line; see `closed`.
        """

    def close(self) -> None:
        """Disconnect without waiting for a reply. May be called twice, and from another thread than `execute`."""


class Wrapper:
    """A backend around another one that changes nothing; subclasses override what they change."""

    def __init__(self, inner: Backend) -> None:
        self._inner = inner
        self.greeting = inner.greeting
        """The state received while connecting, None if there was none."""
        self.port = inner.port
        """The server's port, 1 without server."""
        self.link = inner.link
        """Statistics of the link, None if nothing is counted."""

    @property
    def wire_state(self) -> WireState:
        """Return model, sensor mask and laser mode."""
        return self._inner.wire_state

    @property
    def closed(self) -> bool:
        """Return True if the session is over."""
        return self._inner.closed

    def execute(self, call: Call) -> Reply:
        """Send a command and return its reply. Raises as the inner backend."""
        return self._inner.execute(call)

    def close(self) -> None:
        """Close the inner backend."""
        self._inner.close()


def is_wait(call: Call) -> bool:
    """Return True for a complete ws: three axis flags and a timeout in seconds."""
    return call.name == "ws" and len(call.args) == 4


def split_wait(call: Call, max_piece_s: int, execute: Callable[[Call], Reply]) -> Reply:
    """Execute a ws as several shorter ones, between which other requests are possible.

    Parameters
    ----------
    call
        A ws with whole seconds.
    max_piece_s
        Maximum duration of a piece in seconds.
    execute
        Sends one piece and returns its reply.

    Returns
    -------
    Reply
        The reply of the last piece: the selected axes are still, or the whole time is over.
    """
    *flags, left = call.args
    while True:
        # A piece of 0 s is a query; the timeout may be negative.
        piece = max(0, min(left, max_piece_s))
        left -= piece
        reply = execute(Call("ws", (*flags, piece)))
        # Bit k of the motor status is axis k.
        motors = reply.slots.get(MOTOR_SLOT, 0)
        is_moving = any(flag and motors >> axis & 1 for axis, flag in enumerate(flags))
        if left <= 0 or not is_moving:
            return reply


DEFAULT_TIMEOUT_S: Final = 5
MIN_TIMEOUT_S: Final = 2
"""The robot counts whole seconds: one is too short to split a ws."""
_INTERVALS_PER_TIMEOUT: Final = 3
"""A request that is lost, and one after it, still leave time for a third."""
SPEED_SLOT: Final = 0
REAL_TIME: Final = 10
"""State[0] of a server whose time runs as fast as real time."""
_MIN_INTERVAL_S: Final = 0.005


class KeepAlive(Wrapper):
    """Set the motion timeout at once, and keep it from expiring while the program is alive.

    Parameters
    ----------
    inner
        The backend to wrap.
    timeout_s
        Motion timeout in whole seconds, 2 to 255.
    feeds
        False to set the timeout only.
    at_least_every_s
        Maximum interval between two requests, for wrappers that need fresh replies.
    clock
        Seconds.
    """

    def __init__(self, inner: Backend, timeout_s: int = DEFAULT_TIMEOUT_S, *, feeds: bool = True,
                 at_least_every_s: float = float("inf"), clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(inner)
        self._timeout_s = timeout_s
        self._interval_s = min(timeout_s / _INTERVALS_PER_TIMEOUT, at_least_every_s)
        self._clock = clock
        self._lock = threading.Lock()
        self._ends: queue.SimpleQueue[bool] = queue.SimpleQueue()
        """The end, for the thread: True if the program dropped the robot without closing it. Finalizers may put into a
        SimpleQueue wherever they are executed."""
        self._pending_error: NomadError | None = None
        self._speed = 1.0
        """Robot time per real time; 0 if its time stands still between exchanges."""
        self._robot_ms = 0
        self._last_request_s = clock()
        self._active = self._set_timeout(inner)
        """False if the other end has no motion timeout, or the program controls it."""
        self._thread = threading.Thread(target=_poll_until_end,
                                        args=(weakref.ref(self), inner, self._ends, self._interval_s),
                                        name="nomad-keep-alive", daemon=True)
        if feeds and self._active:
            self._thread.start()
            # At the end of the program, which ends the thread, the timeout stops the robot.
            weakref.finalize(self, self._ends.put, True).atexit = False

    def execute(self, call: Call) -> Reply:
        """Send a command and return its reply. Raises as the inner backend, or an error of the thread first."""
        with self._lock:
            if self._pending_error is not None:
                error, self._pending_error = self._pending_error, None
                raise error
            # During a ws no other request is possible: split it, with a margin of two.
            if call.name == "ws" and self._active and is_wait(call):
                return split_wait(call, self._timeout_s // 2, self._request)
            if call.name == "conf_tm":
                self._active = False
            return self._request(call)

    def close(self) -> None:
        """End the thread and close the inner backend."""
        # The thread may itself close the backend, and cannot join itself.
        self._ends.put(False)
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        self._inner.close()

    def poll(self) -> float:
        """Send gs if there was no request for an interval; return the seconds until the next poll. For the thread."""
        # 1. Time since the last request, in robot time.
        interval_s = max(_MIN_INTERVAL_S, self._interval_s / max(1.0, self._speed))
        left_s = self._last_request_s + interval_s - self._clock()
        if left_s > 0:
            return left_s
        # 2. A call in progress is a request, too.
        if not self._lock.acquire(blocking=False):
            return interval_s
        # 3. The next call raises what goes wrong here, except for a lost reply: the next poll repeats that.
        try:
            if self._active and self._speed and self._pending_error is None:
                self._request(Call("gs"))
        except ReplyTimeout as error:
            self._pending_error = error if self._inner.closed else None
        except NomadError as error:
            self._pending_error = error
        finally:
            self._lock.release()
        return interval_s

    def _set_timeout(self, inner: Backend) -> bool:
        """Send conf_tm; return False if the other end has no motion timeout."""
        try:
            reply = inner.execute(Call("conf_tm", (self._timeout_s,)))
        except RobotRefused:
            return False
        self._update_speed(reply)
        if self.greeting is None:
            self.greeting = reply
        return True

    def _request(self, call: Call) -> Reply:
        reply = self._inner.execute(call)
        self._last_request_s = self._clock()
        self._update_speed(reply)
        if reply.clock is not None:
            # The clock went back: the robot was restarted, and needs its timeout again.
            if reply.clock < self._robot_ms and self._active:
                try:
                    self._inner.execute(Call("conf_tm", (self._timeout_s,)))
                except (ReplyTimeout, RobotRefused):
                    return reply  # `_robot_ms` is unchanged, so that the next reply is a new attempt
            self._robot_ms = reply.clock
        return reply

    def _update_speed(self, reply: Reply) -> None:
        speed = reply.slots.get(SPEED_SLOT)
        if speed is not None:
            self._speed = speed / REAL_TIME


def _poll_until_end(reference: weakref.ref[KeepAlive], inner: Backend, ends: queue.SimpleQueue[bool],
                    interval_s: float) -> None:
    """Poll until the end, with a strong reference only during a poll; stop the robot if it was dropped."""
    while True:
        try:
            was_dropped = ends.get(timeout=interval_s)
            break
        except queue.Empty:
            keep_alive = reference()
            interval_s = keep_alive.poll() if keep_alive else interval_s
            del keep_alive
    if was_dropped:
        # The motion timeout stops a robot that cannot be reached.
        with contextlib.suppress(NomadError):
            inner.execute(Call("st"))
        inner.close()
