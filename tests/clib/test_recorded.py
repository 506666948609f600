"""The C library against the recorded sessions: bytes sent and client state, at 64 and at 32 bits."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import COMMANDS
from nclient.protocol.types import EVERYTHING
from tests.clib.clib_build import PROGRAMS, BuildCache, BuildKind, run_calls
from tests.nclient.protocol.recorded import LINE_SESSIONS, LP64, SERIAL, TCP, TCP_SESSIONS, exchanges, model_of

TIMEOUT_S = 30.0
Cases = list[dict[str, Any]]
Step = tuple[str, bytes, bytes]


def script_of(cases: Cases) -> str:
    """Return the calls of a session, one per line."""
    lines = []
    for case in cases:
        args = case["args"]
        lines.append(f"{case['call']} {args if isinstance(args, str) else ' '.join(map(str, args))}".rstrip())
    return "\n".join(lines) + "\n"


class ReplayServer(threading.Thread):
    """The peer in a recorded session: compares each request with the recorded bytes and sends the recorded reply."""

    def __init__(
        self, script: list[Step], read: Callable[[int], bytes], write: Callable[[bytes], Any]
    ) -> None:
        super().__init__(daemon=True)
        self._script, self._read, self._write = script, read, write
        self.mismatches: list[str] = []
        self.played = 0

    def run(self) -> None:
        for call, wanted, reply in self._script:
            request = b""
            # A stream may deliver a request in pieces.
            while len(request) < len(wanted):
                try:
                    data = self._read(len(wanted) - len(request))
                except OSError:
                    data = b""
                if not data:
                    self.mismatches.append(f"connection closed in {call}")
                    return
                request += data
            if comparable(call, request) != comparable(call, wanted):
                self.mismatches.append(f"{call}: {request.hex()} for {wanted.hex()}")
            self._write(reply)
            self.played += 1


def comparable(call: str, request: bytes) -> bytes:
    """Return a TCP request without its undefined parts: process id and unused words."""
    # Types 0x66 and 0x67, connect and disconnect: the last word is the process number.
    if request[:2] in (b"\0\x66", b"\0\x67"):
        return request[:-4]
    # A line uses five of the eight words.
    if call == "motion_check" and request[4:8] == bytes(4):
        return request[:-12]
    if call.startswith("tk ") and request[0] == 0:
        # The last word of a text holds its end and NUL in the low bytes; the rest of it is undefined.
        used = (len(call) - len("tk ")) % 4 + 1
        return request[:-4] + request[-used:]
    return request


def check(case: dict[str, Any], found: dict[str, Any]) -> None:
    """Compare the recorded values of a call with the values found."""
    for name, wanted in case["decoded"].items():
        match name:
            case "return" if "arm" in case["decoded"]:
                continue
            case "arm":
                value = found["return"]
            case "remain" if "remain" not in found:
                value = 0
            case "remain":
                (value,) = found["remain"]
            case "volt_cpu" | "volt_motor":
                assert found[name] == pytest.approx(wanted, abs=1e-5), case["call"]
                continue
            case _:
                value = found[name]
        if isinstance(wanted, list):
            # Arrays of C are longer than what was recorded.
            value = value[: len(wanted)]
        assert value == wanted, (case["call"], name)


@contextlib.contextmanager
def on_socket(steps: list[Step], hello: bytes = b"") -> Iterator[tuple[str, ReplayServer]]:
    """Run a replay server on a TCP port and yield the port."""
    with contextlib.ExitStack() as open_things:
        listener = open_things.enter_context(socket.create_server(("127.0.0.1", 0)))
        accepted: list[socket.socket] = []

        def read(count: int) -> bytes:
            if not accepted:
                accepted.append(open_things.enter_context(listener.accept()[0]))
                accepted[0].sendall(hello)
            return accepted[0].recv(count)

        def write(data: bytes) -> None:
            accepted[0].sendall(data)

        server = ReplayServer(steps, read, write)
        server.start()
        yield str(listener.getsockname()[1]), server
        server.join(TIMEOUT_S)


@contextlib.contextmanager
def on_terminal(steps: list[Step]) -> Iterator[tuple[str, ReplayServer]]:
    """Run a replay server on a pseudo-terminal and yield its name."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        server = ReplayServer(steps, lambda count: os.read(master, count), lambda data: os.write(master, data))
        server.start()
        yield os.ttyname(slave), server
        os.close(slave)
        server.join(TIMEOUT_S)
    finally:
        os.close(master)


@pytest.mark.parametrize("session", TCP_SESSIONS)
def test_recorded_tcp_session(session: str, kind: BuildKind, builds: BuildCache) -> None:
    cases: Cases = TCP[session]
    program = builds.program(PROGRAMS / "replay.c", kind)
    steps = [
        (f"tk {case['args']}" if case["call"] == "tk" else case["call"],
         bytes.fromhex(exchange["request"]), bytes.fromhex(exchange.get("reply", "")))
        for case in cases for exchange in case["exchanges"]
    ]  # fmt: skip
    with on_socket(steps) as (port, server):
        *found, _ = run_calls([str(program), port], script_of(cases))
    assert server.mismatches == []
    assert server.played == len(steps)
    assert len(cases) > 20
    for case, after in zip(cases, found, strict=True):
        check(case, after)


def with_32_bit_words(message: bytes, value_at: int) -> bytes:
    """Convert a message of the old library's 64-bit build from eight to four bytes per word."""
    words = [message[k + value_at : k + value_at + 4] for k in range(4, len(message), 8)]
    return message[:4] + b"".join(words)


def test_64_bit_errors_of_old_library_are_fixed(kind: BuildKind, builds: BuildCache) -> None:
    # the requests and replies of the 64-bit build, with the word size of the protocol
    steps = [
        (
            str(k),
            with_32_bit_words(bytes.fromhex(exchange["request"]), 4),
            with_32_bit_words(bytes.fromhex(exchange.get("reply", "")), 0),
        )
        for k, exchange in enumerate(LP64["exchanges"])
    ]
    program = builds.program(PROGRAMS / "replay.c", kind)
    with on_socket(steps) as (port, server):
        *found, _ = run_calls([str(program), port], "connect_robot 1\nvm 100 -50 0\ngs\ndisconnect_robot 1\n")
    assert server.mismatches == []
    for after, old in zip(found, LP64["decoded"], strict=True):
        # The recorded 64-bit client had 2^32 - 200 here; the new library must have -200, and equal values otherwise.
        assert old["State"][35] == 2**32 - 200
        assert after["State"] == [*old["State"][:35], -200, *old["State"][36:]]
        assert (after["return"], after["time"]) == (old["return"], old["time"])


@pytest.mark.parametrize("session", LINE_SESSIONS)
def test_recorded_serial_session(session: str, kind: BuildKind, builds: BuildCache) -> None:
    cases: Cases = SERIAL[session]
    model = model_of(session)
    program = str(builds.program(PROGRAMS / "replay.c", kind, "ndirect"))
    steps = [(x.call.name, x.request, x.reply) for x in exchanges(cases, model)]
    # Only a N200 on TCP sends its mask first.
    if session.endswith("_tcp"):
        hello = build_handshake(Handshake(EVERYTHING, 51)) if model.name == "n200" else b""
        with on_socket(steps, hello) as (port, server):
            *found, last = run_calls([program, str(model.number), "127.0.0.1", port], script_of(cases))
    else:
        with on_terminal(steps) as (terminal, server):
            *found, last = run_calls([program, str(model.number), terminal, "38400"], script_of(cases))
    assert server.mismatches == []
    assert server.played == len(steps)
    for case, after in zip(cases, found, strict=True):
        check(case, after)
    for expected in (line for case in cases for line in case.get("prints", ())):
        assert expected in last["stderr"].splitlines()


def test_every_command_was_recorded_or_is_new() -> None:
    recorded = {case["call"] for session in TCP_SESSIONS for case in TCP[session]}
    recorded |= {case["call"] for session in LINE_SESSIONS for case in SERIAL[session]}
    assert {row.name for row in COMMANDS} - recorded == {
        "create_robot", "conf_ser", "sim_truth", "sim_control", "held_by"
    }  # fmt: skip


def test_builds_are_outside_the_source_tree(builds: BuildCache) -> None:
    assert not builds.folder.is_relative_to(Path(__file__).parents[2])
