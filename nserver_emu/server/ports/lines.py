"""A robot's own line on real ports: a pseudo-terminal, or TCP as a radio modem or the robot's `robotd` has it.

    SerialLine         one host at a time; who opens the link is a new host, who closes it has left
    RobotdConnection   any number of hosts; an N200 greets each with its hello

Rules: an emulated robot answers, whatever stands behind Nserver's port. When a host leaves, what it drove stops. A
host that does not read keeps nobody: what its end does not take is lost, but for the rest of what has begun to go.
Who opens the link at once after another closed it is another host: bytes are read before it is asked who is there.
Hosts ask one thing at a time, so of what comes with the news the last frame is the newcomer's: of all that has come
when the system, which hands bytes from end to end in its own time, has had a moment for it. The robot stops at once.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from nclient.errors import AddressError
from nclient.faults.language import Language, LineLanguage
from nclient.protocol.models import Model, model_named
from nclient.protocol.serial_frame import HOST_LIMIT, SerialFramer
from nclient.recording.follower import HELLO_FIRST, SERIAL
from nclient.recording.recorder import OFF
from nserver_emu.server.conversation.line_session import LineSession
from nserver_emu.server.ports.cable import Cable
from nserver_emu.server.ports.connection import Connection
from nserver_emu.server.ports.talker import READ_SIZE, Talker

if TYPE_CHECKING:
    from nserver_emu.server.ports.daemon import Daemon
    from nserver_emu.server.ports.pseudo_terminal import PseudoTerminal

log = logging.getLogger(__name__)

LINK_LOOK_S = 0.5
"""How often it is looked whether somebody removed the link."""


SETTLE_S = 0.02
"""How long bytes may take from a host's end to ours, when one host has followed another."""


class OwnLine(NamedTuple):
    """Whose line it is."""

    robot_id: int
    model: Model


def own_line(daemon: Daemon, robot_id: int) -> OwnLine:
    """The line of a robot. Raises AddressError where there is none of that number."""
    robots = daemon.emulator.simulation.robots
    if robot_id not in robots:
        known = ", ".join(map(str, robots))
        raise AddressError(f"a line for robot {robot_id}: there is no such robot, but {known}; --robots makes more")
    return OwnLine(robot_id, model_named(robots[robot_id].model.family))


def last_frame(data: bytes) -> int:
    """Where the last frame begins, whole or not: what two hosts sent is split there."""
    framer, starts = SerialFramer(limit=HOST_LIMIT), [0]
    for end in range(1, len(data) + 1):
        if framer.receive(data[end - 1 : end]):
            starts.append(end)
    return starts[-1] if starts[-1] < len(data) else starts[-2] if len(starts) > 1 else 0


class SerialLine(Talker):
    """A pseudo-terminal and the robot behind it. `new_cable` makes what lies between them, anew for each host."""

    session: LineSession

    def __init__(
        self, daemon: Daemon, own: OwnLine, terminal: PseudoTerminal, new_cable: Callable[[], Cable] | None = None
    ) -> None:
        super().__init__(daemon)
        self.own = own
        self.line = f"serial:{own.robot_id}"
        self.terminal = terminal
        self.lost = 0
        """Bytes that no host took."""
        self._new_cable = new_cable
        self.here = self._listening = self._muted = False
        self._rest = self._gathered = b""
        self._settling: asyncio.TimerHandle | None = None
        self._begin()
        daemon.connections.add(self)
        self._look_s = 0.0
        self._notices = terminal.comings.fd
        if self._notices >= 0:
            self._loop.add_reader(self._notices, self._noticed)

    def tick(self) -> None:
        """Time has passed: a host may have come, an answer may be there, the link may be gone."""
        if self._loop.time() >= self._look_s:
            self._look_s = self._loop.time() + LINK_LOOK_S
            if self.terminal.restore_link():
                log.warning("%s: the link had been removed, and is there again", self.session.name)
        if self.here:
            super().tick()
        elif not self.terminal.deserted:
            self._arrived_here()

    def close(self) -> None:
        if self._notices >= 0:
            self._loop.remove_reader(self._notices)
            self._notices = -1
        self._left()
        self.terminal.close()
        self._daemon.connections.discard(self)

    def _begin(self) -> None:
        """A conversation for the next host."""
        emulator, name = self._daemon.emulator, f"serial {self.terminal.path}"
        terms = emulator.line_terms(self.own.robot_id)
        self.session = LineSession(emulator.answer, *self.own, self._loop.time, name, terms)
        self._cable = None if self._new_cable is None else self._new_cable()
        self._faulty = False

    def _arrived_here(self) -> None:
        """There is a host."""
        self.here = True
        self._tape = self._daemon.recorder.open(self.session.name, SERIAL, self.own.model, self.own.robot_id)
        log.info("%s: opened", self.session.name)
        self._listen(True)

    def _readable(self) -> None:
        data = self.terminal.read(READ_SIZE)
        if data is None:
            self._left()
            self.terminal.clean()
            return
        if self.terminal.comings.changed():
            self._handed_over(data)
        elif data:
            self._came(data)

    def _noticed(self) -> None:
        """Somebody opened or closed the link."""
        changed = self.terminal.comings.changed()
        if changed and self.here and self._settling is None:
            self._handed_over(b"")
        elif not self.here and not self.terminal.deserted:
            self._arrived_here()

    def _handed_over(self, data: bytes) -> None:
        """The host left, and another came before it was seen that nobody was there; `data`: what both sent so far."""
        self._daemon.emulator.leave(self.session.visit)
        self._listen(False)
        self._muted = True
        self._gathered = data
        self._settling = self._loop.call_later(SETTLE_S, self._settle)

    def _settle(self) -> None:
        """What both hosts sent is here: the first one's is obeyed unanswered, and then it has left."""
        self._settling = None
        data = self._gathered + (self.terminal.read(READ_SIZE) or b"")
        split = last_frame(data)
        if split:
            self._came(data[:split])
        self._left()
        self.terminal.flush()
        self._arrived_here()
        if data[split:]:
            self._came(data[split:])

    def _left(self) -> None:
        """The host is gone: its robot stops, and what was on its way to it is forgotten."""
        self._silence()
        self._listen(False)
        if self._settling is not None:
            self._settling.cancel()
            self._settling = None
        self._muted = False
        self._loop.remove_writer(self.terminal.fd)
        self._rest = b""
        if self.here:
            log.info("%s: left after %d refusals", self.session.name, self.session.refused)
        self.here = False
        self._daemon.emulator.leave(self.session.visit)
        self._tape.close()
        self._tape = OFF
        self._begin()

    def _language(self) -> Language:
        return LineLanguage()

    def _send(self, data: bytes) -> None:
        if self._rest or self._muted:
            self.lost += len(data)
            return
        taken = self.terminal.write(data)
        if taken < len(data):
            self._rest = data[taken:]
            self._loop.add_writer(self.terminal.fd, self._writable)

    def _writable(self) -> None:
        self._rest = self._rest[self.terminal.write(self._rest) :]
        if not self._rest:
            self._loop.remove_writer(self.terminal.fd)

    def _listen(self, on: bool) -> None:
        if on == self._listening or (on and (not self.here or self._settling is not None)):
            return
        self._listening = on
        if on:
            self._loop.add_reader(self.terminal.fd, self._readable)
        else:
            self._loop.remove_reader(self.terminal.fd)

    def _hang_up(self) -> None:
        """As an adapter that is pulled out: the host's end is dead, and another is behind the link."""
        self._left()
        self.terminal.pull()

    def _abort(self) -> None:
        self._hang_up()


class RobotdConnection(Connection):
    """One host that reached a robot over TCP."""

    def __init__(self, daemon: Daemon, own: OwnLine) -> None:
        super().__init__(daemon)
        self.own = own
        self.line = f"robotd:{own.robot_id}"
        self._behind = daemon.emulator
        self._greeted = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if self.greeting:
            self._tape.to_host(self.greeting)
            self._say(self.greeting)
        self._greeted = True

    def _language(self) -> Language:
        return LineLanguage(greets=not self._greeted and bool(self.greeting))

    def _meet(self, name: str) -> None:
        terms = self._daemon.emulator.line_terms(self.own.robot_id)
        session = LineSession(self._behind.answer, *self.own, self._loop.time, name, terms)
        self.session, self.greeting = session, session.greeting
        wire = HELLO_FIRST if self.greeting else SERIAL
        self._tape = self._daemon.recorder.open(name, wire, self.own.model, self.own.robot_id)
