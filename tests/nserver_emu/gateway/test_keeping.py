"""A gateway in a running daemon: sockets, the robot's thread, and a clean end. The robot is another emulator."""

from __future__ import annotations

import argparse
import asyncio
import csv
import json
import logging
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from nclient import connect
from nclient.errors import AddressError, ConnectionLost, RobotRefused
from nclient.opening import Opening
from nclient.protocol.commands import Call
from nserver_emu import cli
from nserver_emu.gateway import run as gateway_options
from nserver_emu.gateway.gateway import Gateway, RealSide
from nserver_emu.gateway.run import kept, model_of, reached
from nserver_emu.server.daemon import Daemon
from tests.nserver_emu.gateway.real_robots import ScriptedRobot, emulated
from tests.nserver_emu.server.daemon_house import serving

WHOLE_S = 30


def told(*words: str) -> argparse.Namespace:
    """What a command line says."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--lockstep")
    parser.add_argument("--record")
    gateway_options.add_options(parser)
    options = parser.parse_args(words)
    gateway_options.refuse(parser, options)
    return options


Visiting = Callable[[str], Awaitable[None]]


def serve(side: RealSide, visit: Visiting, *, shadow: bool = False, every_s: float = 60.0) -> None:
    """A daemon with a gateway to this robot, for as long as the visit takes; the visit is told its address."""

    async def evening() -> None:
        emulator = emulated()
        gateway = Gateway(emulator, {1: side}, shadow=shadow)
        daemon = Daemon(emulator, 1.0, gateway)
        port = await daemon.listen("127.0.0.1", 0)
        async with kept(gateway, daemon, every_s), serving(daemon, WHOLE_S):
            await visit(f"nserver://127.0.0.1:{port}/1")

    asyncio.run(evening())


def test_a_client_drives_and_is_not_the_only_one_served() -> None:
    def drive(address: str) -> None:
        with connect(address) as driver, connect(address) as watcher:
            driver.move(translation_in=6)
            assert driver.wait_until_still(timeout_s=20).x_in == 6.0
            assert watcher.refresh().x_in == 6.0
            with pytest.raises(RobotRefused, match="error 5"):
                watcher.move(translation_in=1)
            with pytest.raises(RobotRefused, match="error 4"):
                watcher.truth()

    with reached(told("--real", "sim:thesis_room")) as sides:
        assert model_of(sides) == "n150"
        serve(sides[1], lambda address: asyncio.to_thread(drive, address), every_s=0.01)


def test_a_shadow_is_summed_up_and_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def drive(address: str) -> None:
        with connect(address) as robot:
            robot.set_position(x_in=5.0)
            while "real less simulated" not in caplog.text:
                robot.refresh()

    for name in ("shadow.json", "shadow.csv"):
        caplog.clear()
        with reached(told("--real", "sim:thesis_room?seed=2", "--shadow-report", str(tmp_path / name))) as sides:
            serve(sides[1], lambda address: asyncio.to_thread(drive, address), shadow=True, every_s=0.2)
    report = json.loads((tmp_path / "shadow.json").read_text())
    assert report["robot"] == "sim:thesis_room?seed=2"
    assert report["quantities"]["x_in"]["max"] == 0.0
    rows = list(csv.DictReader((tmp_path / "shadow.csv").read_text().splitlines()))
    assert int(rows[0]["count"]) > 10


def test_without_a_real_robot_there_is_no_side() -> None:
    with reached(told()) as sides:
        assert (sides, model_of(sides)) == ({}, None)


def test_the_gateway_does_itself_what_wrappers_of_the_address_would(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[Opening]()

    def backend(opening: Opening) -> ScriptedRobot:
        opened.append(opening)
        return ScriptedRobot()

    monkeypatch.setattr(Opening, "backend", backend)
    with reached(told("--real", "serial:///dev/ttyUSB0?tm_s=7&retries=1&max_speed_in_s=6", "--max-turn", "9")):
        pass
    values = opened[0].values
    assert (values["tm_s"], values["feed"], values["reconnect"]) == (None, None, None)
    assert (values["retries"], values["max_speed_in_s"]) == (1, 6.0)


@pytest.mark.parametrize(
    ("words", "args"),
    [
        ((), (100, 200, 300)), (("--max-speed", "4"), (40, 200, 300)), (("--max-turn", "5"), (100, 50, 50)),
        (("--max-speed", "4", "--max-turn", "5"), (40, 50, 50)),
    ],
)  # fmt: skip
def test_caps_are_what_the_command_line_says(words: tuple[str, ...], args: tuple[int, ...]) -> None:
    robot = ScriptedRobot()
    gateway_options.around(told("--real", "sim:", *words))(robot).execute(Call("vm", (100, 200, 300)))
    assert robot.calls == [Call("vm", args)]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--max-speed", "8"], "--max-speed is about a real robot: name it with --real ADDRESS"),
        (["--shadow-report", "x.json"], "--shadow is about a real robot"),
        (["--real-read-only"], "--real-read-only is about"),
        (["--real", "sim:", "--lockstep", "0.1"], "--lockstep and --real do not go together"),
        (["--real", "sim:", "--record", "x.jsonl"], "record=FILE"),
        (["--real", "sim:", "--max-turn", "0"], "a number above 0, not '0'"),
        (["--real", "sim:", "--max-turn", "fast"], "a number above 0, not 'fast'"),
    ],
)
def test_wrong_usage_says_what_is_right(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(words)
    assert stop.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said", "code"),
    [
        (["--real", "simm:thesis_room"], "did you mean sim:", 2),
        (["--real", "nserver://127.0.0.1:1/1"], "127.0.0.1", 1),
        (["--real", "sim:thesis_room?robot=n200", "--robot", "n150"], "really a n200", 2),
    ],
)
def test_what_cannot_be_reached_exits_1_and_what_is_no_such_address_2(
    words: list[str], said: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["--port", "0", *words]) == code
    assert said in capsys.readouterr().err


def test_errors_are_those_of_connect() -> None:
    with pytest.raises(AddressError), reached(told("--real", "nowhere")):
        pass
    with pytest.raises(ConnectionLost), reached(told("--real", "nserver://127.0.0.1:1/1")):
        pass


def test_a_robot_that_answers_after_the_end_troubles_nobody(caplog: pytest.LogCaptureFixture) -> None:
    side = RealSide(ScriptedRobot, lambda: 0.0)

    async def nothing(_address: str) -> None:
        return None

    with caplog.at_level(logging.ERROR):
        serve(side, nothing)
        side.robot.news()
    assert not caplog.records


