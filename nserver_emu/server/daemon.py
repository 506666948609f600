"""The daemon: the clock around the simulation, and the doors that its clients come by.

    Daemon       listens, lets simulated time pass, stops cleanly
    Connection   one client's socket (connection.py); a robot's own line is in lines.py

Rules: no client can stop the daemon or stall another: a bounded number of requests a turn, reading stops while a
client does not read its replies or waits for one, and whatever goes wrong in a session costs that connection only.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import signal
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from nclient.errors import ConnectionLost
from nclient.recording.format import RecordingWriter
from nclient.recording.recorder import NULL_RECORDER, Recorder, TrafficRecorder
from nserver_emu.server.admission import AdmissionControl, AdmissionProtocol
from nserver_emu.server.client_registry import ClientRegistry
from nserver_emu.server.connection import Connection, ConnectionHandler
from nserver_emu.server.garbage_collection import GarbageCollector
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.link import FaultController
from nserver_emu.server.session import Host

log = logging.getLogger(__name__)

TICK_S = 0.01
"""Real time between two steps of the simulation."""
LONGEST_CATCH_UP_S = 0.25
"""Real time that is made up for when the machine was busy or asleep; the rest is lost to the simulation."""
FAST_STEP_S = 0.1
LOCKSTEPS_A_TURN = 100
"""Steps made at once for a client that waits in lockstep, before the others have their turn."""
LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = (LOOPBACK, "localhost")
HOST_NAME_LOOPBACK = "127.0.1.1"
"""Where Debian puts a machine's own host name, which old clients connect to when they are given no host."""


class Daemon:
    """An Nserver on sockets. `speed`: simulated seconds a real second, None for as fast as it can; from then on the
    emulator's pace says. `host`: who answers, where that is not the emulator itself. `recorder` is told all that
    decides what the simulation does, in its order."""

    def __init__(
        self,
        emulator: Emulator,
        speed: float | None = 1.0,
        host: Host | None = None,
        faults: FaultController | None = None,
    ) -> None:
        self.emulator = emulator
        self.host: Host = emulator if host is None else host
        self.recorder: TrafficRecorder = NULL_RECORDER
        self.connections: set[ConnectionHandler] = set()
        self.admission = AdmissionControl()
        self.lost_s = 0.0
        """Real time that was not made up for."""
        self.ticked_s = 0.0
        """When the clock went round last, as the loop has it."""
        self.steps = 0
        """How often time was made to pass."""
        self.gone_answered = self.gone_refused = 0
        """What those who are gone were answered, and refused."""
        self.client_registry = ClientRegistry()
        self.faults = FaultController(time.monotonic) if faults is None else faults
        self.places: dict[str, str] = {}
        """Where each line is reached, by its name."""
        self._servers: list[asyncio.Server] = []
        emulator.clock.factor = speed

    async def listen(self, host: str, port: int) -> int:
        """Open the door; the port it is on (port 0: a free one). Raises ConnectionLost, naming the remedy."""
        port = await self.open_listener(lambda: Connection(self), host, port, "--port")
        if host in LOOPBACK_NAMES:
            with contextlib.suppress(ConnectionLost):  # not every machine has it, and no client needs it but by name
                await self.open_listener(lambda: Connection(self), HOST_NAME_LOOPBACK, port, "--port")
        self.emulator.port = port
        self.places[Connection.line] = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        return port

    def lines(self) -> Mapping[str, str]:
        """Where each line is reached, by its name."""
        return self.places

    def connected_clients(self) -> list[dict[str, Any]]:
        """Who is connected: the name, the robot's number, whether it waits for an answer, how much it was refused."""
        return [
            {"name": session.name, "robot": session.context.robot_id, "waiting": session.waiting,
             "refused": session.refused}
            for session in (talker.session for talker in self.connections if talker.here)
        ]  # fmt: skip

    def paced(self) -> None:
        """The emulator's pace was changed by who may, not by a client."""
        self.recorder.record_pace(self.emulator.clock.factor, self.emulator.clock.paused)

    def hold(self, robot_ids: Iterable[int], by: str) -> None:
        """Stop these robots, and let nobody move them until they are released (holds.py)."""
        robot_ids = list(robot_ids)
        for robot_id in robot_ids:
            self.host.hold(robot_id, by)
        log.warning(
            "stopped and held by %s: %s, until somebody lets go, at the page or by nserver ctl release",
            by,
            _named(robot_ids),
        )
        self.changed({"hold": {"robots": robot_ids, "by": by}})

    def release(self, robot_ids: Iterable[int]) -> None:
        """They may be moved again."""
        robot_ids = list(robot_ids)
        for robot_id in robot_ids:
            self.emulator.estop.release(robot_id)
        log.warning("released: %s", _named(robot_ids))
        self.changed({"release": robot_ids})

    def changed(self, what: Mapping[str, Any]) -> None:
        """The simulation was changed by who may, not by a client (switches.py, holds.py)."""
        self.recorder.record_change(what)

    async def open_listener(self, who: Callable[[], Connection], host: str, port: int, option: str) -> int:
        """Listen for connections of a kind; the port. Raises ConnectionLost, naming the remedy: `option` 0."""
        try:
            loop = asyncio.get_running_loop()
            server = await loop.create_server(lambda: AdmissionProtocol(self.admission, self._hosts, who), host, port)
        except OSError as error:
            remedy = f"is another nserver running? {option} 0 takes a free port"
            if error.errno != errno.EADDRINUSE:
                remedy = "--bind wants an address of this machine, and ports below 1024 are the system's"
            raise ConnectionLost(f"cannot listen on {host}:{port}: {error.strerror or error}; {remedy}") from error
        self._servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    def _hosts(self) -> list[str]:
        """The addresses of those who came by a socket."""
        return [one.host for one in self.connections if isinstance(one, Connection)]

    def record(self, path: Path, header: Mapping[str, Any]) -> None:
        """From now on, write all that is said to a file. Raises RecordingError when it cannot be made."""
        clock = asyncio.get_running_loop().time
        log_writer = RecordingWriter(path, header, self.admission.limits.log)
        self.recorder = Recorder(log_writer, lambda: self.emulator.simulation.time_s, clock)

    async def serve(self, stop: asyncio.Event, before_close: Callable[[], None] = lambda: None) -> None:
        """Let time pass until told to stop, or until a client that may ends it; then close everything.

        `before_close` sees all as it was: no connection closed, no robot stopped for that.
        """
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
        if clock.done() and not clock.cancelled():
            clock.result()

    async def _run_clock(self) -> None:
        loop = asyncio.get_running_loop()
        last, collector = loop.time(), GarbageCollector(loop.time)
        while not self.emulator.quitting:
            pace = self.emulator.clock
            await asyncio.sleep(0 if pace.is_free_running and pace.factor is None else TICK_S)
            now = self.ticked_s = loop.time()
            elapsed, last = now - last, now
            self._pass_time(elapsed)
            collector.run()

    def _pass_time(self, elapsed_s: float) -> None:
        pace = self.emulator.clock
        if pace.is_free_running and pace.factor is None:
            self.step(FAST_STEP_S)
        elif pace.is_free_running and pace.factor is not None:
            if elapsed_s > LONGEST_CATCH_UP_S:
                self.lost_s += elapsed_s - LONGEST_CATCH_UP_S
                log.info("%.2f s of real time lost: the machine was busy or asleep", elapsed_s - LONGEST_CATCH_UP_S)
            self.step(min(elapsed_s, LONGEST_CATCH_UP_S) * pace.factor)
        elif pace.asked_s:
            self._step_for_the_waiting(pace.asked_s)
        self.tick()

    def _step_for_the_waiting(self, step_s: float) -> None:
        """In lockstep, who waits for ws or zr asks for time as long as the answer takes."""
        for _ in range(LOCKSTEPS_A_TURN):
            if not any(connection.session.waiting for connection in self.connections):
                return
            self.step(step_s)
            self.tick()

    def step(self, dt_s: float) -> None:
        """Let simulated time pass."""
        self.steps += 1
        self.recorder.record_step(dt_s)
        self.emulator.pass_time(dt_s)

    def tick(self) -> None:
        """Answers that were to come later may be there."""
        for connection in tuple(self.connections):
            connection.tick()

    async def close(self) -> None:
        """Close everything. Twice is fine."""
        for server in self._servers:
            server.close()
        for connection in tuple(self.connections):
            connection.close()
        await asyncio.sleep(0)
        self.recorder.close()


def _named(robot_ids: Iterable[int]) -> str:
    return ", ".join(f"robot {robot_id}" for robot_id in robot_ids) or "no robot"


def stop_on_signals(stop: asyncio.Event) -> None:
    """SIGINT, SIGTERM and SIGHUP (the terminal was closed) end the daemon cleanly, where the system has them; a SIGHUP
    that is ignored from the start, as under nohup, stays so."""
    loop = asyncio.get_running_loop()
    ending = {signal.SIGINT, signal.SIGTERM}
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        ending.add(signal.SIGHUP)
    for number in ending:
        with contextlib.suppress(NotImplementedError):
            loop.add_signal_handler(number, stop.set)
