"""Readers of the TCP and serial protocols: requests, replies, handshake, framing, captures.

The first byte of an input is the size of the parts in which the rest arrives (0: all at once); a second byte, where
there is one, selects the call, the model or the protocol. Framers and sessions are the real ones, without sockets; time
is a counter.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from random import Random
from typing import Any

from fuzz.mutation import after_header, any_of, choose, mutate_bytes, random_below, word_mutator
from fuzz.reader import Reader
from nclient.backends.base import Backend
from nclient.backends.direct import DirectBackend
from nclient.backends.nserver import NserverBackend
from nclient.cli import state_text
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.faults.inject import Frames, LineFrames, TcpFrames
from nclient.protocol.client_state import HANDSHAKE_SIZE, apply_handshake, build_handshake, read_handshake
from nclient.protocol.codec import TcpFramer, reply_bounds, request_bounds
from nclient.protocol.commands import BY_LINE_TYPE, BY_TCP_TYPE, MAX_REPLY_WORDS, NAK_TYPE, Call
from nclient.protocol.decode import WIRES, WireDecoder
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFramer, build_frame
from nclient.protocol.types import MODELS, N150, N200, SCOUT, serial_wire_state
from nclient.recording.format import format_frame
from nclient.recording.recorder import LINES, FrameDecoder
from nclient.robot import Robot
from nclient.transports.stream import Deadline
from nserver_emu.server.serial_session import NAK, SerialSession
from nserver_emu.server.session import ConnectionContext, Session, error_reply

_VECTORS = Path(__file__).parents[1] / "tests" / "vectors"
_LINE_MODELS = (N150, SCOUT, N200)
_LINE_TYPES, _TCP_TYPES = (*BY_LINE_TYPE, NAK_TYPE), (*BY_TCP_TYPE, *MAX_REPLY_WORDS)
_MAX_CALLS, _MAX_TICKS = 4, 64
_UNAVAILABLE = 4

CALLS = (
    Call("gs"), Call("get_sn"), Call("get_ir"), Call("get_ls"), Call("get_sg"), Call("get_cp"), Call("get_bp"),
    Call("get_rc"), Call("get_rv"), Call("get_ra"), Call("vm", (1, 2, 3)), Call("zr"), Call("ws", (1, 1, 1, 0)),
    Call("conf_ls", (33, 1, 0, 0, 0)), Call("sim_truth"), Call("sim_control", (1, 0)), Call("get_robot_conf"),
    Call("special_request", (50, 1, 2)), Call("get_rpx"), Call("predict_sensors", (0, 0, 0, 0)), Call("conf_tm", (5,)),
)  # fmt: skip


class FixedStream:
    """A stream that receives fixed parts, one at a time."""

    def __init__(self, split: Iterable[bytes]) -> None:
        self._pieces = iter(split)

    def send(self, data: bytes) -> None:
        del data

    def receive(self, deadline: Deadline) -> bytes:
        del deadline
        for part in self._pieces:
            if part:
                return part
        raise ReplyTimeout("no more data")

    def close(self) -> None:
        pass


def split(size: int, data: bytes) -> list[bytes]:
    """Split data into parts of this size; 0: do not split."""
    return [data[at : at + size] for at in range(0, len(data), size)] if size else [data]


def _tcp_requests(data: bytes) -> None:
    _feed(Session(_tcp_answer), split(data[0] if data else 0, data[1:]))


def _feed(session: Session | SerialSession, parts: list[bytes]) -> None:
    for part in parts:
        session.receive(part)
        # A session answers some requests at a time: continue until it has answered all of this part.
        while session.ready:
            session.process_requests(100)


def _tcp_answer(call: Call, context: ConnectionContext) -> Any:
    if call.name in ("connect_robot", "create_robot"):
        context.robot_id = call.args[0]
    return error_reply(_UNAVAILABLE)


def _line_requests(data: bytes) -> None:
    clock = itertools.count()
    model = _LINE_MODELS[data[1] % 3] if len(data) > 1 else N150
    session = SerialSession(lambda _call, _visit: NAK, 1, model, lambda: next(clock) * 0.05)
    _feed(session, split(data[0] if data else 0, data[2:]))
    # Incomplete frames are given up after some time.
    for _ in range(_MAX_TICKS):
        session.tick()
        session.process_requests(100)
        if not session.unfinished:
            break


def _tcp_replies(data: bytes) -> None:
    stream = FixedStream([*_tcp_handshake(), *split(data[0] if data else 0, data[2:])])
    _make_calls(NserverBackend(stream, pid=1), data[1] if len(data) > 1 else 0)


def _line_replies(data: bytes) -> None:
    kind = data[1] % 4 if len(data) > 1 else 0
    model, clock = (N150, SCOUT, N200, N200)[kind], itertools.count()
    parts = split(data[0] if data else 0, data[2:])
    # Over TCP an N200 sends a handshake (kind 3); otherwise its mask is the reply to ct (kind 2).
    handshake = _line_handshake() if kind == 2 else []
    backend = DirectBackend(FixedStream([*handshake, *parts]), model, hello=kind == 3, clock=lambda: next(clock) * 0.01)
    _make_calls(backend, data[1] >> 2 if len(data) > 1 else 0)


def _make_calls(backend: Backend, first: int) -> None:
    """Make some calls and format the state after each, until the data ends."""
    robot = Robot(backend)
    for number in range(_MAX_CALLS):
        call = CALLS[(first + number) % len(CALLS)]
        try:
            robot.execute(call)
        except RobotRefused:
            continue
        # Formatting must work for every state that a reply can produce.
        list(state_text.format_parts(robot.state, ()))


def _tcp_handshake() -> list[bytes]:
    if not _HANDSHAKES:
        session = _vectors("nserver_tcp.json")["session_1"]
        _HANDSHAKES.append([bytes.fromhex(each["reply"]) for each in session[0]["exchanges"]])
        serial = _vectors("robot_serial.json")["n200"]
        _HANDSHAKES.append([b"", bytes.fromhex(serial[0]["exchanges"][0]["reply"])])
    return _HANDSHAKES[0]


def _line_handshake() -> list[bytes]:
    """Return the reply to ct, after an empty part for the flush of the input."""
    _tcp_handshake()
    return _HANDSHAKES[1]


_HANDSHAKES: list[list[bytes]] = []


def _hello(data: bytes) -> None:
    found = read_handshake(data)
    wire_state = serial_wire_state(N200)
    apply_handshake(found, wire_state)
    if read_handshake(build_handshake(found)) != found:
        raise AssertionError("encoding and decoding changed the handshake")


def _framers(data: bytes) -> None:
    """Find the same frames for any split of the input; fault injection loses no byte."""
    parts = split(data[0] if data else 0, data[2:])
    kind = data[1] % 6 if len(data) > 1 else 0
    if kind > 2:
        frames: Frames = (LineFrames(), TcpFrames(None), TcpFrames(True))[kind - 3]
        passed = [piece for part in parts for piece in frames.receive(part)]
        if b"".join(piece.data for piece in (*passed, *frames.flush())) != data[2:]:
            raise AssertionError("bytes were lost")
    elif _frames(kind, [data[2:]]) != _frames(kind, parts):
        raise AssertionError("the frames depend on the split")


def _frames(kind: int, parts: list[bytes]) -> list[object]:
    """Return the frames found in these parts."""
    if kind == 0:
        line = SerialFramer(HOST_LIMIT)
        return [*(frame for part in parts for frame in line.receive(part)), *line.expire()]
    tcp = TcpFramer((request_bounds, reply_bounds)[kind - 1], drop_after_loss=kind == 1)
    return [frame for part in parts for frame in tcp.receive(part)]


def _captures(data: bytes) -> None:
    """Decode turns: a byte with direction and length, then the data."""
    kind = data[0] if data else 0
    follower = FrameDecoder(LINES[kind % 3], _LINE_MODELS[kind // 3 % 3])
    at = 1
    # The highest bit of the byte is the direction, the others are the length.
    while at < len(data):
        size = data[at] & 127
        turn = data[at + 1 : at + 1 + size]
        for found in follower.to_host(turn) if data[at] > 127 else follower.to_robot(turn):
            format_frame(found)
        at += 1 + size
    json.dumps(follower.clock_s)


def _wire_lines(data: bytes) -> None:
    kind = data[0] if data else 0
    transcript = WireDecoder(WIRES[kind % 3], _LINE_MODELS[kind // 3 % 3])
    for line in data[1:].decode("utf-8", "replace").splitlines():
        json.dumps(transcript.read(line))


# Valid inputs and mutators


def _vectors(file: str) -> Any:
    return json.loads((_VECTORS / file).read_text())


def _exchanges(cases: Iterable[dict[str, Any]]) -> Iterator[tuple[bytes, bytes]]:
    for case in cases:
        for each in case.get("exchanges", ()):
            yield bytes.fromhex(each["request"]), bytes.fromhex(each.get("reply", ""))


def _tcp_exchanges() -> list[tuple[bytes, bytes]]:
    file = _vectors("nserver_tcp.json")
    return [*_exchanges(file["session_1"]), *_exchanges(file["session_2_masks_pos_laser"])]


def _line_exchanges() -> Iterator[tuple[int, bytes, bytes]]:
    file = _vectors("robot_serial.json")
    for number, model in enumerate(_LINE_MODELS):
        yield from ((number, *each) for each in _exchanges(file[model.name]))


def _tcp_request_seeds() -> Iterator[bytes]:
    requests = [request for request, _ in _tcp_exchanges()]
    yield b"\0" + b"".join(requests)[:4000]
    yield b"\7" + b"".join(bytes.fromhex(each["request"]) for each in _vectors("nserver_tcp_lp64.json")["exchanges"])
    yield from (b"\3" + requests[0] + request for request in requests)


def _tcp_reply_seeds() -> Iterator[bytes]:
    for number, (_, reply) in enumerate(_tcp_exchanges()):
        yield bytes((0, number % len(CALLS))) + reply


def _line_request_seeds() -> Iterator[bytes]:
    for number, request, _ in _line_exchanges():
        yield bytes((0, number)) + request


def _line_reply_seeds() -> Iterator[bytes]:
    for number, _, reply in _line_exchanges():
        if reply:
            place = next((k for k, call in enumerate(CALLS) if _answers(call, reply)), 0)
            yield bytes((len(reply) & 255, number | place << 2 & 255)) + reply + reply


def _answers(call: Call, reply: bytes) -> bool:
    row = BY_LINE_TYPE.get(reply[3]) if len(reply) > 3 else None
    return row is not None and row.name == call.name


def _capture_seeds() -> Iterator[bytes]:
    for number, request, reply in _line_exchanges():
        yield bytes((1 + 3 * number, len(request) & 127)) + request[:127] + _turns(reply, 128)
    for request, reply in _tcp_exchanges():
        yield bytes((0, len(request) & 127)) + request[:127] + _turns(reply, 128)


def _turns(data: bytes, direction: int) -> bytes:
    return b"".join(bytes((direction | len(part),)) + part for part in split(127, data))


def _wire_line_seeds() -> Iterator[bytes]:
    for number, request, reply in _line_exchanges():
        yield bytes((2 + 3 * number,)) + b"> " + request.hex().encode() + b"\n< " + reply.hex().encode()
    for request, reply in _tcp_exchanges():
        yield b"\0> " + request.hex().encode() + b"\n< " + reply.hex().encode()


def _insert_frame(data: bytes, rng: Random) -> bytes:
    """Insert a valid frame of the serial protocol, of a known type and with random data."""
    at, size = random_below(len(data) + 1, rng), choose((0, 1, 2, 8, 16, 49, 200), rng)
    given = data[at : at + size] if random_below(2, rng) else rng.randbytes(size)
    kind = choose(_LINE_TYPES, rng) if random_below(12, rng) else random_below(256, rng)
    frame = build_frame(kind, given)
    return data[:at] + frame + data[at + choose((0, len(frame)), rng) :]


def _insert_message(data: bytes, rng: Random) -> bytes:
    """Insert a message of the TCP protocol, of a known type and mostly with a valid count."""
    kind = choose(_TCP_TYPES, rng)
    row = BY_TCP_TYPE.get(kind)
    low, high = row.tcp_words if row else (1, min(MAX_REPLY_WORDS[kind], 120))
    count = choose((low, low, high, low + random_below(max(low, high) - low + 1, rng), 1, 0), rng) % 200
    word = [choose((0, 1, -1, 2**31 - 1, -(2**31), random_below(800, rng) - 400, 1000), rng) for _ in range(count)]
    body = b"".join((b"\0" * 4 if random_below(8, rng) == 0 else b"") + n.to_bytes(4, "big", signed=True) for n in word)
    at = random_below(len(data) + 1, rng)
    return data[:at] + kind.to_bytes(2, "big", signed=True) + count.to_bytes(2, "big") + body + data[at:]


_TCP = any_of(_insert_message, mutate_bytes)
_SERIAL = any_of(_insert_frame, mutate_bytes)
_REPLY_ERRORS = (ConnectionLost, ReplyTimeout, RobotRefused)

READERS = (
    Reader("tcp_requests", "TCP protocol, server side", _tcp_requests, (), _tcp_request_seeds, after_header(1, _TCP)),
    Reader("tcp_replies", "TCP protocol, client side", _tcp_replies, _REPLY_ERRORS, _tcp_reply_seeds,
           after_header(2, _TCP)),
    Reader("line_requests", "serial protocol, robot side", _line_requests, (), _line_request_seeds,
           after_header(2, _SERIAL), max_size=1024),
    Reader("line_replies", "serial protocol, host side", _line_replies, _REPLY_ERRORS, _line_reply_seeds,
           after_header(2, _SERIAL)),
    Reader("hello", "handshake of an N200, eleven bytes", _hello, (WireError,),
           lambda: [bytes(HANDSHAKE_SIZE), b"\xff" * HANDSHAKE_SIZE, b"\x12\x34\x56\x78\x9a\x01\x3f\x21abc"],
           mutate_bytes, max_size=24),
    Reader("framers", "frames after invalid bytes", _framers, (),
           lambda: [bytes((1, kind)) + seed[2:] for kind in range(6) for seed in
                    (*itertools.islice(_line_request_seeds(), 9), *itertools.islice(_tcp_reply_seeds(), 9))],
           after_header(2, any_of(_insert_frame, _insert_message, mutate_bytes)), max_size=1024),
    Reader("captures", "traffic decoded by bridge, recorder and page", _captures, (), _capture_seeds,
           any_of(mutate_bytes, _insert_frame, _insert_message)),
    Reader("wire_lines", "lines of nomad wire", _wire_lines, (), _wire_line_seeds,
           any_of(mutate_bytes, word_mutator(b"> ", b"< ", b"\n"))),
)  # fmt: skip
assert set(_LINE_MODELS) == set(MODELS.values())
