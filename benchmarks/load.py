"""What one hostile client costs the others: the 99th percentile of 200 clients at 10 Hz, without and with it.

    python benchmarks/load.py [--rounds N] [--seconds S] [--clients N] [--hostile flood|stall|deaf] [--ahead] [--json]

Target: p99 moves by no more than the larger of a factor of 2 and 2 ms, median of five rounds, for each kind:

    flood   requests as fast as they are taken, replies read and thrown away
    stall   half a request, then nothing, and again when it was closed
    deaf    requests as fast as they are taken, no reply ever read

The daemon, the clients and the hostile one are three processes. All clients are connected before the first asks; a
round trip counts from when it was due, so that a server that is late for one answer does not hide the next. The hostile
one waits for its socket and not in a loop, so that it takes the server's time and not the machine's; it says when it
has begun, and a round in which it ended does not count but fails. Rounds without and with take turns. On a machine that
others load the figures are theirs as much as ours: --ahead runs the three in real time ahead of all else (Linux, as
root), which comes near a machine of their own: the clients, who measure, before the daemon, that before the hostile
one, which has what is left. The exit code is 1 where a bound is not kept.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import select
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Final

from echo import started

from nclient.protocol import codec
from nclient.protocol.commands import Call

FACTOR: Final = 2.0
EXTRA_MS: Final = 2.0
RATE_HZ: Final = 10.0
HOST: Final = "127.0.0.1"
HOSTILE: Final = ("flood", "stall", "deaf")
CONNECT: Final = codec.encode_tcp_request(Call("connect_robot", (1, 1)))
GS: Final = codec.encode_tcp_request(Call("gs"))
CONNECT_REPLY_SIZE, REPLY_SIZE = 8, 4 + 4 * 49
BEGUN: Final = "begun"
CLIENTS, DAEMON, HOSTILE_ONE = 3, 2, 1
"""Who runs before whom in real time, with --ahead."""
MANY: Final = 200
"""Requests that a hostile client sends in one piece."""


def bound_ms(alone_ms: float) -> float:
    """The p99 that is still good, where it is so much without a hostile client."""
    return max(FACTOR * alone_ms, alone_ms + EXTRA_MS)


def p99(trips: list[float]) -> float:
    """The 99th percentile."""
    return statistics.quantiles(trips, n=100)[98]


Client = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def connected(port: int) -> Client:
    """A client that has its robot."""
    reader, writer = await asyncio.open_connection(HOST, port)
    writer.write(CONNECT)
    await reader.readexactly(CONNECT_REPLY_SIZE)
    return reader, writer


async def asking(client: Client, first_s: float, end_s: float) -> list[float]:
    """Ask every tenth of a second from then until then, loop time; each trip in seconds from when it was due."""
    loop = asyncio.get_running_loop()
    reader, writer = client
    trips, due_s = [], first_s
    while due_s < end_s:
        await asyncio.sleep(max(0.0, due_s - loop.time()))
        writer.write(GS)
        await reader.readexactly(REPLY_SIZE)
        trips.append(loop.time() - due_s)
        due_s += 1.0 / RATE_HZ
    writer.close()
    with contextlib.suppress(OSError):
        await writer.wait_closed()
    return trips


async def ask(port: int, clients: int, seconds: float) -> list[float]:
    """That many clients, evenly spread over the tenth of a second, for so long; all trips in seconds."""
    there = [await connected(port) for _ in range(clients)]
    begin_s = asyncio.get_running_loop().time() + 0.5
    starts = [begin_s + number / clients / RATE_HZ for number in range(clients)]
    asked = zip(there, starts, strict=True)
    found = await asyncio.gather(*(asking(client, start_s, begin_s + seconds) for client, start_s in asked))
    return [trip for trips in found for trip in trips]


def be_hostile(kind: str, port: int) -> None:
    """Be so until stopped; a connection that is closed is made again."""
    while True:
        with socket.create_connection((HOST, port)) as hostile, contextlib.suppress(OSError):
            _once(kind, hostile)
        time.sleep(0.01)


def _once(kind: str, hostile: socket.socket) -> None:
    """Until the daemon closes it, or no more can be sent."""
    hostile.sendall(CONNECT + (GS + GS[:3] if kind == "stall" else GS * MANY))
    print(BEGUN, flush=True)
    if kind == "stall":
        while hostile.recv(65536):
            pass
        return
    hostile.setblocking(False)
    listens = [hostile] if kind == "flood" else []
    while True:
        readable, writable, _ = select.select(listens, [hostile], [])
        if writable:
            hostile.send(GS * MANY)
        if readable and not hostile.recv(1 << 20):
            return


def scheduled(command: list[str], priority: int | None) -> list[str]:
    """A command in real time, by util-linux' chrt; None: as all else is."""
    return command if priority is None else ["chrt", "--rr", str(priority), *command]


@contextlib.contextmanager
def hostility(kind: str, port: int, *, ahead: bool = False) -> Iterator[None]:
    """A hostile client in a process of its own, from when it has begun. Raises RuntimeError where it ends by itself."""
    command = [sys.executable, __file__, "--be", kind, "--port", str(port)]
    command = scheduled(command, HOSTILE_ONE if ahead else None)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            if process.stdout.readline().strip() != BEGUN:
                raise RuntimeError(f"no {kind}")
            yield
            if process.poll() is not None:
                raise RuntimeError(f"the {kind} ended by itself: {process.returncode}")
        finally:
            process.terminate()


def measure(
    kind: str, rounds: int, seconds: float, clients: int, ahead: bool = False
) -> dict[str, float | str | bool]:
    """p99 without and with, in turns, ms; whether the median of the rounds keeps the bound."""
    command = scheduled([sys.executable, "-m", "nserver_emu", "--port", "0"], DAEMON if ahead else None)
    alone: list[float] = []
    beside: list[float] = []
    with started(command) as line:
        port = int(line.rpartition(":")[2])
        for _ in range(rounds):
            alone.append(1000 * p99(asyncio.run(ask(port, clients, seconds))))
            with hostility(kind, port, ahead=ahead):
                beside.append(1000 * p99(asyncio.run(ask(port, clients, seconds))))
    alone_ms, beside_ms = statistics.median(alone), statistics.median(beside)
    return {"hostile": kind, "alone_p99_ms": alone_ms, "beside_p99_ms": beside_ms, "bound_ms": bound_ms(alone_ms),
            "kept": beside_ms <= bound_ms(alone_ms), "rounds": rounds, "clients": clients}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 1 where a bound is not kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--hostile", choices=HOSTILE, action="append", help="this kind alone (default: each)")
    parser.add_argument("--ahead", action="store_true", help="in real time, ahead of all else on the machine")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--be", choices=HOSTILE, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.be:
        be_hostile(options.be, options.port)
    if options.ahead:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(CLIENTS))
    kept = True
    for kind in options.hostile or HOSTILE:
        found = measure(kind, options.rounds, options.seconds, options.clients, options.ahead)
        kept = kept and bool(found["kept"])
        print(json.dumps(found) if options.json else
              f"{kind}: p99 {found['alone_p99_ms']:.2f} ms without, {found['beside_p99_ms']:.2f} ms with it "
              f"(at most {found['bound_ms']:.2f}): {'kept' if found['kept'] else 'NOT KEPT'}")
    return 0 if kept else 1


if __name__ == "__main__":
    raise SystemExit(main())
