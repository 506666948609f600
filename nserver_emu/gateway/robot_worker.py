"""Request queue of one real robot: jobs wait in a queue, and one worker thread carries them out.

    submit(calls) ──> queue ──> run_next() ──> backend.execute ──> job.result ──> on_result()
                                     └── no reply ──> pending jobs fail with ERROR 6 ──> reconnect with growing pauses

Only the worker thread waits for the robot. A stop (st) goes to the head of the queue, cancels the motions that have not
begun, and interrupts commands that occupy the line for long. A stop that fails is repeated as soon as the robot answers
again. Requests for the state that wait at the same time share one reply.
`run_next` can be called without a thread; it reads no clock, and returns the pause that it wants.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

from nclient.backends.base import Backend
from nclient.errors import BumperHit, NomadError, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.gateway.translate import REFRESH, Link
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, REFUSED

log = logging.getLogger(__name__)

NO_ANSWER: Final = 6
"""Code of the ERROR reply for a real robot that does not answer."""
MIN_RETRY_PAUSE_S: Final = 0.5
MAX_RETRY_PAUSE_S: Final = 8.0
"""Pause between attempts to reach a silent robot: doubled each time, from the minimum to the maximum."""
SHUTDOWN_TIMEOUT_S: Final = 3.0
"""Longest wait for the worker thread at the end; a reply takes at most 1 s, the host's reply time-out."""

STOP: Final = Call("st")
SLOW: Final = frozenset({"zr", "arm_zr", "arm_ws", "special_request"})
"""Commands that occupy the line for many seconds."""

OpeningCalls = Callable[[Link, bool], Iterable[Call]]
"""Maps (link, reconnected) to the calls that a robot needs first: those that all later ones rely on."""


@dataclass(frozen=True, slots=True)
class JobResult:
    """Result of a job: the replies, or the code of an ERROR reply."""

    replies: tuple[Reply, ...] = ()
    code: int | None = None


@dataclass(slots=True, eq=False)
class Job:
    """Calls to be made one after another.

    Attributes
    ----------
    calls : the calls for the robot.
    moves : True if a stop that arrives first cancels the job.
    request : the client's own call, where `calls` is a translation of it.
    result : None until the job is done.
    """

    calls: tuple[Call, ...]
    moves: bool = False
    request: Call | None = None
    result: JobResult | None = field(default=None)

    @property
    def is_stop(self) -> bool:
        """True for a stop (st)."""
        return self.calls[0] == STOP

    @property
    def simulated_calls(self) -> tuple[Call, ...]:
        """The calls with which a simulation does the same."""
        return self.calls if self.request is None else (self.request,)


class RobotWorker:
    """Request queue and worker thread of one real robot.

    Parameters
    ----------
    open_backend : opens a connection to the robot; called now, and again whenever the robot was lost.
    opening_calls : the first calls after each (re)connection.

    Raises
    ------
    ReplyTimeout
        If the robot does not answer. Other errors are those of `open_backend`.
    """

    def __init__(
        self, open_backend: Callable[[], Backend], opening_calls: OpeningCalls = lambda _link, _reconnected: ()
    ) -> None:
        self.opening_calls = opening_calls
        self.on_result: Callable[[], None] = lambda: None
        """Called by the worker thread after each result."""
        self.finished: deque[Job] = deque()
        """Successful jobs in the order in which they ran, for the shadow simulation to consume."""
        self.is_silent = False
        self.current_command: str | None = None
        """Name of the command that is being executed."""
        self._queue: deque[Job] = deque()
        self._pending_refresh: Job | None = None
        self._pause_s = 0.0
        self._is_lost = False
        self._owes_stop = False
        self._changed = threading.Condition()
        self._backend_lock = threading.Lock()
        self._is_closing = False
        self._thread: threading.Thread | None = None
        self._open_backend = open_backend
        self._backend = open_backend()
        try:
            # Three steps before the daemon serves: the model, the opening calls, and a first state.
            self.link = Link(self._backend.wire_state.model, self._backend.wire_state.line)
            self._send_opening_calls(reconnected=False)
            self._backend.execute(REFRESH)
        except ReplyTimeout as error:
            self._backend.close()
            raise ReplyTimeout(f"the real robot does not answer: {error}; is it on, is its cable in?") from error
        except BaseException:
            self._backend.close()
            raise

    def start(self) -> None:
        """Start the worker thread; it runs until `close`."""
        self._thread = threading.Thread(target=self._run, name="real robot", daemon=True)
        self._thread.start()

    def submit(self, calls: tuple[Call, ...], *, moves: bool = False, request: Call | None = None) -> Job:
        """Queue calls; a stop goes first.

        Returns
        -------
        Job
            With a result already where the robot is silent.
        """
        job = Job(calls, moves, request)
        with self._changed:
            # While a lost robot is retried only a first stop is worth queueing: it may still get through.
            cannot_succeed = self.is_silent and (self._pause_s > 0.0 or not job.is_stop)
            if cannot_succeed or self._is_closing:
                self._fail(job)
                return job
            if job.is_stop:
                self._cancel_motions()
                self._queue.appendleft(job)
            else:
                self._queue.append(job)
            self._changed.notify()
        if job.is_stop:
            self._interrupt_slow_command()
        return job

    def refresh(self) -> Job:
        """Queue a request for the state, or return the one that is still waiting."""
        with self._changed:
            if self._pending_refresh is None:
                # Requests that wait at the same time share one exchange with the robot.
                self._pending_refresh = self.submit((REFRESH,))
                if self._pending_refresh.result is not None:
                    job, self._pending_refresh = self._pending_refresh, None
                    return job
            return self._pending_refresh

    def run_next(self) -> float | None:
        """Carry out the next job.

        Returns
        -------
        float or None
            Seconds to pause before the next call; None: nothing to do until something is submitted.
        """
        # 1. A silent robot is tried again before anything else.
        if self.is_silent and not self._try_reconnect():
            return self._pause_s
        with self._changed:
            if not self._queue:
                return None
            # 2. The next job; from now on a new request for the state is a job of its own.
            job = self._queue.popleft()
            if job is self._pending_refresh:
                self._pending_refresh = None
        # 3. Execute it. An exception leaves the result NO_ANSWER, so that no client waits forever.
        result = JobResult(code=NO_ANSWER)
        try:
            result = self._execute(job.calls)
        finally:
            self.current_command = None
            job.result = result
            # A stop that did not arrive is repeated first when the robot answers again.
            self._owes_stop |= job.is_stop and result.code == NO_ANSWER
            if result.code is None:
                self.finished.append(job)
            self.on_result()
        return 0.0

    def close(self, *shutdown_calls: Call) -> None:
        """Send the last calls if the robot still answers, and close the connection. May be called twice."""
        with self._changed:
            if self._is_closing:
                return
            self._fail_pending()
            if not self.is_silent:
                self._queue.extend(Job((call,)) for call in shutdown_calls)
            self._is_closing = True
            self._changed.notify()
        if shutdown_calls:
            self._interrupt_slow_command()
        # Without a thread, as in tests, the last calls are executed here.
        if self._thread is None:
            while self._queue and not self.is_silent:
                self.run_next()
        else:
            self._thread.join(SHUTDOWN_TIMEOUT_S)
        self._backend.close()
        if self._thread is not None:
            self._thread.join(SHUTDOWN_TIMEOUT_S)

    def _run(self) -> None:
        while not (self._is_closing and (self._pause_s > 0.0 or not self._queue)):
            try:
                pause_s = self.run_next()
            except Exception:
                log.exception("internal error in the real robot's worker thread")
                self._mark_silent("internal error")
                pause_s = MIN_RETRY_PAUSE_S
            with self._changed:
                if not self._is_closing and (self.is_silent or not self._queue):
                    self._changed.wait(pause_s)

    def _execute(self, calls: Iterable[Call]) -> JobResult:
        replies = []
        for call in calls:
            self.current_command = call.name
            try:
                replies.append(self._backend.execute(call))
            except RobotRefused as error:
                return JobResult(code=NOT_AVAILABLE if error.code is None else error.code)
            except WireError as error:
                log.info("%s cannot be sent to the real robot: %s", call.name, error)
                return JobResult(code=BAD_VALUES)
            except BumperHit as error:
                log.warning("the real robot was stopped: %s", error)
                return JobResult(code=REFUSED)
            except NomadError as error:
                self._mark_silent(str(error))
                return JobResult(code=NO_ANSWER)
        return JobResult(tuple(replies))

    def _mark_silent(self, reason: str) -> None:
        log.warning("the real robot does not answer: %s", reason)
        with self._changed:
            self.is_silent = True
            self._pause_s = 0.0
            self._fail_pending(but_stops=True)

    def _try_reconnect(self) -> bool:
        """Try to reach the robot; True if it answers.

        The first attempt uses the open line, which may have lost a single reply. After that the robot may have been
        switched off, and it gets the opening calls again.
        """
        try:
            # 1. A closed line is opened again.
            if self._backend.closed:
                self._is_lost = True
                with self._backend_lock:  # a port must be closed before it can be opened again
                    self._backend = self._open_backend()
            # 2. After more than one lost reply the robot may have been switched off: opening calls again.
            if self._is_lost:
                self._send_opening_calls(reconnected=True)
            # 3. The first exchange: an owed stop, or a query.
            self._backend.execute(STOP if self._owes_stop else REFRESH)
        except NomadError as error:
            self._is_lost = True
            self._fail_pending()
            self._pause_s = min(max(2 * self._pause_s, MIN_RETRY_PAUSE_S), MAX_RETRY_PAUSE_S)
            log.info("the real robot is still silent, next attempt in %g s: %s", self._pause_s, error)
            return False
        self.is_silent = self._is_lost = self._owes_stop = False
        self._pause_s = 0.0
        log.warning("the real robot answers again")
        self.on_result()
        return True

    def _interrupt_slow_command(self) -> None:
        """Close the line under a command that occupies it for long; the next job opens it again."""
        # Closing the line is the only means to end a wait for its reply.
        command = self.current_command
        if command in SLOW:
            log.warning("%s is interrupted by a stop", command)
            with self._backend_lock:
                self._backend.close()

    def _send_opening_calls(self, *, reconnected: bool) -> None:
        """Send the opening calls; a call that the robot refuses is logged and skipped."""
        for call in self.opening_calls(self.link, reconnected):
            try:
                self._backend.execute(call)
            except RobotRefused as error:
                log.warning("the real robot: %s", error)

    def _cancel_motions(self) -> None:
        # A motion that was queued before a stop must not begin after it.
        remaining = [job for job in self._queue if not job.moves]
        for job in self._queue:
            if job.moves:
                job.result = JobResult(code=REFUSED)
        self._queue = deque(remaining)

    def _fail_pending(self, *, but_stops: bool = False) -> None:
        with self._changed:
            remaining = [job for job in self._queue if but_stops and job.is_stop]
            for job in self._queue:
                if job not in remaining:
                    self._fail(job)
            self._queue = deque(remaining)
            self._pending_refresh = None

    def _fail(self, job: Job) -> None:
        job.result = JobResult(code=NO_ANSWER)
        self._owes_stop |= job.is_stop
