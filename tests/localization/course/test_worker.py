"""Judging the functions of a submission, with limits, as the worker process does."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

from localization.course import grading
from tests.localization.course.test_checks import ANSWERS
from tests.localization.course.test_grading import notebook

LIMIT_S = 20.0
RIGHT = inspect.getsource(ANSWERS["relative_step__right_atan2"]).replace("__right_atan2", "")
IMPORTS = "import math\nimport numpy as np"


def test_a_right_function_passes_and_a_missing_one_does_not(tmp_path: Path) -> None:
    values, error = grading.load(notebook(tmp_path / "ada.ipynb", IMPORTS, RIGHT), LIMIT_S)
    assert not error
    assert grading.judge(values, "relative_step", 3, LIMIT_S, error).passed
    missing = grading.judge(values, "random_error", 3, LIMIT_S, error)
    assert not missing.passed
    assert "no function random_error" in missing.text


def test_the_first_error_of_a_submission_is_explained(tmp_path: Path) -> None:
    cells = (IMPORTS, "SIZE = 1 / 0", "raise SystemExit(3)")
    values, error = grading.load(notebook(tmp_path / "bob.ipynb", *cells), LIMIT_S)
    assert "ZeroDivisionError" in error
    assert error in grading.judge(values, "relative_step", 3, LIMIT_S, error).text


@pytest.mark.parametrize(("body", "word"), [
    ("while True:\n        pass", "longer"), ("raise SystemExit(0)", "SystemExit"),
    ("return 1 / 0", "ZeroDivisionError"),
])  # fmt: skip
def test_functions_that_do_not_return_fail(tmp_path: Path, body: str, word: str) -> None:
    parameters = inspect.signature(ANSWERS["relative_step__right_atan2"])
    file = notebook(tmp_path / "eve.ipynb", IMPORTS, f"def relative_step{parameters}:\n    {body}\n")
    values, error = grading.load(file, LIMIT_S)
    # 0.2 s for the answer, where loading the notebook had 20 s.
    found = grading.judge(values, "relative_step", 3, 0.2, error)
    assert not found.passed
    assert word in found.text
