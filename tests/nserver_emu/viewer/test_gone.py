"""Pages that vanish, stall or stay open at the end: removed in time, without blocking others."""

from __future__ import annotations

import asyncio
import gc
import json
import socket
import types
from collections.abc import Awaitable, Callable

import pytest

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer import http_port
from nserver_emu.viewer.scene import Viewer
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import HOST, Served, serve_viewer

# Timeouts are shortened to this; measured times may be longer by 2 s on a busy machine.
SHORT_S = 0.4
HANDSHAKE = (
    "GET /ws?token={token} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\n"
    "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)
# A mask of zeros leaves the payload as it is (RFC 6455).
MASK = b"\0\0\0\0"
# More than the socket buffers of both ends hold together, so that bytes remain unsent.
MORE_THAN_LINES_HOLD = 20_000_000
MUCH = 100


async def dumb_page(here: Served) -> socket.socket:
    """A page that opened and reads nothing any more; its end of the line holds little."""
    end = socket.socket()
    end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    end.setblocking(False)
    loop = asyncio.get_running_loop()
    await loop.sock_connect(end, (HOST, here.port))
    asked = HANDSHAKE.format(token=here.viewer_server.token, host=f"{HOST}:{here.port}")
    await loop.sock_sendall(end, asked.encode())
    assert b" 101 " in await loop.sock_recv(end, 200)
    async with asyncio.timeout(5):
        while not here.viewer_server.broadcaster.viewers:
            await asyncio.sleep(0.01)
    return end


async def forgotten(here: Served) -> float:
    """Return the seconds until no viewer is left."""
    loop = asyncio.get_running_loop()
    began = loop.time()
    async with asyncio.timeout(20):
        while here.viewer_server.broadcaster.viewers:
            await asyncio.sleep(0.02)
    return loop.time() - began


def test_the_time_that_is_promised_is_the_longest_there_is() -> None:
    # 1.5 heartbeats (a ping and half an interval for the pong), or the time without progress.
    assert max(1.5 * http_port.HEARTBEAT_S + 1.0, http_port.STALLED_S + 1.0) <= http_port.CONNECTION_LOST_S


async def test_a_page_that_vanished_is_forgotten_and_its_line_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nserver_emu.viewer.http_port.HEARTBEAT_S", SHORT_S)

    async with serve_viewer(Emulator(simulation())) as here:
        with await dumb_page(here) as end:
            assert await forgotten(here) < 1.5 * SHORT_S + 2.0
            assert not here.daemon.emulator.pose_requests.open
            await read_to_end(end)


async def test_a_page_that_sends_but_never_receives_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_port, "STALLED_S", SHORT_S)

    async with serve_viewer(Emulator(simulation())) as here:
        with await dumb_page(here) as end:
            loop = asyncio.get_running_loop()
            talking = asyncio.create_task(talk_on(loop, end))
            here.viewer_server.broadcaster.notify("x" * MORE_THAN_LINES_HOLD)
            assert await forgotten(here) < SHORT_S + 2.0
            talking.cancel()
            await read_to_end(end)


async def talk_on(loop: asyncio.AbstractEventLoop, end: socket.socket) -> None:
    """Say that a picture was drawn, again and again."""
    payload = json.dumps({"do": "seen", "frame": 1}).encode()
    while True:
        # Header of a frame: 81 is a final text frame, then the mask bit and the length.
        await loop.sock_sendall(end, bytes([0x81, 0x80 | len(payload)]) + MASK + payload)
        await asyncio.sleep(0.05)


async def test_messages_for_a_closed_page_are_dropped(caplog: pytest.LogCaptureFixture) -> None:
    async with serve_viewer(Emulator(simulation())) as here:
        async with here.page() as page:
            await page.until(lambda message: message["type"] == "picture")
            (viewer,) = here.viewer_server.broadcaster.viewers
        await forgotten(here)
        viewer.notify("{}")
        await asyncio.sleep(0.02)
        assert viewer.take_messages() == ["{}"]
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


@pytest.mark.long
async def test_a_page_that_floods_does_not_block_others(monkeypatch: pytest.MonkeyPatch) -> None:
    turns: list[int] = []
    turn = 0
    monkeypatch.setattr(Viewer, "mark_drawn", lambda *_: turns.append(turn))
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        for number in range(MUCH):
            await page.send_message(do="seen", frame=number)
        async with asyncio.timeout(10):
            while len(turns) < MUCH:
                await asyncio.sleep(0)
                turn += 1
        # Each message was handled in a turn of its own.
        assert len(set(turns)) == MUCH


async def read_to_end(end: socket.socket) -> None:
    """Read until the server ends the connection; fail if it does not within 5 s."""
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(5):
        try:
            while await loop.sock_recv(end, 65536):
                pass
        except ConnectionResetError:
            pass


async def test_the_daemon_ends_at_once_with_unresponsive_pages() -> None:
    async with serve_viewer(Emulator(simulation())) as here:
        ends = [await dumb_page(here) for _ in range(5)]
        loop = asyncio.get_running_loop()
        began = loop.time()
        await here.viewer_server.close()
        assert loop.time() - began < http_port.CLOSING_S + 0.5
        for end in ends:
            end.close()


async def test_pages_are_informed_when_the_daemon_ends() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        await page.until(lambda message: message["type"] == "picture")
        closing = asyncio.create_task(here.viewer_server.close())
        while (await page.socket.receive()).type.name not in ("CLOSE", "CLOSED"):
            pass
        await closing
        # 1001: going away (RFC 6455).
        assert page.socket.close_code == 1001


async def refusals(here: Served) -> None:
    for path, status in (("/?token=x", 403), ("/ws?token=x", 403), ("/nothing", 404)):
        async with here.web.get(here.origin + path) as answer:
            assert answer.status == status
    async with here.web.post(here.origin + "/") as answer:
        assert (answer.status, answer.headers["Allow"]) == (405, "GET,HEAD")
    for data in (b"{", b"\xff"):
        token = {"token": here.viewer_server.token}
        async with here.web.post(f"{here.origin}/publish", params=token, data=data) as answer:
            assert answer.status == 400
            assert await answer.text()


async def torn_off(here: Served) -> None:
    page = await dumb_page(here)
    # An end without goodbye.
    # SO_LINGER with 0 s: RST instead of FIN.
    page.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    page.close()
    await forgotten(here)
    await asyncio.sleep(0.05)


@pytest.mark.long
@pytest.mark.parametrize("act", [refusals, torn_off])
async def test_errors_hold_no_frames_until_garbage_collection(act: Callable[[Served], Awaitable[None]]) -> None:
    async with serve_viewer(Emulator(simulation())) as here:
        # The first run fills caches; only the second is judged.
        await act(here)
        gc.collect()
        gc.disable()
        # DEBUG_SAVEALL puts everything that only the collector can free into gc.garbage.
        gc.set_debug(gc.DEBUG_SAVEALL)
        try:
            await act(here)
            gc.collect()
            # A frame or traceback in a cycle holds all local variables of its functions.
            held = [thing for thing in gc.garbage if isinstance(thing, types.FrameType | types.TracebackType)]
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
            gc.enable()
    assert held == []
