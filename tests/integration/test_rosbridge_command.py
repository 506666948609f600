"""nomad rosbridge: a robot at any address as ROS topics."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
from collections.abc import Iterator

import aiohttp
import pytest

from nclient import connect
from tests.programs.forked import Forked


async def drive(address: str, robot: str) -> None:
    """Subscribe, drive until the robot moves, and vanish."""
    twist = {"linear": {"x": 0.2}, "angular": {"z": 0.0}}
    async with (
        asyncio.timeout(30), aiohttp.ClientSession() as web,
        web.ws_connect(address.replace("ws:", "http:")) as socket,
    ):  # fmt: skip
        await socket.send_json({"op": "subscribe", "topic": "/robot1/odom"})
        await socket.send_json({"op": "subscribe", "topic": "/map"})
        seen = set()
        while True:
            message = json.loads(await socket.receive_str())
            seen.add(message["op"])
            if message["op"] == "publish":
                await socket.send_json({"op": "publish", "topic": "/robot1/cmd_vel", "msg": twist})
                if message["msg"]["pose"]["pose"]["position"]["x"] > 0.02:
                    break
        # The map of a robot elsewhere is not known.
        assert seen == {"publish", "status"}, robot


@contextlib.contextmanager
def running(*words: str) -> Iterator[Forked]:
    """A program that is ended, also if the test fails."""
    process = Forked(*words)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


def test_robot_behind_an_address() -> None:
    with running("nserver", "--port", "0") as server:
        robot = f"nserver://{server.stdout.readline().split()[2]}/1"
        with running("nomad", "rosbridge", robot, "--port", "0") as bridge:
            lines = [bridge.stdout.readline().split() for _ in range(2)]
            asyncio.run(drive(lines[1][2], robot))
            with connect(robot) as watcher:
                # The client has gone: its robot stands.
                assert not watcher.wait_until_still(timeout_s=5).moving


def test_wrong_port_names_its_option(capsys: pytest.CaptureFixture[str]) -> None:
    from nclient.cli.main import main

    with pytest.raises(SystemExit) as ended:
        main(["rosbridge", "nserver://127.0.0.1:1", "--port", "abc"])
    assert ended.value.code == 2
    assert "--port: a port is 0 to 65535" in capsys.readouterr().err


def test_no_robot_there(capsys: pytest.CaptureFixture[str]) -> None:
    from nclient.cli.main import main

    assert main(["rosbridge", "nserver://127.0.0.1:1"]) == 1
    assert "127.0.0.1:1" in capsys.readouterr().err
