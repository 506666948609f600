"""The injector: counts equal what an onlooker sees happen, "every tenth" is exact, and a seed repeats it all."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.faults.inject import LINE_NAK, Delivery, Injector, total
from nclient.faults.plan import (
    BIT,
    BOTH,
    Blackout,
    Corrupt,
    Cut,
    Delay,
    Direction,
    Drop,
    DropByte,
    Fault,
    HangUp,
    InsertBytes,
    Nak,
    Noise,
    Plan,
    Rule,
    When,
)
from nclient.protocol.serial_framing import build_frame

REQUEST, REPLY = Direction.REQUEST, Direction.REPLY
FRAME = bytes.fromhex("01080005640032800000245c")
frames = st.lists(st.binary(min_size=1, max_size=40), min_size=1, max_size=60)
quick = settings(max_examples=60)


def one_rule(fault: Fault, when: When | None = None, **rest: object) -> Injector:
    return Injector(Plan((Rule("it", (fault,), when or When(), **rest),), seed=3), "serial:1")  # type: ignore[arg-type]


def passed(injector: Injector, sent: list[bytes], command: str = "gs") -> list[list[Delivery]]:
    return [injector.process_frame(frame, command, REPLY, 0.0) for frame in sent]


# The oracles look at the bytes alone, and not at what the injector reports.
def in_place(sent: bytes, arrived: bytes) -> bool:
    """Return True if exactly one byte differs."""
    return len(sent) == len(arrived) and sum(a != b for a, b in zip(sent, arrived, strict=True)) == 1


def one_less(sent: bytes, arrived: bytes) -> bool:
    return any(sent[:k] + sent[k + 1 :] == arrived for k in range(len(sent)))


def one_more(sent: bytes, arrived: bytes) -> bool:
    return one_less(arrived, sent)


def test_no_rule_no_fault() -> None:
    assert Injector(Plan(), "nserver").process_frame(FRAME, "vm", REQUEST, 5.0) == [Delivery(0.0, FRAME)]


@quick
@given(frames, st.integers(1, 12))
def test_every_nth_is_exact(sent: list[bytes], n: int) -> None:
    injector = one_rule(Drop(), When(every=n))
    arrived = passed(injector, sent)
    # The n-th, 2n-th, .. frame is lost, and no other.
    assert [number for number, found in enumerate(arrived, start=1) if not found] == list(range(n, len(sent) + 1, n))
    assert injector.counts == {"it": {"seen": len(sent), "drop": len(sent) // n}}


@quick
@given(frames, st.integers(0, 2**32), st.integers(1, 10))
def test_one_faulty_byte_in_every_nth_of_three_kinds(sent: list[bytes], seed: int, n: int) -> None:
    rule = Rule("byte", (Corrupt(), DropByte(), InsertBytes()), When(every=n))
    injector = Injector(Plan((rule,), seed), "serial:1")
    happened: Counter[str] = Counter({"corrupt": 0, "drop_byte": 0, "stray": 0})
    for number, frame in enumerate(sent, start=1):
        found = injector.process_frame(frame, "gs", REPLY, 0.0)
        data = found[0].data if found else b""
        if data == frame:
            # A frame that arrives unchanged is none of the n-th ones.
            assert number % n
            continue
        assert number % n == 0
        seen = {"corrupt": in_place, "drop_byte": one_less, "stray": one_more}
        # Exactly one of the three kinds explains the difference.
        (kind,) = [kind for kind, looks_like in seen.items() if looks_like(frame, data)]
        happened[kind] += 1
    assert injector.counts["byte"] == {"seen": len(sent)} | dict(happened)
    assert total(injector.counts) == happened
    assert sum(happened.values()) == len(sent) // n


@quick
@given(frames, st.integers(0, 2**32), st.floats(0.0, 100.0))
def test_per_cent_counts_what_it_dropped(sent: list[bytes], seed: int, percent: float) -> None:
    injector = Injector(Plan((Rule("it", (Drop(),), When(percent=percent)),), seed), "nserver")
    lost = sum(not found for found in passed(injector, sent))
    assert injector.counts["it"] == {"seen": len(sent), "drop": lost}


@pytest.mark.long
def test_per_cent_is_that_many_in_the_long_run() -> None:
    injector = one_rule(Drop(), When(percent=30.0))
    passed(injector, [FRAME] * 10_000)
    # Five standard deviations of a binomial distribution, the square root of n p (1 - p).
    assert injector.counts["it"]["drop"] == pytest.approx(3000, abs=5 * (10_000 * 0.3 * 0.7) ** 0.5)


@quick
@given(st.binary(min_size=1, max_size=400), st.integers(0, 2**32))
def test_noise_of_one_kind_counts_its_bytes(data: bytes, seed: int) -> None:
    def noisy(noise: Noise) -> tuple[bytes, dict[str, int]]:
        injector = Injector(Plan((Rule("it", (noise,)),), seed), "serial:1")
        found = injector.process_frame(data, "", REPLY, 0.0)
        return (found[0].data if found else b""), injector.counts["it"]

    # One kind at a time: with several, the bytes alone do not show which of them struck.
    arrived, counts = noisy(Noise(corrupt_percent=20.0))
    changed = sum(a != b for a, b in zip(data, arrived, strict=True))
    assert (counts.get("corrupted_bytes", 0), counts["noise"]) == (changed, int(changed > 0))
    arrived, counts = noisy(Noise(drop_percent=20.0))
    assert counts.get("dropped_bytes", 0) == len(data) - len(arrived)
    arrived, counts = noisy(Noise(add_percent=20.0))
    assert counts.get("added_bytes", 0) == len(arrived) - len(data)
    arrived, counts = noisy(Noise(30.0, 30.0, 30.0, BIT))
    assert len(arrived) - len(data) == counts.get("added_bytes", 0) - counts.get("dropped_bytes", 0)


def test_noise_has_the_configured_rates() -> None:
    injector = one_rule(Noise(1.0, 2.0, 0.5))
    count = 200_000
    for _ in range(200):
        injector.process_frame(bytes(count // 200), "", REPLY, 0.0)
    for kind, percent in (("corrupted_bytes", 1.0), ("dropped_bytes", 2.0), ("added_bytes", 0.5)):
        expected = count * percent / 100
        # Five standard deviations of a Poisson distribution, the square root of its mean.
        assert injector.counts["it"][kind] == pytest.approx(expected, abs=5 * expected**0.5)


@quick
@given(st.binary(min_size=1, max_size=40), st.integers(0, 2**32), st.integers(-50, 50) | st.none())
def test_a_bit_is_one_bit_at_the_place_wanted(data: bytes, seed: int, place: int | None) -> None:
    injector = Injector(Plan((Rule("it", (Corrupt(BIT, place),)),), seed), "x")
    (found,) = injector.process_frame(data, "gs", REPLY, 0.0)
    (where,) = [k for k, (a, b) in enumerate(zip(data, found.data, strict=True)) if a != b]
    assert (data[where] ^ found.data[where]).bit_count() == 1
    if place is not None:
        wanted = place if place >= 0 else len(data) + place
        # A place beyond the frame means its last byte, or its first one.
        assert where == sorted((0, wanted, len(data) - 1))[1]


@quick
@given(st.binary(min_size=1, max_size=40), st.integers(0, 2**32), st.none() | st.integers(0, 50))
def test_a_cut_leaves_less(data: bytes, seed: int, keep: int | None) -> None:
    injector = Injector(Plan((Rule("it", (Cut(keep),)),), seed), "x")
    found = injector.process_frame(data, "gs", REPLY, 0.0)
    arrived = found[0].data if found else b""
    assert data.startswith(arrived)
    assert len(arrived) < len(data)
    if keep is not None:
        assert len(arrived) == min(keep, len(data) - 1)
    # Without `keep` at least one byte arrives; a frame of one byte cannot be cut otherwise than to nothing.
    elif len(data) > 1:
        assert arrived


@quick
@given(st.binary(min_size=1, max_size=40), st.integers(1, 9), st.integers(-50, 50) | st.none())
def test_stray_bytes_stand_at_one_place(data: bytes, count: int, place: int | None) -> None:
    (found,) = one_rule(InsertBytes(count, place)).process_frame(data, "gs", REPLY, 0.0)
    assert len(found.data) == len(data) + count
    assert any(found.data[:k] + found.data[k + count :] == data for k in range(len(data) + 1))


def test_a_drop_byte_at_a_place() -> None:
    (found,) = one_rule(DropByte(-2)).process_frame(FRAME, "gs", REPLY, 0.0)
    assert found.data == FRAME[:-2] + FRAME[-1:]


@quick
@given(st.lists(st.floats(0.0, 5.0), min_size=2, max_size=2).map(sorted), st.integers(0, 2**32))
def test_delays_stay_within_their_jitter(pair: list[float], seed: int) -> None:
    jitter_s, delay_s = pair
    injector = Injector(Plan((Rule("it", (Delay(delay_s, jitter_s),)),), seed), "x")
    for found in passed(injector, [FRAME] * 20):
        assert delay_s - jitter_s <= found[0].delay_s + 1e-9
        assert 0.0 <= found[0].delay_s <= delay_s + jitter_s
    assert injector.counts["it"]["delay"] == 20


def test_delays_add_up_and_jitter_spreads() -> None:
    rules = (Rule("a", (Delay(1.0),)), Rule("b", (Delay(0.5, 0.5),)))
    injector = Injector(Plan(rules), "x")
    delays = [found[0].delay_s for found in passed(injector, [FRAME] * 200)]
    # 1 s and 0.5 s plus or minus 0.5 s: from 1 to 2 s.
    assert 1.0 <= min(delays) < 1.05
    assert 1.95 < max(delays) <= 2.0


def test_nak_replaces_a_reply_and_answers_a_dropped_request() -> None:
    injector = one_rule(Nak(), directions=BOTH)
    assert injector.process_frame(FRAME, "vm", REQUEST, 0.0) == [Delivery(0.0, LINE_NAK, to_sender=True)]
    assert injector.process_frame(FRAME, "vm", REPLY, 0.0) == [Delivery(0.0, LINE_NAK)]
    assert injector.process_frame(FRAME, "vm", REPLY, 0.0, nak=b"no") == [Delivery(0.0, b"no")]
    assert build_frame(8) == LINE_NAK
    assert injector.counts["it"] == {"seen": 3, "nak": 3}


def test_a_hang_up_ends_it_after_so_many_bytes() -> None:
    assert one_rule(HangUp()).process_frame(FRAME, "vm", REPLY, 0.0) == [Delivery(0.0, b"", hang_up=True)]
    assert one_rule(HangUp(3)).process_frame(FRAME, "vm", REPLY, 0.0) == [Delivery(0.0, FRAME[:3], hang_up=True)]


def test_silence_drops_everything_in_its_direction() -> None:
    rule = Rule("hush", (Blackout(2.0),), When(at=(2,)), ("gs",))
    injector = Injector(Plan((rule,)), "x")
    # The second gs reply starts 2 s of silence at 1.0 s, for all replies; requests pass.
    passes = [
        (0.0, "gs", REPLY, True), (1.0, "gs", REPLY, False), (1.5, "vm", REPLY, False), (1.6, "vm", REQUEST, True),
        (2.99, "gs", REPLY, False), (3.0, "gs", REPLY, True), (3.1, "gs", REPLY, True),
    ]  # fmt: skip
    for now_s, command, direction, arrives in passes:
        assert bool(injector.process_frame(FRAME, command, direction, now_s)) is arrives
    # Swallowed frames are not counted as seen: gs at 0, 1, 3 and 3.1 s.
    assert injector.counts["hush"] == {"seen": 4, "silence": 1, "swallowed": 2}


def test_rule_applies_to_its_command_direction_line_and_time() -> None:
    rule = Rule("it", (Drop(),), When(from_s=10.0, until_s=20.0), ("gs", "vm"), frozenset({REQUEST}), ("serial:1",))
    plan = Plan((rule,))
    injector = Injector(plan, "serial:1", start_s=100.0)
    # Times of a rule count from the start of the injector: 110 is 10 s, and 120 is the end.
    assert not injector.process_frame(FRAME, "gs", REQUEST, 110.0)
    assert injector.process_frame(FRAME, "gs", REQUEST, 109.0)
    assert injector.process_frame(FRAME, "gs", REQUEST, 120.0)
    assert injector.process_frame(FRAME, "gs", REPLY, 110.0)
    assert injector.process_frame(FRAME, "st", REQUEST, 110.0)
    assert injector.counts["it"] == {"seen": 1, "drop": 1}
    elsewhere = Injector(plan, "serial:2")
    assert elsewhere.process_frame(FRAME, "gs", REQUEST, 10.0)
    assert elsewhere.counts == {}


def test_what_a_rule_took_away_those_below_never_see() -> None:
    rules = (Rule("above", (Drop(),), When(every=2)), Rule("below", (Drop(),), When(every=2)))
    injector = Injector(Plan(rules), "x")
    # The rule below sees four of the eight frames, and drops every second one of those.
    assert [bool(found) for found in passed(injector, [FRAME] * 8)] == [True, False, False, False] * 2
    assert injector.counts == {"above": {"seen": 8, "drop": 4}, "below": {"seen": 4, "drop": 2}}
    assert total(injector.counts) == {"drop": 6}


@quick
@given(frames, st.integers(0, 2**32))
def test_seed_repeats_and_rules_do_not_affect_each_other(sent: list[bytes], seed: int) -> None:
    one = Rule("one", (Corrupt(), InsertBytes(), Cut()), When(percent=50.0))
    other = Rule("other", (Noise(10.0, 10.0, 10.0),), When(percent=50.0), ("st",))
    # The same rule twice, then with another rule behind it and before it: a rule's random numbers are its own.
    runs = [
        passed(Injector(Plan(rules, seed), "serial:1"), sent) for rules in ((one,), (one,), (one, other), (other, one))
    ]
    assert all(a == b for a, b in pairwise(runs))


def test_each_line_has_its_own_random_stream_and_counts() -> None:
    plan = Plan((Rule("it", (Corrupt(),), When(percent=50.0)),), seed=1)
    one, other = Injector(plan, "serial:1"), Injector(plan, "serial:2")
    assert passed(one, [FRAME] * 50) != passed(other, [FRAME] * 50)


def test_counts_begin_anew_and_what_is_counted_by_goes_on() -> None:
    injector = one_rule(Drop(), When(every=3))
    passed(injector, [FRAME] * 4)
    before = injector.counts
    injector.reset()
    assert injector.counts == {"it": {"seen": 0, "drop": 0}}
    assert before == {"it": {"seen": 4, "drop": 1}}
    # Four frames were seen before: the next third one is the sixth.
    assert [bool(found) for found in passed(injector, [FRAME] * 2)] == [True, False]


def test_a_frame_that_lost_its_last_byte_does_not_arrive() -> None:
    injector = Injector(Plan((Rule("a", (DropByte(),)), Rule("b", (Corrupt(),)))), "x")
    assert injector.process_frame(b"\x07", "", REPLY, 0.0) == []
    assert injector.counts["b"]["seen"] == 0
