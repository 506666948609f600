"""Effect of one hostile client on others: the 99th percentile latency of 200 clients at 10 Hz, without and with it.

    python benchmarks/load.py [--rounds N] [--seconds S] [--clients N] [--hostile flood|stall|deaf] [--ahead] [--json]

Target: p99 moves by no more than the larger of a factor of 2 and 2 ms, median of five rounds, for each kind:

    flood   requests as fast as possible, replies discarded
    stall   half a request, then silence, repeated when the connection is closed
    deaf    requests as fast as possible, replies never read

Daemon, clients and hostile client are three processes. All clients connect before the first request. A round trip
counts from its due time, so that a late reply does not hide the delay of the next. The hostile client waits for its
socket instead of polling, so that it loads the server and not the machine; a round in which it ends fails. Rounds
without and with it alternate. On a loaded machine, --ahead runs the processes ahead of all others (Linux, root, two
cores): the daemon with a reserved share of a core, the clients, which measure, with real-time priority, the hostile
client with the highest of the usual priorities. The exit code is 1 if a bound is exceeded.
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
# Robot 1; the process number is arbitrary.
CONNECT: Final = codec.encode_tcp_request(Call("connect_robot", (1, 1)))
GS: Final = codec.encode_tcp_request(Call("gs"))
CONNECT_REPLY_SIZE, REPLY_SIZE = 8, 4 + 4 * 49
BEGUN: Final = "begun"
CLIENTS_PRIORITY: Final = 3
"""Real-time priority of the measuring clients with --ahead; they use a few hundredths of a core."""
AHEAD_DAEMON: Final = [
    "chrt", "--reset-on-fork", "--deadline", "--sched-runtime", "4950000", "--sched-deadline", "5000000",
    "--sched-period", "5000000", "0",
]  # fmt: skip
"""Prefix of the daemon's command with --ahead: 99 % of a core, in periods of 5 ms. A process with real-time priority
that never rests is stopped for 50 ms in each second; this one for a millisecond, in one of 200."""
AHEAD_HOSTILE: Final = ["nice", "-n", "-20"]
"""Prefix of the hostile client's command with --ahead: it must not take the core from the measuring clients."""
MANY: Final = 200
"""Requests that a hostile client sends in one piece."""


def bound_ms(alone_ms: float) -> float:
    """Return the limit of p99 for a given p99 without hostile client."""
    return max(FACTOR * alone_ms, alone_ms + EXTRA_MS)


def p99(trips: list[float]) -> float:
    """Return the 99th percentile."""
    return statistics.quantiles(trips, n=100)[98]


Client = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def connected(port: int) -> Client:
    """Connect a client to the robot."""
    reader, writer = await asyncio.open_connection(HOST, port)
    writer.write(CONNECT)
    await reader.readexactly(CONNECT_REPLY_SIZE)
    return reader, writer


async def asking(client: Client, first_s: float, end_s: float) -> list[float]:
    """Send a request every 0.1 s of loop time and return the round-trip times from their due times, in seconds."""
    loop = asyncio.get_running_loop()
    reader, writer = client
    trips, due_s = [], first_s
    while due_s < end_s:
        # Due times, not sending times: a delayed reply must not delay the next request (coordinated omission).
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
    """Run clients, evenly spread over 0.1 s, and return all round-trip times in seconds."""
    there = [await connected(port) for _ in range(clients)]
    # 0.5 s from now: by then all tasks are started.
    begin_s = asyncio.get_running_loop().time() + 0.5
    # Evenly within one period, so that 200 requests do not arrive at once.
    starts = [begin_s + number / clients / RATE_HZ for number in range(clients)]
    asked = zip(there, starts, strict=True)
    found = await asyncio.gather(*(asking(client, start_s, begin_s + seconds) for client, start_s in asked))
    return [trip for trips in found for trip in trips]


def be_hostile(kind: str, port: int) -> None:
    """Act as a hostile client until stopped, reconnecting when closed."""
    while True:
        with socket.create_connection((HOST, port)) as hostile, contextlib.suppress(OSError):
            _once(kind, hostile)
        time.sleep(0.01)


def _once(kind: str, hostile: socket.socket) -> None:
    """Send until the daemon closes the connection."""
    # Half a request, or many at once.
    # Half: one request and three bytes of the next one.
    hostile.sendall(CONNECT + (GS + GS[:3] if kind == "stall" else GS * MANY))
    print(BEGUN, flush=True)
    if kind == "stall":
        while hostile.recv(65536):
            pass
        # A stalled client waits until the daemon closes the connection, and is started again.
        return
    hostile.setblocking(False)
    # A flood receives its replies, so that the daemon never stops sending.
    # A deaf client never reads: the daemon's buffer for it fills up.
    listens = [hostile] if kind == "flood" else []
    while True:
        readable, writable, _ = select.select(listens, [hostile], [])
        if writable:
            hostile.send(GS * MANY)
        if readable and not hostile.recv(1 << 20):
            return


@contextlib.contextmanager
def hostility(kind: str, port: int, *, ahead: bool = False) -> Iterator[None]:
    """Run a hostile client in a process of its own; raise RuntimeError if it ends by itself."""
    command = [*AHEAD_HOSTILE * ahead, sys.executable, __file__, "--be", kind, "--port", str(port)]
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
    command = [*AHEAD_DAEMON * ahead, sys.executable, "-m", "nserver_emu", "--port", "0"]
    alone: list[float] = []
    beside: list[float] = []
    with started(command) as line:
        port = int(line.rpartition(":")[2])
        for _ in range(rounds):
            # Without and with the hostile client by turns; the median of the rounds is compared.
            alone.append(1000 * p99(asyncio.run(ask(port, clients, seconds))))
            with hostility(kind, port, ahead=ahead):
                beside.append(1000 * p99(asyncio.run(ask(port, clients, seconds))))
    alone_ms, beside_ms = statistics.median(alone), statistics.median(beside)
    return {"hostile": kind, "alone_p99_ms": alone_ms, "beside_p99_ms": beside_ms, "bound_ms": bound_ms(alone_ms),
            "is_met": beside_ms <= bound_ms(alone_ms), "rounds": rounds, "clients": clients}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 if a bound is exceeded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--hostile", choices=HOSTILE, action="append", help="this kind alone (default: each)")
    parser.add_argument("--ahead", action="store_true", help="ahead of all else on the machine")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--be", choices=HOSTILE, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.be:
        be_hostile(options.be, options.port)
    if options.ahead:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(CLIENTS_PRIORITY))
    is_within = True
    for kind in options.hostile or HOSTILE:
        found = measure(kind, options.rounds, options.seconds, options.clients, options.ahead)
        is_within = is_within and bool(found["is_met"])
        print(json.dumps(found) if options.json else
              f"{kind}: p99 {found['alone_p99_ms']:.2f} ms without, {found['beside_p99_ms']:.2f} ms with it "
              f"(at most {found['bound_ms']:.2f}): {'passed' if found['is_met'] else 'FAILED'}")
    return 0 if is_within else 1


if __name__ == "__main__":
    raise SystemExit(main())
