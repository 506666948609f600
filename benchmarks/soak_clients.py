"""Clients of an endurance run: one function per kind of client, each a whole session of a few seconds.

    program    nclient: drives, reads sensors, draws, adds an obstacle, disconnects
    dies       sends requests, then resets the connection
    half       half a request, a pause, then disconnects
    deaf       sends a thousand requests and reads no reply
    noise      random bytes
    host       nclient on a robot's own line, over TCP or on the pseudo-terminal
    page       the page's websocket: pictures, a call, closes or vanishes
    localizer  publishes an estimate
    owner      queries and changes over the control socket

Errors of a client (there are faults on all lines) are counted; the daemon must clean up what a client started.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from typing import Final

import aiohttp

from nclient import connect_async
from nclient.aio import AsyncRobot
from nclient.errors import NomadError
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import MODELS as MODELS_BY_NAME

HOST: Final = "127.0.0.1"
MODELS: Final = tuple(MODELS_BY_NAME)
TIMEOUT_S: Final = 20.0
"""Longest session."""
CONNECT: Final = [codec.encode_tcp_request(Call("connect_robot", (robot, 1))) for robot in range(1, 4)]
GS: Final = codec.encode_tcp_request(Call("gs"))
MANY: Final = 1000
SILENCE_S: Final = 0.3
ROBOTD_MODEL, SERIAL_MODEL = MODELS[0], MODELS[1]
"""Models of the robots with lines of their own: robot 1 over TCP, robot 2 on a pseudo-terminal."""


@dataclass
class Target:
    """Addresses of the daemon, and counts of sessions by kind.

    `failed` counts sessions that a fault ended; `now_s` is the simulated time of the latest sample.
    """

    nserver: int
    robotd: int
    serial: str
    control: str
    page: str
    sessions: dict[str, int] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    now_s: float = 0.0

    async def run_session(self, kind: str, rng: random.Random) -> None:
        """Run a session of this kind; count it as failed if a fault ends it."""
        self.sessions[kind] = self.sessions.get(kind, 0) + 1
        try:
            async with asyncio.timeout(TIMEOUT_S):
                await KINDS[kind](self, rng)
        except (NomadError, OSError, EOFError, TimeoutError, aiohttp.ClientError):
            self.failed[kind] = self.failed.get(kind, 0) + 1


async def program(target: Target, rng: random.Random) -> None:
    """A typical program."""
    number = rng.randint(1, len(MODELS))
    async with await connect_async(f"nserver://{HOST}:{target.nserver}/{number}?timeout_s=1") as robot:
        await robot.set_speeds(translation_in_s=15, steering_deg_s=45)
        box = [(x + rng.uniform(60, 90), y + rng.uniform(60, 90)) for x, y in ((0, 0), (4, 0), (0, 4))]
        await robot.add_obstacle(corners_in=box)
        for _ in range(rng.randint(3, 12)):
            await _drive_and_look(robot, rng)
            await robot.draw_line(points_in=[(0, 0), (rng.uniform(0, 50), 10)])
        await robot.say("hello")
        await robot.clear_world()


async def _drive_and_look(robot: AsyncRobot, rng: random.Random) -> None:
    await robot.move(translation_in=rng.uniform(-20, 20), steering_deg=rng.uniform(-90, 90))
    await robot.read_sonars()
    await robot.read_bumpers()
    await robot.refresh()
    await robot.drive(translation_in_s=rng.uniform(-8, 8), steering_deg_s=rng.uniform(-20, 20))
    await robot.refresh()


async def host(target: Target, rng: random.Random) -> None:
    """A program on a robot's own line."""
    address = rng.choice((
        f"robotd://{HOST}:{target.robotd}?model={ROBOTD_MODEL}", f"serial://{target.serial}?model={SERIAL_MODEL}"))
    # No reconnecting and no keep-alive: the daemon must notice by itself that the client is gone.
    async with await connect_async(f"{address}&timeout_s=0.5&reconnect=0&feed=0") as robot:
        for _ in range(rng.randint(2, 6)):
            await robot.drive(translation_in_s=rng.uniform(-8, 8))
            await robot.read_sonars()
            await robot.refresh()
        if rng.random() < 0.5:
            await robot.stop()


async def dies(target: Target, rng: random.Random) -> None:
    """A program that is killed within a reply."""
    async with _connected(target, rng) as (reader, writer):
        writer.write(codec.encode_tcp_request(Call("vm", (80, 100, 0))) + GS * rng.randint(1, 50))
        # In the middle of the replies, before all of them have arrived.
        await reader.read(100)
        _reset(writer)


async def half(target: Target, rng: random.Random) -> None:
    """A program that stops within a request."""
    async with _connected(target, rng) as (_, writer):
        writer.write(GS + GS[:rng.randint(1, len(GS) - 1)])
        await asyncio.sleep(SILENCE_S)


async def deaf(target: Target, rng: random.Random) -> None:
    """A program that sends requests and does not read."""
    with socket.create_connection((HOST, target.nserver)) as caller:
        caller.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            caller.send(rng.choice(CONNECT) + GS * MANY)
        await asyncio.sleep(SILENCE_S)


async def noise(target: Target, rng: random.Random) -> None:
    """A sender of random bytes."""
    async with _open(asyncio.open_connection(HOST, rng.choice((target.nserver, target.robotd)))) as (reader, writer):
        writer.write(rng.randbytes(rng.randint(1, 5000)))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SILENCE_S):
                await reader.read(1000)


async def page(target: Target, rng: random.Random) -> None:
    """A page that is open for some time."""
    origin, _, query = target.page.partition("/?")
    async with aiohttp.ClientSession() as web:
        async with web.get(target.page) as answer:
            await answer.read()
        async with web.ws_connect(f"{origin}/ws?{query}", headers={"Origin": origin}) as ws:
            await ws.send_json({"do": "watch", "traffic": True, "laser": True})
            await ws.send_json({"do": "call", "id": 1, "robot": 3, "call": "pr", "args": [100, 200, 0]})
            for _ in range(rng.randint(5, 40)):
                message = await ws.receive_json()
                if message["type"] == "picture":
                    await ws.send_json({"do": "seen", "frame": message["frame"]})
            transport = ws.get_extra_info("socket")
            if rng.random() < 0.5 and transport is not None:
                # Without a closing handshake of the websocket.
                transport.shutdown(socket.SHUT_RDWR)  # like a laptop that goes to sleep


async def localizer(target: Target, rng: random.Random) -> None:
    """A localizer that publishes an estimate."""
    pose = [rng.uniform(0, 50), rng.uniform(0, 50), 0.0]
    estimate = {"robot": 1, "clock_s": 0.0, "pose": pose, "turret": 0.0, "cov": [[1, 0, 0], [0, 1, 0], [0, 0, 0.1]],
            "odometry": pose, "truth": None, "echoes": [], "waypoints": [[10, 10]], "passed": 0}  # fmt: skip
    url = target.page.replace("/?", "/publish?")
    async with aiohttp.ClientSession() as web, web.post(url, json=estimate) as answer:
        answer.raise_for_status()


async def owner(target: Target, rng: random.Random) -> None:
    """The owner at the control socket."""
    async with _open(asyncio.open_unix_connection(target.control)) as (reader, writer):
        for command in rng.sample(("status", "faults counts", "world show", "stop", "help"), 3):
            writer.write(json.dumps({"command": command}).encode() + b"\n")
            await reader.readline()
        # A stop by this session must not hold the robot in the next one.
        writer.write(b'{"command": "release"}\n')
        await reader.readline()


async def control_request(target: Target, command: str) -> dict[str, object]:
    """Make one request over the control socket."""
    async with _open(asyncio.open_unix_connection(target.control)) as (reader, writer):
        writer.write(json.dumps({"command": command}).encode() + b"\n")
        reply: dict[str, object] = json.loads(await reader.readline())["said"]
        return reply


Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@contextlib.asynccontextmanager
async def _open(opening: Awaitable[Streams]) -> AsyncIterator[Streams]:
    """Open a connection for the block, and close it however the block ends."""
    reader, writer = await opening
    try:
        yield reader, writer
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


@contextlib.asynccontextmanager
async def _connected(target: Target, rng: random.Random) -> AsyncIterator[Streams]:
    async with _open(asyncio.open_connection(HOST, target.nserver)) as (reader, writer):
        writer.write(rng.choice(CONNECT))
        await reader.readexactly(8)
        yield reader, writer


def _reset(writer: asyncio.StreamWriter) -> None:
    """Close the connection with a reset."""
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


KINDS: Final[dict[str, Callable[[Target, random.Random], Awaitable[None]]]] = {
    "program": program, "dies": dies, "half": half, "deaf": deaf, "noise": noise, "host": host, "page": page,
    "localizer": localizer, "owner": owner,
}  # fmt: skip
"""All kinds of clients."""
