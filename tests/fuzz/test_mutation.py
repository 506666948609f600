"""Mutations: reproducible, effective, and mostly still valid syntax."""

from __future__ import annotations

import json
from random import Random

import pytest

from fuzz.mutation import after_header, mutate_bytes, mutate_json, word_mutator
from fuzz.reader import Mutator
from fuzz.readers import READERS

# Two documents in one input, as recordings have one per line.
TREE = b'{"a": [1, 2.5, {"b": null}], "c": "x"}\n{"d": true}'
ALL: list[Mutator] = [mutate_bytes, word_mutator(b"key = "), mutate_json, after_header(2, mutate_bytes)]


@pytest.mark.parametrize("mutate", [*ALL, *(reader.mutate for reader in READERS.values())])
def test_mutation_is_reproducible(mutate: Mutator) -> None:
    # The same seed must give the same input: a finding can be repeated.
    assert [mutate(TREE, Random(k)) for k in range(30)] == [mutate(TREE, Random(k)) for k in range(30)]


@pytest.mark.parametrize("mutate", ALL)
@pytest.mark.parametrize("data", [b"", b"a", b"[1]", TREE])
def test_small_inputs_are_mutated(mutate: Mutator, data: bytes) -> None:
    assert len({mutate(data, Random(k)) for k in range(200)}) > 20


def test_json_mostly_remains_valid() -> None:
    results = [mutate_json(TREE, Random(k)) for k in range(300)]
    valid_count = 0
    for text in results:
        try:
            valid_count += all(json.loads(line) is not Ellipsis for line in text.split(b"\n"))
        except (ValueError, RecursionError):
            continue
    assert valid_count > 200


def test_json_includes_deep_nesting() -> None:
    # Deeper than Python's recursion limit: parsers must refuse it, so it must occur.
    assert any(b"[" * 1000 in mutate_json(TREE, Random(k)) for k in range(300))


@pytest.mark.parametrize("deep", [100, 900, 990, 100_000])
def test_deeply_nested_json_is_mutated(deep: int) -> None:
    data = b"[" * deep + b"]" * deep
    assert len({mutate_json(data, Random(k)) for k in range(50)}) > 20


def test_header_is_mostly_unchanged() -> None:
    results = [after_header(2, mutate_bytes)(b"\0\0abc", Random(k)) for k in range(100)]
    assert 40 < sum(each.startswith(b"\0\0") for each in results) < 100
    assert sum(each[2:] == b"abc" for each in results) < 20
