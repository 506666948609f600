"""The pseudo-terminal and its link: replacement, cleanup, and detection of hosts."""

from __future__ import annotations

import contextlib
import os
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient.errors import ConnectionLost
from nserver_emu.server.pty import _BAUD_CHECK_INTERVAL_S, PseudoTerminal


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the path of the link."""
    return tmp_path / "nomad"


@pytest.fixture
def terminal(path: Path) -> Iterator[PseudoTerminal]:
    made = PseudoTerminal(path)
    yield made
    made.close()


def set_baud(host: int, speed: int) -> None:
    settings = termios.tcgetattr(host)
    # Input and output speed.
    settings[4] = settings[5] = speed
    termios.tcsetattr(host, termios.TCSANOW, settings)


def opened(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def received(host: int) -> bytes:
    """Return all that the host's end has: the system may pass two writes on one after the other."""
    data = b""
    with contextlib.suppress(BlockingIOError):
        while True:
            data += os.read(host, 100)
    return data


def test_bytes_pass_unchanged_in_both_directions(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    # Includes the control characters (^C, XON, XOFF, CR, LF) that a terminal in cooked mode would interpret.
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
    # Bytes sent just before the close are read before the end.
    os.write(host, b"last bytes")
    os.close(host)
    assert [*closed, terminal.is_closed] == [True, False, True]
    assert terminal.read(1000) == b"last bytes"
    # None: the host closed its end (EIO).
    assert terminal.read(1000) is None


def test_reset_discards_bytes_and_settings(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    settings = termios.tcgetattr(host)
    # A host may leave the port in cooked mode with echo.
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


def test_changes_of_the_baud_rate_are_noticed(
    terminal: PseudoTerminal, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    host = opened(path)

    def exchanged() -> tuple[bytes | None, bytes]:
        os.write(host, b"request")
        read = terminal.read(100)
        # At a wrong rate the request itself is answered with noise.
        terminal.write(b"reply")
        return read, received(host)

    assert exchanged() == (b"request", b"reply")
    # 1. Another rate counts after the interval, from the first byte.
    set_baud(host, termios.B9600)
    assert exchanged() == (b"request", b"reply")
    now_s += _BAUD_CHECK_INTERVAL_S
    read, answer = exchanged()
    assert read == b""
    assert len(answer) == len(b"request" + b"reply")
    assert all(byte & 0x80 for byte in answer)
    # 2. The right one counts at once.
    set_baud(host, termios.B38400)
    assert exchanged() == (b"request", b"reply")
    # 3. The next host's rate counts at once, too.
    os.close(host)
    assert terminal.read(1) is None
    terminal.reset()
    host = opened(path)
    set_baud(host, termios.B9600)
    assert exchanged()[0] == b""
    os.close(host)


def test_writing_to_a_full_terminal_does_not_block(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    # The kernel's buffer is some kilobytes; nothing reads it.
    while terminal.write(bytes(1000)):
        pass
    assert terminal.write(b"x") == 0
    os.close(host)


def test_replace_hangs_up_and_links_a_new_terminal(terminal: PseudoTerminal, path: Path) -> None:
    host = opened(path)
    terminal.replace()
    # As an unplugged adapter: end of file for reads, EIO for writes.
    assert os.read(host, 10) == b""
    with pytest.raises(OSError, match="Input/output error"):
        os.write(host, b"x")
    other = opened(path)
    os.write(other, b"y")
    assert terminal.read(10) == b"y"
    for end in (host, other):
        os.close(end)


def test_replaced_terminal_is_closed_after_the_link_leads_to_another(terminal: PseudoTerminal, path: Path) -> None:
    # No host keeps the old one open, so that its number is free as soon as the server closes it.
    old = path.readlink()
    terminal.replace()
    assert path.readlink() != old
    assert not old.exists()


def test_failed_replacement_closes_the_old_terminal(terminal: PseudoTerminal, path: Path) -> None:
    old = path.readlink()
    path.unlink()
    path.mkdir()
    with pytest.raises(ConnectionLost, match="no symbolic link"):
        terminal.replace()
    assert not old.exists()
    assert terminal.fd == -1
    path.rmdir()


def test_the_link_is_gone_at_the_end(path: Path) -> None:
    terminal = PseudoTerminal(path)
    assert path.is_symlink()
    terminal.close()
    assert not os.path.lexists(path)
    terminal.close()


def test_a_stale_link_is_replaced_and_a_foreign_one_stays(path: Path) -> None:
    # The link of a daemon that was killed points to a terminal that no longer exists.
    path.symlink_to("/dev/pts/no-more")
    terminal = PseudoTerminal(path)
    assert path.resolve().is_char_device()
    path.unlink()
    # A link that another program has put there meanwhile is not removed.
    path.symlink_to("elsewhere")
    terminal.close()
    assert path.readlink() == Path("elsewhere")


def test_a_link_is_put_back_where_it_can_be(terminal: PseudoTerminal, path: Path) -> None:
    assert not terminal.restore_link()
    path.unlink()
    assert terminal.restore_link()
    assert path.readlink() == Path(terminal.device)
    path.unlink()
    # Without its folder the link cannot be created; that is no error.
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
        PseudoTerminal(path)
    assert path.readlink() == Path(terminal.device)
    # The same path, by another name of its folder.
    folder = path.parent.with_name("folder")
    folder.symlink_to(path.parent)
    with pytest.raises(ConnectionLost, match="another running nserver"):
        PseudoTerminal(folder / path.name)


def test_without_abstract_sockets_the_last_server_has_the_link(
    path: Path, terminal: PseudoTerminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The claim of a path is an abstract Unix socket, which only Linux has.
    monkeypatch.setattr("sys.platform", "darwin")
    other = PseudoTerminal(path)
    assert path.readlink() == Path(other.device) != Path(terminal.device)
    other.close()


def test_a_missing_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConnectionLost, match="No such file"):
        PseudoTerminal(tmp_path / "no" / "where")


def test_writes_without_host_are_dropped(path: Path) -> None:
    terminal = PseudoTerminal(path)
    # A closed descriptor stands for a terminal that has gone.
    os.close(terminal.fd)
    assert terminal.write(b"x") == 1
    with pytest.raises(OSError, match="Bad file descriptor"):
        terminal.read(1)
    terminal.fd = os.open(os.devnull, os.O_RDWR)
    terminal.close()
