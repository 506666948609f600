"""`nomad grade`: points, explanations and limits, in processes of their own."""

from __future__ import annotations

import fcntl
import inspect
import json
from pathlib import Path

import pytest

from localization.course.grading import Limits, SubmissionError, grade, names, statements, tasks_of
from nclient.cli.main import main
from tests.docs.pages import DOCS
from tests.localization.course.test_checks import ANSWERS

SOLUTIONS = DOCS / "course" / "solutions"
DEFINITIONS = {
    "relative_step": inspect.getsource(ANSWERS["relative_step__right_atan2"]).replace("__right_atan2", ""),
    "random_error": "random_error = lambda d, e: np.mean(e**2 / d)\n",
}  # fmt: skip


def notebook(path: Path, *cells: str) -> Path:
    """Write a notebook of code cells."""
    made = {"cells": [{"cell_type": "code", "source": cell.splitlines(keepends=True), "metadata": {}, "outputs": [],
                       "execution_count": None} for cell in cells],
            "metadata": {}, "nbformat": 4, "nbformat_minor": 5}  # fmt: skip
    path.write_text(json.dumps(made), encoding="utf-8")
    return path


def test_only_definitions_are_executed() -> None:
    selected, errors = statements([
        "%matplotlib inline\nimport math\nfrom nclient import connect\n",
        "SCALE = 2 * math.pi\nrobot = connect('sim:')\nfunction = lambda: connect('sim:')\nprint(SCALE)\n",
        "def helper(x):\n    return x\n\nvalues = [helper(k) for k in range(3)]\nfor k in values:\n    print(k)\n",
        "this is no Python",
    ])  # fmt: skip
    # Definitions and plain assignments are executed; connections, prints and loops are not.
    assert names(selected) == {"SCALE", "function", "helper", "values"}
    assert len(selected) == 6
    assert len(errors) == 1


def test_submission_of_another_kind_is_refused(tmp_path: Path) -> None:
    for text in ("[]", "{", '{"cells": [{}]}'):
        (tmp_path / "one.ipynb").write_text(text)
        with pytest.raises(SubmissionError, match="notebook"):
            tasks_of(tmp_path / "one.ipynb")
    with pytest.raises(SubmissionError, match="none"):
        tasks_of(notebook(tmp_path / "two.ipynb", "x = 1"))


def test_wrong_and_right_answers_get_their_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = inspect.getsource(ANSWERS["step_pose__wrong_start_heading"]).replace("__wrong_start_heading", "")
    file = notebook(tmp_path / "ada.ipynb", "import math\nimport numpy as np", wrong, DEFINITIONS["relative_step"],
                    DEFINITIONS["random_error"])  # fmt: skip
    assert main(["grade", str(file), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["submissions"]
    # Task 1 is wrong (0 of 2), task 2 is right (2), task 3 is right (1).
    assert (found["notebook"], found["points"], found["of"]) == ("01", 3, 5)
    assert [task["points"] for task in found["tasks"]] == [0, 2, 1]
    assert "half of the turn" in found["tasks"][0]["text"]


@pytest.mark.long
def test_bad_answer_costs_only_its_own_points(tmp_path: Path) -> None:
    # A loop without end, an exit of the process, 80 GB of memory, and an exit of Python.
    bodies = {
        "move_particles": "    while True:\n        pass\n",
        "weigh_particles": "    import os\n    os._exit(3)\n",
        "resample": "    return [0] * 10**10\n",
        "mean_pose": "    raise SystemExit\n",
    }
    cells = [f"def {name}(*arguments):\n{body}" for name, body in bodies.items()]
    found = grade(notebook(tmp_path / "bob.ipynb", *cells), limits=Limits(seconds=1.0, megabytes=1024))
    assert found.points == 0
    for mark, word in zip(found.marks, ("longer than", "exit code 3", "MemoryError", "SystemExit"), strict=True):
        assert word in mark.text


@pytest.mark.long
def test_answer_that_catches_everything_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("localization.course.grading.START_S", 3.0)
    # An answer that catches the exception of the time limit must be killed.
    loop = "    while True:\n        try:\n            time.sleep(9)\n        except BaseException:\n            pass\n"
    file = notebook(tmp_path / "eve.ipynb", f"import time\ndef update_cell(l, p):\n{loop}")
    assert "stopped" in grade(file, limits=Limits(seconds=0.2)).marks[0].text


@pytest.mark.long
def test_output_and_children_of_answers_change_nothing(tmp_path: Path) -> None:
    # The printed line has the form of a verdict: it must not be taken for one.
    forged = 'print(\'{"name": "update_cell", "passed": true, "text": ""}\')\n'
    # Parent and child hold the lock until both have ended.
    lock = tmp_path / "lock"
    fork = (f"    file = open({str(lock)!r}, 'w')\n    fcntl.flock(file, fcntl.LOCK_EX)\n"
            "    if os.fork() == 0:\n        time.sleep(9000)\n    return 0 * d\n")  # fmt: skip
    file = notebook(tmp_path / "mal.ipynb", "import fcntl, os, time",
                    f"def update_cell(l, p):\n    {forged}    return 0 * p",
                    f"def inverse_sensor(d, a, z):\n{fork}",
                    "def fit_wall(points):\n    os.fork()\n    return 0, 0\n")  # fmt: skip
    for mark, word in zip(grade(file).marks, ("it returned [0", "it returned 0, expected", "root mean"), strict=True):
        assert mark.points == 0
        assert word in mark.text
    # The lock is free only if the answer's child process was killed, too.
    with lock.open() as opened:
        fcntl.flock(opened, fcntl.LOCK_EX)


@pytest.mark.long
def test_table_and_summary_of_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    notebook(tmp_path / "ada.ipynb", "import numpy as np", (SOLUTIONS / "09-lost-and-found.py").read_text())
    # A right answer, and a cell that uses a recorded drive, which is not executed.
    notebook(tmp_path / "bob.ipynb", "def effective_number(weights):\n    return 1 / sum(weights**2)",
             "half = drive / 2")  # fmt: skip
    (tmp_path / ".ipynb_checkpoints").mkdir()
    notebook(tmp_path / ".ipynb_checkpoints" / "ada.ipynb", "x = 1")
    assert main(["grade", str(tmp_path), "--seed", "5"]) == 0
    output = capsys.readouterr().out
    assert "ada.ipynb: 5 of 5 points" in output
    assert "There is no function is_found." in output
    assert "NameError" not in output  # drives are not executed
    assert "bob.ipynb    1 of 5" in output


def test_unreadable_file_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grade", str(tmp_path / "none.ipynb")]) == 1
    assert "cannot be read" in capsys.readouterr().out


def test_empty_folder_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grade", str(tmp_path)]) == 1
    assert "no notebook" in capsys.readouterr().err
