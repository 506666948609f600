"""Who comes and goes during an endurance run: one function a kind of visitor, each a whole visit of a few seconds.

    program    nclient: drives, reads sensors, draws, adds an obstacle, leaves politely
    dies       asks, then resets the connection in the middle
    half       half a request, then nothing, then gone
    deaf       asks a thousand times and reads no answer
    noise      bytes that are no request
    host       nclient on a robot's own line, over TCP or on the pseudo-terminal
    page       the page's websocket: pictures, a question, leaves politely or not
    localizer  publishes an estimate
    owner      asks and changes things over the control socket

Rules: what goes wrong for a visitor (there are faults on every line) is counted and no more; what it sets going, it
leaves to the daemon to clean up.
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
PATIENCE_S: Final = 20.0
"""A visit that takes longer is broken off."""
CONNECT: Final = [codec.encode_tcp_request(Call("connect_robot", (robot, 1))) for robot in range(1, 4)]
GS: Final = codec.encode_tcp_request(Call("gs"))
MANY: Final = 1000
SILENCE_S: Final = 0.3
ROBOTD_MODEL, SERIAL_MODEL = MODELS[0], MODELS[1]
"""Whose own lines are open: robot 1's over TCP, robot 2's as a pseudo-terminal."""


@dataclass
class House:
    """Where the daemon is reached, and what its visitors met. `failed`: visits that a fault ended; `now_s`: its clock
    when that was looked at last."""

    nserver: int
    robotd: int
    serial: str
    control: str
    page: str
    visits: dict[str, int] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    now_s: float = 0.0

    async def context(self, kind: str, rng: random.Random) -> None:
        """One visit of that kind; a fault of a line ends it, and is counted."""
        self.visits[kind] = self.visits.get(kind, 0) + 1
        try:
            async with asyncio.timeout(PATIENCE_S):
                await KINDS[kind](self, rng)
        except (NomadError, OSError, EOFError, TimeoutError, aiohttp.ClientError):
            self.failed[kind] = self.failed.get(kind, 0) + 1


async def program(house: House, rng: random.Random) -> None:
    """A program as people write them."""
    number = rng.randint(1, len(MODELS))
    async with await connect_async(f"nserver://{HOST}:{house.nserver}/{number}?timeout_s=1") as robot:
        await robot.set_speeds(translation_in_s=15, steering_deg_s=45)
        box = [(x + rng.uniform(60, 90), y + rng.uniform(60, 90)) for x, y in ((0, 0), (4, 0), (0, 4))]
        await robot.add_obstacle(corners_in=box)
        for _ in range(rng.randint(3, 12)):
            await _drive_and_look(robot, rng)
            await robot.draw_line(points_in=[(0, 0), (rng.uniform(0, 50), 10)])
        await robot.say("on my way")
        await robot.clear_world()


async def _drive_and_look(robot: AsyncRobot, rng: random.Random) -> None:
    await robot.move(translation_in=rng.uniform(-20, 20), steering_deg=rng.uniform(-90, 90))
    await robot.read_sonars()
    await robot.read_bumpers()
    await robot.refresh()
    await robot.drive(translation_in_s=rng.uniform(-8, 8), steering_deg_s=rng.uniform(-20, 20))
    await robot.refresh()


async def host(house: House, rng: random.Random) -> None:
    """A program on a robot's own line."""
    address = rng.choice((
        f"robotd://{HOST}:{house.robotd}?model={ROBOTD_MODEL}", f"serial://{house.serial}?model={SERIAL_MODEL}"))
    async with await connect_async(f"{address}&timeout_s=0.5&reconnect=0&feed=0") as robot:
        for _ in range(rng.randint(2, 6)):
            await robot.drive(translation_in_s=rng.uniform(-8, 8))
            await robot.read_sonars()
            await robot.refresh()
        if rng.random() < 0.5:
            await robot.stop()


async def dies(house: House, rng: random.Random) -> None:
    """A program that is killed in the middle of an answer."""
    async with _connected(house, rng) as (reader, writer):
        writer.write(codec.encode_tcp_request(Call("vm", (80, 100, 0))) + GS * rng.randint(1, 50))
        await reader.read(100)
        _reset(writer)


async def half(house: House, rng: random.Random) -> None:
    """A program that stops in the middle of a request."""
    async with _connected(house, rng) as (_, writer):
        writer.write(GS + GS[:rng.randint(1, len(GS) - 1)])
        await asyncio.sleep(SILENCE_S)


async def deaf(house: House, rng: random.Random) -> None:
    """A program that asks and does not read."""
    with socket.create_connection((HOST, house.nserver)) as caller:
        caller.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            caller.send(rng.choice(CONNECT) + GS * MANY)
        await asyncio.sleep(SILENCE_S)


async def noise(house: House, rng: random.Random) -> None:
    """No program of ours at all."""
    async with _open(asyncio.open_connection(HOST, rng.choice((house.nserver, house.robotd)))) as (reader, writer):
        writer.write(rng.randbytes(rng.randint(1, 5000)))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SILENCE_S):
                await reader.read(1000)


async def page(house: House, rng: random.Random) -> None:
    """A page that is looked at for a while."""
    origin, _, query = house.page.partition("/?")
    async with aiohttp.ClientSession() as web:
        async with web.get(house.page) as answer:
            await answer.read()
        async with web.ws_connect(f"{origin}/ws?{query}", headers={"Origin": origin}) as ws:
            await ws.send_json({"do": "watch", "traffic": True, "laser": True})
            await ws.send_json({"do": "call", "id": 1, "robot": 3, "call": "pr", "args": [100, 200, 0]})
            for _ in range(rng.randint(5, 40)):
                said = await ws.receive_json()
                if said["type"] == "picture":
                    await ws.send_json({"do": "seen", "frame": said["frame"]})
            transport = ws.get_extra_info("socket")
            if rng.random() < 0.5 and transport is not None:
                transport.shutdown(socket.SHUT_RDWR)  # as a laptop that is closed


async def localizer(house: House, rng: random.Random) -> None:
    """A localizer that says where it thinks it is."""
    pose = [rng.uniform(0, 50), rng.uniform(0, 50), 0.0]
    said = {"robot": 1, "clock_s": 0.0, "pose": pose, "turret": 0.0, "cov": [[1, 0, 0], [0, 1, 0], [0, 0, 0.1]],
            "odometry": pose, "truth": None, "echoes": [], "waypoints": [[10, 10]], "passed": 0}  # fmt: skip
    async with aiohttp.ClientSession() as web, web.post(house.page.replace("/?", "/publish?"), json=said) as answer:
        answer.raise_for_status()


async def owner(house: House, rng: random.Random) -> None:
    """Whoever runs the daemon."""
    async with _open(asyncio.open_unix_connection(house.control)) as (reader, writer):
        for command in rng.sample(("status", "faults counts", "world show", "stop", "help"), 3):
            writer.write(json.dumps({"command": command}).encode() + b"\n")
            await reader.readline()
        writer.write(b'{"command": "release"}\n')
        await reader.readline()


async def ask_owner(house: House, command: str) -> dict[str, object]:
    """One question over the control socket."""
    async with _open(asyncio.open_unix_connection(house.control)) as (reader, writer):
        writer.write(json.dumps({"command": command}).encode() + b"\n")
        said: dict[str, object] = json.loads(await reader.readline())["said"]
        return said


Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@contextlib.asynccontextmanager
async def _open(opening: Awaitable[Streams]) -> AsyncIterator[Streams]:
    """A connection for as long as the block, however it ends: faults break off some."""
    reader, writer = await opening
    try:
        yield reader, writer
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


@contextlib.asynccontextmanager
async def _connected(house: House, rng: random.Random) -> AsyncIterator[Streams]:
    async with _open(asyncio.open_connection(HOST, house.nserver)) as (reader, writer):
        writer.write(rng.choice(CONNECT))
        await reader.readexactly(8)
        yield reader, writer


def _reset(writer: asyncio.StreamWriter) -> None:
    """Let the other end have a reset, not an end."""
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


KINDS: Final[dict[str, Callable[[House, random.Random], Awaitable[None]]]] = {
    "program": program, "dies": dies, "half": half, "deaf": deaf, "noise": noise, "host": host, "page": page,
    "localizer": localizer, "owner": owner,
}  # fmt: skip
"""Every kind of visitor."""
