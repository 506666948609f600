"""Notebooks of the course run with the solutions in, in this process with short settings; one of them in Jupyter."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from docs.generate import course
from localization.course.tasks import Verdict, all_tasks, check

pytestmark = pytest.mark.long
NAMES = course.NAMES


@pytest.fixture(autouse=True)
def pictures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[int]]:
    """Run in an empty folder, and count the pictures that are shown."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    shown: list[int] = []

    def show() -> None:
        shown.extend(plt.get_fignums())
        plt.close("all")

    monkeypatch.setattr(plt, "show", show)
    monkeypatch.chdir(tmp_path)
    yield shown
    plt.close("all")


def run_here(made: Any) -> list[Verdict]:
    """Execute the code cells of a notebook in this process, and return the verdicts of its checks."""
    verdicts = []
    values: dict[str, Any] = {"__name__": "notebook"}
    for cell in made.cells:
        if cell.cell_type == "code":
            tree = ast.parse(cell.source)
            # As in a notebook, the value of a cell's last expression is shown.
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            exec(compile(tree, "cell", "exec"), values)
            if last:
                shown = eval(compile(ast.Expression(last.value), "cell", "eval"), values)
                verdicts += [shown] if isinstance(shown, Verdict) else []
    return verdicts


def test_there_are_eleven_with_solutions_apart() -> None:
    assert [name[:2] for name in NAMES] == [f"{number:02}" for number in range(1, 12)]
    for name in NAMES:
        assert (course.COURSE / "solutions" / f"{name}.py").is_file()
        stubs = [cell for cell in course.notebook(name).cells if "task" in cell.metadata.get("tags", [])]
        assert all("raise NotImplementedError" in cell.source for cell in stubs)
        tasks = [task.name for task in all_tasks().values() if task.notebook == name[:2]]
        # The stubs of a notebook are its tasks, in the same order.
        assert [cell.source.partition("(")[0].removeprefix("def ") for cell in stubs] == tasks


@pytest.mark.parametrize("name", NAMES)
def test_notebook_runs_with_solutions(name: str, pictures: list[int]) -> None:
    verdicts = run_here(course.solved(name, quick=True))
    assert [str(each) for each in verdicts if not each.passed] == []
    assert len(verdicts) == sum(task.notebook == name[:2] for task in all_tasks().values())
    assert pictures or name == "06-ekf-room"  # whose pictures are the values of cells


def test_notebook_runs_on_a_recording(tmp_path: Path) -> None:
    name, log = "03-wall-follower", tmp_path / "drive.log"
    run_here(course.solved(name, quick=True, address=f"{course.address_of(name)}&record={log}"))
    assert all(run_here(course.solved(name, quick=True, address=f"replay:{log}")))


def test_notebook_runs_on_a_serial_line() -> None:
    name = "05-kalman-line"
    assert run_here(course.solved(name, quick=True, address=f"{course.address_of(name)}&line=1"))


def test_unsolved_notebook_explains() -> None:
    values: dict[str, Any] = {}
    for cell in course.notebook("01-encoders").cells:
        if "task" in cell.metadata.get("tags", []):
            exec(cell.source, values)
    assert "not written yet" in check(values["step_pose"]).text


def test_notebook_runs_in_jupyter(tmp_path: Path) -> None:
    done = course.run(course.solved("05-kalman-line", quick=True), tmp_path)
    assert course.pictures(done)
