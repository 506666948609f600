"""Every reader of outer input returns a value or raises a documented error. The table is that of `scripts/fuzz`."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.reader import SEEDS, EmptyMessage, Reader
from fuzz.readers import READERS
from nclient.errors import ReplyTimeout, WireError

every_reader = pytest.mark.parametrize("reader", READERS.values(), ids=READERS)


@st.composite
def inputs(draw: st.DrawFn, reader: Reader, seeds: list[bytes]) -> bytes:
    """Draw arbitrary bytes, or a valid input mutated one to three times."""
    # One in five inputs is arbitrary; the others are near valid ones, which reach deeper code.
    if draw(st.integers(0, 4)) == 0:
        return draw(st.binary(max_size=min(reader.max_size, 300)))
    data, rng = draw(st.sampled_from(seeds)), Random(draw(st.integers(0, 2**32)))
    for _ in range(draw(st.integers(1, 3))):
        data = reader.mutate(data, rng)
    return data[: reader.max_size]


@every_reader
def test_valid_inputs_are_accepted(reader: Reader) -> None:
    seeds = list(reader.valid_inputs())
    accepted = [reader.accepts(seed) for seed in seeds]
    if ReplyTimeout in reader.errors:
        assert not any(accepted)  # they read until the data ends
    else:
        assert any(accepted)
    assert max(map(len, seeds)) <= reader.max_size


@pytest.mark.long
@every_reader
def test_any_input_gives_value_or_documented_error(reader: Reader) -> None:
    @settings(max_examples=40, derandomize=True, database=None)
    @given(inputs(reader, list(reader.valid_inputs())))
    def read_any_input(data: bytes) -> None:
        reader.accepts(data)

    read_any_input()


@every_reader
def test_seeds_give_value_or_documented_error(reader: Reader) -> None:
    for data in reader.seeds().values():
        reader.accepts(data)


def test_there_are_at_most_five_named_seeds_per_reader() -> None:
    assert {path.name for path in SEEDS.iterdir()} <= set(READERS)
    assert all(len(reader.seeds()) <= 5 for reader in READERS.values())
    assert all(len(data) <= reader.max_size for reader in READERS.values() for data in reader.seeds().values())


def reader_that_raises(error: Exception) -> Reader:
    def read(_data: bytes) -> None:
        raise error

    return Reader("raising", "raises", read, (WireError,), list, lambda data, _: data)


def test_undocumented_and_empty_errors_are_raised() -> None:
    assert reader_that_raises(WireError("no frame")).accepts(b"") is False
    # A documented error is a refusal; any other is raised, as is an error without text.
    with pytest.raises(KeyError):
        reader_that_raises(KeyError("x")).accepts(b"")
    with pytest.raises(EmptyMessage, match="WireError"):
        reader_that_raises(WireError(" ")).accepts(b"")


def test_documentation_lists_every_reader() -> None:
    page = (Path(__file__).parents[2] / "docs" / "fuzzing.md").read_text(encoding="utf-8")
    for reader in READERS.values():
        raised = ", ".join(error.__name__ for error in reader.errors) or "nothing"
        assert f"| `{reader.name}` | {reader.description} | {raised} |" in page
