"""What a faulty line costs: `gs` to an emulated N150 on its own line, in simulated time, a plan of faults between.

    python benchmarks/faulty_exchanges.py [--exchanges N] [--seed N] [--json]

Targets, of 100,000 exchanges: with one faulty byte in every tenth, no wrong value believed and none lost but the faulty
ones; with 1 % of all bytes corrupted and 1 % dropped, at most 30 wrong values past the 8-bit checksum, and fewer past
the plausibility checks. What the robot said is read with struct alone, before the faults. Nothing sleeps.
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
from nclient.faults.frames import Injector, LineLanguage, total
from nclient.faults.inject import FaultyLine, FaultyStream
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
BYTE_S = 10 / 38400
LOOK_S = 0.25
"""How often a robot that is waited for is looked at."""
INSTANT_S = 1e-9
"""Less is no time at all: the simulation counts in whole picoseconds."""
PACKET = struct.Struct("<16s3s8HBIBB")
"""An N150's state packet: sonars, bumpers, pose and velocities and compass, motors, clock, voltages."""
ONE_BYTE: tuple[Fault, ...] = (Corrupt(), DropByte(), InsertBytes())
NOISE: tuple[Fault, ...] = (Noise(corrupt_percent=1.0, drop_percent=1.0),)
TARGET_WRONG = 30


class SimulatedCable:
    """A ByteStream to an emulated robot that drives in circles; time passes with bytes and with waiting alone."""

    def __init__(self, seed: int) -> None:
        self._simulation = Simulation(load_world("thesis_room"), seed)
        emulator = Emulator(self._simulation)
        self._simulation.add_robot(1, StartPose(45.0, 30.0, 0.0, 0.0)).set_velocities(3.0, 0.2, -0.3)
        self._session = SerialSession(emulator.answer, 1, N150, self.now)
        self._under_way_s = 0.0
        self.said = b""
        """What the robot answered last."""

    def now(self) -> float:
        """Simulated time, in seconds."""
        return self._simulation.time_s + self._under_way_s

    def sleep(self, seconds: float) -> None:
        """Let simulated time pass."""
        self._simulation.step(self._under_way_s + seconds)
        self._under_way_s = 0.0

    def send(self, data: bytes) -> None:
        """To the robot, which makes an answer of how things stand then."""
        self.sleep(len(data) * BYTE_S)
        self._session.receive(data)

    def receive(self, deadline: Deadline) -> bytes:
        """What the robot says until then. Raises ReplyTimeout."""
        while not (data := self._session.tick() + self._session.process_requests(max_requests=100)):
            left_s = deadline.remaining()
            if left_s < INSTANT_S:
                raise ReplyTimeout("the robot is silent")
            self.sleep(min(left_s, LOOK_S))
        self.said = data
        self._under_way_s += len(data) * BYTE_S
        return data

    def close(self) -> None:
        """Nothing is held."""


@dataclass
class Outcome:
    """What became of the exchanges, which are numbered from 1; `struck` is the plan's own count, by kind."""

    exchanges: int
    right: int = 0
    wrong: int = 0
    lost: list[int] = field(default_factory=list)
    struck: dict[str, int] = field(default_factory=dict)
    link: dict[str, int] = field(default_factory=dict)
    simulated_s: float = 0.0


def exchange(plan: Plan, exchanges: int, *, checks: bool = True) -> Outcome:
    """So many questions under a plan, none asked twice, and each answer held against what the robot said to it."""
    cable = SimulatedCable(plan.seed)
    injector = Injector(plan, "serial:1")
    line = FaultyStream(cable, FaultyLine(LineLanguage(), lambda: injector), cable.now, cable.sleep)
    backend = DirectBackend(line, N150, checks=checks, clock=cable.now)
    outcome = Outcome(exchanges)
    for number in range(1, exchanges + 1):
        cable.said = b""
        try:
            reply = backend.execute(GS)
        except (ReplyTimeout, RobotRefused):
            outcome.lost.append(number)
            continue
        if spoken(reply) == read_packet(cable.said):
            outcome.right += 1
        else:
            outcome.wrong += 1
    outcome.struck = dict(total(injector.counts))
    outcome.link = backend.link.counts()
    outcome.simulated_s = cable.now()
    return outcome


def one_byte(faults: tuple[Fault, ...], direction: Direction, seed: int) -> Plan:
    """A faulty byte in every tenth question, or in every tenth answer."""
    rule = Rule("tenth", faults, When(every=10), commands=("gs",), directions=frozenset({direction}))
    return Plan((rule,), seed)


def noise(seed: int) -> Plan:
    """One byte in a hundred corrupted and one dropped, both ways, whatever is asked."""
    return Plan((Rule("noise", NOISE, directions=BOTH),), seed)


def missed(outcome: Outcome) -> list[str]:
    """Which targets these exchanges miss; noise is on every byte, else every tenth exchange was struck."""
    if "noise" in outcome.struck:
        most = max(1, TARGET_WRONG * outcome.exchanges // 100_000)
        return [f"{outcome.wrong} wrong values, {most} at most"] if outcome.wrong > most else []
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
    """The numbers in the frame of a state packet, as PROTOCOL.md has them, in the order of `spoken`; () for others."""
    if len(frame) != PACKET.size + 6 or frame[3] != 7:
        return ()
    sonars, bumpers, *shorts, motors, clock, cpu, motor = PACKET.unpack(frame[4:-2])
    signed = [0x8000 - short if short & 0x8000 else short for short in shorts]
    return (*sonars, int.from_bytes(bumpers, "big"), *signed, motors, clock, cpu, motor)


def spoken(reply: Reply) -> tuple[int, ...]:
    """The numbers of a state in the packet's order."""
    slots = reply.slots
    order = (*range(17, 41), 43, 41)
    return (*(slots[slot] for slot in order), reply.clock or 0, *(reply.volts or ()))


def plans(seed: int) -> dict[str, tuple[Plan, bool]]:
    """What is measured: a plan each, and whether answers are checked for what can be true."""
    return {
        "every tenth answer, one byte": (one_byte(ONE_BYTE, Direction.REPLY, seed), True),
        "every tenth question, one byte": (one_byte(ONE_BYTE, Direction.REQUEST, seed), True),
        "1 % corrupted, 1 % dropped, checksum alone": (noise(seed), False),
        "1 % corrupted, 1 % dropped, with checks": (noise(seed), True),
    }


def row(name: str, outcome: Outcome, taken_s: float) -> str:
    """A line of the table in docs/results.md."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(Counter(outcome.struck).items()) if count)
    return (
        f"| {name} | {kinds} | {outcome.right} | {len(outcome.lost)} | {outcome.wrong} "
        f"| {outcome.simulated_s / 3600:.1f} h in {taken_s:.0f} s |"
    )


def main() -> int:
    """Measure and print; 1 where a target is missed."""
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
