"""The control socket: for its owner only, never replacing other files, robust against any input."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import stat
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from nclient.errors import ConnectionLost
from nserver_emu.control import socket as control_socket
from nserver_emu.control.socket import ControlSocket, default_path


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a short name: a Unix socket's path has about a hundred bytes."""
    return tmp_path_factory.mktemp("c")


def backwards(line: bytes) -> bytes:
    if line == b"fault\n":
        raise RuntimeError("a bug")
    return line.strip()[::-1] + b"\n"


def served(path: Path, scenario: Callable[[ControlSocket], Awaitable[None]]) -> None:
    async def evening() -> None:
        control = ControlSocket(path, backwards)
        await control.open()
        try:
            async with asyncio.timeout(20):
                await scenario(control)
        finally:
            control.close()
            await asyncio.sleep(0.01)

    asyncio.run(evening())


async def ask(path: Path, *lines: bytes) -> bytes:
    reader, writer = await asyncio.open_unix_connection(str(path))
    try:
        writer.write(b"".join(lines))
        writer.write_eof()
        return await reader.read()
    finally:
        writer.close()
        await writer.wait_closed()


def test_a_line_in_a_line_out_for_the_owner_only(folder: Path) -> None:
    path = folder / "s"

    async def scenario(_: ControlSocket) -> None:
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert await ask(path, b"abc\n", b"xy\n") == b"cba\nyx\n"
        assert await ask(path, b"half") == b"flah\n"

    served(path, scenario)
    assert not path.exists()


def test_an_internal_error_closes_one_connection(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = folder / "s"

    async def scenario(_: ControlSocket) -> None:
        assert await ask(path, b"fault\n") == b""
        assert await ask(path, b"abc\n") == b"cba\n"

    served(path, scenario)
    assert "internal error; connection closed" in caplog.text


def test_a_line_without_end_is_given_up(
    folder: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_socket, "MAX_LINE", 100)
    path = folder / "s"

    async def scenario(_: ControlSocket) -> None:
        assert await ask(path, b"x" * 300 + b"\n") == b""
        assert await ask(path, b"abc\n") == b"cba\n"

    with caplog.at_level(logging.WARNING):
        served(path, scenario)
    assert "control: closed" in caplog.text


def test_open_connections_are_closed_with_the_socket(folder: Path) -> None:
    path = folder / "s"

    async def scenario(control: ControlSocket) -> None:
        reader, writer = await asyncio.open_unix_connection(str(path))
        writer.write(b"abc\n")
        assert await reader.readline() == b"cba\n"
        control.close()
        assert await reader.read() == b""
        writer.close()
        await writer.wait_closed()

    served(path, scenario)


def test_only_a_stale_socket_is_replaced(folder: Path) -> None:
    path = folder / "s"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))

    async def scenario(_: ControlSocket) -> None:
        with pytest.raises(ConnectionLost, match="another nserver listens there"):
            await ControlSocket(path, backwards).open()
        assert await ask(path, b"abc\n") == b"cba\n"

    served(path, scenario)


def test_what_is_no_socket_is_never_touched(folder: Path) -> None:
    path = folder / "s"
    path.write_text("mine")
    with pytest.raises(ConnectionLost, match="no socket"):
        served(path, lambda _: asyncio.sleep(0))
    assert path.read_text() == "mine"
    (folder / "dangling").symlink_to(folder / "nowhere")
    with pytest.raises(ConnectionLost, match="No such file"):
        served(folder / "dangling", lambda _: asyncio.sleep(0))


def test_a_place_where_none_can_be(folder: Path) -> None:
    with pytest.raises(ConnectionLost, match="No such file"):
        served(folder / "nowhere" / "s", lambda _: asyncio.sleep(0))
    ControlSocket(folder / "never opened", backwards).close()
    with pytest.raises(ConnectionLost, match="path too long"):
        served(folder / ("x" * 200), lambda _: asyncio.sleep(0))


def test_a_socket_that_took_its_place_stays(folder: Path) -> None:
    path = folder / "s"

    async def scenario(_: ControlSocket) -> None:
        path.unlink()
        path.write_text("another's")

    served(path, scenario)
    assert path.read_text() == "another's"


def test_the_users_own_place(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert default_path({"XDG_RUNTIME_DIR": str(folder)}) == folder / "nserver.sock"
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(folder))
    own = folder / f"nserver-{os.getuid()}" / "nserver.sock"
    for environment in ({}, {"XDG_RUNTIME_DIR": str(folder / "nowhere")}):
        assert default_path(environment) == own

    async def scenario(_: ControlSocket) -> None:
        assert stat.S_IMODE(own.parent.stat().st_mode) == 0o700

    served(own, scenario)
    monkeypatch.setattr(os, "getuid", lambda: 4711)
    with pytest.raises(ConnectionLost, match="another user"):
        served(own, scenario)
