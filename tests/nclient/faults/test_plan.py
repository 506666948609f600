"""Plans of faults as values and as TOML: what is wrong is named, and what is written reads back the same."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nclient.errors import FaultPlanError
from nclient.faults import plan as plan_file
from nclient.faults.plan import (
    BIT,
    BOTH,
    BYTE,
    KINDS,
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
    load_plan,
    parse_plan,
    plan_text,
)

EXAMPLE = Path(__file__).parents[3] / "docs" / "faults.toml"

SECONDS = st.floats(0.0, 1000.0)
PLACES = st.none() | st.integers(-300, 300)
FAULTS: st.SearchStrategy[Fault] = st.one_of(
    st.builds(Drop),
    # The jitter must not be larger than the delay.
    st.tuples(SECONDS, SECONDS).map(lambda pair: Delay(max(pair), min(pair))),
    st.builds(Corrupt, st.sampled_from([BIT, BYTE]), PLACES),
    st.builds(DropByte, PLACES),
    st.builds(InsertBytes, st.integers(1, 9), PLACES),
    st.builds(Cut, st.none() | st.integers(0, 300)),
    st.builds(Nak),
    st.builds(Blackout, SECONDS),
    st.builds(HangUp, st.integers(0, 300)),
    st.builds(Noise, st.floats(0.1, 30.0), st.floats(0.0, 30.0), st.floats(0.0, 30.0), st.sampled_from([BIT, BYTE])),
)
TIMES = st.tuples(SECONDS, st.floats(0.001, 10.0) | st.just(math.inf)).map(
    lambda pair: {"from_s": pair[0], "until_s": pair[0] + pair[1]}
)
METHODS: st.SearchStrategy[dict[str, Any]] = st.one_of(
    st.just({}),
    st.fixed_dictionaries({"every": st.integers(1, 1000)}),
    st.fixed_dictionaries({"percent": st.floats(0.0, 100.0)}),
    st.fixed_dictionaries({"first": st.integers(1, 1000)}),
    st.fixed_dictionaries({"at": st.lists(st.integers(1, 1000), min_size=1).map(tuple)}),
)
WHENS = st.builds(lambda method, times: When(**method, **times), METHODS, TIMES)
# No lone surrogates (category Cs), which UTF-8 cannot encode.
NAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1).filter(str.strip)
RULES = st.builds(
    Rule,
    NAMES,
    FAULTS.map(lambda fault: (fault,)) | st.just((Corrupt(), DropByte(), InsertBytes())),
    WHENS,
    st.lists(st.sampled_from(["gs", "vm", "special_request", "hello"]), unique=True).map(tuple),
    st.sampled_from([BOTH, frozenset({Direction.REQUEST}), frozenset({Direction.REPLY})]),
    st.lists(st.sampled_from(["serial:1", "robotd", "nserver", "robotd:12"]), unique=True).map(tuple),
)
PLANS = st.builds(
    Plan, st.lists(RULES, max_size=4, unique_by=lambda rule: rule.name).map(tuple), st.integers(0, 2**63)
)


@given(PLANS)
def test_a_written_plan_reads_back_equal(plan: Plan) -> None:
    # Written and read again: the two directions check each other.
    assert parse_plan(plan_text(plan)) == plan


def test_documented_example_is_a_plan_with_every_kind() -> None:
    plan = load_plan(EXAMPLE)
    assert {fault.kind for rule in plan.rules for fault in rule.faults} == set(KINDS)


def test_a_plan_in_words() -> None:
    plan = parse_plan("""
        seed = 7
        [[rule]]
        do = ["corrupt", "drop_byte", "stray"]
        every = 10
        [[rule]]
        name = "slow gs"
        do = "delay"
        delay_s = 0.2
        jitter_s = 0.05
        command = "gs"
        direction = "both"
        line = ["serial:1", "robotd"]
        at = 3
        until_s = 60
        [[rule]]
        do = "drop"
        command = "all"
        line = "all"
    """)
    one, two, three = plan.rules
    assert plan.seed == 7
    assert one == Rule("rule 1", (Corrupt(), DropByte(), InsertBytes()), When(every=10))
    assert two == Rule(
        "slow gs", (Delay(0.2, 0.05),), When(at=(3,), until_s=60), ("gs",), BOTH, ("serial:1", "robotd")
    )
    assert three == Rule("rule 3", (Drop(),))


def test_an_empty_plan_does_nothing() -> None:
    assert parse_plan("") == Plan()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rule = 3", r"p\.toml: rule: expected tables under \[\[rule\]\]"),
        ("rule = [3]", r"rule\[0\]: expected tables under \[\[rule\]\]"),
        ("[[", "is no TOML"),
        ("seed = -1", "seed: expected a whole number from 0 to 9223372036854775808, found -1"),
        ("seed = true", "seed: expected a whole number"),
        ("rules = []", "rules: unknown key; expected one of seed, rule; did you mean rule?"),
        ("[[rule]]", "rule 'rule 1': do: is missing: a kind of fault"),
        ("[[rule]]\ndo = 'drp'", "rule 'rule 1': do: expected one of corrupt, .*, found 'drp'; did you mean drop?"),
        ("[[rule]]\ndo = 7", "do: expected one of corrupt, .*, found 7"),
        ("[[rule]]\ndo = ['drop', 7]", r"do\[1\]: expected one of corrupt, .*, found 7"),
        ("[[rule]]\nname = 5", "rule 1: name: expected a text, found 5"),
        ("[[rule]]\nname = ' '", "rule 1: name: expected a text"),
        ("[[rule]]\ndo = ['drop', 'drop']", "do: drop is named twice"),
        ("[[rule]]\nname = 'x'\ndo = 'drop'\n[[rule]]\nname='x'\ndo = 'nak'", "rule 'x': name: an earlier rule"),
        ("[[rule]]\ndo = 'drop'\ndelay_s = 1", "rule 'rule 1': delay_s: unknown key"),
        ("[[rule]]\ndo = 'drop'\nevrey = 1", "evrey: unknown key; .*; did you mean every?"),
        ("[[rule]]\ndo = 'delay'", "delay_s: required by do = 'delay'"),
        ("[[rule]]\ndo = 'delay'\ndelay_s = -1", "delay_s: expected 0 to 86400, found -1"),
        ("[[rule]]\ndo = 'delay'\ndelay_s = 1\njitter_s = 2.5", "jitter_s: expected at most delay_s, 1, .* found 2.5"),
        ("[[rule]]\ndo = 'delay'\ndelay_s = nan", "delay_s: expected .* a finite number, found nan"),
        ("[[rule]]\ndo = 'delay'\ndelay_s = 'x'", "delay_s: expected .* a number, found the text 'x'"),
        ("[[rule]]\ndo = 'silence'\nsilence_s = true", "silence_s: expected .* a number, found true"),
        ("[[rule]]\ndo = 'corrupt'\nchange = 'nibble'", "change: expected one of bit, byte, found 'nibble'"),
        ("[[rule]]\ndo = 'corrupt'\nplace = 1.5", "place: expected a whole number, the index of a byte"),
        ("[[rule]]\ndo = 'drop_byte'\nplace = true", "place: expected a whole number"),
        ("[[rule]]\ndo = 'stray'\ncount = 0", "count: expected a whole number from 1 to 65535, found 0"),
        ("[[rule]]\ndo = 'cut'\nkeep = -1", "keep: expected a whole number, 0 or more, found -1"),
        ("[[rule]]\ndo = 'noise'", "corrupt_percent .* expected together more than 0 and at most 100, found 0"),
        ("[[rule]]\ndo = 'noise'\ndrop_percent = 60\nadd_percent = 60", "together more than 0 and at most 100"),
        ("[[rule]]\ndo = 'noise'\ndrop_percent = 101", "drop_percent: expected 0 to 100, found 101"),
        ("[[rule]]\ndo = 'drop'\nevery = 0", "every: expected a whole number, 1 or more, found 0"),
        ("[[rule]]\ndo = 'drop'\nevery = 10\npercent = 1", "percent: every and percent exclude each other; use one"),
        ("[[rule]]\ndo = 'drop'\npercent = 150", "percent: expected 0 to 100, found 150"),
        ("[[rule]]\ndo = 'drop'\nfirst = 'x'", "first: expected a whole number"),
        ("[[rule]]\ndo = 'drop'\nat = []", "at: expected at least 1 numbers of frames"),
        ("[[rule]]\ndo = 'drop'\nat = [0]", r"at\[0\]: expected a whole number, 1 or more, found 0"),
        ("[[rule]]\ndo = 'drop'\nfrom_s = -1", "from_s: expected 0 or more, found -1"),
        ("[[rule]]\ndo = 'drop'\nfrom_s = 5\nuntil_s = 5", "until_s: expected later than from_s, 5, found 5"),
        ("[[rule]]\ndo = 'drop'\ncommand = 'get_sm'", "command: no command 'get_sm'; did you mean get_s"),
        ("[[rule]]\ndo = 'drop'\ncommand = 'arm_zr'", "arm_zr is sent as a special_request; write that"),
        ("[[rule]]\ndo = 'drop'\ncommand = 5", "rule 'rule 1': command: expected a text"),
        ("[[rule]]\ndo = 'drop'\ndirection = 'up'", "direction: expected one of both, reply, request, found 'up'"),
        ("[[rule]]\ndo = 'drop'\ndirection = []", r"direction: expected one of both, .*, found the list \[\]"),
        ("[[rule]]\ndo = 'drop'\nline = 'seral:1'", "line: no line 'seral:1'; .* mean serial?"),
        ("[[rule]]\ndo = 'drop'\nline = 'serial:x'", "line: no line 'serial:x'"),
    ],
)
def test_what_is_wrong_is_named(text: str, words: str) -> None:
    with pytest.raises(FaultPlanError, match=words) as caught:
        parse_plan(text, "p.toml")
    assert str(caught.value).startswith("p.toml: ")


def test_a_rule_that_cannot_be_written_cannot_be_made() -> None:
    with pytest.raises(FaultPlanError, match=r"place: .*all kinds"):
        Rule("x", (Corrupt(place=1), InsertBytes(place=2)))
    with pytest.raises(FaultPlanError, match=r"direction: .*request, reply"):
        Rule("x", (Drop(),), directions=frozenset())


def test_files_that_are_no_plans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FaultPlanError, match=r"nowhere\.toml: .*No such"):
        load_plan(tmp_path / "nowhere.toml")
    with pytest.raises(FaultPlanError, match="embedded null byte"):
        load_plan(tmp_path / "plan\0.toml")
    odd = tmp_path / "odd.toml"
    odd.write_bytes(b"seed = 1 # \xff")
    # 0xff is the eleventh byte, and begins no character in UTF-8.
    with pytest.raises(FaultPlanError, match=r"odd\.toml: .*UTF-8.* 11"):
        load_plan(odd)
    monkeypatch.setattr(plan_file, "MAX_BYTES", 3)
    with pytest.raises(FaultPlanError, match="is longer than"):
        load_plan(odd)


@pytest.mark.parametrize(
    ("when", "struck"),
    [
        (When(), [1, 2, 3, 4, 5, 6]),
        (When(every=2), [2, 4, 6]),
        (When(first=2), [1, 2]),
        (When(at=(5, 1)), [1, 5]),
        (When(percent=50.0), [1, 2]),
        (When(percent=100.0), [1, 2, 3, 4, 5, 6]),
        (When(percent=0.0), []),
    ],
)
def test_which_frames_a_rule_strikes(when: When, struck: list[int]) -> None:
    # One random number in [0, 1) for each frame; 50 percent strikes below 0.5.
    draws = [0.0, 0.4999, 0.5, 0.7, 0.9, 0.99999]
    assert [number for number, draw in enumerate(draws, start=1) if when.matches(number, draw)] == struck


def test_a_rule_is_in_force_from_one_moment_up_to_another() -> None:
    when = When(from_s=1.0, until_s=2.0)
    assert [when.covers(t) for t in (0.5, 1.0, 1.999, 2.0)] == [False, True, True, False]


@pytest.mark.parametrize(
    ("lines", "acts_on"),
    [
        ((), {"serial:1", "serial:2", "robotd:1", "nserver", "serial"}),
        (("serial:1",), {"serial:1"}),
        (("serial",), {"serial:1", "serial:2", "serial"}),
        (("nserver", "robotd:1"), {"nserver", "robotd:1"}),
    ],
)
def test_lines_go_by_name_or_kind(lines: tuple[str, ...], acts_on: set[str]) -> None:
    rule = Rule("x", (Drop(),), lines=lines)
    assert {name for name in ("serial:1", "serial:2", "robotd:1", "nserver", "serial") if rule.acts_on(name)} == acts_on
