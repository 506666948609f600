"""Captures as Wireshark reads them: connections of bytes as a pcap file, and what tshark shows of it."""

from __future__ import annotations

import json
import struct
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

TO_ROBOT, TO_HOST = ">", "<"
MAX_SEGMENT = 1400
ETHERNET = 1
LAYERS = "nomad nomad_line"


@dataclass
class Conversation:
    """One TCP connection: segments (direction, bytes) in order, and what is known of it besides."""

    port: int
    segments: list[tuple[str, bytes]] = field(default_factory=list)


def write_pcap(path: Path, conversations: list[Conversation]) -> None:
    """Write a capture with one TCP connection after another, each from its own client port."""
    packets = []
    for number, conversation in enumerate(conversations):
        next_bytes = {TO_ROBOT: 1, TO_HOST: 1}
        client = 40000 + number
        for direction, data in conversation.segments:
            for at in range(0, len(data), MAX_SEGMENT):
                part = data[at : at + MAX_SEGMENT]
                ports = (client, conversation.port) if direction == TO_ROBOT else (conversation.port, client)
                other = TO_HOST if direction == TO_ROBOT else TO_ROBOT
                packets.append(_packet(*ports, next_bytes[direction], next_bytes[other], part))
                next_bytes[direction] += len(part)
    with path.open("wb") as file:
        # Magic number, version 2.4, no time zone, whole packets, Ethernet.
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 0x40000, ETHERNET))
        for number, packet in enumerate(packets):
            file.write(struct.pack("<IIII", number // 1000, number % 1000 * 1000, len(packet), len(packet)) + packet)


def _packet(source: int, target: int, sequence: int, acknowledged: int, data: bytes) -> bytes:
    tcp = struct.pack(">HHIIBBHHH", source, target, sequence, acknowledged, 5 << 4, 0x18, 65535, 0, 0)
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 40 + len(data), 0, 0x4000, 64, 6, 0, b"\x7f\0\0\1", b"\x7f\0\0\1")
    return bytes(12) + b"\x08\0" + ip + tcp + data


def dissect(capture: Path, dissector: Path, options: tuple[str, ...] = ()) -> dict[int, list[list[tuple[str, str]]]]:
    """Return the messages of each connection as tshark shows them: fields (name, value) in order, nested ones after."""
    done = subprocess.run(
        ["tshark", "-r", str(capture), "-X", f"lua_script:{dissector}", "-T", "json", "-J", f"tcp {LAYERS}", *options],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert "Lua" not in done.stderr, done.stderr
    found: dict[int, list[list[tuple[str, str]]]] = {}
    for packet in json.loads(done.stdout, object_pairs_hook=list):
        layers = dict(dict(packet)["_source"])["layers"]
        stream = int(dict(dict(layers)["tcp"])["tcp.stream"])
        messages = [value for name, value in layers if name in LAYERS.split()]
        found.setdefault(stream, []).extend(list(_flat(message)) for message in messages)
    return found


def _flat(tree: Any) -> Any:
    for name, value in tree:
        if isinstance(value, str):
            yield name, value
        else:
            yield from _flat(value)
