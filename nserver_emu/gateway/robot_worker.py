"""The conversation with one real robot: what is to be said waits in a row, and a thread of its own says it.

    submit(calls) ──> row ──> work() ──> backend.execute ──> ticket.outcome ──> news()
                                 └── silence ──> every ticket ERROR 6 ──> reconnect, with growing pauses ──> opening

Rules: only the thread that works waits for the robot. st goes before all others, voids the motions that have not begun,
and breaks off what keeps the line for long; one that does not get through is said as soon as the robot answers again.
Who asks for the state while such a question still waits shares its answer. `work` can be called without a thread; it
knows no clock, and says how long to pause.
"""

from __future__ import annotations

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
"""The code of the ERROR reply for a real robot that does not answer."""
FIRST_PAUSE_S: Final = 0.5
LONGEST_PAUSE_S: Final = 8.0
"""Pauses between attempts to reach a silent robot grow from the first to the longest, twice as long each time."""
LAST_WORDS_S: Final = 3.0
"""How long the end may take: longer than an answer does, and than the host's time-out of 1 s for one."""

STOP: Final = Call("st")
SLOW: Final = frozenset({"zr", "arm_zr", "arm_ws", "special_request"})
"""Commands that keep the line for many seconds."""

Opening = Callable[[Link, bool], Iterable[Call]]
"""What is to be said to a robot that has just been reached, again or for the first time: what all else relies on."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of calls: the replies, or the code of an ERROR."""

    replies: tuple[Reply, ...] = ()
    code: int | None = None


@dataclass(slots=True, eq=False)
class Ticket:
    """Calls that are to be made one after another. `moves`: whether a stop that comes first makes them void; `meant`:
    what a client said, where that was something else."""

    calls: tuple[Call, ...]
    moves: bool = False
    meant: Call | None = None
    outcome: Outcome | None = field(default=None)

    @property
    def stops(self) -> bool:
        """Whether it is a stop."""
        return self.calls[0] == STOP

    @property
    def simulated(self) -> tuple[Call, ...]:
        """What a simulation does that is to do the same."""
        return self.calls if self.meant is None else (self.meant,)


class RealRobot:
    """One robot behind an address. `opens` reaches it, at once and whenever it was lost.

    Raises what `opens` raises when it cannot be reached at the start, ReplyTimeout when it does not answer.
    """

    def __init__(self, opens: Callable[[], Backend], opening: Opening = lambda _link, _again: ()) -> None:
        self.opening = opening
        self.news: Callable[[], None] = lambda: None
        """Called after each outcome, by the thread that works."""
        self.finished: deque[Ticket] = deque()
        """Tickets that were carried out, in that order, for whoever follows the robot."""
        self.silent = False
        self.saying: str | None = None
        """The call that is being made."""
        self._row: deque[Ticket] = deque()
        self._refreshing: Ticket | None = None
        self._pause_s = 0.0
        self._lost = False
        self._owes_a_stop = False
        self._changed = threading.Condition()
        self._breaking_off = threading.Lock()
        self._ending = False
        self._thread: threading.Thread | None = None
        self._opens = opens
        self._backend = opens()
        try:
            self.link = Link(self._backend.terms.model, self._backend.terms.line)
            self._settle(again=False)
            self._backend.execute(REFRESH)
        except ReplyTimeout as error:
            self._backend.close()
            raise ReplyTimeout(f"the real robot does not answer: {error}; is it on, is its cable in?") from error
        except BaseException:
            self._backend.close()
            raise

    def start(self) -> None:
        """Work on a thread of its own until `close`."""
        self._thread = threading.Thread(target=self._run, name="real robot", daemon=True)
        self._thread.start()

    def submit(self, calls: tuple[Call, ...], *, moves: bool = False, meant: Call | None = None) -> Ticket:
        """Have calls made in turn; a stop at once. A robot that is silent has its outcome already."""
        ticket = Ticket(calls, moves, meant)
        with self._changed:
            hopeless = self.silent and (self._pause_s > 0.0 or not ticket.stops)
            if hopeless or self._ending:
                self._fail(ticket)
                return ticket
            if ticket.stops:
                self._void_motions()
                self._row.appendleft(ticket)
            else:
                self._row.append(ticket)
            self._changed.notify()
        if ticket.stops:
            self._break_off()
        return ticket

    def refresh(self) -> Ticket:
        """Have the state asked for, once for all who want it and have not begun to get it."""
        with self._changed:
            if self._refreshing is None:
                self._refreshing = self.submit((REFRESH,))
                if self._refreshing.outcome is not None:
                    ticket, self._refreshing = self._refreshing, None
                    return ticket
            return self._refreshing

    def work(self) -> float | None:
        """Do what is next; seconds to pause before there is more to do, None: until something is submitted."""
        if self.silent and not self._recover():
            return self._pause_s
        with self._changed:
            if not self._row:
                return None
            ticket = self._row.popleft()
            if ticket is self._refreshing:
                self._refreshing = None
        outcome = Outcome(code=NO_ANSWER)
        try:
            outcome = self._say(ticket.calls)
        finally:
            self.saying = None
            ticket.outcome = outcome
            self._owes_a_stop |= ticket.stops and outcome.code == NO_ANSWER
            if outcome.code is None:
                self.finished.append(ticket)
            self.news()
        return 0.0

    def close(self, *last_words: Call) -> None:
        """Say the last words, if the robot still listens, and leave. Nothing else is said any more. Twice is fine."""
        with self._changed:
            if self._ending:
                return
            self._fail_all()
            if not self.silent:
                self._row.extend(Ticket((call,)) for call in last_words)
            self._ending = True
            self._changed.notify()
        if last_words:
            self._break_off()
        if self._thread is None:
            while self._row and not self.silent:
                self.work()
        else:
            self._thread.join(LAST_WORDS_S)
        self._backend.close()
        if self._thread is not None:
            self._thread.join(LAST_WORDS_S)

    def _run(self) -> None:
        while not (self._ending and (self._pause_s > 0.0 or not self._row)):
            try:
                pause_s = self.work()
            except Exception:
                log.exception("the real robot's conversation broke off because of a fault of ours")
                self._fell_silent("a fault of ours")
                pause_s = FIRST_PAUSE_S
            with self._changed:
                if not self._ending and (self.silent or not self._row):
                    self._changed.wait(pause_s)

    def _say(self, calls: Iterable[Call]) -> Outcome:
        replies = []
        for call in calls:
            self.saying = call.name
            try:
                replies.append(self._backend.execute(call))
            except RobotRefused as error:
                return Outcome(code=NOT_AVAILABLE if error.code is None else error.code)
            except WireError as error:
                log.info("%s cannot be said to the real robot: %s", call.name, error)
                return Outcome(code=BAD_VALUES)
            except BumperHit as error:
                log.warning("the real robot was stopped: %s", error)
                return Outcome(code=REFUSED)
            except NomadError as error:
                self._fell_silent(str(error))
                return Outcome(code=NO_ANSWER)
        return Outcome(tuple(replies))

    def _fell_silent(self, why: str) -> None:
        log.warning("the real robot does not answer: %s", why)
        with self._changed:
            self.silent = True
            self._pause_s = 0.0
            self._fail_all(but_stops=True)

    def _recover(self) -> bool:
        """Try to reach it; first at once, for a line that lost one answer and is there. Else it may have been off."""
        try:
            if self._backend.closed:
                self._lost = True
                with self._breaking_off:  # a port must be let go before it can be opened again
                    self._backend = self._opens()
            if self._lost:
                self._settle(again=True)
            self._backend.execute(STOP if self._owes_a_stop else REFRESH)
        except NomadError as error:
            self._lost = True
            self._fail_all()
            self._pause_s = min(max(2 * self._pause_s, FIRST_PAUSE_S), LONGEST_PAUSE_S)
            log.info("the real robot is still silent, next attempt in %g s: %s", self._pause_s, error)
            return False
        self.silent = self._lost = self._owes_a_stop = False
        self._pause_s = 0.0
        log.warning("the real robot answers again")
        self.news()
        return True

    def _break_off(self) -> None:
        """What keeps the line for long is not waited for: the line is let go, and opened again."""
        slow = self.saying
        if slow in SLOW:
            log.warning("%s is broken off by a stop", slow)
            with self._breaking_off:
                self._backend.close()

    def _settle(self, *, again: bool) -> None:
        """What is to be said first; what it refuses it has not."""
        for call in self.opening(self.link, again):
            try:
                self._backend.execute(call)
            except RobotRefused as error:
                log.warning("the real robot: %s", error)

    def _void_motions(self) -> None:
        kept = [ticket for ticket in self._row if not ticket.moves]
        for ticket in self._row:
            if ticket.moves:
                ticket.outcome = Outcome(code=REFUSED)
        self._row = deque(kept)

    def _fail_all(self, *, but_stops: bool = False) -> None:
        with self._changed:
            kept = [ticket for ticket in self._row if but_stops and ticket.stops]
            for ticket in self._row:
                if ticket not in kept:
                    self._fail(ticket)
            self._row = deque(kept)
            self._refreshing = None

    def _fail(self, ticket: Ticket) -> None:
        ticket.outcome = Outcome(code=NO_ANSWER)
        self._owes_a_stop |= ticket.stops
