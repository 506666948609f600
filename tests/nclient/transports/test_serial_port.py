"""Serial streams on a pseudo-terminal: transfer, locking, and errors."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import select
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports import serial as serial_port
from nclient.transports.serial import PortableSerialStream, SerialStream
from nclient.transports.stream import Deadline


class Pty:
    """Both ends of a pseudo-terminal; `far` is the end of the robot."""

    def __init__(self) -> None:
        self.far, self._near = os.openpty()
        # Raw mode: no echo, no translation of line ends, no control characters.
        tty.setraw(self._near)
        self.name = os.ttyname(self._near)

    def disconnect(self) -> None:
        """Close both ends, like a disconnected cable."""
        if self.far >= 0:
            os.close(self.far)
            os.close(self._near)
            self.far = -1


Opener = type[SerialStream] | type[PortableSerialStream]


@pytest.fixture(params=[SerialStream, PortableSerialStream])
def open_stream(request: pytest.FixtureRequest) -> Opener:
    """Return each of the two kinds of ports."""
    kind: Opener = request.param
    return kind


def wait_for_byte(stream: SerialStream | PortableSerialStream) -> None:
    """Wait until a byte has arrived, without taking it."""
    if isinstance(stream, SerialStream):
        assert select.select([stream._file], [], [], 5)[0]
    else:
        with stream._arrived:
            assert stream._arrived.wait_for(lambda: stream._received, 5)


@pytest.fixture
def pty() -> Iterator[Pty]:
    made = Pty()
    yield made
    made.disconnect()


def test_bytes_are_transferred_unchanged(open_stream: Opener, pty: Pty) -> None:
    stream = open_stream(pty.name)
    data = bytes(range(256))
    stream.send(data)
    assert os.read(pty.far, 1024) == data
    os.write(pty.far, data)
    got = b""
    while len(got) < len(data):
        got += stream.receive(Deadline.after(5))
    assert got == data
    stream.close()


def test_past_deadline_returns_available_bytes(open_stream: Opener, pty: Pty) -> None:
    stream = open_stream(pty.name)
    with pytest.raises(ReplyTimeout, match=f"{pty.name} was silent"):
        stream.receive(Deadline.after(0))
    os.write(pty.far, b"x")
    wait_for_byte(stream)
    assert stream.receive(Deadline.after(0)) == b"x"
    with pytest.raises(ReplyTimeout):
        stream.receive(Deadline.after(0.03))
    stream.close()


def test_bytes_arriving_while_waiting(open_stream: Opener, pty: Pty) -> None:
    stream = open_stream(pty.name)
    later = threading.Timer(0.1, os.write, (pty.far, b"late"))
    later.start()
    # The first byte may be received alone.
    assert b"late".startswith(stream.receive(Deadline.after(5)))
    later.join()
    stream.close()


def test_closing_in_another_thread_ends_the_wait(open_stream: Opener, pty: Pty) -> None:
    stream = open_stream(pty.name)
    closing = threading.Timer(0.1, stream.close)
    closing.start()
    with pytest.raises(ConnectionLost, match="this end"):
        stream.receive(Deadline.after(30))
    closing.join()
    stream.close()
    for use in (lambda: stream.send(b"x"), lambda: stream.receive(Deadline.after(1))):
        with pytest.raises(ConnectionLost, match="this end"):
            use()


def test_large_data_is_sent_in_parts(open_stream: Opener, pty: Pty) -> None:
    stream = open_stream(pty.name)
    # More than the buffer of a terminal.
    data = bytes(range(256)) * 400
    got = bytearray()

    def drain() -> None:
        while len(got) < len(data):
            got.extend(os.read(pty.far, 4096))

    # The reader starts late, so that the first write does not take everything.
    draining = threading.Timer(0.1, drain)
    draining.start()
    stream.send(data)
    draining.join()
    assert got == data
    stream.close()


def test_write_timeout_means_connection_lost(open_stream: Opener, pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    def send_for_ever() -> None:
        while True:
            stream.send(bytes(65536))

    monkeypatch.setattr(serial_port, "WRITE_TIMEOUT_S", 0.1)
    stream = open_stream(pty.name)
    with pytest.raises(ConnectionLost, match=r"is gone \(Write timeout"):
        send_for_ever()
    stream.close()


def test_full_port_is_retried(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    write, full = os.write, [True]

    def refuse_once(file: int, data: bytes) -> int:
        if full:
            full.clear()
            # The port accepts nothing at this moment, although it was reported as writable.
            raise BlockingIOError
        return write(file, data)

    stream = SerialStream(pty.name)
    monkeypatch.setattr(os, "write", refuse_once)
    stream.send(b"hello")
    assert os.read(pty.far, 10) == b"hello"
    stream.close()


def test_read_error_means_connection_lost(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> bytes:
        raise OSError(errno.EIO, "Input/output error")

    stream = SerialStream(pty.name)
    os.write(pty.far, b"x")
    monkeypatch.setattr(os, "read", fail)
    with pytest.raises(ConnectionLost, match=r"is gone .*Input/output error"):
        stream.receive(Deadline.after(5))
    stream.close()


def test_disconnected_cable(open_stream: Opener, pty: Pty) -> None:
    stream = open_stream(pty.name)
    pulling = threading.Timer(0.1, pty.disconnect)
    pulling.start()
    with pytest.raises(ConnectionLost, match=f"{pty.name} is gone.*cable"):
        stream.receive(Deadline.after(30))
    pulling.join()
    with pytest.raises(ConnectionLost, match=f"{pty.name} is gone"):
        stream.send(b"x")
    stream.close()


def test_port_in_use_error_names_process(open_stream: Opener, pty: Pty) -> None:
    first = open_stream(pty.name)
    with pytest.raises(ConnectionLost, match=f"{pty.name} .*this very program"):
        open_stream(pty.name)
    first.close()
    open_stream(pty.name).close()
    # Another process locks the port as pyserial does.
    holds = "import sys,serial; p=serial.Serial(sys.argv[1],exclusive=True); print(flush=True); sys.stdin.read()"
    other = subprocess.Popen([sys.executable, "-c", holds, pty.name], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with other:
        assert other.stdout is not None
        other.stdout.readline()
        with pytest.raises(ConnectionLost, match=rf"in use .*\(process {other.pid}\).*one program"):
            open_stream(pty.name)
        other.communicate(timeout=10)
    open_stream(pty.name).close()


def test_missing_port_error_lists_ports(open_stream: Opener, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_port, "ports", lambda: ["/dev/ttyUSB7"])
    with pytest.raises(ConnectionLost, match=r"plugged in.*/dev/ttyUSB7"):
        open_stream(str(tmp_path / "ttyUSB0"))
    monkeypatch.setattr(serial_port, "ports", list)
    with pytest.raises(ConnectionLost, match="none at all"):
        open_stream(str(tmp_path / "ttyUSB0"))


def test_invalid_port_and_baud_rate(open_stream: Opener, tmp_path: Path, pty: Pty) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConnectionLost, match="cannot be opened"):
        open_stream(str(tmp_path / "file"))
    with pytest.raises(ConnectionLost, match=f"{pty.name} .* at -1 baud"):
        open_stream(pty.name, -1)


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (serial.SerialException(errno.EACCES, "could not open port"), "no permission.*dialout"),
        (serial.SerialException(errno.EBUSY, "could not open port"), "in use by another program"),
        (serial.SerialException(errno.EIO, "could not open port"), "cannot be opened: .*could not open port"),
    ],
)
def test_other_system_errors(monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(ConnectionLost, match=reason):
        SerialStream("/dev/ttyUSB0")


# select() cannot wait for a file descriptor of 1024 or more: the port must use poll().
def test_file_descriptor_above_1024(pty: Pty) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.ExitStack() as stack:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        stack.callback(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard))
        opened = 0
        # Open files until the next descriptor is 1024 or more.
        while opened < 1024:
            opened = os.open(os.devnull, os.O_RDONLY)
            stack.callback(os.close, opened)
        stream = SerialStream(pty.name)
        stack.callback(stream.close)
        os.write(pty.far, b"hello")
        assert stream.receive(Deadline.after(2)) == b"hello"
        with pytest.raises(ReplyTimeout):
            stream.receive(Deadline.after(0.01))


def test_ports_are_names() -> None:
    assert all(isinstance(name, str) for name in serial_port.ports())
