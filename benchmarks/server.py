"""Measure the round trips per second of `gs` against a bare asyncio echo server with messages of the same sizes.

    python benchmarks/server.py [--rounds N] [--calls N] [--json]

Target: a ratio of at least 0.65, and a 99th percentile under 1 ms. The client sends prepared bytes
and decodes nothing, so that only the server is measured; both servers are processes and are measured alternately.
"""

from __future__ import annotations

import json
import sys

from echo import Pinger, compare, parsed_options, start_echo, started

from nclient.protocol import codec
from nclient.protocol.commands import Call

TARGET_RATIO, TARGET_P99_MS = 0.65, 1.0
REPLY_SIZE = 4 + 4 * 49
CONNECT_REPLY_SIZE = 8


def measure(rounds: int, calls: int) -> dict[str, float]:
    """Rates, 99th percentiles and their ratio."""
    gs = codec.encode_tcp_request(Call("gs"))
    connect = codec.encode_tcp_request(Call("connect_robot", (1, 1)))
    # No limit of the request rate: the client sends as fast as the server replies.
    daemon = [sys.executable, "-m", "nserver_emu", "--port", "0", "--limit-rate", "0"]
    with start_echo(len(gs), REPLY_SIZE) as echo_port, started(daemon) as line:
        sides = {
            "nserver": Pinger(int(line.rpartition(":")[2]), gs, REPLY_SIZE, connect, CONNECT_REPLY_SIZE),
            "echo": Pinger(echo_port, gs, REPLY_SIZE),
        }
        paces = compare(dict(sides), rounds, calls)
        for pinger in sides.values():
            pinger.close()
    return {
        "gs_per_second": paces["nserver"].per_second,
        "echo_per_second": paces["echo"].per_second,
        "ratio": paces["nserver"].per_second / paces["echo"].per_second,
        "ratio_target": TARGET_RATIO,
        "p99_ms": paces["nserver"].p99_ms,
        "echo_p99_ms": paces["echo"].p99_ms,
        "p99_ms_target": TARGET_P99_MS,
    }


def main() -> None:
    """Measure and print."""
    options = parsed_options(__doc__)
    result = measure(options.rounds, options.calls)
    if options.json:
        print(json.dumps(result))
        return
    print(f"gs {result['gs_per_second']:.0f}/s, echo {result['echo_per_second']:.0f}/s: "
          f"ratio {result['ratio']:.2f} (target {TARGET_RATIO})")
    print(f"99 % within {result['p99_ms']:.2f} ms (target {TARGET_P99_MS}), echo {result['echo_p99_ms']:.2f} ms")


if __name__ == "__main__":
    main()
