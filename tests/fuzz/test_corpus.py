"""What is kept of inputs: few, small, each for something that no shorter one reaches."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz import corpus
from fuzz.corpus import MOST_BYTES, MOST_FILES, keep, steps_of, worth_keeping
from fuzz.reader import CORPUS, Reader
from fuzz.table import READERS

HELLO = READERS["hello"]


@pytest.mark.parametrize("name", READERS)
def test_the_kept_corpus_is_small(name: str) -> None:
    sizes = [len(data) for data in READERS[name].kept()]
    assert len(sizes) <= MOST_FILES
    assert sum(sizes) <= MOST_BYTES


def test_there_is_a_corpus_for_each_reader_and_no_other() -> None:
    assert {path.name for path in CORPUS.iterdir()} == set(READERS)


def test_steps_are_those_of_our_packages() -> None:
    steps = steps_of(HELLO, bytes(11))
    assert {Path(file).name for file, _, _ in steps} >= {"client_state.py", "wire_state.py"}
    assert not any("site-packages" in file for file, _, _ in steps)


def test_one_short_input_of_a_kind_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = [bytes(30), bytes(12), bytes(11), bytes(12)]
    assert worth_keeping(HELLO, inputs) == [bytes(11), bytes(12)]
    monkeypatch.setattr(corpus, "MOST_FILES", 1)
    assert worth_keeping(HELLO, inputs) == [bytes(11)]


def test_what_shows_a_fault_is_no_example() -> None:
    faulty = Reader("faulty", "", lambda data: HELLO.read(data) or 1 / 0, HELLO.errors, list, HELLO.mutate)
    assert worth_keeping(faulty, [bytes(11)]) == []


def test_what_a_campaign_found_joins_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(corpus, "CORPUS", tmp_path / "corpus")
    (tmp_path / "hello").mkdir()
    (tmp_path / "hello" / "x").write_bytes(b"")
    for _ in range(2):
        assert keep(HELLO, tmp_path) == 2
        assert {path.read_bytes() for path in (tmp_path / "corpus" / "hello").iterdir()} == {b"", bytes(11)}
