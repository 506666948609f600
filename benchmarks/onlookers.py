"""Viewers of a page in a process of their own, for viewer.py: websockets that acknowledge pictures as the page does.

    python benchmarks/onlookers.py URL COUNT

Commands on stdin: `look` connects all and prints `looking` once each has a picture; `leave` disconnects them and prints
the pictures per second that each received. The process ends with stdin.
"""

from __future__ import annotations

import asyncio
import sys
import time

import aiohttp

ACKNOWLEDGE_EVERY = 5
"""Pictures between acknowledgements, as in the page's link.js."""


class Viewers:
    """Viewers of one page."""

    def __init__(self, session: aiohttp.ClientSession, url: str, count: int) -> None:
        self._session = session
        self._origin, _, self._query = url.partition("/?")
        self._count = count
        self._looking: list[asyncio.Task[None]] = []
        self.pictures = 0

    async def look(self) -> None:
        """Connect all and wait until each has a picture."""
        here = [asyncio.Event() for _ in range(self._count)]
        self._looking = [asyncio.create_task(self._one(ready)) for ready in here]
        for ready in here:
            await ready.wait()

    async def leave(self) -> None:
        """Disconnect all."""
        for task in self._looking:
            task.cancel()
        await asyncio.gather(*self._looking, return_exceptions=True)

    async def _one(self, ready: asyncio.Event) -> None:
        headers = {"Origin": self._origin}
        async with self._session.ws_connect(f"{self._origin}/ws?{self._query}", headers=headers) as socket:
            received = 0
            async for message in socket:
                if message.data.startswith('{"type":"picture"'):
                    ready.set()
                    received += 1
                    self.pictures += 1
                    if received % ACKNOWLEDGE_EVERY == 0:
                        # Only the number of the frame is read: parsing each picture as JSON would load the machine.
                        frame = int(message.data[26:40].split(",")[0])
                        await socket.send_str(f'{{"do":"seen","frame":{frame}}}')


async def main(url: str, count: int) -> None:
    """Connect and disconnect on command."""
    # No limit of connections: aiohttp's default is 100.
    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        crowd = Viewers(session, url, count)
        began = 0.0
        while line := await asyncio.to_thread(sys.stdin.readline):
            if line.strip() == "look":
                await crowd.look()
                # Counting begins when all have a picture.
                began, crowd.pictures = time.monotonic(), 0
                print("looking", flush=True)
            else:
                passed_s = time.monotonic() - began
                await crowd.leave()
                print(crowd.pictures / count / passed_s, flush=True)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
