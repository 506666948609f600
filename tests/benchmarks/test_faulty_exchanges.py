"""A faulty line in simulated time: accepted replies are correct, and the counts equal those of the plan.

The whole run, 100,000 exchanges a plan, is `python benchmarks/faulty_exchanges.py`; here are its first ones.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from faulty_exchanges import ONE_BYTE, PACKET, Outcome, exchange, missed, noise, one_byte, read_packet

from nclient.faults.plan import Corrupt, Direction, DropByte, Fault, InsertBytes, Noise, Plan, Rule
from nclient.protocol.serial_framing import build_frame

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "faulty_exchanges.py"
SLICE = 2000
# Every tenth exchange has a fault: the numbers of those exchanges.
TENTHS = range(10, SLICE + 1, 10)


def test_a_clean_line_loses_nothing() -> None:
    outcome = exchange(Plan(), 300)
    assert (outcome.right, outcome.wrong, outcome.lost) == (300, 0, [])
    assert (outcome.link["exchanges"], outcome.link["answers"], outcome.link["skipped_bytes"]) == (300, 300, 0)


@pytest.mark.parametrize("direction", Direction)
def test_one_faulty_byte_in_every_tenth_exchange(direction: Direction) -> None:
    outcome = exchange(one_byte(ONE_BYTE, direction, seed=5), SLICE)
    assert outcome.wrong == 0
    assert set(outcome.lost) <= set(TENTHS)
    assert outcome.right == SLICE - len(outcome.lost)
    assert sum(outcome.struck.values()) == len(TENTHS)
    assert set(outcome.struck) == {"corrupt", "drop_byte", "stray"}
    assert outcome.link["timeouts"] + outcome.link["naks"] == len(outcome.lost)
    # A stray byte may be skipped without a loss; a missing or changed one always costs the reply.
    assert outcome.struck["corrupt"] + outcome.struck["drop_byte"] <= len(outcome.lost) <= len(TENTHS)


@pytest.mark.parametrize("fault", [Corrupt(), Corrupt(change="bit"), DropByte(), InsertBytes(place=20)])
def test_each_fault_costs_only_its_own_replies(fault: Fault) -> None:
    outcome = exchange(one_byte((fault,), Direction.REPLY, seed=1), 300)
    assert outcome.struck == {fault.kind: 30}
    assert outcome.lost == list(range(10, 301, 10))
    assert (outcome.right, outcome.wrong) == (270, 0)


# Before the frame and behind its 48 bytes.
@pytest.mark.parametrize("place", [0, 48])
def test_stray_byte_costs_no_reply(place: int) -> None:
    outcome = exchange(one_byte((InsertBytes(place=place),), Direction.REPLY, seed=1), 300)
    assert outcome.struck == {"stray": 30}
    assert (outcome.right, outcome.lost) == (300, [])
    assert outcome.link["skipped_bytes"] == 30


@pytest.mark.parametrize("checks", [False, True])
def test_noise_on_every_byte(checks: bool) -> None:
    """The bound of the full run, 30 in 100,000, rounded up for 1,500 exchanges."""
    outcome = exchange(noise(seed=2), 1500, checks=checks)
    assert outcome.wrong <= 1
    assert outcome.right + outcome.wrong + len(outcome.lost) == 1500
    # A byte is hit with a probability of 2 percent; 6 bytes of the request and 48 of the reply must all pass.
    frame = 0.98 ** (6 + 48)
    # Five standard deviations of a binomial distribution.
    assert outcome.right / 1500 == pytest.approx(frame, abs=5 * (frame * (1 - frame) / 1500) ** 0.5)
    assert outcome.struck["corrupted_bytes"] == pytest.approx(outcome.struck["dropped_bytes"], rel=0.2)


def test_missed_targets_are_named() -> None:
    counts = {"timeouts": 2, "naks": 0}
    assert missed(Outcome(20, 18, 0, [10, 20], {"corrupt": 1, "stray": 1}, counts)) == []
    bad = missed(Outcome(20, 16, 1, [10, 13, 20], {"corrupt": 1}, counts))
    assert bad == ["1 wrong values", "lost without a fault: [13]", "1 faults, one in ten wanted",
                   "the client's count of failures is another"]  # fmt: skip
    # 30 wrong values in 100,000 exchanges with noise are the bound, and 31 are too many.
    assert missed(Outcome(100_000, wrong=30, struck={"noise": 9})) == []
    assert missed(Outcome(100_000, wrong=31, struck={"noise": 9})) == ["31 wrong values, 30 at most"]


def test_corrupt_reply_with_valid_checksum_is_detected() -> None:
    """With two or more corrupted bytes, one reply in 256 still has a valid checksum."""
    noisy = Plan((Rule("noise", (Noise(corrupt_percent=4.0),)),), seed=8)
    bare, checked = (exchange(noisy, 600, checks=checks) for checks in (False, True))
    assert 1 <= bare.wrong <= 8
    assert checked.wrong < bare.wrong
    assert checked.link["implausible"] >= 1


def test_packet_is_decoded_by_its_layout() -> None:
    # 0xF0, 1, 2 are bumper bytes; 0x8000 | 20 is -20 and 1 << 31 is 0 in sign-magnitude.
    packet = PACKET.pack(bytes(range(16)), bytes((0xF0, 1, 2)), 10, 0x8000 | 20, *range(6), 7, 1 << 31, 200, 201)
    read = read_packet(build_frame(7, packet))
    assert read[:18] == (*range(16), 0xF00102, 10)
    assert read[18:20] == (-20, 0)
    assert read[-4:] == (7, 1 << 31, 200, 201)
    assert read_packet(build_frame(7, packet[1:])) == read_packet(build_frame(9, packet)) == ()


def test_script_prints_table_and_json() -> None:
    command = [sys.executable, str(SCRIPT), "--exchanges", "30"]
    table = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert table[0].startswith("| faults | struck | right | lost | wrong |")
    assert len(table) == 6
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    results = json.loads(done.stdout)
    assert [result["exchanges"] for result in results.values()] == [30] * 4
