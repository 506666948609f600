"""Run the TLS tunnel of docs/security.md with stunnel at both ends, and check the ssh command with `ssh -G`."""

from __future__ import annotations

import contextlib
import re
import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import connect
from nclient.protocol import codec
from nclient.protocol.commands import Call
from tests.docs.pages import code_blocks

PAGE = "security.md"
TIMEOUT_S = 60.0
# Type of a TLS record that reports an error.
TLS_ALERT = b"\x15"
STUNNEL = shutil.which("stunnel4") or "stunnel"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextlib.contextmanager
def running(*command: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=cwd) as process:
        try:
            yield process
        finally:
            process.terminate()


def wait_for_port(port: int) -> None:
    """Return when the port accepts connections."""
    end_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end_s:
        with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
            return
        time.sleep(0.05)
    raise AssertionError(f"port {port} does not accept connections")


def reply_to_connect(port: int, keys: ssl.SSLContext | None) -> bytes:
    """Return the reply to CONNECT over TLS or plain TCP, empty if the connection is closed."""
    plain = socket.create_connection(("127.0.0.1", port), TIMEOUT_S)
    with plain, contextlib.suppress(OSError), keys.wrap_socket(plain) if keys else plain as stream:
        stream.sendall(codec.encode_tcp_request(Call("connect_robot", (1, 1))))
        return stream.recv(8)
    return b""


@pytest.fixture(scope="module")
def ports(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, int, Path]]:
    """Run both ends and a daemon; yield the ports of the lab's and the program's end, and the folder of the keys."""
    folder = tmp_path_factory.mktemp("tunnel")
    *keys, _ = code_blocks(PAGE, "sh")
    for command in keys:
        subprocess.run(["bash", "-c", command], cwd=folder, capture_output=True, check=True)
    ends = {re.match(r"; (\w+\.conf)\n", text)[1]: text for text in code_blocks(PAGE, "ini")}  # type: ignore[index]
    daemon = [sys.executable, "-m", "nserver_emu", "--port", "0"]
    with contextlib.ExitStack() as stack:
        nserver = stack.enter_context(running(*daemon, cwd=folder))
        assert nserver.stdout is not None
        inner, outer, near = int(nserver.stdout.readline().rpartition(":")[2]), free_port(), free_port()
        # Only ports are replaced: the rest of both files is as on the page.
        lab = ends["lab.conf"].replace("0.0.0.0:7020", f"127.0.0.1:{outer}").replace(":7019", f":{inner}")
        me = ends["me.conf"].replace("lab.example:7020", f"127.0.0.1:{outer}").replace(":7019", f":{near}")
        assert "702" not in lab.replace(str(outer), "")
        for name, text, port in (("lab.conf", lab, outer), ("me.conf", me, near)):
            (folder / name).write_text(text)
            stack.enter_context(running(STUNNEL, name, cwd=folder))
            wait_for_port(port)
        yield outer, near, folder


def test_program_drives_through_the_tunnel(ports: tuple[int, int, Path]) -> None:
    _, near, _ = ports
    with connect(f"nserver://localhost:{near}/1") as robot:
        robot.move(translation_in=2)
        assert robot.wait_until_still(timeout_s=20).x_in == pytest.approx(2.0)
    nomad, *words = code_blocks(PAGE, "sh")[-1].strip().replace("7019", str(near)).split()
    command = [str(Path(sys.executable).with_name(nomad)), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "2.0" in done.stdout


def test_client_without_trusted_key_gets_no_reply(ports: tuple[int, int, Path]) -> None:
    outer, _, folder = ports
    # A client that trusts the lab's certificate, and has none of its own.
    keyless = ssl.create_default_context(cafile=str(folder / "lab.pem"))
    keyless.check_hostname = False
    trusted = ssl.create_default_context(cafile=str(folder / "lab.pem"))
    trusted.check_hostname = False
    trusted.load_cert_chain(folder / "me.pem", folder / "me.key")
    # Type 0x52 = 82: the reply to CONNECT.
    assert reply_to_connect(outer, trusted)[:2] == b"\0\x52", "with the key: the reply to CONNECT"
    assert reply_to_connect(outer, keyless) == b""
    # Without TLS: an alert record, or the end of the connection.
    assert reply_to_connect(outer, None)[:1] in (b"", TLS_ALERT)


def test_ssh_command_forwards_the_port() -> None:
    (line,) = [block for block in code_blocks(PAGE, "console") if "ssh" in block]
    _, ssh, *words = line.split()
    # -G prints the options that ssh would use, and connects to nothing.
    config = subprocess.run([ssh, "-G", *words], capture_output=True, text=True, check=True).stdout
    assert "localforward 7019 [127.0.0.1]:7019" in config
    assert "\nhostname lab\n" in config
