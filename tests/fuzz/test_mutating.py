"""Changes to inputs: they change, they are the same for the same chance, and mostly stay what they were."""

from __future__ import annotations

import json
from random import Random

import pytest

from fuzz.mutating import behind, bytes_changed, tree_changed, words_changed
from fuzz.reader import Mutator
from fuzz.table import READERS

TREE = b'{"a": [1, 2.5, {"b": null}], "c": "x"}\n{"d": true}'
ALL: list[Mutator] = [bytes_changed, words_changed(b"key = "), tree_changed, behind(2, bytes_changed)]


@pytest.mark.parametrize("mutate", [*ALL, *(reader.mutate for reader in READERS.values())])
def test_the_same_chance_makes_the_same_input(mutate: Mutator) -> None:
    assert [mutate(TREE, Random(k)) for k in range(30)] == [mutate(TREE, Random(k)) for k in range(30)]


@pytest.mark.parametrize("mutate", ALL)
@pytest.mark.parametrize("data", [b"", b"a", b"[1]", TREE])
def test_nothing_is_too_little_to_change(mutate: Mutator, data: bytes) -> None:
    assert len({mutate(data, Random(k)) for k in range(200)}) > 20


def test_a_tree_stays_json() -> None:
    changed = [tree_changed(TREE, Random(k)) for k in range(300)]
    whole = 0
    for text in changed:
        try:
            whole += all(json.loads(line) is not Ellipsis for line in text.split(b"\n"))
        except (ValueError, RecursionError):
            continue
    assert whole > 200


def test_a_tree_without_end_is_among_them() -> None:
    assert any(b"[" * 1000 in tree_changed(TREE, Random(k)) for k in range(300))


@pytest.mark.parametrize("deep", [100, 900, 990, 100_000])
def test_what_is_nested_deeply_is_changed_all_the_same(deep: int) -> None:
    data = b"[" * deep + b"]" * deep
    assert len({tree_changed(data, Random(k)) for k in range(50)}) > 20


def test_the_head_chooses_and_the_rest_is_changed() -> None:
    changed = [behind(2, bytes_changed)(b"\0\0abc", Random(k)) for k in range(100)]
    assert 40 < sum(each.startswith(b"\0\0") for each in changed) < 100
    assert sum(each[2:] == b"abc" for each in changed) < 20
