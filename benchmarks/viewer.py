"""What twenty viewers at twenty pictures a second cost the simulation: its pace on one processor, with and without.

    python benchmarks/viewer.py [--rounds N] [--seconds S] [--viewers N] [--json]

Target: less than 5 %. The daemon runs as fast as it can with a robot that drives, so that all its time is the
simulation's; counted are simulated seconds for a second of the daemon's processor time (/proc, so Linux only),
rounds with viewers and without taking turns. The viewers are a process of their own and acknowledge as the page does.
Pictures go by the clock on the wall: where others load the machine and the daemon gets a part of a core, the same work
is a larger share of it. So what the viewers take is told of a whole core too, which it has on a machine of its own.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import aiohttp

from nclient import Robot, connect

TARGET_SHARE, PICTURES_A_SECOND = 0.05, 20.0
ACKNOWLEDGE_EVERY = 5
SETTLE_S = 0.5


class Daemon(NamedTuple):
    """A daemon that runs: its process, a client of it, its page."""

    pid: int
    robot: Robot
    page: str

    def processor_s(self) -> float:
        """Processor time it has used so far."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def pace(self, seconds: float) -> tuple[float, float]:
        """Simulated seconds for a second of its processor, and how much of a core it has, over so many real seconds."""
        time.sleep(SETTLE_S)
        begin, processor_s, simulated_s = time.monotonic(), self.processor_s(), self.robot.truth().time_s
        time.sleep(seconds)
        used_s, passed_s = self.processor_s() - processor_s, time.monotonic() - begin
        return (self.robot.truth().time_s - simulated_s) / used_s, used_s / passed_s


@contextmanager
def daemon(*words: str) -> Iterator[Daemon]:
    """A daemon as fast as it can, its robot driving in a circle."""
    command = [sys.executable, "-m", "nserver_emu", "--port", "0", "--viewer", "0", "--start", "45,30,0,0", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            port, page = (process.stdout.readline().split()[-1] for _ in range(2))
            with connect(f"nserver://{port}/1") as robot:
                robot.drive(translation_in_s=8, steering_rad_s=0.7)
                yield Daemon(process.pid, robot, page)
        finally:
            process.terminate()


@contextmanager
def viewers(page: str, count: int) -> Iterator[subprocess.Popen[str]]:
    """So many viewers of a page, in a process of their own; all are there."""
    command = [sys.executable, __file__, "--look", page, "--viewers", str(count)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process


async def look(page: str, count: int) -> None:
    """Be that many viewers until told to stop; print how many pictures a second each got."""
    origin, _, query = page.partition("/?")
    pictures = 0

    async def one(session: aiohttp.ClientSession, ready: asyncio.Event) -> None:
        nonlocal pictures
        async with session.ws_connect(f"{origin}/ws?{query}", headers={"Origin": origin}) as socket:
            mine = 0
            async for message in socket:
                if message.data.startswith('{"type":"picture"'):
                    ready.set()
                    pictures, mine = pictures + 1, mine + 1
                    if mine % ACKNOWLEDGE_EVERY == 0:
                        frame = int(message.data[26:40].split(",")[0])
                        await socket.send_str(f'{{"do":"seen","frame":{frame}}}')

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        here = [asyncio.Event() for _ in range(count)]
        looking = [asyncio.create_task(one(session, ready)) for ready in here]
        for ready in here:
            await ready.wait()
        print("looking", flush=True)
        began, pictures = time.monotonic(), 0
        await asyncio.to_thread(sys.stdin.readline)
        print(pictures / count / (time.monotonic() - began), flush=True)
        for task in looking:
            task.cancel()


def measure(rounds: int, seconds: float, count: int) -> dict[str, float]:
    """Paces with and without viewers, in turns, and what the viewers take of the processor."""
    alone, watched, cores, rates = [], [], [], []
    with daemon("--speed", "max") as served:
        for _ in range(rounds):
            alone.append(served.pace(seconds)[0])
            with viewers(served.page, count) as process:
                pace, core = served.pace(seconds)
                watched.append(pace)
                cores.append(core)
                out, _ = process.communicate("stop\n")
                rates.append(float(out))
    shares = [1.0 - b / a for a, b in zip(alone, watched, strict=True)]
    return {
        "alone_simulated_s_a_processor_s": statistics.median(alone),
        "watched_simulated_s_a_processor_s": statistics.median(watched),
        "share": statistics.median(shares),
        "core_share": statistics.median(share * core for share, core in zip(shares, cores, strict=True)),
        "daemons_core": statistics.median(cores),
        "share_target": TARGET_SHARE,
        "viewers": count,
        "pictures_a_second": statistics.median(rates),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--look", metavar="URL", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.look:
        asyncio.run(look(options.look, options.viewers))
        return
    result = measure(options.rounds, options.seconds, options.viewers)
    if options.json:
        print(json.dumps(result))
        return
    print(f"{result['viewers']:.0f} viewers at {result['pictures_a_second']:.1f} pictures a second take "
          f"{100 * result['share']:.1f} % of the simulation's processor time (target {100 * TARGET_SHARE:.0f} %): "
          f"{result['alone_simulated_s_a_processor_s']:.0f} simulated seconds a processor second without, "
          f"{result['watched_simulated_s_a_processor_s']:.0f} with; that is {100 * result['core_share']:.1f} % of a "
          f"core, of which the daemon had {100 * result['daemons_core']:.0f} %")


if __name__ == "__main__":
    main()
