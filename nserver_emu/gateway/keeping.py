"""A gateway in a running daemon: its robots' threads, the ticks of its clock, and the end of it.

Rules: the only room of the gateway that knows asyncio. Robots speak on threads of their own; what they answer is
looked at by the daemon, at once. At the end the robots are stopped before anything else.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator

from nserver_emu.gateway.gateway import Gateway
from nserver_emu.server.ports.daemon import Daemon

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

