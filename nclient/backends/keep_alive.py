"""Keep-alive of the robot's motion timeout (conf_tm): the robot stops if its program dies, not if its program sleeps.

    connected and in use       gs from a thread, so that the timeout does not expire
    closed                     the thread ends
    dropped without closing    the thread stops the robot, closes the connection and ends

    connecting -> conf_tm tm_s -> no request for tm_s / 3 -> gs, sent by a thread -> ...

Calls and the thread share a lock; a thread that finds it taken has nothing to do. An error in the thread (a lost link,
a bumper hit) is raised by the next call. A program that sends conf_tm itself takes over, and keep-alive ends. A ws,
during which no request is possible, is split into pieces shorter than the timeout. A robot that was restarted gets its
timeout again. The thread has only a weak reference, so that a robot that the program no longer references is dropped.
"""

import contextlib
import queue
import threading
import time
import weakref
from collections.abc import Callable
from typing import Final, Literal

from nclient.backends.base import Backend, Wrapper, is_wait, split_wait
from nclient.errors import NomadError, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply

DEFAULT_TIMEOUT_S: Final = 5
MIN_TIMEOUT_S: Final = 2
"""The robot counts whole seconds: one is too short to split a ws."""
_INTERVALS_PER_TIMEOUT: Final = 3
"""A request that is lost, and one after it, still leave time for a third."""
_SPEED_SLOT, _REAL_TIME = 0, 10
_MIN_INTERVAL_S: Final = 0.005
_GS, _ST = Call("gs"), Call("st")
_Event = Literal["closed", "dropped"]
_CLOSED: Final = "closed"
_DROPPED: Final = "dropped"


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
        self._interval_s = min(timeout_s / _INTERVALS_PER_TIMEOUT, at_least_every_s)
        self._clock = clock
        self._lock = threading.Lock()
        self._events: queue.SimpleQueue[_Event] = queue.SimpleQueue()
        """The end, for the thread. Finalizers may put into a SimpleQueue wherever they are executed."""
        self._pending_error: NomadError | None = None
        self._speed = 1.0
        """Robot time per real time; 0 if its time stands still between exchanges."""
        self._robot_ms = 0
        self._greeting = inner.greeting
        self._last_request_s = clock()
        self._active = self._set_timeout(inner)
        """False if the other end has no motion timeout, or the program controls it."""
        self._thread = threading.Thread(
            target=_poll_until_end,
            args=(weakref.ref(self), inner, self._events, self._interval_s),
            name="nomad-keep-alive",
            daemon=True,
        )
        if feeds and self._active:
            self._thread.start()
            # At the end of the program, which ends the thread, the timeout stops the robot.
            weakref.finalize(self, self._events.put, _DROPPED).atexit = False

    @property
    def greeting(self) -> Reply | None:
        """Return the state received while connecting, or else with the timeout."""
        return self._greeting

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
        self._events.put(_CLOSED)
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
                self._request(_GS)
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
        if self._greeting is None:
            self._greeting = reply
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
        speed = reply.slots.get(_SPEED_SLOT)
        if speed is not None:
            self._speed = speed / _REAL_TIME


def _poll_until_end(
    reference: weakref.ref[KeepAlive], inner: Backend, events: queue.SimpleQueue[_Event], interval_s: float
) -> None:
    """Poll until the end, with a strong reference only during a poll; stop the robot if it was dropped."""
    while True:
        try:
            event = events.get(timeout=interval_s)
            break
        except queue.Empty:
            keep_alive = reference()
            interval_s = keep_alive.poll() if keep_alive else interval_s
            del keep_alive
    if event == _DROPPED:
        # The motion timeout stops a robot that cannot be reached.
        with contextlib.suppress(NomadError):
            inner.execute(_ST)
        inner.close()
