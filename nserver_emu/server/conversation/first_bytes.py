"""What the first message of a connection gives away that says no CONNECT: how wide its sender's words are.

    32 bits   type, count | word   word   ...          a 64-bit client sends every word as
    64 bits   type, count | 0 word 0 word ...          four zero bytes and then its value

Rules: bytes in, an answer out. A word that is not 0 where a 64-bit client sends zeros tells for certain; zeros in all
those places tell nothing by themselves, but for a mask (ct), that a client begins with and that has bits in its first
byte. Nobody is kept waiting for bytes that do not have to come.
"""

from __future__ import annotations

from typing import Final

from nclient.protocol.commands import BY_NAME
from nclient.protocol.tcp_frame import request_bounds

_HEADER_BYTES: Final = 4
_WORD_BYTES: Final = 4
_MOST_WORDS: Final = 8
"""Words that are looked at, of a message that has more."""

_CONNECTS: Final = ("connect_robot", "create_robot", "disconnect_robot")
_CONNECT_TYPES: Final = frozenset(BY_NAME[name].tcp_type for name in _CONNECTS)
_MASK_TYPE: Final = BY_NAME["ct"].tcp_type


def enough(head: bytes) -> bool:
    """Whether these first bytes tell all that they can."""
    if len(head) < _HEADER_BYTES:
        return len(head) >= 2 and (connects(head) or request_bounds(_type(head)) is None)
    bounds = request_bounds(_type(head))
    if connects(head) or bounds is None or not bounds[0] <= _count(head) <= bounds[1]:
        return True
    return len(head) >= _HEADER_BYTES + _WORD_BYTES * min(_count(head), _MOST_WORDS)


def connects(head: bytes) -> bool:
    """Whether the first message says by itself who comes."""
    return _type(head) in _CONNECT_TYPES


def width(head: bytes) -> bool | None:
    """True for words of 64 bits, False for 32, None where these bytes do not tell."""
    words = [head[at : at + _WORD_BYTES] for at in range(_HEADER_BYTES, len(head) - 3, _WORD_BYTES)]
    words = words[: _count(head)]
    if any(any(word) for word in words[::2]):
        return False
    return True if _type(head) == _MASK_TYPE and any(any(word) for word in words) else None


def _type(head: bytes) -> int:
    return int.from_bytes(head[:2], "big", signed=True)


def _count(head: bytes) -> int:
    return int.from_bytes(head[2:_HEADER_BYTES], "big")
