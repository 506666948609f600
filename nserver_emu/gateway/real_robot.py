"""The real robot behind the gateway: its calls and replies in the terms of Nserver, and the queue of its requests.

Translation between Nserver's calls and a real robot's: calls to the robot, and replies from its answers.

    call ──> plan: calls for the robot, one after another ──> the last one's answer ──> reply for the connection

    place_robot         dp and da: the robot cannot be moved by hand, only its encoders can be set
    ct                  each connection agrees on its mask with this server; the robot sends all slots
    get_cp              the whole state where the model's line has no such query
    conf_cp             followed by the state, which is an Nserver's reply
    get_robot_conf      the pose of the robot's encoders
    everything else     unchanged

A command without a row here is answered by the simulation. What the robot lacks is ERROR 4, position stamps on a line
without stamps included. Numbers beyond the range of the robot's line are clamped to it.

Request queue of one real robot: jobs wait in a queue, and one worker thread carries them out.

    submit(calls) ──> queue ──> run_next() ──> backend.execute ──> job.result ──> on_result()
                                     └── no reply ──> pending jobs fail with ERROR 6 ──> reconnect with growing pauses

Only the worker thread waits for the robot. A stop (st) goes to the head of the queue, cancels the motions that have not
begun, and interrupts commands that occupy the line for long. A stop that fails is repeated as soon as the robot answers
again. Requests for the state that wait at the same time share one reply.
`run_next` can be called without a thread; it reads no clock, and returns the pause that it wants.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from nclient.backends.base import Backend
from nclient.errors import BumperHit, NomadError, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.client_state import ERROR_SLOT, STATE_SIZE
from nclient.protocol.codec import clamp_to_serial
from nclient.protocol.commands import BY_NAME, Call, exists_on_serial
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, LASER_SLOT, LINES, PIXELS, POINTS, Model, tenths
from nserver_emu.server.server_state import INFRARED, POSE_SLOTS, SPEED_SLOT, apply_mask
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, REFUSED, ConnectionContext, done, error_reply
from nserver_emu.simulation.axis import Command
from nserver_emu.simulation.sensors import COLUMNS, PIXEL_IN, LineFit, lines, points
from worlds.geometry import FloatArray
from worlds.robots import BODIES, Body

NO_READINGS: Final = (0,)
"""A laser vector without readings."""
REAL_TIME: Final = 10
"""State[0] of a robot whose time runs at normal speed, in tenths."""
REFRESH: Final = Call("gs")
MAX_TIMEOUT_S: Final = 255
"""The watchdog time-out has one byte on the robot's line."""
_AXES: Final = 7
"""Bits of State[41] that show moving axes; the bits above are a Scout's battery."""


@dataclass(frozen=True, slots=True)
class Link:
    """Link to a real robot: its model, and whether it is the robot's own line or another Nserver."""

    model: Model
    own_line: bool

    @property
    def masks(self) -> bool:
        """True if the slots and stamps of its state packets can be selected."""
        return self.model.sends_mask or not self.own_line

    def clean(self, slots: Mapping[int, int]) -> dict[int, int]:
        """Return State slots without the bumper bits that a robot at rest sets on its own line."""
        clean = dict(slots)
        if BUMPER_SLOT in clean:
            clean[BUMPER_SLOT] &= ~self.model.bumper_rest
        return clean


ReplyBuilder = Callable[[ConnectionContext, Reply, Link], Reply]
"""Makes a connection's reply from the robot's answer."""


class TranslatedCall(NamedTuple):
    """The calls to make, and the function that turns the last answer into the connection's reply."""

    calls: tuple[Call, ...]
    build_reply: ReplyBuilder


def stays_here(name: str) -> bool:
    """Return True if the simulation answers this command whichever robot is driven: world, window and server."""
    return name not in _REPLIES and name not in LACKING


def plan(call: Call, context: ConnectionContext, link: Link) -> TranslatedCall | int:
    """Translate a connection's call.

    Returns
    -------
    TranslatedCall or int
        The code of an ERROR reply where the robot has no such command or the values are wrong.
    """
    if call.name not in _REPLIES:
        return NOT_AVAILABLE
    if call.name == "mv" and any(mode not in tuple(Command) for mode in call.args[::2]):
        return BAD_VALUES
    if call.name == "ct" and context.wire_state.mask.position and not link.masks:
        return NOT_AVAILABLE
    calls, build_reply = _translated(call, context, link)
    if link.own_line and not all(exists_on_serial(BY_NAME[sent.name], link.model) for sent in calls):
        return NOT_AVAILABLE
    return TranslatedCall(tuple(map(clamp_to_serial, calls)) if link.own_line else calls, build_reply)


# --- Replies ---------------------------------------------------------------------------------------------------------


def whole_state(reply: Reply, link: Link) -> list[int]:
    """Return State[0..44] of a state reply in wire units, as an Nserver sends it.

    Slot 0 is real time, 1-16 are 15 where the robot has no infrareds, 33 has no bits of bumpers at rest, 42 and 44
    are 0 until a connection's own values are filled in.
    """
    slots = dict.fromkeys(range(STATE_SIZE), 0) | dict.fromkeys(INFRARED.slots, INFRARED.absent)
    slots[SPEED_SLOT] = REAL_TIME
    slots |= link.clean(reply.slots)
    slots[LASER_SLOT] = slots[ERROR_SLOT] = 0
    return list(slots.values())


def state_for(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Return the state reply for this connection, by its mask and laser mode.

    A slot that the connection's mask leaves out repeats the value last sent there.
    """
    slots, laser = whole_state(reply, link), None
    if link.model.has_laser:
        slots[LASER_SLOT] = context.wire_state.laser_mode
        wire_state = context.wire_state
        laser = shaped(reply.laser, wire_state.laser_width, link) if wire_state.mask.has(LASER_SLOT) else None
    return reply._replace(slots=dict(enumerate(apply_mask(context, slots))), laser=laser)


def moving_axes(reply: Reply) -> int:
    """Return the moving axes of a state reply: bits 0 translation, 1 steering, 2 turret."""
    return reply.slots.get(MOTOR_SLOT, 0) & _AXES


def shaped(laser: tuple[int, ...] | None, width: int, link: Link) -> tuple[int, ...] | None:
    """Return a laser vector with `width` words per reading; None where there is none."""
    return None if laser is None else convert_laser(laser, width, BODIES[link.model.name], LineFit())


def convert_laser(vector: tuple[int, ...], width: int, body: Body, fit: LineFit) -> tuple[int, ...]:
    """Convert a laser vector to another number of words per reading.

    Words per reading: 4 lines (x1 y1 x2 y2), 2 points (x y), 1 the camera's row of each column. Rows become points
    and points become lines; the other directions are not possible and give no readings.

    Parameters
    ----------
    vector : the count n, then the numbers of n readings, in tenths of an inch or rows.
    width : words per reading of the result.
    body, fit : geometry of the laser, and settings of the line fit.
    """
    count = vector[0]
    source_width = (len(vector) - 1) // count if count else width
    if source_width == width:
        return vector
    if source_width == LINES or width == PIXELS:
        return NO_READINGS
    # 1. To points (k, 2) in inches, robot frame.
    if source_width == PIXELS:
        converted = _points_of_rows(vector[1:], body)
    else:
        converted = np.reshape(vector[1:], (-1, POINTS)) / 10.0
    # 2. To lines (k, 4).
    if width == LINES:
        converted = lines(converted, fit)
    return (len(converted), *[tenths(number) for number in converted.ravel().tolist()])


def _points_of_rows(rows: tuple[int, ...], body: Body) -> FloatArray:
    """Return points (k, 2) in inches in the robot's frame, of the columns with a reading: range is PIXEL_IN / row."""
    columns = np.linspace(0, COLUMNS - 1, len(rows)).round().astype(int)  # readings are spread evenly over the angle
    ranges = np.full(COLUMNS, np.inf)
    has_reading = np.array(rows) > 0
    ranges[columns[has_reading]] = PIXEL_IN / np.array(rows)[has_reading]
    return points(ranges, body)


def _unchanged(_context: ConnectionContext, reply: Reply, _link: Link) -> Reply:
    return reply


def _done(_context: ConnectionContext, _reply: Reply, _link: Link) -> Reply:
    return done()


def _numbers(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Reply to a query that sets slots of State; later state replies repeat them."""
    clean = reply._replace(slots=link.clean(reply.slots))
    context.update_last_sent(clean.slots)
    return clean


def _accelerations(_context: ConnectionContext, reply: Reply, _link: Link) -> Reply:
    """Reply to get_ra, which arrives in the slots of the velocities; without any the robot has no such query."""
    return reply if reply.slots else error_reply(NOT_AVAILABLE)


def _compass(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Reply to get_cp made from a whole state."""
    compass = {COMPASS_SLOT: reply.slots[COMPASS_SLOT]}
    return _numbers(context, Reply("compass", compass, clock=reply.clock), link)


def _laser(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Reply to get_ls."""
    return reply._replace(laser=shaped(reply.laser, context.wire_state.get_laser_width, link))


def _segments(_context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Reply to get_sg."""
    return reply._replace(laser=shaped(reply.laser, LINES, link))


def _pose(_context: ConnectionContext, reply: Reply, _link: Link) -> Reply:
    return Reply("configuration", values=tuple(reply.slots[slot] for slot in POSE_SLOTS))


# --- Calls -----------------------------------------------------------------------------------------------------------

_REPLIES: Final[dict[str, ReplyBuilder]] = {
    **dict.fromkeys(("gs", "ct", "ws", "vm", "sp", "ac", "pr", "pa", "mv", "st", "lp", "zr", "dp", "da"), state_for),
    **dict.fromkeys(("conf_ir", "conf_sn", "conf_ls", "conf_sg", "conf_ser", "conf_cp", "conf_tm"), state_for),
    **dict.fromkeys(("get_ir", "get_sn", "get_rc", "get_rv", "get_bp", "get_cp"), _numbers),
    **dict.fromkeys(("special_request", "arm_zr", "arm_ws", "arm_mv"), _unchanged),
    "get_ra": _accelerations, "get_ls": _laser, "get_sg": _segments, "get_robot_conf": _pose,
    "tk": _done, "place_robot": _done,
}  # fmt: skip
"""All commands that are sent to the robot, and the functions that usually make their replies."""


def _translated(call: Call, context: ConnectionContext, link: Link) -> TranslatedCall:
    on_its_line = context.wire_state.line
    build_reply = _REPLIES[call.name]
    match call.name:
        case "gs" | "ct" | "ws":
            return TranslatedCall((REFRESH,), build_reply)
        case "get_cp" if not link.masks:
            return TranslatedCall((REFRESH,), _compass)
        case "conf_cp":
            return TranslatedCall((call,), _unchanged) if on_its_line else TranslatedCall((call, REFRESH), build_reply)
        case "tk" if on_its_line:
            return TranslatedCall((call, REFRESH), state_for)
        case "conf_tm":
            return TranslatedCall((Call("conf_tm", (min(max(call.args[0], 0), MAX_TIMEOUT_S),)),), build_reply)
        case "place_robot":
            x, y, steering, turret = call.args
            return TranslatedCall((Call("dp", (x, y)), Call("da", (steering, turret))), build_reply)
        case "get_robot_conf":
            return TranslatedCall((Call("get_rc"),), build_reply)
    return TranslatedCall((call,), build_reply)


LACKING: Final = frozenset({"sim_truth", "sim_control"})
"""Commands that no real robot can answer: its true pose, and control of time."""


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
    result: JobResult | None = None

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

    def __init__(self, open_backend: Callable[[], Backend],
                 opening_calls: OpeningCalls = lambda _link, _reconnected: ()) -> None:
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
            # Requests that wait at the same time share one exchange with the robot.
            job = self._pending_refresh or self.submit((REFRESH,))
            self._pending_refresh = job if job.result is None else None
            return job

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
        for job in self._queue:
            if job.moves:
                job.result = JobResult(code=REFUSED)
        self._queue = deque(job for job in self._queue if job.result is None)

    def _fail_pending(self, *, but_stops: bool = False) -> None:
        with self._changed:
            for job in self._queue:
                if not (but_stops and job.is_stop):
                    self._fail(job)
            self._queue = deque(job for job in self._queue if job.result is None)
            self._pending_refresh = None

    def _fail(self, job: Job) -> None:
        job.result = JobResult(code=NO_ANSWER)
        self._owes_stop |= job.is_stop
