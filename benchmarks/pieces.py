"""Measure the time of an exchange with a client that writes its request in pieces, against one that writes it at once.

    python benchmarks/pieces.py [--rounds N] [--calls N] [--json]

Programs of the 1990s write header and words one by one and leave Nagle's algorithm on: their system sends the second
piece when the first is acknowledged, which the peer's system delays by about 40 ms. Target: less than 2 ms more than
in one piece.
"""

from __future__ import annotations

import json
import sys

from echo import Pinger, compare, parsed_options, started

from nclient.protocol import codec
from nclient.protocol.commands import Call

TARGET_MS = 2.0
REPLY_SIZE, CONNECT_REPLY_SIZE = 4 + 4 * 49, 8
# A header of 4 bytes, and then the words one by one.
PIECE_SIZE = 4


def measure(rounds: int, calls: int) -> dict[str, float]:
    """Return the mean time of an exchange sent whole and in pieces, and the difference."""
    request = codec.encode_tcp_request(Call("vm", (0, 0, 0)))
    connect = codec.encode_tcp_request(Call("connect_robot", (1, 1)))
    # No limit of the request rate.
    with started([sys.executable, "-m", "nserver_emu", "--port", "0", "--limit-rate", "0"]) as line:
        port = int(line.rpartition(":")[2])
        sides = {
            "whole": Pinger(port, request, REPLY_SIZE, connect, CONNECT_REPLY_SIZE),
            "pieces": Pinger(port, request, REPLY_SIZE, connect, CONNECT_REPLY_SIZE, PIECE_SIZE),
        }
        paces = compare(dict(sides), rounds, calls)
        for pinger in sides.values():
            pinger.close()
    # The mean time of an exchange, from the median rate of the rounds.
    whole_ms, pieces_ms = (1000 / paces[name].per_second for name in ("whole", "pieces"))
    delay_ms = pieces_ms - whole_ms
    return {"whole_ms": whole_ms, "pieces_ms": pieces_ms, "delay_ms": delay_ms, "delay_ms_target": TARGET_MS}


def main() -> None:
    """Measure and print."""
    options = parsed_options(__doc__)
    result = measure(options.rounds, min(options.calls, 500))
    if options.json:
        print(json.dumps(result))
        return
    print(f"vm in one piece {result['whole_ms']:.2f} ms, in pieces {result['pieces_ms']:.2f} ms: "
          f"{result['delay_ms']:.2f} ms more (target {TARGET_MS:g})")


if __name__ == "__main__":
    main()
