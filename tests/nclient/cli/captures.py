"""Captures as Wireshark reads them: connections of bytes as a pcap file, and what tshark shows of it."""

from __future__ import annotations

import json
import struct
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

TO_ROBOT, TO_HOST = ">", "<"
# Below the 1460 bytes that a TCP segment has on Ethernet.
MAX_SEGMENT = 1400
# Link type of the pcap header (LINKTYPE_ETHERNET).
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
        # Sequence numbers after the SYN of each side.
        next_bytes = {TO_ROBOT: 1, TO_HOST: 1}
        # A client port for each connection: without it tshark would take all for one stream.
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
            # Time in seconds and microseconds, one millisecond a packet; the captured length is the whole length.
            file.write(struct.pack("<IIII", number // 1000, number % 1000 * 1000, len(packet), len(packet)) + packet)


def _packet(source: int, target: int, sequence: int, acknowledged: int, data: bytes) -> bytes:
    # Header of 5 words, flags PSH and ACK, a window of 65535, checksum 0, which tshark does not verify by default.
    tcp = struct.pack(">HHIIBBHHH", source, target, sequence, acknowledged, 5 << 4, 0x18, 65535, 0, 0)
    # IPv4 with a header of 5 words, "don't fragment", time to live 64, protocol 6 (TCP), loopback on both sides.
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 40 + len(data), 0, 0x4000, 64, 6, 0, b"\x7f\0\0\1", b"\x7f\0\0\1")
    # Ethernet addresses of zeros, then the type 0x0800 of IPv4.
    return bytes(12) + b"\x08\0" + ip + tcp + data


def dissect(capture: Path, dissector: Path, options: tuple[str, ...] = ()) -> dict[int, list[list[tuple[str, str]]]]:
    """Return the messages of each connection as tshark shows them: fields (name, value) in order, nested ones after."""
    done = subprocess.run(
        # JSON of the layers `tcp` (for the stream number) and the dissector's own.
        ["tshark", "-r", str(capture), "-X", f"lua_script:{dissector}", "-T", "json", "-J", f"tcp {LAYERS}", *options],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    # An error in the Lua script leaves the exit code 0, and is written to stderr.
    assert "Lua" not in done.stderr, done.stderr
    found: dict[int, list[list[tuple[str, str]]]] = {}
    # Repeated names are the rule, such as one for each mask entry: pairs are read instead of dictionaries.
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
