"""Checks of the course: solutions and unusual right answers pass, wrong ones are caught, with a message."""

from __future__ import annotations

import os
import runpy
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import numpy as np
import pytest

from localization.course.tasks import NoSuchTask, Wrong, all_tasks, call, check, numbers, verdict
from tests.docs.pages import DOCS
from tests.localization.course import answers

SEEDS = range(int(os.environ.get("COURSE_SEEDS", "1")))
"""More seeds by scripts/course."""
SOLUTIONS: dict[str, Callable[..., Any]] = {
    name: function
    for file in sorted((DOCS / "course" / "solutions").glob("*.py"))
    for name, function in runpy.run_path(str(file)).items()
    if name in all_tasks()
}
ANSWERS: dict[str, Callable[..., Any]] = {
    name: function
    for module in iter_modules(answers.__path__)
    # Names are TASK__right_REASON and TASK__wrong_REASON; names with a leading underscore are helpers.
    for name, function in vars(import_module(f"{answers.__name__}.{module.name}")).items()
    if "__" in name and not name.startswith("_")
}


@pytest.mark.long
@pytest.mark.parametrize("name", all_tasks())
def test_solution_passes(name: str) -> None:
    for seed in SEEDS:
        assert verdict(all_tasks()[name], SOLUTIONS[name], seed).text == ""


@pytest.mark.parametrize("name", ANSWERS)
def test_answer_is_judged(name: str) -> None:
    task, _, kind = name.partition("__")
    for seed in SEEDS:
        # Another seed than that of the solutions: the checks draw their examples from it.
        found = verdict(all_tasks()[task], ANSWERS[name], seed + 100)
        assert found.passed == kind.startswith("right"), found
        # A message that explains the mistake, and not only that there is one.
        assert found.passed or len(found.text) > 30


def test_every_task_has_three_wrong_answers_and_a_right_one() -> None:
    wrong = Counter(name.partition("__")[0] for name in ANSWERS if "__wrong" in name)
    right = Counter(name.partition("__")[0] for name in ANSWERS if "__right" in name)
    assert set(wrong) == set(right) == set(all_tasks())
    assert min(wrong.values()) >= 3


def test_every_notebook_has_two_to_four_tasks() -> None:
    counts = Counter(task.notebook for task in all_tasks().values())
    assert sorted(counts) == [f"{number:02}" for number in range(1, 12)]
    assert set(counts.values()) <= {2, 3, 4}


def test_unwritten_answer_says_so() -> None:
    def step_pose(*_: Any) -> None:
        raise NotImplementedError

    assert "not written yet" in str(check(step_pose))


@pytest.mark.parametrize(
    ("answer", "word"),
    [
        (lambda *_: None, "None"),
        (lambda *_: 1 / 0, "ZeroDivisionError"),
        (lambda *_: undefined, "arguments"),  # type: ignore[name-defined]  # noqa: F821
        (lambda *_: "text", "numbers"),
        (lambda *_: (1, 2), "shape"),
        (lambda *_: (1, 2, float("nan")), "NaN"),
        (lambda: 1, "TypeError"),
    ],
)
def test_broken_answer_is_explained(answer: Callable[..., Any], word: str) -> None:
    assert word in check(answer, "step_pose").text


def test_statements_are_true_or_false() -> None:
    for name in ("is_blocked", "is_consistent", "is_found"):
        for result in ("yes", 0.5, np.array([True, False])):
            assert "expected True or False" in check(lambda *_, result=result: result, name).text


def test_infinite_results_are_wrong() -> None:
    assert "inf" in check(lambda *_: np.inf, "nearest_reflector").text
    assert "inf" in check(lambda *_: (np.inf, np.inf), "fit_wall").text


def test_answer_cannot_change_its_arguments() -> None:
    given = np.zeros(3)

    def answer(array: np.ndarray) -> np.ndarray:
        array += 1
        return array

    assert numbers(answer, given, shape=(3,)).tolist() == [1, 1, 1]
    assert not given.any()


def test_generator_goes_on_from_call_to_call() -> None:
    rng = np.random.default_rng(0)
    assert call(lambda rng: rng.uniform(), rng) != call(lambda rng: rng.uniform(), rng)


def test_unknown_task_gets_a_suggestion() -> None:
    with pytest.raises(NoSuchTask, match="step_pose"):
        check(lambda: 0, "step_poze")


def test_typical_mistake_gets_its_hint() -> None:
    with pytest.raises(Wrong, match="half of the turn"):
        all_tasks()["step_pose"].check(ANSWERS["step_pose__wrong_start_heading"], np.random.default_rng(3))
