"""Measure the cost of a faulty line: `gs` to an emulated N150 on a serial line with a fault plan, in simulated time.

    python benchmarks/faulty_exchanges.py [--exchanges N] [--seed N] [--json]

Targets for 100,000 exchanges: with one faulty byte in every tenth, no wrong value is accepted and only the faulty ones
are lost; with 1 % of all bytes corrupted and 1 % dropped, at most 30 wrong values pass the 8-bit checksum, and fewer
the validation. The oracle decodes the robot's replies with struct alone, before the faults. Nothing sleeps.
"""

from __future__ import annotations

import argparse
import json
import struct
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, field

from nclient.backends.direct import DirectBackend
from nclient.errors import ReplyTimeout, RobotRefused
from nclient.faults.inject import FaultyLine, FaultyStream, Injector, LineLanguage, total
from nclient.faults.plan import BOTH, Corrupt, Direction, DropByte, Fault, InsertBytes, Noise, Plan, Rule, When
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150
from nclient.transports.stream import Deadline
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import SerialSession
from nserver_emu.simulation.simulation import Simulation
from worlds.io import load_world
from worlds.world import StartPose

GS = Call("gs")
# Ten bits for each byte: a start bit, eight data bits and a stop bit.
BYTE_S = 10 / 38400
POLL_S = 0.25
"""Interval at which a reply is polled for."""
INSTANT_S = 1e-9
"""A wait below this is none: the simulation counts in whole picoseconds."""
PACKET = struct.Struct("<16s3s8HBIBB")
"""An N150's state packet: sonars, bumpers, pose and velocities and compass, motors, clock, voltages."""
ONE_BYTE: tuple[Fault, ...] = (Corrupt(), DropByte(), InsertBytes())
NOISE: tuple[Fault, ...] = (Noise(corrupt_percent=1.0, drop_percent=1.0),)
TARGET_WRONG = 30


class SimulatedCable:
    """A ByteStream to an emulated robot that drives in circles; time passes only with bytes and with waiting."""

    def __init__(self, seed: int) -> None:
        self._simulation = Simulation(load_world("thesis_room"), seed)
        emulator = Emulator(self._simulation)
        # In circles, so that each reply differs from the one before: a late reply has wrong values.
        self._simulation.add_robot(1, StartPose(45.0, 30.0, 0.0, 0.0)).set_velocities(3.0, 0.2, -0.3)
        self._session = SerialSession(emulator.answer, 1, N150, self.now)
        self._transit_s = 0.0
        self.last_reply = b""
        """The last reply of the robot."""

    def now(self) -> float:
        """Return the simulated time in seconds."""
        return self._simulation.time_s + self._transit_s

    def sleep(self, seconds: float) -> None:
        """Let simulated time pass."""
        self._simulation.step(self._transit_s + seconds)
        self._transit_s = 0.0

    def send(self, data: bytes) -> None:
        """Send a request, which the robot answers with its state at arrival."""
        # The request takes its time on the line; the state is that of its arrival.
        self.sleep(len(data) * BYTE_S)
        self._session.receive(data)

    def receive(self, deadline: Deadline) -> bytes:
        """Return the robot's reply. Raises ReplyTimeout at the deadline."""
        # Simulated time passes only while the client waits: a run takes seconds, and repeats exactly.
        while not (data := self._session.tick() + self._session.process_requests(max_requests=100)):
            left_s = deadline.remaining()
            if left_s < INSTANT_S:
                raise ReplyTimeout("the robot is silent")
            self.sleep(min(left_s, POLL_S))
        self.last_reply = data
        # The reply's own time on the line passes before the next request.
        # Ten bits per byte at 38400 baud.
        self._transit_s += len(data) * BYTE_S
        return data

    def close(self) -> None:
        """Do nothing."""


@dataclass
class Outcome:
    """Results of exchanges, numbered from 1; `struck` is the fault plan's count by kind."""

    exchanges: int
    right: int = 0
    wrong: int = 0
    lost: list[int] = field(default_factory=list)
    struck: dict[str, int] = field(default_factory=dict)
    link: dict[str, int] = field(default_factory=dict)
    simulated_s: float = 0.0


def exchange(plan: Plan, exchanges: int, *, checks: bool = True) -> Outcome:
    """Send requests under a fault plan, without retries, and compare each reply with the one that the robot sent."""
    # Inside out: simulated line, faults, client.
    cable = SimulatedCable(plan.seed)
    injector = Injector(plan, "serial:1")
    line = FaultyStream(cable, FaultyLine(LineLanguage(), lambda: injector), cable.now, cable.sleep)
    backend = DirectBackend(line, N150, checks=checks, clock=cable.now)
    outcome = Outcome(exchanges)
    for number in range(1, exchanges + 1):
        # Nothing was sent yet: a reply of an earlier exchange must not count as this one's.
        cable.last_reply = b""
        try:
            reply = backend.execute(GS)
        except (ReplyTimeout, RobotRefused):
            outcome.lost.append(number)
            continue
        if numbers_of(reply) == read_packet(cable.last_reply):
            outcome.right += 1
        else:
            outcome.wrong += 1
    outcome.struck = dict(total(injector.counts))
    outcome.link = backend.link.counts()
    outcome.simulated_s = cable.now()
    return outcome


def one_byte(faults: tuple[Fault, ...], direction: Direction, seed: int) -> Plan:
    """Return the plan of a faulty byte in every tenth request or reply."""
    rule = Rule("tenth", faults, When(every=10), commands=("gs",), directions=frozenset({direction}))
    return Plan((rule,), seed)


def noise(seed: int) -> Plan:
    """Return the plan that corrupts 1 % and drops 1 % of all bytes in both directions."""
    return Plan((Rule("noise", NOISE, directions=BOTH),), seed)


def missed(outcome: Outcome) -> list[str]:
    """Return the missed targets; noise affects every byte, other plans every tenth exchange."""
    # Noise may produce a valid checksum: a low rate of wrong values is allowed.
    if "noise" in outcome.struck:
        # The bound is for 100,000 exchanges; a short run may have one.
        allowed = max(1, TARGET_WRONG * outcome.exchanges // 100_000)
        return [f"{outcome.wrong} wrong values, {allowed} at most"] if outcome.wrong > allowed else []
    # Plans affect every tenth exchange: others must not be lost.
    clean = [number for number in outcome.lost if number % 10]
    struck = sum(outcome.struck.values())
    return [
        text
        for text, bad in (
            (f"{outcome.wrong} wrong values", outcome.wrong),
            (f"lost without a fault: {clean[:5]}", clean),
            (f"{struck} faults, one in ten wanted", struck != outcome.exchanges // 10),
            ("the client's count of failures is another", len(outcome.lost) != _failures(outcome)),
        )
        if bad
    ]


def _failures(outcome: Outcome) -> int:
    return outcome.link["timeouts"] + outcome.link["naks"]


def read_packet(frame: bytes) -> tuple[int, ...]:
    """Decode the frame of a state packet by docs/protocol.md, in the order of `numbers_of`; () for other frames."""
    # 6 bytes of the frame; type 7 is the reply to gs.
    if len(frame) != PACKET.size + 6 or frame[3] != 7:
        return ()
    sonars, bumpers, *shorts, motors, clock, cpu, motor = PACKET.unpack(frame[4:-2])
    # Sign-magnitude: the top bit is the sign.
    signed = [0x8000 - short if short & 0x8000 else short for short in shorts]
    return (*sonars, int.from_bytes(bumpers, "big"), *signed, motors, clock, cpu, motor)


def numbers_of(reply: Reply) -> tuple[int, ...]:
    """Return the numbers of a state in the order of the packet."""
    slots = reply.slots
    order = (*range(17, 41), 43, 41)
    return (*(slots[slot] for slot in order), reply.clock or 0, *(reply.volts or ()))


def plans(seed: int) -> dict[str, tuple[Plan, bool]]:
    """Return the fault plans to measure, each with True if replies are validated."""
    return {
        "every tenth answer, one byte": (one_byte(ONE_BYTE, Direction.REPLY, seed), True),
        "every tenth question, one byte": (one_byte(ONE_BYTE, Direction.REQUEST, seed), True),
        "1 % corrupted, 1 % dropped, checksum alone": (noise(seed), False),
        "1 % corrupted, 1 % dropped, with checks": (noise(seed), True),
    }


def row(name: str, outcome: Outcome, taken_s: float) -> str:
    """Return a row of the table in docs/results.md."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(Counter(outcome.struck).items()) if count)
    return (
        f"| {name} | {kinds} | {outcome.right} | {len(outcome.lost)} | {outcome.wrong} "
        f"| {outcome.simulated_s / 3600:.1f} h in {taken_s:.0f} s |"
    )


def main() -> int:
    """Measure and print; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exchanges", type=int, default=100_000, help="a plan (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the faults and of the robot (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    results, misses = {}, []
    if not options.json:
        print("| faults | struck | right | lost | wrong | simulated time |\n|---|---|---|---|---|---|")
    for name, (plan, checks) in plans(options.seed).items():
        start_s = time.perf_counter()
        outcome = exchange(plan, options.exchanges, checks=checks)
        misses += [f"{name}: {what}" for what in missed(outcome)]
        results[name] = asdict(outcome) | {"lost": len(outcome.lost)}
        if not options.json:
            print(row(name, outcome, time.perf_counter() - start_s), flush=True)
    if options.json:
        print(json.dumps(results))
    print("\n".join(misses) or "all targets met", file=sys.stderr)
    return 1 if misses else 0


if __name__ == "__main__":
    raise SystemExit(main())
