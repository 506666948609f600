"""Measure a serial line: `gs` over a pseudo-terminal, relative to a bare echo of the same bytes over another one.

    python benchmarks/line.py [--rounds N] [--calls N] [--json]

    nserver   the host is that of the echo: it sends prepared bytes and counts those that arrive
    client    the host is this package, as `connect` builds it: each reply is parsed and validated

Targets: unpaced, the daemon reaches at least 0.5 of the echo's rate; at 38400 baud, both hosts reach at least 0.95 of
the exchanges that the baud rate allows, with ten bits per byte, request and reply in turn.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import tempfile
import time
import tty
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from echo import Pace, compare, parsed_options, started

from nclient.backends.base import Backend
from nclient.connector import open_backend
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import N150, serial_wire_state

TARGET_RATIO, TARGET_SHARE = 0.5, 0.95
BAUD, BITS_PER_BYTE = 38400, 10
GS = Call("gs")
REQUEST = codec.encode_serial_request(GS, serial_wire_state(N150))
REPLY_SIZE = 48
"""An N150's state packet in its frame."""
PACED_CALLS = 100
STARTING_S = 20.0
ECHO = "--echo"


class Host:
    """A blocking program on a serial line that repeats one prepared request."""

    def __init__(self, path: Path) -> None:
        # The line is no controlling terminal: otherwise its end would send SIGHUP.
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._fd)

    def __call__(self) -> None:
        os.write(self._fd, REQUEST)
        size = REPLY_SIZE
        while size:
            size -= len(os.read(self._fd, size))

    def close(self) -> None:
        """Close the line."""
        os.close(self._fd)


async def _serve_echo() -> None:
    """Print the name of a pseudo-terminal and answer complete requests on it."""
    # A pseudo-terminal in raw mode, whose other end is the host's.
    fd, other = os.openpty()
    tty.setraw(other)
    os.set_blocking(fd, False)
    pending, reply = 0, bytes(REPLY_SIZE)

    def readable() -> None:
        nonlocal pending
        # Requests may arrive in parts: only complete ones are answered.
        whole, pending = divmod(pending + len(os.read(fd, 4096)), len(REQUEST))
        if whole:
            os.write(fd, reply * whole)

    asyncio.get_running_loop().add_reader(fd, readable)
    print(os.ttyname(other), flush=True)
    await asyncio.Event().wait()


@contextlib.contextmanager
def bare_echo() -> Iterator[Host]:
    """Yield a host on the echo's pseudo-terminal."""
    with started([sys.executable, __file__, ECHO]) as path, contextlib.closing(Host(Path(path))) as host:
        yield host


@contextlib.contextmanager
def hosts(*words: str) -> Iterator[dict[str, Callable[[], None]]]:
    """Yield two hosts, each on its own line to the N150 of a daemon, that send one request per call."""
    with contextlib.ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory()))
        links = folder / "nserver", folder / "client"
        lines = [f"--serial-link={link}@1" for link in links]
        opened.enter_context(started([sys.executable, "-m", "nserver_emu", "--port", "0", *lines, *words]))
        _wait_for(links[-1])
        # The links exist once the daemon listens.
        backend = open_backend(f"serial://{links[1]}")
        opened.callback(backend.close)
        yield {"nserver": opened.enter_context(contextlib.closing(Host(links[0]))), "client": partial(_ask, backend)}


def measure(rounds: int, calls: int) -> dict[str, float]:
    """Return rates and ratios; only the daemon that is measured runs."""
    # Without pacing: the daemon's own time is measured.
    with bare_echo() as echo, hosts() as measured:
        fast = compare({"echo": echo, **measured}, rounds, calls)
    # At 38400 baud: the daemon delays each byte, so that fewer calls are enough.
    with hosts("--baud", str(BAUD)) as measured:
        slow = compare(measured, rounds, PACED_CALLS)
    return _result(fast, slow)


def _wait_for(link: Path) -> None:
    until_s = time.monotonic() + STARTING_S
    while not link.exists():
        if time.monotonic() > until_s:
            raise TimeoutError(f"nserver did not create {link} within {STARTING_S:g} s")
        time.sleep(0.01)


def _ask(backend: Backend) -> None:
    backend.execute(GS)


def _result(fast: dict[str, Pace], slow: dict[str, Pace]) -> dict[str, float]:
    """Return the figures of the best rounds, the echo's too: load on the machine can only lower a rate."""
    # Exchanges per second at this baud rate: request and reply, ten bits per byte.
    allowed = BAUD / BITS_PER_BYTE / (len(REQUEST) + REPLY_SIZE)
    echo = fast["echo"].best_per_second
    result = {"echo_per_second": echo, "ratio_target": TARGET_RATIO, "share_target": TARGET_SHARE}
    for name in ("nserver", "client"):
        result[f"{name}_per_second"] = fast[name].best_per_second
        result[f"{name}_ratio"] = fast[name].best_per_second / echo
        result[f"{name}_paced_per_second"] = slow[name].best_per_second
        result[f"{name}_paced_share"] = slow[name].best_per_second / allowed
    return result


def main() -> None:
    """Measure and print."""
    if sys.argv[1:] == [ECHO]:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_serve_echo())
        return
    options = parsed_options(__doc__)
    result = measure(options.rounds, options.calls)
    if options.json:
        print(json.dumps(result))
        return
    print(f"echo {result['echo_per_second']:.0f}/s")
    for name in ("nserver", "client"):
        per_second, ratio, paced, share = (
            result[f"{name}_{key}"] for key in ("per_second", "ratio", "paced_per_second", "paced_share")
        )
        target = f" (target {TARGET_RATIO})" if name == "nserver" else ""
        print(f"{name} {per_second:.0f}/s: ratio {ratio:.2f}{target}; "
              f"at {BAUD} baud {paced:.1f}/s: {share:.3f} of what it allows (target {TARGET_SHARE})")


if __name__ == "__main__":
    main()
