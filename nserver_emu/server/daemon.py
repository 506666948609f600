"""The server process: listening sockets, connections, and the loop that advances simulated time with real time.

Used by `nserver` (nserver_emu/cli.py), which opens its ports, control socket, viewer and files around it. Connections
are in connection.py, robots' own lines in serial_lines.py.
"""

import asyncio
import contextlib
import errno
import gc
import logging
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

from nclient.errors import ConnectionLost
from nclient.recording.format import RecordingWriter
from nclient.recording.recorder import NULL_RECORDER, Recorder, TrafficRecorder
from nclient.transports.listener import LOOPBACK, LOOPBACK_NAME
from nserver_emu.server import admission
from nserver_emu.server.admission import RESERVED_S, AcceptErrorHandler, AdmissionControl, ConnectionReserve
from nserver_emu.server.connection import ConnectionHandler, FairScheduler, TcpConnection
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import FaultController
from nserver_emu.server.session import ClientRegistry, CommandHandler

log = logging.getLogger(__name__)

# Real time between two steps of the simulation.
TICK_S = 0.01
# Maximum real time caught up after the machine was busy or suspended; the simulation skips the rest.
MAX_CATCH_UP_S = 0.25
# Simulated time of one step at unlimited speed.
FAST_STEP_S = 0.1
# Steps in lockstep for a waiting client before other clients get a turn.
MAX_LOCKSTEPS_PER_TURN = 100
LOOPBACK_NAMES = (LOOPBACK, LOOPBACK_NAME)
# The address of a machine's own host name on Debian; old clients connect to it by default.
HOST_NAME_LOOPBACK = "127.0.1.1"


class Daemon:
    """An Nserver on sockets.

    Parameters
    ----------
    emulator
        The simulation behind the protocol.
    speed
        Simulated seconds per real second at the start, None for unlimited; later `emulator.clock` decides.
    handler
        Executes calls instead of the emulator: the gateway to real robots.
    faults
        Fault plans in force; None for a new controller without a plan.
    """

    def __init__(self, emulator: Emulator, speed: float | None = 1.0, handler: CommandHandler | None = None,
                 faults: FaultController | None = None) -> None:
        self.emulator = emulator
        self.handler: CommandHandler = emulator if handler is None else handler
        # Records requests, replies, time steps and changes in their order.
        self.recorder: TrafficRecorder = NULL_RECORDER
        self.connections: set[ConnectionHandler] = set()
        self.admission = AdmissionControl()
        self.scheduler = FairScheduler()
        self.client_registry = ClientRegistry()
        self.faults = FaultController(time.monotonic) if faults is None else faults
        # Address of each line by its name.
        self.places: dict[str, str] = {}
        # Statistics: real time not caught up, loop time of the last tick, steps, totals of closed connections.
        self.lost_s = 0.0
        self.ticked_s = 0.0
        self.steps = 0
        self.closed_answered = self.closed_refused = 0
        self.closed_cpu_s = 0.0
        self._servers: list[asyncio.Server] = []
        emulator.clock.factor = speed

    # Listening.

    async def listen(self, host: str, port: int) -> int:
        """Listen for clients and return the port; port 0 takes a free one. Raise ConnectionLost with a remedy."""
        port = await self.open_listener(lambda: TcpConnection(self), host, port, "--port")
        if host in LOOPBACK_NAMES:
            # Optional: not every machine has this address.
            with contextlib.suppress(ConnectionLost):
                await self.open_listener(lambda: TcpConnection(self), HOST_NAME_LOOPBACK, port, "--port")
        self.emulator.port = port
        self.places[TcpConnection.line] = admission.at_port(host, port)
        return port

    async def open_listener(self, new_connection: Callable[[], TcpConnection], host: str, port: int,
                            option: str) -> int:
        """Listen for connections of a kind and return the port.

        Raises
        ------
        ConnectionLost
            If the port is taken; the message names `option`, with which the user chose it.
        """
        try:
            admitted = partial(admission.AdmissionProtocol, self.admission, self._client_hosts, new_connection,
                               self._make_room)
            server = await admission.listen(admitted, host, port)
        except OSError as error:
            remedy = f"is another nserver running? {option} 0 takes a free port"
            if error.errno != errno.EADDRINUSE:
                remedy = "--bind needs an address of this machine, and ports below 1024 are reserved for root"
            raise ConnectionLost(f"cannot listen on {host}:{port}: {error.strerror or error}; {remedy}") from error
        self._servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    def _client_hosts(self) -> list[str]:
        """Return the addresses of all TCP clients."""
        return [connection.host for connection in self._tcp_connections()]

    def _make_room(self, host: str) -> bool:
        """Return True if a new connection is accepted though a limit is reached."""
        loop = asyncio.get_running_loop()
        is_accepted = self._reserve.make_room(host, self._tcp_connections(), loop.time())
        if is_accepted:
            # A place of the reserve is only for a short time.
            loop.call_later(RESERVED_S, lambda: self._reserve.check(self._tcp_connections(), loop.time()))
        return is_accepted

    @property
    def _reserve(self) -> ConnectionReserve:
        return ConnectionReserve(self.admission, self._may_close)

    def _tcp_connections(self) -> list[TcpConnection]:
        return [connection for connection in self.connections if isinstance(connection, TcpConnection)]

    def _may_close(self, connection: admission.ReservableConnection) -> bool:
        """Return True if closing a connection for another one stops no robot."""
        assert isinstance(connection, TcpConnection)
        context = connection.session.context
        if self.handler is not self.emulator and context.robot_id is not None:
            # A real robot: its motion is not known for certain.
            return False
        return not self.emulator.axis_ownership.has_motion(context, self.emulator.simulation.robots)

    def lines(self) -> Mapping[str, str]:
        """Return the address of each line by its name."""
        return self.places

    def connected_clients(self) -> list[dict[str, Any]]:
        """Return number, name, robot, refused requests, processor time and whether a reply is deferred, for each."""
        return [
            {"name": session.name, "robot": session.context.robot_id, "waiting": session.waiting,
             "refused": session.refused, "number": connection.number, "cpu_s": round(connection.cpu_s, 6)}
            for connection in self.connections if connection.is_connected
            for session in (connection.session,)
        ]  # fmt: skip

    # Changes by the operator (control socket, viewer), which a recording must contain.

    def record(self, path: Path, header: Mapping[str, Any]) -> None:
        """Start recording to a file. Raise RecordingError if it cannot be created."""
        clock = asyncio.get_running_loop().time
        log_writer = RecordingWriter(path, header, self.admission.limits.log)
        self.recorder = Recorder(log_writer, lambda: self.emulator.simulation.time_s, clock)

    def record_clock(self) -> None:
        """Record that the operator changed speed or pause."""
        self.recorder.record_pace(self.emulator.clock.factor, self.emulator.clock.paused)

    def record_change(self, change: Mapping[str, Any]) -> None:
        """Record a change of the simulation by the operator (runtime_settings.py, estop.py)."""
        self.recorder.record_change(change)

    def hold(self, robot_ids: Iterable[int], by: str) -> None:
        """Stop these robots and ignore motion commands until `release` (estop.py)."""
        robot_ids = list(robot_ids)
        for robot_id in robot_ids:
            self.handler.hold(robot_id, by)
        log.warning("emergency stop by %s: %s; release in the viewer or with nserver ctl release",
                    by, _names(robot_ids))
        self.record_change({"hold": {"robots": robot_ids, "by": by, "informs": True}})

    def release(self, robot_ids: Iterable[int]) -> None:
        """End the emergency stop of these robots."""
        robot_ids = list(robot_ids)
        for robot_id in robot_ids:
            self.emulator.release(robot_id)
        log.warning("released: %s", _names(robot_ids))
        self.record_change({"release": robot_ids})

    # Running.

    async def serve(self, stop: asyncio.Event, before_close: Callable[[], None] = lambda: None) -> None:
        """Advance time until `stop` is set or a permitted client ends the server; then close everything.

        `before_close` runs before any connection is closed and any robot is stopped because of that.
        """
        loop = asyncio.get_running_loop()
        accept_errors = AcceptErrorHandler(loop.get_exception_handler())
        loop.set_exception_handler(accept_errors)
        clock = asyncio.create_task(self._run_clock())
        stopped = asyncio.create_task(stop.wait())
        try:
            await asyncio.wait({clock, stopped}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            stopped.cancel()
            clock.cancel()
            try:
                before_close()
            finally:
                await self.close()
                loop.set_exception_handler(accept_errors.previous)
                accept_errors.close()
        if clock.done() and not clock.cancelled():
            clock.result()

    async def close(self) -> None:
        """Close listeners, connections and the recording; idempotent."""
        for server in self._servers:
            server.close()
        for connection in tuple(self.connections):
            connection.close()
        await asyncio.sleep(0)
        self.recorder.close()

    def step(self, dt_s: float) -> None:
        """Advance simulated time by `dt_s`."""
        self.steps += 1
        self.recorder.record_step(dt_s)
        self.emulator.pass_time(dt_s)

    def tick(self) -> None:
        """Send deferred replies that are complete."""
        for connection in tuple(self.connections):
            connection.tick()

    async def _run_clock(self) -> None:
        loop = asyncio.get_running_loop()
        last, collector = loop.time(), GarbageCollector(loop.time)
        while not self.emulator.quitting:
            clock = self.emulator.clock
            await asyncio.sleep(0 if clock.is_free_running and clock.factor is None else TICK_S)
            now = self.ticked_s = loop.time()
            elapsed, last = now - last, now
            self._advance(elapsed)
            collector.run()

    def _advance(self, elapsed_s: float) -> None:
        """Advance simulated time for `elapsed_s` of real time, as the clock's mode says."""
        clock = self.emulator.clock
        if clock.is_free_running and clock.factor is None:
            self.step(FAST_STEP_S)
        elif clock.is_free_running and clock.factor is not None:
            if elapsed_s > MAX_CATCH_UP_S:
                self.lost_s += elapsed_s - MAX_CATCH_UP_S
                log.info("%.2f s of real time lost: the machine was busy or asleep", elapsed_s - MAX_CATCH_UP_S)
            self.step(min(elapsed_s, MAX_CATCH_UP_S) * clock.factor)
        elif clock.step_per_request_s:
            self._step_for_waiting_clients(clock.step_per_request_s)
        self.tick()

    def _step_for_waiting_clients(self, step_s: float) -> None:
        """Advance time in lockstep while a client waits for a deferred reply (ws, zr)."""
        for _ in range(MAX_LOCKSTEPS_PER_TURN):
            if not any(connection.session.waiting for connection in self.connections):
                return
            self.step(step_s)
            self.tick()


def _names(robot_ids: Iterable[int]) -> str:
    return ", ".join(f"robot {robot_id}" for robot_id in robot_ids) or "no robot"


def _ending_signals() -> set[signal.Signals]:
    """Return the signals that end the daemon, where they exist; a SIGHUP ignored at start (nohup) stays ignored."""
    ending = {signal.SIGINT, signal.SIGTERM}
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        ending.add(signal.SIGHUP)
    return ending


def stop_on_signals(stop: asyncio.Event) -> None:
    """Set `stop` on SIGINT, SIGTERM and SIGHUP."""
    for number in _ending_signals():
        with contextlib.suppress(NotImplementedError):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)


@contextlib.contextmanager
def restored_signals() -> Iterator[None]:
    """Restore the handlers of these signals at the end, unless this is not the main thread."""
    handlers = {number: signal.getsignal(number) for number in _ending_signals()}
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):
            for number, handler in handlers.items():
                signal.signal(number, handler)


def ignore_signals() -> None:
    """Ignore these signals from now on: the daemon has ended, and a closing event loop reports them as errors."""
    loop, ending = asyncio.get_running_loop(), _ending_signals()
    with contextlib.suppress(NotImplementedError, AttributeError):
        # Blocked meanwhile: removing a handler restores the default, which ends the process.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ending)
        for number in ending:
            if loop.remove_signal_handler(number):
                signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# -- Python's garbage collection --------------------------------------------------------------------------------------
#
# A step of a thousand robots creates tens of thousands of objects, nearly all of which are freed by reference counting.
# With Python's default threshold of 700 new objects, collections cost a fifth of the time and cause pauses. But asyncio
# and aiohttp leave some thirty objects in reference cycles per connection, so a long-running daemon must collect.

GC_THRESHOLD: Final = 100_000
"""New objects after which Python collects within a step: some tens of megabytes."""
MIN_INTERVAL_S: Final = 10.0
"""Shortest interval between two collections between steps."""
MIN_INTERVAL_RATIO: Final = 100.0
"""Shortest interval as a multiple of the last collection's duration: some ms, over 100 ms with a thousand robots."""
MIN_OBJECTS: Final = 100
"""With fewer new objects no connection was closed, and a collection is not worth its time."""


@contextmanager
def rare_collection() -> Iterator[None]:
    """Exempt all present objects from garbage collection, and raise its threshold, within the block.

    Objects of a host program that has exempted them itself stay exempt after the block, and no others are.
    """
    threshold, is_frozen = gc.get_threshold(), gc.get_freeze_count() > 0
    if not is_frozen:
        gc.collect()
        gc.freeze()
    gc.set_threshold(GC_THRESHOLD)
    try:
        yield
    finally:
        gc.set_threshold(*threshold)
        if not is_frozen:
            gc.unfreeze()


class GarbageCollector:
    """Collects garbage between steps of the simulation; `clock` returns seconds, monotonic."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._due_s = clock() + MIN_INTERVAL_S

    def run(self) -> None:
        """Collect if the interval has passed and there are new objects; call it between two steps."""
        now_s = self._clock()
        if now_s < self._due_s or gc.get_count()[0] < MIN_OBJECTS:
            return
        gc.collect()
        done_s = self._clock()
        self._due_s = done_s + max(MIN_INTERVAL_S, MIN_INTERVAL_RATIO * (done_s - now_s))
