"""What to show of an answer: the part of the state that was asked for, or the numbers of a reply that is held nowhere.

Rules: pure; a kind of reply is a row of SHOWN or of VALUES, and one that is neither shows its numbers as they came.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.units import unwrapped_word
from nclient.robot_state import NOTHING_IN, RobotState
from nclient.shell import glance

SHOWN = {
    "infrared": ("infrared",), "sonar": ("sonar",), "bumper": ("bumpers",), "compass": ("compass",),
    "laser": ("laser",), "velocity": ("velocity",),
}  # fmt: skip
"""Parts of the state by the kind of reply that brings them."""


def shown(call: Call, reply: Reply, state: RobotState) -> Iterator[str]:
    """Lines that tell what came of a call; `state`: what is known after it."""
    if call.name == "get_ra":
        yield _accelerations(reply)
    elif reply.kind == "state":
        yield glance.line(state)
    elif reply.kind == "configuration":
        yield _clicked(reply) if reply.values else next(glance.lines(state, ("pose",)))
    elif reply.kind in SHOWN and not reply.values:
        yield from glance.lines(state, SHOWN[reply.kind])
    elif call.name in VALUES:
        yield from VALUES[call.name](reply)
    else:
        yield _plain(reply)


def _plain(reply: Reply) -> str:
    if reply.kind == "nak":
        return "the robot said no (NAK)"
    return " ".join(map(str, reply.values)) if len(reply.values) > 1 else "ok"


def _accelerations(reply: Reply) -> str:
    told = [reply.slots.get(slot, 0) / 10 for slot in (38, 39, 40)]
    return "translation {:.1f} in/s2  steering {:.1f} deg/s2  turret {:.1f} deg/s2".format(*told)


def _clicked(reply: Reply) -> str:
    return "x {:.1f} in  y {:.1f} in  steering {:.1f} deg  turret {:.1f} deg".format(
        *[value / 10 for value in reply.values]
    )


def _truth(reply: Reply) -> Iterator[str]:
    _, time_ms, x, y, heading, turret, seed, robot = reply.values
    yield (
        f"in truth x {x / 1000:.3f} in  y {y / 1000:.3f} in  heading {heading / 1000:.3f} deg  "
        f"turret {turret / 1000:.3f} deg | {unwrapped_word(time_ms) / 1000:.3f} s | robot {robot}, seed {seed}"
    )


def _time(reply: Reply) -> Iterator[str]:
    _, time_ms, speed, paused = reply.values
    pace = "paused" if paused else f"{speed / 10:g} x real time" if speed else "as clients ask, or as fast as it can"
    yield f"simulated time {time_ms / 1000:.3f} s, {pace}"


def _collision(reply: Reply) -> Iterator[str]:
    hit, x, y, normal = reply.values
    yield f"hits at x {x / 1000:.1f} in  y {y / 1000:.1f} in, normal {normal / 1e6:.3f} rad" if hit else "free"


def _robots(reply: Reply) -> Iterator[str]:
    count, *numbers = reply.values
    for number in range(count):
        x, y, heading = numbers[3 * number : 3 * number + 3]
        yield f"robot {number + 1}: x {x / 10:.1f} in  y {y / 10:.1f} in  heading {heading / 10:.1f} deg"


def _prediction(reply: Reply) -> Iterator[str]:
    yield f"infrared    {' '.join(f'{reading:3}' for reading in reply.values[1:17])}"
    sonars = ("  -" if reading >= NOTHING_IN else f"{reading:3}" for reading in reply.values[17:33])
    yield f"sonar       {' '.join(sonars)}  in"


VALUES: dict[str, Callable[[Reply], Iterator[str]]] = {
    "sim_truth": _truth, "sim_control": _time, "motion_check": _collision, "get_rpx": _robots,
    "predict_sensors": _prediction,
}  # fmt: skip
"""Replies that are held nowhere, by the command."""
