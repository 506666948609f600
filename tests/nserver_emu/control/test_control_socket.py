"""The control socket: for its owner only, never replacing other files, robust against any input."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import stat
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from nclient.errors import ConnectionLost
from nserver_emu.control import commands as control_socket
from nserver_emu.control.commands import ControlSocket, default_path


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a short name: a Unix socket's path has about a hundred bytes."""
    return tmp_path_factory.mktemp("c")


async def backwards(line: bytes) -> bytes:
    if line == b"fault\n":
        raise RuntimeError("a bug")
    # Any answer that shows which line it belongs to.
    return line.strip()[::-1] + b"\n"


@asynccontextmanager
async def open_socket(path: Path) -> AsyncIterator[ControlSocket]:
    """Serve `backwards` at a path."""
    control = ControlSocket(path, backwards)
    await control.open()
    try:
        async with asyncio.timeout(20):
            yield control
    finally:
        control.close()
        await asyncio.sleep(0.01)


async def ask(path: Path, *lines: bytes) -> bytes:
    reader, writer = await asyncio.open_unix_connection(str(path))
    try:
        writer.write(b"".join(lines))
        # The end of input after the last line: the reader gets all answers, then the end.
        writer.write_eof()
        return await reader.read()
    finally:
        writer.close()
        await writer.wait_closed()


async def test_a_line_in_a_line_out_for_the_owner_only(folder: Path) -> None:
    path = folder / "s"

    async with open_socket(path):
        # Only the owner may connect: mode 600.
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert await ask(path, b"abc\n", b"xy\n") == b"cba\nyx\n"
        # The last line may have no newline.
        assert await ask(path, b"half") == b"flah\n"
    assert not path.exists()


async def test_an_internal_error_closes_one_connection(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = folder / "s"

    async with open_socket(path):
        assert await ask(path, b"fault\n") == b""
        assert await ask(path, b"abc\n") == b"cba\n"
    assert "internal error; connection closed" in caplog.text


async def test_a_line_without_end_is_given_up(
    folder: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_socket, "MAX_LINE", 100)
    path = folder / "s"

    caplog.set_level(logging.WARNING)
    async with open_socket(path):
        assert await ask(path, b"x" * 300 + b"\n") == b""
        assert await ask(path, b"abc\n") == b"cba\n"
    assert "control: closed" in caplog.text


async def test_open_connections_are_closed_with_the_socket(folder: Path) -> None:
    path = folder / "s"

    async with open_socket(path) as control:
        reader, writer = await asyncio.open_unix_connection(str(path))
        writer.write(b"abc\n")
        assert await reader.readline() == b"cba\n"
        control.close()
        assert await reader.read() == b""
        writer.close()
        await writer.wait_closed()


async def test_only_a_stale_socket_is_replaced(folder: Path) -> None:
    path = folder / "s"
    # The file of a socket that nothing listens to, as after a crash.
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))

    async with open_socket(path):
        with pytest.raises(ConnectionLost, match="another nserver"):
            await ControlSocket(path, backwards).open()
        assert await ask(path, b"abc\n") == b"cba\n"


async def test_what_is_no_socket_is_never_touched(folder: Path) -> None:
    path = folder / "s"
    path.write_text("mine")
    with pytest.raises(ConnectionLost, match="no socket"):
        await ControlSocket(path, backwards).open()
    assert path.read_text() == "mine"
    # A dangling link: nothing may be created at its target.
    (folder / "dangling").symlink_to(folder / "nowhere")
    with pytest.raises(ConnectionLost, match="No such file"):
        await ControlSocket(folder / "dangling", backwards).open()


async def test_a_place_where_none_can_be(folder: Path) -> None:
    with pytest.raises(ConnectionLost, match="No such file"):
        await ControlSocket(folder / "nowhere" / "s", backwards).open()
    ControlSocket(folder / "never opened", backwards).close()
    with pytest.raises(ConnectionLost, match="path too long"):
        await ControlSocket(folder / ("x" * 200), backwards).open()


async def test_a_socket_that_took_its_place_stays(folder: Path) -> None:
    path = folder / "s"

    async with open_socket(path):
        # Another program has replaced the file: closing must not remove it.
        path.unlink()
        path.write_text("another's")
    assert path.read_text() == "another's"


async def test_the_users_own_place(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert default_path({"XDG_RUNTIME_DIR": str(folder)}) == folder / "nserver.sock"
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(folder))
    own = folder / f"nserver-{os.getuid()}" / "nserver.sock"
    for environment in ({}, {"XDG_RUNTIME_DIR": str(folder / "nowhere")}):
        assert default_path(environment) == own

    async with open_socket(own):
        assert stat.S_IMODE(own.parent.stat().st_mode) == 0o700
    # The folder in /tmp belongs to another user, who could answer in place of the server.
    monkeypatch.setattr(os, "getuid", lambda: 4711)
    with pytest.raises(ConnectionLost, match="another user"):
        await ControlSocket(own, backwards).open()


async def test_a_planted_runtime_folder_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(folder))
    own, elsewhere = default_path({}), folder / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    own.parent.symlink_to(elsewhere)
    with pytest.raises(ConnectionLost, match="symbolic link"):
        await ControlSocket(own, backwards).open()
    own.parent.unlink()
    own.parent.mkdir()
    # Writable by all: another user could replace the socket in it.
    own.parent.chmod(0o777)
    with pytest.raises(ConnectionLost, match="other users"):
        await ControlSocket(own, backwards).open()
    assert not list(elsewhere.iterdir())
    assert not list(own.parent.iterdir())
