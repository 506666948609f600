"""Connections to the page's port that ask nothing: so many and no more, closed in time, and clients notice nothing."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator

import pytest

from nserver_emu.server.admission import CONNECTIONS_PER_PAGE, Limits
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.http_port import HTTP_LOG
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import HOST, Served, serve_viewer

# A request without the empty line at its end.
HALF = b"GET / HTTP/1.1\r\n"
ICON = b"GET /favicon.ico HTTP/1.1\r\nHost: localhost\r\n\r\n"
PATIENCE_S = 20


@contextlib.asynccontextmanager
async def serve_with(limits: Limits) -> AsyncIterator[Served]:
    """Serve the page with these limits."""
    async with serve_viewer(Emulator(simulation())) as here:
        here.daemon.admission.limits = limits
        yield here


async def comes(here: Served, says: bytes = HALF) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection(HOST, here.port)
    writer.write(says)
    return reader, writer


async def let_go(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
    async with asyncio.timeout(PATIENCE_S):
        try:
            there = await reader.read(1)
        except ConnectionError:
            there = b""
    writer.close()
    return not there


async def test_a_connection_without_a_request_is_closed() -> None:
    async with serve_with(Limits(stall=1)) as here:
        silent, half = await comes(here, b""), await comes(here)
        # The connection of a request that was answered stays open (keep-alive).
        reader, writer = await comes(here, ICON)
        assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 204")
        async with here.page() as page:
            assert await let_go(*silent)
            assert await let_go(*half)
            await page.until(lambda message: message["type"] == "picture")
        writer.write(ICON)
        assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 204")
        writer.close()


@pytest.mark.parametrize(("limits", "most"), [(Limits(viewers=1), CONNECTIONS_PER_PAGE), (Limits(per_address=3), 3)])
async def test_there_are_no_more_than_pages_want(limits: Limits, most: int, caplog: pytest.LogCaptureFixture) -> None:
    async with serve_with(limits) as here:
        inside = [await comes(here) for _ in range(most)]
        assert here.viewer_server._port.runner is not None
        server = here.viewer_server._port.runner.server
        assert server is not None
        async with asyncio.timeout(PATIENCE_S):
            while len(server.connections) < most:
                await asyncio.sleep(0.01)
        assert await let_go(*await comes(here))
        assert here.daemon.admission.rejected == 1
        for _, writer in inside:
            writer.close()
    assert f"there are {most} connections to the page" in caplog.text


async def test_bytes_that_are_no_http_are_logged_without_a_traceback(caplog: pytest.LogCaptureFixture) -> None:
    async with serve_with(Limits()) as here:
        # No Host header, a line that is too long, and a header without a colon.
        for says in (b"GET / HTTP/1.1\r\n\r\n", b"GET /" + b"a" * 70_000, b"GET / HTTP/1.1\r\nHost\r\n\r\n"):
            reader, writer = await comes(here, says)
            async with asyncio.timeout(PATIENCE_S):
                assert b" 400 " in await reader.readline()
            writer.close()
        assert here.daemon.admission.rejected == 3
    records = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(records) == 3
    for record in records:
        assert record.getMessage().startswith(f"{HOST}: rejected: what it says at the page's port is no HTTP")
        assert record.exc_info is None
    assert HTTP_LOG.filters == []


async def test_an_internal_error_is_logged_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    async with serve_with(Limits()):
        try:
            raise RuntimeError("of our own")
        except RuntimeError:
            HTTP_LOG.exception("Error handling request from %s", HOST)
        HTTP_LOG.error("Missing return statement on request handler")
    assert "RuntimeError: of our own" in caplog.text
    assert "Missing return statement" in caplog.text


async def test_without_a_stall_limit_no_connection_is_closed() -> None:
    async with serve_with(Limits(stall=0)) as here:
        reader, writer = await comes(here)
        await asyncio.sleep(0.05)
        writer.write(b"Host: localhost\r\n\r\n")
        assert (await reader.readuntil(b"\r\n")).startswith(b"HTTP/1.1 200")
        writer.close()
