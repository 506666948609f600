"""A robot's own line on real ports: a pseudo-terminal, or TCP as a radio modem or the robot's `robotd` has it.

    SerialLine         one host at a time; who opens the link is a new host, who closes it has left
    RobotdConnection   any number of hosts; an N200 greets each with its hello

Rules: an emulated robot answers, whatever stands behind Nserver's port. When a host leaves, what it drove stops. A
host that does not read keeps nobody: what its end does not take is lost, but for the rest of what has begun to go.
Who opens the link at once after another closed it is another host: bytes are read before it is asked who is there.
Hosts ask one thing at a time, so of what comes with the news the last frame is the newcomer's: of all that has come
when the system, which hands bytes from end to end in its own time, has had a moment for it. The robot stops at once.

The options of `nserver` for robots' own lines, and the lines that they ask for.

    --serial-link PATH[@ROBOT]    --robotd [PORT[@ROBOT]]    --baud RATE

Rules: the k-th line of a kind is robot k's where it names none. Each open line is one line on stdout, for programs.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from nclient.errors import AddressError, ConnectionLost
from nclient.faults.frames import Language, LineLanguage
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFramer
from nclient.protocol.types import Model, get_model
from nclient.recording.recorder import HANDSHAKE_FIRST, NULL_RECORDER, SERIAL
from nserver_emu.server.connection import READ_SIZE, Connection, ConnectionHandler
from nserver_emu.server.link import RateLimitedChannel, SerialChannel
from nserver_emu.server.serial_session import SerialSession

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon
    from nserver_emu.server.pty import PseudoTerminal

log = logging.getLogger(__name__)

LINK_LOOK_S = 0.5
"""How often it is looked whether somebody removed the link."""


SETTLE_S = 0.02
"""How long bytes may take from a host's end to ours, when one host has followed another."""


class RobotLine(NamedTuple):
    """Whose line it is."""

    robot_id: int
    model: Model


def robot_line(daemon: Daemon, robot_id: int) -> RobotLine:
    """The line of a robot. Raises AddressError where there is none of that number."""
    robots = daemon.emulator.simulation.robots
    if robot_id not in robots:
        known = ", ".join(map(str, robots))
        raise AddressError(f"a line for robot {robot_id}: there is no such robot, but {known}; --robots makes more")
    return RobotLine(robot_id, get_model(robots[robot_id].model.family))


def last_frame(data: bytes) -> int:
    """Where the last frame begins, whole or not: what two hosts sent is split there."""
    framer, starts = SerialFramer(limit=HOST_LIMIT), [0]
    for end in range(1, len(data) + 1):
        if framer.receive(data[end - 1 : end]):
            starts.append(end)
    return starts[-1] if starts[-1] < len(data) else starts[-2] if len(starts) > 1 else 0


class PtyConnection(ConnectionHandler):
    """A pseudo-terminal and the robot behind it. `new_cable` makes what lies between them, anew for each host."""

    session: SerialSession

    def __init__(
        self,
        daemon: Daemon,
        own: RobotLine,
        terminal: PseudoTerminal,
        new_cable: Callable[[], SerialChannel] | None = None,
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
        wire_state = emulator.serial_wire_state(self.own.robot_id)
        self.session = SerialSession(emulator.answer, *self.own, self._loop.time, name, wire_state)
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
            self.data_received(data)

    def _noticed(self) -> None:
        """Somebody opened or closed the link."""
        changed = self.terminal.comings.changed()
        if changed and self.here and self._settling is None:
            self._handed_over(b"")
        elif not self.here and not self.terminal.deserted:
            self._arrived_here()

    def _handed_over(self, data: bytes) -> None:
        """The host left, and another came before it was seen that nobody was there; `data`: what both sent so far."""
        self._daemon.emulator.on_disconnect(self.session.context)
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
            self.data_received(data[:split])
        self._left()
        self.terminal.flush()
        self._arrived_here()
        if data[split:]:
            self.data_received(data[split:])

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
        self._daemon.emulator.on_disconnect(self.session.context)
        self._tape.close()
        self._tape = NULL_RECORDER
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

    def __init__(self, daemon: Daemon, own: RobotLine) -> None:
        super().__init__(daemon)
        self.own = own
        self.line = f"robotd:{own.robot_id}"
        self._behind = daemon.emulator
        self._greeted = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if self.greeting:
            self._tape.to_host(self.greeting)
            self.send(self.greeting)
        self._greeted = True

    def _language(self) -> Language:
        return LineLanguage(has_handshake=not self._greeted and bool(self.greeting))

    def _meet(self, name: str) -> None:
        wire_state = self._daemon.emulator.serial_wire_state(self.own.robot_id)
        session = SerialSession(self._behind.answer, *self.own, self._loop.time, name, wire_state)
        self.session, self.greeting = session, session.greeting
        wire = HANDSHAKE_FIRST if self.greeting else SERIAL
        self._tape = self._daemon.recorder.open(name, wire, self.own.model, self.own.robot_id)


if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

ROBOTD_PORT: Final = 65001
"""Where a robot on a network answers."""
SLOWEST_BAUD, FASTEST_BAUD = 9600, 4_000_000
_HIGHEST_PORT = 65535


class Wanted(NamedTuple):
    """A line that an option asks for: a path or a port, and whose; None: by its place among those of its kind."""

    place: str
    robot_id: int | None


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of this room."""
    group = parser.add_argument_group("robots' own lines")
    group.add_argument(
        "--serial-link",
        action="append",
        type=_link,
        default=[],
        metavar="PATH[@ROBOT]",
        help="a robot's own serial line: a pseudo-terminal, and PATH a symbolic link to it; once more "
        "for robot 2, and so on; clients find it at serial://PATH?model=MODEL",
    )
    group.add_argument(
        "--robotd",
        action="append",
        type=_port,
        nargs="?",
        const=Wanted(str(ROBOTD_PORT), None),
        default=[],
        metavar="PORT[@ROBOT]",
        help=f"the same over TCP (default {ROBOTD_PORT}; 0 takes a free port); clients find it at "
        "robotd://HOST:PORT?model=MODEL",
    )
    group.add_argument(
        "--baud",
        type=_baud,
        metavar="RATE",
        help="let serial lines be as slow as a real one, 38400 for a Nomad's (default: no time at all)",
    )


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Wrong usage that only several options together show."""
    if options.baud is not None and not options.serial_link:
        parser.error("--baud is the rate of serial lines, and there is none: add --serial-link PATH")


async def open_lines(daemon: Daemon, options: argparse.Namespace) -> list[str]:
    """Open the lines; what to print of each. Raises AddressError or ConnectionLost, naming the remedy."""
    host = options.bind
    ports = [await _open_robotd(daemon, own, host, int(port)) for own, port in _lines(daemon, options.robotd)]
    paths = [_open_serial(daemon, own, path, options.baud) for own, path in _lines(daemon, options.serial_link)]
    return [f"listening robotd {port}" for port in ports] + [f"listening serial {path}" for path in paths]


def at_port(host: str, port: int) -> str:
    """HOST:PORT, as addresses have it."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _lines(daemon: Daemon, wanted: list[Wanted]) -> list[tuple[RobotLine, str]]:
    return [
        (robot_line(daemon, number if robot_id is None else robot_id), place)
        for number, (place, robot_id) in enumerate(wanted, start=1)
    ]


async def _open_robotd(daemon: Daemon, own: RobotLine, host: str, port: int) -> str:
    place = at_port(host, await daemon.open_listener(lambda: RobotdConnection(daemon, own), host, port, "--robotd"))
    _note(daemon, f"robotd:{own.robot_id}", place)
    return place


def _open_serial(daemon: Daemon, own: RobotLine, path: str, baud: int | None) -> str:
    try:
        from nserver_emu.server.pty import PseudoTerminal
    except ImportError:
        raise ConnectionLost(f"no serial link {path}: this system has no pseudo-terminals; use --robotd") from None
    PtyConnection(daemon, own, PseudoTerminal(Path(path)), None if baud is None else lambda: RateLimitedChannel(baud))
    _note(daemon, f"serial:{own.robot_id}", path)
    return path


def _note(daemon: Daemon, line: str, place: str) -> None:
    """Where a line of a robot is; where it has several of a kind they count as one, and all are told."""
    daemon.places[line] = ", ".join(filter(None, (daemon.places.get(line), place)))


def _link(text: str) -> Wanted:
    wanted = _split(text)
    if not wanted.place:
        raise argparse.ArgumentTypeError("a path such as /tmp/nomad, or /tmp/nomad@2 for robot 2")
    if wanted.robot_id is None and "@" in Path(wanted.place).name:
        raise argparse.ArgumentTypeError(f"after @ comes the number of a robot, PATH@2, not {text!r}")
    return wanted


def _port(text: str) -> Wanted:
    wanted = _split(text)
    if not wanted.place.isdecimal() or int(wanted.place) > _HIGHEST_PORT:
        raise argparse.ArgumentTypeError(
            f"a port is 0 to {_HIGHEST_PORT}, or PORT@ROBOT, not {text!r}; the world goes before --robotd"
        )
    return wanted


def _split(text: str) -> Wanted:
    """PATH@2 names robot 2."""
    numbered = re.fullmatch(r"(.*)@(\d+)", text)
    return Wanted(numbered[1], int(numbered[2])) if numbered else Wanted(text, None)


def _baud(text: str) -> int:
    if not text.isdecimal() or not SLOWEST_BAUD <= int(text) <= FASTEST_BAUD:
        raise argparse.ArgumentTypeError(f"a rate is {SLOWEST_BAUD} to {FASTEST_BAUD} bits a second, not {text!r}")
    return int(text)
