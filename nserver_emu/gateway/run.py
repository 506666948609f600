"""Command line and lifetime of the gateway: its options, the connection to the real robot, and its asyncio task.

    nserver --real serial:///dev/ttyUSB0?model=n150 --max-speed 8 --shadow --shadow-report shadow.json

The address is any that `connect` accepts. Time-out, keep-alive and reconnecting, which wrappers of the address would
provide, are switched off there, since the gateway handles them itself.
"""

import argparse
import asyncio
import contextlib
import logging
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from nclient.backends.base import Backend, Wrapper
from nclient.backends.wrappers import POLL_S, SpeedLimiter
from nclient.common.arguments import ABOVE_ZERO, add_flag, add_value, number
from nclient.errors import RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.gateway.gateway import TIMEOUT_S, Gateway, RealRobotProxy
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import MAX_STEP_MS, STEP
from nserver_emu.server.serial_session import FaultController

log = logging.getLogger(__name__)

TICK_S: Final = 0.1
"""Interval at which time-outs are checked; results of a robot are processed at once."""
ROBOT_ID: Final = 1
"""Number of the robot that --real drives."""
LINE: Final = f"real:{ROBOT_ID}"
"""Name of the line to it in a plan of faults."""
SUMMARY_S: Final = 60.0
_NEED_REAL: Final = ("real_read_only", "max_speed", "max_turn", "shadow")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the gateway's options, in a group of their own."""
    group = parser.add_argument_group("a real robot behind the server")
    group.add_argument("--real", metavar="ADDRESS",
                       help="drive this robot as robot 1: any address, such as serial:///dev/ttyUSB0?model=n150; "
                       "clients switch with real_robot and simulated_robot; default at the start: real")
    add_flag(group, "--real-read-only", "refuse (ERROR 5) all that would move or change the real robot; st works")
    speed = number("a number above 0", ABOVE_ZERO)
    add_value(group, "--max-speed", "IN_S", speed, "limit the speed of the real robot to IN_S inches a second")
    add_value(group, "--max-turn", "DEG_S", speed, "limit the speed of steering and turret to DEG_S degrees a second")
    add_flag(group, "--shadow", "let the simulation repeat what the real robot does, and log the differences")
    add_value(group, "--shadow-report", "FILE", Path,
              "write the differences to FILE at the end: CSV where it ends in .csv, else JSON")
    add_value(group, "--shadow-every", "S", speed,
              f"log a summary of the differences every S seconds (default: {SUMMARY_S:g})", SUMMARY_S)


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Report options that require a real robot, or that exclude one, as wrong usage."""
    # A report needs a shadow.
    options.shadow = options.shadow or options.shadow_report is not None
    for name in _NEED_REAL if options.real is None else ():
        if getattr(options, name):
            parser.error(f"--{name.replace('_', '-')} is about a real robot: name it with --real ADDRESS")
    if options.real is not None:
        if options.lockstep is not None:
            parser.error("a real robot does not wait for clients: --lockstep and --real do not go together")
        if options.record is not None:
            parser.error("what a real robot answers cannot be computed again: record its line instead, with "
                         "record=FILE in the address of --real")


@contextlib.contextmanager
def connected(options: argparse.Namespace,
              faults: FaultController | None = None) -> Iterator[dict[int, RealRobotProxy]]:
    """Connect to the robot of --real; at the end stop it, disconnect, and write the shadow's report.

    Parameters
    ----------
    options : the options of `nserver`.
    faults : faults for the line to the robot, where its address names no plan of its own.

    Yields
    ------
    dict of int to RealRobotProxy
        The real robots by number; empty without --real.

    Raises
    ------
    RecordingError
        If the report cannot be written. Other errors are those of `connect`.
    """
    if options.real is None:
        yield {}
        return
    # The report is written after the robot has stopped, and only if nothing failed before.
    proxy = _connect(options, faults)
    try:
        yield {ROBOT_ID: proxy}
    finally:
        proxy.close()
    if proxy.shadow is not None and options.shadow_report is not None:
        proxy.shadow.report.write(options.real, options.shadow_report)


@contextlib.asynccontextmanager
async def run_gateway(gateway: Gateway, daemon: Daemon, summary_s: float) -> AsyncIterator[None]:
    """Run the robots' worker threads and the gateway's timer; stop the robots at the end.

    `summary_s` is the interval between two summaries of a shadow in the log, in seconds.
    """
    loop = asyncio.get_running_loop()

    def process() -> None:
        gateway.tick()
        daemon.tick()

    def on_result() -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: the robot answered after the end
            loop.call_soon_threadsafe(process)

    for proxy in gateway.proxies.values():
        proxy.robot.on_result = on_result
        proxy.robot.start()
    timer = asyncio.create_task(_tick(gateway, summary_s))
    try:
        yield
    finally:
        timer.cancel()
        for proxy in gateway.proxies.values():
            # Stopping waits for the robot, so it must not block the event loop.
            await asyncio.to_thread(proxy.robot.close, *proxy.shutdown_calls)
            proxy.process_results()
        with contextlib.suppress(asyncio.CancelledError):
            await timer


async def _tick(gateway: Gateway, summary_s: float) -> None:
    loop = asyncio.get_running_loop()
    next_summary_s = loop.time() + summary_s
    while True:
        await asyncio.sleep(TICK_S)
        gateway.tick()
        if loop.time() >= next_summary_s:
            # Counted from the planned time, so that the interval is exact on average.
            next_summary_s += summary_s
            log_summaries(gateway)


def log_summaries(gateway: Gateway) -> None:
    """Log one line per shadow simulation."""
    for robot_id, proxy in gateway.proxies.items():
        if proxy.shadow is not None:
            log.warning("shadow of robot %d, real less simulated, %s", robot_id, proxy.shadow.report.summary())


def model_of(proxies: Mapping[int, RealRobotProxy]) -> str | None:
    """Return the model of the real robot; None where there is none."""
    return proxies[ROBOT_ID].robot.link.model.name if proxies else None


def speed_limiter(options: argparse.Namespace) -> Callable[[Backend], Backend]:
    """Return the wrapper for --max-speed and --max-turn, for the robot and for its shadow."""
    if options.max_speed is None and options.max_turn is None:
        return lambda backend: backend
    # A limit that is not given is infinite.
    speed, turn = options.max_speed or math.inf, options.max_turn or math.inf
    return lambda backend: SpeedLimiter(backend, max_speed_in_s=speed, max_turn_deg_s=turn)


class RealTimeSimulation(Wrapper):
    """A simulation in this process (`sim:`) whose time passes as a real robot's: by a clock, not by requests."""

    def __init__(self, inner: Backend, clock: Callable[[], float]) -> None:
        super().__init__(inner)
        self._clock, self._last_s = clock, clock()

    def execute(self, call: Call) -> Reply:
        """Let the time since the last command pass, then execute this one. Raises as the inner backend."""
        now_s = self._clock()
        step_ms = int(1000 * (now_s - self._last_s))
        self._last_s += step_ms / 1000
        # A recording has no such time.
        with contextlib.suppress(RobotRefused):
            self._inner.execute(Call("sim_control", (STEP, min(step_ms, MAX_STEP_MS))))
        return super().execute(call)


def _connect(options: argparse.Namespace, faults: FaultController | None) -> RealRobotProxy:
    """Connect to the robot of --real.

    Speed limits of its address apply as well, the lower of two. Faults are those of the address or, where it names
    none, those that the daemon has for this line.
    """
    from nclient.connector import Connector  # most daemons have no real robot and start faster without it
    from nclient.url import parse_address

    address = parse_address(options.real)
    # The gateway sets the motion timeout, keeps it alive and reconnects by itself.
    address = replace(address, options=replace(address.options, tm_s=None, feed=None, reconnect=None))
    injector = None if faults is None else lambda: faults.injector(LINE)
    connector = Connector(address, injector=injector)
    limit = speed_limiter(options)

    def open_robot() -> Backend:
        backend = limit(connector.open())
        return RealTimeSimulation(backend, time.monotonic) if address.in_process else backend

    # Often enough to see the bumpers, else three times within the motion timeout.
    feed_s = POLL_S if address.options.bumper_stop else TIMEOUT_S / 3
    return RealRobotProxy(open_robot, time.monotonic, read_only=options.real_read_only, feed_s=feed_s)
