"""One robot's real side: who may move it, what goes to it, what comes back to each connection.

    answer(call, visit) ──> plan ──> owner? ──> ticket ──> later: the reply, or ERROR 4, 5, 6
    ws                      the state asked for again and again, so that nobody is kept from stopping the robot
    conf_tm                 a client's own: the owner must speak in that time, for watchers do not feed a robot;
                            where none has said one TIMEOUT_S, fed from here while somebody owns the robot

Rules: no thread, no socket; time is an argument. Nothing here waits: an answer is there, or a Later looks for it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Final

from nclient.backends.backend import Backend
from nclient.protocol.commands import Call
from nclient.protocol.mask import EVERYTHING
from nclient.protocol.replies import Reply
from nserver_emu.gateway.following import Follower
from nserver_emu.gateway.ownership import Ownership
from nserver_emu.gateway.real_robot import SLOW, STOP, Outcome, RealRobot, Ticket
from nserver_emu.gateway.robot_state import REAL_TIME, Link, moving_axes, state_for
from nserver_emu.gateway.translate import HIGHEST_TIMEOUT_S, REFRESH, Plan, Shaping, plan
from nserver_emu.server.conversation.session import REFUSED, Later, Visit, error_reply
from nserver_emu.server.stage.holds import moves

log = logging.getLogger(__name__)

TIMEOUT_S: Final = 5
"""A robot that nobody speaks to for so long stops; it is what a gateway that dies leaves behind."""
POLL_S: Final = 0.05
"""Between two questions of one ws whether the axes are still."""
_CLOCK: Final = 2**32
_SPEED_SLOT: Final = 0


class RealSide:
    """See the head of this file. `opens` reaches the robot, and raises where it cannot; `clock` tells seconds.

    `feed_s`: how long nothing may be said to a robot that somebody owns; `active`: whether connections drive this or
    the simulated robot.
    """

    def __init__(
        self,
        opens: Callable[[], Backend],
        clock: Callable[[], float],
        *,
        read_only: bool = False,
        feed_s: float = TIMEOUT_S / 3,
    ) -> None:
        self.ownership = Ownership(read_only=read_only)
        self.active = True
        self.last: Reply | None = None
        """The state that came last."""
        self.follower: Follower | None = None
        self._clock = clock
        self._feed_s = feed_s
        self._said_s = self._heard_s = clock()
        self._stopped_for_silence = False
        self._wishes: dict[Visit, int] = {}
        self._position = 0
        self._timeout: tuple[Visit, int] | None = None
        self.robot = RealRobot(opens, self.opening)

    def answer(self, call: Call, visit: Visit) -> Reply | Later:
        """What a connection gets for a call."""
        self._hear(visit)
        found = plan(call, visit, self.robot.link)
        if isinstance(found, int):
            return error_reply(found)
        if not self.ownership.allows(call, visit):
            return error_reply(REFUSED)
        match call.name:
            case "ws":
                return self._wait(call.args, visit)
            case "ct":
                found = Plan(self._agree(visit) or found.calls, found.shape)
            case "conf_tm":
                self._timeout = (visit, found.calls[0].args[0]) if call.args[0] > 0 else None
                found = Plan((self._timeout_call(),), found.shape)
            case _:
                pass
        if found.calls != (REFRESH,):
            return self._promise(self._submit(found.calls, call), found.shape, visit)
        if self.robot.saying in SLOW and self.last is not None:  # what there is: its clock tells how old it is
            return found.shape(visit, self.last, self.robot.link)
        return self._promise(self.refresh(), found.shape, visit)

    def leave(self, visit: Visit) -> None:
        """A connection is gone: a robot that it owned stops, a time-out that it set is not in force any more."""
        self._wishes.pop(visit, None)
        if self.ownership.owner is visit:
            self.let_go()
        if self._timeout is not None and self._timeout[0] is visit:
            self._timeout = None
            self._submit((self._timeout_call(),))

    def stop(self) -> None:
        """Whoever owns the robot: it stops."""
        self._submit((STOP,))

    def let_go(self) -> None:
        """The robot is not driven from here any more: it stops, and is nobody's."""
        self.ownership.owner = None
        if not self.ownership.read_only:
            self._submit((STOP,))

    def tick(self) -> None:
        """Time has passed: follow the robot; feed one that somebody owns, stop one whose owner has gone dumb."""
        self.catch_up()
        if not self.active or self.ownership.owner is None:
            return
        if self._timeout is None:
            if self._since_s(self._said_s) >= self._feed_s:
                self.refresh()
        elif self._since_s(self._heard_s) > self._timeout[1] and not self._stopped_for_silence:
            log.warning("the real robot's owner has said nothing for %d s, its time-out: stopped", self._timeout[1])
            self._stopped_for_silence = True
            self._submit((STOP,))

    def refresh(self) -> Ticket:
        """Have the state asked for."""
        self._said_s = self._clock()
        return self.robot.refresh()

    def catch_up(self) -> None:
        """See what the robot has done since, and let the shadow do it."""
        while self.robot.finished:
            ticket = self.robot.finished.popleft()
            assert ticket.outcome is not None
            states = [reply for reply in ticket.outcome.replies if reply.kind == "state"]
            self.last = states[-1] if states else self.last
            slow = ticket.calls[0].name in SLOW
            self._follow(() if slow else ticket.simulated, states[-1] if states else None)

    def opening(self, link: Link, again: bool) -> Iterable[Call]:
        """What a robot is told when it is reached: to stop where it was lost, its time-out, what to send."""
        if not self.ownership.read_only:
            yield from (STOP,) if again else ()
            yield self._timeout_call()
        if link.masks:
            yield Call("ct", EVERYTHING.with_position(self._position).smask)

    @property
    def last_words(self) -> tuple[Call, ...]:
        """What a robot is told in the end: to stop, if it may be moved from here."""
        return () if self.ownership.read_only else (STOP,)

    def close(self) -> None:
        """Stop the robot and let it go. Twice is fine."""
        self.robot.close(*self.last_words)
        self.catch_up()

    def _hear(self, visit: Visit) -> None:
        """The owner lives; who is about to become it has spoken just now as well."""
        if self.ownership.is_free_for(visit):
            self._heard_s = self._clock()
            self._stopped_for_silence = False

    def _since_s(self, then_s: float) -> float:
        """Seconds since then, as the robot's time runs and its time-out with it: a simulation waits to be asked."""
        pace = REAL_TIME if self.last is None else self.last.slots.get(_SPEED_SLOT, REAL_TIME)
        return (self._clock() - then_s) * pace / REAL_TIME

    def _submit(self, calls: tuple[Call, ...], meant: Call | None = None) -> Ticket:
        self._said_s = self._clock()
        if calls[0].name in SLOW and not self.robot.silent:
            self._follow(calls)
        return self.robot.submit(calls, moves=meant is not None and moves(meant), meant=meant)

    def _follow(self, calls: Iterable[Call], state: Reply | None = None) -> None:
        """The shadow does what the robot has done, or what it begins now and is long about."""
        if self.follower is not None and self.active:
            self.follower.follow(calls, state)

    def _promise(self, ticket: Ticket, shape: Shaping, visit: Visit) -> Later:
        def later() -> Reply | None:
            self._hear(visit)
            self.catch_up()
            return None if ticket.outcome is None else self._shaped(ticket.outcome, shape, visit)

        return later

    def _shaped(self, outcome: Outcome, shape: Shaping, visit: Visit) -> Reply:
        if outcome.code is not None:
            return error_reply(outcome.code)
        return shape(visit, outcome.replies[-1], self.robot.link)

    def _wait(self, args: tuple[int, ...], visit: Visit) -> Later:
        """ws: on the robot's own clock, which is the simulated one's where the robot is a simulation."""
        axes = sum(bool(flag) << axis for axis, flag in enumerate(args[:3]))
        longest_ms = 1000 * max(0, args[3])
        begun_ms: int | None = None
        ticket: Ticket | None = None
        asked_s = 0.0

        def later() -> Reply | None:
            nonlocal begun_ms, ticket, asked_s
            self._hear(visit)
            if ticket is None:
                if begun_ms is None or self._clock() - asked_s >= POLL_S:
                    ticket, asked_s = self.refresh(), self._clock()
                return None
            self.catch_up()
            if ticket.outcome is None:
                return None
            outcome, ticket = ticket.outcome, None
            if outcome.code is None:
                state = outcome.replies[-1]
                now_ms = state.clock or 0
                begun_ms = now_ms if begun_ms is None else begun_ms
                if moving_axes(state) & axes and (now_ms - begun_ms) % _CLOCK < longest_ms:
                    return None
            return self._shaped(outcome, state_for, visit)

        return later

    def _agree(self, visit: Visit) -> tuple[Call, ...]:
        """A connection's mask: the robot sends everything, with the stamps that any connection wants."""
        self._wishes[visit] = visit.terms.mask.position
        position = 0
        for wish in self._wishes.values():
            position |= wish
        if position == self._position:
            return ()
        self._position = position
        return (Call("ct", EVERYTHING.with_position(position).smask),)

    def _timeout_call(self) -> Call:
        timeout_s = TIMEOUT_S if self._timeout is None else self._timeout[1]
        return Call("conf_tm", (min(timeout_s, HIGHEST_TIMEOUT_S),))
