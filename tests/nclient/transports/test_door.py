"""Doors: one peer after the other, by TCP and by a pseudo-terminal, and what is said where there can be none."""

from __future__ import annotations

import os
import socket
import threading
import tty
from pathlib import Path

import pytest

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.listener import TcpDoor, TerminalDoor
from nclient.transports.stream import Deadline
from nclient.transports.tcp import TcpStream


def test_peers_come_and_go_at_a_port() -> None:
    door = TcpDoor("127.0.0.1", 0)
    try:
        assert door.name == f"127.0.0.1:{door.port}"
        for word in (b"one", b"two"):
            guest = TcpStream("127.0.0.1", door.port)
            peer = door.peer()
            guest.send(word)
            assert peer.receive(Deadline.after(5)) == word
            peer.send(word * 2)
            assert guest.receive(Deadline.after(5)) == word * 2
            guest.close()
            with pytest.raises(ConnectionLost, match="has left"):
                peer.receive(Deadline.after(5))
            peer.close()
        with pytest.raises(ConnectionLost, match="port 0 takes a free one"):
            TcpDoor("127.0.0.1", door.port)
    finally:
        door.close()
        door.close()
    with pytest.raises(ConnectionLost):
        TcpStream("127.0.0.1", door.port)


def test_the_other_internet() -> None:
    if not socket.has_ipv6:
        pytest.skip("this machine has none")
    try:
        door = TcpDoor("::1", 0)
    except ConnectionLost:
        pytest.skip("this machine's loopback has none")
    assert door.name == f"[::1]:{door.port}"
    door.close()


def opened(link: Path) -> int:
    fd = os.open(link, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    return fd


def test_peers_come_and_go_at_a_pseudo_terminal(tmp_path: Path) -> None:
    link = tmp_path / "robot"
    link.symlink_to("/nowhere")
    door = TerminalDoor(link)
    try:
        guests: list[int] = []
        for _ in range(2):
            guests.clear()
            timer = threading.Timer(0.05, lambda: guests.append(opened(link)))
            timer.start()
            peer = door.peer()
            timer.join()
            with pytest.raises(ReplyTimeout):
                peer.receive(Deadline.after(0))
            os.write(guests[0], bytes(range(256)))
            assert peer.receive(Deadline.after(5)) == bytes(range(256))
            peer.send(b"\x00\x03\x04\x11\x13\x1a\xff")
            assert os.read(guests[0], 100) == b"\x00\x03\x04\x11\x13\x1a\xff"
            os.close(guests[0])
            with pytest.raises(ConnectionLost, match="has left"):
                peer.receive(Deadline.after(5))
            peer.close()
    finally:
        door.close()
        door.close()
    assert not link.is_symlink()


def test_a_peer_that_does_not_read_loses_what_is_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nclient.transports.listener._TAKING_S", 0.05)
    door = TerminalDoor(tmp_path / "robot")
    try:
        fd = opened(tmp_path / "robot")
        door.peer().send(bytes(1_000_000))
        os.close(fd)
    finally:
        door.close()


def test_a_door_that_is_closed_behind_its_peer(tmp_path: Path) -> None:
    door = TerminalDoor(tmp_path / "robot")
    fd = opened(tmp_path / "robot")
    peer = door.peer()
    door.close()
    os.close(fd)
    with pytest.raises(ConnectionLost, match="has left"):
        peer.send(b"late")
    with pytest.raises(ConnectionLost, match="has left"):
        peer.receive(Deadline.after(5))


def test_what_is_there_stays(tmp_path: Path) -> None:
    taken = tmp_path / "file"
    taken.write_text("mine")
    with pytest.raises(ConnectionLost, match="is there and no symbolic link: it stays"):
        TerminalDoor(taken)
    with pytest.raises(ConnectionLost, match="cannot make the serial link"):
        TerminalDoor(tmp_path / "no" / "robot")
    door = TerminalDoor(tmp_path / "robot")
    (tmp_path / "robot").unlink()
    (tmp_path / "robot").symlink_to("/elsewhere")
    door.close()
    assert (tmp_path / "robot").is_symlink()
