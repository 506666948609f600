"""Measure the client: `robot.refresh()` over TCP, relative to a bare asyncio echo of the same sizes.

    python benchmarks/client.py [--rounds N] [--calls N] [--json]

Target: a ratio of at least 0.4. The client builds a request, parses the reply and creates a RobotState; the other
end is nserver.
"""

from __future__ import annotations

import json
import sys

from echo import Pinger, compare, parsed_options, start_echo, started

from nclient import Robot, connect
from nclient.protocol import codec
from nclient.protocol.commands import Call

TARGET_RATIO = 0.4
# A header of 4 bytes and the 49 words of a state without laser and stamps.
REPLY_SIZE = 4 + 4 * 49


def measure(rounds: int, calls: int) -> dict[str, float]:
    """Return rates, 99th percentiles and the ratio."""
    # The echo server gets and sends the same numbers of bytes as the daemon.
    gs = codec.encode_tcp_request(Call("gs"))
    daemon = [sys.executable, "-m", "nserver_emu", "--port", "0"]
    with start_echo(len(gs), REPLY_SIZE) as echo_port, started(daemon) as line:
        echo = Pinger(echo_port, gs, REPLY_SIZE)
        with connect(f"nserver://{line.removeprefix('listening nserver ')}/1") as robot:
            # Client and baseline by turns: load on the machine affects both.
            paces = compare({"client": lambda: _refresh(robot), "echo": echo}, rounds, calls)
        echo.close()
    return {
        "refresh_per_second": paces["client"].per_second,
        "echo_per_second": paces["echo"].per_second,
        "ratio": paces["client"].per_second / paces["echo"].per_second,
        "ratio_target": TARGET_RATIO,
        "p99_ms": paces["client"].p99_ms,
        "echo_p99_ms": paces["echo"].p99_ms,
    }


def _refresh(robot: Robot) -> None:
    robot.refresh()


def main() -> None:
    """Measure and print."""
    options = parsed_options(__doc__)
    result = measure(options.rounds, options.calls)
    if options.json:
        print(json.dumps(result))
        return
    print(f"refresh {result['refresh_per_second']:.0f}/s, echo {result['echo_per_second']:.0f}/s: "
          f"ratio {result['ratio']:.2f} (target {TARGET_RATIO})")
    print(f"99 % within {result['p99_ms']:.2f} ms, echo {result['echo_p99_ms']:.2f} ms")


if __name__ == "__main__":
    main()
