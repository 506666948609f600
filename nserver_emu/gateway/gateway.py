"""Who may move a real robot: one connection at a time, and the others watch. No wire, no clock, no thread.

    questions, ct, ws, st    anybody, at any time
    motions                  the owner; where there is none, whoever moves the robot first becomes it
    all other changes        the owner; anybody while there is none

Rules: the owner gives the robot up by leaving, or by letting it go with lp. A robot to be read only is moved by nobody;
stopped by anybody all the same.

One robot's real side: who may move it, what goes to it, what comes back to each connection.

    answer(call, visit) ──> plan ──> owner? ──> ticket ──> later: the reply, or ERROR 4, 5, 6
    ws                      the state asked for again and again, so that nobody is kept from stopping the robot
    conf_tm                 a client's own: the owner must speak in that time, for watchers do not feed a robot;
                            where none has said one TIMEOUT_S, fed from here while somebody owns the robot

Rules: no thread, no socket; time is an argument. Nothing here waits: an answer is there, or a Later looks for it.

Nserver's clients on real robots: an emulator, with a real side for some of its robots.

    call ──> real_robot, simulated_robot: which side of the connection's robot is driven, by all connected to it
         ──> world, window, server, robots without a real side: the simulation, as ever
         ──> everything else: the real side

Rules: no thread, no socket, no clock but the one handed in with the sides. A switch is refused (ERROR 5) while another
connection owns the robot; the side that is left stands still.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Final

from nclient.backends.base import Backend
from nclient.errors import AddressError
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING
from nserver_emu.gateway.robot_worker import SLOW, STOP, Outcome, RealRobot, Ticket
from nserver_emu.gateway.shadow import Follower, Simulated
from nserver_emu.gateway.translate import (
    HIGHEST_TIMEOUT_S,
    REAL_TIME,
    REFRESH,
    Link,
    Plan,
    Shaping,
    moving_axes,
    plan,
    state_for,
    stays_here,
)
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.handlers.world import done
from nserver_emu.server.ownership import MOTIONS, moves
from nserver_emu.server.session import REFUSED, Later, Visit, error_reply
from nserver_emu.simulation.robot import SimulatedRobot

_CHANGES: Final = MOTIONS | {
    "lp", "sp", "ac", "dp", "da", "place_robot", "tk", "special_request", "arm_ws",
    "conf_ir", "conf_sn", "conf_cp", "conf_ls", "conf_tm", "conf_sg", "conf_ser",
}  # fmt: skip


def changes(call: Call) -> bool:
    """Whether this call changes the robot. st does not count, nor does an mv that leaves all axes: programs ping so."""
    if call.name == "mv":
        return any(call.args[::2])
    return call.name in _CHANGES


class Ownership:
    """Whose one robot is. `owner` is None while it is nobody's."""

    def __init__(self, *, read_only: bool = False) -> None:
        self.read_only = read_only
        self.owner: Visit | None = None

    def allows(self, call: Call, visit: Visit) -> bool:
        """Whether this connection may say that now; a motion that may makes it the owner, lp makes nobody it."""
        if not changes(call):
            return True
        if self.read_only or not self.is_free_for(visit):
            return False
        if call.name == "lp":
            self.owner = None
        elif moves(call):
            self.owner = visit
        return True

    def is_free_for(self, visit: Visit) -> bool:
        """Whether nobody else owns the robot."""
        return self.owner is None or self.owner is visit


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


Around = Callable[[Backend], Backend]
"""What is put around a backend."""
REAL, SIMULATED = "real_robot", "simulated_robot"


class Gateway:
    """`sides`: the real ones, by the numbers of their robots; `shadow`: whether the simulated ones follow them, with
    `around` put around them as backends.

    Raises AddressError where the simulated robot of a number is of another model than the real one.
    """

    def __init__(
        self, emulator: Emulator, sides: Mapping[int, RealSide], *, shadow: bool = False, around: Around = lambda it: it
    ) -> None:
        self.sides = sides
        self._emulator = emulator
        for robot_id, side in sides.items():
            simulated, link = partial(self._simulated, robot_id), side.robot.link
            if simulated().model.family != link.model.name:
                raise AddressError(f"robot {robot_id} is a {simulated().model.family} in the simulation and really a "
                                   f"{link.model.name}; model= in the address and --robot must say the same")
            if shadow:
                following = around(Simulated(emulator.answer, robot_id, link.model))
                side.follower = Follower(following, simulated, link)
                side.refresh()

    def answer(self, call: Call, visit: Visit) -> Reply | Later:
        """The reply to a call, or a promise of it: from the real robot, where the connection's robot is one."""
        side = None if visit.robot_id is None else self.sides.get(visit.robot_id)
        if side is None:
            return self._emulator.answer(call, visit)
        if call.name in (REAL, SIMULATED):
            return self._switch(side, visit, to_real=call.name == REAL)
        if not side.active or stays_here(call.name):
            return self._emulator.answer(call, visit)
        meant = self._emulator.holds.meant(call, visit.robot_id)
        return error_reply(REFUSED) if meant is None else side.answer(meant, visit)

    def hold(self, robot_id: int, by: str) -> None:
        """Stop a robot, the real one too where it is driven, and let nobody move it until it is released."""
        self._emulator.hold(robot_id, by)
        side = self.sides.get(robot_id)
        if side is not None and side.active:
            side.stop()

    def leave(self, visit: Visit) -> None:
        """A connection is gone: what it drove stops, on either side."""
        self._emulator.leave(visit)
        for side in self.sides.values():
            side.leave(visit)

    def tick(self) -> None:
        """Time has passed."""
        for side in self.sides.values():
            side.tick()

    def _switch(self, side: RealSide, visit: Visit, *, to_real: bool) -> Reply:
        assert visit.robot_id is not None
        if not side.ownership.is_free_for(visit):
            return error_reply(REFUSED)
        if side.active != to_real:
            log.warning("robot %d is the %s one from now on", visit.robot_id, "real" if to_real else "simulated")
            if to_real:
                self._simulated(visit.robot_id).stop()
                self._emulator.look_anew()
            else:
                side.let_go()
            side.active = to_real
        return done()

    def _simulated(self, robot_id: int) -> SimulatedRobot:
        return self._emulator.simulation.robots[robot_id]
