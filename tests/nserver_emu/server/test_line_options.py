"""The options for robots' own lines: whose line each is, and what is no such option."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import pytest

from nclient.errors import AddressError, ConnectionLost
from nserver_emu.server.admission import at_port
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_lines import add_options, open_lines, refuse
from nserver_emu.simulation.models import MODELS
from tests.nserver_emu.server.line_host import emulated
from worlds.world import StartPose


def parsed(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--bind", default="127.0.0.1")
    add_options(parser)
    return parser.parse_args(words)


def test_a_rate_without_a_serial_line_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    refuse(parser, parsed("--baud", "38400", "--serial-link", "/tmp/q"))
    refuse(parser, parsed("--robotd"))
    with pytest.raises(SystemExit):
        refuse(parser, parsed("--baud", "38400", "--robotd"))
    assert "there is none: add --serial-link PATH" in capsys.readouterr().err


def three_robots() -> Emulator:
    emulator: Emulator = emulated()
    for robot_id, model in ((2, "n200"), (3, "scout")):
        emulator.simulation.add_robot(robot_id, StartPose(30.0 * robot_id, 0.0, 0.0, 0.0), MODELS[model])
    return emulator


async def opened(*words: str) -> tuple[list[str], dict[str, str]]:
    """Return the printed lines, and the addresses of the daemon's lines."""
    daemon = Daemon(three_robots())
    try:
        printed = await open_lines(daemon, parsed(*words))
        return printed, dict(daemon.places)
    finally:
        await daemon.close()


async def test_lines_belong_to_robots_in_order_unless_numbered(tmp_path: Path) -> None:
    a, b, c = (str(tmp_path / name) for name in "abc")
    # PATH@ROBOT names a robot; without it lines belong to robots 1, 2, ... in order.
    words = ["--serial-link", a, "--serial-link", f"{b}@3", "--serial-link", f"{c}@2", "--robotd", "0", "--robotd=0@3"]
    printed, places = await opened(*words)
    assert printed[2:] == [f"listening serial {path}" for path in (a, b, c)]
    assert all(line.startswith("listening robotd 127.0.0.1:") for line in printed[:2])
    assert {name: places[name] for name in ("serial:1", "serial:2", "serial:3")} == {
        "serial:1": a, "serial:2": c, "serial:3": b}  # fmt: skip
    assert [f"listening robotd {places[name]}" for name in ("robotd:1", "robotd:3")] == printed[:2]
    assert list(tmp_path.iterdir()) == []


async def test_all_lines_of_one_robot_are_printed(tmp_path: Path) -> None:
    a, b = (str(tmp_path / name) for name in "ab")
    words = ["--serial-link", f"{a}@1", "--serial-link", f"{b}@1", "--robotd", "0@1", "--robotd", "0@1"]
    printed, places = await opened(*words)
    assert places["serial:1"] == f"{a}, {b}"
    assert [f"listening robotd {place}" for place in places["robotd:1"].split(", ")] == printed[:2]


async def test_a_link_that_old_programs_take_for_a_host_is_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    await opened("--serial-link", str(tmp_path / "nomad"))
    assert any("old C programs" in message and "/dev/shm/nomad" in message for message in caplog.messages)
    caplog.clear()
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        await opened("--serial-link", f"{folder}/nomad")
    assert not [message for message in caplog.messages if "old C programs" in message]


def test_robotd_has_a_default_port_and_folders_may_contain_at() -> None:
    options = parsed("--robotd", "--serial-link", "/tmp/me@home/q")
    assert options.robotd == [("65001", None)]
    assert options.serial_link == [("/tmp/me@home/q", None)]
    assert options.baud is None
    assert parsed().robotd == parsed().serial_link == []


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--robotd", "thesis_room"), "the world goes before --robotd"),
        (("--robotd", "65536"), "a port is 0 to 65535, or PORT@ROBOT, not '65536'"),
        (("--serial-link", "@2"), "a path such as"),
        (("--serial-link", "/tmp/q@x"), "after @ comes the number of a robot"),
        (("--baud", "300"), "a rate is 9600 to 4000000 bits a second, not '300'"),
        (("--baud", "fast"), "not 'fast'"),
    ],
)
def test_what_cannot_be_is_wrong_usage(
    words: tuple[str, str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        parsed(*words)
    assert stop.value.code == 2
    assert complaint in capsys.readouterr().err


async def test_a_line_that_cannot_be_opened_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(AddressError, match=r"robot 4: .*1, 2, 3"):
        await opened("--serial-link", str(tmp_path / "a"), "--serial-link", f"{tmp_path}/b@4")
    (tmp_path / "precious").write_text("x")
    # The second link cannot be created, so the first one must be removed again.
    with pytest.raises(ConnectionLost, match="no symbolic link"):
        await opened("--serial-link", str(tmp_path / "a"), "--serial-link", str(tmp_path / "precious"))
    assert [entry.name for entry in tmp_path.iterdir()] == ["precious"]


async def test_a_system_without_pseudo_terminals_has_robotd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # None in sys.modules makes the import fail, as on Windows.
    monkeypatch.setitem(sys.modules, "nserver_emu.server.pty", None)
    with pytest.raises(ConnectionLost, match="use --robotd"):
        await opened("--serial-link", str(tmp_path / "a"))


def test_hosts_with_colons_stand_in_brackets() -> None:
    assert (at_port("::1", 5), at_port("localhost", 5)) == ("[::1]:5", "localhost:5")


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="no writable folder below /dev")
async def test_links_that_old_programs_take_for_hosts(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        for link, is_reported in ((tmp_path / "line", True), (Path(folder) / "line", False)):
            caplog.clear()
            await opened("--serial-link", str(link))
            assert (f"--serial-link {link}: old C programs" in caplog.text) == is_reported
