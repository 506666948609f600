"""The pseudo-terminal and its link: what is replaced, what stays, and what shows of hosts that come and go."""

from __future__ import annotations

import os
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient.errors import ConnectionLost
from nserver_emu.server.pty import PseudoTerminal


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where the link is to be."""
    return tmp_path / "nomad"


@pytest.fixture
def terminal(path: Path) -> Iterator[PseudoTerminal]:
    made = PseudoTerminal(path)
    yield made
    made.close()


def opened(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def test_bytes_go_both_ways_as_they_are(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    every_byte = bytes(range(256))
    os.write(host, every_byte)
    assert terminal.read(1000) == every_byte
    assert terminal.read(1000) == b""
    assert terminal.write(every_byte) == 256
    assert os.read(host, 1000) == every_byte
    os.close(host)


def test_hosts_that_come_and_go_are_seen(terminal: PseudoTerminal, path: Path) -> None:
    closed = [terminal.is_closed]
    host = opened(path)
    closed.append(terminal.is_closed)
    os.write(host, b"last words")
    os.close(host)
    assert [*closed, terminal.is_closed] == [True, False, True]
    assert terminal.read(1000) == b"last words"
    assert terminal.read(1000) is None


def test_the_next_host_finds_neither_bytes_nor_settings_of_the_last(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    settings = termios.tcgetattr(host)
    settings[tty.LFLAG] |= termios.ECHO | termios.ICANON
    termios.tcsetattr(host, termios.TCSANOW, settings)
    terminal.write(b"unread")
    os.close(host)
    terminal.reset()
    assert terminal.is_closed
    host = opened(path)
    assert not termios.tcgetattr(host)[tty.LFLAG] & (termios.ECHO | termios.ICANON)
    with pytest.raises(BlockingIOError):
        os.read(host, 100)
    os.close(host)


def test_a_host_that_does_not_read_makes_nobody_wait(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    while terminal.write(bytes(1000)):
        pass
    assert terminal.write(b"x") == 0
    os.close(host)


def test_a_pulled_one_is_dead_to_its_host_and_the_link_leads_to_another(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    terminal.replace()
    assert os.read(host, 10) == b""
    with pytest.raises(OSError, match="Input/output error"):
        os.write(host, b"x")
    other = opened(path)
    os.write(other, b"y")
    assert terminal.read(10) == b"y"
    for end in (host, other):
        os.close(end)


def test_the_link_is_gone_at_the_end(path: Path) -> None:
    terminal = PseudoTerminal(path)
    assert path.is_symlink()
    terminal.close()
    assert not os.path.lexists(path)
    terminal.close()


def test_a_link_that_a_killed_daemon_left_is_replaced_and_one_that_somebody_else_made_since_stays(path: Path) -> None:
    path.symlink_to("/dev/pts/no-more")
    terminal = PseudoTerminal(path)
    assert path.resolve().is_char_device()
    path.unlink()
    path.symlink_to("elsewhere")
    terminal.close()
    assert path.readlink() == Path("elsewhere")


def test_a_link_is_put_back_where_it_can_be(terminal: PseudoTerminal, path: Path) -> None:
    assert not terminal.restore_link()
    path.unlink()
    assert terminal.restore_link()
    assert path.readlink() == Path(terminal.device)
    path.unlink()
    path.parent.rmdir()
    assert not terminal.restore_link()


def test_what_is_no_link_stays_and_the_remedy_is_named(path: Path) -> None:
    path.write_text("precious")
    with pytest.raises(ConnectionLost, match="no symbolic link"):
        PseudoTerminal(path)
    assert path.read_text() == "precious"
    assert [entry.name for entry in path.parent.iterdir()] == ["nomad"]


def test_the_line_of_another_daemon_stays_its_own(terminal: PseudoTerminal, path: Path) -> None:
    with pytest.raises(ConnectionLost, match="another running nserver"):
        PseudoTerminal(path.parent / "." / "nomad")
    assert path.readlink() == Path(terminal.device)


def test_without_a_way_to_tell_other_daemons_the_last_one_has_the_link(
    path: Path, terminal: PseudoTerminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "darwin")
    other = PseudoTerminal(path)
    assert path.readlink() == Path(other.device) != Path(terminal.device)
    other.close()


def test_a_place_that_is_none_says_so(tmp_path: Path) -> None:
    with pytest.raises(ConnectionLost, match="No such file or directory"):
        PseudoTerminal(tmp_path / "no" / "where")


def test_what_is_written_for_nobody_is_gone_and_other_errors_are_told(path: Path) -> None:
    terminal = PseudoTerminal(path)
    os.close(terminal.fd)
    assert terminal.write(b"x") == 1
    with pytest.raises(OSError, match="Bad file descriptor"):
        terminal.read(1)
    terminal.fd = os.open(os.devnull, os.O_RDWR)
    terminal.close()
