"""Notification of a service manager over a real datagram socket, and the systemd unit."""

from __future__ import annotations

import asyncio
import configparser
import contextlib
import os
import shlex
import signal
import socket
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from nserver_emu import cli
from nserver_emu.cli import ServiceManager, announced, nserver_parser
from tests.programs.forked import Forked

UNIT = Path(__file__).parents[2] / "packaging/nserver.service"


@pytest.fixture(params=["path", "abstract"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return str(tmp_path / "notify") if request.param == "path" else f"@nserver-test-{os.getpid()}"


@pytest.fixture
def manager(place: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0{place[1:]}" if place.startswith("@") else place)
        listener.settimeout(60)
        yield listener


@pytest.mark.long
def test_a_daemon_is_ready_alive_and_stopping(manager: socket.socket, place: str) -> None:
    # A watchdog of 200 ms, so that three of its messages come soon.
    environment = {**os.environ, "NOTIFY_SOCKET": place, "WATCHDOG_USEC": "200000"}
    environment.pop("WATCHDOG_PID", None)
    with Forked("nserver", "--port", "0", environment=environment) as process:
        assert manager.recv(100) == b"READY=1"
        assert process.stdout.readline().startswith("listening nserver"), "ready comes after the doors are open"
        assert [manager.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
        process.send_signal(signal.SIGTERM)
        while (message := manager.recv(100)) == b"WATCHDOG=1":
            pass
        assert message == b"STOPPING=1"
        assert process.wait(60) == 0


@pytest.mark.parametrize(("environment", "feed_s"), [
    # Half of the interval is the usual rate; nothing without socket, for another process, or with a bad number.
    ({}, 0.0), ({"WATCHDOG_USEC": "1000000"}, 0.0), ({"NOTIFY_SOCKET": "/x", "WATCHDOG_USEC": "1000000"}, 0.5),
    ({"NOTIFY_SOCKET": "/x", "WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}, 0.0),
    ({"NOTIFY_SOCKET": "/x", "WATCHDOG_USEC": "soon"}, 0.0),
])  # fmt: skip
def test_the_watchdog_is_fed_where_it_is_asked_for(environment: dict[str, str], feed_s: float) -> None:
    assert ServiceManager(environment).feed_s == feed_s


PATIENCE_S = 10.0
FED = {"WATCHDOG_USEC": "2000"}


async def test_an_absent_service_manager_is_notified_later(
    caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    place = str(tmp_path / "absent")
    async with asyncio.timeout(PATIENCE_S), announced(ServiceManager({"NOTIFY_SOCKET": place} | FED)):
        # The first messages are sent while nothing is bound at the path.
        await asyncio.sleep(0.02)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
            listener.setblocking(False)
            listener.bind(place)
            message = await asyncio.get_running_loop().sock_recv(listener, 100)
            assert message.split() == [b"READY=1", b"WATCHDOG=1"]
            assert await asyncio.get_running_loop().sock_recv(listener, 100) == b"WATCHDOG=1"
    assert caplog.text.count("does not listen") == 1
    assert caplog.text.count("listens again") == 1


@pytest.mark.parametrize("environment", [FED, {}], ids=["watchdog", "no watchdog"])
async def test_a_full_queue_ends_no_watchdog_and_loses_no_ready(
    manager: socket.socket, place: str, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "_RETRY_S", 0.001)
    manager.setblocking(False)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as crowd, contextlib.suppress(BlockingIOError):
        crowd.setblocking(False)
        while True:
            # The queue of the socket is filled until it blocks.
            crowd.sendto(b"STATUS=much to say", place.replace("@", "\0", 1) if place[0] == "@" else place)

    receive = partial(asyncio.get_running_loop().sock_recv, manager, 100)
    async with asyncio.timeout(PATIENCE_S), announced(ServiceManager({"NOTIFY_SOCKET": place} | environment)):
        await asyncio.sleep(0.02)
        # First what was in the queue, then nothing may be missing.
        while (message := await receive()).startswith(b"STATUS="):
            pass
        assert message.split() == ([b"READY=1", b"WATCHDOG=1"] if environment else [b"READY=1"])
        if environment:
            assert await receive() == b"WATCHDOG=1"


def test_the_unit_asks_for_what_the_daemon_does(tmp_path: Path) -> None:
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(UNIT)
    cli = dict(unit["Service"])
    assert (cli["Type"], cli["WatchdogSec"], cli["NoNewPrivileges"]) == ("notify", "30", "yes")
    # systemd would replace these variables; the resulting command must be valid.
    options = shlex.split(cli["Environment"])[0].partition("=")[2]
    command = cli["ExecStart"].replace("$NSERVER_OPTIONS", options)
    for folder in ("${STATE_DIRECTORY}", "${RUNTIME_DIRECTORY}"):
        command = command.replace(folder, str(tmp_path))
    words = shlex.split(command)
    assert words[0].endswith("/nserver")
    found = nserver_parser().parse_args(words[1:])
    assert (found.files, found.log_format, found.control) == (["several_walls"], "json", tmp_path / "nserver.sock")
