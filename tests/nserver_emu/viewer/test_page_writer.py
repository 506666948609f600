"""Messages to one page that receives everything, some or nothing."""

from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace
from typing import cast

import pytest
from aiohttp import ClientConnectionResetError, web
from aiohttp.test_utils import make_mocked_request

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.http_port import STALLED_S, PageWriter, transport_of
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer


class Line(asyncio.Transport):
    """A transport whose unsent bytes the test sets."""

    def __init__(self) -> None:
        super().__init__()
        self.received = b""
        self.unsent = 0
        self.closing = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.received += data

    def get_write_buffer_size(self) -> int:
        return self.unsent

    def is_closing(self) -> bool:
        return self.closing

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self.limits = high, low

    def abort(self) -> None:
        self.closing = True


def make_writer(now: float = 0.0, *, closed: bool = False) -> tuple[PageWriter, Line]:
    line = Line()
    return PageWriter(cast(web.WebSocketResponse, SimpleNamespace(closed=closed)), line, now), line


async def test_messages_of_every_length_arrive() -> None:
    empty = len(json.dumps({"type": "x", "text": ""}))

    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        # Lengths of a websocket frame: 7 bits up to 125, 16 bits up to ffff, 64 bits above.
        for size in (empty, 125, 126, 0xFFFF, 0x10000, 20 * 0xFFFF):
            text = "x" * (size - empty)
            here.viewer_server.broadcaster.notify(json.dumps({"type": "x", "text": text}))
            assert (await page.until(lambda message: message["type"] == "x"))["text"] == text
        here.viewer_server.broadcaster.notify(json.dumps({"type": "x", "text": "äöü"}, ensure_ascii=False))
        assert (await page.until(lambda message: message["type"] == "x"))["text"] == "äöü"


async def test_a_page_that_closes_while_it_is_sent_to_is_no_error() -> None:
    sent = []

    async def send_str(text: str) -> None:
        # As aiohttp does between the end of the connection and that of the task that reads from it.
        sent.append(text)
        raise ClientConnectionResetError("Cannot write to closing transport")

    socket = cast(web.WebSocketResponse, SimpleNamespace(closed=False, send_str=send_str))
    await PageWriter(socket, Line(), 0.0).send("picture")
    assert sent == ["picture"]


def test_a_slow_page_is_skipped_and_not_closed() -> None:
    writer, line = make_writer()
    assert writer.is_ready(1.0)
    line.unsent = 1000
    assert not writer.is_ready(2.0)
    now = 2.0
    while line.unsent > 1:
        # Some bytes are taken shortly before each timeout: slow, but not stalled.
        line.unsent -= 111
        now += STALLED_S - 0.1
        assert not writer.is_ready(now)
        assert not writer.is_stalled(now)
    line.unsent = 0
    assert writer.is_ready(now + 100.0)
    assert not writer.is_stalled(now + 100.0)


def test_a_page_that_receives_nothing_is_stalled() -> None:
    writer, line = make_writer(100.0)
    line.unsent = 1
    assert not writer.is_ready(110.0)
    line.unsent = 7  # a ping came to it
    assert not writer.is_ready(110.0 + STALLED_S)
    assert not writer.is_stalled(110.0 + STALLED_S)
    assert writer.is_stalled(110.1 + STALLED_S)
    writer.abort()
    line.unsent = 0
    assert not writer.is_ready(130.0)


def test_nothing_is_sent_after_the_closing_frame() -> None:
    writer, _ = make_writer(closed=True)
    assert not writer.is_ready(1.0)
    assert not writer.is_stalled(1.0 + 2 * STALLED_S)


def test_a_closed_request_has_no_transport() -> None:
    line = Line()
    assert transport_of(make_mocked_request("GET", "/ws", transport=line)) is line
    request = make_mocked_request("GET", "/ws")
    request._protocol.transport = None
    with pytest.raises(ConnectionResetError, match="closed"):
        transport_of(request)
