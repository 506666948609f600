"""Readers of the wire: both languages, both ways, from the framer to the value; hello; captures; what faults cut.

Input: one byte says in what pieces the rest comes (0: at once), a second one, where there is, which call, model or
language. Rules: real framers and conversations; no socket, no clock but a counting one.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from random import Random
from typing import Any

from fuzz.mutating import behind, below, bytes_changed, either, one_of, words_changed
from fuzz.reader import Reader
from nclient.backends.base import Backend
from nclient.backends.direct import DirectBackend
from nclient.backends.nserver import NserverBackend
from nclient.cli import state_text
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.faults.frames import Frames, LineFrames, TcpFrames
from nclient.protocol.client_state import HELLO_SIZE, adopt, build_hello, read_hello
from nclient.protocol.commands import BY_LINE_TYPE, BY_TCP_TYPE, MAX_REPLY_WORDS, NAK_TYPE, Call
from nclient.protocol.decode import WIRES, Transcript
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFramer, build_frame
from nclient.protocol.tcp_framing import TcpFramer, reply_bounds, request_bounds
from nclient.protocol.types import MODELS, N150, N200, SCOUT
from nclient.protocol.wire_state import line_terms
from nclient.recording.readable import told
from nclient.recording.recorder import LINES, Follower
from nclient.robot import Robot
from nclient.transports.stream import Deadline
from nserver_emu.server.serial_session import NAK, SerialSession
from nserver_emu.server.session import ConnectionContext, Session, error_reply

_VECTORS = Path(__file__).parents[1] / "tests" / "vectors"
_LINE_MODELS = (N150, SCOUT, N200)
_LINE_TYPES, _TCP_TYPES = (*BY_LINE_TYPE, NAK_TYPE), (*BY_TCP_TYPE, *MAX_REPLY_WORDS)
_MOST_CALLS, _MOST_TICKS = 4, 64
_UNAVAILABLE = 4

CALLS = (
    Call("gs"), Call("get_sn"), Call("get_ir"), Call("get_ls"), Call("get_sg"), Call("get_cp"), Call("get_bp"),
    Call("get_rc"), Call("get_rv"), Call("get_ra"), Call("vm", (1, 2, 3)), Call("zr"), Call("ws", (1, 1, 1, 0)),
    Call("conf_ls", (33, 1, 0, 0, 0)), Call("sim_truth"), Call("sim_control", (1, 0)), Call("get_robot_conf"),
    Call("special_request", (50, 1, 2)), Call("get_rpx"), Call("predict_sensors", (0, 0, 0, 0)), Call("conf_tm", (5,)),
)  # fmt: skip


class Canned:
    """A stream whose other end has said all it ever will: these pieces, one at a time."""

    def __init__(self, pieces: Iterable[bytes]) -> None:
        self._pieces = iter(pieces)

    def send(self, data: bytes) -> None:
        del data

    def receive(self, deadline: Deadline) -> bytes:
        del deadline
        for piece in self._pieces:
            if piece:
                return piece
        raise ReplyTimeout("it has nothing more to say")

    def close(self) -> None:
        pass


def pieces(size: int, data: bytes) -> list[bytes]:
    """Data in pieces of this size; 0: whole."""
    return [data[at : at + size] for at in range(0, len(data), size)] if size else [data]


def _tcp_requests(data: bytes) -> None:
    _answered(Session(_tcp_answer), pieces(data[0] if data else 0, data[1:]))


def _answered(session: Session | SerialSession, cut: list[bytes]) -> None:
    for piece in cut:
        session.receive(piece)
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
    _answered(session, pieces(data[0] if data else 0, data[2:]))
    for _ in range(_MOST_TICKS):
        session.tick()
        session.process_requests(100)
        if not session.unfinished:
            break


def _tcp_replies(data: bytes) -> None:
    stream = Canned([*_tcp_greeting(), *pieces(data[0] if data else 0, data[2:])])
    _ask(NserverBackend(stream, pid=1), data[1] if len(data) > 1 else 0)


def _line_replies(data: bytes) -> None:
    kind = data[1] % 4 if len(data) > 1 else 0
    model, clock = (N150, SCOUT, N200, N200)[kind], itertools.count()
    cut = pieces(data[0] if data else 0, data[2:])
    greeting = _line_greeting() if kind == 2 else []
    backend = DirectBackend(Canned([*greeting, *cut]), model, hello=kind == 3, clock=lambda: next(clock) * 0.01)
    _ask(backend, data[1] >> 2 if len(data) > 1 else 0)


def _ask(backend: Backend, first: int) -> None:
    """A few calls and a look at what they left, until the other end has said its all."""
    robot = Robot(backend)
    for number in range(_MOST_CALLS):
        call = CALLS[(first + number) % len(CALLS)]
        try:
            robot.execute(call)
        except RobotRefused:
            continue
        list(state_text.lines(robot.state, ()))


def _tcp_greeting() -> list[bytes]:
    if not _GREETINGS:
        session = _vectors("nserver_tcp.json")["session_1"]
        _GREETINGS.append([bytes.fromhex(each["reply"]) for each in session[0]["exchanges"]])
        serial = _vectors("robot_serial.json")["n200"]
        _GREETINGS.append([b"", bytes.fromhex(serial[0]["exchanges"][0]["reply"])])
    return _GREETINGS[0]


def _line_greeting() -> list[bytes]:
    """What answers ct; nothing is there when the input is emptied first."""
    _tcp_greeting()
    return _GREETINGS[1]


_GREETINGS: list[list[bytes]] = []


def _hello(data: bytes) -> None:
    found = read_hello(data)
    terms = line_terms(N200)
    adopt(found, terms)
    if read_hello(build_hello(found)) != found:
        raise AssertionError("built anew it is another hello")


def _framers(data: bytes) -> None:
    """The same frames however they come in, and no byte lost on the way through a plan of faults."""
    cut = pieces(data[0] if data else 0, data[2:])
    kind = data[1] % 6 if len(data) > 1 else 0
    if kind > 2:
        frames: Frames = (LineFrames(), TcpFrames(None), TcpFrames(True))[kind - 3]
        passed = [piece for part in cut for piece in frames.receive(part)]
        if b"".join(piece.data for piece in (*passed, *frames.rest())) != data[2:]:
            raise AssertionError("bytes lost")
    elif _found(kind, [data[2:]]) != _found(kind, cut):
        raise AssertionError("other frames in pieces")


def _found(kind: int, cut: list[bytes]) -> list[object]:
    """What a framer finds in these pieces."""
    if kind == 0:
        line = SerialFramer(HOST_LIMIT)
        return [*(frame for piece in cut for frame in line.receive(piece)), *line.expire()]
    tcp = TcpFramer((request_bounds, reply_bounds)[kind - 1], gives_up=kind == 1)
    return [frame for piece in cut for frame in tcp.receive(piece)]


def _captures(data: bytes) -> None:
    """Turns: a byte for direction and length, then what was said."""
    kind = data[0] if data else 0
    follower = Follower(LINES[kind % 3], _LINE_MODELS[kind // 3 % 3])
    at = 1
    while at < len(data):
        size = data[at] & 127
        said = data[at + 1 : at + 1 + size]
        for found in follower.to_host(said) if data[at] > 127 else follower.to_robot(said):
            told(found)
        at += 1 + size
    json.dumps(follower.clock_s)


def _wire_lines(data: bytes) -> None:
    kind = data[0] if data else 0
    transcript = Transcript(WIRES[kind % 3], _LINE_MODELS[kind // 3 % 3])
    for line in data[1:].decode("utf-8", "replace").splitlines():
        json.dumps(transcript.read(line))


# seeds and mutators


def _vectors(file: str) -> Any:
    return json.loads((_VECTORS / file).read_text())


def _exchanged(cases: Iterable[dict[str, Any]]) -> Iterator[tuple[bytes, bytes]]:
    for case in cases:
        for each in case.get("exchanges", ()):
            yield bytes.fromhex(each["request"]), bytes.fromhex(each.get("reply", ""))


def _tcp_exchanges() -> list[tuple[bytes, bytes]]:
    file = _vectors("nserver_tcp.json")
    return [*_exchanged(file["session_1"]), *_exchanged(file["session_2_masks_pos_laser"])]


def _line_exchanges() -> Iterator[tuple[int, bytes, bytes]]:
    file = _vectors("robot_serial.json")
    for number, model in enumerate(_LINE_MODELS):
        yield from ((number, *each) for each in _exchanged(file[model.name]))


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
        yield bytes((1 + 3 * number, len(request) & 127)) + request[:127] + _turn(reply, 128)
    for request, reply in _tcp_exchanges():
        yield bytes((0, len(request) & 127)) + request[:127] + _turn(reply, 128)


def _turn(data: bytes, way: int) -> bytes:
    return b"".join(bytes((way | len(part),)) + part for part in pieces(127, data))


def _wire_line_seeds() -> Iterator[bytes]:
    for number, request, reply in _line_exchanges():
        yield bytes((2 + 3 * number,)) + b"> " + request.hex().encode() + b"\n< " + reply.hex().encode()
    for request, reply in _tcp_exchanges():
        yield b"\0> " + request.hex().encode() + b"\n< " + reply.hex().encode()


def _framed(data: bytes, chance: Random) -> bytes:
    """A good frame of the robot's line put somewhere, of a known type and with any data."""
    at, size = below(len(data) + 1, chance), one_of((0, 1, 2, 8, 16, 49, 200), chance)
    given = data[at : at + size] if below(2, chance) else chance.randbytes(size)
    kind = one_of(_LINE_TYPES, chance) if below(12, chance) else below(256, chance)
    frame = build_frame(kind, given)
    return data[:at] + frame + data[at + one_of((0, len(frame)), chance) :]


def _message(data: bytes, chance: Random) -> bytes:
    """A message of Nserver's language put somewhere, of a known type and mostly of a count that it can have."""
    kind = one_of(_TCP_TYPES, chance)
    row = BY_TCP_TYPE.get(kind)
    low, high = row.tcp_words if row else (1, min(MAX_REPLY_WORDS[kind], 120))
    count = one_of((low, low, high, low + below(max(low, high) - low + 1, chance), 1, 0), chance) % 200
    word = [one_of((0, 1, -1, 2**31 - 1, -(2**31), below(800, chance) - 400, 1000), chance) for _ in range(count)]
    body = b"".join((b"\0" * 4 if below(8, chance) == 0 else b"") + n.to_bytes(4, "big", signed=True) for n in word)
    at = below(len(data) + 1, chance)
    return data[:at] + kind.to_bytes(2, "big", signed=True) + count.to_bytes(2, "big") + body + data[at:]


_TCP = either(_message, bytes_changed)
_SERIAL = either(_framed, bytes_changed)
_ANSWERED = (ConnectionLost, ReplyTimeout, RobotRefused)

READERS = (
    Reader("tcp_requests", "Nserver's language, server side", _tcp_requests, (), _tcp_request_seeds, behind(1, _TCP)),
    Reader("tcp_replies", "Nserver's language, client side", _tcp_replies, _ANSWERED, _tcp_reply_seeds,
           behind(2, _TCP)),
    Reader("line_requests", "a robot's own line, robot's side", _line_requests, (), _line_request_seeds,
           behind(2, _SERIAL), longest=1024),
    Reader("line_replies", "a robot's own line, host's side", _line_replies, _ANSWERED, _line_reply_seeds,
           behind(2, _SERIAL)),
    Reader("hello", "the eleven bytes that a N200 says first", _hello, (WireError,),
           lambda: [bytes(HELLO_SIZE), b"\xff" * HELLO_SIZE, b"\x12\x34\x56\x78\x9a\x01\x3f\x21abc"], bytes_changed,
           longest=24),
    Reader("framers", "frames found again among rubbish", _framers, (),
           lambda: [bytes((1, kind)) + seed[2:] for kind in range(6) for seed in
                    (*itertools.islice(_line_request_seeds(), 9), *itertools.islice(_tcp_reply_seeds(), 9))],
           behind(2, either(_framed, _message, bytes_changed)), longest=1024),
    Reader("captures", "what a bridge, recorder or page overhears", _captures, (), _capture_seeds,
           either(bytes_changed, _framed, _message)),
    Reader("wire_lines", "lines of nomad wire", _wire_lines, (), _wire_line_seeds,
           either(bytes_changed, words_changed(b"> ", b"< ", b"\n"))),
)  # fmt: skip
assert set(_LINE_MODELS) == set(MODELS.values())
