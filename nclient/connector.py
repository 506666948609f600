"""Connections: from an address to a `Robot`.

    nserver://host[:port]/id?timeout_s=2&model=scout     an Nserver over TCP; defaults: port 7019, robot 1, an N150
    sim:WORLD?robot=n150&seed=1&noisy=1                  the emulator in this process, found by its entry point
    serial:///dev/ttyUSB0?model=n150&baud=38400          a robot on a cable, or an emulated one on a pseudo-terminal
    robotd://host[:port]?model=n200                      the serial protocol over TCP; default port 65001
    replay:FILE                                          the robot's side of a recording

`Connector` builds a connection, layer by layer:

    transport <- recorder <- faults <- protocol backend <- reconnect <- retries <- bumper stop <- keep-alive <- limits

`nclient.url` lists all schemes and options and validates them before anything is opened.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from nclient.aio import AsyncRobot
from nclient.backends import wrappers
from nclient.backends.base import Backend, KeepAlive, LinkStatistics
from nclient.backends.direct import DirectBackend
from nclient.backends.nserver import NserverBackend
from nclient.errors import AddressError, ConnectionLost
from nclient.faults.inject import FaultyLine, FaultyStream, Injector, LineLanguage, TcpLanguage
from nclient.faults.plan import require_rules_for
from nclient.protocol.types import MODELS, Model
from nclient.recording.drive import Drive, DrivePeer
from nclient.recording.format import Recording, parse_recording, read_recording
from nclient.recording.recorder import HANDSHAKE_FIRST, TCP, ClientRecording
from nclient.recording.replayer import STRICT, Player, RecordedConnection, ReplayPeer, load_exchanges
from nclient.robot import Robot
from nclient.transports import serial
from nclient.transports import stream as streams
from nclient.transports.stream import ByteStream, MemoryStream, open_in_process
from nclient.url import SCHEMES, Address, available_schemes, parse_address, split_address

log = logging.getLogger(__name__)

DEFAULT_ADDRESS: Final = "nserver://localhost:7019/1"
VARIABLE: Final = "NOMAD_ROBOT"
"""The environment variable that names the default address."""
MAX_KEEP_ALIVE_SPEED: Final = 1000
"""State[0] of a simulation 100 times as fast as real time: a faster one outruns any keep-alive and needs none."""
DEFAULT_ROBOT_ID: Final = 1


@dataclass(frozen=True, slots=True)
class ConnectOptions:
    """Hold what the caller specifies besides the address.

    Attributes
    ----------
    timeout_s
        Maximum time for a reply, unless the address has `timeout_s=`; None: the default of the protocol.
    robot_id
        Number of the robot, which must agree with the one in the address; None: that of the address, or 1.
    create
        True to create a robot of that number on the server.
    """

    timeout_s: float | None = None
    robot_id: int | None = None
    create: bool = False


class Connector:
    """Open the connection that an address describes, and open it again after a link loss.

    What outlives a lost link is stored here: recorder, fault injector, statistics, position in a replayed recording.

    Parameters
    ----------
    address
        From `nclient.url.parse_address`.
    options
        What the caller specifies besides the address.
    injector
        Returns the injector in force, for faults that change at run time; used unless the address has `faults=`.

    Raises
    ------
    AddressError
        If address and caller name different robots.
    """

    def __init__(self, address: Address, options: ConnectOptions = ConnectOptions(), *,
                 injector: Callable[[], Injector] | None = None) -> None:
        self.address = address
        self.timeout_s = options.timeout_s if address.options.timeout_s is None else address.options.timeout_s
        self.robot_id = _agreed_robot_id(address, options)
        self.link = LinkStatistics()
        self.plan_injector: Injector | None = None
        self._injector = injector
        self._create = options.create
        self._recorder: ClientRecording | None = None
        self._recording: Recording | None = None
        self._replayed: RecordedConnection | None = None
        self._drive: Drive | None = None
        self._replays = 0

    @property
    def model(self) -> Model:
        """Return the robot's model: that of the address, or of the replayed recording."""
        return self._replayed.model if self._replayed else self.address.model

    @property
    def wire(self) -> str:
        """Return the protocol on the stream: tcp, serial or hello (serial, after eleven bytes from the robot)."""
        return self._replayed.line if self._replayed else self.address.wire

    def open(self) -> Backend:
        """Open the connection with everything that the address configures.

        Raises
        ------
        ConnectionLost, ReplyTimeout, RobotRefused
            As the protocol backends do while connecting.
        """
        options = self.address.options
        # 1. Transport, recorder, faults and protocol; all of them are opened again after a link loss.
        backend = self.open_session()
        try:
            # 2. Recovery. Reconnecting is the inner one: a retry may find the link open again.
            if options.reconnect:
                backend = wrappers.ReconnectingBackend(backend, self.open_session, options.reconnect)
            if options.retries:
                backend = wrappers.RetryingBackend(backend, options.retries)
            # 3. Safety. Keep-alive polls often enough for the bumper stop inside it to see a hit.
            if options.bumper_stop:
                backend = wrappers.BumperStop(backend)
            if options.tm_s and self._needs_keep_alive(backend):
                interval_s = wrappers.POLL_S if options.bumper_stop else float("inf")
                backend = KeepAlive(backend, options.tm_s, feeds=bool(options.feed), at_least_every_s=interval_s)
            # 4. Speed limits, outermost: no other layer commands a speed.
            if options.max_turn_deg_s:
                backend = wrappers.SpeedLimiter(backend, max_turn_deg_s=options.max_turn_deg_s)
            if options.max_speed_in_s:
                backend = wrappers.SpeedLimiter(backend, max_speed_in_s=options.max_speed_in_s)
        except BaseException:
            backend.close()
            raise
        return backend

    def open_session(self) -> Backend:
        """Open a new stream and start the protocol on it; without recovery, keep-alive and limits.

        For commands that only read or stop a robot, and for every reconnect.
        """
        transport = self.open_transport()
        stream = self._instrumented(transport)
        if self.wire != TCP and isinstance(transport, MemoryStream) and self.address.scheme not in SCHEMES:
            # A simulated robot on its serial line: the simulation itself answers what no robot can.
            simulation = self._start_tcp(transport.beside())
            return wrappers.SimulationBackendMux(self.start_session(stream, hello=False), simulation)
        return self.start_session(stream)

    def open_stream(self) -> ByteStream:
        """Open the transport with recorder and faults, without starting the protocol."""
        return self._instrumented(self.open_transport())

    def open_transport(self) -> ByteStream:
        """Open the transport alone."""
        address = self.address
        connect_timeout_s = max(self.timeout_s or 0.0, streams.CONNECT_TIMEOUT_S)
        match address.scheme:
            # Over sockets and serial ports.
            case "nserver":
                return streams.TcpStream(address.host, address.port, connect_timeout_s)
            case "robotd":
                return streams.TcpStream(address.host, address.port, connect_timeout_s, served_by=streams.ROBOT_LINE)
            case "serial" | "serial+rfc2217" | "serial+socket":
                return serial.open_port(address.path, address.options.baud or serial.DEFAULT_BAUD)
            # In this process.
            case "replay":
                return self._open_replay()
            case scheme:
                return open_in_process(scheme, address.stripped_text)

    def start_session(self, stream: ByteStream, *, hello: bool = True) -> Backend:
        """Start the protocol on a stream.

        Parameters
        ----------
        stream
            From `open_stream`.
        hello
            False if an exchange took place already, so that the robot's hello bytes are no longer expected.
        """
        # The scheme does not decide the protocol: a recording or a simulation may have either.
        if self.wire == TCP:
            return self._start_tcp(stream)
        checks = self.address.options.checks
        return DirectBackend(stream, self.model, hello=hello and self.wire == HANDSHAKE_FIRST and self.model.sends_mask,
                             timeout_s=self.timeout_s, checks=True if checks is None else checks, link=self.link)

    def _start_tcp(self, stream: ByteStream) -> NserverBackend:
        return NserverBackend(
            stream,
            robot_id=self._replayed.robot_id if self._replayed else self.robot_id,
            model=self.model,
            timeout_s=self.timeout_s,
            create=self._create and not self._replayed,
            # Over TCP there is little to count except losses, so that counting is left out without reconnect=.
            link=self.link if self.address.options.reconnect else None,
        )

    def _instrumented(self, stream: ByteStream) -> ByteStream:
        """Wrap a transport in the recorder, and that in the faults."""
        try:
            # The recorder is the inner one: it writes down what really crosses the line.
            if self.address.options.record:
                if self._recorder is None:
                    self._recorder = self._open_recorder(Path(self.address.options.record))
                stream = self._recorder.wrap(stream)
            # Faults come outside of it: they are what the program sees.
            if injector := self._current_injector():
                greets = self.wire == HANDSHAKE_FIRST and self.model.sends_mask
                language = TcpLanguage(wide=False) if self.wire == TCP else LineLanguage(greets)
                stream = FaultyStream(stream, FaultyLine(language, injector), time.monotonic, time.sleep)
        except BaseException:
            stream.close()
            raise
        return stream

    def _open_recorder(self, path: Path) -> ClientRecording:
        target = (self.address.stripped_text, self.wire, self.model)
        if self.address.in_process:
            # Simulated time: entries carry the robot's clock, so that the same run gives the same file.
            return ClientRecording(path, *target)
        start_s = time.monotonic()
        return ClientRecording(path, *target, lambda: time.monotonic() - start_s, datetime.now(UTC))

    def _current_injector(self) -> Callable[[], Injector] | None:
        plan = self.address.options.faults
        if plan is None:
            return self._injector
        if self.plan_injector is None:
            # A fault plan has one kind of line for all serial ports.
            kind = self.address.scheme.partition("+")[0]
            require_rules_for(kind, plan)
            self.plan_injector = Injector(plan, kind, time.monotonic())
        injector = self.plan_injector
        return lambda: injector

    def _open_replay(self) -> MemoryStream:
        """Open the connection that the address names, else the first, and the next one at each reopening."""
        if self._recording is None and self._drive is None:
            self._read_replayed(Path(self.address.path))
        if self._drive is not None:
            self._replayed = RecordedConnection(self.address.path, TCP, self._drive.model)
            return MemoryStream(DrivePeer(self.address.path, self._drive))
        assert self._recording is not None
        # Reopening past the last recorded connection repeats that one.
        names = self._recording.connections()
        name = self.address.options.connection or (names[min(self._replays, len(names) - 1)] if names else "")
        self._replayed = load_exchanges(self._recording, name)
        self._replays += 1
        return MemoryStream(ReplayPeer(Player(self._replayed, self.address.options.order or STRICT)))

    def _read_replayed(self, path: Path) -> None:
        """Read a recording, or a file of another program as a drive."""
        from nclient.recording import convert  # here: formats of others are seldom read

        if convert.is_recording(path):
            self._recording = read_recording(path)
            return
        drive = convert.read_drive(path)
        if drive.traffic:
            self._recording = parse_recording("\n".join(drive.traffic) + "\n", str(path))
        else:
            self._drive = drive

    def _needs_keep_alive(self, backend: Backend) -> bool:
        """Return False for a simulation too fast for a keep-alive, unless the address has `tm_s=`."""
        # State[0] is ten times the speed of the server's time; serial lines do not report it.
        speed = backend.greeting.slots.get(0, 0) if backend.greeting else 0
        return speed <= MAX_KEEP_ALIVE_SPEED or "tm_s" in self.address.given


def _agreed_robot_id(address: Address, options: ConnectOptions) -> int:
    """Return the robot's number. If address and caller disagree neither wins, or the wrong robot could move."""
    if options.robot_id is not None and address.robot_id not in (None, options.robot_id):
        raise AddressError(f"{address.text!r} names robot {address.robot_id}, the program asks for robot "
                           f"{options.robot_id}: let both say the same, or leave the number out of the address")
    if options.robot_id is not None:
        return options.robot_id
    return DEFAULT_ROBOT_ID if address.robot_id is None else address.robot_id


# -- for programs -----------------------------------------------------------------------------------------------------


def connect(address: str | None = None, *, timeout_s: float | None = None) -> Robot:
    """Connect to a robot.

    Where time runs by itself, the robot's motion timeout is set and refreshed, so that the robot stops when the
    program dies (`tm_s=` and `feed=` in the address).

    Parameters
    ----------
    address
        See docs/addresses.md; default: the environment variable NOMAD_ROBOT, else robot 1 of a local Nserver.
    timeout_s
        Maximum time for a reply in seconds, default 5 over TCP and 1 on a serial line; `timeout_s=` in the address
        takes precedence.

    Raises
    ------
    AddressError
        If the address is not valid; nothing was opened.
    ConnectionLost, ReplyTimeout
        If nothing answers there.
    RobotRefused
        If the server has no robot of that number.
    WorldFileError, StartError
        If the world or the start pose of a `sim:` address is not usable.
    """
    connector = Connector(parse_address(address_or_default(address)), ConnectOptions(timeout_s))
    return Robot(connector.open(), lockstep=connector.address.in_process)


def connect_async(address: str | None = None, *, timeout_s: float | None = None) -> Connecting:
    """Connect to a robot under asyncio: `async with connect_async(address) as robot:`, or await the result.

    Parameters and errors are those of `connect`.
    """
    return Connecting(lambda: connect(address, timeout_s=timeout_s))


class Connecting:
    """Represent a connection to be opened; awaitable, and an asynchronous context manager."""

    def __init__(self, open_robot: Callable[[], Robot]) -> None:
        self._open_robot = open_robot
        self._robot: AsyncRobot | None = None

    def __await__(self) -> Generator[Any, None, AsyncRobot]:
        return AsyncRobot.open(self._open_robot).__await__()

    async def __aenter__(self) -> AsyncRobot:
        self._robot = await self
        return await self._robot.__aenter__()

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None,
                        trace: TracebackType | None) -> None:
        assert self._robot is not None
        await self._robot.__aexit__(kind, error, trace)


def open_backend(address: str | None, options: ConnectOptions = ConnectOptions()) -> Backend:
    """Open a connection without `Robot` around it. Raises as `connect` does."""
    return Connector(parse_address(address_or_default(address)), options).open()


def address_or_default(address: str | None) -> str:
    """Return the address, else that of NOMAD_ROBOT, else that of a local Nserver's first robot.

    A NOMAD_ROBOT that names another robot than the address is reported once: it has no effect.
    """
    ignored = os.environ.get(VARIABLE)
    if address and ignored and address != ignored:
        _report_ignored_variable(address, ignored)
    return address or os.environ.get(VARIABLE) or DEFAULT_ADDRESS


@functools.cache
def _report_ignored_variable(used: str, ignored: str) -> None:
    log.warning("%s=%s is ignored: the program names %s", VARIABLE, ignored, used)


# -- for C programs: nclient.capi -------------------------------------------------------------------------------------


def open_machine(name: str, port: int, options: ConnectOptions = ConnectOptions()) -> Backend:
    """Open the connection to a server as programs that use Nclient.h name it.

    Parameters
    ----------
    name
        A host; `host:port`, which takes precedence over `port`; or an address. "" is the address of NOMAD_ROBOT,
        else this machine.
    port
        TCP port of the server.

    Raises
    ------
    AddressError, ConnectionLost, ReplyTimeout, RobotRefused
        As `connect` does.
    """
    # A C program names a host alone, which may be that of the variable.
    ignored = os.environ.get(VARIABLE)
    if name and ignored and name not in ignored:
        _report_ignored_variable(name, ignored)
    address = _address_of(name)
    if address is None:
        stream = _open_tcp(name, port, options.timeout_s)
        robot_id = DEFAULT_ROBOT_ID if options.robot_id is None else options.robot_id
        return NserverBackend(stream, robot_id=robot_id, timeout_s=options.timeout_s, create=options.create)
    try:
        return open_backend(address, options)
    except AddressError as error:
        raise error if name else AddressError(f"{VARIABLE}: {error}") from None


def open_line(model_number: int, device: str, conn: int, options: ConnectOptions = ConnectOptions()) -> Backend:
    """Open a robot's serial line as programs of the direct C library name it.

    As in that library the motion timeout is not set, nothing is repeated, and only checksums are verified.

    Parameters
    ----------
    model_number
        MODEL_N200, MODEL_N150 or MODEL_SCOUT.
    device
        Path of a serial port, or a host.
    conn
        Baud rate of the port, or TCP port of the host.

    Raises
    ------
    AddressError
        If there is no such model.
    ConnectionLost, ReplyTimeout
        If nothing answers there.
    """
    models = {model.number: model.name for model in MODELS.values()}
    if model_number not in models:
        raise AddressError(f"a model's number is one of {', '.join(map(str, sorted(models)))}, not {model_number}")
    place = f"serial://{device}?baud={conn}&" if device.startswith("/") else f"robotd://{device}:{conn}?"
    as_c_library = "&tm_s=0&retries=0&reconnect=0&checks=0&bumper_stop=0"
    return open_backend(f"{place}model={models[model_number]}{as_c_library}", options)


def is_listening(name: str, port: int) -> bool:
    """Return True if a transport to `name` can be opened, with names as `open_machine` takes them."""
    try:
        address = _address_of(name)
        if address is None:
            stream: ByteStream = _open_tcp(name, port, None)
        else:
            stream = Connector(parse_address(address)).open_transport()
    except (AddressError, ConnectionLost):
        return False
    stream.close()
    return True


def _open_tcp(name: str, port: int, timeout_s: float | None) -> streams.TcpStream:
    """Connect to a host, or where none is named to the first name of this machine that answers."""
    # "host:port", but not an IPv6 address without brackets.
    host, colon, digits = name.rpartition(":")
    if colon and digits.isdecimal() and (":" not in host or host.endswith("]")):
        name, port = host.strip("[]"), int(digits)
    connect_timeout_s = max(timeout_s or 0.0, streams.CONNECT_TIMEOUT_S)
    # The last failure is the one that is raised.
    *others, last = (name,) if name else streams.names_of_this_machine()
    for host in others:
        with contextlib.suppress(ConnectionLost):
            return streams.TcpStream(host, port, connect_timeout_s)
    return streams.TcpStream(last, port, connect_timeout_s)


def _address_of(name: str) -> str | None:
    """Return the address that a C program's machine name is; None for a host, or if nothing names one."""
    if not name:
        return os.environ.get(VARIABLE) or None
    # "lab:7654" is a host with its port, whatever schemes there are.
    has_port = name.partition(":")[2].isdecimal()
    return name if not has_port and split_address(name).scheme in available_schemes() else None
