"""The Wireshark dissector shows every field as `nomad wire decode` does."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import pytest

from nclient.cli.wire import build_dissector
from nclient.protocol import codec
from nclient.protocol.client_state import ClientState, Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, COMMANDS, Call, Command
from nclient.protocol.decode import WireDecoder, describe_client_state
from nclient.protocol.replies import Reply
from nclient.protocol.types import MODELS, Mask, Model, Stamp, WireState, serial_wire_state, tcp_wire_state
from tests.nclient.cli.captures import TO_HOST, TO_ROBOT, Conversation, dissect, write_pcap
from tests.nclient.protocol.recorded import LINE_SESSIONS, LP64, SERIAL, TCP, TCP_SESSIONS, exchanges, model_of
from tests.nclient.protocol.strategies import line_reply_of, tcp_reply_of

SLOTS = (
    "speed", *(f"ir_{k}" for k in range(16)), *(f"sonar_{k}" for k in range(16)), "bumper", "x", "y", "steer",
    "turret", "v_trans", "v_steer", "v_turret", "motors", "laser_mode", "compass", "state_error",
)  # fmt: skip
STAMP = ("x", "y", "steer", "turret", "v_trans", "v_steer", "v_turret", "pose_time", "sensor_time")
UNKNOWN_PORT = 12345
"""A port of no preference: the dissector recognizes the connection by its first message."""

pytestmark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed (apt install tshark)")


@dataclass
class Case:
    """A connection, how it is read, and its messages as one frame each."""

    name: str
    wire: str
    model: Model
    conversation: Conversation
    frames: list[tuple[str, bytes]]


def a_case(name: str, wire: str, model: Model, port: int, frames: list[tuple[str, bytes]]) -> Case:
    return Case(name, wire, model, Conversation(port, frames), frames)


def recorded_cases() -> Iterator[Case]:
    for session in TCP_SESSIONS:
        frames = list(both_ways(exchanges(TCP[session], None)))
        # On Nserver's port the dissector is chosen by the port, on the other one by the first message.
        for port in (7019, UNKNOWN_PORT):
            yield a_case(f"{session}, port {port}", "tcp", MODELS["n200"], port, frames)
    # The recorded 64-bit client: only its words of 8 bytes distinguish it.
    frames = [(way, bytes.fromhex(one[key])) for one in LP64["exchanges"]
              for way, key in ((TO_ROBOT, "request"), (TO_HOST, "reply")) if one.get(key)]
    yield a_case("lp64", "tcp64", MODELS["n200"], UNKNOWN_PORT, frames)
    for number, session in enumerate(LINE_SESSIONS):
        model = model_of(session)
        # The line's port selects the model: a preference of the dissector lists port=model.
        yield a_case(session, "serial", model, 65002 + number, list(both_ways(exchanges(SERIAL[session], model))))


def both_ways(recorded: Iterator[Any]) -> Iterator[tuple[str, bytes]]:
    for exchange in recorded:
        yield TO_ROBOT, exchange.request
        if exchange.reply:
            yield TO_HOST, exchange.reply


def our_cases() -> Iterator[Case]:
    """Yield every command of every wire and model, with random arguments, masks, laser modes and replies."""
    rng = Random(19)
    for wide in (False, True):
        connect = codec.encode_tcp_request(Call("connect_robot", (1, 4711)), wide=wide)
        # 0x1b6b = 7019, the port that connect_robot returns.
        frames = [(TO_ROBOT, connect), (TO_HOST, codec.build_frame(82, b"\0\0\x1b\x6b", wide=wide, reply=True))]
        state = tcp_wire_state(MODELS["n200"])
        state.wide = wide
        # Commands without a reply would end the conversation: only disconnect_robot is left out.
        for row in mixed([row for row in COMMANDS if row.tcp_type is not None and row.has_tcp_reply], rng):
            call = a_call(row, rng, line=False)
            codec.update_from_request(call, state)
            frames.append((TO_ROBOT, codec.encode_tcp_request(call, wide=wide)))
            if rng.random() < 0.9:  # requests without a reply, too
                frames.append((TO_HOST, codec.encode_tcp_reply(row, a_tcp_reply(row, rng, state), state)))
        yield a_case(f"random, wide={wide}", "tcp64" if wide else "tcp", MODELS["n200"], UNKNOWN_PORT, frames)
    for number, model in enumerate(MODELS.values()):
        state = serial_wire_state(model)
        # Only a N200 sends its mask first; mask with position bits 5, laser mode 1.
        frames = [(TO_HOST, build_handshake(Handshake(Mask((5, *[1] * 43)), 1)))] if model.sends_mask else []
        for row in mixed([row for row in COMMANDS if model.name in row.line_models and row.line_type], rng):
            call = a_call(row, rng, line=True)
            frames.append((TO_ROBOT, codec.encode_serial_request(call, state)))
            # The mask and the laser mode apply to the reply of this very request.
            codec.update_from_request(call, state)
            frames.append((TO_HOST, a_line_frame(row, rng, state)))
        yield a_case(f"random line of {model.name}", "serial", model, 65020 + number, frames)


def mixed(rows: list[Command], rng: Random) -> list[Command]:
    """Return ct first, then every command at least once in random order."""
    # Each command twice, and 20 more of those that change or depend on the format of replies.
    many = rows * 2 + rng.choices([row for row in rows if row.name in ("gs", "ct", "conf_ls", "get_ls", "get_sg")] or
                                  rows, k=20)
    rng.shuffle(many)
    return [row for row in rows if row.name == "ct"] + many


def a_call(row: Command, rng: Random, line: bool) -> Call:
    # Small and large words: a field that is read with too few bits shows in the large ones.
    word = rng.choice((5, 2**31 - 1))
    match row.name:
        case "ct":
            bits = [rng.randrange(2) for _ in range(43)]
            if line:
                # Smask[41] is not sent on the serial line, and reads 1.
                bits[40] = 1
            return Call("ct", (rng.choice((0, 31, rng.randrange(32))), *bits))
        case "tk":
            return Call("tk", ("Where am I? " + "\xe9" * rng.randrange(5),))
        case "conf_ls":
            return Call("conf_ls", (rng.choice((51, 50, 19, 1, 33, 0, 49, 255)), 1, 2, rng.randrange(483), 0))
        case "special_request":
            return Call(row.name, (200, *rng.choices(range(256), k=rng.randrange(20))))
        case "motion_check":
            arc = (1, 10, -20, 1.5, -2500, 30, -40, 50)
            return Call(row.name, rng.choice(((0, 10, -20, 30, -40), arc)))
        case "add_obstacle" | "delete_obstacle" | "move_obstacle":
            n = rng.randrange(1, 11)
            size = 2 * n + (2 if row.name == "move_obstacle" else 0)
            return Call(row.name, (n, *(rng.randrange(-word, word) for _ in range(size))))
    bounds = codec.serial_argument_bounds(row.name) if line else ()
    if bounds and row.name != "ws":
        return Call(row.name, tuple(rng.randint(low, min(high, 10) if row.name == "conf_ir" else high)
                                    for _, low, high in bounds))
    if row.name == "ws":
        return Call(row.name, (1, 0, 1, rng.randrange(256)))
    small = row.packet_type is not None
    return Call(row.name, tuple(rng.randrange(0 if small else -word, 65536 if small else word) for _ in row.arguments))


def a_tcp_reply(row: Command, rng: Random, state: WireState) -> Reply:
    layout = row.tcp_reply
    width = layout.laser_width(state) if layout.laser_width else 1
    # An error in place of one reply in ten: error replies have no layout of the command.
    if rng.random() < 0.1:
        return Reply("error", values=(rng.randrange(1, 7),))
    values = rng.randrange(12, 20) if layout.values is None else layout.values
    return tcp_reply_of(layout.kind, rng.randrange(2**32), (rng.choice((0, 3, 40)), width), values)


def a_line_frame(row: Command, rng: Random, state: WireState) -> bytes:
    width = state.laser_width
    if row.name in ("get_ls", "get_sg"):
        width = 4 if row.name == "get_sg" else 1
    if rng.random() < 0.1:
        return codec.encode_serial_reply(row, Reply("nak"), state)
    reply = line_reply_of(row.line_reply.kind, rng.randrange(2**32), (rng.choice((0, 3, 40)), width),
                          3 if row.name == "conf_cp" else 12, signed_compass=row.name != "get_cp")
    return codec.encode_serial_reply(row, reply, state)


def expected(case: Case) -> list[dict[str, Any]]:
    # The oracle is the decoder of `nomad wire decode`, which is Python code; the dissector is a Lua script.
    decoder = WireDecoder(case.wire, case.model)
    return [decoder.request(frame) if way == TO_ROBOT else decoder.reply(frame) for way, frame in case.frames]


class Shown:
    """What the dissector shows of a connection, as `nomad wire decode` prints it."""

    def __init__(self, wide: bool) -> None:
        # The dissector shows what a message carries; the state after it is collected here.
        self.client_state = ClientState()
        self.wide = wide

    def message(self, fields: list[tuple[str, str]]) -> dict[str, Any]:
        # For fields that occur once; repeated ones are taken from the list.
        only = {name.removeprefix("nomad."): value for name, value in fields}
        if "call" in only:
            return self._call(only, fields)
        if only.get("reply") == "hello":
            mask = [int(value) for name, value in fields if name == "nomad.smask"]
            return {"to": only["to"], "reply": "hello", "mask": mask, "laser_mode": int(only["laser_mode"])}
        return self._reply(only, fields)

    @staticmethod
    def _call(only: dict[str, str], fields: list[tuple[str, str]]) -> dict[str, Any]:
        name = only["call"]
        found: dict[str, Any] = {"to": only["to"], "call": name, "args": []}
        for field, value in fields:
            key = field.removeprefix("nomad.")
            if key == "smask":
                found.setdefault("mask", []).append(int(value))
            elif key == "packet_type" or key == f"{name}.pid":
                found[key.rpartition(".")[2]] = int(value)
            elif key == "tk.text":
                found["args"].append(value)
            elif key == "real":
                found["args"].append(float(value))
            elif key == "number" or key.startswith(f"{name}."):
                found["args"].append(int(value))
        return found

    def _reply(self, only: dict[str, str], fields: list[tuple[str, str]]) -> dict[str, Any]:
        """Apply what this reply carries, and return the client's state after it."""
        many: dict[str, list[str]] = {}
        for name, value in fields:
            many.setdefault(name.removeprefix("nomad."), []).append(value)
        stamps = {key: Stamp(*[int(many[f"position.{part}"][k]) for part in STAMP])
                  for k, key in enumerate(many.get("position", ()))}
        values = tuple(map(int, many.get("value", ())))
        laser = (int(only["laser_count"]), *map(int, many.get("laser_value", ()))) if "laser_count" in only else None
        volts = (int(only["cpu_raw"]), int(only["motor_raw"])) if "cpu_raw" in only else None
        clock = int(only["clock"]) if "clock" in only else None
        slots = {k: int(only[name]) for k, name in enumerate(SLOTS) if name in only}
        self.client_state.apply_reply(Reply(only["reply"], slots, laser, stamps, clock, volts, values))
        found = {"to": only["to"], "reply": only["reply"]} | describe_client_state(self.client_state)
        # Volts as shown, not those computed here from the raw bytes.
        found |= {name: round(float(only[name]), 5) for name in ("volt_cpu", "volt_motor") if name in only}
        if values:
            found["values"] = list(values)
        if only["reply"] == "prediction":
            found |= {"pred_state": [values[k] if 1 <= k <= 32 else 0 for k in range(45)],
                      "pred_laser": list(laser or ())}
        if only["reply"] == "special" and values:
            found["special"] = list(values)
        if values and only.get("reply_to") in ("get_rpx", "move_obstacle", "get_robot_conf") and "code" not in only:
            found["obs"] = list(values)
        found |= {name: int(only[name]) for name in ("code", "arm", "remain") if name in only}
        if "collide" in only:
            found["collide"] = [float(value) for value in many["collide"]]
        return found


@pytest.fixture(scope="module")
def dissector(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("wireshark") / "nomad.lua"
    path.write_text(build_dissector())
    return path


@pytest.mark.long
def test_every_field_equals_wire_decode(dissector: Path, tmp_path: Path) -> None:
    cases = [*recorded_cases(), *our_cases()]
    # One capture and one run of tshark for all cases, as its start takes most of the time.
    write_pcap(tmp_path / "all.pcap", [case.conversation for case in cases])
    models = " ".join(f"{case.conversation.port}={case.model.name}" for case in cases if case.wire == "serial")
    ports = ",".join(str(case.conversation.port) for case in cases if case.wire == "serial")
    # Two passes, as Wireshark: without a filter tshark would leave the first one out.
    found = dissect(tmp_path / "all.pcap", dissector,
                    ("-2", "-Y", "nomad || nomad_line", "-o", f"nomad_line.models:{models}",
                     "-o", f"nomad_line.ports:{ports}"))
    messages = 0
    for number, case in enumerate(cases):
        shown = Shown(case.wire == "tcp64")
        wanted = expected(case)
        # 1. As many messages as frames were written: none is missing, and none is an error.
        assert len(found.get(number, ())) == len(wanted), case.name
        for k, (fields, decoded) in enumerate(zip(found[number], wanted, strict=True)):
            assert "error" not in decoded
            # 2. Field by field equal to the decoder's output.
            assert shown.message(fields) == decoded, (case.name, k, fields)
            messages += 1
    # Empty cases would pass everything else.
    assert messages > 1500


def test_recognizes_lines_and_resumes_after_noise(dissector: Path, tmp_path: Path) -> None:
    """Segments with several frames, frames in pieces, noise; on ports of no preference, models from the frames."""
    cases = []
    for model in MODELS.values():
        state = serial_wire_state(model)
        gs, vm = (codec.encode_serial_request(call, state) for call in (Call("gs"), Call("vm", (100, -50, 0))))
        slots = {33: model.bumper_rest, 34: -1234}
        answer = codec.encode_serial_reply(BY_NAME["gs"], Reply("state", slots=slots, clock=1), state)
        # 1. A segment with two frames; 2. a frame in two pieces; 3. noise between two frames.
        cases.append(Conversation(UNKNOWN_PORT, [
            (TO_ROBOT, gs), (TO_HOST, answer), (TO_ROBOT, gs + vm), (TO_HOST, answer[:9]), (TO_HOST, answer[9:]),
            (TO_HOST, answer + b"\x01\x02\xff" + answer),
        ]))
    write_pcap(tmp_path / "noise.pcap", cases)
    for messages in dissect(tmp_path / "noise.pcap", dissector).values():
        # The noise is one error item between two states.
        names = [dict(one).get("nomad.call") or dict(one).get("nomad.reply") or "error" for one in messages]
        assert names == ["gs", "state", "gs", "vm", "state", "state", "error", "state"]
        assert dict(messages[1])["nomad.x"] == dict(messages[-1])["nomad.x"] == "-1234"
        assert dict(messages[3])["nomad.vm.steering"] == "-50"
