"""The recorded exchanges as test cases: each case's calls, in the form the table takes them, with what came back."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.types import EVERYTHING, MODELS, Mask, Model

VECTORS = Path(__file__).parents[2] / "vectors"
# The recording program sent each user packet with this type; the C function takes only the packet's bytes.
PACKET_TYPE_OF_THE_RECORDER = 200


@dataclass(frozen=True)
class Exchange:
    """One call with its request and reply bytes; `decoded` is the C client's state after it (last of a case)."""

    call: Call
    request: bytes
    reply: bytes
    decoded: dict[str, Any] | None
    prints: tuple[str, ...] = ()


def recorded(file: str) -> dict[str, Any]:
    """One of the recorded files."""
    content: dict[str, Any] = json.loads((VECTORS / file).read_text())
    return content


def exchanges(cases: list[dict[str, Any]], model: Model | None) -> Iterator[Exchange]:
    """The exchanges of a session, over TCP where model is None, else on that model's own line."""
    mask = EVERYTHING
    for case in cases:
        calls, mask = _calls(case, mask, model)
        wire = case["exchanges"]
        # A call that sends nothing, such as one that the client itself refuses, has no exchange.
        assert not wire or len(wire) == len(calls), case["call"]
        for call, exchange in zip(calls, wire, strict=False):
            last = exchange is wire[-1]
            # DISCONNECT alone has no reply.
            reply = bytes.fromhex(exchange.get("reply", ""))
            decoded = case["decoded"] if last else None
            yield Exchange(call, bytes.fromhex(exchange["request"]), reply, decoded, tuple(case.get("prints", ())))


def _calls(case: dict[str, Any], mask: Mask, model: Model | None) -> tuple[list[Call], Mask]:
    name, given = case["call"], case["args"]
    args = (given,) if isinstance(given, str) else tuple(given)
    match name:
        case "connect_robot" | "disconnect_robot" if model is None:
            # The process number of the recorded client is the last word of CONNECT or DISCONNECT.
            pid = int(case["exchanges"][0]["request"][-8:], 16)
            connect = Call(name, (*args, pid))
            # The C library sends CT with all masks on right after CONNECT, so that one C call makes two exchanges.
            return ([connect, Call("ct", EVERYTHING.smask)] if name == "connect_robot" else [connect]), mask
        case "connect_robot":
            # A serial line has no CONNECT message: a host of a N200 sends CT alone.
            return [Call("ct", EVERYTHING.smask)], mask
        case "mask":
            # The two functions of the C library that change the mask both send it with CT.
            mask = Mask(args)
        case "posDataRequest":
            mask = mask.with_position(args[0])
        case "place_robot" if model is not None:
            # On the serial line place_robot is sent as dp and da.
            return [Call("dp", args[:2]), Call("da", args[2:])], mask
        case "special_request":
            args = (PACKET_TYPE_OF_THE_RECORDER, *args)
        case "ws":
            # The C library sends each axis flag of ws as 0 or 1.
            args = (*(int(bool(flag)) for flag in args[:3]), args[3])
    if name in ("mask", "posDataRequest", "ct"):
        return [Call("ct", mask.smask)], mask
    assert name in BY_NAME
    return [Call(name, args)], mask


TCP = recorded("nserver_tcp.json")
LP64 = recorded("nserver_tcp_lp64.json")
SERIAL = recorded("robot_serial.json")
TCP_SESSIONS = tuple(name for name in TCP if name != "about")
LINE_SESSIONS = tuple(name for name in SERIAL if name != "about")


def model_of(session: str) -> Model:
    """The model that a session of the serial file was recorded with."""
    return MODELS[session.removesuffix("_tcp")]
