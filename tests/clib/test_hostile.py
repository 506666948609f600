"""Invalid replies: the C library rejects them with an error, without crashing or reading out of bounds."""

from __future__ import annotations

import random
import re
import socket
import subprocess
import threading
from collections.abc import Iterator

from nclient.protocol import codec
from nclient.protocol.commands import NAK_TYPE
from nclient.protocol.types import N150, Model, WireState, serial_wire_state, tcp_wire_state
from tests.clib.clib_build import PROGRAMS, SANITIZED, BuildCache, BuildKind, run_calls
from tests.nclient.protocol.recorded import LINE_SESSIONS, SERIAL, TCP, TCP_SESSIONS, Exchange, exchanges, model_of

MUTATED = 20_000
ROUNDS = 120


def corpus() -> Iterator[str]:
    """Yield a line for every recorded reply, with the wire state under which it was received."""
    for session in TCP_SESSIONS:
        yield from corpus_lines(exchanges(TCP[session], None), tcp_wire_state(N150), None)
    for session in LINE_SESSIONS:
        model = model_of(session)
        yield from corpus_lines(exchanges(SERIAL[session], model), serial_wire_state(model), model)


def corpus_lines(session: Iterator[Exchange], wire_state: WireState, model: Model | None) -> Iterator[str]:
    for exchange in session:
        reply = exchange.reply
        codec.update_from_request(exchange.call, wire_state)
        # Error replies and NAKs carry no data that could be decoded.
        if not reply or (reply[:2] == b"\0\x5b" if model is None else reply[3] == NAK_TYPE):
            continue
        # Without the header of the message, or head and end of the frame.
        data = reply[4:] if model is None else reply[4:-2]
        mask = wire_state.mask.smask
        yield (
            f"{'T' if model is None else 'L'} {exchange.call.name} {wire_state.model.number} {wire_state.laser_mode} "
            f"{wire_state.laser_width} {mask[0]} {''.join(map(str, mask[1:]))} .{data.hex()}\n"
        )


def test_mutated_replies_are_decoded_or_rejected(kind: BuildKind, builds: BuildCache) -> None:
    program = builds.program(PROGRAMS / "fuzz.c", kind, extra_libraries=("-lndirect",))
    # Without sanitizers an invalid access is seldom noticed: fewer examples are enough.
    times = MUTATED if kind.sanitized else MUTATED // 10
    done = subprocess.run([str(program), "20260", str(times)], input="".join(corpus()), capture_output=True, text=True,
                          timeout=60, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    counts = re.fullmatch(rf"(\d+) recorded, {times} mutated: (\d+) decoded, (\d+) rejected\n", done.stdout)
    assert counts
    # Both outcomes must be frequent, since a decoder that rejects everything would pass.
    assert int(counts[1]) > 180
    assert int(counts[2]) > times // 10
    assert int(counts[3]) > times // 10


CONNECTED = (bytes.fromhex(TCP["session_1"][0]["exchanges"][0]["reply"]),
             bytes.fromhex(TCP["session_1"][0]["exchanges"][1]["reply"]))  # fmt: skip
HOSTILE_CALLS = ("gs", "get_sn", "get_rpx", "move_obstacle", "special_request", "predict_sensors", "get_robot_conf")


def mutated(rng: random.Random, reply: bytes) -> bytes:
    """Return a reply with changed bytes, count, or length."""
    data = bytearray(reply)
    for _ in range(rng.randrange(1, 4)):
        # Bytes 2 and 3 are the count, 4 to 7 the first word: errors in them change sizes.
        at = rng.choice((2, 3, 4, 5, 6, 7, rng.randrange(len(data))))
        data[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    if rng.random() < 0.3:
        del data[rng.randrange(4, len(data)) :]
    return bytes(data)


def serve(listener: socket.socket, replies: list[bytes]) -> None:
    """Accept clients one by one, send each its reply after the handshake, and close the connection."""
    for reply in replies:
        with listener.accept()[0] as client:
            for answer in (*CONNECTED, reply):
                if not client.recv(4096):
                    break
                client.sendall(answer)


def test_hostile_replies_only_cause_errors(builds: BuildCache) -> None:
    program = builds.program(PROGRAMS / "replay.c", SANITIZED)
    rng = random.Random(7)
    recorded = {case["call"]: case for case in TCP["session_1"]}
    calls = [rng.choice(HOSTILE_CALLS) for _ in range(ROUNDS)]
    replies = [mutated(rng, bytes.fromhex(recorded[call]["exchanges"][0]["reply"])) for call in calls]
    script = "".join(
        f"connect_robot 1\n{call} {' '.join(map(str, recorded[call]['args']))}\n" for call in calls
    )
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = threading.Thread(target=serve, args=(listener, replies), daemon=True)
        server.start()
        *found, _ = run_calls([str(program), str(listener.getsockname()[1])], script)
        server.join(30)
    assert len(found) == 2 * ROUNDS
    failed = 0
    for connected, after, call in zip(found[::2], found[1::2], calls, strict=True):
        assert connected["return"] == 7019
        if after["return"]:
            continue
        failed += 1
        assert after["error"].startswith(call)
        # A rejected reply changes nothing of the client's state except the error.
        assert after["State"][:44] == connected["State"][:44]
        assert after["Laser"] == connected["Laser"]
    assert failed > ROUNDS // 4
