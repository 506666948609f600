"""Access to the page: tokens and their file, host names, and the page for requests without a token."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from pathlib import Path

import aiohttp
import pytest

from nclient.transports.listener import is_loopback
from nserver_emu import cli
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer import http_port
from nserver_emu.viewer.http_port import TokenFileError, Tokens, address, load_tokens, new_tokens
from nserver_emu.viewer.server import ViewerServer
from nserver_emu.viewer.server import serve_viewer as page_served
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import HOST, serve_viewer

ACT, WATCH = "a" * 16, "b" * 200


def test_tokens_are_random_and_differ_in_permission() -> None:
    tokens = new_tokens()
    assert len({*tokens, *new_tokens()}) == 4
    # Tokens to act and to watch; then none, one that UTF-8 cannot encode, and one that is too short.
    assert [tokens.may_act(token) for token in (*tokens, "", "ü\ud800", tokens.act[:-1])] == [
        True, False, None, None, None
    ]  # fmt: skip


def test_a_token_file_is_created_private_and_reused(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    first = load_tokens(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert load_tokens(path) == first
    path.write_text(f"{ACT}\n{WATCH}\n")
    assert load_tokens(path) == Tokens(ACT, WATCH)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o620])
def test_a_token_file_that_others_can_read_is_refused(mode: int, tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    load_tokens(path)
    path.chmod(mode)
    with pytest.raises(TokenFileError, match=f"chmod 600 {path}"):
        load_tokens(path)


# Empty, one line, too short, twice the same, too long (201), a character that needs quoting in a URL, no UTF-8.
@pytest.mark.parametrize("text", [b"", ACT.encode(), b"short\nshorter", f"{ACT}\n{ACT}".encode(),
                                  f"{ACT}\n{WATCH}b".encode(), f"{ACT}\n{'&' * 20}".encode(), b"\xff\xfe"])  # fmt: skip
def test_what_is_no_pair_of_tokens_is_refused(text: bytes, tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    path.touch(0o600)
    path.write_bytes(text)
    with pytest.raises(TokenFileError, match="tokens"):
        load_tokens(path)


def test_a_token_file_that_cannot_be_created_is_an_error() -> None:
    with pytest.raises(TokenFileError, match="used for tokens"):
        load_tokens(Path("/dev/null/tokens"))


async def test_the_address_stays_the_same_over_restarts(tmp_path: Path) -> None:
    async def line() -> str:
        tokens = load_tokens(tmp_path / "tokens")
        async with page_served(ViewerServer(Daemon(Emulator(simulation())), tokens), HOST, 0) as lines:
            return lines[0].rpartition("/")[2]

    assert await line() == await line()


def test_a_wrong_token_file_ends_the_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tokens"
    path.touch(0o644)
    assert cli.main(["--port", "0", "--viewer", "0", "--viewer-token-file", str(path)]) == 1
    assert f"chmod 600 {path}" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main(["--viewer-token-file", str(path)])
    assert "give --viewer too" in capsys.readouterr().err


async def test_without_a_token_the_page_explains_the_remedy() -> None:
    async with serve_viewer(Emulator(simulation())) as here:
        async with here.web.get(here.origin, params={"token": "old"}) as answer:
            assert answer.status == 403
            assert answer.content_type == "text/html"
            assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
            text = await answer.text()
        assert "use the whole address that nserver printed" in text
        assert "src=" not in text
        assert "<link" not in text
        async with here.web.get(f"{here.origin}/favicon.ico") as answer:
            assert (answer.status, await answer.read()) == (204, b"")


@pytest.mark.parametrize("path", ["/", "/ws", "/publish"])
@pytest.mark.parametrize("host", ["[", "[::1", "evil.example", "127.0.0.1:x", "", "a b", "\xff"])
async def test_a_host_that_is_none_is_403_and_no_fault(path: str, host: str) -> None:
    """Send the request by hand: a client library refuses to."""
    async with serve_viewer(Emulator(simulation())) as here:
        verb = "POST" if path == "/publish" else "GET"
        reader, writer = await asyncio.open_connection(HOST, here.port)
        # The headers that a browser sends, but for the host, and an Origin that cannot be parsed.
        head = f"{verb} {path}?token={here.viewer_server.token} HTTP/1.1\r\nHost: {host}\r\nContent-Length: 0\r\n"
        upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nOrigin: http://[\r\n"
        writer.write(f"{head}{upgrade if path == '/ws' else ''}{key}\r\n".encode("latin-1"))
        line = await reader.readline()
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()
    assert line.split()[1] == b"403"


@pytest.mark.parametrize(
    ("host", "inside"),
    [("127.0.0.1", True), ("::1", True), ("LOCALHOST", True), ("127.0.1.1", True), ("0.0.0.0", False),
     ("robots.example", False), ("10.0.0.2", False)],
)  # fmt: skip
def test_what_is_open_to_the_network_is_known(host: str, inside: bool) -> None:
    assert is_loopback(host) is inside


def test_an_address_is_one_that_can_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    assert address("127.0.0.1", 80) == "http://127.0.0.1:80"
    assert address("::1", 80) == "http://[::1]:80"
    assert address("robots.example", 80) == "http://robots.example:80"
    # The address of all interfaces is none that a browser can open.
    for everywhere in ("0.0.0.0", "::"):
        assert everywhere not in address(everywhere, 80).split("//")[1].split(":80")[0].split("[")
    monkeypatch.setattr(socket, "socket", _no_network)
    assert address("0.0.0.0", 80) == "http://127.0.0.1:80"
    assert address("::", 80) == "http://[::1]:80"


def _no_network(*_: object) -> None:
    raise OSError("no network")


async def test_a_wildcard_address_is_printed_usably_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    server = ViewerServer(Daemon(Emulator(simulation())))
    async with page_served(server, "0.0.0.0", 0) as (line,), aiohttp.ClientSession() as web:
        url = line.split()[-1]
        assert "0.0.0.0" not in url
        async with web.get(url) as answer:
            assert answer.status == 200
    assert "open to the network" in caplog.text
    assert "ssh -L" in caplog.text


async def test_a_page_on_a_name_prints_that_name_and_is_known_by_it(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    async with page_served(ViewerServer(Daemon(Emulator(simulation()))), "LocalHost", 0) as (line,):
        url = line.split()[-1]
        async with aiohttp.ClientSession() as web, web.get(url) as answer:
            assert answer.status == 200
    assert not caplog.records
    assert http_port.is_known_host("Robots.Example:1", "robots.example")
