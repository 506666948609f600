"""Robots' own lines on real ports, and the options of `nserver` that open them.

    --serial-link PATH[@ROBOT]    PtyConnection      a pseudo-terminal: one host at a time; opening the link connects a
                                                     host, closing it disconnects it
    --robotd [PORT[@ROBOT]]       RobotdConnection   TCP, as a radio modem or the robot's `robotd`: any number of hosts
    --baud RATE                                      limit serial lines to the rate of a real one

The simulated robot answers, whatever is behind the port of Nserver. A host's motions stop when it disconnects. Replies
that a host does not read are dropped, except for the rest of a packet whose first bytes were written. The k-th line of
a kind belongs to robot k unless it names another.
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
from nclient.faults.inject import Language, LineLanguage
from nclient.protocol.types import Model, get_model
from nclient.recording.recorder import HANDSHAKE_FIRST, NULL_RECORDER, SERIAL
from nserver_emu.server.admission import at_port
from nserver_emu.server.connection import READ_SIZE, ConnectionHandler, ConnectionState, TcpConnection
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.serial_session import RateLimitedChannel, SerialChannel, SerialSession

if TYPE_CHECKING:
    # The module does not exist on Windows.
    from nserver_emu.server.pty import PseudoTerminal

log = logging.getLogger(__name__)

# Seconds between checks if the symbolic link was removed.
LINK_CHECK_INTERVAL_S = 0.5

# Default port of a robot on a network.
ROBOTD_PORT: Final = 65001
MIN_BAUD, MAX_BAUD = 9600, 4_000_000
_MAX_PORT = 65535
# Beginning of the names that old C programs take for serial ports.
DEVICE_FOLDER: Final = "/dev"


class RobotLine(NamedTuple):
    """The robot that a line belongs to."""

    robot_id: int
    model: Model


def robot_line(daemon: Daemon, robot_id: int) -> RobotLine:
    """Return the line of a robot. Raise AddressError if there is no robot of that number."""
    robots = daemon.emulator.simulation.robots
    if robot_id not in robots:
        existing = ", ".join(map(str, robots))
        raise AddressError(f"a line for robot {robot_id}: there is no such robot, only {existing}; --robots adds more")
    return RobotLine(robot_id, get_model(robots[robot_id].model.family))


class PtyConnection(ConnectionHandler):
    """A pseudo-terminal and the simulated robot behind it.

    Parameters
    ----------
    daemon, robot
        The server and the robot of this line.
    terminal
        The open pseudo-terminal.
    new_channel
        Creates the channel between terminal and session, anew for each host; None for no delay.
    """

    session: SerialSession

    def __init__(self, daemon: Daemon, robot: RobotLine, terminal: PseudoTerminal,
                 new_channel: Callable[[], SerialChannel] | None = None) -> None:
        super().__init__(daemon)
        self.robot = robot
        self.line = f"serial:{robot.robot_id}"
        self.terminal = terminal
        # Number of bytes dropped because the host did not read them.
        self.lost = 0
        self._handler = daemon.emulator
        self._new_channel = new_channel
        self.state = ConnectionState.DISCONNECTED
        self._is_reading = False
        # The rest of a reply that the terminal has taken in part.
        self._write_buffer = b""
        self._next_link_check_s = 0.0
        self._start_session()
        daemon.connections.add(self)

    def tick(self) -> None:
        """Check for a new host and a removed link, and send a deferred reply if it is complete."""
        if self._loop.time() >= self._next_link_check_s:
            self._next_link_check_s = self._loop.time() + LINK_CHECK_INTERVAL_S
            if self.terminal.restore_link():
                log.warning("%s: the symbolic link was removed; created again", self.session.name)
        if self.state is ConnectionState.OPEN:
            super().tick()
        elif not self.terminal.is_closed:
            self._on_opened()

    def close(self) -> None:
        """Close the terminal and remove the connection from the server."""
        self._on_closed()
        self.state = ConnectionState.CLOSED
        self.terminal.close()
        self._server.connections.discard(self)

    def _start_session(self) -> None:
        """Create the session for the next host. Mask and laser mode are the robot's and stay in force."""
        emulator, name = self._server.emulator, f"serial {self.terminal.path}"
        wire_state = emulator.serial_wire_state(self.robot.robot_id)
        self.session = SerialSession(self._handler.answer, *self.robot, self._loop.time, name, wire_state)
        self._channel = None if self._new_channel is None else self._new_channel()
        self._has_faults = False
        self._preparing_steps, self._prepared_ps = 0, -1

    def _on_opened(self) -> None:
        """Connect the host that has opened the link."""
        self.state = ConnectionState.OPEN
        self._recorder = self._server.recorder.open(self.session.name, SERIAL, self.robot.model, self.robot.robot_id)
        log.info("%s: opened", self.session.name)
        self._set_reading(True)

    def _on_readable(self) -> None:
        data = self.terminal.read(READ_SIZE)
        if data is None:
            self._on_closed()
            self.terminal.reset()
        elif data:
            self.data_received(data)

    def _on_closed(self) -> None:
        """Disconnect the host: its motions stop; requests that wait and replies in its channel are dropped."""
        self._cancel_timers()
        self._set_reading(False)
        self._loop.remove_writer(self.terminal.fd)
        self._write_buffer = self._receive_backlog = b""
        if self.state is ConnectionState.OPEN:
            log.info("%s: closed after %d refused requests", self.session.name, self.session.refused)
        self.state = ConnectionState.DISCONNECTED
        self._handler.on_disconnect(self.session.context)
        self._recorder.close()
        self._recorder = NULL_RECORDER
        self._start_session()

    def _language(self) -> Language:
        return LineLanguage()

    def _write(self, data: bytes) -> None:
        # A line without flow control: what does not fit is lost.
        if self._write_buffer:
            self.lost += len(data)
            return
        count = self.terminal.write(data)
        if count < len(data):
            self._write_buffer = data[count:]
            self._loop.add_writer(self.terminal.fd, self._on_writable)

    def _on_writable(self) -> None:
        self._write_buffer = self._write_buffer[self.terminal.write(self._write_buffer) :]
        if not self._write_buffer:
            self._loop.remove_writer(self.terminal.fd)

    def _set_reading(self, on: bool) -> None:
        if on == self._is_reading:
            return
        self._is_reading = on
        if on:
            self._loop.add_reader(self.terminal.fd, self._on_readable)
        else:
            self._loop.remove_reader(self.terminal.fd)

    def _close_port(self) -> None:
        """Hang up as an unplugged adapter does: the host's end is dead, and a new one is behind the link."""
        self._on_closed()
        self.terminal.replace()


class RobotdConnection(TcpConnection):
    """A TCP connection of a host to a robot's own line. A N200 sends each host its handshake first."""

    def __init__(self, daemon: Daemon, robot: RobotLine) -> None:
        super().__init__(daemon)
        self.robot = robot
        self.line = f"robotd:{robot.robot_id}"
        self._handler = daemon.emulator
        self._has_sent_greeting = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the session; a N200 sends its handshake first."""
        super().connection_made(transport)
        if self.greeting:
            self._recorder.to_host(self.greeting)
            self.send(self.greeting)
        self._has_sent_greeting = True

    def _language(self) -> Language:
        return LineLanguage(has_handshake=not self._has_sent_greeting and bool(self.greeting))

    def _start_session(self, name: str) -> None:
        wire_state = self._server.emulator.serial_wire_state(self.robot.robot_id)
        session = SerialSession(self._handler.answer, *self.robot, self._loop.time, name, wire_state)
        self.session, self.greeting = session, session.greeting
        wire = HANDSHAKE_FIRST if self.greeting else SERIAL
        self._recorder = self._server.recorder.open(name, wire, self.robot.model, self.robot.robot_id)


# Options.


class RequestedLine(NamedTuple):
    """A line requested on the command line."""

    # Path or port.
    place: str
    # None: the robot numbered as the line among those of its kind.
    robot_id: int | None


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of robots' own lines."""
    group = parser.add_argument_group("robots' own lines")
    group.add_argument("--serial-link", action="append", type=_link, default=[], metavar="PATH[@ROBOT]",
                       help="create a pseudo-terminal as a robot's serial line, and PATH as a symbolic link to it; "
                       "repeatable, for robot 2 and so on; clients connect to serial://PATH?model=MODEL, old C "
                       "programs to PATH if it begins with /dev, such as /dev/shm/nomad")
    group.add_argument("--robotd", action="append", type=_port, nargs="?",
                       const=RequestedLine(str(ROBOTD_PORT), None), default=[], metavar="PORT[@ROBOT]",
                       help=f"listen for a robot's line over TCP (default: {ROBOTD_PORT}; 0 takes a free port); "
                       "clients connect to robotd://HOST:PORT?model=MODEL")
    group.add_argument("--baud", type=_baud, metavar="RATE",
                       help="limit serial lines to RATE bits per second, 38400 for a real Nomad (default: no limit)")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Exit with a usage error for options that do not fit together."""
    if options.baud is not None and not options.serial_link:
        parser.error("--baud is the rate of serial lines, and there is none: add --serial-link PATH")


async def open_lines(daemon: Daemon, options: argparse.Namespace) -> list[str]:
    """Open the requested lines and return a line of output for each.

    Raises
    ------
    AddressError
        If there is no such robot.
    ConnectionLost
        If a port or link cannot be opened; the message names the remedy.
    """
    host = options.bind
    for place, _ in options.serial_link:
        if not place.startswith(DEVICE_FOLDER):
            log.warning("--serial-link %s: old C programs take a name that does not begin with %s for a host; link it "
                        "as /dev/shm/nomad for them", place, DEVICE_FOLDER)  # fmt: skip
    ports = [await _open_robotd(daemon, robot, host, int(port)) for robot, port in _lines(daemon, options.robotd)]
    paths = [_open_serial(daemon, robot, path, options.baud) for robot, path in _lines(daemon, options.serial_link)]
    return [f"listening robotd {port}" for port in ports] + [f"listening serial {path}" for path in paths]


def _lines(daemon: Daemon, requested: list[RequestedLine]) -> list[tuple[RobotLine, str]]:
    return [(robot_line(daemon, number if robot_id is None else robot_id), place)
            for number, (place, robot_id) in enumerate(requested, start=1)]


async def _open_robotd(daemon: Daemon, robot: RobotLine, host: str, port: int) -> str:
    place = at_port(host, await daemon.open_listener(lambda: RobotdConnection(daemon, robot), host, port, "--robotd"))
    _add_place(daemon, f"robotd:{robot.robot_id}", place)
    return place


def _open_serial(daemon: Daemon, robot: RobotLine, path: str, baud: int | None) -> str:
    try:
        from nserver_emu.server.pty import DEFAULT_BAUD, PseudoTerminal
    except ImportError:
        raise ConnectionLost(f"no serial link {path}: this system has no pseudo-terminals; use --robotd") from None
    # A limited line takes hosts of the robot's usual rate, too.
    terminal = PseudoTerminal(Path(path), (DEFAULT_BAUD,) if baud is None else (DEFAULT_BAUD, baud))
    PtyConnection(daemon, robot, terminal, None if baud is None else lambda: RateLimitedChannel(baud))
    _add_place(daemon, f"serial:{robot.robot_id}", path)
    return path


def _add_place(daemon: Daemon, line: str, place: str) -> None:
    """Record the address of a line; several lines of a kind and robot share one entry."""
    daemon.places[line] = ", ".join(filter(None, (daemon.places.get(line), place)))


def _link(text: str) -> RequestedLine:
    line = _split_robot(text)
    if not line.place:
        raise argparse.ArgumentTypeError("a path such as /dev/shm/nomad, or /dev/shm/nomad@2 for robot 2")
    if line.robot_id is None and "@" in Path(line.place).name:
        raise argparse.ArgumentTypeError(f"after @ comes the number of a robot, PATH@2, not {text!r}")
    return line


def _port(text: str) -> RequestedLine:
    line = _split_robot(text)
    if not line.place.isdecimal() or int(line.place) > _MAX_PORT:
        raise argparse.ArgumentTypeError(
            f"a port is 0 to {_MAX_PORT}, or PORT@ROBOT, not {text!r}; the world goes before --robotd"
        )
    return line


def _split_robot(text: str) -> RequestedLine:
    """Split PLACE@ROBOT."""
    numbered = re.fullmatch(r"(.*)@(\d+)", text)
    return RequestedLine(numbered[1], int(numbered[2])) if numbered else RequestedLine(text, None)


def _baud(text: str) -> int:
    if not text.isdecimal() or not MIN_BAUD <= int(text) <= MAX_BAUD:
        raise argparse.ArgumentTypeError(f"a rate is {MIN_BAUD} to {MAX_BAUD} bits a second, not {text!r}")
    return int(text)
