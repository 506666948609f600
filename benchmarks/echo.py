"""Baseline of the server and client benchmarks: a bare asyncio server that sends a prepared reply.

    start_echo(request, reply)   a process of its own; asyncio.Protocol; `reply` for every `request` bytes
    Pinger                       a blocking client on a plain socket that sends prepared bytes and counts
    compare(sides)               several short rounds, the sides taking turns, since these machines are noisy

Neither the echo server nor the Pinger uses code of the project.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass


class Echo(asyncio.Protocol):
    """Counts bytes, answers whole requests."""

    def __init__(self, request_size: int, reply: bytes) -> None:
        self._size, self._reply, self._pending = request_size, reply, 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        # Requests are counted by their bytes: the server parses nothing.
        whole, self._pending = divmod(self._pending + len(data), self._size)
        if whole:
            self._transport.write(self._reply * whole)


async def _serve(request_size: int, reply_size: int) -> None:
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: Echo(request_size, bytes(reply_size)), "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()


@contextlib.contextmanager
def start_echo(request_size: int, reply_size: int) -> Iterator[int]:
    """The port of an echo server in its own process."""
    with started([sys.executable, __file__, str(request_size), str(reply_size)]) as line:
        yield int(line)


@contextlib.contextmanager
def started(command: list[str]) -> Iterator[str]:
    """The first line that a program prints; the program ends with the block."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        try:
            yield program.stdout.readline().strip()
        finally:
            program.terminate()


class Pinger:
    """A blocking client: the same prepared request again and again, each answered before the next.

    With a `piece_size` it writes the request in pieces, and its system delays them by Nagle's algorithm.
    """

    def __init__(
        self, port: int, request: bytes, reply_size: int, greeting: bytes = b"", greeted: int = 0, piece_size: int = 0
    ) -> None:  # fmt: skip
        self._socket = socket.create_connection(("127.0.0.1", port))
        # Nagle's algorithm stays on only for requests in pieces.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, int(not piece_size))
        size = piece_size or len(request)
        self._pieces = [request[at : at + size] for at in range(0, len(request), size)]
        self._size = reply_size
        if greeting:
            self._socket.sendall(greeting)
            self._receive(greeted)

    def __call__(self) -> None:
        for piece in self._pieces:
            self._socket.sendall(piece)
        self._receive(self._size)

    def _receive(self, size: int) -> None:
        while size:
            data = self._socket.recv(size)
            if not data:
                raise ConnectionError("the server closed the connection")
            size -= len(data)

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


@dataclass(frozen=True)
class Pace:
    """Result of one side: median and best rate of the rounds, and the 99th percentile of all round trips."""

    per_second: float
    p99_ms: float
    best_per_second: float


def compare(sides: dict[str, Callable[[], None]], rounds: int, calls: int) -> dict[str, Pace]:
    """Each side makes `calls` round trips a round, in turns; one round more at the beginning does not count."""
    rates: dict[str, list[float]] = {name: [] for name in sides}
    trips: dict[str, list[float]] = {name: [] for name in sides}
    # Round 0 warms up caches and branch predictors and is not counted.
    for number in range(rounds + 1):
        for name, call in sides.items():
            taken = [_timed(call) for _ in range(calls)]
            if number:
                # The sum of the round trips, without the time of the other sides.
                rates[name].append(calls / sum(taken))
                trips[name] += taken
    return {
        name: Pace(
            statistics.median(rates[name]), 1000 * statistics.quantiles(trips[name], n=100)[98], max(rates[name])
        )
        for name in sides
    }


def parsed_options(description: str | None) -> argparse.Namespace:
    """The options of a benchmark against this yardstick: rounds, calls, json."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7, help="rounds that count (default %(default)s)")
    parser.add_argument("--calls", type=int, default=3000, help="round trips a round (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser.parse_args()


def _timed(call: Callable[[], None]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(int(sys.argv[1]), int(sys.argv[2])))
