"""Every reader of outer input: a value or its documented error, whatever comes. The same table as `scripts/fuzz`."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.reader import Reader, Wordless
from fuzz.table import READERS
from nclient.errors import ReplyTimeout, WireError

every_reader = pytest.mark.parametrize("reader", READERS.values(), ids=READERS)


@st.composite
def inputs(draw: st.DrawFn, reader: Reader, seeds: list[bytes]) -> bytes:
    """Bytes of any kind, or an input as it should be, changed once to three times."""
    if draw(st.integers(0, 4)) == 0:
        return draw(st.binary(max_size=min(reader.longest, 300)))
    data, chance = draw(st.sampled_from(seeds)), Random(draw(st.integers(0, 2**32)))
    for _ in range(draw(st.integers(1, 3))):
        data = reader.mutate(data, chance)
    return data[: reader.longest]


@every_reader
def test_what_is_as_it_should_be_is_taken(reader: Reader) -> None:
    seeds = list(reader.seeds())
    taken = [reader.take(seed) for seed in seeds]
    if ReplyTimeout in reader.errors:
        assert not any(taken)  # all ask on until nothing comes any more
    else:
        assert any(taken)
    assert max(map(len, seeds)) <= reader.longest


@every_reader
def test_whatever_comes_is_a_value_or_the_documented_error(reader: Reader) -> None:
    @settings(max_examples=40, derandomize=True, database=None)
    @given(inputs(reader, list(reader.seeds())))
    def whatever_comes(data: bytes) -> None:
        reader.take(data)

    whatever_comes()


@every_reader
def test_what_was_found_before_is_read_as_documented(reader: Reader) -> None:
    kept = reader.kept()
    assert kept, f"fuzz/corpus/{reader.name} is empty: scripts/fuzz --keep {reader.name}"
    for data in kept:
        reader.take(data)


def reader_that_raises(error: Exception) -> Reader:
    def read(_data: bytes) -> None:
        raise error

    return Reader("raising", "raises", read, (WireError,), list, lambda data, _: data)


def test_another_error_and_one_without_words_are_not_let_through() -> None:
    assert reader_that_raises(WireError("no frame")).take(b"") is False
    with pytest.raises(KeyError):
        reader_that_raises(KeyError("x")).take(b"")
    with pytest.raises(Wordless, match="WireError without a word"):
        reader_that_raises(WireError(" ")).take(b"")


def test_the_page_names_every_reader_and_what_it_may_raise() -> None:
    page = (Path(__file__).parents[2] / "docs" / "fuzzing.md").read_text(encoding="utf-8")
    for reader in READERS.values():
        raised = ", ".join(error.__name__ for error in reader.errors) or "nothing"
        assert f"| `{reader.name}` | {reader.about} | {raised} |" in page
