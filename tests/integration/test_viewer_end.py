"""nserver with pages open, as a process: SIGTERM ends it at once, and its address is the same when it comes again."""

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
"""The best of three, for busy machines: it takes hundredths; with a page open it was 2.9 s more each time."""


@contextlib.contextmanager
def nserver(*words: str) -> Iterator[tuple[Forked, str]]:
    """The process, and the address of its page."""
    with Forked("nserver", "--port", "0", *words) as process:
        try:
            process.stdout.readline()
            yield process, process.stdout.readline().split()[-1]
        finally:
            process.kill()


def test_an_open_page_keeps_no_daemon_from_ending(tmp_path: Path) -> None:
    words = ("--viewer", "0", "--viewer-token-file", str(tmp_path / "tokens"))

    async def look(url: str, process: Forked) -> float:
        origin, _, query = url.partition("/?")
        async with aiohttp.ClientSession() as web:
            sockets = [await web.ws_connect(f"{origin}/ws?{query}", headers={"Origin": origin}) for _ in range(3)]
            await sockets[0].receive()
            began = time.monotonic()
            process.send_signal(signal.SIGTERM)
            code = await asyncio.to_thread(process.wait, 10)
            assert code == 0
            return time.monotonic() - began

    tokens, took = set(), []
    for _ in range(3):
        with nserver(*words) as (process, url):
            took.append(asyncio.run(look(url, process)))
            tokens.add(url.partition("?")[2])
    assert min(took) < AT_ONCE_S
    assert len(tokens) == 1
