"""nserver with open pages: SIGTERM ends it at once, and a restarted one has the same address."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp

from tests.programs.forked import Forked

AT_ONCE_S = 2.0
"""Limit for the best of three, for busy machines; it takes some hundredths of a second."""


@contextlib.contextmanager
def nserver(*words: str) -> Iterator[tuple[Forked, str]]:
    """Run a server and yield it with the address of its page."""
    with Forked("nserver", "--port", "0", *words) as process:
        try:
            process.stdout.readline()
            yield process, process.stdout.readline().split()[-1]
        finally:
            process.kill()


async def shutdown_time_s(url: str, process: Forked) -> float:
    """Open three pages, end the server, and return how long it takes."""
    origin, _, query = url.partition("/?")
    async with aiohttp.ClientSession() as web:
        sockets = [await web.ws_connect(f"{origin}/ws?{query}", headers={"Origin": origin}) for _ in range(3)]
        await sockets[0].receive()
        started_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert await asyncio.to_thread(process.wait, 10) == 0
        return time.monotonic() - started_s


async def test_open_page_does_not_delay_shutdown(tmp_path: Path) -> None:
    words = ("--viewer", "0", "--viewer-token-file", str(tmp_path / "tokens"))
    tokens, times_s = set(), []
    for _ in range(3):
        with nserver(*words) as (process, url):
            times_s.append(await shutdown_time_s(url, process))
            tokens.add(url.partition("?")[2])
    assert min(times_s) < AT_ONCE_S
    assert len(tokens) == 1
