"""A gateway in a running daemon: its robots' threads, the ticks of its clock, and the end of it.

Rules: the only room of the gateway that knows asyncio. Robots speak on threads of their own; what they answer is
looked at by the daemon, at once. At the end the robots are stopped before anything else.

The command line of the gateway: its options, what does not go together, and the way to the robot they name.

    nserver --real serial:///dev/ttyUSB0?model=n150 --max-speed 8 --shadow --shadow-report shadow.json

Rules: the address is any that `connect` takes. What wrappers of the address would do on their own the gateway does
itself: time-out, feeding and reconnecting are switched off there.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

from nclient.backends.base import Backend
from nclient.backends.wrappers import POLL_S, Capped
from nclient.opening import Wanted
from nclient.schemes import opening_of
from nserver_emu.gateway import shadow
from nserver_emu.gateway.gateway import TIMEOUT_S, Gateway, RealSide
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.link import NOTHING, FaultDesk

log = logging.getLogger(__name__)

TICK_S = 0.1


@contextlib.asynccontextmanager
async def kept(gateway: Gateway, daemon: Daemon, summary_s: float) -> AsyncIterator[None]:
    """Let robots answer while this is entered; `summary_s`: from one summary of a shadow in the log to the next."""
    loop = asyncio.get_running_loop()

    def look() -> None:
        gateway.tick()
        daemon.tick()

    def news() -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: a robot that answers after the end
            loop.call_soon_threadsafe(look)

    for side in gateway.sides.values():
        side.robot.news = news
        side.robot.start()
    ticking = asyncio.create_task(_tick(gateway, summary_s))
    try:
        yield
    finally:
        ticking.cancel()
        for side in gateway.sides.values():
            await asyncio.to_thread(side.robot.close, *side.last_words)
            side.catch_up()
        with contextlib.suppress(asyncio.CancelledError):
            await ticking


async def _tick(gateway: Gateway, summary_s: float) -> None:
    loop = asyncio.get_running_loop()
    due_s = loop.time() + summary_s
    while True:
        await asyncio.sleep(TICK_S)
        gateway.tick()
        if loop.time() >= due_s:
            due_s += summary_s
            summarise(gateway)


def summarise(gateway: Gateway) -> None:
    """One line a shadow."""
    for robot_id, side in gateway.sides.items():
        if side.follower is not None:
            log.warning("shadow of robot %d, real less simulated, %s", robot_id, side.follower.shadow.summary())


ROBOT_ID: Final = 1
"""The robot whose real side --real names."""
LINE: Final = f"real:{ROBOT_ID}"
"""What a plan of faults calls the line to it."""
SUMMARY_S: Final = 60.0
_OWN: Final = ("tm_s", "feed", "reconnect")
_NEED_REAL: Final = ("real_read_only", "max_speed", "max_turn", "shadow")


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of a gateway, in a group of their own."""
    group = parser.add_argument_group("a real robot behind the server")
    group.add_argument("--real", metavar="ADDRESS",
                       help="drive this robot as robot 1: any address, such as serial:///dev/ttyUSB0?model=n150; "
                       "clients switch with real_robot and simulated_robot, real to begin with")
    group.add_argument("--real-read-only", action="store_true",
                       help="refuse (ERROR 5) all that would move or change the real robot; st works")
    group.add_argument("--max-speed", type=_speed, metavar="IN_S", help="no faster than that, in inches a second")
    group.add_argument("--max-turn", type=_speed, metavar="DEG_S",
                       help="steering and turret no faster than that, in degrees a second")
    group.add_argument("--shadow", action="store_true",
                       help="let the simulation do what the real robot does, and log how far they differ")
    group.add_argument("--shadow-report", type=Path, metavar="FILE",
                       help="write the differences to FILE at the end: CSV where it ends in .csv, else JSON")
    group.add_argument("--shadow-every", type=_speed, default=SUMMARY_S, metavar="S",
                       help=f"seconds from one logged summary to the next (default {SUMMARY_S:g})")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Wrong usage: what makes no sense without a real robot, or with one."""
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
def reached(options: argparse.Namespace, faults: FaultDesk | None = None) -> Iterator[dict[int, RealSide]]:
    """The real sides by number: the robot of --real, if there is one; in the end stopped, let go, and reported on.

    `faults`: what may act on the line to it, where its address names no plan of its own.
    Raises what `connect` raises, and RecordingError where the report cannot be written.
    """
    if options.real is None:
        yield {}
        return
    side = _side(options, faults)
    try:
        yield {ROBOT_ID: side}
    finally:
        side.close()
    if side.follower is not None and options.shadow_report is not None:
        shadow.write(side.follower.shadow, options.real, options.shadow_report)


def model_of(sides: Mapping[int, RealSide]) -> str | None:
    """The model of the real robot; None where there is none."""
    return sides[ROBOT_ID].robot.link.model.name if sides else None


def around(options: argparse.Namespace) -> Callable[[Backend], Backend]:
    """The speed caps, to be put around the robot and around its shadow."""
    if options.max_speed is None and options.max_turn is None:
        return lambda backend: backend
    speed, turn = options.max_speed or math.inf, options.max_turn or math.inf
    return lambda backend: Capped(backend, max_speed_in_s=speed, max_turn_deg_s=turn)


def places(options: argparse.Namespace) -> dict[str, str]:
    """Where the real robot is reached, by the name of its line."""
    return {} if options.real is None else {LINE: options.real}


def _side(options: argparse.Namespace, faults: FaultDesk | None) -> RealSide:
    """The way to the robot is the same one each time; caps in its address count as well, the lower of two.

    Faults are those of the address, or where it names none those that the daemon has for this line.
    """
    opening = opening_of(options.real, Wanted())
    opening.values = {**opening.values, **dict.fromkeys(_OWN)}
    if faults is not None and "faults" not in opening.values:
        opening.values = {**opening.values, "faults": NOTHING}
        opening.kept["faults"] = lambda: faults.injector(LINE)
    capped = around(options)
    feed_s = POLL_S if opening.values.get("bumper_stop") else TIMEOUT_S / 3
    return RealSide(
        lambda: capped(opening.backend()), time.monotonic, read_only=options.real_read_only, feed_s=feed_s
    )


def _speed(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"a number above 0, not {text!r}")
    return value
