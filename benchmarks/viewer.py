"""Cost of twenty viewers at twenty pictures per second, as a fraction of the processor time of the simulation.

    python benchmarks/viewer.py [--rounds N] [--seconds S] [--viewers N] [--json]

Target: less than 5 %. The daemon runs at maximum speed, so that it spends all its time on the simulation, with a robot
that drives in a circle and fires its sonars. The viewers are a separate process (onlookers.py) that acknowledges
pictures as the page does. All processor time of the daemon is counted, including system calls. Rounds without viewers
give the time per step and the time of the event loop per step; the excess with viewers is attributed to them:

    page      outside of steps: taking and sending pictures, messages of pages, sockets
    steps     longer steps, because of evicted caches; mostly noise of the machine, so the median of many rounds counts

`share`, the sum, is the loss of speed: simulated seconds per processor second with viewers relative to those without.
Pictures follow wall time: on a loaded machine, where the daemon gets a part of a core, the same work is a larger
fraction; that part and the fraction of a whole core are printed, too.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from pathlib import Path
from typing import NamedTuple

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.transports.listener import LOOPBACK
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.daemon import Daemon, rare_collection
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.server import ViewerServer, serve_viewer
from worlds.world import StartPose

TARGET_SHARE, PICTURES_A_SECOND = 0.05, 20.0
SETTLE_S = 0.2
START = StartPose(45.0, 30.0)
ROUND_AND_ROUND = (80, 400, 0)
"""8 in/s, 40 degrees/s."""


class Taken(NamedTuple):
    """Processor time of the daemon and of its steps, number of steps, and wall time."""

    whole_s: float
    stepping_s: float
    steps: int
    wall_s: float

    def since(self, began: Taken) -> Taken:
        """Return the differences to an earlier measurement."""
        whole_s, stepping_s, steps, wall_s = began
        return Taken(self.whole_s - whole_s, self.stepping_s - stepping_s, self.steps - steps, self.wall_s - wall_s)


class Metered(Daemon):
    """A daemon that measures the time of its steps."""

    stepping_s = 0.0

    def step(self, dt_s: float) -> None:
        """Let simulated time pass."""
        # Thread time: waiting and other processes do not count.
        began_s = time.thread_time()
        super().step(dt_s)
        self.stepping_s += time.thread_time() - began_s

    def taken(self) -> Taken:
        """Return the totals so far."""
        return Taken(time.process_time(), self.stepping_s, self.steps, time.monotonic())

    async def over(self, seconds: float) -> Taken:
        """Measure for this many real seconds, after a short pause."""
        await asyncio.sleep(SETTLE_S)
        began = self.taken()
        await asyncio.sleep(seconds)
        return self.taken().since(began)


class Share(NamedTuple):
    """Fractions of the processor time that viewers take."""

    page: float
    steps: float


def share(alone: Taken, watched: Taken) -> Share:
    """Return the fraction of the time with viewers that exceeds that of as many steps without."""
    # Times per step without viewers: of the step itself, and of the rest of the loop.
    step_s, around_s = alone.stepping_s / alone.steps, (alone.whole_s - alone.stepping_s) / alone.steps
    page_s = watched.whole_s - watched.stepping_s - around_s * watched.steps
    return Share(page_s / watched.whole_s, (watched.stepping_s - step_s * watched.steps) / watched.whole_s)


@contextlib.asynccontextmanager
async def running() -> AsyncIterator[tuple[Metered, str]]:
    """Run a daemon at maximum speed with a driving robot; yield it with the address of its page."""
    daemon = Metered(Emulator(SimulationConfig(start=START).simulation()), speed=None)
    port = await daemon.listen(LOOPBACK, 0)
    stop = asyncio.Event()
    async with serve_viewer(ViewerServer(daemon), LOOPBACK, 0) as lines:
        serving = asyncio.create_task(daemon.serve(stop))
        _, writer = await asyncio.open_connection(LOOPBACK, port)
        for call in (Call("connect_robot", (1, os.getpid())), Call("vm", ROUND_AND_ROUND)):
            writer.write(codec.encode_tcp_request(call))
        with rare_collection():
            yield daemon, lines[0].split()[-1]
        # A robot that stands would make the steps cheap, and the viewers' fraction large.
        if daemon.emulator.simulation.robots[1].is_still((0,)):
            raise RuntimeError("the robot did not move: nothing was measured")
        writer.close()
        stop.set()
        await serving


@contextlib.asynccontextmanager
async def onlookers(page: str, count: int) -> AsyncIterator[Process]:
    """Run viewers of a page in a process, controlled by `command_viewers`."""
    program = str(Path(__file__).with_name("onlookers.py"))
    process = await asyncio.create_subprocess_exec(sys.executable, program, page, str(count), stdin=PIPE, stdout=PIPE)
    try:
        yield process
    finally:
        assert process.stdin is not None
        process.stdin.close()
        await process.wait()


async def command_viewers(process: Process, word: str) -> str:
    """Send a command (look, leave) and return the reply; raise RuntimeError if the process ended."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{word}\n".encode())
    answer = (await process.stdout.readline()).decode().strip()
    if not answer:
        raise RuntimeError(f"the viewers ended at {word!r}")
    return answer


async def measure(rounds: int, seconds: float, count: int) -> dict[str, float]:
    """Measure the cost of the viewers: the median of rounds in which they connect and disconnect."""
    shares: list[Share] = []
    alones, watcheds, rates = [], [], []
    async with running() as (daemon, page), onlookers(page, count) as process:
        # The first interval is not counted: it fills caches.
        await daemon.over(seconds)
        for _ in range(rounds):
            alone = await daemon.over(seconds)
            await command_viewers(process, "look")
            watched = await daemon.over(seconds)
            rates.append(float(await command_viewers(process, "leave")))
            shares.append(share(alone, watched))
            alones.append(alone)
            watcheds.append(watched)
    sums = [sum(one) for one in shares]
    quarters = statistics.quantiles(sums, n=4) if rounds > 1 else [sums[0]] * 3
    return {
        "share": statistics.median(sums), "share_quarter": quarters[0], "share_three_quarters": quarters[2],
        "share_page": statistics.median(one.page for one in shares),
        "share_steps": statistics.median(one.steps for one in shares), "share_target": TARGET_SHARE,
        "alone_steps_a_processor_s": statistics.median(one.steps / one.whole_s for one in alones),
        "watched_steps_a_processor_s": statistics.median(one.steps / one.whole_s for one in watcheds),
        "share_of_a_core": statistics.median(
            sum(one) * watched.whole_s / watched.wall_s for one, watched in zip(shares, watcheds, strict=True)
        ),
        "daemons_core": statistics.median(one.whole_s / one.wall_s for one in watcheds),
        "viewers": count, "rounds": rounds, "pictures_a_second": statistics.median(rates),
    }  # fmt: skip


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = asyncio.run(measure(options.rounds, options.seconds, options.viewers))
    if options.json:
        print(json.dumps(found))
        return
    print(f"{found['viewers']:.0f} viewers at {found['pictures_a_second']:.1f} pictures a second take "
          f"{100 * found['share']:.1f} % of the simulation's processor time (target {100 * TARGET_SHARE:.0f} %), half "
          f"of the {found['rounds']:.0f} rounds {100 * found['share_quarter']:.1f} to "
          f"{100 * found['share_three_quarters']:.1f} %: the page {100 * found['share_page']:.1f} %, slower steps "
          f"{100 * found['share_steps']:.1f} %; {found['alone_steps_a_processor_s']:.0f} steps a processor second "
          f"without, {found['watched_steps_a_processor_s']:.0f} with them. The daemon had "
          f"{100 * found['daemons_core']:.0f} % of a core, of which that is {100 * found['share_of_a_core']:.1f} %")


if __name__ == "__main__":
    main()
