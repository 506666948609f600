"""Answers that nobody should give: the C library refuses them, tells why, and neither crashes nor reads too far."""

from __future__ import annotations

import random
import re
import socket
import subprocess
import threading
from collections.abc import Iterator

from building import PROGRAMS, SANITIZED, Kind, Workshop, held
from recorded import LINE_SESSIONS, SERIAL, TCP, TCP_SESSIONS, Exchange, exchanges, model_of

from nclient.protocol import language
from nclient.protocol.commands import NAK_TYPE
from nclient.protocol.models import N150, Model
from nclient.protocol.terms import Terms, line_terms, tcp_terms

MUTATED = 20_000
ROUNDS = 120


def corpus() -> Iterator[str]:
    """Every recorded reply, a line each, with the terms under which it was said."""
    for session in TCP_SESSIONS:
        yield from said(exchanges(TCP[session], None), tcp_terms(N150), None)
    for session in LINE_SESSIONS:
        model = model_of(session)
        yield from said(exchanges(SERIAL[session], model), line_terms(model), model)


def said(session: Iterator[Exchange], terms: Terms, model: Model | None) -> Iterator[str]:
    for exchange in session:
        reply = exchange.reply
        language.note(exchange.call, terms)
        if not reply or (reply[:2] == b"\0\x5b" if model is None else reply[3] == NAK_TYPE):
            continue
        data = reply[4:] if model is None else reply[4:-2]
        mask = terms.mask.smask
        yield (
            f"{'T' if model is None else 'L'} {exchange.call.name} {terms.model.number} {terms.laser_mode} "
            f"{terms.laser_width} {mask[0]} {''.join(map(str, mask[1:]))} .{data.hex()}\n"
        )


def test_mutated_replies_are_read_or_refused(kind: Kind, workshop: Workshop) -> None:
    program = workshop.program(PROGRAMS / "fuzz.c", kind, beside=("-lndirect",))
    times = MUTATED if kind.sanitized else MUTATED // 10
    done = subprocess.run([str(program), "20260", str(times)], input="".join(corpus()), capture_output=True, text=True,
                          timeout=60, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    counts = re.fullmatch(rf"(\d+) recorded, {times} mutated: (\d+) read, (\d+) refused\n", done.stdout)
    assert counts
    assert int(counts[1]) > 180
    assert int(counts[2]) > times // 10
    assert int(counts[3]) > times // 10


CONNECTED = (bytes.fromhex(TCP["session_1"][0]["exchanges"][0]["reply"]),
             bytes.fromhex(TCP["session_1"][0]["exchanges"][1]["reply"]))  # fmt: skip
ASKED = ("gs", "get_sn", "get_rpx", "move_obstacle", "special_request", "predict_sensors", "get_robot_conf")


def mutated(rng: random.Random, reply: bytes) -> bytes:
    """A reply with other bytes, another count, or another length."""
    data = bytearray(reply)
    for _ in range(rng.randrange(1, 4)):
        at = rng.choice((2, 3, 4, 5, 6, 7, rng.randrange(len(data))))
        data[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    if rng.random() < 0.3:
        del data[rng.randrange(4, len(data)) :]
    return bytes(data)


def serve(listener: socket.socket, replies: list[bytes]) -> None:
    """Greet each client well, answer its next question as told, and hang up."""
    for reply in replies:
        with listener.accept()[0] as client:
            for answer in (*CONNECTED, reply):
                if not client.recv(4096):
                    break
                client.sendall(answer)


def test_a_hostile_server_gets_no_further_than_an_error(workshop: Workshop) -> None:
    program = workshop.program(PROGRAMS / "replay.c", SANITIZED)
    rng = random.Random(7)
    recorded = {case["call"]: case for case in TCP["session_1"]}
    calls = [rng.choice(ASKED) for _ in range(ROUNDS)]
    replies = [mutated(rng, bytes.fromhex(recorded[call]["exchanges"][0]["reply"])) for call in calls]
    script = "".join(
        f"connect_robot 1\n{call} {' '.join(map(str, recorded[call]['args']))}\n" for call in calls
    )
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = threading.Thread(target=serve, args=(listener, replies), daemon=True)
        server.start()
        *found, _ = held([str(program), str(listener.getsockname()[1])], script)
        server.join(30)
    assert len(found) == 2 * ROUNDS
    failed = 0
    for connected, after, call in zip(found[::2], found[1::2], calls, strict=True):
        assert connected["return"] == 7019
        if after["return"]:
            continue
        failed += 1
        assert after["error"].startswith(call)
        assert after["State"][:44] == connected["State"][:44]
        assert after["Laser"] == connected["Laser"]
    assert failed > ROUNDS // 4
