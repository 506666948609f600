"""A long conversation in lockstep with noise on, as a program: prints a hash of all the replies' bytes.

    python lockstep_run.py SEED REPLIES [OPTIONS]            options of the address, noisy=1 where left out

Every kind of request is among them; what is asked follows from its number alone.
"""

from __future__ import annotations

import hashlib
import sys

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING
from nserver_emu.server.inprocess import open_address

ORDER = (0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8)


def request(number: int) -> Call:
    """The request of that number."""
    match number % 50:
        case 0:
            return Call("conf_sn", (number % 16, *ORDER))
        case 7:
            return Call("vm", (number % 91 - 40, number % 301 - 150, number % 101 - 50))
        case 19:
            return Call("pr", (number % 77 - 38, 100 - number % 201, 450))
        case 23:
            return Call("ws", (1, 1, 1, 2))
        case 31:
            return Call("add_obstacle", (3, 700 + number % 50, 700, 800, 700, 800, 800))
        case 37:
            return Call("ct", EVERYTHING.with_position(number % 32).smask)
        case 43:
            return Call("new_world")
        case 47:
            return Call("predict_sensors", (number % 300, number % 200, 0, number % 3600))
    return Call(("gs", "get_sn", "get_rc", "get_rv", "sim_truth", "get_bp", "get_ra")[number % 7])


def run(seed: int, replies: int, options: str = "noisy=1") -> str:
    """The hash of so many replies."""
    end = open_address(f"sim:thesis_room?{options}&seed={seed}&start=20,20,30,0&step_s=0.05")
    whole = hashlib.sha256()
    end.send(codec.encode_tcp_request(Call("connect_robot", (1, 1))))
    for number in range(replies):
        end.send(codec.encode_tcp_request(request(number)))
        answered = end.receive()
        assert answered, number
        whole.update(answered)
    return whole.hexdigest()


if __name__ == "__main__":
    print(run(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]))
