"""What becomes of the bytes of one frame: functions of bytes, a fault and chance.

Rules: each changes something: a byte that is corrupted is another than it was; what is cut off is a byte or more.
"""

from __future__ import annotations

from collections import Counter
from random import Random

from nclient.faults.kinds import BIT, Alteration, Corrupt, DropByte, Noise, Stray

CORRUPTED, DROPPED, ADDED = "corrupted_bytes", "dropped_bytes", "added_bytes"


def altered(data: bytes, fault: Alteration, chance: Random) -> bytes:
    """The bytes after the fault; `data` has at least one, the result may have none."""
    match fault:
        case Corrupt():
            place = _place(fault.place, len(data), chance)
            return data[:place] + bytes((_other(data[place], fault.change, chance),)) + data[place + 1 :]
        case DropByte():
            place = _place(fault.place, len(data), chance)
            return data[:place] + data[place + 1 :]
        case Stray():
            place = _place(fault.place, len(data) + 1, chance)
            return data[:place] + chance.randbytes(fault.count) + data[place:]
    most = len(data) - 1
    return data[: chance.randint(min(1, most), most) if fault.keep is None else min(fault.keep, most)]


def with_noise(data: bytes, noise: Noise, chance: Random, tally: Counter[str]) -> bytes:
    """The bytes after noise on each of them; what happened is added to the tally, bytes by kind and frames touched."""
    dropped = noise.drop_percent / 100.0
    corrupted = dropped + noise.corrupt_percent / 100.0
    added = corrupted + noise.add_percent / 100.0
    arrived, happened = bytearray(), Counter[str]()
    for byte in data:
        draw = chance.random()
        if draw >= added:
            arrived.append(byte)
        elif draw < dropped:
            happened[DROPPED] += 1
        elif draw < corrupted:
            happened[CORRUPTED] += 1
            arrived.append(_other(byte, noise.change, chance))
        else:
            happened[ADDED] += 1
            arrived += bytes((byte, chance.randrange(256)))
    if happened:
        tally.update(happened)
        tally[noise.kind] += 1
    return bytes(arrived)


def _place(wanted: int | None, count: int, chance: Random) -> int:
    """An index from 0 below `count`: the wanted one, or the nearest there is, or by chance."""
    if wanted is None:
        return chance.randrange(count)
    return min(max(wanted + count if wanted < 0 else wanted, 0), count - 1)


def _other(byte: int, change: str, chance: Random) -> int:
    return byte ^ (1 << chance.randrange(8) if change == BIT else chance.randrange(1, 256))
